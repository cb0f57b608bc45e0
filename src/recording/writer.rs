//! Writing a recording: frames, colour and statistics into chunks that are safe once closed.

use super::calibration::{
    CALIBRATION_SCHEMA, CAMERA_SCHEMA, calibration, calibration_schema, camera_schema, camera_text,
};
use super::message::{self, FrameHeader};
use super::sink::Sink;
use super::stream::{CameraStream, Stream};
use super::tally;
use super::{
    CALIBRATION_TOPIC, CAMERA_TOPIC, COLOR_TOPIC, MAX_MESSAGE, RecordingError, SAINT_ENCODING,
    SAINT_TOPIC, STATISTICS_TOPIC, Target, color,
};
use crate::codec::EncodedFrame;
use crate::frame::{Camera, ColorFrame, FrameTime};
use mcap::McapError;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A chunk is closed when its frames span this much stream time, ns.
const CHUNK_STREAM_NS: i64 = 1_000_000_000;
/// A chunk is closed when it is this old.
const CHUNK_AGE: Duration = Duration::from_secs(1);
/// A chunk is closed when it holds this many bytes.
const CHUNK_BYTES: usize = 4 << 20;

/// What a recording says of itself beside the camera.
#[derive(Clone, Debug, Default)]
pub struct WriterOptions {
    /// Extra facts about the stream (tolerance, source, options), as metadata of the `saint`
    /// channel. The names `camera` and `generator` are taken.
    pub notes: BTreeMap<String, String>,
}

/// What is in a finished recording.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct RecordingSummary {
    /// File or pipe.
    pub target: String,
    /// Frames written.
    pub frames: u64,
    /// Key frames among them.
    pub key_frames: u64,
    /// Colour images written.
    pub color_frames: u64,
    /// Size of the recording, bytes.
    pub bytes: u64,
    /// Last frame's device time minus the first's, ns.
    pub duration_ns: i64,
}

/// Writes one recording. Dropped without [`finish`](Self::finish) it still finalises the file,
/// but nobody hears of an error.
pub struct RecordingWriter {
    /// `None` once finished or failed.
    container: Option<mcap::Writer<NoSeek<Sink>>>,
    target: String,
    /// One per camera.
    streams: Vec<Stream>,
    chunk: Chunk,
    kept_frames: u64,
    kept_bytes: u64,
    /// Bytes the sink has handed to the system.
    written: Arc<AtomicU64>,
    message: Vec<u8>,
}

/// The chunk that is open.
#[derive(Default)]
struct Chunk {
    /// When its first message came; `None` while it is empty.
    since: Option<Instant>,
    /// Camera and device time (ns) of its first frame. Other messages, and other cameras, may
    /// keep clocks of their own.
    first: Option<(usize, i64)>,
    bytes: usize,
}

impl Chunk {
    /// Whether the chunk must be closed before a message of `bytes` goes in.
    fn is_full(&self, kind: Kind, bytes: usize, now: Instant) -> bool {
        let Some(since) = self.since else {
            return false;
        };
        let span = match (kind, self.first) {
            (Kind::Key(at) | Kind::Predicted(at), Some(first)) if at.0 == first.0 => {
                at.1.saturating_sub(first.1)
            }
            _ => 0,
        };
        let span = span.saturating_abs();
        let age = now.saturating_duration_since(since);
        let early = matches!(kind, Kind::Key(_)) && span >= CHUNK_STREAM_NS / 2;
        span >= CHUNK_STREAM_NS || age >= CHUNK_AGE || self.bytes + bytes > CHUNK_BYTES || early
    }
}

impl RecordingWriter {
    /// Opens the target and writes the container's beginning: the camera is safe before the
    /// first frame comes.
    ///
    /// # Errors
    /// [`RecordingError::Exists`], [`RecordingError::Unwritable`], or a write error.
    pub fn create(
        target: Target,
        camera: &Camera,
        options: &WriterOptions,
    ) -> Result<Self, RecordingError> {
        let only = CameraStream {
            name: String::new(),
            camera: camera.clone(),
            notes: options.notes.clone(),
        };
        Self::create_rig(target, &[only])
    }

