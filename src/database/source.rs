//! Where the bytes of a database come from: positioned reads, whoever serves them.

use std::{fs::File, io};

/// A file of bytes that any number of threads read at once. Reading past its end is an `UnexpectedEof` error.
pub(super) trait PageSource: Send + Sync {
    /// Bytes in it now.
    fn length(&self) -> io::Result<u64>;

    /// Fills `bytes` from `offset` on.
    fn read_exact_at(&self, bytes: &mut [u8], offset: u64) -> io::Result<()>;
}

/// Positioned reads of an ordinary file.
#[cfg(unix)]
pub(super) struct FileSource(File);

#[cfg(unix)]
impl PageSource for FileSource {
    fn length(&self) -> io::Result<u64> {
        self.0.metadata().map(|m| m.len())
    }

    fn read_exact_at(&self, bytes: &mut [u8], offset: u64) -> io::Result<()> {
        std::os::unix::fs::FileExt::read_exact_at(&self.0, bytes, offset)
    }
}

/// Seeking reads of an ordinary file, one at a time: for systems without positioned ones.
#[cfg(not(unix))]
pub(super) struct FileSource(std::sync::Mutex<File>);

#[cfg(not(unix))]
impl FileSource {
    fn lock(&self) -> std::sync::MutexGuard<'_, File> {
        self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

#[cfg(not(unix))]
impl PageSource for FileSource {
    fn length(&self) -> io::Result<u64> {
        self.lock().metadata().map(|m| m.len())
    }

    fn read_exact_at(&self, bytes: &mut [u8], offset: u64) -> io::Result<()> {
        use std::io::{Read, Seek, SeekFrom};
        let mut file = self.lock();
        file.seek(SeekFrom::Start(offset))?;
        file.read_exact(bytes)
    }
}

impl FileSource {
    /// Writes all of `bytes` from `offset` on, to a file that was opened for it.
    pub(super) fn write_all_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
        #[cfg(unix)]
        return std::os::unix::fs::FileExt::write_all_at(&self.0, bytes, offset);
        #[cfg(not(unix))]
        {
            use std::io::{Seek, SeekFrom, Write};
            let mut file = self.lock();
            file.seek(SeekFrom::Start(offset))?;
            file.write_all(bytes)
        }
    }

    /// A source that reads `file`.
    pub(super) fn new(file: File) -> Self {
        #[cfg(unix)]
        return Self(file);
        #[cfg(not(unix))]
        return Self(std::sync::Mutex::new(file));
    }
}
