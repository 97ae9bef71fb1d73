//! Conformance, part 3 (`clients/README.md`): a view is lost with its server and resumed at the one that follows.

use super::*;

#[tokio::test]
async fn a_client_resumes_its_view_when_the_server_was_started_anew() {
    let running = Running::start(TestTerrain::new(None), Limits::default()).await;
    let address = running.address.clone();
    let client = running.client().await;
    exercise(&client, "again", 12).await;
    let mut view = client.open_view("again", settings(400), pose(1500.0, 900.0)).await.unwrap();
    let before = frame(&mut view).await;
    let verdicts: Vec<_> = view.scene().verdicts().collect();
    assert_eq!((before.base_sequence, verdicts.len()), (0, 12));

    running.stop.send(()).unwrap();
    running.done.await.unwrap().unwrap();
    let lost = timeout(PATIENCE, view.next()).await.expect("the loss is noticed");
    assert!(!matches!(lost, Ok(Some(_))), "{lost:?}");
    assert_eq!(view.scene().replica().hash(), before.mesh_hash, "what was received stays");

    let listener = TcpListener::bind(&address).await.unwrap();
    let served = tokio::spawn(service::serve(listener, TestTerrain::new(None), std::future::pending()));
    exercise(&client, "again", 12).await;
    let mut resumed = client.open_view("again", settings(400), pose(1500.0, 900.0)).await.unwrap();
    let after = frame(&mut resumed).await;
    assert_eq!((after.base_sequence, after.mesh_hash), (0, before.mesh_hash), "the same inputs, the same mesh");
    assert_eq!(resumed.scene().verdicts().collect::<Vec<_>>(), verdicts);
    assert!(resumed.scene().silent_disagreements().is_empty());
    served.abort();
}
