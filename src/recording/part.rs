//! One MCAP file being written: chunks that are safe once closed, then index and end mark.

use super::chunk::{Chunk, Kind};
use super::disk::{Disk, sync_folder};
use super::open::generator;
use super::sink::Sink;
use super::tally::{self, Tally};
use super::{MAX_MESSAGE, RecordingError, Sync, Target, description};
use mcap::records::{MessageHeader, Metadata};
use mcap::write::{NoSeek, PrivateRecordOptions};
use mcap::{Attachment, McapError};
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// What MCAP puts around a message: its record's head, its index entry.
const AROUND_MESSAGE: usize = 9 + 22 + 16;
/// Room for the end of a file beside the tally and what grows with it: schemas, statistics,
/// offsets, footer.
const END_ROOM: u64 = 16 << 10;

/// One message as it goes into the file.
pub(super) struct Message<'a> {
    pub channel: u16,
    pub topic: &'a str,
    /// MCAP's field, 32 bits.
    pub sequence: u32,
    pub log_time: u64,
    pub publish_time: u64,
    pub kind: Kind<'a>,
    pub data: &'a [u8],
}

/// A schema: name, encoding, text.
pub(super) type Schema<'a> = (&'a str, &'a str, &'a [u8]);

/// A file or pipe that takes messages. Dropped without [`finish`](Self::finish) it still
/// finalises the file, but nobody hears of an error.
pub(super) struct Part {
    /// `None` once finished or failed.
    container: Option<mcap::Writer<NoSeek<Sink>>>,
    pub target: String,
    /// The path of a regular file.
    path: Option<PathBuf>,
    disk: Option<Disk>,
    sync: Sync,
    pub tally: Tally,
    chunk: Chunk,
    /// The channels so far, as every chunk repeats them.
    description: Vec<u8>,
    /// Frames that are safe, by camera.
    pub kept: BTreeMap<String, u64>,
    pub kept_bytes: u64,
    /// Bytes the sink has handed to the system.
    written: Arc<AtomicU64>,
}

impl Part {
    /// Opens the target and writes MCAP's head, with the profile the file follows (empty: its own).
    pub fn create(target: Target, sync: Sync, profile: &str) -> Result<Self, RecordingError> {
        let name = target.name();
        let path = match &target {
            Target::File { path, .. } => Some(path.clone()),
            Target::Pipe { .. } => None,
        };
        let sink = Sink::open(target)?;
        let (written, disk) = (sink.written(), sink.disk());
        let container = mcap::WriteOptions::new()
            .library(generator())
            .profile(profile)
            .chunk_size(None) // closed here, by time and size
            .compression(None)
            .disable_seeking(true)
            .create(NoSeek::new(sink))
            .map_err(|e| write_error(e, &name, 0, 0))?;
        Ok(Self {
            container: Some(container),
            target: name,
            path: path.filter(|_| disk.is_some()),
            disk,
            sync,
            tally: Tally::default(),
            chunk: Chunk::default(),
            description: Vec::new(),
            kept: BTreeMap::new(),
            kept_bytes: 0,
            written,
        })
    }

    /// Adds a channel to the file; gives its number.
    pub fn add_channel(
        &mut self,
        topic: &str,
        encoding: &str,
        (name, schema_encoding, schema): Schema<'_>,
        metadata: &BTreeMap<String, String>,
    ) -> Result<u16, RecordingError> {
        self.open_chunk(schema.len())?;
        let (id, schema_id) = self.with(|container| {
            let schema_id = match name {
                "" => 0, // MCAP's number for no schema
                name => container.add_schema(name, schema_encoding, schema)?,
            };
            let id = container.add_channel(schema_id, topic, encoding, metadata)?;
            Ok((id, schema_id))
        })?;
        let ids = (id, schema_id);
        description::add_channel(&mut self.description, ids, topic, encoding, metadata);
        self.chunk.bytes += schema.len();
        Ok(id)
    }

