//! Flies over a running server's terrain with a fixed number of triangles, and keeps vertex and index buffers as a
//! renderer would: what each frame changed is all that would be uploaded. When the server goes away it waits for it.
//!
//! ```sh
//! cargo run -p sightline-client --example fly -- 127.0.0.1:7410 10000
//! ```

use std::{ops::Range, time::Duration};

use sightline_client::{Client, ClientError, Event, View, buffers::MeshBuffers, v1};

const POSES: u32 = 60;
/// How long to wait for a server that has gone away.
const PATIENCE: Duration = Duration::from_secs(30);

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), ClientError> {
    let mut arguments = std::env::args().skip(1);
    let address = arguments.next().unwrap_or_else(|| "127.0.0.1:7410".into());
    let triangles = arguments.next().and_then(|n| n.parse().ok()).unwrap_or(10_000);
    let client = Client::connect(&address).await?;
    let terrain = client.terrain().await?;
    let settings = v1::ViewSettings {
        projection: Some(v1::view_settings::Projection::Perspective(v1::Perspective {
            tan_half_fov: 0.5,
            near_m: 1.0,
        })),
        viewport_width_px: 1280,
        viewport_height_px: 720,
        target: Some(v1::view_settings::Target::TriangleBudget(v1::TriangleBudget { triangles })),
        subscription: None, // all sight lines of the exercise; here there is none
        ..Default::default()
    };
    let mut view = client.open_view("", settings, pose(&terrain, 0)).await?;
    next_frame(&mut view).await?;
    let mut buffers = MeshBuffers::new(view.scene(), [0.0; 3]);
    println!("frame 1: all of {} triangles", buffers.triangles().len());
    for n in 1..=POSES {
        view.steer(pose(&terrain, n)).await?;
        let frame = next_frame(&mut view).await?;
        let changed = buffers.update(view.scene());
        println!(
            "frame {}: {} bytes; {} of {} vertices, {} of {} triangles to upload; at most {:.1} px off",
            frame.sequence,
            frame.mesh.len(),
            places(&changed.vertices),
            buffers.vertices().len(),
            places(&changed.triangles),
            buffers.triangles().len(),
            frame.distortion_bound_px
        );
    }
    Ok(())
}

async fn next_frame(view: &mut View) -> Result<v1::Frame, ClientError> {
    loop {
        match view.next().await {
            Ok(Some(Event::Frame(frame))) => return Ok(frame),
            // Sight lines of an epoch, or a frame that was lost: the next one comes by itself.
            Ok(Some(_)) => {}
            Ok(None) | Err(ClientError::Refused(_)) => view.resume(PATIENCE).await?,
            Err(error) => return Err(error),
        }
    }
}

fn places(ranges: &[Range<usize>]) -> usize {
    ranges.iter().map(Range::len).sum()
}

/// Northward over the middle of the terrain, looking 30 degrees downward.
fn pose(terrain: &v1::TerrainDescription, n: u32) -> v1::Pose {
    let north_m = f64::from(terrain.ny - 1) * terrain.metres_per_post_north;
    let eye = v1::Position {
        x: 0.5 * f64::from(terrain.nx - 1) * terrain.metres_per_post_east,
        y: north_m * (0.1 + 0.005 * f64::from(n)),
        z: terrain.max_height * terrain.metres_per_height_unit + 300.0,
    };
    // Straight down, tilted up by 60 degrees about the east axis.
    let (sin, cos) = 30_f64.to_radians().sin_cos();
    v1::Pose { eye: Some(eye), rotation: Some(v1::Quaternion { x: sin, y: 0.0, z: 0.0, w: cos }) }
}
