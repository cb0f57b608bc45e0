//! Reading a recording: frames in order, from any key frame, through damage.

use super::container::Source;
use super::index::{Fault, Index};
use super::info::{Account, ChannelInfo, Damage, Info};
use super::loaded::{Care, Loaded};
use super::message::FrameHeader;
use super::tally::{StreamTally, Traffic};
use super::topics::Role;
use super::{CONTACT_MAP_NOTE, RecordingError, color, message, raw};
use crate::codec::{Domain, EncodedFrame};
use crate::frame::{Camera, ColorFrame, FrameTime};
use mcap::records::MessageHeader;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

/// Where [`RecordingReader::seek`] has gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seek {
    /// The frame that is read next: a key frame, unless the recording begins without one.
    pub position: u64,
    /// Frames to decode and not to show before the one asked for.
    pub decode_through: u64,
}

/// The camera's part of the chunk in memory.
#[derive(Default)]
struct View {
    /// Each frame's header and where its payload lies.
    frames: Vec<(FrameHeader, Range<usize>)>,
    /// Colour images: frames of this chunk before it, MCAP's header, where it lies.
    colors: Vec<(usize, MessageHeader, Range<usize>)>,
}

/// One camera of a recording opened for reading. Holds one chunk (half a second of the stream) in
/// memory.
pub struct RecordingReader {
    pub(super) source: Source,
    /// Names of all cameras.
    cameras: Vec<String>,
    name: String,
    camera: Camera,
    notes: BTreeMap<String, String>,
    pub(super) index: Index,
    tally: StreamTally,
    /// Number of the first frame of each chunk, and of the frame after the last.
    firsts: Vec<u64>,
    loaded: Loaded,
    view: View,
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
    account: Option<Account>,
}

