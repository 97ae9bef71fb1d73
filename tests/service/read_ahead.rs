//! Reading ahead of views: it happens, and no frame knows of it.

use super::{port::get, *};

/// The frames of a flight, and how often it was read ahead of it.
async fn fly(read_ahead: Duration) -> (Vec<v1::Frame>, u64) {
    let options = ServeOptions { read_ahead, ..ServeOptions::default() };
    let running = Running::start_with(TestTerrain::new(None), options).await;
    let client = running.client().await;
    let mut view = client.open_view("", settings(700), pose(300.0, 300.0)).await.unwrap();
    let mut frames = vec![frame(&mut view).await];
    for step in 1..40_u32 {
        let wanted = view.steer(pose(300.0 + 20.0 * f64::from(step), 300.0)).await.unwrap();
        let made = frame(&mut view).await;
        assert_eq!(made.pose_sequence, wanted);
        frames.push(made);
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    let (_, page) = get(&running.address, "/metrics").await;
    let looks = page.lines().find_map(|line| line.strip_prefix("sightline_looks_ahead_total "));
    (frames, looks.unwrap_or_else(|| panic!("no such metric in {page}")).parse().unwrap())
}

#[tokio::test]
async fn frames_are_the_same_with_and_without() {
    let (with, looks) = fly(Duration::from_millis(20)).await;
    let (without, none) = fly(Duration::ZERO).await;
    assert!(looks > 0 && none == 0, "{looks}, {none}");
    assert_eq!(with, without);
}
