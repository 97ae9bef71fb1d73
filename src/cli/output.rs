//! Where the result of a verb goes: a file that is complete or not there, or standard output.

use std::{
    fs::{self, File},
    io::{BufWriter, Cursor, Read, Seek, Write},
    path::{Path, PathBuf},
};

use super::{Context, Failure, args};

/// Something that can be written to and gone back in.
pub(super) trait WriteSeek: Write + Seek {}

impl<T: Write + Seek> WriteSeek for T {}

/// A place for one result.
#[derive(Clone, Debug)]
pub(super) struct Output {
    path: PathBuf,
}

impl Output {
    /// Refuses what cannot be, before any work is done: a file that exists, without `force`; two documents on standard
    /// output.
    pub(super) fn new(context: &Context, path: &Path, force: bool) -> Result<Self, Failure> {
        let output = Self { path: path.into() };
        if output.is_standard() && context.json {
            return Err(Failure::Usage("--json and -o - both want standard output: name a file for one".into()));
        }
        if !output.is_standard() {
            args::refuse_existing(path, force)?;
        }
        Ok(output)
    }

    pub(super) fn is_standard(&self) -> bool {
        self.path.as_os_str() == "-"
    }

    /// The end of the name, in small letters; `None` for standard output and for a name without one.
    pub(super) fn extension(&self) -> Option<String> {
        Some(self.path.extension()?.to_str()?.to_ascii_lowercase())
    }

    /// Hands `write` a place to write to. A file appears under its name only when that ends well.
    pub(super) fn write(&self, write: impl FnOnce(&mut dyn WriteSeek) -> Result<(), Failure>) -> Result<(), Failure> {
        if self.is_standard() {
            let mut whole = Cursor::new(Vec::new());
            write(&mut whole)?;
            let written = std::io::stdout().lock().write_all(whole.get_ref());
            return written.map_err(|error| Failure::environment("standard output", error));
        }
        let failure = |error: std::io::Error| Failure::environment(format!("writing {}", self.path.display()), error);
        let mut name = self.path.file_name().unwrap_or_default().to_owned();
        name.push(".partial");
        let partial = self.path.with_file_name(name);
        let mut file = BufWriter::new(File::create(&partial).map_err(failure)?);
        let done = write(&mut file).and_then(|()| file.flush().map_err(failure));
        drop(file);
        let done = done.and_then(|()| fs::rename(&partial, &self.path).map_err(failure));
        if done.is_err() {
            // What is incomplete is of no use; that it could not be removed says no more than the failure.
            let _ = fs::remove_file(&partial);
        }
        done
    }

    /// Writes a text.
    pub(super) fn text(&self, text: &str) -> Result<(), Failure> {
        self.bytes(text.as_bytes())
    }

    /// Writes bytes.
    pub(super) fn bytes(&self, bytes: &[u8]) -> Result<(), Failure> {
        self.write(|to| to.write_all(bytes).map_err(|e| Failure::environment(self.path.display(), e)))
    }
}

/// Reads a text file, or standard input for -.
pub(super) fn read_text(path: &Path) -> Result<String, Failure> {
    let mut bytes = Vec::new();
    let read = if path.as_os_str() == "-" {
        std::io::stdin().lock().read_to_end(&mut bytes)
    } else {
        File::open(path).and_then(|mut file| file.read_to_end(&mut bytes))
    };
    read.map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => Failure::input(path.display(), error),
        _ => Failure::environment(path.display(), error),
    })?;
    String::from_utf8(bytes).map_err(|_| Failure::input(path.display(), "it is not UTF-8 text"))
}
