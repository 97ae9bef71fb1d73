//! Generates the wire types from `sightline/v1/*.proto` without protoc.

use std::{env, error::Error, fs, path::PathBuf};

use prost::Message;

const FILES: [&str; 6] = [
    "sightline/v1/common.proto",
    "sightline/v1/terrain.proto",
    "sightline/v1/line_of_sight.proto",
    "sightline/v1/exercise.proto",
    "sightline/v1/scene.proto",
    "sightline/v1/operation.proto",
];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=sightline");
    let descriptors = protox::compile(FILES, ["."])?;
    let out = PathBuf::from(env::var("OUT_DIR")?);
    fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;
    tonic_prost_build::configure().build_transport(false).compile_fds(descriptors)?;
    Ok(())
}
