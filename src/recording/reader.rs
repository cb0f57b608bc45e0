//! Reading a recording: frames in order, from any key frame, through damage.

use super::container::Source;
use super::index::{Fault, Index, Loaded};
use super::info::{ChannelInfo, Damage, Info};
use super::tally::Traffic;
use super::{CONTACT_MAP_NOTE, RecordingError, SAINT_TOPIC, color, message};
use crate::codec::{Domain, EncodedFrame};
use crate::frame::{Camera, ColorFrame, FrameTime};
use std::collections::BTreeMap;
use std::path::Path;

/// Where [`RecordingReader::seek`] has gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seek {
    /// The frame that is read next: a key frame, unless the recording begins without one.
    pub position: u64,
    /// Frames to decode and not to show before the one asked for.
    pub decode_through: u64,
}

/// A recording opened for reading. Holds one chunk (a second of the stream) in memory.
pub struct RecordingReader {
    source: Source,
    camera: Camera,
    index: Index,
    loaded: Loaded,
    /// Number of the chunk in `loaded`.
    current: Option<usize>,
    /// The frame that is read next.
    position: u64,
    /// The fault of `index.faults` that is met next.
    next_fault: usize,
    cut_told: bool,
    /// Chunks of the stored index found damaged on reading.
    found: Vec<Fault>,
    colors: Vec<ColorFrame>,
}

