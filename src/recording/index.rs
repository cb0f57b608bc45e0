//! Where the frames of a file lie: read from its end, or found again by a scan.

use super::RecordingError;
use super::channels::Channels;
use super::container::{CHUNK_HEADER, PREFIX, Source, parse, records};
use super::loaded::{Care, Loaded};
use super::tally::{self, Tally};
use mcap::records::{ChunkIndex, Record, op};

/// Footer record (9 + 20 bytes) and the closing magic.
const FOOTER: u64 = PREFIX + 20 + mcap::MAGIC.len() as u64;

/// A place where bytes are wrong.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Fault {
    /// Readable chunks before it; of a file with a whole index, chunks.
    pub chunk: usize,
    pub offset: u64,
    pub what: String,
}

/// One chunk of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    pub offset: u64,
    /// Record with its prefix, bytes.
    pub length: u64,
    /// False for the last chunk of a cut file: its end and its CRC are missing.
    pub whole: bool,
}

/// The end of a file: where its parts lie.
pub(super) struct End {
    /// First byte of the summary; the data section's end mark stands before it.
    pub summary_start: u64,
    summary: Vec<u8>,
}

impl End {
    /// The summary, guarded by its own checksum; `None` where any byte of it is in doubt.
    pub fn read(source: &Source) -> Option<Self> {
        let footer_at = source.length.checked_sub(FOOTER)?;
        let mut end = [0; FOOTER as usize];
        source.read_at(footer_at, &mut end).ok()?;
        let (footer, magic) = end.split_at((PREFIX + 20) as usize);
        if magic != mcap::MAGIC || footer[0] != op::FOOTER || footer[1..9] != 20u64.to_le_bytes() {
            return None;
        }
        let Ok(Record::Footer(facts)) = parse(op::FOOTER, &footer[PREFIX as usize..]) else {
            return None;
        };
        let length = footer_at.checked_sub(facts.summary_start)?;
        let mut summary = Vec::new();
        source
            .fill(facts.summary_start, length, &mut summary)
            .ok()?;
        let mut crc = crc32fast::Hasher::new();
        crc.update(&summary);
        crc.update(&footer[..footer.len() - 4]); // the footer's own CRC field stands last
        (crc.finalize() == facts.summary_crc).then_some(Self {
            summary_start: facts.summary_start,
            summary,
        })
    }
}

/// All that is known of a file without keeping a frame of it.
#[derive(Default)]
pub(super) struct Index {
    /// Chunks that can be read; of a stored index, all.
    pub chunks: Vec<Place>,
    /// Chunks a scan found damaged.
    pub damaged: Vec<Place>,
    pub tally: Tally,
    pub channels: Channels,
    /// Damaged chunks, in file order.
    pub faults: Vec<Fault>,
    /// Where the file breaks off, for one that was cut.
    pub cut: Option<Fault>,
    /// True where the file's own index was missing or wrong.
    pub rebuilt: bool,
}

impl Index {
    pub fn read(source: &Source) -> Result<Self, RecordingError> {
        let index = match Self::stored(source) {
            Some(index) => index,
            None => Self::scanned(source),
        };
        if !index.channels.cameras().is_empty() {
            return Ok(index);
        }
        if let Some(fault) = index.faults.first().or(index.cut.as_ref()) {
            return Err(RecordingError::Damaged {
                path: source.path.clone(),
                offset: fault.offset,
                frame: 0,
                what: format!("{} (the camera's description is lost)", fault.what),
            });
        }
        Err(source.foreign(&format!(
            "holds no `{}` channel in `{}` (channels: {}); \
             give a recording made by this version of saint-live",
            super::SAINT_TOPIC,
            super::SAINT_ENCODING,
            index.channels.topics(),
        )))
    }

    /// The index at the file's end; `None` where any part of it is missing or in doubt.
    fn stored(source: &Source) -> Option<Self> {
        let end = End::read(source)?;
        let mut index = Self::default();
        let mut chunks = Vec::new();
        let mut tally_at = None;
        for step in records(&end.summary) {
            let (code, body, _) = step.ok()?;
            match parse(code, body).ok()? {
                Record::ChunkIndex(chunk) => chunks.push(chunk),
                Record::MetadataIndex(m) if m.name == tally::RECORD => {
                    tally_at = Some((m.offset, m.length));
                }
                record => index.channels.learn(&record),
            }
        }
        index.tally = Self::stored_tally(source, tally_at?)?;
        index.place(&chunks, source.length)?;
        Some(index)
    }

