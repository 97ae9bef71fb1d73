//! Every cell against the query of its own.

use proptest::prelude::*;

use super::*;
use crate::terrain::{MemoryField, synthetic};

/// The verdict on each cell of a region, in order of rows, after checking that each came once.
fn cells<H: HeightField>(field: &H, view: &View) -> (Vec<([u32; 2], Verdict)>, Summary) {
    let mut cells = Vec::new();
    let mut reported = 0;
    let summary = viewshed(field, view, |tile, progress| {
        for (n, &verdict) in (0..).zip(&tile.cells) {
            let [i, j] = [tile.page.pi * PAGE_SIDE + n % PAGE_SIDE, tile.page.pj * PAGE_SIDE + n / PAGE_SIDE];
            cells.extend(verdict.map(|verdict| ([j, i], verdict)));
        }
        assert!(progress.done > reported && progress.done <= progress.total);
        reported = progress.done;
        ControlFlow::Continue(())
    })
    .unwrap();
    cells.sort();
    assert!(cells.windows(2).all(|pair| pair[0].0 != pair[1].0), "a cell came twice");
    assert_eq!(cells.len() as u64, summary.visible + summary.blocked + summary.unknown);
    (cells.into_iter().map(|([j, i], verdict)| ([i, j], verdict)).collect(), summary)
}

/// Compares each cell with its own query; returns the summary.
fn check<H: HeightField>(field: &H, view: &View) -> Summary {
    let (cells, summary) = cells(field, view);
    let mut posts = Posts::new(field);
    let options = Options { strict: view.strict, earth: view.earth, ..Options::default() };
    let mut lines = Lines::plain(field);
    for ([i, j], verdict) in cells {
        let (x, y) = (f64::from(i), f64::from(j));
        let expected = match on_ground(field, x, y, view.target_height).unwrap() {
            Some(z) => lines.ask(view.observer, [x, y, z], options).unwrap().verdict,
            None => Verdict::Unknown,
        };
        let post = posts.at(sightline_proto::diamond::Post::new(i, j)).unwrap();
        assert_eq!(verdict, expected, "post ({i}, {j}) {post:?} of {view:?}");
    }
    summary
}

fn everything() -> Region {
    Region::Rectangle { i: [0, u32::MAX], j: [0, u32::MAX] }
}

/// A random terrain of few heights, so that ties are common, from a number.
fn terrain(seed: u64, nx: u32, ny: u32, void_share: u64) -> MemoryField {
    let kind = synthetic::mix(seed) % 4;
    MemoryField::from_fn(nx, ny, |i, j| {
        let n = synthetic::mix(seed ^ synthetic::mix(u64::from(i) << 32 | u64::from(j)));
        let z = match kind {
            0 => 0.0,
            1 => (n % 3) as f64,
            2 => f64::from(synthetic::fractal_height(i, j, seed, 40)),
            _ => f64::from(i / 8) + (n % 2) as f64 * 0.25,
        };
        (n >> 32 & 255 >= void_share).then_some(z)
    })
    .unwrap()
}

