//! Where the frames of a file lie: read from its end, or found again by a scan.

use super::container::{PREFIX, Source, parse, records};
use super::message::{self, FrameHeader};
use super::tally::{self, Tally};
use super::{COLOR_TOPIC, RecordingError, SAINT_ENCODING, SAINT_TOPIC, stream};
use crate::frame::Camera;
use mcap::records::{ChunkIndex, MessageHeader, Record, op};
use std::collections::BTreeMap;
use std::ops::Range;

/// Bytes between a chunk record's prefix and its records, without compression.
const CHUNK_HEADER: u64 = 40;
/// Footer record (9 + 20 bytes) and the closing magic.
const FOOTER: u64 = PREFIX + 20 + mcap::MAGIC.len() as u64;

/// A place where bytes are wrong.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Fault {
    /// Frames before it.
    pub frame: u64,
    pub offset: u64,
    pub what: String,
}

/// One chunk of the file.
#[derive(Clone, Debug)]
pub(super) struct Place {
    pub offset: u64,
    /// Record with its prefix, bytes.
    pub length: u64,
    pub first_frame: u64,
    pub frames: u64,
    /// Device time of its first frame, ns.
    pub time: i64,
    /// False for the last chunk of a cut file: its end and its CRC are missing.
    pub whole: bool,
}

/// One channel.
#[derive(Clone, Debug)]
pub(super) struct Channel {
    pub topic: String,
    pub encoding: String,
    pub schema: String,
}

/// The channels met so far, and what the `saint` channel says of the camera's stream.
#[derive(Clone, Debug, Default)]
pub(super) struct Channels {
    schemas: BTreeMap<u16, String>,
    /// Name of the camera that is read: the one asked for, or the first met.
    name: Option<String>,
    /// Names of all cameras, in the order of the recording; the only one may have none.
    pub cameras: Vec<String>,
    pub by_id: BTreeMap<u16, Channel>,
    pub camera: Option<Camera>,
    /// Metadata of the `saint` channel, camera aside.
    pub notes: BTreeMap<String, String>,
}

impl Channels {
    /// Takes schema and channel records; the first definition of a number stays.
    fn learn(&mut self, record: &Record<'_>) {
        match record {
            Record::Schema { header, .. } => {
                self.schemas
                    .entry(header.id)
                    .or_insert_with(|| header.name.clone());
            }
            Record::Channel(channel) if !self.by_id.contains_key(&channel.id) => {
                let schema = self.schemas.get(&channel.schema_id).cloned();
                self.by_id.insert(
                    channel.id,
                    Channel {
                        topic: channel.topic.clone(),
                        encoding: channel.message_encoding.clone(),
                        schema: schema.unwrap_or_default(),
                    },
                );
                if let Some(name) = camera_name(&channel.topic, &channel.message_encoding) {
                    self.cameras.push(name.to_owned());
                    if self.name.get_or_insert_with(|| name.to_owned()) != name {
                        return;
                    }
                    self.notes = channel.metadata.clone();
                    let camera = self.notes.remove("camera");
                    self.camera = camera.and_then(|text| serde_json::from_str(&text).ok());
                }
            }
            _ => {}
        }
    }

    fn of_camera(name: Option<&str>) -> Self {
        Self {
            name: name.map(str::to_owned),
            ..Self::default()
        }
    }

    /// What stands before the topics of the camera that is read.
    pub fn prefix(&self) -> String {
        stream::prefix(self.name.as_deref().unwrap_or_default())
    }

    /// The part of a topic after the camera's prefix; `None` for another camera's.
    pub fn own<'a>(&self, topic: &'a str) -> Option<&'a str> {
        match self.name.as_deref() {
            None | Some("") => Some(topic),
            Some(name) => topic.strip_prefix(name)?.strip_prefix('/'),
        }
    }

    fn is_saint(&self, id: u16) -> bool {
        self.by_id.get(&id).is_some_and(|c| {
            c.encoding == SAINT_ENCODING && self.own(&c.topic) == Some(SAINT_TOPIC)
        })
    }

    fn is_color(&self, id: u16) -> bool {
        self.by_id
            .get(&id)
            .is_some_and(|c| c.encoding == "cdr" && self.own(&c.topic) == Some(COLOR_TOPIC))
    }
}

/// The camera whose frames a channel carries: empty for `saint`, else what stands before `/saint`.
fn camera_name<'a>(topic: &'a str, encoding: &str) -> Option<&'a str> {
    let before = topic.strip_suffix(SAINT_TOPIC)?;
    let name = if before.is_empty() {
        Some(before)
    } else {
        before.strip_suffix('/')
    };
    name.filter(|_| encoding == SAINT_ENCODING)
}

