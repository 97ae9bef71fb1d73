//! A headless scene generator: flies a path over a server's terrain, keeps its replica, checks it, draws it.
//!
//! It knows what the server sent and its own path, nothing else. `view` runs one in this process; `consistency` and
//! `demo` run several, each a process of its own (the hidden verb `scene-generator`), and read their records.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

use prost::Message;
use serde::{Deserialize, Serialize};
use sightline_client::{
    Client, ClientError, Event, View,
    morph::{Drawn, Morph},
    raster::{Projection, Surface, Voids},
    scene::{self, SceneError, SceneState},
};
use sightline_proto::{replica::ApplyError, v1};

use super::{
    Failure,
    connect::{connect, failure},
    pictures,
};
use crate::evaluate::{
    flight::{Plan, Preset, Viewpoint, jumping},
    record::{FrameRecord, Kind, Record},
    recording::{self, Recorder},
    sabotage::{Sabotage, Saboteur},
};

/// How long a server may take for a frame.
const FRAME_TIMEOUT: Duration = Duration::from_secs(120);
/// Plan points asked of the server at a time.
const HEIGHTS_CHUNK: usize = 8_192;
/// Distance of the near plane in metres.
pub(super) const NEAR_M: f64 = 1.0;

/// Where a generator flies.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) enum FlightOrder {
    /// A preset over a plan rectangle in metres; the whole terrain when absent.
    Preset { name: String, area_m: Option<[[f64; 2]; 2]>, seed: u64 },
    /// Viewpoints as CSV.
    Listed { csv: String },
}

/// Which pictures a generator draws.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct PictureOrder {
    /// The folder; it exists.
    pub(super) directory: PathBuf,
    /// Every so many poses; the last pose is always drawn.
    pub(super) every: u64,
    /// The plan rectangle in metres of pictures from above; the whole terrain when absent.
    pub(super) window_m: Option<[[f64; 2]; 2]>,
}

/// What a generator asks of its view beside a triangle budget and a pinhole camera.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Wishes {
    /// Half the height of the picture in metres: a parallel projection.
    pub(super) half_height_m: Option<f64>,
    /// Distortion aimed for, with the triangle count as a cap.
    pub(super) pixels: Option<f64>,
    /// Milliseconds that drawing a frame should take, with the triangle count as a cap. Every frame is drawn then.
    pub(super) frame_time_ms: Option<f64>,
    /// Regions of interest: metres east and north, radius in metres, weight.
    pub(super) regions: Vec<[f64; 4]>,
    /// Seconds of the flight over which new posts slide to their height in pictures.
    pub(super) morph_s: Option<f64>,
}

/// What a generator is to do.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Order {
    pub(super) name: String,
    pub(super) address: String,
    /// Empty for none.
    pub(super) exercise: String,
    pub(super) triangles: u32,
    pub(super) tan_half_fov: f64,
    pub(super) viewport_px: [u32; 2],
    pub(super) wishes: Wishes,
    pub(super) flight: FlightOrder,
    /// Poses to fly; all of a listed flight when absent.
    pub(super) poses: Option<usize>,
    /// Poses a second of the flight.
    pub(super) rate_hz: f64,
    /// Sight lines of which records speak.
    pub(super) lines: usize,
    /// Whether to keep a plain view beside, for contrast.
    pub(super) plain: bool,
    /// Other budgets: the pose from which each counts, ascending.
    pub(super) budgets: Vec<(u64, u32)>,
    /// Poses between two jumps of the view.
    pub(super) jump_every: Option<usize>,
    /// Whether to tell the last meshes of both views.
    pub(super) tell_meshes: bool,
    pub(super) sabotage: Option<Sabotage>,
    pub(super) pictures: Option<PictureOrder>,
    /// The file for a recorded session.
    pub(super) record: Option<PathBuf>,
}

/// What a generator found.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Flown {
    pub(super) poses: u64,
    pub(super) frames: u64,
    pub(super) bytes: u64,
    pub(super) most_triangles: u32,
    /// Most triangles in a picture, those of posts that are leaving included; `None` where nothing slides.
    pub(super) most_triangles_drawn: Option<u64>,
    /// Triangles of the last frame.
    pub(super) last_triangles: u32,
    /// Verdicts on the own mesh that were compared with the stated ones.
    pub(super) comparisons: u64,
    /// Those that differ without being named.
    pub(super) silent_disagreements: u64,
    /// Times that a line was named as unsatisfied.
    pub(super) named: u64,
    /// Frames that could not be applied: wrong hash, wrong count, damage.
    pub(super) refused: u64,
    pub(super) last_epoch: u64,
    pub(super) last_hash: String,
    pub(super) pictures: Vec<PathBuf>,
    /// Whether the recording had to stop at its limit; `None` without one.
    pub(super) recording_cut: Option<bool>,
}