/// On, between, just beside and outside of the posts.
fn coordinate(side: f64) -> impl Strategy<Value = f64> {
    let whole = move || (-2..side as i32 + 2).prop_map(f64::from);
    prop_oneof![
        3 => whole(),
        2 => whole().prop_map(|v| v + 0.5),
        1 => whole().prop_map(f64::next_up),
        1 => whole().prop_map(f64::next_down),
        1 => whole().prop_map(|v| v + 1e-9),
        4 => 0.0..side,
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 160, ..ProptestConfig::default() })]

    /// Voids, plateaus, grazing, observers on posts and edges, below ground, outside and at the border.
    #[test]
    fn each_cell_has_the_verdict_of_its_own_query(
        seed in 0..u64::MAX,
        nx in 2..40_u32,
        ny in 2..40_u32,
        void_share in prop_oneof![3 => Just(0_u64), 1 => Just(4), 1 => Just(60)],
        x in coordinate(40.0),
        y in coordinate(40.0),
        above in prop_oneof![4 => Just(0.0), 3 => Just(1.0), 1 => Just(-0.5), 2 => Just(30.0), 1 => Just(1e6)],
        target_height in prop_oneof![3 => Just(0.0), 2 => Just(1.0), 1 => Just(0.1), 1 => Just(-1.0)],
        strict in any::<bool>(),
        radius in prop_oneof![Just(None), (1.0..60.0_f64).prop_map(Some)],
        north_m in prop_oneof![Just(1.0), Just(1.7)],
        bend in prop_oneof![5 => Just([0.0, 0.0]), 1 => Just([1e-5, 2e-5]), 2 => Just([0.02, 0.01]), 1 => Just([0.0, 0.125])],
    ) {
        let field = terrain(seed, nx, ny, void_share);
        let z = on_ground(&field, x, y, above).unwrap().unwrap_or(above);
        let scale = SceneScale { east_m: 1.0, north_m, up_m: 1.0 };
        let region = radius.map_or(everything(), |metres| Region::Radius { metres, scale });
        let earth = Earth::curved(bend[0], bend[1]).unwrap();
        let view = View { observer: [x, y, z], target_height, region, strict, earth };
        let empty = viewshed(&field, &view, |_, _| ControlFlow::Break(())) == Err(ViewshedError::EmptyRegion);
        prop_assume!(!empty);
        check(&field, &view);
    }
}

#[test]
fn a_bulge_between_crossings_counts_where_a_path_is_followed_back() {
    let field = terrain(16_187_827_663_538_201_231, 34, 31, 0);
    let (x, y) = (32.791225405147564, 29.206893038161866);
    let z = on_ground(&field, x, y, 0.0).unwrap().unwrap();
    let earth = Earth::curved(0.02, 0.01).unwrap();
    check(&field, &View { observer: [x, y, z], target_height: 1.0, region: everything(), strict: false, earth });
}

/// An edge before the first column rises, within one sector, towards its post in that column.
#[test]
fn a_path_followed_back_to_the_first_column_meets_the_posts_of_that_column() {
    let field = terrain(10_958_751_093_110_824_209, 35, 7, 0);
    let (x, y) = (20.567_465_274_401_51, 6.0_f64.next_down());
    let z = on_ground(&field, x, y, 1.0).unwrap().unwrap();
    let view =
        View { observer: [x, y, z], target_height: 0.1, region: everything(), strict: false, earth: Earth::Flat };
    check(&field, &view);
}

#[test]
fn a_fractal_is_right_in_every_cell_and_few_are_asked() {
    let field = synthetic::fractal(257, 257, 5, 400).unwrap();
    for (x, y, above, target_height) in [(128.0, 128.0, 2.0, 2.0), (40.25, 100.7, 30.0, 0.0), (256.0, 3.0, 2.0, 2.0)] {
        let z = on_ground(&field, x, y, above).unwrap().unwrap();
        let view = View { observer: [x, y, z], target_height, region: everything(), strict: false, earth: Earth::Flat };
        let summary = check(&field, &view);
        assert!(summary.visible > 500 && summary.blocked > 500, "{summary:?}");
        assert!(summary.asked * 10 < 257 * 257, "{summary:?}");
    }
}