    /// Opens the target for several cameras, each with channels of its own; their numbers in
    /// [`frame_of`](Self::frame_of) are their places in `cameras`. The names must differ, and the
    /// only camera of a recording may have none.
    ///
    /// # Errors
    /// As [`create`](Self::create).
    pub fn create_rig(target: Target, cameras: &[CameraStream]) -> Result<Self, RecordingError> {
        let name = target.name();
        let sink = Sink::open(target)?;
        let written = sink.written();
        let container = mcap::WriteOptions::new()
            .library(generator())
            .chunk_size(None) // closed here, by time and size
            .compression(None)
            .disable_seeking(true)
            .create(NoSeek::new(sink))
            .map_err(|e| write_error(e, &name, 0, 0))?;
        let mut writer = Self {
            container: Some(container),
            target: name,
            streams: Vec::new(),
            chunk: Chunk::default(),
            kept_frames: 0,
            kept_bytes: 0,
            written,
            message: Vec::new(),
        };
        for camera in cameras {
            writer.begin(camera)?;
        }
        writer.open_chunk();
        writer.close_chunk()?;
        Ok(writer)
    }

    /// Channels every camera has, in the first chunk.
    fn begin(&mut self, camera: &CameraStream) -> Result<(), RecordingError> {
        let mut stream = Stream::new(&camera.name, &camera.camera);
        let mut facts = camera.notes.clone();
        facts.insert("generator".to_owned(), generator());
        facts.insert("camera".to_owned(), camera_text(&camera.camera));
        let schema = ("saint-live.frame", "text", SAINT_SCHEMA.to_owned());
        let topic = stream.topic(SAINT_TOPIC);
        stream.saint = self.add_channel(&topic, SAINT_ENCODING, schema, &facts)?;
        stream.calibration = self.add_json(
            &stream.topic(CALIBRATION_TOPIC),
            CALIBRATION_SCHEMA,
            &calibration_schema().to_string(),
        )?;
        stream.camera_channel = self.add_json(
            &stream.topic(CAMERA_TOPIC),
            CAMERA_SCHEMA,
            &camera_schema().to_string(),
        )?;
        self.streams.push(stream);
        Ok(())
    }

    /// Appends one frame.
    ///
    /// # Errors
    /// A write error says how many frames are safe; the recording is closed by it.
    pub fn frame(&mut self, frame: &EncodedFrame) -> Result<(), RecordingError> {
        self.frame_of(0, frame)
    }

    /// Appends one frame of a camera, by its place in [`create_rig`](Self::create_rig).
    ///
    /// # Errors
    /// As [`frame`](Self::frame); [`RecordingError::Container`] where there is no such camera.
    pub fn frame_of(&mut self, camera: usize, frame: &EncodedFrame) -> Result<(), RecordingError> {
        let stream = self.stream(camera)?;
        stream.set_clock(frame.time);
        let saint = stream.saint;
        let mut message = std::mem::take(&mut self.message);
        message::write(frame, &mut message);
        let header = FrameHeader {
            key: frame.key,
            sequence: frame.sequence,
            time: frame.time,
        };
        let kind = if header.key {
            Kind::Key((camera, header.time.device_ns))
        } else {
            Kind::Predicted((camera, header.time.device_ns))
        };
        let result = self.put(
            camera,
            saint,
            SAINT_TOPIC,
            (header.sequence, header.time),
            kind,
            &message,
        );
        if result.is_ok() {
            self.stream(camera)?.tally.frame(&header);
        }
        self.message = message;
        result
    }

    /// Appends one colour image, its bytes untouched.
    ///
    /// # Errors
    /// As [`frame`](Self::frame).
    pub fn color(&mut self, frame: &ColorFrame) -> Result<(), RecordingError> {
        self.color_of(0, frame)
    }

    /// Appends one colour image that belongs to a camera of [`create_rig`](Self::create_rig).
    ///
    /// # Errors
    /// As [`frame_of`](Self::frame_of).
    pub fn color_of(&mut self, camera: usize, frame: &ColorFrame) -> Result<(), RecordingError> {
        let stream = self.stream(camera)?;
        stream.set_clock(frame.time);
        let stamp = stream.log_time(frame.time);
        let channel = match stream.color {
            Some(channel) => channel,
            None => {
                let topic = stream.topic(COLOR_TOPIC);
                let schema = (color::SCHEMA, "ros2msg", color::DEFINITION.to_owned());
                let channel = self.add_channel(&topic, "cdr", schema, &BTreeMap::new())?;
                *self.stream(camera)?.color.insert(channel)
            }
        };
        let mut message = std::mem::take(&mut self.message);
        color::write(frame, stamp, &mut message);
        let result = self.put(
            camera,
            channel,
            COLOR_TOPIC,
            (frame.sequence, frame.time),
            Kind::Other,
            &message,
        );
        self.message = message;
        result
    }

