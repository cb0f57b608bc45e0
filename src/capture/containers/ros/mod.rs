//! Depth images out of ROS messages, whatever file the messages lie in.
//!
//! [`RosImages::open`] looks through the beginning of the file for topics with depth, picks one,
//! and finds the camera that belongs to it: `…/camera_info` beside the images (RealSense:
//! `…/info/camera_info`) and RealSense's `…/option/Depth_Units/value` above them.

mod fields;
mod image;
mod messages;
mod survey;

pub(super) use fields::{Fields, Layout};
pub(super) use messages::Kind;

use super::{About, Container, DepthImage, Stamp, damaged};
use crate::capture::CaptureError;
use crate::capture::sequences::SequenceOptions;
use crate::frame::{ColorFrame, FrameTime};
use crate::recording::raw::{CLOCK_NOTE, COLOR_TOPIC, SEQUENCE_NOTE, WALL_NOTE};
use messages::{CompressedImage, Image};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use survey::Survey;

/// A stream of messages of one type.
#[derive(Clone, Debug)]
pub(super) struct Channel {
    pub(super) topic: String,
    pub(super) kind: Kind,
    pub(super) layout: Layout,
    /// MCAP only.
    pub(super) metadata: BTreeMap<String, String>,
}

/// One message, its bytes still in the file's buffer.
pub(super) struct Message<'a> {
    pub(super) channel: &'a Channel,
    /// The log's own numbering, where it has one.
    pub(super) sequence: Option<u32>,
    pub(super) log_ns: u64,
    pub(super) publish_ns: u64,
    pub(super) data: &'a [u8],
}

/// A file of messages, in the order of the file.
pub(super) trait MessageLog: Send {
    /// The next message of a kind that is read here; `None` at the end.
    ///
    /// # Errors
    /// The file is damaged or cut here; what follows may still be read by the next call.
    fn next(&mut self) -> Result<Option<Message<'_>>, CaptureError>;
}

/// Depth images of one topic.
pub(super) struct RosImages {
    log: Box<dyn MessageLog>,
    path: PathBuf,
    topic: String,
    about: About,
    raw: Option<RawClock>,
    scratch: Vec<u8>,
    images: u64,
    /// The newest colour image between the last two depth images, of a raw capture.
    color: Option<ColorFrame>,
}

/// How a raw capture of this program keeps numbers and times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct RawClock {
    offset_ns: i64,
    wall: bool,
    /// The number given last.
    last: u64,
}

impl RawClock {
    fn of(notes: &BTreeMap<String, String>) -> Option<Self> {
        Some(Self {
            offset_ns: notes.get(CLOCK_NOTE)?.parse().ok()?,
            wall: notes.get(WALL_NOTE).is_some_and(|text| text == "known"),
            last: notes.get(SEQUENCE_NOTE)?.parse().ok()?,
        })
    }

    /// The whole number whose lower 32 bits are `sequence`, not below the last.
    fn number(&mut self, sequence: u32) -> u64 {
        let high = self.last & !u64::from(u32::MAX);
        let number = high | u64::from(sequence);
        self.last = if number < self.last {
            number.wrapping_add(1 << 32)
        } else {
            number
        };
        self.last
    }

    /// A colour image of the capture; its number is as MCAP keeps it.
    fn color(self, message: &Message<'_>) -> Option<ColorFrame> {
        let image = CompressedImage::read(message.data, message.channel.layout)?;
        Some(ColorFrame {
            sequence: message.sequence.map_or(0, u64::from),
            time: self.time(message),
            format: image.format.to_owned(),
            data: image.data.to_vec(),
        })
    }

    fn time(self, message: &Message<'_>) -> FrameTime {
        let ns = |time: u64| i64::try_from(time).unwrap_or(i64::MAX);
        FrameTime {
            device_ns: ns(message.log_ns).saturating_sub(self.offset_ns),
            wall_ns: if self.wall { ns(message.publish_ns) } else { 0 },
        }
    }
}

impl RosImages {
    /// Surveys the file and opens it again at its beginning.
    pub(super) fn open(
        path: &Path,
        options: &SequenceOptions,
        log: impl Fn() -> Result<Box<dyn MessageLog>, CaptureError>,
    ) -> Result<Self, CaptureError> {
        let found = Survey::of(log()?.as_mut(), options.topic.as_deref(), path)?.choose(path)?;
        Ok(Self {
            log: log()?,
            path: path.to_owned(),
            raw: RawClock::of(&found.notes),
            topic: found.topic,
            about: found.about,
            scratch: Vec::new(),
            images: 0,
            color: None,
        })
    }
}

impl Container for RosImages {
    fn about(&self) -> &About {
        &self.about
    }

    fn take_color(&mut self) -> Option<ColorFrame> {
        self.color.take()
    }

    fn next(&mut self, out: &mut DepthImage) -> Result<bool, CaptureError> {
        let message = loop {
            match self.log.next()? {
                None => return Ok(false),
                Some(message) if message.channel.topic == self.topic => break message,
                Some(message) => {
                    if let Some(raw) = self.raw
                        && message.channel.topic == COLOR_TOPIC
                    {
                        self.color = raw.color(&message).or(self.color.take());
                    }
                }
            }
        };
        let number = self.images;
        self.images += 1;
        let channel = message.channel;
        let broken = |what: String| {
            let what = format!("{} {number} of {}: {what}", channel.kind.name(), self.topic);
            damaged(&self.path, what)
        };
        let early = || broken("its fields end too early".to_owned());
        let header = match channel.kind {
            Kind::CompressedImage => {
                let read = CompressedImage::read(message.data, channel.layout);
                let read = read.ok_or_else(early)?;
                image::decode_compressed(&read, &mut self.scratch, out).map_err(broken)?;
                read.header
            }
            _ => {
                let read = Image::read(message.data, channel.layout).ok_or_else(early)?;
                image::decode(&read, out).map_err(broken)?;
                read.header
            }
        };
        (out.number, out.time) = match &mut self.raw {
            Some(raw) => (
                message.sequence.map(|sequence| raw.number(sequence)),
                Stamp::Exact(raw.time(&message)),
            ),
            None => {
                // a header without a stamp: when it was logged is the next best
                let logged = i64::try_from(message.log_ns).unwrap_or(i64::MAX);
                let ns = Some(header.stamp_ns).filter(|ns| *ns != 0);
                (
                    header.sequence.map(u64::from),
                    Stamp::Clock(ns.unwrap_or(logged)),
                )
            }
        };
        Ok(true)
    }
}
