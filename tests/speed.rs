//! Not guards but measurements: `cargo test --release --test speed -- --ignored --nocapture`.

use std::time::Instant;

use sightline::{
    terrain::{SceneScale, synthetic},
    wedgie::BoundsPyramid,
};

const SCALE: SceneScale = SceneScale { east_m: 74.0, north_m: 92.5, up_m: 1.0 };

#[test]
#[ignore = "needs half a minute; prints how long all bounds of 4801 x 4801 posts take"]
fn bounds_of_a_large_terrain() {
    let field = synthetic::fractal(4801, 4801, 1, 4000).unwrap();
    let start = Instant::now();
    let pyramid = BoundsPyramid::compute(&field, SCALE).unwrap();
    println!("{:?} for {} lattices", start.elapsed(), pyramid.lattices().len());
}