    /// Appends one set of statistics, at the time of the frame they follow.
    ///
    /// # Errors
    /// As [`frame`](Self::frame).
    pub fn statistics(
        &mut self,
        statistics: &serde_json::Value,
        time: FrameTime,
    ) -> Result<(), RecordingError> {
        self.statistics_of(0, statistics, time)
    }

    /// Appends one set of statistics of a camera of [`create_rig`](Self::create_rig).
    ///
    /// # Errors
    /// As [`frame_of`](Self::frame_of).
    pub fn statistics_of(
        &mut self,
        camera: usize,
        statistics: &serde_json::Value,
        time: FrameTime,
    ) -> Result<(), RecordingError> {
        let stream = self.stream(camera)?;
        let channel = match stream.statistics {
            Some(channel) => channel,
            None => {
                let topic = stream.topic(STATISTICS_TOPIC);
                let schema = r#"{"title":"saint-live.statistics","type":"object"}"#;
                let channel = self.add_json(&topic, "saint-live.statistics", schema)?;
                *self.stream(camera)?.statistics.insert(channel)
            }
        };
        let text = statistics.to_string();
        self.put(
            camera,
            channel,
            STATISTICS_TOPIC,
            (0, time),
            Kind::Other,
            text.as_bytes(),
        )
    }

    /// Closes the chunk that is open if it is a second old. Call it while no frame comes, so that
    /// a stalled camera does not keep frames from the disk.
    ///
    /// # Errors
    /// As [`frame`](Self::frame).
    pub fn idle(&mut self) -> Result<(), RecordingError> {
        match self.chunk.since {
            Some(since) if since.elapsed() >= CHUNK_AGE => self.close_chunk(),
            _ => Ok(()),
        }
    }

    /// Writes the index and the end mark.
    ///
    /// # Errors
    /// As [`frame`](Self::frame); closed chunks stay readable then.
    pub fn finish(mut self) -> Result<RecordingSummary, RecordingError> {
        self.finalise()?;
        let tallies = || self.streams.iter().map(|stream| &stream.tally);
        Ok(RecordingSummary {
            target: self.target.clone(),
            frames: self.frames(),
            key_frames: tallies().map(|t| t.key_frames.len() as u64).sum(),
            color_frames: tallies()
                .filter_map(|t| t.channels.get(COLOR_TOPIC))
                .map(|traffic| traffic.messages)
                .sum(),
            bytes: self.kept_bytes,
            duration_ns: tallies()
                .map(|t| t.last.device_ns.saturating_sub(t.first.device_ns))
                .max()
                .unwrap_or(0),
        })
    }

    /// Frames that are safe whatever happens next.
    #[must_use]
    pub fn kept_frames(&self) -> u64 {
        self.kept_frames
    }

    /// Bytes that are safe whatever happens next.
    #[must_use]
    pub fn kept_bytes(&self) -> u64 {
        self.kept_bytes
    }

    fn finalise(&mut self) -> Result<(), RecordingError> {
        if self.chunk.since.is_some() {
            self.close_chunk()?;
        }
        let index = Metadata {
            name: tally::RECORD.to_owned(),
            metadata: self
                .streams
                .iter()
                .flat_map(|stream| stream.tally.to_metadata(&stream.prefix))
                .collect(),
        };
        self.with(|container| {
            container.write_metadata(&index)?;
            container.finish().map(|_| ())
        })?;
        let Some(container) = self.container.take() else {
            return Ok(());
        };
        let mut sink = container.into_inner().into_inner();
        let end = sink.flush().and_then(|()| sink.sync());
        if let Err(source) = end {
            sink.keep(self.kept_bytes);
            return Err(self.write_error(source.into()));
        }
        self.kept_bytes = self.written.load(Ordering::Relaxed);
        Ok(())
    }

    fn stream(&mut self, camera: usize) -> Result<&mut Stream, RecordingError> {
        let cameras = self.streams.len();
        self.streams
            .get_mut(camera)
            .ok_or_else(|| RecordingError::Container {
                target: self.target.clone(),
                what: format!("no camera number {camera}, it has {cameras}"),
            })
    }

    /// Frames of all cameras.
    fn frames(&self) -> u64 {
        self.streams.iter().map(|stream| stream.tally.frames).sum()
    }

    fn open_chunk(&mut self) {
        for stream in &mut self.streams {
            stream.tally.open_chunk();
        }
    }

