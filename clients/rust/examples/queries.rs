//! Asks a running server for lines of sight, one with all that follows from it and many at once:
//!
//! ```sh
//! cargo run -p sightline-client --example queries -- 127.0.0.1:7410
//! ```

use sightline_client::{Client, ClientError, v1};

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), ClientError> {
    let address = std::env::args().nth(1).unwrap_or_else(|| "127.0.0.1:7410".into());
    let client = Client::connect(&address).await?;
    let terrain = client.terrain().await?;
    println!("{} x {} posts, {} m to {} m", terrain.nx, terrain.ny, terrain.min_height, terrain.max_height);

    // Two metres above the ground at two posts.
    let (east, north) = (f64::from(terrain.nx - 1), f64::from(terrain.ny - 1));
    let end = |x, y| v1::SightLineEnd {
        position: Some(v1::Position { x, y, z: 2.0 }),
        frame: v1::CoordinateFrame::Grid.into(),
        altitude: v1::AltitudeReference::AboveGround.into(),
    };
    let (a, b) = (Some(end(0.2 * east, 0.3 * north)), Some(end(0.7 * east, 0.6 * north)));
    let answer = client.query(v1::QueryLineOfSightRequest { a, b, derive: true, ..Default::default() }).await?;
    println!("{} over {:.0} m", answer.verdict().as_str_name(), answer.range_m);
    if let Some(first) = answer.first_from_a {
        println!("obstructed {:.0} m from the observer; {:?} below ground at most", first.range_m, answer.deepest);
    }

    // From one observer to a ring of targets.
    let angles: Vec<f64> = (0..360).map(|n| f64::from(n).to_radians()).collect();
    let lines = v1::QueryLineOfSightBatchRequest {
        frame: v1::CoordinateFrame::Grid.into(),
        altitude: v1::AltitudeReference::AboveGround.into(),
        ax: vec![0.5 * east; angles.len()],
        ay: vec![0.5 * north; angles.len()],
        az: vec![10.0; angles.len()],
        bx: angles.iter().map(|t| east * (0.5 + 0.2 * t.cos())).collect(),
        by: angles.iter().map(|t| north * (0.5 + 0.2 * t.sin())).collect(),
        bz: vec![2.0; angles.len()],
        ..Default::default()
    };
    let answers = client.query_batch(lines).await?;
    let visible = answers.verdicts.iter().filter(|&&v| v == v1::Verdict::Visible).count();
    println!("{visible} of {} targets are visible", answers.verdicts.len());
    Ok(())
}
