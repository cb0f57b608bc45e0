//! ROS 1 bags as a log of messages: <http://wiki.ros.org/Bags/Format/2.0>.
//!
//! A record is a header of `name=value` fields and data, each with a u32 length before it. Messages
//! lie in chunks, plain or packed (LZ4, bzip2), each with the connections it is the first to use.
//! The reader is our own: the crates for it map the file into memory and trust its lengths.

use super::ros::{Channel, Kind, Layout, Message, MessageLog};
use super::{MAX_RECORD, damaged};
use crate::capture::CaptureError;
use crate::capture::sequences::input;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};

const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
/// Largest header of a record, bytes: a connection's has a topic and a number.
const MAX_HEADER: u64 = 1 << 20;
/// Connections kept at most; a real bag has some dozen.
const MOST_CONNECTIONS: usize = 1 << 16;

/// Values of the header field `op`.
mod op {
    pub(super) const MESSAGE: u8 = 2;
    pub(super) const CHUNK: u8 = 5;
    pub(super) const CONNECTION: u8 = 7;
}

/// A bag read from its beginning.
pub(super) struct BagLog {
    path: PathBuf,
    file: BufReader<File>,
    at: u64,
    length: u64,
    connections: BTreeMap<u32, Channel>,
    header: Vec<u8>,
    packed: Vec<u8>,
    /// Records that are read next, and where.
    chunk: Vec<u8>,
    chunk_at: usize,
}

/// A message: its connection, its time, its data in the chunk.
type Place = (u32, u64, Range<usize>);

impl BagLog {
    /// Opens a file that begins with `#ROSBAG V`.
    pub(super) fn open(path: &Path) -> Result<Self, CaptureError> {
        let unreadable = |error: std::io::Error| input(path, error.to_string(), "check the file");
        let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
        let length = file.get_ref().metadata().map_err(unreadable)?.len();
        let mut magic = [0; MAGIC.len()];
        let read = file.read_exact(&mut magic);
        if read.is_err() || magic != *MAGIC {
            let version = String::from_utf8_lossy(&magic).trim().to_owned();
            let what = format!("\"{version}\", but version 2.0 of ROS bags is read");
            return Err(input(path, what, "convert it with rosbag fix"));
        }
        Ok(Self {
            path: path.to_owned(),
            at: magic.len() as u64,
            file,
            length,
            connections: BTreeMap::new(),
            header: Vec::new(),
            packed: Vec::new(),
            chunk: Vec::new(),
            chunk_at: 0,
        })
    }

    fn damaged(&self, what: impl std::fmt::Display) -> CaptureError {
        damaged(&self.path, format!("{what}, at byte {}", self.at))
    }

    /// The same, and the rest of the file is given up: without a length nothing can be skipped.
    fn broken(&mut self, what: impl std::fmt::Display) -> CaptureError {
        let error = self.damaged(what);
        self.at = self.length;
        error
    }

    /// A u32 length that the file can hold, within `limit`.
    fn read_length(&mut self, limit: u64) -> Result<u64, CaptureError> {
        let mut bytes = [0; 4];
        if self.length - self.at < 4 || self.file.read_exact(&mut bytes).is_err() {
            return Err(self.broken("the file is cut"));
        }
        let length = u64::from(u32::from_le_bytes(bytes));
        let left = self.length - self.at - 4;
        if length > left {
            let what = format!("{length} bytes are announced, {left} are left");
            return Err(self.broken(what));
        }
        if length > limit {
            return Err(self.broken(format!("{length} bytes, the limit is {limit}")));
        }
        self.at += 4;
        Ok(length)
    }

    fn read(
        &mut self,
        length: u64,
        which: fn(&mut Self) -> &mut Vec<u8>,
    ) -> Result<(), CaptureError> {
        let mut bytes = std::mem::take(which(self));
        bytes.clear();
        bytes.resize(length as usize, 0);
        let read = self.file.read_exact(&mut bytes);
        *which(self) = bytes;
        if let Err(error) = read {
            return Err(self.broken(format!("reading failed: {error}")));
        }
        self.at += length;
        Ok(())
    }

    /// Moves on until `chunk` holds records; false at the end of the file.
    fn load(&mut self) -> Result<bool, CaptureError> {
        while self.at < self.length {
            let length = self.read_length(MAX_HEADER)?;
            self.read(length, |log| &mut log.header)?;
            let code = field(&self.header, "op").and_then(|op| op.first().copied());
            match code {
                Some(op::CHUNK) => {
                    let length = self.read_length(MAX_RECORD)?;
                    self.read(length, |log| &mut log.packed)?;
                    self.unpack()?;
                    return Ok(true);
                }
                Some(op::MESSAGE | op::CONNECTION) => {
                    let length = self.read_length(MAX_RECORD)?;
                    self.read(length, |log| &mut log.packed)?;
                    self.chunk.clear();
                    for part in [&self.header, &self.packed] {
                        self.chunk.extend((part.len() as u32).to_le_bytes());
                        self.chunk.extend_from_slice(part);
                    }
                    self.chunk_at = 0;
                    return Ok(true);
                }
                _ => {
                    let length = self.read_length(u64::MAX)?;
                    let step = i64::try_from(length).unwrap_or(i64::MAX);
                    if let Err(error) = self.file.seek_relative(step) {
                        return Err(self.broken(format!("seeking failed: {error}")));
                    }
                    self.at += length;
                }
            }
        }
        Ok(false)
    }

