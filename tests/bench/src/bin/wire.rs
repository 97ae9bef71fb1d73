//! Bytes and times of the mesh payload over a database: snapshots, deltas of flights, HTTP/2 DATA of their frames. Each
//! frame is applied to a replica, as a client does, and its hash checked.
//!
//! `cargo run --release --manifest-path tests/bench/Cargo.toml --bin wire -- DATABASE [TRIANGLES] [FRAMES] [HZ]`

use std::{error::Error, path::Path, sync::Arc, time::Instant};

use prost::Message;
use sightline::{
    database::{Database, OpenOptions},
    evaluate::flight::{Plan, Preset, Viewpoint},
    los,
    roam::{Target, ViewMesh},
    service::ServedTerrain,
    session::{Event, Pose, Settings, View, describe},
    terrain::HeightField,
    view::Camera,
};
use sightline_proto::{
    mesh::Mesh,
    replica::Replica,
    v1::{self, stream_scene_response::Response},
};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// What gRPC puts before a message in the DATA of HTTP/2: a flag and a length.
const GRPC_PREFIX_BYTES: usize = 5;
/// Each time is the median of so many.
const ROUNDS: usize = 101;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("the path of a database, please")?;
    let triangles: u32 = arguments.next().map_or(Ok(10_000), |n| n.parse())?;
    let frames: usize = arguments.next().map_or(Ok(600), |n| n.parse())?;
    let hz: f64 = arguments.next().map_or(Ok(60.0), |n| n.parse())?;
    let terrain = Arc::new(Database::open(Path::new(&path), OpenOptions::default())?);
    let description = describe(&*terrain, &ServedTerrain::site(&*terrain), &terrain.details()?)?;
    snapshot(&terrain, &description, triangles)?;
    println!("flights at {hz} Hz, {triangles} triangles, {frames} frames; the first is not counted");
    for preset in [Preset::Straight, Preset::Helicopter, Preset::Turn, Preset::Teleport] {
        fly(&terrain, &description, &viewpoints(&terrain, preset, frames, hz)?, preset.name(), triangles)?;
    }
    Ok(())
}

/// The mesh that is best in metres everywhere, as one snapshot.
fn snapshot(terrain: &Arc<Database>, description: &v1::TerrainDescription, triangles: u32) -> Result<()> {
    let mut mesh = ViewMesh::new(Arc::clone(terrain), terrain.scale())?;
    let report = mesh.update(&Camera::everywhere(), Target::TriangleBudget(triangles), &[])?;
    let posts: Vec<_> = mesh.active_posts().into_iter().map(|(p, z)| (p, z as i32)).collect();
    let held = Replica::new(description)?.with_posts(posts, 1)?;
    let payload = held.encode(None);
    let frame = v1::Frame {
        sequence: 1,
        mesh: payload.clone(),
        triangle_count: held.triangle_count(),
        mesh_hash: held.hash(),
        ..Default::default()
    };
    let encode_ms = median_ms(|| assert_eq!(held.encode(None).len(), payload.len()));
    let empty = Replica::new(description)?;
    let decode_ms = median_ms(|| {
        let mut replica = empty.clone();
        assert_eq!(replica.apply(&frame, triangles), Ok(()));
    });
    let mut replica = empty.clone();
    replica.apply(&frame, triangles)?;
    assert_eq!(replica.posts(), held.posts(), "lossless");
    println!(
        "snapshot of the world-error mesh, {} triangles, {:.2} m: {} bytes, {:.3} a triangle; encode {encode_ms:.3} ms, \
         decode and check {decode_ms:.3} ms",
        report.triangles,
        report.bound_px,
        payload.len(),
        payload.len() as f64 / f64::from(report.triangles),
    );
    Ok(())
}

fn median_ms(mut what: impl FnMut()) -> f64 {
    let times = (0..ROUNDS).map(|_| {
        let began = Instant::now();
        what();
        1e3 * began.elapsed().as_secs_f64()
    });
    median(&mut times.collect())
}

