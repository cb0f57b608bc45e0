//! Raw capture: the sensor's integers themselves, lossless, as an MCAP file other tools read too.
//!
//! | topic | message encoding | schema | content |
//! |---|---|---|---|
//! | `/depth/image_raw/compressedDepth` | `cdr` | `sensor_msgs/msg/CompressedImage` (ros2msg) | `16UC1; compressedDepth rvl`: one image |
//! | `/depth/camera_info` | `cdr` | `sensor_msgs/msg/CameraInfo` (ros2msg) | the pinhole, once |
//! | `/color/image_raw/compressed` | `cdr` | `sensor_msgs/msg/CompressedImage` (ros2msg) | JPEG or PNG of a colour camera beside, bytes untouched |
//!
//! The image channel's metadata keeps what ROS has no place for, so that a replay equals the
//! capture bit for bit: the whole [`Camera`] as JSON ([`CAMERA_NOTE`]), the number of the first
//! frame ([`SEQUENCE_NOTE`]; MCAP keeps the lower 32 bits of each), and the clocks. `log_time` and
//! the stamp are the device clock plus [`CLOCK_NOTE`], which moves it to the wall clock of the
//! first frame; `publish_time` is the frame's wall time where [`WALL_NOTE`] is `known`.
//!
//! The file is written like a recording ([`super`]): chunks with their CRC, closed twice a second,
//! room reserved ahead. A part of a capture in parts is whole by itself.

use super::chunk::Kind;
use super::message::FrameHeader;
use super::open::{generator, publish_time};
use super::part::{Message, Part};
use super::split::{Grown, Names};
use super::{RecordingError, Target, WriterOptions, color};
use crate::frame::{Camera, ColorFrame, FrameTime};
use mcap::records::MessageHeader;
use std::collections::BTreeMap;

mod ros;
#[cfg(test)]
mod tests;

pub use ros::image_message;
pub(super) use ros::unpack;

/// Topic of the images.
pub const IMAGE_TOPIC: &str = "/depth/image_raw/compressedDepth";
/// Topic of the camera.
pub const INFO_TOPIC: &str = "/depth/camera_info";
/// Topic of the colour images.
pub const COLOR_TOPIC: &str = "/color/image_raw/compressed";
/// Channel metadata: the whole camera as JSON.
pub const CAMERA_NOTE: &str = "saint-live.camera";
/// Channel metadata: log time less this is the device clock, ns.
pub const CLOCK_NOTE: &str = "saint-live.clock_offset_ns";
/// Channel metadata: number of the first frame.
pub const SEQUENCE_NOTE: &str = "saint-live.first_sequence";
/// Channel metadata: `known` where publish times are the wall clock.
pub const WALL_NOTE: &str = "saint-live.wall_clock";

/// MCAP's profile of files that ROS 2 tools read.
pub(super) const PROFILE: &str = "ros2";

/// Number and times of an image, as the channel's notes and MCAP's header of the message have
/// them; the first image is the key. `None` where the notes do not say.
pub(super) fn header(
    notes: &BTreeMap<String, String>,
    message: &MessageHeader,
) -> Option<FrameHeader> {
    let first: u64 = notes.get(SEQUENCE_NOTE)?.parse().ok()?;
    let offset_ns: i64 = notes.get(CLOCK_NOTE)?.parse().ok()?;
    let ns = |time: u64| i64::try_from(time).unwrap_or(i64::MAX);
    // the numbers begin with the first one: below it the lower 32 bits have run over
    let low = u64::from(message.sequence);
    let number = first & !u64::from(u32::MAX) | low;
    let sequence = if number < first {
        number.saturating_add(1 << 32)
    } else {
        number
    };
    Some(FrameHeader {
        key: sequence == first,
        sequence,
        time: FrameTime {
            device_ns: ns(message.log_time).saturating_sub(offset_ns),
            wall_ns: match notes.get(WALL_NOTE).map(String::as_str) {
                Some("known") => ns(message.publish_time),
                _ => 0,
            },
        },
    })
}

