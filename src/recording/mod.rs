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
//! The `saint` channel's metadata repeats the camera as JSON (`camera`) and names the writer
//! (`generator`). Where a recording has several cameras, each has these channels with its name and
//! a slash before the topic (`left/saint`), its own numbers and its own device clock. A reader MUST
//! ignore channels it does not know.
//!
//! Each chunk begins with a private record (opcode 0x80) whose body is the file's channel records
//! so far, whole MCAP records one after another. So the cameras are known from any chunk, and from
//! the summary; a lost beginning does not lose them.
//!
//! # Time
//! The exact times stand in the frame's header. MCAP's `log_time` is the device clock moved to
//! the wall clock of the first frame (`wall₀ + device − device₀`), so it never runs backwards and
//! reads as a date; where the wall clock is not known it is the device clock. `publish_time` is
//! the frame's own wall time, or `log_time` where that is not known. Negative times become 0.
//!
//! # Chunks
//! Not compressed (the payload is entropy coded), each with its CRC, closed when it holds half a
//! second of stream time, is half a second old on the writer's clock, or holds 4 MiB; also before
//! a key frame once it holds a quarter of a second, so that a lost chunk costs few frames.
//!
//! A closed chunk is handed to the system at once: it survives the end of the program, however it
//! comes. With [`Sync::Chunk`] it is on the disk (fdatasync, and the folder's entry) before the
//! next one is begun: a power cut takes at most the open chunk, as far as the disk keeps its word.
//! With [`Sync::End`] a power cut may also take what the system had not written yet, usually
//! half a minute; the file is synced when it is finished.
//!
//! Room for the end of the file is reserved ahead (fallocate). On a full disk the frame that finds
//! no room is refused and the file is finished, whole. Where the file system cannot reserve, the
//! file is shortened to its last whole chunk: it is cut, and `repair` makes it whole.
//!
//! # Index
//! Before the summary stands a metadata record `saint-live.index`: `tally` is JSON (frames per
//! chunk, numbers of the key frames, times, losses of each camera, bytes per channel) and `crc32`
//! its checksum (8 hex digits), since MCAP guards metadata with nothing. A reader MUST fall back to a scan
//! where it is missing, fails its checksum, or disagrees with MCAP's own chunk index.

mod beside;
mod calibration;
mod channels;
mod check;
mod chunk;
mod color;
mod container;
mod description;
mod disk;
mod error;
mod index;
mod info;
mod loaded;
pub mod message;
mod open;
mod part;
pub mod raw;
mod reader;
mod repair;
mod shape;
mod sink;
mod split;
mod tally;
#[cfg(test)]
mod tests;
mod topics;
mod writer;

pub use check::{CheckReport, Finding, Gap, check};
pub use error::RecordingError;
pub use info::{Account, ChannelInfo, Damage, Info};
pub use reader::{RecordingReader, Seek};
pub use repair::{RepairReport, repair};
pub use sink::Target;
pub use split::Split;
pub use writer::{CameraStream, RecordingSummary, RecordingWriter, Sync, WriterOptions};

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
/// Note that names the domain of the contact maps (`sensor` or `polar`); a recording without it
/// has sensor maps. The payloads say the same by their first bytes ([`crate::codec::Domain`]).
pub const CONTACT_MAP_NOTE: &str = "contact_map";
/// Message encoding of [`SAINT_TOPIC`].
pub const SAINT_ENCODING: &str = "saint-live/1";
/// Largest message that is written or read, bytes.
pub const MAX_MESSAGE: usize = 64 << 20;
