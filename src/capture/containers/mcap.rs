//! MCAP files as a log of messages: <https://mcap.dev/spec>.
//!
//! Chunks may be plain, LZ4 or Zstandard; checksums are verified. Records are walked and parsed
//! here: the `mcap` crate takes memory for a text of any announced length before it looks whether
//! the text is there.

use super::ros::{Channel, Fields, Kind, Layout, Message, MessageLog};
use super::{MAX_RECORD, damaged};
use crate::capture::CaptureError;
use crate::capture::sequences::input;
use ::mcap::records::op;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Opcode and length before every record.
const PREFIX: usize = 9;
/// Schemas and channels kept at most; a real log has some dozen.
const MOST_CHANNELS: usize = 1 << 16;

/// An MCAP file read from its beginning.
pub(super) struct McapLog {
    path: PathBuf,
    file: BufReader<File>,
    at: u64,
    length: u64,
    schemas: BTreeMap<u16, Kind>,
    channels: BTreeMap<u16, Channel>,
    /// The record as it stands in the file.
    body: Vec<u8>,
    /// Records of the chunk that is read, and where the next one begins.
    chunk: Vec<u8>,
    chunk_at: usize,
}

/// A message's header and where its data lie in the chunk.
struct Place {
    channel: u16,
    sequence: u32,
    log_ns: u64,
    publish_ns: u64,
    data: Range<usize>,
}

/// A channel as the file describes it.
struct Described {
    id: u16,
    schema: u16,
    topic: String,
    encoding: String,
    metadata: BTreeMap<String, String>,
}

/// A chunk's header and its records as they are packed.
struct Packed<'a> {
    size: u64,
    crc: u32,
    compression: &'a str,
    data: &'a [u8],
}

/// The fields of a record: packed, little endian.
fn fields(body: &[u8]) -> Option<Fields<'_>> {
    Fields::new(body, Layout::Ros1)
}

/// A schema's number and name.
fn schema(body: &[u8]) -> Option<(u16, &str)> {
    let mut fields = fields(body)?;
    Some((fields.u16()?, fields.text()?))
}

fn channel(body: &[u8]) -> Option<Described> {
    let mut from = fields(body)?;
    let (id, schema) = (from.u16()?, from.u16()?);
    let (topic, encoding) = (from.text()?.to_owned(), from.text()?.to_owned());
    let mut entries = fields(from.bytes()?)?;
    let mut metadata = BTreeMap::new();
    while !entries.rest().is_empty() {
        metadata.insert(entries.text()?.to_owned(), entries.text()?.to_owned());
    }
    Some(Described {
        id,
        schema,
        topic,
        encoding,
        metadata,
    })
}

/// A message in the bytes of a record that ends at `end`.
fn message(body: &[u8], end: usize) -> Option<Place> {
    let mut fields = fields(body)?;
    Some(Place {
        channel: fields.u16()?,
        sequence: fields.u32()?,
        log_ns: fields.u64()?,
        publish_ns: fields.u64()?,
        data: end - fields.rest().len()..end,
    })
}

fn chunk(body: &[u8]) -> Option<Packed<'_>> {
    let mut fields = fields(body)?;
    let _times = (fields.u64()?, fields.u64()?);
    let (size, crc, compression) = (fields.u64()?, fields.u32()?, fields.text()?);
    let length = usize::try_from(fields.u64()?).ok()?;
    Some(Packed {
        size,
        crc,
        compression,
        data: fields.rest().get(..length)?,
    })
}

impl McapLog {
    /// Opens a file that begins with MCAP's magic.
    pub(super) fn open(path: &Path) -> Result<Self, CaptureError> {
        let unreadable = |error: std::io::Error| input(path, error.to_string(), "check the file");
        let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
        let length = file.get_ref().metadata().map_err(unreadable)?.len();
        let mut magic = [0; ::mcap::MAGIC.len()];
        file.read_exact(&mut magic)
            .map_err(|_| damaged(path, "too short for an MCAP file"))?;
        Ok(Self {
            path: path.to_owned(),
            at: magic.len() as u64,
            file,
            length,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            body: Vec::new(),
            chunk: Vec::new(),
            chunk_at: 0,
        })
    }

    fn damaged(&self, what: impl std::fmt::Display) -> CaptureError {
        damaged(&self.path, format!("{what}, at byte {}", self.at))
    }

    /// Moves on in the file until the chunk holds records; false at the end of the data.
    fn load(&mut self) -> Result<bool, CaptureError> {
        loop {
            let left = self.length - self.at;
            let mut prefix = [0; PREFIX];
            if left < PREFIX as u64 || self.file.read_exact(&mut prefix).is_err() {
                let error = self.damaged(format_args!("the file is cut, {left} bytes are left"));
                self.at = self.length;
                // said once
                return if left > 0 { Err(error) } else { Ok(false) };
            }
            let (&code, length) = (&prefix[0], &prefix[1..]);
            let length = u64::from_le_bytes(length.try_into().unwrap_or_default());
            let left = left - PREFIX as u64;
            if length > left {
                let what = format!("a record of {length} bytes is announced, {left} are left");
                let error = self.damaged(what);
                self.at = self.length;
                let _ = self.file.seek(SeekFrom::End(0));
                return Err(error);
            }
            match code {
                op::DATA_END | op::FOOTER => {
                    self.at = self.length;
                    let _ = self.file.seek(SeekFrom::End(0));
                    return Ok(false);
                }
                op::SCHEMA | op::CHANNEL | op::MESSAGE | op::CHUNK if length <= MAX_RECORD => {
                    self.read_body(length)?;
                    if code == op::CHUNK {
                        self.unpack()?;
                    } else {
                        self.chunk.clear();
                        self.chunk.extend_from_slice(&prefix);
                        self.chunk.append(&mut self.body);
                    }
                    self.chunk_at = 0;
                    return Ok(true);
                }
                op::SCHEMA | op::CHANNEL | op::MESSAGE | op::CHUNK => {
                    let what = format!("a record of {length} bytes, the limit is {MAX_RECORD}");
                    let error = self.damaged(what);
                    self.skip(length)?;
                    return Err(error);
                }
                _ => self.skip(length)?,
            }
        }
    }

