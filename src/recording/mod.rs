//! A recording: one MCAP file (or pipe) with the SAINT stream and what belongs to it.
//!
//! ```text
//! EncodedFrame ─┐                                ┌─ frames in order, seek to a key frame
//! ColorFrame  ──┼─► RecordingWriter ─► .mcap ─► RecordingReader ─ camera, colour
//! statistics  ──┘    chunks ≤ 1 s                └─ Info: what is in it, what is damaged
//! ```
//!
//! # Channels
//! | topic | message encoding | schema | content |
//! |---|---|---|---|
//! | `saint` | `saint-live/1` | `saint-live.frame` (text) | 25-byte header ([`message`]) and the payload of `codec/FORMAT.md` |
//! | `calibration` | `json` | `foxglove.CameraCalibration` (jsonschema) | once, at the first frame's time |
//! | `camera` | `json` | `saint-live.camera` (jsonschema) | the whole [`Camera`](crate::frame::Camera), once |
//! | `statistics` | `json` | `saint-live.statistics` (jsonschema) | what the pipeline counts |
//! | `color` | `cdr` | `sensor_msgs/msg/CompressedImage` (ros2msg) | JPEG or PNG, bytes untouched |
//!
//! The `saint` channel's metadata repeats the camera as JSON (`camera`), so that the camera is
//! known from the file's first chunk and from its summary alike, and names the writer
//! (`generator`). A reader MUST ignore channels it does not know.
//!
//! # Time
//! The exact times stand in the frame's header. MCAP's `log_time` is the device clock moved to
//! the wall clock of the first frame (`wall₀ + device − device₀`), so it never runs backwards and
//! reads as a date; where the wall clock is not known it is the device clock. `publish_time` is
//! the frame's own wall time, or `log_time` where that is not known. Negative times become 0.
//!
//! # Chunks
//! Not compressed (the payload is entropy coded), each with its CRC, closed when it holds a
//! second of stream time, is a second old on the writer's clock, or holds 4 MiB; also before a
//! key frame once it holds half a second, so that a lost chunk costs few frames. The file is
//! flushed when a chunk is closed: what was closed survives whatever comes later.
//!
//! # Index
//! Before the summary stands a metadata record `saint-live.index`: `tally` is JSON (frames per
//! chunk, numbers of the key frames, times, losses, bytes per channel) and `crc32` its checksum
//! (8 hex digits), since MCAP guards metadata with nothing. A reader MUST fall back to a scan
//! where it is missing, fails its checksum, or disagrees with MCAP's own chunk index.

mod calibration;
mod color;
mod container;
mod index;
mod info;
pub mod message;
mod reader;
mod sink;
mod tally;
#[cfg(test)]
mod tests;
mod writer;

pub use info::{ChannelInfo, Damage, Info};
pub use reader::{RecordingReader, Seek};
pub use sink::Target;
pub use writer::{RecordingSummary, RecordingWriter, WriterOptions};

use std::io;
use std::path::PathBuf;

/// Topic of the SAINT stream.
pub const SAINT_TOPIC: &str = "saint";
/// Topic of the camera as Foxglove tools read it.
pub const CALIBRATION_TOPIC: &str = "calibration";
/// Topic of the camera as we read it.
pub const CAMERA_TOPIC: &str = "camera";
/// Topic of the statistics.
pub const STATISTICS_TOPIC: &str = "statistics";
/// Topic of the colour images.
pub const COLOR_TOPIC: &str = "color";
/// Message encoding of [`SAINT_TOPIC`].
pub const SAINT_ENCODING: &str = "saint-live/1";
/// Largest message that is written or read, bytes.
pub const MAX_MESSAGE: usize = 64 << 20;

/// Why a recording cannot be written or read; a variant is what the caller does about it.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The output exists and nobody asked to overwrite it: usage, exit 2.
    #[error("{} exists already; give another name or --overwrite", .path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The output cannot be opened for writing: exit 5.
    #[error("cannot write {}: {source}; choose a folder that exists and may be written", .path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// No room is left: exit 5.
    #[error(
        "{target}: no space left; {frames} frames ({bytes} bytes) are kept; free some space and record again"
    )]
    DiskFull {
        /// File or pipe.
        target: String,
        /// Whole frames that are safe.
        frames: u64,
        /// Bytes that are safe.
        bytes: u64,
        /// What the system said.
        source: io::Error,
    },
    /// The reading end of the pipe has gone: exit 5.
    #[error("{target}: the reader has closed the pipe after {frames} frames ({bytes} bytes)")]
    Closed {
        /// File or pipe.
        target: String,
        /// Whole frames that were handed over.
        frames: u64,
        /// Bytes that were handed over.
        bytes: u64,
        /// What the system said.
        source: io::Error,
    },
    /// Any other write error: exit 5.
    #[error("{target}: writing failed ({source}); {frames} frames ({bytes} bytes) are kept")]
    Write {
        /// File or pipe.
        target: String,
        /// Whole frames that are safe.
        frames: u64,
        /// Bytes that are safe.
        bytes: u64,
        /// What the system said.
        source: io::Error,
    },
    /// The writer was used after it had failed or finished: a fault of the caller.
    #[error("{target}: the recording is closed; {frames} frames are kept")]
    Finished {
        /// File or pipe.
        target: String,
        /// Whole frames that are safe.
        frames: u64,
    },
    /// A message is larger than [`MAX_MESSAGE`]; it was not written.
    #[error(
        "{target}: a message of {bytes} bytes on channel {topic} exceeds the limit of {limit}; it was not recorded"
    )]
    TooLarge {
        /// File or pipe.
        target: String,
        /// The channel.
        topic: &'static str,
        /// Its size.
        bytes: usize,
        /// [`MAX_MESSAGE`].
        limit: usize,
    },
    /// The container's own code refused, for a reason that is not the output's.
    #[error("{target}: {what}")]
    Container {
        /// File or pipe.
        target: String,
        /// What it said.
        what: String,
    },
    /// The input cannot be opened or read: exit 4.
    #[error("cannot read {}: {source}", .path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The input is no recording of ours: exit 4.
    #[error("{}: {what}", .path.display())]
    NotARecording {
        /// The file.
        path: PathBuf,
        /// Why not, and what to do.
        what: String,
    },
    /// Bytes are missing or wrong from here on: exit 4. Frames before `frame` are whole; asking
    /// for the next frame again goes on at the next key frame after the damage.
    #[error("{}: damaged at byte {offset}, before frame {frame}: {what}; the {frame} frames before it are whole", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where in the file, bytes.
        offset: u64,
        /// Number of the first frame that is missing.
        frame: u64,
        /// What is wrong.
        what: String,
    },
    /// The file ends before its end mark: exit 4. Every frame before `frame` is whole.
    #[error("{}: cut at byte {offset}, after {frame} whole frames: {what}", .path.display())]
    Cut {
        /// The file.
        path: PathBuf,
        /// Where the whole part ends, bytes.
        offset: u64,
        /// Number of whole frames.
        frame: u64,
        /// What is missing.
        what: String,
    },
    /// A frame was asked for that the recording does not have.
    #[error("{}: frame {frame} was asked for, the recording has {frames} (0 to {})", .path.display(), .frames.saturating_sub(1))]
    NoSuchFrame {
        /// The file.
        path: PathBuf,
        /// The frame asked for.
        frame: u64,
        /// Frames there are.
        frames: u64,
    },
}