fn median(values: &mut Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn viewpoints(terrain: &Database, preset: Preset, frames: usize, hz: f64) -> Result<Vec<Viewpoint>> {
    let (grid, scale) = (HeightField::grid(terrain), terrain.scale());
    let far = [f64::from(grid.nx() - 1) * scale.east_m, f64::from(grid.ny() - 1) * scale.north_m];
    let plan = Plan::preset(preset, [[0.0; 2], far], frames, hz, 1)?;
    let mut ground = Vec::new();
    for [x, y] in plan.ground_points() {
        let (x, y) = (x.clamp(0.0, far[0]) / scale.east_m, y.clamp(0.0, far[1]) / scale.north_m);
        let known = los::on_ground(terrain, x, y, 0.0)?.map(|z| z * scale.up_m);
        ground.push(known.or(ground.last().copied()).unwrap_or(0.0));
    }
    Ok(plan.fly(&ground)?)
}

fn pose(viewpoint: &Viewpoint) -> v1::Pose {
    let ([x, y, z, w], eye) = (viewpoint.rotation, viewpoint.eye);
    v1::Pose { eye: Some(v1::Position { x: eye.x, y: eye.y, z: eye.z }), rotation: Some(v1::Quaternion { x, y, z, w }) }
}

/// What the deltas of a flight take.
#[derive(Default)]
struct Flown {
    /// Bytes of DATA of each frame.
    data_bytes: Vec<f64>,
    payload_bytes: Vec<f64>,
    /// Triangles that were made by splits and by merges: an inner post's split makes 4, its merge 2.
    changed: u64,
    produce_ms: Vec<f64>,
    apply_ms: Vec<f64>,
}

fn fly(
    terrain: &Arc<Database>,
    description: &v1::TerrainDescription,
    viewpoints: &[Viewpoint],
    name: &str,
    triangles: u32,
) -> Result<()> {
    let projection = v1::view_settings::Projection::Perspective(v1::Perspective { tan_half_fov: 0.577, near_m: 1.0 });
    let settings = Settings::from_wire(&v1::ViewSettings {
        projection: Some(projection),
        viewport_width_px: 1280,
        viewport_height_px: 720,
        target: Some(v1::view_settings::Target::TriangleBudget(v1::TriangleBudget { triangles })),
        subscription: None,
        regions: Vec::new(),
    })?;
    let first = Pose::from_wire(&pose(&viewpoints[0]))?;
    let mut view = View::open(Arc::clone(terrain), terrain.scale(), description, settings, first, None)?;
    let mut replica = Replica::new(description)?;
    let mut flown = Flown::default();
    for (k, viewpoint) in (0_u64..).zip(viewpoints) {
        if k > 0 {
            let applied_sequence = replica.sequence();
            let steer =
                v1::SteerView { pose: Some(pose(viewpoint)), pose_sequence: k, applied_sequence, ..Default::default() };
            view.handle(Event::Steer(steer))?;
        }
        let began = Instant::now();
        let words = view.produce()?;
        let produce_ms = 1e3 * began.elapsed().as_secs_f64();
        let Some(Response::Frame(frame)) = words.last() else { return Err("no frame".into()) };
        let began = Instant::now();
        let changes = replica.apply_noting(frame, triangles)?;
        let apply_ms = 1e3 * began.elapsed().as_secs_f64();
        assert_eq!(replica.hash(), view.sent().hash());
        if k == 0 {
            continue;
        }
        let root = Mesh::root(&replica);
        let halves = |posts: &[_]| posts.iter().map(|&p| root.triangles(p).count() as u64).sum::<u64>();
        flown.changed += 2 * halves(&changes.added) + halves(&changes.removed);
        let message = v1::StreamSceneResponse { response: words.last().cloned() };
        flown.data_bytes.push((message.encoded_len() + GRPC_PREFIX_BYTES) as f64);
        flown.payload_bytes.push(frame.mesh.len() as f64);
        flown.produce_ms.push(produce_ms);
        flown.apply_ms.push(apply_ms);
    }
    let bytes: f64 = flown.payload_bytes.iter().sum();
    println!(
        "  {name:12} DATA {:4} bytes in the median frame, payload {:4}; {:.3} bytes a changed triangle ({:.0} a frame); made in \
         {:.3} ms, applied in {:.3} ms (medians)",
        median(&mut flown.data_bytes),
        median(&mut flown.payload_bytes),
        bytes / flown.changed as f64,
        flown.changed as f64 / flown.produce_ms.len() as f64,
        median(&mut flown.produce_ms),
        median(&mut flown.apply_ms),
    );
    Ok(())
}
