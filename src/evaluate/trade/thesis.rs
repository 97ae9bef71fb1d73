//! The thesis: Inam, "Evaluation of Terrain Rendering Algorithms", 2005, its two test cases on terrains made as it names
//! them and on real ones, beside its printed numbers.
//!
//! Its accuracy (formula 3.1) is 100 (H - D) / H: H is the sum of all heights, D that of the vertical differences at
//! all posts. So it depends on where heights count from: the same mesh of the same ground is "more accurate" above a
//! higher datum. The thesis made its heights 8 bits, lowest to highest.

use super::{
    Instrument, Plan, Step, TradeError,
    contender::{Contender, Maker},
    document::{Block, Cell, Section, Table, exact},
    mean,
    noise::Method,
    printed::{AT_10_000, AVERAGES, Printed, SETS},
    world::{World, view},
};
use crate::{
    evaluate::flight,
    lod::{Algorithm, LodView, Target, measure::heights_at_posts},
    terrain::{MemoryField, SceneScale},
};

/// Metres between posts, and of one of 255 steps of height: the thesis says neither.
const SCALE: SceneScale = SceneScale { east_m: 30.0, north_m: 30.0, up_m: 4.0 };
const SEED: u64 = 7;
/// Triangles of the second test case.
const SECOND_CASE: u32 = 10_000;
/// Greatest value of 8 bits.
const GREATEST: f64 = 255.0;

/// Its three algorithms, and this project's.
const CONTENDERS: [Contender; 4] = [
    Contender::Other(Algorithm::Published),
    Contender::Other(Algorithm::Quadtree),
    Contender::Other(Algorithm::GeoMipMap),
    Contender::Plain,
];

/// A mesh of a data set.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Row {
    pub(super) set: String,
    /// Whether it was made here, and whether it is said to be jagged.
    pub(super) is_synthetic: bool,
    pub(super) is_jagged: bool,
    pub(super) case: u8,
    pub(super) contender: Contender,
    pub(super) wanted: u32,
    pub(super) printed: Option<Printed>,
    pub(super) triangles: usize,
    /// Formula 3.1, with heights of 8 bits.
    pub(super) accuracy: f64,
    /// The same with heights in metres above sea, where there is a sea.
    pub(super) accuracy_above_sea: Option<f64>,
    /// Mean vertical difference in steps of height.
    pub(super) mean_difference: f64,
}

/// Both test cases on its five kinds of terrain and on real ones.
pub(super) fn measure(worlds: &[World], plan: &Plan, instrument: &Instrument<'_>) -> Result<Vec<Row>, TradeError> {
    let real: Vec<_> = worlds.iter().skip(1).collect();
    let total = Method::ALL.len() + real.len();
    let mut rows = Vec::new();
    for (n, (method, set)) in Method::ALL.into_iter().zip(SETS).enumerate() {
        (instrument.tell)(Step { name: "the thesis", done: n, total });
        let cells = (set.posts - 1).min(plan.thesis_cells);
        let world = World::new(method.name(), method.terrain(cells, SEED)?, SCALE, instrument)?;
        // On a smaller terrain, as many triangles for each post.
        let share = f64::from(cells + 1) / f64::from(set.posts);
        let case = Case { world: &world, above_sea: None, is_jagged: method.is_jagged(), share: share * share };
        case.measure(Some(&set.results), &mut rows, instrument)?;
    }
    for (n, world) in real.into_iter().enumerate() {
        (instrument.tell)(Step { name: "the thesis", done: Method::ALL.len() + n, total });
        let eight_bits = World::new(world.name.clone(), eight_bits(world)?, in_eight_bits(world), instrument)?;
        let case = Case { world: &eight_bits, above_sea: Some(world), is_jagged: false, share: share_of_1025(world) };
        case.measure(None, &mut rows, instrument)?;
    }
    Ok(rows)
}

/// How many posts a terrain has for each of 1025 x 1025; at most 1.
fn share_of_1025(world: &World) -> f64 {
    let posts = world.ground.grid().posts() as f64;
    (posts / (1025.0 * 1025.0)).min(1.0)
}

/// Lowest height, and height units in one of 255 steps.
fn steps(world: &World) -> [f64; 2] {
    let [low, high] = super::world::height_range_m(world).map(|z| z / world.scale().up_m);
    [low, ((high - low) / GREATEST).max(f64::MIN_POSITIVE)]
}

