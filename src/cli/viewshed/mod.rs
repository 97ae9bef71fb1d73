//! `sightline viewshed`: all that one observer sees, exactly, as a GeoTIFF or a picture.

mod geotiff;
mod picture;

use std::{io, ops::ControlFlow, path::PathBuf};

use serde_json::json;

use self::{geotiff::GeoTiff, picture::Map};
use super::{
    Context, Failure,
    args::{EarthShape, Point, Positions},
    info,
    los::ask::place_failure,
    output::Output,
    progress::Progress,
};
use crate::{
    database::Database,
    exercise::{Place, Site},
    los::{Region, Summary, Tile, View, ViewshedError, viewshed, viewshed_extent},
    terrain::{Georeference, HeightField},
};

/// Most cells of a picture, which is drawn from all of them.
const MAX_PICTURE_CELLS: u64 = 1 << 29;
/// A sagitta above which the flat frame deserves a warning, in metres.
const WARN_SAGITTA_M: f64 = 1.0;

/// Ask what an observer sees of all posts around, exactly, and write it as a GeoTIFF or a picture.
///
/// A GeoTIFF has a byte for each post: 1 where a target on it is seen, 0 where not, 2 where that is unknown (a void
/// post, or unknown ground before it), 255 outside the radius, marked as no data.
///
/// Example: sightline viewshed area.sightline --from -118.292,36.5785,2 --altitude agl --radius 30000
/// --target-height 2 -o seen.tif
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// The database.
    #[arg(value_name = "DB")]
    database: PathBuf,
    /// Where the result goes: .tif or .png. - is standard output, as GeoTIFF.
    #[arg(short, value_name = "F.tif|png")]
    output: PathBuf,
    /// The observer.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    from: Point,
    /// How far to look, in metres in plan.
    #[arg(long, value_name = "M", allow_hyphen_values = true)]
    radius: f64,
    /// Height of targets above the ground, in metres.
    #[arg(long, value_name = "M", default_value_t = 0.0, allow_hyphen_values = true)]
    target_height: f64,
    #[command(flatten)]
    positions: Positions,
    /// Whether touching the ground before the target blocks, too.
    #[arg(long)]
    strict: bool,
    #[command(flatten)]
    earth: EarthShape,
    /// Replace the output if it exists.
    #[arg(long)]
    force: bool,
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let output = Output::new(context, &self.output, self.force)?;
        let as_picture = match output.extension().as_deref() {
            Some("png") => true,
            Some("tif" | "tiff") => false,
            None if output.is_standard() => false,
            _ => return Err(Failure::Usage(format!("-o {}: name it .tif or .png", self.output.display()))),
        };
        let database = info::open(&self.database)?;
        let view = self.view(&database)?;
        let (extent, cells) = viewshed_extent(HeightField::grid(&database), &view).map_err(failure)?;
        if as_picture && cells > MAX_PICTURE_CELLS {
            let most = MAX_PICTURE_CELLS;
            return Err(Failure::Input(format!("{cells} posts; a picture has at most {most}: write a .tif instead")));
        }
        let sagitta = database.georeference().map_or(0.0, |_| Georeference::sagitta_m(self.radius));
        if sagitta > WARN_SAGITTA_M && view.earth.is_flat() && !context.quiet {
            errln!("warning: the Earth bulges by {sagitta:.1} m under so long a line; --earth sphere heeds that");
        }
        let summary = if as_picture {
            self.draw(context, &database, &view, extent, &output)?
        } else {
            let place = database.georeference();
            let mut summary = Summary::default();
            output.write(|out| {
                let broken = |error: io::Error| Failure::environment(self.output.display(), error);
                let mut file = GeoTiff::new(out, extent).map_err(broken)?;
                summary = look(context, &database, &view, |tile| file.add(tile).map_err(broken))?;
                file.finish(place.as_ref()).map_err(broken)
            })?;
            summary
        };
        self.tell(context, &view, summary);
        Ok(())
    }

    fn view(&self, database: &Database) -> Result<View, Failure> {
        let scale = database.scale();
        let site = Site { scale, georeference: database.georeference() };
        let place = Place { position: self.from.0, frame: self.positions.frame(), altitude: self.positions.altitude() };
        let Some(observer) = site.grid_from_place(database, &place, 0.0).map_err(place_failure)? else {
            return Err(Failure::Input(
                "--from is given above ground where no ground is known: give --altitude absolute, or another place"
                    .into(),
            ));
        };
        let region = Region::Radius { metres: self.radius, scale };
        let target_height = self.target_height / scale.up_m;
        let earth = self.earth.earth(scale)?;
        Ok(View { observer, target_height, region, strict: self.strict, earth })
    }

    fn draw(
        &self,
        context: &Context,
        database: &Database,
        view: &View,
        extent: [[u32; 2]; 2],
        output: &Output,
    ) -> Result<Summary, Failure> {
        let mut map = Map::new(extent);
        let summary = look(context, database, view, |tile| {
            map.add(tile);
            Ok(())
        })?;
        let [x, y, z] = self.from.0;
        let seen = share(summary.visible, summary);
        let caption = [
            format!("from {x}, {y}, {z}"),
            format!("radius {} m, targets {} m up", self.radius, self.target_height),
            format!("{seen:.1} % seen of {} posts", summary.visible + summary.blocked + summary.unknown),
        ];
        let picture = map.draw(database, database.scale(), view.observer, &caption);
        let picture = picture.map_err(|error| Failure::Input(error.to_string()))?;
        output.bytes(&picture.png().map_err(|error| Failure::environment(self.output.display(), error))?)?;
        Ok(summary)
    }

    fn tell(&self, context: &Context, view: &View, summary: Summary) {
        let Summary { visible, blocked, unknown, asked } = summary;
        let cells = visible + blocked + unknown;
        if context.json {
            let document = json!({
                "cells": cells, "visible": visible, "blocked": blocked, "unknown": unknown, "asked": asked,
                "observer": view.observer, "radius_m": self.radius, "target_height_m": self.target_height,
                "output": self.output,
            });
            outln!("{document:#}");
        } else if !context.quiet {
            let percent = |n| share(n, summary);
            errln!(
                "{cells} posts: {visible} visible ({:.1} %), {blocked} blocked ({:.1} %), {unknown} unknown ({:.1} %)",
                percent(visible),
                percent(blocked),
                percent(unknown)
            );
        }
    }
}

