//! Reading ahead of views that move: one thread that looks at what each of them will need where it will be soon, so that the
//! pages are there when a frame asks for them.
//!
//! It only fills the terrain's cache of pages: no frame, verdict or record depends on it, and what cannot be read is told
//! by whoever needs it. It gives way: between small steps it waits as long as other work waits for a core, and drops a
//! guess that has become too old. A view whose guesses read nothing new is asked less often. It holds one guess a view,
//! the newest.

use std::{
    collections::BTreeMap,
    io,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use super::ServedTerrain;
use crate::roam::Preview;

/// Furthest into the future that can be read ahead, in seconds.
pub const MAX_READ_AHEAD_S: f64 = 10.0;
/// Posts that are looked at before it is asked whether other work waits: some 50 us when all pages are there.
const STEP: usize = 256;
/// How long it waits for other work at a time.
const GIVING_WAY: Duration = Duration::from_millis(1);

/// What reading ahead did.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Ahead {
    /// Guesses looked at to the end.
    pub looks: u64,
    /// Guesses that became too old, or met what cannot be read.
    pub dropped: u64,
    /// Time spent looking, what was given way for included.
    pub took: Duration,
}

/// The thread that reads ahead. It ends when this and all [`Lookout`]s are dropped.
pub struct ReadAhead<T> {
    desk: Arc<Desk<T>>,
}

/// The place of one view.
pub struct Lookout<T> {
    desk: Arc<Desk<T>>,
    number: u64,
}

/// Where guesses are left and taken.
struct Desk<T> {
    /// How far ahead guesses are.
    time: Duration,
    guesses: Mutex<Guesses<T>>,
    /// Told when there is a guess, or no more will come.
    news: Condvar,
    looks: AtomicU64,
    dropped: AtomicU64,
    took_us: AtomicU64,
}

struct Guesses<T> {
    next: u64,
    places: BTreeMap<u64, Place<T>>,
    /// Whether no more places will come.
    is_closed: bool,
}

struct Place<T> {
    /// What to look at, and since when that is so.
    guess: Option<(Instant, Preview<T>)>,
    /// From when on it is asked for another.
    free: Instant,
    rest: Duration,
}