/// The runtime of verbs that talk to a server.
pub(super) fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|e| Failure::environment("starting threads", e))
}

/// Flies `order`; `tell` gets a record of each frame.
pub(super) async fn fly(order: &Order, tell: &mut dyn FnMut(Record) -> Result<(), Failure>) -> Result<Flown, Failure> {
    let client = connect(&order.address).await?;
    let terrain = client.terrain().await.map_err(failure)?;
    let viewpoints = viewpoints(&client, &terrain, order).await?;
    let mut generator = Generator::open(&client, order, &viewpoints[0]).await?;
    for (k, viewpoint) in (0_u64..).zip(&viewpoints) {
        if let Some(&(_, triangles)) = order.budgets.iter().find(|(from, _)| *from == k) {
            generator.change_budget(order, triangles).await?;
        }
        generator.fly_to(k, viewpoint, tell).await?;
        generator.slide(k as f64 / order.rate_hz);
        generator.time_drawing(order, viewpoint);
        let last = k + 1 == viewpoints.len() as u64;
        if let Some(pictures) = order.pictures.as_ref().filter(|p| last || k % p.every.max(1) == 0) {
            generator.draw(pictures, order, viewpoint, k)?;
        }
    }
    generator.finish(order, tell)
}

/// The poses to fly, their ground asked of the server.
async fn viewpoints(
    client: &Client,
    terrain: &v1::TerrainDescription,
    order: &Order,
) -> Result<Vec<Viewpoint>, Failure> {
    let extent = extent_m(terrain);
    let usage = |error: crate::evaluate::flight::FlightError| Failure::Usage(error.to_string());
    let plan = match &order.flight {
        FlightOrder::Listed { csv } => Plan::listed(csv).map_err(|e| Failure::input("the flight", e))?,
        FlightOrder::Preset { name, area_m, seed } => {
            let preset: Preset = name.parse().map_err(usage)?;
            let area_m = area_m.unwrap_or([[0.0; 2], extent]);
            Plan::preset(preset, area_m, order.poses.unwrap_or(DEFAULT_POSES), order.rate_hz, *seed).map_err(usage)?
        }
    };
    let mut viewpoints = over_ground(client, extent, &plan).await?;
    viewpoints.truncate(order.poses.unwrap_or(usize::MAX));
    if let (Some(stay), FlightOrder::Preset { seed, .. }) = (order.jump_every, &order.flight) {
        viewpoints = jumping(&viewpoints, stay, *seed);
    }
    if viewpoints.is_empty() { Err(Failure::Usage("a flight needs at least one frame".into())) } else { Ok(viewpoints) }
}

/// Metres east and north of the north-eastern post.
pub(super) fn extent_m(terrain: &v1::TerrainDescription) -> [f64; 2] {
    [
        f64::from(terrain.nx.saturating_sub(1)) * terrain.metres_per_post_east,
        f64::from(terrain.ny.saturating_sub(1)) * terrain.metres_per_post_north,
    ]
}

/// The viewpoints of a plan, its ground asked of the server.
pub(super) async fn over_ground(client: &Client, extent_m: [f64; 2], plan: &Plan) -> Result<Vec<Viewpoint>, Failure> {
    let within = |p: [f64; 2]| [p[0].clamp(0.0, extent_m[0]), p[1].clamp(0.0, extent_m[1])];
    let points: Vec<_> = plan.ground_points().into_iter().map(within).collect();
    let ground = ground_m(client, &points).await?;
    plan.fly(&ground).map_err(|error| Failure::Usage(error.to_string()))
}

/// Poses of a preset when nobody says.
pub(super) const DEFAULT_POSES: usize = 300;

