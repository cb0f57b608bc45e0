//! MCAP records straight from the file: every length is checked before a byte is allocated.
//!
//! The file is read by position, a record at a time, so a long recording never lies in memory and
//! damaged bytes are met one chunk at a time. Parsing of a record's fields is the `mcap` crate's;
//! walking from record to record is ours, because a reader of damaged files must know offsets and
//! go on where the crate stops.

use super::{RecordingError, shape};
use mcap::records::{Record, op};
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Opcode and length in front of every record.
pub(super) const PREFIX: u64 = 9;
/// Largest record that is read, bytes; ours are smaller than `MAX_MESSAGE` and 4 MiB together.
const MAX_RECORD: u64 = 256 << 20;

/// The file, its length, and its name for messages.
pub(super) struct Source {
    file: File,
    pub path: PathBuf,
    pub length: u64,
}

impl Source {
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let unreadable = |source| RecordingError::Unreadable {
            path: path.to_owned(),
            source,
        };
        let file = File::open(path).map_err(unreadable)?;
        let facts = file.metadata().map_err(unreadable)?;
        let source = Self {
            file,
            path: path.to_owned(),
            length: facts.len(),
        };
        if !facts.is_file() {
            return Err(source.foreign("is not a file; save the stream to a file first"));
        }
        let mut magic = [0; mcap::MAGIC.len()];
        let begins = source.length >= magic.len() as u64
            && source.read_at(0, &mut magic).is_ok()
            && magic == *mcap::MAGIC;
        if begins {
            Ok(source)
        } else {
            Err(source
                .foreign("does not begin as an MCAP file; give a recording made by saint-live"))
        }
    }

    /// The error for a file that holds no recording of ours.
    pub fn foreign(&self, what: &str) -> RecordingError {
        RecordingError::NotARecording {
            path: self.path.clone(),
            what: what.to_owned(),
        }
    }

    pub fn read_at(&self, offset: u64, bytes: &mut [u8]) -> io::Result<()> {
        self.file.read_exact_at(bytes, offset)
    }

    /// `length` bytes from `offset` into `bytes`; says what is wrong where the file has not got them.
    pub fn fill(&self, offset: u64, length: u64, bytes: &mut Vec<u8>) -> Result<(), String> {
        let end = offset.checked_add(length).filter(|end| *end <= self.length);
        if end.is_none() {
            return Err(format!(
                "{length} bytes are announced at byte {offset}, the file ends at {}",
                self.length
            ));
        }
        if length > MAX_RECORD {
            return Err(format!(
                "a record of {length} bytes is announced, the limit is {MAX_RECORD}"
            ));
        }
        bytes.clear();
        bytes.resize(length as usize, 0);
        self.read_at(offset, bytes)
            .map_err(|e| format!("reading failed: {e}"))
    }

    /// Opcode and body length of the record at `offset`; says what is wrong where there is none.
    pub fn record_at(&self, offset: u64) -> Result<(u8, u64), String> {
        let mut prefix = [0; PREFIX as usize];
        let room = self.length.saturating_sub(offset);
        if room == 0 {
            return Err("its end mark is missing".to_owned());
        }
        if room < PREFIX {
            return Err(format!("the file ends {room} bytes into a record"));
        }
        self.read_at(offset, &mut prefix)
            .map_err(|e| format!("reading failed: {e}"))?;
        let (code, length) = split_prefix(&prefix).ok_or("no record")?;
        if length > room - PREFIX {
            return Err(format!(
                "a record of {length} bytes is announced, {} bytes are left",
                room - PREFIX
            ));
        }
        Ok((code, length))
    }
}

/// Bytes between a chunk record's prefix and its records, without compression.
pub(super) const CHUNK_HEADER: u64 = 40;
/// The file is searched in pieces of this size, bytes.
const PIECE: usize = 1 << 20;

impl Source {
    /// The next place at or after `from` where an uncompressed chunk of ours begins and ends
    /// inside the file. A chunk says its length three times over, so hardly anything else looks
    /// like one.
    pub fn find_chunk(&self, from: u64) -> Option<u64> {
        let head = (PREFIX + CHUNK_HEADER) as usize;
        let mut piece = Vec::new();
        let mut at = from;
        while at + head as u64 <= self.length {
            let take = (self.length - at).min(PIECE as u64) as usize;
            piece.resize(take, 0);
            self.read_at(at, &mut piece).ok()?;
            let place = |(offset, bytes)| {
                let offset = at + offset as u64;
                let length = chunk_length(bytes)?;
                (length <= self.length - offset).then_some(offset)
            };
            if let Some(found) = piece.windows(head).enumerate().find_map(place) {
                return Some(found);
            }
            at += (take - head + 1) as u64;
        }
        None
    }
}

/// Length of the chunk record (with its prefix) whose first bytes these are.
fn chunk_length(bytes: &[u8]) -> Option<u64> {
    let number = |at: usize| {
        let eight = bytes.get(at..at + 8)?.try_into().ok()?;
        Some(u64::from_le_bytes(eight))
    };
    if bytes[0] != op::CHUNK || bytes[37..41] != [0; 4] {
        return None;
    }
    let (body, start, end) = (number(1)?, number(9)?, number(17)?);
    let (size, stored) = (number(25)?, number(41)?);
    let agree = size == stored && stored.checked_add(CHUNK_HEADER)? == body;
    (agree && start <= end && body <= MAX_RECORD).then_some(body + PREFIX)
}

fn split_prefix(bytes: &[u8]) -> Option<(u8, u64)> {
    let length = u64::from_le_bytes(bytes.get(1..PREFIX as usize)?.try_into().ok()?);
    Some((bytes[0], length))
}

/// One record's fields.
pub(super) fn parse(code: u8, body: &[u8]) -> Result<Record<'_>, String> {
    if !shape::fits(code, body) {
        return Err(format!(
            "a record of type {code:#04x} and {} bytes announces more than it holds",
            body.len()
        ));
    }
    mcap::parse_record(code, body).map_err(|e| e.to_string())
}

/// A record's opcode, its body, and where the body begins in `bytes`.
pub(super) type Step<'a> = Result<(u8, &'a [u8], usize), String>;

/// The records that lie in `bytes` one after another; ends after the first error.
pub(super) fn records(bytes: &[u8]) -> impl Iterator<Item = Step<'_>> {
    let mut at = 0;
    std::iter::from_fn(move || {
        if at == bytes.len() {
            return None;
        }
        let body = at + PREFIX as usize;
        let step = split_prefix(&bytes[at..]).and_then(|(code, length)| {
            let length = usize::try_from(length).ok()?;
            Some((code, bytes.get(body..body.checked_add(length)?)?))
        });
        Some(match step {
            Some((code, data)) => {
                at = body + data.len();
                Ok((code, data, body))
            }
            None => {
                let error = format!(
                    "a record runs over the end, {} bytes before it",
                    bytes.len() - at
                );
                at = bytes.len();
                Err(error)
            }
        })
    })
}