fn eight_bits(world: &World) -> Result<MemoryField, TradeError> {
    let ([low, step], grid) = (steps(world), world.ground.grid());
    Ok(MemoryField::from_fn(grid.nx(), grid.ny(), |i, j| Some(((world.ground.z(i, j) - low) / step).round()))?)
}

fn in_eight_bits(world: &World) -> SceneScale {
    let scale = world.scale();
    SceneScale { up_m: scale.up_m * steps(world)[1], ..scale }
}

/// A data set.
struct Case<'a> {
    world: &'a World,
    /// The same ground with its own heights.
    above_sea: Option<&'a World>,
    is_jagged: bool,
    /// Posts for each post of the printed set.
    share: f64,
}

impl Case<'_> {
    fn measure(
        &self,
        printed: Option<&[Printed; 3]>,
        rows: &mut Vec<Row>,
        instrument: &Instrument<'_>,
    ) -> Result<(), TradeError> {
        let view = whole(self.world)?;
        let averages = averages_of_real();
        for (n, contender) in CONTENDERS.into_iter().enumerate() {
            // Our own mesh at the number of the first, ROAM.
            let column = n % 3;
            let shown = printed.map_or(averages[column], |printed| printed[column]);
            let wanted = (f64::from(shown.triangles) * self.share) as u32;
            let shown = Some(shown).filter(|_| n < 3 && self.share == 1.0);
            rows.push(self.row(1, contender, wanted, shown, &view, instrument)?);
        }
        for contender in CONTENDERS {
            let wanted = (f64::from(SECOND_CASE) * self.share) as u32;
            rows.push(self.row(2, contender, wanted, None, &view, instrument)?);
        }
        Ok(())
    }

    fn row(
        &self,
        case: u8,
        contender: Contender,
        wanted: u32,
        printed: Option<Printed>,
        view: &LodView,
        instrument: &Instrument<'_>,
    ) -> Result<Row, TradeError> {
        let mut maker = Maker::new(contender, self.world, &[], instrument)?;
        let mesh = maker.update(view, Target::Triangles(wanted), instrument)?.mesh;
        let heights = heights_at_posts(&mesh, &self.world.ground);
        let [total, delta] = sums(self.world, &heights);
        let posts = self.world.ground.grid().posts() as f64;
        let accuracy_above_sea = self.above_sea.map(|sea| {
            let [low, step] = steps(sea);
            let units = sea.scale().up_m;
            percent((low * posts + total * step) * units, delta * step * units)
        });
        Ok(Row {
            set: self.world.name.clone(),
            is_synthetic: self.above_sea.is_none(),
            is_jagged: self.is_jagged,
            case,
            contender,
            wanted,
            printed,
            triangles: mesh.len(),
            accuracy: percent(total, delta),
            accuracy_above_sea,
            mean_difference: delta / posts,
        })
    }
}

/// Formula 3.1.
fn percent(total_height: f64, total_delta: f64) -> f64 {
    100.0 * (total_height - total_delta) / total_height
}

/// The sum of the heights of all posts, and of the differences of a mesh there.
fn sums(world: &World, heights: &[f64]) -> [f64; 2] {
    let columns = world.ground.grid().nx() as usize;
    let mut sums = [0.0; 2];
    for (n, z) in heights.iter().enumerate() {
        let finest = world.ground.z((n % columns) as u32, (n / columns) as u32);
        sums[0] += finest;
        sums[1] += (finest - z).abs();
    }
    sums
}

/// A view of the whole terrain, from the south and above.
fn whole(world: &World) -> Result<LodView, TradeError> {
    let ([east, north], scale) = (world.cells(), world.scale());
    let (east_m, north_m) = (east * scale.east_m, north * scale.north_m);
    let middle_m = world.ground.z(east as u32 / 2, north as u32 / 2) * scale.up_m;
    let eye = glam::DVec3::new(0.5 * east_m, -0.35 * north_m, middle_m + 0.8 * north_m);
    let look = glam::DVec3::new(0.5 * east_m, 0.45 * north_m, middle_m);
    view(&flight::viewpoint(eye, look)?)
}

/// What the thesis prints for its seven real sets, on average.
fn averages_of_real() -> [Printed; 3] {
    averages(&SETS[5..])
}

