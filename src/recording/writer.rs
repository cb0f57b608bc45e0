//! Writing a recording: frames, colour and statistics of one camera or several, in one file or in
//! parts.

use super::message::{self, FrameHeader};
use super::open::{Open, Stream};
use super::part::Part;
use super::split::{Names, Split};
use super::topics::{self, Role};
use super::{RecordingError, Target, color};
use crate::codec::EncodedFrame;
use crate::frame::{Camera, ColorFrame, FrameTime};
use std::collections::BTreeMap;

/// When a recording's bytes are made to reach the disk itself. What has reached the system, with
/// each chunk, survives the end of the program in any case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sync {
    /// Once, when the file is finished: a power cut before may take what the system still held.
    #[default]
    End,
    /// With each chunk, twice a second: a power cut takes the open chunk only.
    Chunk,
}

/// How a recording is written.
#[derive(Clone, Copy, Debug, Default)]
pub struct WriterOptions {
    /// When bytes must be on the disk.
    pub sync: Sync,
    /// Write parts instead of one file.
    pub split: Option<Split>,
}

/// One camera of a recording.
#[derive(Clone, Debug)]
pub struct CameraStream {
    /// Its name: its topics are `NAME/saint`, `NAME/color` and so on. Empty for the only camera.
    pub name: String,
    /// The camera.
    pub camera: Camera,
    /// Extra facts about its stream (tolerance, source, options), as metadata of the `saint`
    /// channel. The names `camera`, `generator` and `part` are taken.
    pub notes: BTreeMap<String, String>,
}

/// What is in a finished recording.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct RecordingSummary {
    /// File or pipe; the last of the parts.
    pub target: String,
    /// Files written.
    pub parts: u32,
    /// Frames written.
    pub frames: u64,
    /// Key frames among them.
    pub key_frames: u64,
    /// Colour images written.
    pub color_frames: u64,
    /// Size of the recording, bytes.
    pub bytes: u64,
    /// Last frame's device time minus the first's, ns, of the camera with the most.
    pub duration_ns: i64,
}

/// Writes one recording. Dropped without [`finish`](Self::finish) it still finalises the file,
/// but nobody hears of an error.
pub struct RecordingWriter {
    streams: Vec<Stream>,
    options: WriterOptions,
    names: Option<Names>,
    current: Open,
    /// The part before, while some camera waits for its key frame to leave it.
    closing: Option<Open>,
    finished: Finished,
    message: Vec<u8>,
    /// In parts: the colour image of each camera that waits for the frame it came with, since that
    /// frame may begin a part.
    waiting: Vec<Option<ColorFrame>>,
}

/// Parts that are complete.
#[derive(Clone, Default)]
struct Finished {
    parts: u32,
    /// Frames by camera.
    kept: BTreeMap<String, u64>,
    key_frames: u64,
    color_frames: u64,
    bytes: u64,
}