/// What a raw capture has become.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawSummary {
    /// File, or "standard output"; the last of the parts.
    pub target: String,
    /// Files written.
    pub parts: u32,
    /// Frames in them.
    pub frames: u64,
    /// Their bytes.
    pub bytes: u64,
}

/// The channels of a part, known with its first frame.
#[derive(Clone, Copy)]
struct Channels {
    image: u16,
    color: Option<u16>,
    /// Added to the device clock, ns.
    offset_ns: i64,
    /// Device time of the first frame, ns.
    first_ns: i64,
}

/// Writes a raw capture. Dropped without [`finish`](Self::finish) it still finalises the file, but
/// nobody hears of an error.
pub struct RawWriter {
    part: Part,
    camera: Camera,
    options: WriterOptions,
    names: Option<Names>,
    channels: Option<Channels>,
    /// The newest colour image that came before the first frame and waits for it.
    early: Option<ColorFrame>,
    message: Vec<u8>,
    /// Parts that are complete: their number, frames, bytes.
    finished: (u32, u64, u64),
}

impl RawWriter {
    /// Opens the target and writes the container's beginning.
    ///
    /// # Errors
    /// [`RecordingError::Exists`], [`RecordingError::Unwritable`], [`RecordingError::NoParts`], or
    /// a write error.
    pub fn create(
        target: Target,
        camera: &Camera,
        options: &WriterOptions,
    ) -> Result<Self, RecordingError> {
        let mut names = options.split.map(|_| Names::new(&target)).transpose()?;
        let target = match &mut names {
            Some(names) => names.next().0,
            None => target,
        };
        Ok(Self {
            part: Part::create(target, options.sync, PROFILE)?,
            camera: camera.clone(),
            options: *options,
            names,
            channels: None,
            early: None,
            message: Vec::new(),
            finished: (0, 0, 0),
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
        self.turn_page(time, image.len())?;
        let (channels, first) = match self.channels {
            Some(channels) => (channels, false),
            None => (self.begin(sequence, time)?, true),
        };
        let mut message = std::mem::take(&mut self.message);
        message.clear();
        message.extend_from_slice(image);
        // each frame stands alone, but one key is enough for the tally
        let kind = Kind::Frame(
            "",
            FrameHeader {
                key: first,
                sequence,
                time,
            },
        );
        let stamp = (sequence, time, channels.offset_ns);
        let result = self.put((channels.image, IMAGE_TOPIC), stamp, kind, &mut message);
        self.message = message;
        result?;
        match self.early.take() {
            Some(color) => self.color(&color),
            None => Ok(()),
        }
    }

    /// Appends a colour image, its bytes untouched. Before the first frame the newest one waits
    /// for it, since that frame says what the clocks are.
    ///
    /// # Errors
    /// As [`frame`](Self::frame).
    pub fn color(&mut self, image: &ColorFrame) -> Result<(), RecordingError> {
        let Some(mut channels) = self.channels else {
            self.early = Some(image.clone());
            return Ok(());
        };
        let id = match channels.color {
            Some(id) => id,
            None => {
                let schema = (color::SCHEMA, "ros2msg", color::DEFINITION.as_bytes());
                let none = BTreeMap::new();
                let id = self.part.add_channel(COLOR_TOPIC, "cdr", schema, &none)?;
                channels.color = Some(id);
                self.channels = Some(channels);
                id
            }
        };
        let mut message = std::mem::take(&mut self.message);
        color::write(image, 0, &mut message);
        let stamp = (image.sequence, image.time, channels.offset_ns);
        let result = self.put((id, COLOR_TOPIC), stamp, Kind::Other, &mut message);
        self.message = message;
        result
    }

    /// Closes the chunk that is open if it is old enough.
    ///
    /// # Errors
    /// As [`frame`](Self::frame).
    pub fn idle(&mut self) -> Result<(), RecordingError> {
        let result = self.part.idle();
        result.map_err(|error| self.beside(error))
    }

    /// Writes the index and the end mark.
    ///
    /// # Errors
    /// As [`frame`](Self::frame); closed chunks stay readable then.
    pub fn finish(&mut self) -> Result<RawSummary, RecordingError> {
        self.finish_part()?;
        let (parts, frames, bytes) = self.finished;
        Ok(RawSummary {
            target: self.part.target.clone(),
            parts,
            frames,
            bytes,
        })
    }

    /// Frames that are safe whatever happens next.
    #[must_use]
    pub fn kept_frames(&self) -> u64 {
        self.finished.1 + self.part.kept_frames()
    }

    fn finish_part(&mut self) -> Result<(), RecordingError> {
        let result = self.part.finish();
        result.map_err(|error| self.beside(error))?;
        self.finished.0 += 1;
        self.finished.1 += self.part.kept_frames();
        self.finished.2 += self.part.kept_bytes;
        self.part.kept.clear();
        self.part.kept_bytes = 0;
        Ok(())
    }

    /// Begins a new part before a frame, where one is due.
    fn turn_page(&mut self, time: FrameTime, bytes: usize) -> Result<(), RecordingError> {
        let (Some(split), Some(names), Some(channels)) =
            (self.options.split, &mut self.names, self.channels)
        else {
            return Ok(());
        };
        let span = time.device_ns.saturating_sub(channels.first_ns);
        let grown = Grown {
            bytes: self.part.size(),
            group: bytes as u64,
            span_ns: u64::try_from(span).unwrap_or(0),
        };
        if !split.is_due(grown) {
            return Ok(());
        }
        let (target, _) = names.next();
        self.finish_part()?;
        self.channels = None;
        let next = Part::create(target, self.options.sync, PROFILE);
        self.part = next.map_err(|error| self.beside(error))?;
        Ok(())
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
            ("generator", generator()),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into();
        let schema = (color::SCHEMA, "ros2msg", color::DEFINITION.as_bytes());
        let image = self.part.add_channel(IMAGE_TOPIC, "cdr", schema, &notes)?;
        let schema = (ros::INFO_SCHEMA, "ros2msg", ros::INFO_DEFINITION.as_bytes());
        let none = BTreeMap::new();
        let info = self.part.add_channel(INFO_TOPIC, "cdr", schema, &none)?;
        let mut message = ros::info_message(&self.camera);
        let stamp = (sequence, time, offset_ns);
        self.put((info, INFO_TOPIC), stamp, Kind::Other, &mut message)?;
        // in a chunk of their own: whatever is lost later, the camera is known
        let closed = self.part.close_chunk();
        closed.map_err(|error| self.beside(error))?;
        Ok(*self.channels.insert(Channels {
            image,
            color: None,
            offset_ns,
            first_ns: time.device_ns,
        }))
    }

    /// Stamps a message and writes it.
    fn put(
        &mut self,
        (channel, topic): (u16, &str),
        (sequence, time, offset_ns): (u64, FrameTime, i64),
        kind: Kind<'_>,
        message: &mut [u8],
    ) -> Result<(), RecordingError> {
        let moved = time.device_ns.saturating_add(offset_ns);
        let log_time = u64::try_from(moved).unwrap_or(0);
        ros::stamp(message, log_time);
        let result = self.part.put(&Message {
            channel,
            topic,
            sequence: sequence as u32, // the lower 32 bits
            log_time,
            publish_time: publish_time(time, log_time),
            kind,
            data: message,
        });
        result.map_err(|error| self.beside(error))
    }

    /// An error of one part speaks for the whole capture.
    fn beside(&self, error: RecordingError) -> RecordingError {
        error.beside(self.finished.1, self.finished.2)
    }
}
