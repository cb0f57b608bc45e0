//! Where a recording goes: a file or a pipe, written in large pieces.

use super::RecordingError;
use super::disk::Disk;
use super::part::write_error;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::fd::AsFd;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes gathered before they are written: MCAP's index records come in pieces of a few bytes.
const BUFFER: usize = 64 << 10;

/// Where a recording goes.
pub enum Target {
    /// A file. A device or named pipe at this path is written to as it is.
    File {
        /// Its path.
        path: PathBuf,
        /// Replace a file that is there.
        overwrite: bool,
    },
    /// Anything that takes bytes in order.
    Pipe {
        /// How messages call it.
        name: String,
        /// Takes the bytes.
        to: Box<dyn Write + Send>,
    },
}

impl Target {
    /// Standard output, not line buffered.
    ///
    /// # Errors
    /// Standard output is closed.
    pub fn stdout() -> Result<Self, RecordingError> {
        let owned = io::stdout().as_fd().try_clone_to_owned();
        let owned = owned.map_err(|source| RecordingError::Unwritable {
            path: "standard output".into(),
            source,
        })?;
        Ok(Self::Pipe {
            name: "standard output".into(),
            to: Box::new(File::from(owned)),
        })
    }

    /// How messages call it.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            Self::File { path, .. } => path.display().to_string(),
            Self::Pipe { name, .. } => name.clone(),
        }
    }
}

enum Output {
    /// A regular file: can be shortened to its last whole chunk.
    Regular(File),
    Stream(Box<dyn Write + Send>),
}

impl Target {
    /// Writes a whole file at once and waits until it is on the disk.
    ///
    /// # Errors
    /// The target exists, cannot be opened, or cannot be written; nothing is kept then.
    pub fn put(self, bytes: &[u8]) -> Result<(), RecordingError> {
        let target = self.name();
        let mut sink = Sink::open(self)?;
        let written = sink.write_all(bytes).and_then(|()| sink.flush());
        written.and_then(|()| sink.sync()).map_err(|source| {
            sink.keep(0);
            write_error(source.into(), &target, 0, 0)
        })
    }
}

/// The opened target. Never writes by itself when dropped, so a failed write stays where it failed.
pub(super) struct Sink {
    output: Output,
    buffer: Vec<u8>,
    /// Bytes handed to the system, shared since the container hides its stream.
    written: Arc<AtomicU64>,
}

impl Sink {
    pub(super) fn open(target: Target) -> Result<Self, RecordingError> {
        let output = match target {
            Target::Pipe { to, .. } => Output::Stream(to),
            Target::File { path, overwrite } => open_file(path, overwrite)?,
        };
        Ok(Self {
            output,
            buffer: Vec::with_capacity(BUFFER),
            written: Arc::default(),
        })
    }

    /// Bytes handed to the system.
    pub(super) fn written(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.written)
    }

    /// Another handle on a regular file.
    pub(super) fn disk(&self) -> Option<Disk> {
        match &self.output {
            Output::Regular(file) => file.try_clone().ok().map(Disk::new),
            Output::Stream(_) => None,
        }
    }

    /// Drops what was written after the first `bytes`, where the output can.
    pub(super) fn keep(&mut self, bytes: u64) {
        self.buffer.clear();
        if let Output::Regular(file) = &self.output {
            // a failure here leaves a cut file, which the reader takes as well
            let _ = file.set_len(bytes);
        }
    }

    /// Waits until the bytes are on the disk: some file systems find out only now that it is full.
    pub(super) fn sync(&self) -> io::Result<()> {
        match &self.output {
            Output::Regular(file) => file.sync_all(),
            Output::Stream(_) => Ok(()),
        }
    }

    fn pass(&mut self, bytes: &[u8]) -> io::Result<()> {
        match &mut self.output {
            Output::Regular(file) => file.write_all(bytes)?,
            Output::Stream(stream) => stream.write_all(bytes)?,
        }
        self.written
            .fetch_add(bytes.len() as u64, Ordering::Relaxed);
        Ok(())
    }

    fn drain(&mut self) -> io::Result<()> {
        let buffer = std::mem::take(&mut self.buffer);
        let result = self.pass(&buffer);
        self.buffer = buffer;
        self.buffer.clear();
        result
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.buffer.len() + bytes.len() > BUFFER {
            self.drain()?;
        }
        if bytes.len() >= BUFFER {
            self.pass(bytes)?;
        } else {
            self.buffer.extend_from_slice(bytes);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.drain()?;
        match &mut self.output {
            Output::Regular(_) => Ok(()),
            Output::Stream(stream) => stream.flush(),
        }
    }
}

fn open_file(path: PathBuf, overwrite: bool) -> Result<Output, RecordingError> {
    let mut options = OpenOptions::new();
    options.write(true);
    let existing = std::fs::metadata(&path);
    if existing.as_ref().is_ok_and(std::fs::Metadata::is_dir) {
        let source = io::Error::from(io::ErrorKind::IsADirectory);
        return Err(RecordingError::Unwritable { path, source });
    }
    let special = existing.as_ref().is_ok_and(|m| !m.is_file());
    if !special {
        if overwrite {
            options.create(true).truncate(true);
        } else {
            options.create_new(true);
        }
    }
    match options.open(&path) {
        Ok(file) if special => Ok(Output::Stream(Box::new(file))),
        Ok(file) => Ok(Output::Regular(file)),
        Err(e) if e.kind() == io::ErrorKind::AlreadyExists => Err(RecordingError::Exists { path }),
        Err(source) => Err(RecordingError::Unwritable { path, source }),
    }
}