impl RecordingWriter {
    /// Opens the target for one camera and writes the container's beginning: the camera is safe
    /// before the first frame comes.
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
            notes: BTreeMap::new(),
        };
        Self::create_rig(target, &[only], options)
    }

    /// Opens the target for several cameras, each with channels of its own; their numbers in
    /// [`frame_of`](Self::frame_of) are their places in `cameras`. The names must differ.
    ///
    /// # Errors
    /// As [`create`](Self::create).
    pub fn create_rig(
        target: Target,
        cameras: &[CameraStream],
        options: &WriterOptions,
    ) -> Result<Self, RecordingError> {
        let streams: Vec<_> = cameras
            .iter()
            .map(|stream| Stream {
                name: stream.name.clone(),
                camera: stream.camera.clone(),
                notes: stream.notes.clone(),
                lags: false,
                span_ns: None,
            })
            .collect();
        let mut names = options.split.map(|_| Names::new(&target)).transpose()?;
        let (target, number) = match &mut names {
            Some(names) => names.next(),
            None => (target, 0),
        };
        Ok(Self {
            current: Open::create(target, number, &streams, options)?,
            streams,
            options: *options,
            names,
            closing: None,
            finished: Finished::default(),
            message: Vec::new(),
            waiting: vec![None; cameras.len()],
        })
    }

    /// Appends one frame of the first camera.
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
        self.stream(camera)?;
        let header = FrameHeader {
            key: frame.key,
            sequence: frame.sequence,
            time: frame.time,
        };
        if header.key {
            self.turn_page(camera, header.time)?;
        }
        self.color_that_waits(camera)?;
        let mut message = std::mem::take(&mut self.message);
        message::write(frame, &mut message);
        let place = (camera, Role::Saint);
        let result = self.put(
            place,
            (header.sequence, header.time),
            Some(header),
            &message,
        );
        self.message = message;
        result?;
        let now_ns = header.time.device_ns;
        let span = &mut self.streams[camera].span_ns;
        *span = Some((span.map_or(now_ns, |(first, _)| first), now_ns));
        Ok(())
    }

    /// Appends one colour image of the first camera, its bytes untouched.
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
        self.stream(camera)?;
        if self.options.split.is_none() {
            return self.put_color(camera, frame);
        }
        self.color_that_waits(camera)?;
        self.waiting[camera] = Some(frame.clone());
        Ok(())
    }

    /// Writes the colour image that waits for the next frame of its camera.
    fn color_that_waits(&mut self, camera: usize) -> Result<(), RecordingError> {
        match self.waiting[camera].take() {
            Some(image) => self.put_color(camera, &image),
            None => Ok(()),
        }
    }

    fn put_color(&mut self, camera: usize, frame: &ColorFrame) -> Result<(), RecordingError> {
        let lags = self.stream(camera)?.lags;
        let stamp = self.page(lags).log_time(camera, frame.time, true);
        let mut message = std::mem::take(&mut self.message);
        color::write(frame, stamp, &mut message);
        let place = (camera, Role::Color);
        let result = self.put(place, (frame.sequence, frame.time), None, &message);
        self.message = message;
        result
    }

    /// Appends one set of statistics of the first camera, at the time of the frame they follow.
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
        self.stream(camera)?;
        let text = statistics.to_string();
        self.put((camera, Role::Statistics), (0, time), None, text.as_bytes())
    }

    /// Closes the chunk that is open if it is old enough. Call it while no frame comes, so that a
    /// stalled camera does not keep frames from the disk.
    ///
    /// # Errors
    /// As [`frame`](Self::frame).
    pub fn idle(&mut self) -> Result<(), RecordingError> {
        let result = self
            .closing
            .as_mut()
            .map_or(Ok(()), |open| open.part.idle());
        let result = result.and_then(|()| self.current.part.idle());
        result.map_err(|error| self.beside(error))
    }

    /// Writes the index and the end mark.
    ///
    /// # Errors
    /// As [`frame`](Self::frame); closed chunks stay readable then.
    pub fn finish(&mut self) -> Result<RecordingSummary, RecordingError> {
        for camera in 0..self.streams.len() {
            self.color_that_waits(camera)?;
        }
        self.close_lagging()?;
        let result = self.current.part.finish();
        result.map_err(|error| self.beside(error))?;
        let mut all = self.finished.clone();
        all.add(&self.current.part);
        let spans = self.streams.iter().filter_map(|stream| stream.span_ns);
        let durations = spans.map(|(first, last)| last.saturating_sub(first));
        Ok(RecordingSummary {
            target: self.current.part.target.clone(),
            parts: all.parts,
            frames: all.frames(),
            key_frames: all.key_frames,
            color_frames: all.color_frames,
            bytes: all.bytes,
            duration_ns: durations.max().unwrap_or(0),
        })
    }

    /// Frames that are safe whatever happens next.
    #[must_use]
    pub fn kept_frames(&self) -> u64 {
        let open = self.open_parts().map(Part::kept_frames);
        self.finished.frames() + open.sum::<u64>()
    }

    /// As [`kept_frames`](Self::kept_frames), of one camera of [`create_rig`](Self::create_rig).
    #[must_use]
    pub fn kept_frames_of(&self, camera: usize) -> u64 {
        let Some(stream) = self.streams.get(camera) else {
            return 0;
        };
        let kept = self.open_parts().map(|part| &part.kept);
        let kept = kept.chain([&self.finished.kept]);
        kept.filter_map(|kept| kept.get(&stream.name)).sum()
    }

    /// Bytes that are safe whatever happens next.
    #[must_use]
    pub fn kept_bytes(&self) -> u64 {
        let open = self.open_parts().map(|part| part.kept_bytes);
        self.finished.bytes + open.sum::<u64>()
    }

    fn open_parts(&self) -> impl Iterator<Item = &Part> {
        let open = self.closing.iter().chain([&self.current]);
        open.map(|open| &open.part)
    }

    fn stream(&self, camera: usize) -> Result<&Stream, RecordingError> {
        let none = || RecordingError::Container {
            target: self.current.part.target.clone(),
            what: format!("no camera number {camera}, it has {}", self.streams.len()),
        };
        self.streams.get(camera).ok_or_else(none)
    }

    /// At a key frame of `camera`: begins a new part where one is due, or lets the camera leave
    /// the part before.
    fn turn_page(&mut self, camera: usize, time: FrameTime) -> Result<(), RecordingError> {
        if std::mem::take(&mut self.streams[camera].lags) {
            if self.streams.iter().all(|stream| !stream.lags) {
                self.close_lagging()?;
            }
            return Ok(());
        }
        let (Some(split), Some(names)) = (self.options.split, &mut self.names) else {
            return Ok(());
        };
        let grown = self.current.grown(camera, time.device_ns);
        if !grown.is_some_and(|grown| split.is_due(grown)) {
            return Ok(());
        }
        let (target, number) = names.next();
        // a camera that fell silent does not keep the part before the last open
        self.close_lagging()?;
        let next = match Open::create(target, number, &self.streams, &self.options) {
            Ok(next) => next,
            Err(error) => {
                // the part that is open ends well
                self.current.part.finish()?;
                return Err(error.beside(self.kept_frames(), self.kept_bytes()));
            }
        };
        self.closing = Some(std::mem::replace(&mut self.current, next));
        for (n, stream) in self.streams.iter_mut().enumerate() {
            stream.lags = n != camera;
        }
        if self.streams.len() == 1 {
            self.close_lagging()?;
        }
        Ok(())
    }

    /// Completes the part before, where it is still open.
    fn close_lagging(&mut self) -> Result<(), RecordingError> {
        for stream in &mut self.streams {
            stream.lags = false;
        }
        let Some(mut open) = self.closing.take() else {
            return Ok(());
        };
        let result = open.part.finish();
        self.finished.add(&open.part);
        result.map_err(|error| self.beside(error))
    }

    /// The part a camera's messages go to.
    fn page(&mut self, lags: bool) -> &mut Open {
        match &mut self.closing {
            Some(open) if lags => open,
            _ => &mut self.current,
        }
    }

    fn put(
        &mut self,
        (camera, role): (usize, Role),
        stamp: (u64, FrameTime),
        header: Option<FrameHeader>,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let stream = &self.streams[camera];
        let open = match &mut self.closing {
            Some(open) if stream.lags => open,
            _ => &mut self.current,
        };
        let result = open.put(stream, (camera, role), stamp, header, data);
        result.map_err(|error| self.beside(error))
    }

    /// An error of one part speaks for the whole recording.
    fn beside(&self, error: RecordingError) -> RecordingError {
        error.beside(self.finished.frames(), self.finished.bytes)
    }
}

impl Finished {
    fn frames(&self) -> u64 {
        self.kept.values().sum()
    }

    fn add(&mut self, part: &Part) {
        let tally = &part.tally;
        let color = tally.channels.iter().filter(|(topic, _)| {
            let (camera, _) = topics::split(topic);
            **topic == Role::Color.topic(camera)
        });
        self.parts += 1;
        for (camera, frames) in &part.kept {
            *self.kept.entry(camera.clone()).or_default() += frames;
        }
        self.key_frames += tally
            .streams
            .values()
            .map(|stream| stream.key_frames.len() as u64)
            .sum::<u64>();
        self.color_frames += color.map(|(_, traffic)| traffic.messages).sum::<u64>();
        self.bytes += part.kept_bytes;
    }
}