/// Ground heights in metres; where the ground is unknown, that of the point before.
async fn ground_m(client: &Client, points: &[[f64; 2]]) -> Result<Vec<f64>, Failure> {
    let mut out = Vec::with_capacity(points.len());
    for chunk in points.chunks(HEIGHTS_CHUNK) {
        let request = v1::GetHeightsRequest {
            frame: v1::CoordinateFrame::Scene.into(),
            x: chunk.iter().map(|p| p[0]).collect(),
            y: chunk.iter().map(|p| p[1]).collect(),
            normals: false,
        };
        let heights = client.heights(request).await.map_err(failure)?;
        if heights.z.len() != chunk.len() || heights.known.len() != chunk.len() {
            return Err(Failure::Input("the server answers with another number of heights than asked".into()));
        }
        for (z, known) in heights.z.into_iter().zip(heights.known) {
            let before = out.last().copied().unwrap_or(0.0);
            out.push(if known { z } else { before });
        }
    }
    Ok(out)
}

fn settings(order: &Order, plain: bool) -> v1::ViewSettings {
    use v1::{
        subscription::Lines,
        view_settings::{Projection, Target},
    };
    let lines = if plain { Lines::None(v1::NoLines {}) } else { Lines::All(v1::AllLines {}) };
    let (wishes, tan_half_fov, max_triangles) = (&order.wishes, order.tan_half_fov, order.triangles);
    let pinhole = Projection::Perspective(v1::Perspective { tan_half_fov, near_m: NEAR_M });
    let parallel = |half_height_m| Projection::Orthographic(v1::Orthographic { half_height_m, near_m: NEAR_M });
    let target = match (wishes.pixels, wishes.frame_time_ms) {
        (Some(pixels), _) => Target::ScreenError(v1::ScreenError { pixels, max_triangles }),
        (None, Some(milliseconds)) => Target::FrameTime(v1::FrameTime { milliseconds, max_triangles }),
        (None, None) => Target::TriangleBudget(v1::TriangleBudget { triangles: max_triangles }),
    };
    let region =
        |&[east_m, north_m, radius_m, weight]: &[f64; 4]| v1::RegionOfInterest { east_m, north_m, radius_m, weight };
    v1::ViewSettings {
        projection: Some(wishes.half_height_m.map_or(pinhole, parallel)),
        viewport_width_px: order.viewport_px[0],
        viewport_height_px: order.viewport_px[1],
        target: Some(target),
        subscription: Some(v1::Subscription { lines: Some(lines) }),
        regions: wishes.regions.iter().map(region).collect(),
    }
}

pub(super) fn pose(viewpoint: &Viewpoint) -> v1::Pose {
    let [x, y, z, w] = viewpoint.rotation;
    let eye = viewpoint.eye;
    v1::Pose { eye: Some(v1::Position { x: eye.x, y: eye.y, z: eye.z }), rotation: Some(v1::Quaternion { x, y, z, w }) }
}

/// One generator in flight.
struct Generator {
    view: View,
    plain: Option<View>,
    shadow: Option<Shadow>,
    recorder: Option<Recorder>,
    /// `None` before the first frame, and where nothing slides.
    morph: Option<Morphing>,
    morph_s: Option<f64>,
    /// Where the ground in pictures is filled in.
    voids: Option<Arc<Voids>>,
    lines: usize,
    flown: Flown,
}

/// What is drawn where posts slide.
struct Morphing {
    morph: Morph,
    drawn: Drawn,
}

/// The falsified view of a sabotaged client.
struct Shadow {
    saboteur: Saboteur,
    scene: SceneState,
}

impl Generator {
    async fn open(client: &Client, order: &Order, first: &Viewpoint) -> Result<Self, Failure> {
        let open = |plain| client.open_view(&order.exercise, settings(order, plain), pose(first));
        let view = open(false).await.map_err(failure)?;
        let plain = if order.plain { Some(open(true).await.map_err(failure)?) } else { None };
        let scene = view.scene().clone();
        let voids = match order.pictures {
            Some(_) => client.voids(scene.terrain()).await.map_err(failure)?.map(Arc::new),
            None => None,
        };
        let shadow = order.sabotage.map(|kind| Shadow { saboteur: Saboteur::new(kind, scene.clone()), scene });
        let recorder = order
            .record
            .as_ref()
            .map(|_| Recorder::new(order.triangles, !order.exercise.is_empty(), view.opening_bytes()));
        let flown = Flown { bytes: view.opening_bytes().len() as u64, ..Default::default() };
        Ok(Self {
            view,
            plain,
            shadow,
            recorder,
            morph: None,
            morph_s: order.wishes.morph_s,
            voids,
            lines: order.lines,
            flown,
        })
    }

