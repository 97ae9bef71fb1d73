//! `sightline info`: what a database holds.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::{Context, Failure, output::Output, relief, statistics};
use crate::{
    database::{Database, OpenError, OpenOptions, Statistics, version_digits},
    terrain::{Georeference, SceneScale},
};

/// Show what a database holds.
#[derive(clap::Args, Debug)]
pub(super) struct Args {
    /// The database.
    #[arg(value_name = "DB")]
    database: PathBuf,
    /// Draw it from above, shaded and tinted by height, voids blue, as a PNG.
    #[arg(long, value_name = "F.png")]
    thumbnail: Option<PathBuf>,
    /// Look at every post: how heights are spread, and how far the terrain strays from each level of its hierarchy.
    ///
    /// Reads all of the database, unlike all else that this shows. For each level, coarsest first: how many diamonds it has;
    /// how many the surface does not stray from; the mean deviation, those that half, 95 % and 99 % of the diamonds keep (at
    /// most a 32nd too large), and the greatest. A mesh that is not refined to a level is wrong by so much there.
    #[arg(long)]
    statistics: bool,
    /// Replace the picture if it exists.
    #[arg(long, requires = "thumbnail")]
    force: bool,
}

/// Opens a database, or says why not, with the right exit status.
pub(super) fn open(path: &Path) -> Result<Database, Failure> {
    Database::open(path, OpenOptions::default()).map_err(|error| open_failure(path, error))
}

/// A file that is missing or no database is bad input; one that the system refuses to read is the environment's.
pub(super) fn open_failure(path: &Path, error: OpenError) -> Failure {
    match error {
        OpenError::Io(ref io) if io.kind() != std::io::ErrorKind::NotFound => {
            Failure::environment(path.display(), error)
        }
        _ => Failure::input(path.display(), error),
    }
}

impl Args {
    pub(super) fn run(self, context: &Context) -> Result<(), Failure> {
        let database = open(&self.database)?;
        if let Some(path) = &self.thumbnail {
            let output = Output::new(context, path, self.force)?;
            let picture =
                relief::thumbnail(&database).map_err(|error| Failure::input(self.database.display(), error))?;
            output.bytes(&picture.png().map_err(|error| Failure::environment(path.display(), error))?)?;
        }
        let found = self.statistics.then(|| statistics::of(&database, context)).transpose();
        let found = found.map_err(|error| Failure::input(self.database.display(), error))?;
        if context.json {
            outln!("{:#}", self.document(&database, found.as_ref()));
        } else {
            out!("{}", self.text(&database, found.as_ref()));
        }
        Ok(())
    }

    fn document(&self, database: &Database, found: Option<&Statistics>) -> serde_json::Value {
        let (grid, scale, (lowest, highest)) = (database.grid(), database.scale(), database.height_range());
        let sections: Vec<_> = database.sections().iter().map(|s| {
            json!({ "name": s.name, "bytes": s.bytes, "pages": s.pages, "bytes_per_post": s.bytes as f64 / grid.posts() as f64 })
        }).collect();
        let place = database.georeference().map(|place| {
            let [west, south, east, north] = corners(&place, database);
            json!({
                "epsg": place.epsg, "geographic": place.geographic, "origin": place.origin, "step": place.step,
                "bounds": { "west": west, "south": south, "east": east, "north": north },
                "geographic_corners": geographic_corners(&place, database),
            })
        });
        json!({
            "database": self.database, "version": version_digits(&database.version()),
            "nx": grid.nx(), "ny": grid.ny(), "posts": grid.posts(), "root_exponent": grid.root().exponent(),
            "void_posts": database.void_posts(),
            "unit_m": scale.up_m, "lowest": lowest, "highest": highest,
            "lowest_m": f64::from(lowest) * scale.up_m, "highest_m": f64::from(highest) * scale.up_m,
            "scene_scale_m": { "east": scale.east_m, "north": scale.north_m, "up": scale.up_m },
            "scale_error": scale_error(database),
            "sagitta_of_diagonal_m": Georeference::sagitta_m(diagonal_m(database)),
            "georeference": place,
            "provenance": database.provenance(),
            "bytes": database.file_bytes(),
            "bytes_per_post": database.file_bytes() as f64 / grid.posts() as f64,
            "sections": sections,
            "statistics": found.map(|found| statistics::document(database, found)),
        })
    }