    /// Reads a record's body; its length was checked.
    fn read_body(&mut self, length: u64) -> Result<(), CaptureError> {
        self.body.clear();
        self.body.resize(length as usize, 0);
        let read = self.file.read_exact(&mut self.body);
        read.map_err(|error| self.damaged(format_args!("reading failed: {error}")))?;
        self.at += PREFIX as u64 + length;
        Ok(())
    }

    fn skip(&mut self, length: u64) -> Result<(), CaptureError> {
        let step = i64::try_from(length).unwrap_or(i64::MAX);
        let moved = self.file.seek_relative(step);
        moved.map_err(|error| self.damaged(format_args!("seeking failed: {error}")))?;
        self.at += PREFIX as u64 + length;
        Ok(())
    }

    /// Decompresses the chunk in `body` into `chunk`.
    fn unpack(&mut self) -> Result<(), CaptureError> {
        self.chunk.clear();
        let unpacked = chunk(&self.body)
            .ok_or_else(|| "its header ends too early".to_owned())
            .and_then(|packed| unpack(&packed, &mut self.chunk));
        unpacked.map_err(|what| {
            self.chunk.clear();
            self.damaged(format_args!("a damaged chunk: {what}"))
        })
    }

    /// The next message in the chunk; `None` at its end.
    fn step(&mut self) -> Result<Option<Place>, String> {
        while self.chunk_at < self.chunk.len() {
            let rest = &self.chunk[self.chunk_at..];
            let whole = rest.split_at_checked(PREFIX).and_then(|(prefix, rest)| {
                let length = u64::from_le_bytes(prefix[1..].try_into().ok()?);
                Some((prefix[0], rest.get(..usize::try_from(length).ok()?)?))
            });
            let Some((code, body)) = whole else {
                self.chunk_at = self.chunk.len();
                return Err("a record runs over its chunk's end".to_owned());
            };
            let end = self.chunk_at + PREFIX + body.len();
            self.chunk_at = end;
            let known = match code {
                op::SCHEMA => schema(body).map(|(id, name)| {
                    if self.schemas.len() < MOST_CHANNELS {
                        self.schemas.insert(id, Kind::named(name));
                    }
                }),
                op::CHANNEL => channel(body).map(|described| self.add(described)),
                op::MESSAGE => match message(body, end) {
                    Some(place) => return Ok(Some(place)),
                    None => None,
                },
                _ => Some(()),
            };
            known.ok_or_else(|| format!("a damaged record of type {code}"))?;
        }
        Ok(None)
    }

    /// Keeps a channel whose messages are read here.
    fn add(&mut self, channel: Described) {
        let kind = self.schemas.get(&channel.schema).copied();
        let layout = match channel.encoding.as_str() {
            "cdr" => Layout::Cdr,
            "ros1" => Layout::Ros1,
            _ => return,
        };
        if let Some(kind) = kind.filter(|kind| *kind != Kind::Other) {
            let kept = Channel {
                topic: channel.topic,
                kind,
                layout,
                metadata: channel.metadata,
            };
            self.channels.insert(channel.id, kept);
        }
    }
}

impl MessageLog for McapLog {
    fn next(&mut self) -> Result<Option<Message<'_>>, CaptureError> {
        let place = loop {
            match self.step() {
                Ok(Some(place)) if self.channels.contains_key(&place.channel) => break place,
                Ok(Some(_)) => {}
                Ok(None) => {
                    if !self.load()? {
                        return Ok(None);
                    }
                }
                Err(what) => return Err(self.damaged(what)),
            }
        };
        let channel = self.channels.get(&place.channel);
        Ok(channel.map(|channel| Message {
            channel,
            sequence: Some(place.sequence),
            log_ns: place.log_ns,
            publish_ns: place.publish_ns,
            data: &self.chunk[place.data],
        }))
    }
}

/// Decompresses into `out` (empty) and checks length and checksum.
fn unpack(packed: &Packed<'_>, out: &mut Vec<u8>) -> Result<(), String> {
    let size = packed.size;
    if size > MAX_RECORD {
        return Err(format!("{size} bytes unpacked, the limit is {MAX_RECORD}"));
    }
    super::open::unpack(packed.compression, packed.data, size, out)?;
    if out.len() as u64 != size {
        let got = out.len();
        return Err(format!("{size} bytes are announced, {got} came out"));
    }
    if packed.crc != 0 && packed.crc != crc32fast::hash(out) {
        return Err("its checksum does not match".to_owned());
    }
    Ok(())
}

/// What the first channel of an MCAP file says: is this a recording of spheres, or something else?
/// `None` where no channel is found before damage or the end.
pub(super) fn first_channel_is(path: &Path, topic: &str, encoding: &str) -> Option<bool> {
    let mut log = McapLog::open(path).ok()?;
    loop {
        let mut at = 0;
        while let Some((prefix, rest)) = log.chunk.get(at..)?.split_at_checked(PREFIX) {
            let length = u64::from_le_bytes(prefix[1..].try_into().ok()?);
            let body = rest.get(..usize::try_from(length).ok()?)?;
            if prefix[0] == op::CHANNEL {
                let first = channel(body)?;
                return Some(first.topic == topic && first.encoding == encoding);
            }
            at += PREFIX + body.len();
        }
        if !log.load().ok()? {
            return None;
        }
    }
}