    /// Allows another number of triangles from the next pose on.
    async fn change_budget(&mut self, order: &Order, triangles: u32) -> Result<(), Failure> {
        let order = Order { triangles, ..order.clone() };
        for (view, plain) in [(Some(&mut self.view), false), (self.plain.as_mut(), true)] {
            if let Some(view) = view {
                view.change_settings(settings(&order, plain)).await.map_err(failure)?;
            }
        }
        Ok(())
    }

    /// Steers to pose `k` and takes all that comes until its frame.
    async fn fly_to(
        &mut self,
        k: u64,
        viewpoint: &Viewpoint,
        tell: &mut dyn FnMut(Record) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        if k > 0 {
            self.view.steer(pose(viewpoint)).await.map_err(failure)?;
        }
        while self.take_one(tell).await? != Some(k) {}
        self.flown.poses += 1;
        let Some(plain) = &mut self.plain else { return Ok(()) };
        if k > 0 {
            plain.steer(pose(viewpoint)).await.map_err(failure)?;
        }
        while !matches!(next(plain).await?, Event::Frame(frame) if frame.pose_sequence == k) {}
        let told = self.shadow.as_ref().map_or(self.view.scene(), |shadow| &shadow.scene);
        tell(Record::Frame(FrameRecord::of(Kind::Plain, plain.scene(), told, self.lines)))
    }

    /// Takes one message of the view; gives the pose of the frame that it brought.
    async fn take_one(&mut self, tell: &mut dyn FnMut(Record) -> Result<(), Failure>) -> Result<Option<u64>, Failure> {
        let event = next(&mut self.view).await?;
        let mut sequence = 0;
        if let Some(bytes) = self.view.last_bytes() {
            self.flown.bytes += bytes.len() as u64;
            if matches!(event, Event::Lost(_)) {
                sequence = frame_sequence(&bytes);
            }
            if let Some(shadow) = &mut self.shadow {
                shadow.take(&bytes, self.lines, tell)?;
            }
            if let Some(recorder) = &mut self.recorder {
                recorder.push(bytes);
            }
        }
        match event {
            Event::Frame(frame) => {
                self.count();
                if self.shadow.is_none() {
                    let scene = self.view.scene();
                    tell(Record::Frame(FrameRecord::of(Kind::Lines, scene, scene, self.lines)))?;
                }
                Ok(Some(frame.pose_sequence))
            }
            Event::Lost(error) => {
                self.flown.refused += 1;
                tell(refusal(sequence, &error))?;
                Ok(None)
            }
            Event::Exercise(_) | Event::Skipped => Ok(None),
        }
    }

    /// Lets the posts that came and went with the last frame slide, as they are drawn at `now_s`.
    fn slide(&mut self, now_s: f64) {
        let Some(duration_s) = self.morph_s else { return };
        let scene = self.view.scene();
        let morphing = self.morph.get_or_insert_with(|| {
            let morph = Morph::new(scene.replica(), duration_s);
            Morphing { drawn: morph.drawn(now_s), morph }
        });
        let lines: Vec<_> = scene.lines().values().filter_map(|line| line.ends).collect();
        morphing.morph.advance(scene.replica(), &lines, now_s);
        morphing.drawn = morphing.morph.drawn(now_s);
        let most = self.flown.most_triangles_drawn.get_or_insert(0);
        *most = (*most).max(morphing.drawn.triangles());
    }

    /// Draws for the clock alone where the budget follows the time that a frame takes.
    fn time_drawing(&mut self, order: &Order, viewpoint: &Viewpoint) {
        if order.wishes.frame_time_ms.is_some() {
            let started = Instant::now();
            let _ = self.scene(order, viewpoint, None).eye_picture();
            self.view.set_frame_time_ms(started.elapsed().as_secs_f64() * 1e3);
        }
    }

