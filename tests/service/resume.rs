//! Conformance, part 3 (`clients/README.md`): a view is lost with its server and resumed at the one that follows.

use super::*;
use sightline_client::buffers::MeshBuffers;

#[tokio::test]
async fn a_client_resumes_its_view_when_the_server_was_started_anew() {
    let running = Running::start(TestTerrain::new(None), Limits::default()).await;
    let address = running.address.clone();
    let client = running.client().await;
    exercise(&client, "again", 12).await;
    let mut view = client.open_view("again", settings(400), pose(900.0, 900.0)).await.unwrap();
    frame(&mut view).await;
    view.change_settings(settings(300)).await.unwrap();
    let number = view.steer(pose(1500.0, 900.0)).await.unwrap();
    let before = loop {
        let next = frame(&mut view).await;
        if next.pose_sequence == number {
            break next;
        }
    };
    let verdicts: Vec<_> = view.scene().verdicts().collect();
    assert_eq!(verdicts.len(), 12);
    let mut buffers = MeshBuffers::new(view.scene(), [0.0; 3]);

    running.stop.send(()).unwrap();
    running.done.await.unwrap().unwrap();
    let lost = timeout(PATIENCE, view.next()).await.expect("the loss is noticed");
    assert!(!matches!(lost, Ok(Some(_))), "{lost:?}");
    assert_eq!(view.scene().replica().hash(), before.mesh_hash, "what was received stays");

    let refused = view.resume(Duration::ZERO).await;
    assert!(matches!(refused, Err(ClientError::Refused(_))), "nobody is there: {refused:?}");
    assert_eq!(view.scene().replica().hash(), before.mesh_hash);

    let listener = TcpListener::bind(&address).await.unwrap();
    let served = tokio::spawn(service::serve(listener, TestTerrain::new(None), std::future::pending()));
    refusal(view.resume(PATIENCE).await, Code::NotFound, "'again'");
    assert_eq!(view.scene().replica().hash(), before.mesh_hash, "still");
    exercise(&client, "again", 12).await;
    view.resume(PATIENCE).await.unwrap();
    assert_eq!(view.scene().replica().hash(), before.mesh_hash, "until the first frame");
    let after = frame(&mut view).await;
    let mut fresh = client.open_view("again", settings(300), pose(1500.0, 900.0)).await.unwrap();
    let first = frame(&mut fresh).await;
    assert_eq!((after.base_sequence, after.mesh_hash), (0, first.mesh_hash), "the same inputs, the same mesh");
    assert_eq!(view.scene().verdicts().collect::<Vec<_>>(), verdicts);
    assert!(view.scene().silent_disagreements().is_empty());
    buffers.update(view.scene());
    assert_eq!(buffers.triangles().len(), after.triangle_count as usize);
    let number = view.steer(pose(1400.0, 900.0)).await.unwrap();
    assert_eq!((number, frame(&mut view).await.base_sequence), (1, 1), "it goes on as any other view");
    served.abort();
}