    /// Puts a message into the open chunk, after closing it if it is full.
    ///
    /// Where the disk has no room for it, the file is finished, whole, before the error comes.
    pub fn put(&mut self, message: &Message<'_>) -> Result<(), RecordingError> {
        let bytes = message.data.len();
        if bytes > MAX_MESSAGE {
            return Err(RecordingError::TooLarge {
                target: self.target.clone(),
                topic: message.topic.to_owned(),
                bytes,
                limit: MAX_MESSAGE,
            });
        }
        let now = Instant::now();
        if self.chunk.is_full(message.kind, bytes, now) {
            self.close_chunk()?;
        }
        self.open_chunk(bytes)?;
        let header = MessageHeader {
            channel_id: message.channel,
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        self.with(|container| container.write_to_known_channel(&header, message.data))?;
        self.tally.message(message.topic, bytes);
        if let Kind::Frame(camera, header) = &message.kind {
            self.tally.frame(camera, header);
        }
        self.chunk.add(message.kind, bytes);
        Ok(())
    }

    /// Adds a metadata record.
    pub fn metadata(
        &mut self,
        name: &str,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), RecordingError> {
        if self.chunk.is_open() {
            self.close_chunk()?;
        }
        let name = name.to_owned();
        self.with(|container| container.write_metadata(&Metadata { name, metadata }))
    }

    /// Adds an attachment.
    pub fn attachment(&mut self, attachment: &Attachment<'_>) -> Result<(), RecordingError> {
        if self.chunk.is_open() {
            self.close_chunk()?;
        }
        self.reserve(attachment.data.len())?;
        self.with(|container| container.attach(attachment))
    }

    /// Closes the chunk that is open if it has waited long enough.
    pub fn idle(&mut self) -> Result<(), RecordingError> {
        if self.chunk.is_due(Instant::now()) {
            self.close_chunk()?;
        }
        Ok(())
    }

    /// Hands the open chunk to the system, and to the disk where that was asked for.
    pub fn close_chunk(&mut self) -> Result<(), RecordingError> {
        self.with(mcap::Writer::flush)?;
        self.chunk = Chunk::default();
        self.reach_the_disk(self.sync == Sync::Chunk)?;
        self.kept = self.tally.frames_by_camera();
        self.kept_bytes = self.written.load(Ordering::Relaxed);
        Ok(())
    }

    /// Frames of all cameras that are safe.
    pub fn kept_frames(&self) -> u64 {
        self.kept.values().sum()
    }

    /// Bytes of the file if it were finished now, about.
    pub fn size(&self) -> u64 {
        let around = AROUND_MESSAGE * (self.chunk.messages + 1) + 1024;
        let open = (self.chunk.bytes + around + self.description.len()) as u64;
        let end = self.tally.room() + self.description.len() as u64 + END_ROOM;
        self.written.load(Ordering::Relaxed) + open + end
    }

    /// Writes index and end mark.
    pub fn finish(&mut self) -> Result<(), RecordingError> {
        if self.chunk.is_open() {
            self.close_chunk()?;
        }
        let index = Metadata {
            name: tally::RECORD.to_owned(),
            metadata: self.tally.to_metadata(),
        };
        self.with(|container| {
            container.write_metadata(&index)?;
            container.finish().map(|_| ())
        })?;
        let Some(container) = self.container.take() else {
            return Ok(());
        };
        let mut sink = container.into_inner().into_inner();
        let end = sink.flush().and_then(|()| sink.sync());
        if let Err(source) = end {
            sink.keep(self.kept_bytes);
            return Err(self.write_error(source.into()));
        }
        self.kept_bytes = self.written.load(Ordering::Relaxed);
        if let Some(disk) = &self.disk {
            disk.trim(self.kept_bytes);
        }
        self.reach_the_disk(true)
    }

    /// Makes sure that the disk has room for `bytes` more.
    fn reserve(&mut self, bytes: usize) -> Result<(), RecordingError> {
        let size = self.size() + bytes as u64;
        if let Some(disk) = &mut self.disk
            && let Err(source) = disk.reserve(size)
        {
            // what was reserved before is enough to end the file properly
            self.finish()?;
            return Err(self.write_error(source.into()));
        }
        Ok(())
    }

    /// Makes sure that there is an open chunk, and room in it for `bytes` more.
    fn open_chunk(&mut self, bytes: usize) -> Result<(), RecordingError> {
        self.reserve(bytes)?;
        if self.chunk.is_open() {
            return Ok(());
        }
        self.tally.open_chunk();
        self.chunk.open(Instant::now());
        if self.description.is_empty() {
            return Ok(());
        }
        let description = std::mem::take(&mut self.description);
        let options = PrivateRecordOptions::IncludeInChunks.into();
        let result = self.with(|container| {
            container.write_private_record(description::OPCODE, &description, options)
        });
        self.description = description;
        result
    }

    /// Looks whether the file is still there and, with `sync`, waits until it is on the disk.
    fn reach_the_disk(&mut self, sync: bool) -> Result<(), RecordingError> {
        let Some(disk) = &self.disk else {
            return Ok(());
        };
        if !disk.exists() {
            self.kept.clear();
            self.kept_bytes = 0;
            self.container = None;
            return Err(RecordingError::Vanished {
                target: self.target.clone(),
                frames: self.tally.frames(),
            });
        }
        if sync {
            let done = disk.sync();
            let done = done.and_then(|()| self.path.as_deref().map_or(Ok(()), sync_folder));
            if let Err(source) = done {
                self.container = None;
                return Err(self.write_error(source.into()));
            }
        }
        Ok(())
    }

    /// Runs one step of the container. After an error nothing more is written, and a file is
    /// shortened to its last whole chunk.
    fn with<T>(
        &mut self,
        step: impl FnOnce(&mut mcap::Writer<NoSeek<Sink>>) -> Result<T, McapError>,
    ) -> Result<T, RecordingError> {
        let Some(mut container) = self.container.take() else {
            return Err(RecordingError::Finished {
                target: self.target.clone(),
                frames: self.kept_frames(),
            });
        };
        match step(&mut container) {
            Ok(value) => {
                self.container = Some(container);
                Ok(value)
            }
            Err(error) => {
                container.into_inner().into_inner().keep(self.kept_bytes);
                Err(self.write_error(error))
            }
        }
    }

    fn write_error(&self, error: McapError) -> RecordingError {
        write_error(error, &self.target, self.kept_frames(), self.kept_bytes)
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        if self.container.is_some() {
            let _ = self.finish();
        }
    }
}

pub(super) fn write_error(
    error: McapError,
    target: &str,
    frames: u64,
    bytes: u64,
) -> RecordingError {
    let target = target.to_owned();
    match error {
        McapError::Io(source) => match source.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => RecordingError::DiskFull {
                target,
                frames,
                bytes,
                source,
            },
            io::ErrorKind::FileTooLarge => RecordingError::FileLimit {
                target,
                frames,
                bytes,
                source,
            },
            io::ErrorKind::BrokenPipe => RecordingError::Closed {
                target,
                frames,
                bytes,
                source,
            },
            _ => RecordingError::Write {
                target,
                frames,
                bytes,
                source,
            },
        },
        other => RecordingError::Container {
            target,
            what: other.to_string(),
        },
    }
}
