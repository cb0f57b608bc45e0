//! Raw capture: the sensor's integers themselves, lossless, as an MCAP file other tools read too.
//!
//! | topic | message encoding | schema | content |
//! |---|---|---|---|
//! | `/depth/image_raw/compressedDepth` | `cdr` | `sensor_msgs/msg/CompressedImage` (ros2msg) | `16UC1; compressedDepth rvl`: one image |
//! | `/depth/camera_info` | `cdr` | `sensor_msgs/msg/CameraInfo` (ros2msg) | the pinhole, once |
//!
//! The image channel's metadata keeps what ROS has no place for, so that a replay equals the
//! capture bit for bit: the whole [`Camera`] as JSON ([`CAMERA_NOTE`]), the number of the first
//! frame ([`SEQUENCE_NOTE`]; MCAP keeps the lower 32 bits of each), and the clocks. `log_time` and
//! the stamp are the device clock plus [`CLOCK_NOTE`], which moves it to the wall clock of the
//! first frame; `publish_time` is the frame's wall time where [`WALL_NOTE`] is `known`.
//!
//! Chunks are not compressed beyond the images, have their CRC, and are closed each second or
//! 4 MiB, like those of a recording: what was closed survives whatever comes later.

use super::color;
use super::part::write_error;
use super::sink::Sink;
use super::{RecordingError, Target};
use crate::capture::containers::rvl;
use crate::frame::{Camera, FrameTime};
use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{McapError, WriteOptions};
use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Topic of the images.
pub const IMAGE_TOPIC: &str = "/depth/image_raw/compressedDepth";
/// Topic of the camera.
pub const INFO_TOPIC: &str = "/depth/camera_info";
/// Channel metadata: the whole camera as JSON.
pub const CAMERA_NOTE: &str = "saint-live.camera";
/// Channel metadata: log time less this is the device clock, ns.
pub const CLOCK_NOTE: &str = "saint-live.clock_offset_ns";
/// Channel metadata: number of the first frame.
pub const SEQUENCE_NOTE: &str = "saint-live.first_sequence";
/// Channel metadata: `known` where publish times are the wall clock.
pub const WALL_NOTE: &str = "saint-live.wall_clock";

const FORMAT: &str = "16UC1; compressedDepth rvl";
const FRAME_ID: &str = "depth";
const INFO_SCHEMA: &str = "sensor_msgs/msg/CameraInfo";
/// The message definition, with those it refers to, as ros2msg has it.
const INFO_DEFINITION: &str = "\
std_msgs/Header header
uint32 height
uint32 width
string distortion_model
float64[] d
float64[9] k
float64[9] r
float64[12] p
uint32 binning_x
uint32 binning_y
sensor_msgs/RegionOfInterest roi
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: sensor_msgs/RegionOfInterest
uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify
";
/// Where the stamp lies in a message.
const STAMP: std::ops::Range<usize> = 4..12;
/// A chunk is closed when it is this old or holds this much.
const CHUNK_AGE: Duration = Duration::from_secs(1);
const CHUNK_BYTES: usize = 4 << 20;

/// Replaces `message` by the image message of a frame of `camera`, its stamp zero. `O(pixels)`.
pub fn image_message(camera: &Camera, depth: &[u16], message: &mut Vec<u8>) {
    message.clear();
    begin(message);
    color::string(message, FORMAT);
    color::length(message, 0);
    let data = message.len();
    // transport of inverse depth, not used by integers
    message.extend_from_slice(&[0; 12]);
    message.extend_from_slice(&camera.width.to_le_bytes());
    message.extend_from_slice(&camera.height.to_le_bytes());
    rvl::encode(depth, message);
    // 3 bytes a pixel of 16 million pixels at most
    let length = (message.len() - data) as u32;
    message[data - 4..data].copy_from_slice(&length.to_le_bytes());
}

/// Encapsulation (CDR, little endian) and header.
fn begin(message: &mut Vec<u8>) {
    message.extend_from_slice(&[0, 1, 0, 0]);
    message.extend_from_slice(&[0; 8]);
    color::string(message, FRAME_ID);
}

