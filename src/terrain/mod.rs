//! The finest surface: a grid of posts with exact heights, its scale and its place on Earth.
//!
//! Everything below this module sees terrain through [`HeightField`]. Heights are exact f64 values in height units
//! (a database's are integers); reads go by page and may fail; nothing holds a terrain as one slice.

mod block;
pub mod extremes;
mod field;
mod georeference;
mod memory;
mod projection;
pub mod synthetic;

pub use block::{Block, Stored};
pub use field::{
    DrawnPost, Grid, GridError, HeightField, HeightPage, PAGE_POSTS, PAGE_SIDE, PageId, Posts, ReadError, Samples,
};
pub use georeference::{EARTH_RADIUS_M, Georeference, SceneScale};
pub use memory::MemoryField;