    /// One message into the open chunk, after closing it if it is full.
    fn put(
        &mut self,
        camera: usize,
        channel: u16,
        topic: &'static str,
        (sequence, time): (u64, FrameTime),
        kind: Kind,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        if data.len() > MAX_MESSAGE {
            return Err(RecordingError::TooLarge {
                target: self.target.clone(),
                topic,
                bytes: data.len(),
                limit: MAX_MESSAGE,
            });
        }
        let now = Instant::now();
        if self.chunk.is_full(kind, data.len(), now) {
            self.close_chunk()?;
        }
        if self.chunk.since.is_none() {
            self.open_chunk();
            self.chunk.since = Some(now);
        }
        if let Kind::Key(at) | Kind::Predicted(at) = kind {
            self.chunk.first.get_or_insert(at);
        }
        if !self.stream(camera)?.described {
            self.describe_camera(camera, time)?;
        }
        self.append(camera, channel, topic, (sequence, time), data)
    }

    /// The camera's two messages, at the first message's time.
    fn describe_camera(&mut self, camera: usize, time: FrameTime) -> Result<(), RecordingError> {
        let stream = self.stream(camera)?;
        stream.described = true;
        let (first, second) = (stream.calibration, stream.camera_channel);
        let text = calibration(&stream.camera, stream.log_time(time)).to_string();
        let whole = camera_text(&stream.camera);
        self.append(camera, first, CALIBRATION_TOPIC, (0, time), text.as_bytes())?;
        self.append(camera, second, CAMERA_TOPIC, (0, time), whole.as_bytes())
    }

    fn append(
        &mut self,
        camera: usize,
        channel_id: u16,
        topic: &'static str,
        (sequence, time): (u64, FrameTime),
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let log_time = self.stream(camera)?.log_time(time);
        let header = MessageHeader {
            channel_id,
            sequence: sequence as u32, // MCAP's field; the whole number stands in our header
            log_time,
            publish_time: match u64::try_from(time.wall_ns) {
                Ok(wall) if wall > 0 => wall,
                _ => log_time,
            },
        };
        self.with(|container| container.write_to_known_channel(&header, data))?;
        self.stream(camera)?.tally.message(topic, data.len());
        self.chunk.bytes += data.len();
        Ok(())
    }

    fn close_chunk(&mut self) -> Result<(), RecordingError> {
        self.with(mcap::Writer::flush)?;
        self.chunk = Chunk::default();
        self.kept_frames = self.frames();
        self.kept_bytes = self.written.load(Ordering::Relaxed);
        Ok(())
    }

    fn add_json(&mut self, topic: &str, name: &str, schema: &str) -> Result<u16, RecordingError> {
        let schema = (name, "jsonschema", schema.to_owned());
        self.add_channel(topic, "json", schema, &BTreeMap::new())
    }

    fn add_channel(
        &mut self,
        topic: &str,
        encoding: &str,
        (name, schema_encoding, schema): (&str, &str, String),
        metadata: &BTreeMap<String, String>,
    ) -> Result<u16, RecordingError> {
        self.with(|container| {
            let id = container.add_schema(name, schema_encoding, schema.as_bytes())?;
            container.add_channel(id, topic, encoding, metadata)
        })
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

impl Drop for RecordingWriter {
    fn drop(&mut self) {
        if self.container.is_some() {
            let _ = self.finalise();
        }
    }
}

/// What the chunking rule wants to know of a message: a frame's camera and device time, ns.
#[derive(Clone, Copy)]
enum Kind {
    Key((usize, i64)),
    Predicted((usize, i64)),
    Other,
}

/// The `saint` channel's schema: where to read on.
const SAINT_SCHEMA: &str = "\
One frame of a saint-live stream, little endian:
u8 kind ('K' decodes alone, 'P' needs the frame before it), u64 sequence, i64 device clock ns,
i64 wall clock ns, then the payload that src/codec/FORMAT.md of saint-live describes.
";

fn generator() -> String {
    concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned()
}

pub(super) fn write_error(
    error: McapError,
    target: &str,
    frames: u64,
    bytes: u64,
) -> RecordingError {
    let target = target.to_owned();
    match error {
        McapError::Io(source) => match source.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => RecordingError::DiskFull {
                target,
                frames,
                bytes,
                source,
            },
            io::ErrorKind::BrokenPipe => RecordingError::Closed {
                target,
                frames,
                bytes,
                source,
            },
            _ => RecordingError::Write {
                target,
                frames,
                bytes,
                source,
            },
        },
        other => RecordingError::Container {
            target,
            what: other.to_string(),
        },
    }
}