    /// Unpacks the chunk in `packed` into `chunk`.
    fn unpack(&mut self) -> Result<(), CaptureError> {
        self.chunk.clear();
        self.chunk_at = 0;
        let compression = field(&self.header, "compression").unwrap_or(b"none");
        let compression = String::from_utf8_lossy(compression);
        let size = field(&self.header, "size").and_then(number);
        let size = size.map_or(self.packed.len() as u64, u64::from);
        let unpacked = if size > MAX_RECORD {
            Err(format!("{size} bytes unpacked, the limit is {MAX_RECORD}"))
        } else {
            super::open::unpack(&compression, &self.packed, size, &mut self.chunk)
        };
        let short = self.chunk.len() as u64 != size;
        let what = match unpacked {
            Ok(()) if short => format!("{size} bytes are announced, {} came out", self.chunk.len()),
            Ok(()) => return Ok(()),
            Err(what) => what,
        };
        self.chunk.clear();
        Err(self.damaged(format_args!("a damaged chunk: {what}")))
    }

    /// The next message in the chunk; `None` at its end.
    fn step(&mut self) -> Result<Option<Place>, String> {
        while self.chunk_at < self.chunk.len() {
            let Some((header, data)) = record(&self.chunk, self.chunk_at) else {
                self.chunk_at = self.chunk.len();
                return Err("a record runs over its chunk's end".to_owned());
            };
            self.chunk_at = data.end;
            let header = &self.chunk[header];
            let connection = field(header, "conn").and_then(number);
            match (field(header, "op"), connection) {
                (Some([op::CONNECTION]), Some(connection)) => {
                    let facts = &self.chunk[data];
                    let topic = field(header, "topic").or_else(|| field(facts, "topic"));
                    let kind = field(facts, "type").map(String::from_utf8_lossy);
                    let kind = kind.map_or(Kind::Other, |name| Kind::named(&name));
                    let room = self.connections.len() < MOST_CONNECTIONS;
                    if let Some(topic) = topic.filter(|_| room && kind != Kind::Other) {
                        let channel = Channel {
                            topic: String::from_utf8_lossy(topic).into_owned(),
                            kind,
                            layout: Layout::Ros1,
                            metadata: BTreeMap::new(),
                        };
                        self.connections.insert(connection, channel);
                    }
                }
                (Some([op::MESSAGE]), Some(connection)) => {
                    let time = field(header, "time").and_then(|time| {
                        let (seconds, nanoseconds) = time.split_first_chunk::<4>()?;
                        let seconds = u64::from(u32::from_le_bytes(*seconds));
                        Some(seconds * 1_000_000_000 + u64::from(number(nanoseconds)?))
                    });
                    return Ok(Some((connection, time.unwrap_or(0), data)));
                }
                _ => {}
            }
        }
        Ok(None)
    }
}

impl MessageLog for BagLog {
    fn next(&mut self) -> Result<Option<Message<'_>>, CaptureError> {
        let (connection, log_ns, data) = loop {
            match self.step() {
                Ok(Some(place)) if self.connections.contains_key(&place.0) => break place,
                Ok(Some(_)) => {}
                Ok(None) => {
                    if !self.load()? {
                        return Ok(None);
                    }
                }
                Err(what) => return Err(self.damaged(what)),
            }
        };
        let channel = self.connections.get(&connection);
        Ok(channel.map(|channel| Message {
            channel,
            sequence: None,
            log_ns,
            publish_ns: log_ns,
            data: &self.chunk[data],
        }))
    }
}

/// Where the header and the data of the record at `at` lie.
fn record(bytes: &[u8], at: usize) -> Option<(Range<usize>, Range<usize>)> {
    let part = |at: usize| {
        let start = at.checked_add(4)?;
        let length = number(bytes.get(at..start)?)? as usize;
        let end = start
            .checked_add(length)
            .filter(|end| *end <= bytes.len())?;
        Some(start..end)
    };
    let header = part(at)?;
    let data = part(header.end)?;
    Some((header, data))
}

/// The value of a header's field.
fn field<'a>(mut header: &'a [u8], name: &str) -> Option<&'a [u8]> {
    while let Some((length, rest)) = header.split_first_chunk::<4>() {
        let (entry, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        header = rest;
        let value = entry.strip_prefix(name.as_bytes());
        if let Some(value) = value.and_then(|value| value.strip_prefix(b"=")) {
            return Some(value);
        }
    }
    None
}

fn number(bytes: &[u8]) -> Option<u32> {
    bytes.try_into().ok().map(u32::from_le_bytes)
}