fn share(part: u64, summary: Summary) -> f64 {
    part as f64 * 100.0 / (summary.visible + summary.blocked + summary.unknown) as f64
}

/// Sweeps, with progress; the receiver's failure ends it.
fn look(
    context: &Context,
    database: &Database,
    view: &View,
    mut receive: impl FnMut(&Tile) -> Result<(), Failure>,
) -> Result<Summary, Failure> {
    let (_, cells) = viewshed_extent(HeightField::grid(database), view).map_err(failure)?;
    let mut progress = Progress::new(context, "posts");
    progress.tell("viewshed", 0, cells);
    let mut broken = None;
    let summary = viewshed(database, view, |tile, at| {
        progress.at(at.done, at.total);
        match receive(&tile) {
            Ok(()) => ControlFlow::Continue(()),
            Err(failure) => {
                broken = Some(failure);
                ControlFlow::Break(())
            }
        }
    });
    progress.finish();
    match (summary, broken) {
        (_, Some(failure)) => Err(failure),
        (summary, None) => summary.map_err(failure),
    }
}

fn failure(error: ViewshedError) -> Failure {
    match error {
        ViewshedError::BadRadius(_) => Failure::Usage(format!("--radius: {error}")),
        ViewshedError::Los(error) => place_failure(error.into()),
        error => Failure::Input(error.to_string()),
    }
}
