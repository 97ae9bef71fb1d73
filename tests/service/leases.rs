//! Leases and watches of verdicts, by a clock that stands until the test moves it.

use std::path::Path;

use sightline::{
    exercise::Exercise,
    service::Clock,
    store::{DiskStore, ExerciseStore, MemoryStore, StoreError, Stored},
};
use sightline_client::ExerciseWatch;
use tonic_health::ServingStatus;

use super::*;

const SECOND: Duration = Duration::from_secs(1);

async fn with_clock(store: Box<dyn ExerciseStore>) -> (Running, Client, Clock) {
    let clock = Clock::standing();
    let options = ServeOptions { clock: clock.clone(), store, ..ServeOptions::default() };
    let running = Running::start_with(TestTerrain::new(None), options).await;
    let client = running.client().await;
    (running, client, clock)
}

fn lease(owner: &str, term_s: u32) -> v1::Lease {
    v1::Lease { owner: owner.into(), term_s }
}

async fn watch(client: &Client, name: &str, owner: &str) -> ExerciseWatch {
    let (name, lease_owner) = (name.to_owned(), owner.to_owned());
    client.watch_exercise(v1::WatchExerciseRequest { name, lease_owner, ..Default::default() }).await.unwrap()
}

async fn news(watch: &mut ExerciseWatch) -> v1::WatchExerciseResponse {
    timeout(PATIENCE, watch.next()).await.expect("news in time").unwrap().expect("an open watch")
}

async fn the_lease(client: &Client, name: &str) -> v1::LeaseState {
    client.exercise(name).await.unwrap().leases.swap_remove(0)
}

