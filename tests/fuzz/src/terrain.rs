//! What the readers need of the terrain.

#[path = "../../../src/terrain/georeference.rs"]
mod georeference;
#[path = "../../../src/terrain/projection.rs"]
mod projection;

pub use georeference::{Georeference, SceneScale};