impl RecordingReader {
    /// Opens a recording: by its index where that is whole, else by a scan of the file. Of several
    /// cameras the first is read.
    ///
    /// # Errors
    /// [`RecordingError::Unreadable`], [`RecordingError::NotARecording`], or
    /// [`RecordingError::Damaged`] where not even the camera is left. A cut or damaged file opens.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Self::open_at(path, None)
    }

    /// Opens one camera of a recording of several, by name.
    ///
    /// # Errors
    /// As [`open`](Self::open); [`RecordingError::NotARecording`] names the cameras there are.
    pub fn open_camera(path: &Path, name: &str) -> Result<Self, RecordingError> {
        Self::open_at(path, Some(name))
    }

    fn open_at(path: &Path, name: Option<&str>) -> Result<Self, RecordingError> {
        let source = Source::open(path)?;
        let index = Index::read(&source, name)?;
        let Some(camera) = index.channels.camera.clone() else {
            return Err(source.foreign("does not describe its camera"));
        };
        Ok(Self {
            source,
            camera,
            index,
            loaded: Loaded::default(),
            current: None,
            position: 0,
            next_fault: 0,
            cut_told: false,
            found: Vec::new(),
            colors: Vec::new(),
        })
    }

    /// The camera.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Names of all cameras of the recording, in its order; the only one may have none.
    #[must_use]
    pub fn cameras(&self) -> &[String] {
        &self.index.channels.cameras
    }

    /// What the writer noted beside the camera's stream.
    #[must_use]
    pub fn notes(&self) -> &BTreeMap<String, String> {
        &self.index.channels.notes
    }

    /// Number of frames.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.index.tally.frames
    }

    /// Numbers of the key frames, ascending.
    #[must_use]
    pub fn key_frames(&self) -> &[u64] {
        &self.index.tally.key_frames
    }

    /// Number of the frame that [`next_frame`](Self::next_frame) reads.
    #[must_use]
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Reads the next frame into `frame`; `false` at the end.
    ///
    /// # Errors
    /// [`RecordingError::Damaged`] once at each damaged place: the next call goes on at the next
    /// key frame after it. [`RecordingError::Cut`] once at the end of a cut file.
    pub fn next_frame(&mut self, frame: &mut EncodedFrame) -> Result<bool, RecordingError> {
        if let Some(fault) = self.index.faults.get(self.next_fault)
            && fault.frame <= self.position
        {
            let error = self.damaged(fault);
            self.next_fault += 1;
            self.position = self.key_from(self.position);
            return Err(error);
        }
        if self.position >= self.frames() {
            return self.end();
        }
        let chunk = self.chunk_of(self.position);
        if let Err(fault) = self.load(chunk) {
            let place = &self.index.chunks[chunk];
            self.position = self.key_from(place.first_frame + place.frames);
            return Err(self.damaged(&fault));
        }
        let inside = (self.position - self.index.chunks[chunk].first_frame) as usize;
        let (header, payload) = &self.loaded.frames[inside];
        frame.sequence = header.sequence;
        frame.time = header.time;
        frame.key = header.key;
        frame.payload.clear();
        frame
            .payload
            .extend_from_slice(&self.loaded.bytes[payload.clone()]);
        self.collect_colors(inside);
        self.position += 1;
        Ok(true)
    }

    /// When the frame that [`next_frame`](Self::next_frame) reads was taken; `None` at the end and
    /// before a damaged place.
    pub fn next_time(&mut self) -> Option<FrameTime> {
        if self.position >= self.frames() {
            return None;
        }
        let chunk = self.chunk_of(self.position);
        self.load(chunk).ok()?;
        let inside = (self.position - self.index.chunks[chunk].first_frame) as usize;
        Some(self.loaded.frames.get(inside)?.0.time)
    }

    /// Goes to the key frame at or before `frame`.
    ///
    /// # Errors
    /// [`RecordingError::NoSuchFrame`].
    pub fn seek(&mut self, frame: u64) -> Result<Seek, RecordingError> {
        if frame >= self.frames() {
            return Err(RecordingError::NoSuchFrame {
                path: self.source.path.clone(),
                frame,
                frames: self.frames(),
            });
        }
        let keys = self.key_frames();
        let before = keys.partition_point(|key| *key <= frame);
        self.position = match before.checked_sub(1) {
            Some(last) => keys[last],
            None => 0,
        };
        self.next_fault = self
            .index
            .faults
            .partition_point(|f| f.frame <= self.position);
        self.cut_told = false;
        self.colors.clear();
        Ok(Seek {
            position: self.position,
            decode_through: frame - self.position,
        })
    }

    /// Number of the first frame at or after `seconds` from the first frame (device clock);
    /// [`frames`](Self::frames) where there is none.
    pub fn frame_at(&mut self, seconds: f64) -> u64 {
        let tally = &self.index.tally;
        let wanted = tally
            .first
            .device_ns
            .saturating_add((seconds * 1e9).round() as i64);
        if wanted > tally.last.device_ns {
            return self.frames();
        }
        let after = self
            .index
            .chunks
            .partition_point(|place| place.time < wanted);
        let Some(chunk) = after.checked_sub(1) else {
            return 0;
        };
        let first = self.index.chunks[chunk].first_frame;
        match self.load(chunk) {
            Ok(()) => {
                let times = self.loaded.frames.iter();
                first + times.take_while(|(h, _)| h.time.device_ns < wanted).count() as u64
            }
            Err(_) => first,
        }
    }

    /// Colour images that came with the frame last read: recorded since the frame before it. Of
    /// their numbers the low 32 bits are kept.
    pub fn take_colors(&mut self) -> Vec<ColorFrame> {
        std::mem::take(&mut self.colors)
    }

    /// Reads the whole file and checks every chunk, so that [`info`](Self::info) knows all damage.
    pub fn verify(&mut self) {
        for chunk in 0..self.index.chunks.len() {
            // what fails is noted by `load`
            let _ = self.load(chunk);
        }
    }

    /// What is in the recording.
    #[must_use]
    pub fn info(&self) -> Info {
        let tally = &self.index.tally;
        let mut faults: Vec<_> = self.index.faults.iter().chain(&self.found).collect();
        faults.sort();
        faults.extend(&self.index.cut);
        let traffic = |topic: &str| tally.channels.get(topic).copied().unwrap_or_default();
        let Traffic { messages, bytes } = traffic(SAINT_TOPIC);
        let payload_bits = 8.0 * bytes.saturating_sub(messages * message::HEADER as u64) as f64;
        let duration_s = (tally.last.device_ns.saturating_sub(tally.first.device_ns)) as f64 * 1e-9;
        let fps =
            (tally.frames > 1 && duration_s > 0.0).then(|| (tally.frames - 1) as f64 / duration_s);
        let bits_per_frame = (tally.frames > 0).then(|| payload_bits / tally.frames as f64);
        let mut notes = self.index.channels.notes.clone();
        let generator = notes.remove("generator").unwrap_or_default();
        let known = &self.index.channels;
        let mut channels: Vec<_> = (known.by_id.values())
            .filter_map(|channel| Some((channel, known.own(&channel.topic)?)))
            .collect();
        channels.sort_by(|a, b| a.1.cmp(b.1));
        Info {
            path: self.source.path.display().to_string(),
            bytes: self.source.length,
            generator,
            frames: tally.frames,
            key_frames: tally.key_frames.len() as u64,
            width: self.camera.width,
            height: self.camera.height,
            duration_s,
            first: tally.first,
            last: tally.last,
            fps,
            bitrate_bps: fps.zip(bits_per_frame).map(|(fps, bits)| fps * bits),
            bits_per_frame,
            lost_frames: tally.lost_frames,
            cut: self.index.cut.is_some(),
            index_rebuilt: self.index.rebuilt,
            damaged: faults.into_iter().map(damage).collect(),
            contact_map: notes
                .get(CONTACT_MAP_NOTE)
                .map_or_else(|| Domain::Sensor.name().to_owned(), Clone::clone),
            channels: channels
                .into_iter()
                .map(|(channel, topic)| ChannelInfo {
                    topic: channel.topic.clone(),
                    schema: channel.schema.clone(),
                    encoding: channel.encoding.clone(),
                    messages: traffic(topic).messages,
                    bytes: traffic(topic).bytes,
                })
                .collect(),
            camera: self.camera.clone(),
            notes,
        }
    }

    /// Number of the chunk that holds `frame`, which the recording has.
    fn chunk_of(&self, frame: u64) -> usize {
        let chunks = &self.index.chunks;
        chunks.partition_point(|place| place.first_frame + place.frames <= frame)
    }

    /// The first key frame at or after `frame`, or the end.
    fn key_from(&self, frame: u64) -> u64 {
        let keys = self.key_frames();
        let at = keys.partition_point(|key| *key < frame);
        keys.get(at).copied().unwrap_or(self.frames())
    }

    /// Brings a chunk into memory and checks it.
    fn load(&mut self, chunk: usize) -> Result<(), Fault> {
        if self.current == Some(chunk) {
            return Ok(());
        }
        self.current = None;
        let place = &self.index.chunks[chunk];
        let result = self
            .loaded
            .load(&self.source, place, &mut self.index.channels);
        let held = self.loaded.frames.len() as u64;
        let what = match result {
            Ok(()) if held == place.frames => {
                self.current = Some(chunk);
                return Ok(());
            }
            Ok(()) => format!(
                "the chunk holds {held} frames, the index says {}",
                place.frames
            ),
            Err(what) => what,
        };
        let fault = Fault {
            frame: place.first_frame,
            offset: place.offset,
            what,
        };
        if !self.found.contains(&fault) {
            self.found.push(fault.clone());
        }
        Err(fault)
    }

    fn collect_colors(&mut self, inside: usize) {
        self.colors.clear();
        let first = self.index.tally.first;
        // the log time is the device clock on the first frame's wall clock: undo that
        let offset = match first.wall_ns {
            0 => 0,
            wall => wall.saturating_sub(first.device_ns),
        };
        let last = inside + 1 == self.loaded.frames.len();
        for (before, header, place) in &self.loaded.colors {
            // what follows a chunk's last frame goes with that frame
            if *before != inside && !(last && *before > inside) {
                continue;
            }
            let time = FrameTime {
                device_ns: i64::try_from(header.log_time)
                    .unwrap_or(i64::MAX)
                    .saturating_sub(offset),
                wall_ns: match first.wall_ns {
                    0 => 0,
                    _ => i64::try_from(header.publish_time).unwrap_or(i64::MAX),
                },
            };
            let message = &self.loaded.bytes[place.clone()];
            self.colors
                .extend(color::read(message, u64::from(header.sequence), time));
        }
    }

    fn end(&mut self) -> Result<bool, RecordingError> {
        match &self.index.cut {
            Some(cut) if !self.cut_told => {
                self.cut_told = true;
                Err(RecordingError::Cut {
                    path: self.source.path.clone(),
                    offset: cut.offset,
                    frame: cut.frame,
                    what: cut.what.clone(),
                })
            }
            _ => Ok(false),
        }
    }

    fn damaged(&self, fault: &Fault) -> RecordingError {
        RecordingError::Damaged {
            path: self.source.path.clone(),
            offset: fault.offset,
            frame: fault.frame,
            what: fault.what.clone(),
        }
    }
}

fn damage(fault: &Fault) -> Damage {
    Damage {
        offset: fault.offset,
        frame: fault.frame,
        what: fault.what.clone(),
    }
}
