//! Which epoch a frame satisfies: a client can tell, and a frame that comes late is right for its own.

use super::*;

/// Where an entity is at an epoch: far enough from where it was before that verdicts turn.
fn place(id: u64, epoch: u64) -> [f64; 2] {
    [(id * 37 + epoch * 211) % 880, (id * 53 + epoch * 173) % 690].map(|tenths| tenths as f64 * 0.1)
}

const LINES: u64 = 24;

/// The lines at an epoch, by the terrain alone: their ends and verdicts.
fn truth(terrain: &TestTerrain, epoch: u64) -> Vec<([[f64; 3]; 2], MeshVerdict)> {
    let end = |id: u64| {
        let [x, y] = place(id, epoch);
        [x, y, los::on_ground(terrain, x, y, 4.0).unwrap().unwrap()]
    };
    let line = |id: u64| {
        let ends = [end(2 * id), end(2 * id + 1)];
        let verdict = los::line_of_sight(terrain, ends[0], ends[1], Options::default()).unwrap().verdict;
        (ends, verdict.on_mesh().unwrap())
    };
    (0..LINES).map(line).collect()
}

/// Checks a view that has just taken a frame against the terrain at the frame's epoch.
fn check(view: &View, frame: &v1::Frame, truth: &[([[f64; 3]; 2], MeshVerdict)]) {
    let scene = view.scene();
    assert_eq!((scene.epoch(), scene.last_frame().epoch), (frame.epoch, frame.epoch));
    assert_eq!(scene.lines().len(), truth.len());
    for (id, (ends, verdict)) in (0..).zip(truth) {
        let stated = &scene.lines()[&id];
        assert_eq!(stated.ends, Some(*ends), "line {id} at epoch {}", frame.epoch);
        let found = verdict_on_mesh(scene.replica(), ends[0], ends[1]);
        assert!(
            found == *verdict || scene.unsatisfied().contains_key(&id),
            "line {id} is {verdict:?} at epoch {} and comes out {found:?}",
            frame.epoch
        );
    }
}

#[tokio::test]
async fn a_late_frame_is_right_for_the_epoch_that_it_names() {
    let terrain = TestTerrain::new(None);
    let running = Running::start(Arc::clone(&terrain), Limits::default()).await;
    let client = running.client().await;
    client.create_exercise("moving").await.unwrap();
    let change = |epoch: u64| v1::ChangeExerciseRequest {
        name: "moving".into(),
        put_entities: (0..2 * LINES).map(|id| entity(id, place(id, epoch)[0], place(id, epoch)[1])).collect(),
        put_sight_lines: (0..LINES).filter(|_| epoch == 1).map(|id| between(id, 2 * id, 2 * id + 1)).collect(),
        ..Default::default()
    };
    assert_eq!(client.change_exercise(change(1)).await.unwrap(), 1);
    let mut view = client.open_view("moving", settings(900), pose(1500.0, 900.0)).await.unwrap();
    let first = frame(&mut view).await;
    check(&view, &first, &truth(&terrain, 1));
    // Nothing is read while the exercise goes on, so what waits is of epochs that are past. How many frames the server
    // makes meanwhile is its own affair: it is tried until some came late whose verdicts are no longer those of the newest.
    let (mut epoch, mut late, mut turned) = (1, 0, 0);
    for _ in 0..40 {
        for _ in 0..4 {
            epoch += 1;
            assert_eq!(client.change_exercise(change(epoch)).await.unwrap(), epoch);
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        let newest = truth(&terrain, epoch);
        let mut last = 0;
        while last < epoch {
            let frame = frame(&mut view).await;
            assert!((last..=epoch).contains(&frame.epoch), "epochs go on, and never beyond what was made");
            last = frame.epoch;
            let then = truth(&terrain, last);
            check(&view, &frame, &then);
            late += usize::from(last < epoch);
            turned += usize::from(then.iter().zip(&newest).any(|(then, now)| then.1 != now.1));
        }
        if turned >= 3 {
            return;
        }
    }
    panic!("{late} late frames, {turned} with other verdicts than the newest");
}
