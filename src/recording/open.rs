//! A part of a recording that is open, and the channels its cameras have in it.

use super::calibration::{
    CALIBRATION_SCHEMA, CAMERA_SCHEMA, calibration, calibration_schema, camera_schema, camera_text,
};
use super::chunk::Kind;
use super::message::FrameHeader;
use super::part::{Message, Part};
use super::split::Grown;
use super::topics::Role;
use super::{RecordingError, SAINT_ENCODING, Target, WriterOptions, color};
use crate::frame::{Camera, FrameTime};
use std::collections::BTreeMap;

/// One camera while it is written.
pub(super) struct Stream {
    pub name: String,
    pub camera: Camera,
    pub notes: BTreeMap<String, String>,
    /// Its frames still go to the part that is closing.
    pub lags: bool,
    /// Times of its first and last frame, ns.
    pub span_ns: Option<(i64, i64)>,
}

/// A part and the numbers of its channels.
pub(super) struct Open {
    pub part: Part,
    channels: BTreeMap<(usize, Role), u16>,
    /// For each camera: added to its device clock to make a log time; set by its first image.
    clock_offsets: Vec<Option<i64>>,
    /// For each camera: device time of its first frame in the part, ns.
    firsts_ns: Vec<Option<i64>>,
    /// Size at the last key frame, and the most bytes between two.
    key_at: u64,
    group: u64,
}

impl Open {
    /// Opens a part with the channels every camera has, in a chunk of their own.
    pub fn create(
        target: Target,
        number: u32,
        streams: &[Stream],
        options: &WriterOptions,
    ) -> Result<Self, RecordingError> {
        let mut open = Self {
            part: Part::create(target, options.sync, "")?,
            channels: BTreeMap::new(),
            clock_offsets: vec![None; streams.len()],
            firsts_ns: vec![None; streams.len()],
            key_at: 0,
            group: 0,
        };
        for (n, stream) in streams.iter().enumerate() {
            let mut facts = stream.notes.clone();
            facts.insert("generator".to_owned(), generator());
            facts.insert("camera".to_owned(), camera_text(&stream.camera));
            if number > 0 {
                facts.insert("part".to_owned(), number.to_string());
            }
            let schema = ("saint-live.frame", "text", SAINT_SCHEMA.as_bytes());
            let topic = Role::Saint.topic(&stream.name);
            let id = open
                .part
                .add_channel(&topic, SAINT_ENCODING, schema, &facts)?;
            open.channels.insert((n, Role::Saint), id);
            open.channel(stream, (n, Role::Calibration))?;
            open.channel(stream, (n, Role::Camera))?;
        }
        open.part.close_chunk()?;
        open.key_at = open.part.size();
        Ok(open)
    }

    /// Number of a channel, which is added where it is new.
    fn channel(&mut self, stream: &Stream, place: (usize, Role)) -> Result<u16, RecordingError> {
        if let Some(id) = self.channels.get(&place) {
            return Ok(*id);
        }
        let json = |name, text: String| (name, "jsonschema", text);
        let (name, schema_encoding, schema) = match place.1 {
            Role::Saint => ("saint-live.frame", "text", SAINT_SCHEMA.to_owned()),
            Role::Calibration => json(CALIBRATION_SCHEMA, calibration_schema().to_string()),
            Role::Camera => json(CAMERA_SCHEMA, camera_schema().to_string()),
            Role::Statistics => json(
                "saint-live.statistics",
                r#"{"title":"saint-live.statistics","type":"object"}"#.to_owned(),
            ),
            Role::Color => (color::SCHEMA, "ros2msg", color::DEFINITION.to_owned()),
        };
        let encoding = match place.1 {
            Role::Saint => SAINT_ENCODING,
            Role::Color => "cdr",
            _ => "json",
        };
        let topic = place.1.topic(&stream.name);
        let schema = (name, schema_encoding, schema.as_bytes());
        let id = self
            .part
            .add_channel(&topic, encoding, schema, &BTreeMap::new())?;
        self.channels.insert(place, id);
        Ok(id)
    }

    pub fn put(
        &mut self,
        stream: &Stream,
        (camera, role): (usize, Role),
        (sequence, time): (u64, FrameTime),
        header: Option<FrameHeader>,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let is_image = matches!(role, Role::Saint | Role::Color);
        let log_time = self.log_time(camera, time, is_image);
        self.describe_camera(stream, camera, time, log_time)?;
        let channel = self.channel(stream, (camera, role))?;
        self.part.put(&Message {
            channel,
            topic: &role.topic(&stream.name),
            sequence: sequence as u32, // the whole number stands in the frame's own header
            log_time,
            publish_time: publish_time(time, log_time),
            kind: header.map_or(Kind::Other, |header| Kind::Frame(&stream.name, header)),
            data,
        })?;
        if header.is_some() {
            self.firsts_ns[camera].get_or_insert(time.device_ns);
        }
        Ok(())
    }

    /// The camera's two messages, before its first message and at its time.
    fn describe_camera(
        &mut self,
        stream: &Stream,
        camera: usize,
        time: FrameTime,
        log_time: u64,
    ) -> Result<(), RecordingError> {
        let topic = Role::Camera.topic(&stream.name);
        if self.part.tally.channels.contains_key(&topic) {
            return Ok(());
        }
        let texts = [
            (
                Role::Calibration,
                calibration(&stream.camera, log_time).to_string(),
            ),
            (Role::Camera, camera_text(&stream.camera)),
        ];
        for (role, text) in texts {
            let channel = self.channel(stream, (camera, role))?;
            self.part.put(&Message {
                channel,
                topic: &role.topic(&stream.name),
                sequence: 0,
                log_time,
                publish_time: publish_time(time, log_time),
                kind: Kind::Other,
                data: text.as_bytes(),
            })?;
        }
        Ok(())
    }

    /// MCAP's log time: the device clock, moved to the wall clock of the camera's first image.
    pub fn log_time(&mut self, camera: usize, time: FrameTime, is_image: bool) -> u64 {
        let offset = match time.wall_ns {
            0 => 0,
            wall => wall.saturating_sub(time.device_ns),
        };
        let known = &mut self.clock_offsets[camera];
        let offset = if is_image {
            *known.get_or_insert(offset)
        } else {
            known.unwrap_or(0)
        };
        u64::try_from(time.device_ns.saturating_add(offset)).unwrap_or(0)
    }

    /// What the part has grown to before a key frame of `camera` at `device_ns`; `None` where it
    /// has no frame of it yet.
    pub fn grown(&mut self, camera: usize, device_ns: i64) -> Option<Grown> {
        let first = self.firsts_ns[camera]?;
        let bytes = self.part.size();
        self.group = self.group.max(bytes.saturating_sub(self.key_at));
        self.key_at = bytes;
        Some(Grown {
            bytes,
            group: self.group,
            span_ns: u64::try_from(device_ns.saturating_sub(first)).unwrap_or(0),
        })
    }
}

/// The wall time, where it is known.
pub(super) fn publish_time(time: FrameTime, log_time: u64) -> u64 {
    match u64::try_from(time.wall_ns) {
        Ok(wall) if wall > 0 => wall,
        _ => log_time,
    }
}

/// The `saint` channel's schema: where to read on.
const SAINT_SCHEMA: &str = "\
One frame of a saint-live stream, little endian:
u8 kind ('K' decodes alone, 'P' needs the frame before it), u64 sequence, i64 device clock ns,
i64 wall clock ns, then the payload that src/codec/FORMAT.md of saint-live describes.
";

/// What wrote the file.
pub(super) fn generator() -> String {
    concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned()
}