/// Waits until so many streams hold the first lease.
async fn held_by(client: &Client, name: &str, streams: u32) {
    let waiting = async {
        while the_lease(client, name).await.streams != streams {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(PATIENCE, waiting).await.expect("a lease held by as many streams");
}

#[tokio::test]
async fn an_exercise_goes_with_its_lease_and_whoever_watches_is_told() {
    let (_running, client, clock) = with_clock(Box::<MemoryStore>::default()).await;
    client.create_exercise("forever").await.unwrap();
    client.create_exercise_under("brief", lease("page", 60)).await.unwrap();
    let open = v1::OpenView {
        exercise: "brief".into(),
        settings: Some(settings(300)),
        pose: Some(pose(0.0, 0.0)),
        lease_owner: "page".into(),
        ..Default::default()
    };
    let owner = client.open(open).await.unwrap();
    let mut stranger = client.open_view("brief", settings(300), pose(0.0, 0.0)).await.unwrap();
    frame(&mut stranger).await;
    // The view of the owner holds it, that of a stranger does not.
    held_by(&client, "brief", 1).await;
    clock.advance(1_000 * SECOND);
    drop(owner);
    held_by(&client, "brief", 0).await;
    clock.advance(50 * SECOND);
    let state = the_lease(&client, "brief").await;
    assert_eq!((state.remaining_s, state.term_s, state.holds_exercise), (10.0, 60, true));
    assert_eq!(client.renew_lease("brief", "page").await.unwrap(), 60);
    clock.advance(50 * SECOND);
    assert_eq!(the_lease(&client, "brief").await.remaining_s, 10.0);
    let mut watch = watch(&client, "brief", "").await;
    assert_eq!(news(&mut watch).await, v1::WatchExerciseResponse::default());

    clock.advance(10 * SECOND);
    let end = timeout(PATIENCE, watch.next()).await.expect("the end is told");
    refusal(end, Code::NotFound, "exercise 'brief' has ended: the lease of 'page' has run out");
    let end = timeout(PATIENCE, stranger.next()).await.expect("the end is told");
    refusal(end, Code::NotFound, "the lease of 'page' has run out");
    refusal(client.exercise("brief").await, Code::NotFound, "'brief'");
    refusal(client.renew_lease("brief", "page").await, Code::NotFound, "'brief'");
    assert_eq!(client.list_exercises().await.unwrap().len(), 1);
    // The name is free, and another exercise of that name another one.
    client.create_exercise_under("brief", lease("page", 60)).await.unwrap();
    assert_eq!(the_lease(&client, "brief").await.remaining_s, 60.0);
    for (owner, term_s, words) in
        [("", 60, "own a lease"), ("page", 0, "from 1 to 604800"), ("page", 700_000, "700000")]
    {
        refusal(client.create_exercise_under("bad", lease(owner, term_s)).await, Code::InvalidArgument, words);
    }
}

#[tokio::test]
async fn things_go_with_the_lease_of_who_put_them_in_one_epoch() {
    let (_running, client, clock) = with_clock(Box::<MemoryStore>::default()).await;
    client.create_exercise("shared").await.unwrap();
    let put = |owner: &str, term_s: u32, ids: [u64; 2], line: u64| v1::ChangeExerciseRequest {
        name: "shared".into(),
        put_entities: ids.iter().map(|&id| entity(id, 5.0 + 4.0 * id as f64, 9.0 + id as f64)).collect(),
        put_sight_lines: vec![between(line, ids[0], ids[1])],
        lease: Some(lease(owner, term_s)),
        ..Default::default()
    };
    client.change_exercise(put("a", 100, [1, 2], 10)).await.unwrap();
    client.change_exercise(put("b", 60, [3, 4], 20)).await.unwrap();
    // A line of a to an entity of b.
    let across = v1::ChangeExerciseRequest {
        name: "shared".into(),
        put_sight_lines: vec![between(11, 1, 3), between(12, 1, 2)],
        lease: Some(lease("a", 100)),
        ..Default::default()
    };
    client.change_exercise(across).await.unwrap();
    let mut watch = watch(&client, "shared", "a").await;
    let told = news(&mut watch).await;
    let ids: Vec<u64> = told.changed.iter().map(|line| line.id).collect();
    assert_eq!((told.epoch, ids, told.removed, told.expired_owners), (3, vec![10, 11, 12, 20], vec![], vec![]));
    let mut view = client.open_view("shared", settings(300), pose(0.0, 0.0)).await.unwrap();
    frame(&mut view).await;

    clock.advance(61 * SECOND);
    let told = news(&mut watch).await;
    assert_eq!((told.epoch, told.removed, told.expired_owners), (4, vec![11, 20], vec!["b".to_owned()]));
    assert_eq!(told.changed, []);
    while view.scene().epoch() < 4 {
        frame(&mut view).await;
    }
    assert_eq!(view.scene().lines().keys().copied().collect::<Vec<_>>(), [10, 12]);
    let left = client.exercise("shared").await.unwrap();
    assert_eq!(left.entities.iter().map(|entity| entity.id).collect::<Vec<_>>(), [1, 2]);
    assert_eq!(left.leases.len(), 1);
    // What somebody puts without a lease stays.
    let kept = v1::ChangeExerciseRequest {
        name: "shared".into(),
        put_entities: vec![entity(1, 9.0, 9.0), entity(2, 40.0, 9.0)],
        put_sight_lines: vec![between(12, 1, 2)],
        ..Default::default()
    };
    client.change_exercise(kept).await.unwrap();
    held_by(&client, "shared", 1).await;
    drop(watch);
    held_by(&client, "shared", 0).await;
    let mut watch = self::watch(&client, "shared", "").await;
    news(&mut watch).await;
    clock.advance(101 * SECOND);
    let told = news(&mut watch).await;
    assert_eq!((told.epoch, told.removed, told.expired_owners), (6, vec![10], vec!["a".to_owned()]));
    let left = client.exercise("shared").await.unwrap();
    assert_eq!((left.entities.len(), left.sight_lines.len(), left.leases.len()), (2, 1, 0));
    refusal(client.renew_lease("shared", "a").await, Code::NotFound, "'a'");
}

fn disk(path: &Path) -> Box<DiskStore> {
    let terrain = TestTerrain::new(None);
    Box::new(DiskStore::open(path, b"terrain", &terrain.site(), &*terrain).unwrap())
}

#[tokio::test]
async fn a_server_that_is_started_anew_gives_leases_their_full_term() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("state");
    let (running, client, clock) = with_clock(disk(&path)).await;
    client.create_exercise_under("brief", lease("page", 60)).await.unwrap();
    clock.advance(50 * SECOND);
    assert_eq!(the_lease(&client, "brief").await.remaining_s, 10.0);
    running.stop.send(()).unwrap();
    running.done.await.unwrap().unwrap();
    drop(client);

    let (running, client, clock) = with_clock(disk(&path)).await;
    let mut watch = watch(&client, "brief", "").await;
    news(&mut watch).await;
    let known = async {
        while the_lease(&client, "brief").await.remaining_s < 60.0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(PATIENCE, known).await.expect("the full term");
    clock.advance(59 * SECOND);
    assert_eq!(the_lease(&client, "brief").await.remaining_s, 1.0);
    clock.advance(SECOND);
    let end = timeout(PATIENCE, watch.next()).await.expect("the end is told");
    refusal(end, Code::NotFound, "the lease of 'page' has run out");
    running.stop.send(()).unwrap();
    running.done.await.unwrap().unwrap();
    assert!(disk(&path).list().unwrap().is_empty(), "it is gone from the file, too");
}

/// A store whose disk may be full.
struct Full {
    memory: MemoryStore,
    is_full: Arc<AtomicBool>,
}

impl Full {
    fn room(&self) -> Result<(), StoreError> {
        if self.is_full.load(Ordering::Relaxed) { Err(StoreError::Failed("no space is left".into())) } else { Ok(()) }
    }
}

impl ExerciseStore for Full {
    fn create(&self, exercise: Exercise) -> Result<Stored, StoreError> {
        self.room().and_then(|()| self.memory.create(exercise))
    }

    fn list(&self) -> Result<Vec<Stored>, StoreError> {
        self.memory.list()
    }

    fn get(&self, name: &str) -> Result<Stored, StoreError> {
        self.memory.get(name)
    }

    fn replace(&self, revision: u64, exercise: Exercise) -> Result<Stored, StoreError> {
        self.room().and_then(|()| self.memory.replace(revision, exercise))
    }

    fn delete(&self, name: &str) -> Result<(), StoreError> {
        self.room().and_then(|()| self.memory.delete(name))
    }

    fn probe(&self) -> Result<(), StoreError> {
        self.room()
    }
}

#[tokio::test]
async fn a_store_that_cannot_be_written_is_told_by_health_and_its_leases_wait() {
    let is_full = Arc::new(AtomicBool::new(false));
    let store = Full { memory: MemoryStore::default(), is_full: Arc::clone(&is_full) };
    let (running, client, clock) = with_clock(Box::new(store)).await;
    exercise(&client, "kept", 2).await;
    client.create_exercise_under("brief", lease("page", 60)).await.unwrap();
    health(&running, ServingStatus::Serving).await;
    is_full.store(true, Ordering::Relaxed);
    let change = v1::ChangeExerciseRequest { name: "kept".into(), ..Default::default() };
    refusal(client.change_exercise(change.clone()).await, Code::Unavailable, "no space is left");
    health(&running, ServingStatus::NotServing).await;
    let status = client.status().await.unwrap();
    assert!(!status.serving && status.troubles[0].contains("cannot be written"), "{status:?}");
    assert_eq!(client.exercise("kept").await.unwrap().epoch, 1, "what is there can be read");
    let mut watch = watch(&client, "brief", "").await;
    news(&mut watch).await;
    clock.advance(100 * SECOND);
    assert_eq!(the_lease(&client, "brief").await.remaining_s, 0.0);
    is_full.store(false, Ordering::Relaxed);
    health(&running, ServingStatus::Serving).await;
    let end = timeout(PATIENCE, watch.next()).await.expect("the end is told");
    refusal(end, Code::NotFound, "the lease of 'page' has run out");
    assert_eq!(client.change_exercise(change).await.unwrap(), 2);
}

/// Whoever does not read is told the newest state afterwards, not what was in between.
#[tokio::test]
async fn a_slow_reader_of_verdicts_is_told_the_newest() {
    const LINES: u64 = 60;
    const EPOCHS: u64 = 120;
    let (running, client) = started().await;
    exercise(&client, "fast", LINES).await;
    // A window of 4 kB holds some news only.
    let endpoint = tonic::transport::Endpoint::from_shared(format!("http://{}", running.address)).unwrap();
    let channel = endpoint.initial_stream_window_size(4_096).connect().await.unwrap();
    let mut exercises = v1::exercise_service_client::ExerciseServiceClient::new(channel);
    let request = v1::WatchExerciseRequest { name: "fast".into(), ..Default::default() };
    let mut slow = exercises.watch_exercise(request).await.unwrap().into_inner();
    for epoch in 2..=EPOCHS {
        let place = |id: u64| {
            let [x, y] = [id * 37 + epoch * 211, id * 53 + epoch * 173];
            entity(id, (x % 880) as f64 * 0.1, (y % 690) as f64 * 0.1)
        };
        let change = v1::ChangeExerciseRequest {
            name: "fast".into(),
            put_entities: (0..2 * LINES).map(place).collect(),
            ..Default::default()
        };
        assert_eq!(client.change_exercise(change).await.unwrap(), epoch);
    }
    let truth = client.exercise("fast").await.unwrap().sight_lines;
    let (mut known, mut messages, mut epoch) = (std::collections::BTreeMap::new(), 0, 0);
    while truth.iter().any(|line| known.get(&line.id) != Some(&line.verdict)) {
        let told = timeout(PATIENCE, slow.message()).await.expect("news in time").unwrap().unwrap();
        assert!(told.epoch > epoch && told.epoch <= EPOCHS);
        epoch = told.epoch;
        known.extend(told.changed.iter().map(|line| (line.id, line.verdict)));
        messages += 1;
    }
    assert!(messages < EPOCHS / 2, "{messages} messages of {EPOCHS} epochs");
}

#[tokio::test]
async fn watches_that_make_no_sense_are_refused_and_deleting_ends_those_that_do() {
    let limits = Limits { verdict_watches_per_client: 1, ..Limits::default() };
    let running = Running::start(TestTerrain::new(None), limits).await;
    let client = running.client().await;
    let request =
        |name: &str, sight_lines| v1::WatchExerciseRequest { name: name.into(), sight_lines, ..Default::default() };
    refusal(client.watch_exercise(request("none", vec![])).await, Code::NotFound, "'none'");
    refusal(client.watch_exercise(request("", vec![])).await, Code::InvalidArgument, "missing");
    exercise(&client, "one", 3).await;
    let many = request("one", vec![7; 20_001]);
    refusal(client.watch_exercise(many).await, Code::ResourceExhausted, "20000");
    let mut watch = client.watch_exercise(request("one", vec![2, 99])).await.unwrap();
    assert_eq!(news(&mut watch).await.changed.iter().map(|line| line.id).collect::<Vec<_>>(), [2]);
    let second = client.watch_exercise(request("one", vec![])).await;
    refusal(second, Code::ResourceExhausted, "limits.verdict_watches_per_client");
    client.delete_exercise("one").await.unwrap();
    let end = timeout(PATIENCE, watch.next()).await.expect("the end is told");
    refusal(end, Code::NotFound, "exercise 'one' has ended");
    // Its place is free, and so is that of one that its reader has dropped.
    exercise(&client, "two", 3).await;
    for _ in 0..2 {
        let free = async {
            loop {
                match client.watch_exercise(request("two", vec![])).await {
                    Ok(mut watch) => return drop(news(&mut watch).await),
                    Err(_) => tokio::time::sleep(Duration::from_millis(5)).await,
                }
            }
        };
        timeout(PATIENCE, free).await.expect("a free place");
    }
}