impl<T> Desk<T> {
    // Each change of it is complete before anything can panic.
    fn guesses(&self) -> MutexGuard<'_, Guesses<T>> {
        self.guesses.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The guess whose turn it is, when there is one; `None` when no more will come.
    fn take(&self) -> Option<(u64, Instant, Preview<T>)> {
        let mut guesses = self.guesses();
        loop {
            if guesses.is_closed && guesses.places.is_empty() {
                return None;
            }
            let waiting = guesses.places.iter_mut().filter(|(_, place)| place.guess.is_some());
            let longest = waiting.min_by_key(|(_, place)| place.free);
            if let Some((&number, (since, preview))) = longest.and_then(|(n, place)| Some((n, place.guess.take()?))) {
                return Some((number, since, preview));
            }
            guesses = self.news.wait(guesses).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Lets a view rest: for half the time that guesses are ahead, or twice as long as before where nothing was read.
    fn rest(&self, number: u64, has_read: bool) {
        if let Some(place) = self.guesses().places.get_mut(&number) {
            place.rest = if has_read { self.time / 2 } else { (place.rest * 2).min(self.time * 2) };
            place.free = Instant::now() + place.rest;
        }
    }
}

impl<T: ServedTerrain> ReadAhead<T> {
    /// Starts the thread for views of `terrain`, which looks so far ahead, and gives way while `is_busy`.
    pub fn start(terrain: Arc<T>, time: Duration, is_busy: impl Fn() -> bool + Send + 'static) -> io::Result<Self> {
        let guesses = Guesses { next: 0, places: BTreeMap::new(), is_closed: false };
        let desk = Arc::new(Desk {
            time,
            guesses: Mutex::new(guesses),
            news: Condvar::new(),
            looks: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            took_us: AtomicU64::new(0),
        });
        let own = Arc::clone(&desk);
        let work = move || {
            while let Some((number, since, mut preview)) = own.take() {
                let (began, before) = (Instant::now(), terrain.pages_read());
                let look = || look(&mut preview, since + time, &is_busy);
                // A defect ends one look.
                let done = catch_unwind(AssertUnwindSafe(look)).unwrap_or(false);
                let count = if done { &own.looks } else { &own.dropped };
                count.fetch_add(1, Ordering::Relaxed);
                own.took_us.fetch_add(began.elapsed().as_micros() as u64, Ordering::Relaxed);
                // Others may have read meanwhile: then it looks once more than it must.
                own.rest(number, terrain.pages_read() != before);
            }
        };
        thread::Builder::new().name("read-ahead".into()).spawn(work)?;
        Ok(Self { desk })
    }

    /// A place for a view.
    pub fn lookout(&self) -> Lookout<T> {
        let mut guesses = self.desk.guesses();
        let number = guesses.next;
        guesses.next += 1;
        guesses.places.insert(number, Place { guess: None, free: Instant::now(), rest: self.desk.time / 2 });
        drop(guesses);
        Lookout { desk: Arc::clone(&self.desk), number }
    }

    /// What it did so far.
    pub fn done(&self) -> Ahead {
        let [looks, dropped, took_us] =
            [&self.desk.looks, &self.desk.dropped, &self.desk.took_us].map(|count| count.load(Ordering::Relaxed));
        Ahead { looks, dropped, took: Duration::from_micros(took_us) }
    }
}

impl<T> Lookout<T> {
    /// How far ahead a guess should be.
    pub fn time(&self) -> Duration {
        self.desk.time
    }

    /// Leaves a guess in place of the one before, unless the view rests.
    pub fn tell(&self, guess: impl FnOnce() -> Option<Preview<T>>) {
        let now = Instant::now();
        let is_free = |guesses: &Guesses<T>| guesses.places.get(&self.number).is_some_and(|place| place.free <= now);
        if !is_free(&self.desk.guesses()) {
            return;
        }
        let Some(preview) = guess() else { return };
        let mut guesses = self.desk.guesses();
        // Dropped when the others may go on.
        let _before = guesses.places.get_mut(&self.number).and_then(|place| place.guess.replace((now, preview)));
        drop(guesses);
        self.desk.news.notify_one();
    }
}

impl<T> Drop for ReadAhead<T> {
    fn drop(&mut self) {
        self.desk.guesses().is_closed = true;
        self.desk.news.notify_one();
    }
}

impl<T> Drop for Lookout<T> {
    fn drop(&mut self) {
        // Dropped when the others may go on.
        let _left = self.desk.guesses().places.remove(&self.number);
        self.desk.news.notify_one();
    }
}

/// Looks at a guess until `end`; whether it came to its own end.
fn look<T: ServedTerrain>(preview: &mut Preview<T>, end: Instant, is_busy: &impl Fn() -> bool) -> bool {
    loop {
        while is_busy() {
            thread::sleep(GIVING_WAY);
            if Instant::now() >= end {
                return false;
            }
        }
        match preview.step(STEP) {
            Ok(true) if Instant::now() < end => {}
            Ok(more) => return !more,
            // The view that needs it will be told.
            Err(_) => return false,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::{
        exercise::Site,
        roam::{Target, ViewMesh},
        session::Details,
        terrain::{Grid, HeightField, HeightPage, PageId, ReadError, SceneScale, synthetic},
        view::Camera,
        wedgie::{DiamondBounds, ErrorBounds, MemoryTerrain},
    };
    use sightline_proto::diamond::Post;

    const SCALE: SceneScale = SceneScale { east_m: 20.0, north_m: 30.0, up_m: 1.0 };
    const PATIENCE: Duration = Duration::from_secs(20);

    /// A terrain that counts its pages, and can be broken.
    struct Counted {
        memory: MemoryTerrain,
        read: AtomicU64,
        is_broken: AtomicBool,
    }

    impl HeightField for Counted {
        fn grid(&self) -> Grid {
            self.memory.grid()
        }

        fn page(&self, id: PageId) -> Result<Arc<HeightPage>, ReadError> {
            if self.is_broken.load(Ordering::Relaxed) {
                return Err(ReadError::Damaged { what: "page 3".into(), detail: "on purpose".into() });
            }
            self.read.fetch_add(1, Ordering::Relaxed);
            self.memory.page(id)
        }
    }

    impl ErrorBounds for Counted {
        fn bounds(&self, p: Post) -> Result<DiamondBounds, ReadError> {
            self.memory.bounds(p)
        }
    }

    impl ServedTerrain for Counted {
        fn site(&self) -> Site {
            self.memory.site()
        }

        fn details(&self) -> Result<Details, ReadError> {
            self.memory.details()
        }

        fn pages_read(&self) -> Option<u64> {
            Some(self.read.load(Ordering::Relaxed))
        }
    }

    fn counted() -> Arc<Counted> {
        let memory = MemoryTerrain::new(synthetic::fractal(90, 70, 11, 1500).unwrap(), SCALE).unwrap();
        Arc::new(Counted { memory, read: AtomicU64::new(0), is_broken: AtomicBool::new(false) })
    }

    /// What a view of all of it would read.
    fn guess(terrain: &Arc<Counted>) -> Preview<Counted> {
        let mut mesh = ViewMesh::new(Arc::clone(terrain), SCALE).unwrap();
        mesh.update(&Camera::everywhere(), Target::TriangleBudget(2_000), &[]).unwrap();
        mesh.preview(Camera::everywhere())
    }

    #[track_caller]
    fn becomes(what: impl Fn() -> bool) {
        let began = Instant::now();
        while !what() {
            assert!(began.elapsed() < PATIENCE);
            thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn a_guess_is_read_for_and_its_view_rests() {
        let terrain = counted();
        let preview = guess(&terrain);
        let before = terrain.pages_read();
        let ahead = ReadAhead::start(Arc::clone(&terrain), Duration::from_secs(100), || false).unwrap();
        let (first, second) = (ahead.lookout(), ahead.lookout());
        first.tell(|| Some(preview));
        becomes(|| ahead.done().looks == 1);
        assert!(terrain.pages_read() > before);
        becomes(|| ahead.desk.guesses().places[&first.number].free > Instant::now());
        first.tell(|| panic!("it rests"));
        second.tell(|| Some(guess(&terrain)));
        becomes(|| ahead.done().looks == 2);
        assert_eq!(ahead.done().dropped, 0);
        drop((ahead, first, second));
        // The thread had the only other one.
        becomes(|| Arc::strong_count(&terrain) == 1);
    }

    #[test]
    fn it_gives_way_and_drops_what_is_too_old() {
        let terrain = counted();
        let preview = guess(&terrain);
        let before = terrain.pages_read();
        let is_busy = Arc::new(AtomicBool::new(true));
        let flag = Arc::clone(&is_busy);
        let time = Duration::from_millis(20);
        let ahead = ReadAhead::start(Arc::clone(&terrain), time, move || flag.load(Ordering::Relaxed)).unwrap();
        let view = ahead.lookout();
        view.tell(|| Some(preview));
        becomes(|| ahead.done().dropped == 1);
        assert_eq!(terrain.pages_read(), before, "nothing is read meanwhile");
        is_busy.store(false, Ordering::Relaxed);
        becomes(|| {
            view.tell(|| Some(guess(&terrain)));
            ahead.done().looks > 0
        });
    }

    #[test]
    fn what_cannot_be_read_ends_one_look() {
        let terrain = counted();
        let previews = [guess(&terrain), guess(&terrain)];
        let ahead = ReadAhead::start(Arc::clone(&terrain), Duration::from_secs(100), || false).unwrap();
        terrain.is_broken.store(true, Ordering::Relaxed);
        let views = previews.map(|preview| {
            let view = ahead.lookout();
            view.tell(|| Some(preview));
            view
        });
        becomes(|| ahead.done().dropped == 2);
        assert_eq!(ahead.done().looks, 0);
        drop(views);
        assert!(ahead.desk.guesses().places.is_empty(), "a view that goes leaves nothing");
    }
}
