//! One chunk in memory, its messages found.

use super::channels::Channels;
use super::container::{CHUNK_HEADER, PREFIX, Source, parse, records};
use super::index::Place;
use super::message::{self, FrameHeader};
use super::raw;
use mcap::records::{MessageHeader, Record, op};
use std::ops::Range;

/// One message of a chunk.
#[derive(Clone, Debug)]
pub(super) struct Item {
    pub header: MessageHeader,
    /// Where its data lies in [`Loaded::bytes`].
    pub data: Range<usize>,
    /// For a frame: its header, and where its payload lies.
    pub frame: Option<(FrameHeader, Range<usize>)>,
}

/// How much is asked of a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Care {
    /// All of it is right, or it is an error.
    Whole,
    /// The end is missing and the checksum with it: what stands there is taken, frames by their
    /// own checksum, up to the first record that is none.
    Cut,
    /// Something in it is wrong: only frames that prove themselves, header and payload, are taken.
    Damaged,
}

/// A chunk's bytes and messages.
#[derive(Default)]
pub(super) struct Loaded {
    pub bytes: Vec<u8>,
    pub items: Vec<Item>,
}

impl Loaded {
    /// Reads and checks a chunk; says what is wrong with it.
    pub fn load(
        &mut self,
        source: &Source,
        place: &Place,
        care: Care,
        channels: &mut Channels,
    ) -> Result<(), String> {
        self.items.clear();
        let body = place.length.saturating_sub(PREFIX);
        if place.whole && care == Care::Whole {
            let found = source.record_at(place.offset)?;
            if found != (op::CHUNK, body) {
                return Err(format!(
                    "a chunk of {body} bytes was expected, a record {:#04x} of {} bytes is there",
                    found.0, found.1
                ));
            }
        }
        let care = if place.whole { care } else { Care::Cut };
        let mut bytes = std::mem::take(&mut self.bytes);
        let result = source.fill(place.offset + PREFIX, body, &mut bytes);
        let result = result.and_then(|()| self.find(&bytes, care, channels));
        self.bytes = bytes;
        result
    }

    /// Finds the messages in a chunk record's body.
    fn find(&mut self, bytes: &[u8], care: Care, channels: &mut Channels) -> Result<(), String> {
        let start = CHUNK_HEADER as usize;
        let end = match care {
            Care::Whole => whole_end(bytes)?,
            Care::Cut | Care::Damaged => bytes.len(),
        };
        let data = bytes
            .get(start..end)
            .ok_or("the chunk ends in its header")?;
        for step in records(data) {
            let found = step.and_then(|(code, body, at)| Ok((parse(code, body)?, body.len(), at)));
            let (record, length, at) = match found {
                Ok(found) => found,
                Err(_) if care != Care::Whole => break,
                Err(what) => return Err(what),
            };
            match record {
                Record::Message { header, data } => {
                    let end = start + at + length;
                    self.message(header, &data, end - data.len()..end, care, channels)?;
                }
                record if care != Care::Damaged => channels.learn(&record),
                _ => {}
            }
        }
        Ok(())
    }

    fn message(
        &mut self,
        header: MessageHeader,
        data: &[u8],
        place: Range<usize>,
        care: Care,
        channels: &Channels,
    ) -> Result<(), String> {
        let channel = channels.by_id.get(&header.channel_id);
        let mut frame = None;
        if let Some(channel) = channel.filter(|channel| channel.is_raw()) {
            // an image has no checksum of its own
            if care == Care::Damaged {
                return Ok(());
            }
            let read = raw::header(&channel.metadata, &header);
            frame = read.map(|read| (read, place.clone()));
        } else if channel.is_some_and(|channel| channel.frames_of().is_some()) {
            let read = message::read(data);
            let is_taken = |read: &(FrameHeader, &[u8])| match care {
                Care::Whole => true,
                Care::Cut => {
                    message::has_whole_payload(read.1) && message::agrees(read) != Some(false)
                }
                Care::Damaged => {
                    message::has_whole_payload(read.1) && message::agrees(read) == Some(true)
                }
            };
            match read.filter(is_taken) {
                Some((header, payload)) => {
                    frame = Some((header, place.end - payload.len()..place.end));
                }
                None if care == Care::Whole => {
                    return Err(format!("a message of {} bytes is no frame", data.len()));
                }
                None => return Ok(()),
            }
        } else if care == Care::Damaged {
            return Ok(());
        }
        self.items.push(Item {
            header,
            data: place,
            frame,
        });
        Ok(())
    }
}

/// Where the records of a chunk end, after its checksum was found right.
fn whole_end(bytes: &[u8]) -> Result<usize, String> {
    let Record::Chunk { header, data } = parse(op::CHUNK, bytes)? else {
        return Err("no chunk".into());
    };
    if !header.compression.is_empty() {
        return Err(format!(
            "the chunk is compressed ({}); decompress the file with `mcap decompress`",
            header.compression
        ));
    }
    let crc = crc32fast::hash(&data);
    if header.uncompressed_crc != 0 && crc != header.uncompressed_crc {
        return Err(format!(
            "the chunk's checksum is {crc:08x}, {:08x} was written",
            header.uncompressed_crc
        ));
    }
    Ok(CHUNK_HEADER as usize + data.len())
}
