//! Pages of a database in the making: in a nameless file beside it, as many as memory allows at hand.
//!
//! Pages come in the order in which they are made, from any thread, and lie end to end. Whoever puts one keeps its
//! [`Entry`], which is what a directory says of it, but for the offset, which is in this file. Each is held against its
//! checksum when it is read back. The file has no name from the start where the system allows that, so nothing is left
//! of it when the program is killed.

use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use xxhash_rust::xxh3::xxh3_64;

use super::{
    cache::Cache,
    directory::Entry,
    error::WriteError,
    format::Element,
    layout::Paging,
    pages::{self, BoundsPage},
    source::{FileSource, PageSource},
};
use crate::{
    terrain::{HeightPage, PageId, ReadError, Samples},
    wedgie::DiamondBounds,
};

/// The bit of an entry's flags that says, in a scratch file only, that heights have 32 bits.
const IS_WIDE: u32 = 1 << 31;

/// A page at hand.
#[derive(Clone)]
enum Held {
    Heights(Arc<HeightPage>),
    Bounds(Arc<BoundsPage>),
}

/// The file.
pub(super) struct Scratch {
    path: PathBuf,
    file: FileSource,
    end: AtomicU64,
    cache: Cache<Held>,
}

impl Scratch {
    /// An empty file beside `path`, with room for about `cache_bytes` of pages at hand.
    pub(super) fn beside(path: &Path, cache_bytes: usize) -> Result<Self, WriteError> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let path = path.with_file_name(format!(".{name}.{}.pages", std::process::id()));
        let open = File::options().read(true).write(true).create(true).truncate(true).open(&path);
        let file = open.map_err(|error| WriteError::Io { path: path.clone(), error })?;
        #[cfg(unix)]
        let _ = fs::remove_file(&path);
        Ok(Self { path, file: FileSource::new(file), end: AtomicU64::new(0), cache: Cache::new(cache_bytes) })
    }

    /// Appends the bytes of a page.
    fn put(&self, (bytes, flags): (Vec<u8>, u32)) -> Result<Entry, WriteError> {
        let offset = self.end.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        let written = self.file.write_all_at(&bytes, offset);
        written.map_err(|error| WriteError::Io { path: self.path.clone(), error })?;
        Ok(Entry { offset, checksum: xxh3_64(&bytes), length: bytes.len() as u32, flags })
    }

    /// The bytes of a page.
    fn get(&self, entry: &Entry) -> Result<Vec<u8>, ReadError> {
        let failed = |detail: String| ReadError::Io { what: self.path.display().to_string(), detail };
        let mut bytes = vec![0; entry.length as usize];
        self.file.read_exact_at(&mut bytes, entry.offset).map_err(|e: io::Error| failed(e.to_string()))?;
        if xxh3_64(&bytes) != entry.checksum {
            return Err(failed("the disk gives other bytes than were written to it".into()));
        }
        Ok(bytes)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        #[cfg(not(unix))]
        let _ = fs::remove_file(&self.path);
    }
}

/// The pages of a section in a scratch file.
pub(super) struct Shelf<'a> {
    scratch: &'a Scratch,
    /// Tells its pages from those of others in the cache.
    number: u8,
    pub(super) paging: Paging,
    /// Row by row from the south.
    entries: Vec<Entry>,
}

impl<'a> Shelf<'a> {
    /// A shelf without pages as yet; no other has its `number`.
    pub(super) fn new(scratch: &'a Scratch, number: u8, paging: Paging) -> Self {
        Self { scratch, number, paging, entries: vec![Entry::default(); paging.pages() as usize] }
    }

    fn key(&self, id: PageId) -> u64 {
        u64::from(self.number) << 56 | u64::from(id.pj) << 25 | u64::from(id.pi)
    }

    fn index(&self, id: PageId) -> usize {
        id.pj as usize * self.paging.columns_rows().0 as usize + id.pi as usize
    }

    pub(super) fn entry(&self, id: PageId) -> &Entry {
        &self.entries[self.index(id)]
    }

    /// Bytes of all its pages.
    pub(super) fn stored_bytes(&self) -> u64 {
        self.entries.iter().map(|entry| u64::from(entry.length)).sum()
    }

