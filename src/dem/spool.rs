//! Bytes that are written once and read again: in memory while they are few, in a nameless file beyond that.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::sync::atomic::{AtomicU32, Ordering};

/// Bytes at hand. Those that were never written are 0.
#[derive(Debug)]
pub(super) struct Spool {
    /// Most bytes that stay in memory.
    most: usize,
    held: Held,
}

#[derive(Debug)]
enum Held {
    Memory(Vec<u8>),
    File(File),
}

impl Spool {
    /// Nothing yet; up to `most` bytes will stay in memory.
    pub(super) fn new(most: usize) -> Self {
        Self { most, held: Held::Memory(Vec::new()) }
    }

    /// Bytes that are in memory already.
    pub(super) fn of(bytes: Vec<u8>) -> Self {
        Self { most: bytes.len(), held: Held::Memory(bytes) }
    }

    /// Most bytes that stay in memory.
    pub(super) fn most(&self) -> u64 {
        self.most as u64
    }

    /// Lets no more than `most` bytes stay in memory.
    pub(super) fn limit(&mut self, most: usize) -> io::Result<()> {
        self.most = most;
        match &self.held {
            Held::Memory(held) if held.len() > most => self.leave_memory(),
            _ => Ok(()),
        }
    }

    fn leave_memory(&mut self) -> io::Result<()> {
        if let Held::Memory(held) = &self.held {
            let mut file = nameless()?;
            file.write_all(held)?;
            self.held = Held::File(file);
        }
        Ok(())
    }

    /// Writes `bytes` at byte `at`.
    pub(super) fn write_at(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        let end = at + bytes.len() as u64;
        if let Held::Memory(held) = &mut self.held
            && end <= self.most as u64
        {
            let (at, end) = (at as usize, end as usize);
            if end > held.len() {
                // By halves, but never beyond what may stay.
                let more = (held.len() / 2).max(end - held.len()).min(self.most - held.len());
                held.reserve_exact(more);
                held.resize(end, 0);
            }
            held[at..end].copy_from_slice(bytes);
            return Ok(());
        }
        self.leave_memory()?;
        let Held::File(file) = &mut self.held else { return Ok(()) };
        file.seek(SeekFrom::Start(at))?;
        file.write_all(bytes)
    }

    /// Byte `at` and those behind it: as many as there are room for in `room`, where they are put when they are in a file.
    pub(super) fn read_at<'a>(&'a mut self, at: u64, room: &'a mut [u8]) -> io::Result<&'a [u8]> {
        let read = match &mut self.held {
            Held::Memory(held) => {
                let start = usize::try_from(at).unwrap_or(usize::MAX).min(held.len());
                if held.len() - start >= room.len() {
                    return Ok(&held[start..][..room.len()]);
                }
                let there = &held[start..];
                room[..there.len()].copy_from_slice(there);
                there.len()
            }
            Held::File(file) => {
                file.seek(SeekFrom::Start(at))?;
                read_as_far_as_it_goes(file, room)?
            }
        };
        room[read..].fill(0);
        Ok(room)
    }

    /// Bytes that are in memory.
    #[cfg(test)]
    fn in_memory(&self) -> usize {
        match &self.held {
            Held::Memory(held) => held.capacity(),
            Held::File(_) => 0,
        }
    }
}

fn read_as_far_as_it_goes(file: &mut File, room: &mut [u8]) -> io::Result<usize> {
    let mut read = 0;
    while read < room.len() {
        match file.read(&mut room[read..]) {
            Ok(0) => break,
            Ok(more) => read += more,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(read)
}

/// A file, in the folder for temporary ones, that is gone when it is closed.
pub(super) fn nameless() -> io::Result<File> {
    static MADE: AtomicU32 = AtomicU32::new(0);
    let number = MADE.fetch_add(1, Ordering::Relaxed);
    let path = std::env::temp_dir().join(format!("sightline-{}-{number}.part", std::process::id()));
    let file = File::options().read(true).write(true).create_new(true).open(&path)?;
    std::fs::remove_file(&path)?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_come_back_from_memory_and_from_a_file() {
        for most in [0, 7, 100, 1000] {
            let mut spool = Spool::new(most);
            let mut expected = vec![0; 300];
            for (at, length) in [(0, 5), (3, 4), (90, 30), (20, 1), (250, 10)] {
                let bytes: Vec<u8> = (0..length as u8).map(|n| n ^ at as u8 | 1).collect();
                spool.write_at(at as u64, &bytes).unwrap();
                expected[at..][..length].copy_from_slice(&bytes);
                assert!(spool.in_memory() <= most);
            }
            assert_eq!(spool.in_memory() > 0, most == 1000);
            let mut lowered = Spool::of(expected.clone());
            lowered.limit(most).unwrap();
            assert_eq!(lowered.in_memory() > 0, most == 1000);
            assert_eq!(lowered.read_at(0, &mut [0; 300]).unwrap(), expected);
            for (at, length) in [(0, 300), (0, 1), (100, 160), (255, 40), (290, 10), (10, 0)] {
                let mut room = vec![9; length];
                assert_eq!(spool.read_at(at as u64, &mut room).unwrap(), &expected[at..][..length], "{most} {at}");
            }
        }
    }
}