    fn stored_tally(source: &Source, (offset, length): (u64, u64)) -> Option<Tally> {
        let mut bytes = Vec::new();
        source.fill(offset, length, &mut bytes).ok()?;
        let (code, body, _) = records(&bytes).next()?.ok()?;
        match parse(code, body).ok()? {
            Record::Metadata(m) if m.name == tally::RECORD => Tally::from_metadata(&m.metadata),
            _ => None,
        }
    }

    /// Joins MCAP's chunk index with our tally; `None` where they disagree.
    fn place(&mut self, chunks: &[ChunkIndex], file_length: u64) -> Option<()> {
        if chunks.len() != self.tally.chunks {
            return None;
        }
        let mut free_from = 0;
        for chunk in chunks {
            let end = chunk.chunk_start_offset.checked_add(chunk.chunk_length)?;
            if chunk.chunk_start_offset < free_from || end > file_length {
                return None;
            }
            free_from = end;
            self.chunks.push(Place {
                offset: chunk.chunk_start_offset,
                length: chunk.chunk_length,
                whole: true,
            });
        }
        Some(())
    }

    /// Goes through the whole file, chunk by chunk, and finds what can be played.
    fn scanned(source: &Source) -> Self {
        let mut index = Self {
            rebuilt: true,
            ..Self::default()
        };
        let mut loaded = Loaded::default();
        let mut at = mcap::MAGIC.len() as u64;
        // nothing before this byte needs another look
        let mut sure = at;
        index.cut = loop {
            let (code, length) = match source.record_at(at).and_then(known) {
                Ok(record) => record,
                Err(what) => match source.find_chunk(sure) {
                    Some(next) => {
                        index.faults.push(index.fault(at, what));
                        (at, sure) = (next, next);
                        continue;
                    }
                    None => {
                        index.salvage(source, at, &mut loaded);
                        break Some(index.fault(at, what));
                    }
                },
            };
            let next = at + PREFIX + length;
            match code {
                op::CHUNK => {
                    let good = index.scan_chunk(source, at, next - at, true, &mut loaded);
                    sure = if good { next } else { at + 1 };
                }
                op::FOOTER if source.length - next >= mcap::MAGIC.len() as u64 => break None,
                _ => {}
            }
            at = next;
        };
        index
    }

    fn fault(&self, offset: u64, what: String) -> Fault {
        Fault {
            chunk: self.chunks.len(),
            offset,
            what,
        }
    }

    /// Takes a chunk in; false where it is damaged.
    fn scan_chunk(
        &mut self,
        source: &Source,
        offset: u64,
        length: u64,
        whole: bool,
        loaded: &mut Loaded,
    ) -> bool {
        let place = Place {
            offset,
            length,
            whole,
        };
        if let Err(what) = loaded.load(source, &place, Care::Whole, &mut self.channels) {
            if whole {
                self.faults.push(self.fault(offset, what));
                self.damaged.push(place);
            }
            return false;
        }
        self.tally.open_chunk();
        for item in &loaded.items {
            let Some(channel) = self.channels.by_id.get(&item.header.channel_id) else {
                continue;
            };
            self.tally.message(&channel.topic, item.data.len());
            if let (Some(camera), Some((header, _))) = (channel.frames_of(), &item.frame) {
                self.tally.frame(camera, header);
            }
        }
        self.chunks.push(place);
        true
    }

    /// The whole frames at the beginning of a chunk whose end is missing. The container's
    /// checksum is gone with the end; the payload has its own.
    fn salvage(&mut self, source: &Source, at: u64, loaded: &mut Loaded) {
        let mut code = [0];
        let room = source.length.saturating_sub(at);
        if room > PREFIX + CHUNK_HEADER
            && source.read_at(at, &mut code).is_ok()
            && code[0] == op::CHUNK
        {
            self.scan_chunk(source, at, room, false, loaded);
        }
    }
}

/// Refuses opcodes no writer makes: a lost disk block reads as zeros.
fn known((code, length): (u8, u64)) -> Result<(u8, u64), String> {
    match code {
        0 => Err("zeros stand where a record should".into()),
        op::HEADER..=op::DATA_END | 0x80.. => Ok((code, length)),
        other => Err(format!("no record begins with {other:#04x}")),
    }
}