/// One chunk in memory, its messages found.
#[derive(Default)]
pub(super) struct Loaded {
    pub bytes: Vec<u8>,
    /// Each frame's header and where its payload lies in `bytes`.
    pub frames: Vec<(FrameHeader, Range<usize>)>,
    /// Colour images: frames of this chunk before it, MCAP's header, place in `bytes`.
    pub colors: Vec<(usize, MessageHeader, Range<usize>)>,
    /// Channel and size of every message.
    traffic: Vec<(u16, usize)>,
}

impl Loaded {
    /// Reads and checks a chunk; says what is wrong with it.
    pub fn load(
        &mut self,
        source: &Source,
        place: &Place,
        channels: &mut Channels,
    ) -> Result<(), String> {
        self.frames.clear();
        self.colors.clear();
        self.traffic.clear();
        let body = place.length.saturating_sub(PREFIX);
        if place.whole {
            let found = source.record_at(place.offset)?;
            if found != (op::CHUNK, body) {
                return Err(format!(
                    "a chunk of {body} bytes was expected, a record {:#04x} of {} bytes is there",
                    found.0, found.1
                ));
            }
        }
        let mut bytes = std::mem::take(&mut self.bytes);
        let result = source.fill(place.offset + PREFIX, body, &mut bytes);
        let result = result.and_then(|()| self.find(&bytes, place.whole, channels));
        self.bytes = bytes;
        result
    }

    /// Finds the messages in a chunk record's body.
    fn find(&mut self, bytes: &[u8], whole: bool, channels: &mut Channels) -> Result<(), String> {
        let start = CHUNK_HEADER as usize;
        let end = if whole {
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
            start + data.len()
        } else {
            bytes.len()
        };
        let data = bytes
            .get(start..end)
            .ok_or("the chunk ends in its header")?;
        for step in records(data) {
            let (code, body, at) = match step {
                Ok(step) => step,
                Err(_) if !whole => break,
                Err(what) => return Err(what),
            };
            match parse(code, body) {
                Ok(Record::Message { header, data }) => {
                    let end = start + at + body.len();
                    self.message(header, &data, end - data.len()..end, channels)?;
                }
                Ok(record) => channels.learn(&record),
                Err(_) if !whole => break,
                Err(what) => return Err(what),
            }
        }
        Ok(())
    }

    fn message(
        &mut self,
        header: MessageHeader,
        data: &[u8],
        place: Range<usize>,
        channels: &Channels,
    ) -> Result<(), String> {
        self.traffic.push((header.channel_id, data.len()));
        if channels.is_saint(header.channel_id) {
            let (frame, payload) = message::read(data)
                .ok_or_else(|| format!("a message of {} bytes is no frame", data.len()))?;
            self.frames
                .push((frame, place.end - payload.len()..place.end));
        } else if channels.is_color(header.channel_id) {
            self.colors.push((self.frames.len(), header, place));
        }
        Ok(())
    }
}

