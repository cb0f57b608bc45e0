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

/// Everything `info`, `seek` and `--from` need without touching a frame.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Tally {
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
    /// By topic, without the camera's prefix.
    pub channels: BTreeMap<String, Traffic>,
}

impl Tally {
    /// A new chunk begins.
    pub fn open_chunk(&mut self) {
        self.chunk_frames.push(0);
        self.chunk_times.push(self.last.device_ns);
    }

    /// A frame goes into the chunk that is open.
    pub fn frame(&mut self, header: &FrameHeader) {
        if self.frames == 0 {
            self.first = header.time;
        } else {
            let step = header.sequence.saturating_sub(self.last_sequence);
            self.lost_frames = self.lost_frames.saturating_add(step.saturating_sub(1));
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

    /// The tally as entries of the metadata record's map, `prefix` before their names.
    pub fn to_metadata(&self, prefix: &str) -> BTreeMap<String, String> {
        // serialising integers, strings and lists of them cannot fail
        let text = serde_json::to_string(self).unwrap_or_default();
        let crc = format!("{:08x}", crc32fast::hash(text.as_bytes()));
        BTreeMap::from([
            (format!("{prefix}tally"), text),
            (format!("{prefix}crc32"), crc),
        ])
    }

    /// The tally of the camera of that prefix out of the metadata record's map; `None` unless
    /// checksum and sums agree.
    pub fn from_metadata(map: &BTreeMap<String, String>, prefix: &str) -> Option<Self> {
        let text = map.get(&format!("{prefix}tally"))?;
        let crc = u32::from_str_radix(map.get(&format!("{prefix}crc32"))?, 16).ok()?;
        if crc != crc32fast::hash(text.as_bytes()) {
            return None;
        }
        let tally: Self = serde_json::from_str(text).ok()?;
        let sum = tally
            .chunk_frames
            .iter()
            .try_fold(0u64, |sum, n| sum.checked_add(*n))?;
        let ordered = tally.key_frames.windows(2).all(|pair| pair[0] < pair[1])
            && tally
                .key_frames
                .last()
                .is_none_or(|key| *key < tally.frames);
        let agrees = sum == tally.frames && tally.chunk_times.len() == tally.chunk_frames.len();
        (ordered && agrees).then_some(tally)
    }
}
