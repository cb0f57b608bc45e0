//! What is in a recording, for people and scripts.

use crate::codec::Spent;
use crate::frame::{Camera, FrameTime};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One channel of a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelInfo {
    /// Its topic.
    pub topic: String,
    /// Name of its schema.
    pub schema: String,
    /// Message encoding.
    pub encoding: String,
    /// Messages.
    pub messages: u64,
    /// Message bodies, bytes.
    pub bytes: u64,
}

/// A place where bytes are wrong.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Damage {
    /// Where in the file, bytes.
    pub offset: u64,
    /// Number of the first frame that is missing.
    pub frame: u64,
    /// What is wrong.
    pub what: String,
}

/// Where the sensor's frames and the payloads' bits went, as the writer counted them: `sensor_frames` is `frames` and all
/// drops together.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Account {
    /// Frames the sensor made.
    pub sensor_frames: u64,
    /// Frames written.
    pub frames: u64,
    /// Frames not written, by cause.
    pub drops: BTreeMap<String, u64>,
    /// Payload bits by what they say; nothing where the writer did not count them.
    #[serde(default)]
    pub spent_bits: Spent,
}

impl Account {
    /// The account in a message of statistics, where it has one.
    pub(super) fn read(message: &[u8]) -> Option<Self> {
        #[derive(Deserialize)]
        struct Statistics {
            total: Account,
        }
        let statistics: Statistics = serde_json::from_slice(message).ok()?;
        Some(statistics.total)
    }
}

/// What [`RecordingReader::info`](super::RecordingReader::info) gives.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Info {
    /// The file.
    pub path: String,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// What wrote it.
    pub generator: String,
    /// Frames.
    pub frames: u64,
    /// Key frames among them.
    pub key_frames: u64,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Last frame's device time minus the first's, seconds.
    pub duration_s: f64,
    /// When the first frame was taken.
    pub first: FrameTime,
    /// When the last frame was taken.
    pub last: FrameTime,
    /// True where each frame's device time lies after the time of the frame before.
    pub monotonic: bool,
    /// Mean frame rate, frames per second; none with fewer than two frames.
    pub fps: Option<f64>,
    /// Mean bit rate of the SAINT stream, bit/s; none with fewer than two frames.
    pub bitrate_bps: Option<f64>,
    /// Mean size of a frame, bits; none without frames.
    pub bits_per_frame: Option<f64>,
    /// Sequence numbers skipped between frames: lost before the encoder.
    pub lost_frames: u64,
    /// Where the sensor's frames went, up to the last statistics in the file. Known after
    /// [`verify`](super::RecordingReader::verify) or once they were read.
    pub account: Option<Account>,
    /// The file ends before its end mark.
    pub cut: bool,
    /// The file's index was missing or wrong and was found again by a scan.
    pub index_rebuilt: bool,
    /// What is known to be damaged; all of it after a scan or
    /// [`verify`](super::RecordingReader::verify). For a cut file the last entry is the cut.
    pub damaged: Vec<Damage>,
    /// Domain of the contact maps: `sensor` or `polar`; `none` for a raw capture.
    pub contact_map: String,
    /// The camera's channels, by topic.
    pub channels: Vec<ChannelInfo>,
    /// The camera.
    pub camera: Camera,
    /// What the writer noted beside (tolerance, source).
    pub notes: BTreeMap<String, String>,
}
