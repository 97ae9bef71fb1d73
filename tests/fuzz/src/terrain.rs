//! What the readers need of the terrain.

#[path = "../../../src/terrain/georeference.rs"]
mod georeference;

pub use georeference::{Georeference, SceneScale};