#[test]
fn a_lake_of_voids_is_seen_across_as_unknown() {
    let hill = |i: u32, j: u32| f64::from(synthetic::fractal_height(i, j, 3, 100));
    let lake = |i: u32, j: u32| (i.abs_diff(90) < 25 && j.abs_diff(70) < 30) || (i == 30 && j.is_multiple_of(3));
    let field = MemoryField::from_fn(150, 150, |i, j| (!lake(i, j)).then(|| hill(i, j))).unwrap();
    let z = on_ground(&field, 40.5, 75.25, 20.0).unwrap().unwrap();
    let view = View {
        observer: [40.5, 75.25, z],
        target_height: 1.0,
        region: everything(),
        strict: false,
        earth: Earth::Flat,
    };
    let summary = check(&field, &view);
    assert!(summary.unknown > 3000 && summary.blocked > 3000 && summary.visible > 300, "{summary:?}");
    assert!(summary.asked < 6000, "{summary:?}");
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let field = synthetic::fractal(150, 130, 9, 300).unwrap();
    let z = on_ground(&field, 70.0, 60.5, 3.0).unwrap().unwrap();
    let scale = SceneScale { east_m: 2.0, north_m: 3.0, up_m: 1.0 };
    let region = Region::Radius { metres: 140.0, scale };
    let view = View { observer: [70.0, 60.5, z], target_height: 0.5, region, strict: false, earth: Earth::Flat };
    let expected = cells(&field, &view);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(pool.install(|| cells(&field, &view)), expected);
}

#[test]
fn a_radius_holds_the_posts_within_it() {
    let field = synthetic::fractal(90, 80, 9, 30).unwrap();
    let scale = SceneScale { east_m: 10.0, north_m: 25.0, up_m: 1.0 };
    let observer = [30.0, 40.0, 1e4];
    let view = View {
        observer,
        target_height: 0.0,
        region: Region::Radius { metres: 250.0, scale },
        strict: false,
        earth: Earth::Flat,
    };
    let (cells, summary) = cells(&field, &view);
    let within = |i: u32, j: u32| {
        let (east, north) = ((f64::from(i) - 30.0) * 10.0, (f64::from(j) - 40.0) * 25.0);
        east * east + north * north <= 250.0 * 250.0
    };
    let extent = viewshed_extent(field.grid(), &view).unwrap();
    assert_eq!(extent, ([[5, 30], [55, 50]], cells.len() as u64));
    let expected: Vec<_> = (0..80).flat_map(|j| (0..90).map(move |i| [i, j])).filter(|&[i, j]| within(i, j)).collect();
    assert_eq!(cells.iter().map(|c| c.0).collect::<Vec<_>>(), expected);
    assert_eq!(summary.blocked + summary.unknown, 0, "from so high all is seen");
}

#[test]
fn huge_heights_and_far_observers_are_asked() {
    let field = MemoryField::from_fn(20, 20, |i, j| Some(if i == 9 { 3e200 } else { f64::from(i * j) })).unwrap();
    for observer in [[3.0, 3.5, 100.0], [1e9, 4.0, 50.0], [5.0, -1e250, 10.0], [4.0, 4.0, 1e300]] {
        check(&field, &View { observer, target_height: 1.0, region: everything(), strict: false, earth: Earth::Flat });
    }
}

#[test]
fn what_makes_no_sense_is_refused() {
    let field = synthetic::fractal(20, 20, 1, 10).unwrap();
    let ask = |view: View| viewshed(&field, &view, |_, _| ControlFlow::Continue(())).unwrap_err();
    let view = View {
        observer: [5.0, 5.0, 50.0],
        target_height: 0.0,
        region: everything(),
        strict: false,
        earth: Earth::Flat,
    };
    let radius = |metres| View { region: Region::Radius { metres, scale: SceneScale::UNIT }, ..view };
    assert_eq!(ask(radius(-1.0)), ViewshedError::BadRadius(-1.0));
    assert_eq!(ask(View { observer: [1e20, 0.0, 0.0], ..radius(5.0) }), ViewshedError::FarObserver(1e20, 0.0));
    assert_eq!(ask(View { observer: [100.0, 0.0, 0.0], ..radius(5.0) }), ViewshedError::EmptyRegion);
    assert!(matches!(ask(View { target_height: f64::NAN, ..view }), ViewshedError::Los(LosError::NotFinite { .. })));
    assert!(matches!(ask(View { observer: [f64::NAN; 3], ..view }), ViewshedError::Los(LosError::NotFinite { .. })));
    let stopped = viewshed(&field, &view, |_, _| ControlFlow::Break(()));
    assert_eq!(stopped, Err(ViewshedError::Stopped));
}
