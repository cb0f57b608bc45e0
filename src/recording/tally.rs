//! What a recording holds, counted the same way by the writer and by the scan of a cut file.

use super::message::FrameHeader;
use crate::frame::FrameTime;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name of the metadata record that carries the tally.
pub(super) const RECORD: &str = "saint-live.index";

/// Messages and bytes of one channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Traffic {
    pub messages: u64,
    /// Message bodies, without MCAP's own headers.
    pub bytes: u64,
}

/// The frames of one camera: everything `info`, `seek` and `--from` need without touching one.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct StreamTally {
    /// Frames in each chunk, chunks in file order.
    pub chunk_frames: Vec<u64>,
    /// Device time of each chunk's first frame, ns; a chunk without frames repeats the last.
    pub chunk_times: Vec<i64>,
    /// Numbers of the key frames.
    pub key_frames: Vec<u64>,
    pub frames: u64,
    pub first: FrameTime,
    pub last: FrameTime,
    /// The source's number of the last frame.
    pub last_sequence: u64,
    /// Sequence numbers skipped between frames.
    pub lost_frames: u64,
    /// Frames whose device time does not lie after the time of the frame before.
    pub backward_steps: u64,
}

impl StreamTally {
    fn open_chunk(&mut self) {
        self.chunk_frames.push(0);
        self.chunk_times.push(self.last.device_ns);
    }

    fn frame(&mut self, header: &FrameHeader) {
        if self.frames == 0 {
            self.first = header.time;
        } else {
            let step = header.sequence.saturating_sub(self.last_sequence);
            self.lost_frames = self.lost_frames.saturating_add(step.saturating_sub(1));
            let advances = header.time.device_ns > self.last.device_ns;
            self.backward_steps += u64::from(!advances);
        }
        if header.key {
            self.key_frames.push(self.frames);
        }
        if let (Some(count), Some(time)) =
            (self.chunk_frames.last_mut(), self.chunk_times.last_mut())
        {
            if *count == 0 {
                *time = header.time.device_ns;
            }
            *count += 1;
        }
        self.last = header.time;
        self.last_sequence = header.sequence;
        self.frames += 1;
    }

    /// Whether its parts agree with each other and with a file of so many chunks.
    fn agrees(&self, chunks: usize) -> bool {
        let sum = self
            .chunk_frames
            .iter()
            .try_fold(0u64, |sum, n| sum.checked_add(*n));
        let ordered = self.key_frames.windows(2).all(|pair| pair[0] < pair[1]);
        ordered
            && self.key_frames.last().is_none_or(|key| *key < self.frames)
            && sum == Some(self.frames)
            && self.chunk_frames.len() == chunks
            && self.chunk_times.len() == chunks
    }
}

/// What a whole file holds.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Tally {
    pub chunks: usize,
    /// By camera.
    pub streams: BTreeMap<String, StreamTally>,
    /// By topic.
    pub channels: BTreeMap<String, Traffic>,
}

impl Tally {
    /// A new chunk begins.
    pub fn open_chunk(&mut self) {
        self.chunks += 1;
        for stream in self.streams.values_mut() {
            stream.open_chunk();
        }
    }

    /// A frame of `camera` goes into the chunk that is open.
    pub fn frame(&mut self, camera: &str, header: &FrameHeader) {
        if !self.streams.contains_key(camera) {
            let stream = StreamTally {
                chunk_frames: vec![0; self.chunks],
                chunk_times: vec![header.time.device_ns; self.chunks],
                ..StreamTally::default()
            };
            self.streams.insert(camera.to_owned(), stream);
        }
        if let Some(stream) = self.streams.get_mut(camera) {
            stream.frame(header);
        }
    }

    /// A message goes out on `topic`.
    pub fn message(&mut self, topic: &str, bytes: usize) {
        if !self.channels.contains_key(topic) {
            self.channels.insert(topic.to_owned(), Traffic::default());
        }
        if let Some(traffic) = self.channels.get_mut(topic) {
            traffic.messages += 1;
            traffic.bytes += bytes as u64;
        }
    }

    /// Frames of each camera.
    pub fn frames_by_camera(&self) -> BTreeMap<String, u64> {
        let streams = self.streams.iter();
        streams
            .map(|(camera, stream)| (camera.clone(), stream.frames))
            .collect()
    }

    /// Frames of all cameras.
    pub fn frames(&self) -> u64 {
        self.streams.values().map(|stream| stream.frames).sum()
    }

    /// Bytes that [`to_metadata`](Self::to_metadata) and MCAP's own index need at the most.
    pub fn room(&self) -> u64 {
        let keys: usize = self.streams.values().map(|s| s.key_frames.len()).sum();
        let per_chunk = 128 + 48 * self.streams.len() + 12 * self.channels.len();
        (1024 + self.chunks * per_chunk + 21 * keys + 128 * self.channels.len()) as u64
    }

    /// The tally as the metadata record's map.
    pub fn to_metadata(&self) -> BTreeMap<String, String> {
        // serialising integers, strings and lists of them cannot fail
        let text = serde_json::to_string(self).unwrap_or_default();
        let crc = format!("{:08x}", crc32fast::hash(text.as_bytes()));
        BTreeMap::from([("tally".to_owned(), text), ("crc32".to_owned(), crc)])
    }

    /// The tally out of the metadata record's map; `None` unless checksum and sums agree.
    pub fn from_metadata(map: &BTreeMap<String, String>) -> Option<Self> {
        let text = map.get("tally")?;
        let crc = u32::from_str_radix(map.get("crc32")?, 16).ok()?;
        if crc != crc32fast::hash(text.as_bytes()) {
            return None;
        }
        let tally: Self = serde_json::from_str(text).ok()?;
        let agrees = tally.streams.values().all(|s| s.agrees(tally.chunks));
        agrees.then_some(tally)
    }
}