fn averages(sets: &[super::printed::DataSet]) -> [Printed; 3] {
    [0, 1, 2].map(|n| Printed {
        triangles: mean(&sets.iter().map(|set| f64::from(set.results[n].triangles)).collect::<Vec<_>>()).round() as u32,
        accuracy: mean(&sets.iter().map(|set| set.results[n].accuracy).collect::<Vec<_>>()),
    })
}

/// Part (d) of the report.
pub(super) fn section(rows: &[Row]) -> Section {
    let blocks = vec![
        Block::Text(ABOUT.into()),
        Block::Text(consistency()),
        Block::Table(table(rows, 1)),
        Block::Table(table(rows, 2)),
    ];
    Section { title: "The thesis".into(), blocks }
}

const ABOUT: &str = "Inam (2005) compares ROAM, Roettger's quadtree and GeoMipMap by an accuracy that is 100 (H - D) / H, H \
     the sum of all heights and D that of all vertical differences. Here its two test cases: as accurate as each can \
     be (at the numbers of triangles that it prints, since its settings, \"maximum detail level 30\" and the like, mean \
     nothing outside its programs), and at 10,000 triangles. What could be reproduced: the formula, the methods by which \
     the terrains were made, their sizes, a view of the whole terrain. What could not: TerraGen's seeds and settings, the \
     camera, the scale of a post, the Turkish tiles, and how 16-bit heights became 8-bit ones. The formula counts from \
     the lowest height of 8 bits; the same meshes of the same ground have another accuracy when heights count from the sea.";

/// What its own columns say of each other.
fn consistency() -> String {
    let threefold = SETS.iter().filter(|set| set.roam_vertices == 3 * set.results[0].triangles).count();
    let rates = SETS.iter().filter(|set| (1000.0 / set.roam_rate[1] - set.roam_rate[0]).abs() < 1.0).count();
    let again = averages(&SETS);
    let agree = again
        .iter()
        .zip(AVERAGES)
        .all(|(a, b)| (a.accuracy - b.accuracy).abs() < 0.006 && a.triangles.abs_diff(b.triangles) <= 1);
    format!(
        "Its columns: \"Tris/s\" is the number of triangles in a frame, for in {threefold} of {} sets the vertices of \
         ROAM, drawn triangle by triangle, are three times as many. Frames a second and milliseconds of rendering agree \
         within one frame a second in {rates} of {}. The averages of table 4.1 {} from its other tables (accuracy {:.2}, \
         {:.2} and {:.2} %; {}, {} and {} triangles).",
        SETS.len(),
        SETS.len(),
        if agree { "follow" } else { "do not follow" },
        again[0].accuracy,
        again[1].accuracy,
        again[2].accuracy,
        again[0].triangles,
        again[1].triangles,
        again[2].triangles
    )
}

fn table(rows: &[Row], case: u8) -> Table {
    let cells = |row: &Row| {
        vec![
            row.set.clone().into(),
            row.contender.name().into(),
            Cell::count(row.triangles),
            Cell::number(row.accuracy),
            Cell::number(row.accuracy_above_sea),
            Cell::number(row.mean_difference),
            Cell::number(row.printed.map(|printed| f64::from(printed.triangles))),
            Cell::number(row.printed.map(|printed| printed.accuracy)),
        ]
    };
    let (file, title) = match case {
        1 => ("thesis-maximum", "First test case: the greatest accuracy".to_owned()),
        _ => ("thesis-10000", "Second test case: 10,000 triangles".to_owned()),
    };
    let at_10_000 = AT_10_000.map(|[roam, quadtree]| format!("{:.2} and {:.2} %", roam.accuracy, quadtree.accuracy));
    let note = match case {
        1 => "Real terrains at the average numbers that the thesis prints for its own, smaller ones at as many for \
              each post. Sightline at the number of ROAM."
            .into(),
        _ => format!(
            "The thesis prints, for ROAM and the quadtree: {} (table 3.27), {} (3.28).",
            at_10_000[0], at_10_000[1]
        ),
    };
    let columns = [
        "terrain",
        "system",
        "triangles",
        "accuracy, %",
        "above sea, %",
        "mean difference, 8-bit steps",
        "printed triangles",
        "printed accuracy, %",
    ];
    let rows = rows.iter().filter(|row| row.case == case).map(cells).collect();
    Table { file, title, note, columns: columns.map(exact).to_vec(), rows }
}
