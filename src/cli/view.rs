//! `sightline view`: the headless scene generator.

use std::{path::PathBuf, time::Instant};

use sightline_client::raster::MAX_SIDE_PX;

use super::{
    Context, Failure,
    generator::{self, FlightOrder, Flown, Order, PictureOrder, Wishes},
};
use crate::evaluate::flight::{PRESETS, Preset};

/// Fly over a server's terrain without a window: keep the mesh, check it, draw it.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// Address of the server.
    #[arg(value_name = "ADDR")]
    address: String,
    /// Folder for pictures; made if it is not there.
    #[arg(short, value_name = "DIR")]
    output: PathBuf,
    /// Triangle budget; with --pixels or --frame-time the most triangles.
    #[arg(long, value_name = "N", default_value_t = 5_000)]
    triangles: u32,
    /// As few triangles as this distortion in pixels allows.
    #[arg(long, value_name = "PX", conflicts_with = "frame_time")]
    pixels: Option<f64>,
    /// As many triangles as this program draws in so many milliseconds. Every frame is drawn then, if not written.
    #[arg(long, value_name = "MS")]
    frame_time: Option<f64>,
    /// A parallel projection with half the picture so many metres high.
    #[arg(long, value_name = "M", conflicts_with = "fov")]
    orthographic: Option<f64>,
    /// A disc in which distortion counts WEIGHT times: metres east and north of the south-west post, radius in metres,
    /// weight from 1 to 1048576. May be given up to 64 times.
    #[arg(long, value_name = "E,N,RADIUS,WEIGHT", value_parser = region, allow_hyphen_values = true)]
    region: Vec<[f64; 4]>,
    /// Let new posts slide to their height in so many seconds of the flight, in pictures only: the mesh, its hash and
    /// its verdicts are the frame's, and triangles under sight lines stand still.
    #[arg(long, value_name = "S", value_parser = seconds)]
    morph: Option<f64>,
    /// terrain-avoidance, straight, helicopter, orbit, turn, teleport, or a CSV file of viewpoints in metres of the scene frame:
    /// eye_x_m,eye_y_m,eye_z_m,look_x_m,look_y_m,look_z_m.
    #[arg(long, value_name = "PRESET|FILE", default_value = "straight")]
    flight: String,
    /// Frames to fly [default: 300, or all of a file].
    #[arg(long, value_name = "F")]
    frames: Option<usize>,
    /// Write the session as received to this file.
    #[arg(long, value_name = "F")]
    record: Option<PathBuf>,
    /// Honour the sight lines of this exercise.
    #[arg(long, value_name = "NAME", default_value = "")]
    exercise: String,
    /// Draw every so many frames; the first and the last always.
    #[arg(long, value_name = "K", default_value_t = 50, value_parser = clap::value_parser!(u64).range(1..))]
    every: u64,
    /// Vertical field of view in degrees.
    #[arg(long, value_name = "DEG", default_value_t = 50.0, value_parser = field_of_view)]
    fov: f64,
    /// Size of pictures in pixels.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = viewport)]
    viewport: [u32; 2],
    /// Where a preset flight starts and heads.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Replace a recording that exists.
    #[arg(long)]
    force: bool,
}

fn field_of_view(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(degrees) if (1.0..=170.0).contains(&degrees) => Ok(degrees),
        _ => Err(format!("'{text}' is not a field of view from 1 to 170 degrees")),
    }
}

fn region(text: &str) -> Result<[f64; 4], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    let region = numbers.and_then(|numbers| numbers.try_into().ok());
    region.ok_or_else(|| format!("'{text}' is not E,N,RADIUS,WEIGHT, such as 12000,8500,500,4"))
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.0..=3600.0).contains(&seconds) => Ok(seconds),
        _ => Err(format!("'{text}' is not a time from 0 to 3600 seconds")),
    }
}

fn viewport(text: &str) -> Result<[u32; 2], String> {
    let side = |part: &str| part.parse().ok().filter(|n| (1..=MAX_SIDE_PX).contains(n));
    text.split_once('x')
        .and_then(|(width, height)| Some([side(width)?, side(height)?]))
        .ok_or_else(|| format!("'{text}' is not WxH with 1 to {MAX_SIDE_PX} pixels a side, such as 1280x720"))
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let started = Instant::now();
        if let Some(path) = &self.record {
            super::args::refuse_existing(path, self.force)?;
        }
        std::fs::create_dir_all(&self.output)
            .map_err(|e| Failure::environment(format!("making {}", self.output.display()), e))?;
        let order = self.order()?;
        let flown = generator::runtime()?.block_on(generator::fly(&order, &mut |_| Ok(())))?;
        report(context, &order, &flown, started.elapsed().as_secs_f64())
    }

    fn order(self) -> Result<Order, Failure> {
        let flight = if PRESETS.iter().any(|p| p.name() == self.flight) {
            FlightOrder::Preset { name: self.flight, area_m: None, seed: self.seed }
        } else {
            let csv = std::fs::read_to_string(&self.flight).map_err(|e| {
                Failure::Input(format!(
                    "the flight '{}' is no preset ({}) and no readable file: {e}",
                    self.flight,
                    PRESETS.map(Preset::name).join(", ")
                ))
            })?;
            FlightOrder::Listed { csv }
        };
        Ok(Order {
            name: "view".into(),
            address: self.address,
            exercise: self.exercise,
            triangles: self.triangles,
            tan_half_fov: (0.5 * self.fov).to_radians().tan(),
            viewport_px: self.viewport,
            wishes: Wishes {
                half_height_m: self.orthographic,
                pixels: self.pixels,
                frame_time_ms: self.frame_time,
                regions: self.region,
                morph_s: self.morph,
            },
            flight,
            poses: self.frames,
            rate_hz: 30.0,
            lines: 0,
            plain: false,
            budgets: Vec::new(),
            jump_every: None,
            tell_meshes: false,
            sabotage: None,
            pictures: Some(PictureOrder { directory: self.output, every: self.every, window_m: None }),
            record: self.record,
        })
    }
}

fn report(context: &Context, order: &Order, flown: &Flown, seconds: f64) -> Result<(), Failure> {
    if context.json {
        outln!("{}", serde_json::json!({ "flown": flown, "seconds": seconds }));
    } else {
        outln!("{} poses, {} frames in {seconds:.1} s, {} bytes received", flown.poses, flown.frames, flown.bytes);
        outln!("at most {} of {} triangles; last hash {}", flown.most_triangles, order.triangles, flown.last_hash);
        if order.wishes.pixels.or(order.wishes.frame_time_ms).is_some() {
            outln!("{} triangles in the last frame", flown.last_triangles);
        }
        if let Some(drawn) = flown.most_triangles_drawn {
            outln!("at most {drawn} triangles drawn: those of posts that are leaving are drawn until they are done");
        }
        outln!(
            "{} verdicts on the own mesh, {} silent disagreements with the server's, {} times a line was named",
            flown.comparisons,
            flown.silent_disagreements,
            flown.named
        );
        for path in &flown.pictures {
            outln!("{}", path.display());
        }
        if let (Some(path), Some(cut)) = (&order.record, flown.recording_cut) {
            outln!("{}{}", path.display(), if cut { " (cut at the limit of a recording)" } else { "" });
        }
    }
    match flown.silent_disagreements + flown.refused {
        0 => Ok(()),
        _ => Err(Failure::Found(format!(
            "{} silent disagreements, {} frames that could not be applied",
            flown.silent_disagreements, flown.refused
        ))),
    }
}