fn info_message(camera: &Camera) -> Vec<u8> {
    let mut message = Vec::new();
    begin(&mut message);
    color::length(&mut message, camera.height as usize);
    color::length(&mut message, camera.width as usize);
    color::string(&mut message, "plumb_bob");
    // no distortion: an empty sequence
    color::length(&mut message, 0);
    let k = camera.intrinsics;
    let pinhole = [k.fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0];
    let upright = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let projection = [
        k.fx, 0.0, k.cx, 0.0, 0.0, k.fy, k.cy, 0.0, 0.0, 0.0, 1.0, 0.0,
    ];
    // 8-byte fields are aligned to 8, counted from behind the encapsulation
    let aligned = (message.len() - 4).next_multiple_of(8) + 4;
    message.resize(aligned, 0);
    for value in pinhole.iter().chain(&upright).chain(&projection) {
        message.extend_from_slice(&f64::to_le_bytes(*value));
    }
    // binning and region: the whole image
    message.extend_from_slice(&[0; 6 * 4 + 1]);
    message
}

/// What a raw capture has become.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawSummary {
    /// File, or "standard output".
    pub target: String,
    /// Frames in it.
    pub frames: u64,
    /// Its bytes.
    pub bytes: u64,
}

/// The channels, known with the first frame.
#[derive(Clone, Copy)]
struct Channels {
    image: u16,
    /// Added to the device clock, ns.
    offset_ns: i64,
}

/// Writes a raw capture.
pub struct RawWriter {
    container: Option<mcap::Writer<NoSeek<Sink>>>,
    target: String,
    camera: Camera,
    channels: Option<Channels>,
    frames: u64,
    chunk_since: Option<Instant>,
    chunk_bytes: usize,
    kept_frames: u64,
    kept_bytes: u64,
    written: Arc<AtomicU64>,
    message: Vec<u8>,
}

impl RawWriter {
    /// Opens the target and writes the container's beginning.
    ///
    /// # Errors
    /// [`RecordingError::Exists`], [`RecordingError::Unwritable`], or a write error.
    pub fn create(target: Target, camera: &Camera) -> Result<Self, RecordingError> {
        let name = target.name();
        let sink = Sink::open(target)?;
        let written = sink.written();
        let container = WriteOptions::new()
            .library(concat!("saint-live ", env!("CARGO_PKG_VERSION")))
            .profile("ros2")
            .chunk_size(None)
            .compression(None)
            .disable_seeking(true)
            .create(NoSeek::new(sink))
            .map_err(|error| write_error(error, &name, 0, 0))?;
        Ok(Self {
            container: Some(container),
            target: name,
            camera: camera.clone(),
            channels: None,
            frames: 0,
            chunk_since: None,
            chunk_bytes: 0,
            kept_frames: 0,
            kept_bytes: 0,
            written,
            message: Vec::new(),
        })
    }

    /// Appends a frame: `image` is what [`image_message`] made of it.
    ///
    /// # Errors
    /// A write error says how many frames are safe; the file is closed by it.
    pub fn frame(
        &mut self,
        sequence: u64,
        time: FrameTime,
        image: &[u8],
    ) -> Result<(), RecordingError> {
        let now = Instant::now();
        let full = self.chunk_bytes + image.len() > CHUNK_BYTES;
        let old = |since: Instant| full || now.saturating_duration_since(since) >= CHUNK_AGE;
        if self.chunk_since.is_some_and(old) {
            self.close_chunk()?;
        }
        self.chunk_since.get_or_insert(now);
        let channels = match self.channels {
            Some(channels) => channels,
            None => self.begin(sequence, time)?,
        };
        let mut message = std::mem::take(&mut self.message);
        message.clear();
        message.extend_from_slice(image);
        let result = self.append(channels.image, channels, (sequence, time), &mut message);
        self.chunk_bytes += message.len();
        self.message = message;
        result?;
        self.frames += 1;
        Ok(())
    }

    /// Closes the chunk that is open if it is a second old.
    ///
    /// # Errors
    /// As [`frame`](Self::frame).
    pub fn idle(&mut self) -> Result<(), RecordingError> {
        match self.chunk_since {
            Some(since) if since.elapsed() >= CHUNK_AGE => self.close_chunk(),
            _ => Ok(()),
        }
    }