    /// Remembers where page `id` is.
    pub(super) fn set(&mut self, id: PageId, entry: Entry) {
        let n = self.index(id);
        self.entries[n] = entry;
    }

    /// Puts the bytes of a page and its flags into the file.
    pub(super) fn put(&self, bytes_and_flags: (Vec<u8>, u32)) -> Result<Entry, WriteError> {
        self.scratch.put(bytes_and_flags)
    }

    /// The bytes of page `id`.
    pub(super) fn bytes(&self, id: PageId) -> Result<Vec<u8>, ReadError> {
        self.scratch.get(self.entry(id))
    }

    /// Puts a page of integer heights into the file, in as few bits as they need, and keeps it at hand.
    pub(super) fn put_heights(&self, id: PageId, page: HeightPage) -> Result<Entry, WriteError> {
        let element = match page.samples() {
            Samples::I16(_) => Element::I16,
            _ => Element::I32,
        };
        let encoded = pages::encode_heights(&page, element, self.paging.size(id));
        let (bytes, flags) = encoded.ok_or_else(|| WriteError::Description("heights are no integers".into()))?;
        let entry = self.scratch.put((bytes, flags | if element == Element::I32 { IS_WIDE } else { 0 }))?;
        let weight = pages::heights_weight(&page);
        self.scratch.cache.replace(self.key(id), Held::Heights(Arc::new(page)), weight);
        Ok(entry)
    }

    /// The page of heights `id`.
    pub(super) fn heights(&self, id: PageId) -> Result<Arc<HeightPage>, ReadError> {
        let key = self.key(id);
        if let Some(Held::Heights(page)) = self.scratch.cache.get(key) {
            return Ok(page);
        }
        let (element, flags) = heights_format(self.entry(id));
        let page = pages::decode_heights(&self.bytes(id)?, element, self.paging.size(id), flags)
            .map_err(|e| self.unreadable(e))?;
        let page = Arc::new(page);
        self.scratch.cache.insert(key, Held::Heights(Arc::clone(&page)), pages::heights_weight(&page));
        Ok(page)
    }

    /// Puts a page of bounds, three for each quad of the page, and the heights of their posts into the file, and keeps it at
    /// hand.
    pub(super) fn put_bounds(
        &self,
        id: PageId,
        diamonds: Vec<DiamondBounds>,
        heights: Vec<i32>,
        element: Element,
    ) -> Result<Entry, WriteError> {
        let encoded = pages::encode_bounds(&diamonds, &heights, element).map_err(WriteError::Description)?;
        let entry = self.scratch.put(encoded)?;
        // Whoever reads it back asks for bounds only.
        let page = BoundsPage::new(self.paging.size(id).0, diamonds, Vec::new());
        let weight = page.weight();
        self.scratch.cache.insert(self.key(id), Held::Bounds(Arc::new(page)), weight);
        Ok(entry)
    }

    /// The page of bounds `id`, which was put as `element`.
    pub(super) fn bounds(&self, id: PageId, element: Element) -> Result<Arc<BoundsPage>, ReadError> {
        let key = self.key(id);
        if let Some(Held::Bounds(page)) = self.scratch.cache.get(key) {
            return Ok(page);
        }
        let (bytes, flags, size) = (self.bytes(id)?, self.entry(id).flags, self.paging.size(id));
        let page = pages::decode_bounds(&bytes, element, size, flags).map_err(|e| self.unreadable(e))?;
        let page = Arc::new(page);
        self.scratch.cache.insert(key, Held::Bounds(Arc::clone(&page)), page.weight());
        Ok(page)
    }

    fn unreadable(&self, detail: String) -> ReadError {
        ReadError::Io { what: self.scratch.path.display().to_string(), detail }
    }
}

/// The element of a page of heights on a shelf, and its flags as a database has them.
pub(super) fn heights_format(entry: &Entry) -> (Element, u32) {
    let element = if entry.flags & IS_WIDE == 0 { Element::I16 } else { Element::I32 };
    (element, entry.flags & !IS_WIDE)
}