    fn text(&self, database: &Database, found: Option<&Statistics>) -> String {
        let (grid, scale, (lowest, highest)) = (database.grid(), database.scale(), database.height_range());
        let SceneScale { east_m, north_m, up_m } = scale;
        let per_post = |bytes: u64| bytes as f64 / grid.posts() as f64;
        let mut lines = vec![
            format!("database      {}", self.database.display()),
            format!("version       {}", version_digits(&database.version())),
            format!("posts         {} x {} = {}", grid.nx(), grid.ny(), grid.posts()),
            format!("root square   2^{} = {} cells a side", grid.root().exponent(), grid.root().side()),
            format!("height unit   {up_m} m"),
            format!("heights       {} to {} m", f64::from(lowest) * up_m, f64::from(highest) * up_m),
            format!("void          {} posts ({:.3} %)", database.void_posts(), 100.0 * per_post(database.void_posts())),
        ];
        lines.extend(place_lines(database));
        lines.push(format!("scene scale   {east_m:.4} m east, {north_m:.4} m north a post, at the grid's centre"));
        match scale_error(database) {
            Some([east, north]) => {
                let (east, north) = (100.0 * east, 100.0 * north);
                lines.push(format!("scale error   east {east:+.3} %, north {north:+.3} % at worst"));
            }
            None if database.georeference().is_some() => {
                lines.push("scale error   that of the projection: map units are taken as metres".into());
            }
            None => {}
        }
        lines.extend(sagitta_lines(database));
        let provenance = database.provenance();
        lines.push(format!("sources       {}", summary(&provenance.sources)));
        if !provenance.void_filling.is_empty() {
            lines.push(format!("voids drawn   {}", provenance.void_filling));
        }
        if provenance.seam_disagreements > 0 {
            lines.push(format!("seams         {} shared posts differ between tiles", provenance.seam_disagreements));
        }
        lines.push(format!("written by    {}", provenance.written_by));
        lines.push(format!(
            "size          {} bytes, {:.3} a post",
            database.file_bytes(),
            per_post(database.file_bytes())
        ));
        for s in database.sections() {
            lines.push(format!(
                "  {:22} {:>14} bytes {:>9} pages {:8.4} a post",
                s.name,
                s.bytes,
                s.pages,
                per_post(s.bytes)
            ));
        }
        lines.extend(found.into_iter().flat_map(|found| statistics::lines(database, found)));
        lines.join("\n") + "\n"
    }
}

fn summary(sources: &[String]) -> String {
    match sources {
        [] => "not recorded".into(),
        [first, .., last] if sources.len() > 4 => format!("{first} ... {last} ({} files)", sources.len()),
        _ => sources.join(", "),
    }
}

/// West, south, east and north in map coordinates.
fn corners(place: &Georeference, database: &Database) -> [f64; 4] {
    let grid = database.grid();
    let [east, north] = place.map_from_grid(f64::from(grid.nx() - 1), f64::from(grid.ny() - 1));
    [place.origin[0], place.origin[1], east, north]
}

/// Longitude and latitude of the south-western and the north-eastern corner of a map in metres that has them.
fn geographic_corners(place: &Georeference, database: &Database) -> Option<[[f64; 2]; 2]> {
    let [west, south, east, north] = corners(place, database);
    let corner = |x, y| place.geographic_from_map(x, y).filter(|_| !place.geographic);
    Some([corner(west, south)?, corner(east, north)?])
}

fn place_lines(database: &Database) -> Vec<String> {
    let Some(place) = database.georeference() else {
        return vec!["place         not georeferenced: map coordinates are posts, scene metres are posts".into()];
    };
    let kind = if place.geographic { "longitude and latitude" } else { "projected" };
    let code = place.epsg.map_or_else(|| "unnamed".into(), |code| format!("EPSG:{code}"));
    let [west, south, east, north] = corners(&place, database);
    let mut lines = vec![
        format!("CRS           {code}, {kind}"),
        format!("bounds        west {west}, south {south}, east {east}, north {north}"),
    ];
    if let Some([[west, south], [east, north]]) = geographic_corners(&place, database) {
        lines.push(format!(
            "corners       longitude {west:.7}, latitude {south:.7} in the south-west; {east:.7}, {north:.7} in the \
             north-east"
        ));
    }
    lines
}

/// Metres east on the map of the middle of a UTM zone.
const UTM_MIDDLE_M: f64 = 500_000.0;

/// The greatest relative error of the scene scale east and north, as distance in the scene over true distance less
/// one. `None` for projections that are not known.
fn scale_error(database: &Database) -> Option<[f64; 2]> {
    let place = database.georeference().filter(Georeference::has_geographic)?;
    let scale = database.scale();
    let grid = database.grid();
    let mut worst = [0.0_f64; 2];
    let [last_i, last_j] = [grid.nx(), grid.ny()].map(|posts| f64::from(posts - 1));
    let [middle, equator] = place.grid_from_map(UTM_MIDDLE_M, 0.0);
    // Lengths on maps grow or shrink steadily from the equator to the poles, and from a zone's middle to its sides.
    for i in [0.0, middle.clamp(0.0, last_i), last_i] {
        for j in [0.0, equator.clamp(0.0, last_j), last_j] {
            let origin = place.map_from_grid(i, j);
            let there = Georeference { origin, ..place }.scene_scale(1, 1, scale.up_m);
            for (worst, error) in worst.iter_mut().zip([scale.east_m / there.east_m, scale.north_m / there.north_m]) {
                let error = error - 1.0;
                *worst = if error.abs() > worst.abs() { error } else { *worst };
            }
        }
    }
    Some(worst)
}

/// Length of the grid's diagonal in the scene frame.
fn diagonal_m(database: &Database) -> f64 {
    let (grid, scale) = (database.grid(), database.scale());
    let (east, north) = (f64::from(grid.nx() - 1) * scale.east_m, f64::from(grid.ny() - 1) * scale.north_m);
    (east * east + north * north).sqrt()
}

fn sagitta_lines(database: &Database) -> Option<String> {
    database.georeference()?;
    let diagonal = diagonal_m(database);
    Some(format!(
        "flat Earth    lines are straight over a flat Earth: the true one bulges by L^2/8R under a line of length L, \
         {:.2} m at 10 km, {:.1} m over the grid's diagonal of {:.1} km",
        Georeference::sagitta_m(10_000.0),
        Georeference::sagitta_m(diagonal),
        diagonal / 1000.0
    ))
}