    /// Writes the index and the end mark.
    ///
    /// # Errors
    /// As [`frame`](Self::frame); closed chunks stay readable then.
    pub fn finish(mut self) -> Result<RawSummary, RecordingError> {
        if self.chunk_since.is_some() {
            self.close_chunk()?;
        }
        self.with(|container| container.finish().map(|_| ()))?;
        if let Some(container) = self.container.take() {
            let mut sink = container.into_inner().into_inner();
            let end = io::Write::flush(&mut sink).and_then(|()| sink.sync());
            end.map_err(|source| self.write_error(source.into()))?;
        }
        Ok(RawSummary {
            target: self.target.clone(),
            frames: self.frames,
            bytes: self.written.load(Ordering::Relaxed),
        })
    }

    /// The channels, with what the first frame says about the clocks, and the camera.
    fn begin(&mut self, sequence: u64, time: FrameTime) -> Result<Channels, RecordingError> {
        let known = time.wall_ns > 0;
        // where the wall clock is not known, the device clock, as far as it is positive
        let offset_ns = if known {
            time.wall_ns.saturating_sub(time.device_ns)
        } else {
            time.device_ns.min(0).saturating_neg()
        };
        let camera = serde_json::to_string(&self.camera).unwrap_or_default();
        let wall = if known { "known" } else { "unknown" };
        let notes: BTreeMap<String, String> = [
            (CAMERA_NOTE, camera),
            (CLOCK_NOTE, offset_ns.to_string()),
            (SEQUENCE_NOTE, sequence.to_string()),
            (WALL_NOTE, wall.to_owned()),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into();
        let (image, info) = self.with(|container| {
            let schema =
                container.add_schema(color::SCHEMA, "ros2msg", color::DEFINITION.as_bytes())?;
            let image = container.add_channel(schema, IMAGE_TOPIC, "cdr", &notes)?;
            let schema =
                container.add_schema(INFO_SCHEMA, "ros2msg", INFO_DEFINITION.as_bytes())?;
            let info = container.add_channel(schema, INFO_TOPIC, "cdr", &BTreeMap::new())?;
            Ok((image, info))
        })?;
        let channels = Channels { image, offset_ns };
        let mut message = info_message(&self.camera);
        self.append(info, channels, (sequence, time), &mut message)?;
        Ok(*self.channels.insert(channels))
    }

    /// Stamps a message and writes it.
    fn append(
        &mut self,
        channel_id: u16,
        channels: Channels,
        (sequence, time): (u64, FrameTime),
        message: &mut [u8],
    ) -> Result<(), RecordingError> {
        let moved = time.device_ns.saturating_add(channels.offset_ns);
        let log_time = u64::try_from(moved).unwrap_or(0);
        let seconds = i32::try_from(log_time / 1_000_000_000).unwrap_or(i32::MAX);
        let nanoseconds = (log_time % 1_000_000_000) as u32;
        let (stamp_s, stamp_ns) = message[STAMP].split_at_mut(4);
        stamp_s.copy_from_slice(&seconds.to_le_bytes());
        stamp_ns.copy_from_slice(&nanoseconds.to_le_bytes());
        let header = MessageHeader {
            channel_id,
            sequence: sequence as u32, // the lower 32 bits
            log_time,
            publish_time: match u64::try_from(time.wall_ns) {
                Ok(wall) if wall > 0 => wall,
                _ => log_time,
            },
        };
        self.with(|container| container.write_to_known_channel(&header, message))
    }

    fn close_chunk(&mut self) -> Result<(), RecordingError> {
        self.with(mcap::Writer::flush)?;
        self.chunk_since = None;
        self.chunk_bytes = 0;
        self.kept_frames = self.frames;
        self.kept_bytes = self.written.load(Ordering::Relaxed);
        Ok(())
    }

    /// Runs one step of the container. After an error nothing more is written, and a file is
    /// shortened to its last whole chunk.
    fn with<T>(
        &mut self,
        step: impl FnOnce(&mut mcap::Writer<NoSeek<Sink>>) -> Result<T, McapError>,
    ) -> Result<T, RecordingError> {
        let Some(mut container) = self.container.take() else {
            return Err(RecordingError::Finished {
                target: self.target.clone(),
                frames: self.kept_frames,
            });
        };
        match step(&mut container) {
            Ok(value) => {
                self.container = Some(container);
                Ok(value)
            }
            Err(error) => {
                container.into_inner().into_inner().keep(self.kept_bytes);
                Err(self.write_error(error))
            }
        }
    }

    fn write_error(&self, error: McapError) -> RecordingError {
        write_error(error, &self.target, self.kept_frames, self.kept_bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::sequences::{self, SequenceOptions};
    use crate::capture::{FrameSource, Next};
    use crate::frame::{DepthFrame, Intrinsics};

    fn camera() -> Camera {
        Camera {
            width: 5,
            height: 3,
            intrinsics: Intrinsics {
                fx: 1.0 / 3.0,
                fy: 5.1,
                cx: 2.2,
                cy: 1e-7,
            },
            depth_unit_m: 0.000_1,
            invalid: vec![7, 65535],
            depth_min_m: 0.1,
            depth_max_m: 4.3,
            fps: Some(90.0),
            name: "a \"camera\"".to_owned(),
        }
    }

    fn frames() -> Vec<DepthFrame> {
        let frame = |sequence: u64, device_ns, wall_ns, depth: [u16; 15]| DepthFrame {
            sequence,
            time: FrameTime { device_ns, wall_ns },
            depth: depth.to_vec(),
        };
        let wall = 1_700_000_000_123_456_789;
        vec![
            frame(u64::from(u32::MAX) * 3 + 2, 55, wall, [0; 15]),
            // numbers pass a multiple of 2³², the wall clock drifts
            frame(
                u64::from(u32::MAX) * 3 + 3,
                11_111_166,
                wall + 11_111_113,
                [65535; 15],
            ),
            frame(
                u64::from(u32::MAX) * 3 + 9,
                22_222_277,
                wall + 22_222_220,
                std::array::from_fn(|n| [0, 1, 65535, 900][n % 4]),
            ),
        ]
    }

    fn written(frames: &[DepthFrame]) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("raw.mcap");
        let target = Target::File {
            path: path.clone(),
            overwrite: false,
        };
        let mut writer = RawWriter::create(target, &camera()).unwrap();
        let mut message = Vec::new();
        for frame in frames {
            image_message(&camera(), &frame.depth, &mut message);
            writer.frame(frame.sequence, frame.time, &message).unwrap();
        }
        let summary = writer.finish().unwrap();
        assert_eq!(summary.frames, frames.len() as u64);
        assert_eq!(summary.bytes, std::fs::metadata(&path).unwrap().len());
        (folder, path)
    }

    fn read(mut source: Box<dyn FrameSource>) -> Vec<DepthFrame> {
        let mut out = Vec::new();
        let mut frame = DepthFrame::default();
        while source.next(&mut frame).unwrap() == Next::Frame {
            out.push(frame.clone());
        }
        out
    }

    #[test]
    fn camera_numbers_times_and_integers_come_back() {
        let (_folder, path) = written(&frames());
        let source = sequences::open(&path, &SequenceOptions::default()).unwrap();
        assert_eq!(source.camera(), &camera());
        assert_eq!(read(source), frames());
    }

    #[test]
    fn a_device_clock_without_a_wall_clock_comes_back() {
        let mut without = frames();
        for (n, frame) in without.iter_mut().enumerate() {
            frame.time = FrameTime {
                device_ns: -5 + 7 * n as i64,
                wall_ns: 0,
            };
        }
        let (_folder, path) = written(&without);
        let source = sequences::open(&path, &SequenceOptions::default()).unwrap();
        assert_eq!(read(source), without);
    }

    #[test]
    fn an_empty_capture_is_a_file_without_images() {
        let (_folder, path) = written(&[]);
        assert!(sequences::open(&path, &SequenceOptions::default()).is_err());
    }
}