impl RecordingReader {
    /// Opens a recording at its first camera: by its index where that is whole, else by
    /// a scan of the file.
    ///
    /// # Errors
    /// [`RecordingError::Unreadable`], [`RecordingError::NotARecording`], or
    /// [`RecordingError::Damaged`] where not even the camera is left. A cut or damaged file opens.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Self::open_named(path, None)
    }

    /// As [`open`](Self::open), at the camera of this name.
    ///
    /// # Errors
    /// As [`open`](Self::open), and [`RecordingError::NoSuchCamera`].
    pub fn open_camera(path: &Path, name: &str) -> Result<Self, RecordingError> {
        Self::open_named(path, Some(name))
    }

    fn open_named(path: &Path, name: Option<&str>) -> Result<Self, RecordingError> {
        let source = Source::open(path)?;
        let index = Index::read(&source)?;
        let mut known = index.channels.cameras();
        let cameras: Vec<_> = known.iter().map(|(name, ..)| (*name).to_owned()).collect();
        let at = name.map_or(Some(0), |name| {
            cameras.iter().position(|known| known == name)
        });
        let Some(at) = at.filter(|at| *at < known.len()) else {
            let only = cameras.iter().all(String::is_empty);
            return Err(RecordingError::NoSuchCamera {
                path: source.path,
                name: name.unwrap_or_default().to_owned(),
                known: match only {
                    true => "one without a name".to_owned(),
                    false => cameras.join(", "),
                },
            });
        };
        let (name, camera, notes) = known.swap_remove(at);
        let name = name.to_owned();
        let tally = index.tally.streams.get(&name).cloned().unwrap_or_default();
        let mut firsts = vec![0; index.chunks.len() + 1];
        for (n, frames) in tally.chunk_frames.iter().enumerate() {
            firsts[n + 1] = firsts[n] + frames;
        }
        Ok(Self {
            source,
            cameras,
            name,
            camera,
            notes,
            index,
            tally,
            firsts,
            loaded: Loaded::default(),
            view: View::default(),
            current: None,
            position: 0,
            next_fault: 0,
            cut_told: false,
            found: Vec::new(),
            colors: Vec::new(),
            account: None,
        })
    }

    /// Names of all cameras of the recording, in its order; the only one may have none.
    #[must_use]
    pub fn cameras(&self) -> &[String] {
        &self.cameras
    }

    /// The camera.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// True for a raw capture: its payloads are image messages ([`raw`]), each of which stands
    /// alone.
    #[must_use]
    pub fn is_raw(&self) -> bool {
        self.index.channels.are_raw()
    }

    /// What the writer noted beside the camera's stream.
    #[must_use]
    pub fn notes(&self) -> &BTreeMap<String, String> {
        &self.notes
    }

    /// Number of frames.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.tally.frames
    }

    /// Numbers of the key frames, ascending.
    #[must_use]
    pub fn key_frames(&self) -> &[u64] {
        &self.tally.key_frames
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
            && self.frames_before(fault) <= self.position
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
            self.position = self.key_from(self.firsts[chunk + 1]);
            return Err(self.damaged(&fault));
        }
        let inside = (self.position - self.firsts[chunk]) as usize;
        let (header, payload) = &self.view.frames[inside];
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
        let inside = (self.position - self.firsts[chunk]) as usize;
        Some(self.view.frames.get(inside)?.0.time)
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
            _ if self.is_raw() => frame,
            Some(last) => keys[last],
            None => 0,
        };
        let faults = &self.index.faults;
        self.next_fault = faults.partition_point(|f| self.frames_before(f) <= self.position);
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
        let tally = &self.tally;
        let wanted = tally
            .first
            .device_ns
            .saturating_add((seconds * 1e9).round() as i64);
        if wanted > tally.last.device_ns {
            return self.frames();
        }
        // of chunks without a frame, the one before them holds the time
        let after = tally.chunk_times.partition_point(|time| *time < wanted);
        let holds = |chunk: &usize| tally.chunk_frames[*chunk] > 0;
        let Some(chunk) = (0..after).rev().find(holds) else {
            return 0;
        };
        let first = self.firsts[chunk];
        match self.load(chunk) {
            Ok(()) => {
                let times = self.view.frames.iter();
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
        let tally = &self.tally;
        let faults = self.index.faults.iter().chain(&self.found);
        let mut faults: Vec<_> = faults.chain(&self.index.cut).collect();
        faults.sort_by_key(|fault| fault.offset);
        let traffic = |topic: &str| {
            let channels = &self.index.tally.channels;
            channels.get(topic).copied().unwrap_or_default()
        };
        let (topic, header) = match self.is_raw() {
            true => (raw::IMAGE_TOPIC.to_owned(), 0),
            false => (Role::Saint.topic(&self.name), message::HEADER as u64),
        };
        let Traffic { messages, bytes } = traffic(&topic);
        let payload_bits = 8.0 * bytes.saturating_sub(messages * header) as f64;
        let duration_s = (tally.last.device_ns.saturating_sub(tally.first.device_ns)) as f64 * 1e-9;
        let fps =
            (tally.frames > 1 && duration_s > 0.0).then(|| (tally.frames - 1) as f64 / duration_s);
        let bits_per_frame = (tally.frames > 0).then(|| payload_bits / tally.frames as f64);
        let mut notes = self.notes.clone();
        let generator = notes.remove("generator").unwrap_or_default();
        let channels = self.index.channels.by_id.values();
        let mut channels: Vec<_> = channels.filter(|c| c.belongs_to(&self.name)).collect();
        channels.sort_by(|a, b| a.topic.cmp(&b.topic));
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
            monotonic: tally.backward_steps == 0,
            fps,
            bitrate_bps: fps.zip(bits_per_frame).map(|(fps, bits)| fps * bits),
            bits_per_frame,
            lost_frames: tally.lost_frames,
            account: self.account.clone(),
            cut: self.index.cut.is_some(),
            index_rebuilt: self.index.rebuilt,
            damaged: faults
                .into_iter()
                .map(|fault| Damage {
                    offset: fault.offset,
                    frame: self.frames_before(fault),
                    what: fault.what.clone(),
                })
                .collect(),
            contact_map: match notes.get(CONTACT_MAP_NOTE) {
                _ if self.is_raw() => "none".to_owned(),
                Some(name) => name.clone(),
                None => Domain::Sensor.name().to_owned(),
            },
            channels: channels
                .into_iter()
                .map(|channel| ChannelInfo {
                    topic: channel.topic.clone(),
                    schema: channel.schema.name.clone(),
                    encoding: channel.encoding.clone(),
                    messages: traffic(&channel.topic).messages,
                    bytes: traffic(&channel.topic).bytes,
                })
                .collect(),
            camera: self.camera.clone(),
            notes,
        }
    }

    /// Frames of this camera before a fault.
    fn frames_before(&self, fault: &Fault) -> u64 {
        self.firsts
            .get(fault.chunk)
            .copied()
            .unwrap_or(self.tally.frames)
    }

    /// Number of the chunk that holds `frame`, which the recording has.
    fn chunk_of(&self, frame: u64) -> usize {
        self.firsts.partition_point(|first| *first <= frame) - 1
    }

    /// The first key frame at or after `frame`, or the end.
    fn key_from(&self, frame: u64) -> u64 {
        if self.is_raw() {
            return frame.min(self.frames());
        }
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
        let place = self.index.chunks[chunk];
        let channels = &mut self.index.channels;
        let result = self
            .loaded
            .load(&self.source, &place, Care::Whole, channels);
        let expected = self.firsts[chunk + 1] - self.firsts[chunk];
        let what = match result {
            Ok(()) => {
                self.look();
                let held = self.view.frames.len() as u64;
                if held == expected {
                    self.current = Some(chunk);
                    return Ok(());
                }
                format!("the chunk holds {held} frames, the index says {expected}")
            }
            Err(what) => what,
        };
        let fault = Fault {
            chunk,
            offset: place.offset,
            what,
        };
        if !self.found.contains(&fault) {
            self.found.push(fault.clone());
        }
        Err(fault)
    }

    /// Finds what is this camera's in the chunk in memory.
    fn look(&mut self) {
        self.view.frames.clear();
        self.view.colors.clear();
        for item in &self.loaded.items {
            let channel = self.index.channels.by_id.get(&item.header.channel_id);
            let Some(channel) = channel else {
                continue;
            };
            if let Some((header, payload)) = &item.frame {
                if channel.frames_of() == Some(&self.name) {
                    self.view.frames.push((*header, payload.clone()));
                }
            } else if channel.is_color_of(&self.name) {
                let place = (self.view.frames.len(), item.header, item.data.clone());
                self.view.colors.push(place);
            } else if channel.is_statistics_of(&self.name) {
                let text = self.loaded.bytes.get(item.data.clone());
                let told = text.and_then(Account::read);
                self.account = told.or(self.account.take());
            }
        }
    }

    fn collect_colors(&mut self, inside: usize) {
        self.colors.clear();
        let first = self.tally.first;
        // the log time is the device clock on the first frame's wall clock: undo that
        let offset = match first.wall_ns {
            0 => 0,
            wall => wall.saturating_sub(first.device_ns),
        };
        let last = inside + 1 == self.view.frames.len();
        for (before, header, place) in &self.view.colors {
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
                    frame: self.frames_before(cut),
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
            frame: self.frames_before(fault),
            what: fault.what.clone(),
        }
    }
}