    fn scene<'a>(
        &'a self,
        order: &'a Order,
        viewpoint: &'a Viewpoint,
        window_m: Option<[[f64; 2]; 2]>,
    ) -> pictures::Scene<'a> {
        let (state, metres) = (self.view.scene(), self.view.scene().replica().scale_m());
        let mesh = match &self.morph {
            Some(morphing) => Surface::of_mesh(&morphing.drawn, metres),
            None => Surface::of_mesh(state.replica(), metres),
        };
        let surface = Surface { voids: self.voids.clone(), ..mesh };
        let pinhole = Projection::Perspective { tan_half_fov: order.tan_half_fov, near_m: NEAR_M };
        let parallel = |half_height_m| Projection::Orthographic { half_height_m, near_m: NEAR_M };
        pictures::Scene {
            name: &order.name,
            state,
            surface,
            triangles_drawn: self.morph.as_ref().map(|morphing| morphing.drawn.triangles()),
            viewpoint,
            projection: order.wishes.half_height_m.map_or(pinhole, parallel),
            viewport_px: order.viewport_px,
            window_m,
        }
    }

    fn count(&mut self) {
        let scene = self.view.scene();
        let stated = scene.lines().values().filter(|line| line.verdict != v1::Verdict::Unknown).count();
        self.flown.frames += 1;
        self.flown.last_triangles = scene.replica().triangle_count();
        self.flown.most_triangles = self.flown.most_triangles.max(scene.replica().triangle_count());
        self.flown.comparisons += stated as u64;
        self.flown.silent_disagreements += scene.silent_disagreements().len() as u64;
        self.flown.named += scene.unsatisfied().len() as u64;
    }

    fn draw(&mut self, pictures: &PictureOrder, order: &Order, viewpoint: &Viewpoint, k: u64) -> Result<(), Failure> {
        let scene = self.scene(order, viewpoint, pictures.window_m);
        let drawn = [("view", scene.eye_picture()), ("above", scene.map_picture())];
        for (what, picture) in drawn {
            let path = pictures.directory.join(format!("{}-{k:04}-{what}.png", order.name));
            write(&path, &picture.png().map_err(|e| Failure::environment(path.display(), e))?)?;
            self.flown.pictures.push(path);
        }
        Ok(())
    }

    fn finish(mut self, order: &Order, tell: &mut dyn FnMut(Record) -> Result<(), Failure>) -> Result<Flown, Failure> {
        if let (Some(recorder), Some(path)) = (self.recorder, &order.record) {
            let recording = recorder.finish();
            self.flown.recording_cut = Some(recording.cut);
            write(path, &recording::seal(&recording).map_err(|e| Failure::environment(path.display(), e))?)?;
        }
        let plain = self.plain.as_ref().map(|plain| (Kind::Plain, plain));
        for (kind, view) in [(Kind::Lines, &self.view)].into_iter().chain(plain).filter(|_| order.tell_meshes) {
            if let Some(mesh) = Record::of_mesh(kind, view.scene()) {
                tell(mesh)?;
            }
        }
        let scene = self.view.scene();
        self.flown.last_epoch = scene.epoch();
        self.flown.last_hash = format!("{:016x}", scene.replica().hash());
        tell(Record::Done { poses: self.flown.poses, bytes: self.flown.bytes })?;
        Ok(self.flown)
    }
}

impl Shadow {
    fn take(
        &mut self,
        bytes: &[u8],
        lines: usize,
        tell: &mut dyn FnMut(Record) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        let own = |error: &dyn std::fmt::Display| Failure::Input(format!("sabotage: {error}"));
        let message = v1::StreamSceneResponse::decode(bytes).map_err(|e| own(&e))?;
        let passed = self.saboteur.pass(message).map_err(|e| own(&e))?;
        if let Some((betrays, detail)) = passed.tampered {
            tell(Record::Tampered { betrays, detail })?;
        }
        for message in &passed.messages {
            if self.scene.apply(message).map_err(|e| own(&e))? == scene::Event::Frame {
                tell(Record::Frame(FrameRecord::of(Kind::Lines, &self.scene, &self.scene, lines)))?;
            }
        }
        Ok(())
    }
}

/// The number of the frame that a message carries; 0 for any other message.
fn frame_sequence(bytes: &[u8]) -> u64 {
    match v1::StreamSceneResponse::decode(bytes).ok().and_then(|message| message.response) {
        Some(v1::stream_scene_response::Response::Frame(frame)) => frame.sequence,
        _ => 0,
    }
}

fn refusal(sequence: u64, error: &SceneError) -> Record {
    let hash = matches!(error, SceneError::Frame(ApplyError::Hash { .. }));
    Record::Refused { sequence, hash, detail: error.to_string() }
}

async fn next(view: &mut View) -> Result<Event, Failure> {
    match tokio::time::timeout(FRAME_TIMEOUT, view.next()).await {
        Ok(Ok(Some(event))) => Ok(event),
        Ok(Ok(None)) => Err(failure(ClientError::Closed)),
        Ok(Err(error)) => Err(failure(error)),
        Err(_) => Err(Failure::Environment(format!("no message from the server for {} s", FRAME_TIMEOUT.as_secs()))),
    }
}

pub(super) fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    fs::write(path, bytes).map_err(|e| Failure::environment(format!("writing {}", path.display()), e))
}