/// All that is known of a file without keeping a frame of it.
#[derive(Default)]
pub(super) struct Index {
    pub chunks: Vec<Place>,
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
    /// The index of one camera, or of the first where none is named.
    pub fn read(source: &Source, camera: Option<&str>) -> Result<Self, RecordingError> {
        let index = match Self::stored(source, camera) {
            Some(index) => index,
            None => Self::scanned(source, camera),
        };
        if index.channels.camera.is_some() {
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
        if let (Some(name), false) = (camera, index.channels.cameras.is_empty()) {
            let cameras = index.channels.cameras.join(", ");
            return Err(source.foreign(&format!(
                "holds no camera `{name}`; it holds {}",
                if cameras.is_empty() {
                    "one without a name"
                } else {
                    &cameras
                }
            )));
        }
        let topics: Vec<_> = index
            .channels
            .by_id
            .values()
            .map(|c| c.topic.as_str())
            .collect();
        Err(source.foreign(&format!(
            "holds no `{SAINT_TOPIC}` channel in `{SAINT_ENCODING}` (channels: {}); \
             give a recording made by this version of saint-live",
            if topics.is_empty() {
                "none".to_owned()
            } else {
                topics.join(", ")
            }
        )))
    }

    /// The index at the file's end; `None` where any part of it is missing or in doubt.
    fn stored(source: &Source, camera: Option<&str>) -> Option<Self> {
        let footer_at = source.length.checked_sub(FOOTER)?;
        let mut end = [0; FOOTER as usize];
        source.read_at(footer_at, &mut end).ok()?;
        let (footer, magic) = end.split_at((PREFIX + 20) as usize);
        if magic != mcap::MAGIC || footer[0] != op::FOOTER {
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
        if crc.finalize() != facts.summary_crc {
            return None;
        }
        let mut index = Self {
            channels: Channels::of_camera(camera),
            ..Self::default()
        };
        let mut chunks = Vec::new();
        let mut tally_at = None;
        for step in records(&summary) {
            let (code, body, _) = step.ok()?;
            match parse(code, body).ok()? {
                Record::ChunkIndex(chunk) => chunks.push(chunk),
                Record::MetadataIndex(m) if m.name == tally::RECORD => {
                    tally_at = Some((m.offset, m.length));
                }
                record => index.channels.learn(&record),
            }
        }
        index.tally = Self::stored_tally(source, tally_at?, &index.channels.prefix())?;
        index.place(&chunks, source.length)?;
        Some(index)
    }

    fn stored_tally(source: &Source, (offset, length): (u64, u64), prefix: &str) -> Option<Tally> {
        let mut bytes = Vec::new();
        source.fill(offset, length, &mut bytes).ok()?;
        let (code, body, _) = records(&bytes).next()?.ok()?;
        match parse(code, body).ok()? {
            Record::Metadata(m) if m.name == tally::RECORD => {
                Tally::from_metadata(&m.metadata, prefix)
            }
            _ => None,
        }
    }

    /// Joins MCAP's chunk index with our tally; `None` where they disagree.
    fn place(&mut self, chunks: &[ChunkIndex], file_length: u64) -> Option<()> {
        let tally = &self.tally;
        if chunks.len() != tally.chunk_frames.len() {
            return None;
        }
        let mut first_frame = 0;
        let mut free_from = 0;
        for ((chunk, frames), time) in chunks
            .iter()
            .zip(&tally.chunk_frames)
            .zip(&tally.chunk_times)
        {
            let end = chunk.chunk_start_offset.checked_add(chunk.chunk_length)?;
            if chunk.chunk_start_offset < free_from || end > file_length {
                return None;
            }
            free_from = end;
            self.chunks.push(Place {
                offset: chunk.chunk_start_offset,
                length: chunk.chunk_length,
                first_frame,
                frames: *frames,
                time: *time,
                whole: true,
            });
            first_frame += frames;
        }
        Some(())
    }

    /// Goes through the whole file, chunk by chunk, and finds what can be played.
    fn scanned(source: &Source, camera: Option<&str>) -> Self {
        let mut index = Self {
            rebuilt: true,
            channels: Channels::of_camera(camera),
            ..Self::default()
        };
        let mut loaded = Loaded::default();
        let mut at = mcap::MAGIC.len() as u64;
        index.cut = loop {
            let (code, length) = match source.record_at(at) {
                Ok(record) => record,
                Err(what) => {
                    index.salvage(source, at, &mut loaded);
                    break Some(index.fault(at, what));
                }
            };
            let next = at + PREFIX + length;
            match code {
                op::CHUNK => index.scan_chunk(source, at, next - at, true, &mut loaded),
                op::FOOTER if source.length - next >= mcap::MAGIC.len() as u64 => break None,
                // no writer makes opcode 0, but a lost disk block reads as zeros
                0 => break Some(index.fault(at, "zeros stand where a record should".into())),
                _ => {}
            }
            at = next;
        };
        index
    }

    fn fault(&self, offset: u64, what: String) -> Fault {
        Fault {
            frame: self.tally.frames,
            offset,
            what,
        }
    }

    fn scan_chunk(
        &mut self,
        source: &Source,
        offset: u64,
        length: u64,
        whole: bool,
        loaded: &mut Loaded,
    ) {
        let mut place = Place {
            offset,
            length,
            first_frame: self.tally.frames,
            frames: 0,
            time: 0,
            whole,
        };
        if let Err(what) = loaded.load(source, &place, &mut self.channels) {
            if whole {
                self.faults.push(self.fault(offset, what));
            }
            return;
        }
        self.tally.open_chunk();
        for (header, _) in &loaded.frames {
            self.tally.frame(header);
        }
        for (id, bytes) in &loaded.traffic {
            let channel = self.channels.by_id.get(id);
            if let Some(topic) = channel.and_then(|c| self.channels.own(&c.topic)) {
                self.tally.message(topic, *bytes);
            }
        }
        place.frames = loaded.frames.len() as u64;
        place.time = self.tally.chunk_times.last().copied().unwrap_or(0);
        self.chunks.push(place);
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
