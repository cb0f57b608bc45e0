//! A recording of ours, decoded frame by frame: what replay, play and export read.

use super::args::LevelArg;
use super::failure::{Failure, Kind};
use saint_live::codec::{CodecError, Domain, EncodedFrame, Level, Payload, PayloadDecoder};
use saint_live::contact_map::merged::ClaimMap;
use saint_live::export::{ExportCloud, ExportFrame};
use saint_live::fit::sphere::Sphere;
use saint_live::frame::{Camera, ColorFrame, FrameTime};
use saint_live::model::file::is_model;
use saint_live::play::Frames;
use saint_live::recording::{RecordingError, RecordingReader};
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// An open recording and the frame last decoded. A damaged place is skipped to the next key frame;
/// a cut file plays to its last whole frame. Both are told when met and kept as [`Tape::fault`].
pub struct Tape {
    /// The camera.
    pub camera: Camera,
    path: PathBuf,
    reader: RecordingReader,
    decoder: PayloadDecoder,
    encoded: EncodedFrame,
    depth_m: Vec<f32>,
    labels: Vec<u16>,
    spheres: Vec<Option<Sphere>>,
    /// The polar map of the frame last decoded, where it has one.
    polar: Option<ClaimMap>,
    fault: Option<String>,
}

/// Refuses what is a recording by its name only.
fn no_model(path: &Path) -> Result<(), Failure> {
    if is_model(path) {
        return Err(Failure::new(
            Kind::Input,
            format_args!(
                "{}: is a model of static clouds, it has no frames; use info or export",
                path.display()
            ),
        ));
    }
    Ok(())
}

impl Tape {
    /// Opens a recording at its first frame; of several cameras the first, which is told.
    pub fn open(path: &Path) -> Result<Self, Failure> {
        no_model(path)?;
        let reader = RecordingReader::open(path)?;
        if reader.is_raw() {
            let path = path.display();
            return Err(Failure::new(
                Kind::Input,
                format_args!(
                    "{path}: is a raw capture, it has no spheres; `saint-live replay {path} -o OUT.mcap` models it"
                ),
            ));
        }
        let tape = Self::of(reader, path);
        if let [first, _, ..] = tape.cameras() {
            tracing::warn!(
                "{} holds the cameras {}; {first} is taken",
                path.display(),
                tape.cameras().join(", ")
            );
        }
        Ok(tape)
    }

    /// Opens one camera of a recording of several.
    pub fn open_camera(path: &Path, name: &str) -> Result<Self, Failure> {
        no_model(path)?;
        Ok(Self::of(RecordingReader::open_camera(path, name)?, path))
    }

    fn of(reader: RecordingReader, path: &Path) -> Self {
        Self {
            camera: reader.camera().clone(),
            path: path.to_owned(),
            reader,
            decoder: PayloadDecoder::new(),
            encoded: EncodedFrame::default(),
            depth_m: Vec::new(),
            labels: Vec::new(),
            spheres: Vec::new(),
            polar: None,
            fault: None,
        }
    }

    /// Decodes this much of each payload. To be said before the first frame.
    pub fn decode_at(&mut self, level: LevelArg) {
        self.decoder = PayloadDecoder::at(match level {
            LevelArg::Blocks => Level::Blocks,
            LevelArg::Spheres => Level::Spheres,
            LevelArg::Full => Level::Full,
        });
    }

    /// Names of all cameras; the only one may have none.
    pub fn cameras(&self) -> &[String] {
        self.reader.cameras()
    }

    /// A fact the recording keeps as JSON; `None` where it is missing or not understood.
    pub fn note<T: DeserializeOwned>(&self, name: &str) -> Option<T> {
        serde_json::from_str(self.reader.notes().get(name)?).ok()
    }

    /// When the frame that [`Tape::advance`] would read was taken.
    pub fn next_time(&mut self) -> Option<FrameTime> {
        self.reader.next_time()
    }

    /// When the frame last decoded was taken.
    pub fn time(&self) -> FrameTime {
        self.encoded.time
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// True where the recording says that its contact maps are polar.
    pub fn is_polar(&self) -> bool {
        self.reader.info().contact_map == Domain::Polar.name()
    }

    /// Number of frames.
    pub fn frames(&self) -> u64 {
        self.reader.frames()
    }

    /// Frames in a second, where it is known; else as most cameras have it.
    pub fn frames_per_second(&self) -> f64 {
        let told = self.reader.info().fps.or(self.camera.fps);
        told.filter(|fps| *fps >= 1.0).unwrap_or(30.0)
    }

    /// Goes to the key frame from which `frame` can be decoded; gives its number.
    pub fn seek(&mut self, frame: u64) -> Result<u64, Failure> {
        if frame == 0 && self.frames() == 0 {
            return Ok(0);
        }
        Ok(self.reader.seek(frame)?.position)
    }

    /// Decodes the next frame that can be decoded; gives its number, `None` at the end.
    pub fn advance(&mut self) -> Option<u64> {
        loop {
            match self.reader.next_frame(&mut self.encoded) {
                Ok(true) => {}
                Ok(false) => return None,
                Err(error @ RecordingError::Damaged { .. }) => {
                    self.tell(&error);
                    continue;
                }
                Err(error) => {
                    self.tell(&error);
                    return None;
                }
            }
            match self.decoder.decode(&self.encoded.payload) {
                Ok(Payload::Polar(map)) => {
                    let cloud = ExportCloud {
                        sequence: self.encoded.sequence,
                        time: self.encoded.time,
                        map,
                    };
                    cloud.project(
                        &self.camera,
                        &mut self.depth_m,
                        &mut self.labels,
                        &mut self.spheres,
                    );
                    self.polar = Some(map.clone());
                    return Some(self.reader.position().saturating_sub(1));
                }
                Ok(Payload::Sensor(decoded)) => {
                    self.polar = None;
                    self.depth_m.clone_from(&decoded.depth_m);
                    self.labels.clone_from(&decoded.labels);
                    self.spheres.clone_from(&decoded.spheres);
                    return Some(self.reader.position().saturating_sub(1));
                }
                // frames after a damaged place wait for their key frame
                Err(CodecError::MissingReference { .. }) if self.fault.is_some() => {}
                Err(error) => {
                    let frame = self.reader.position().saturating_sub(1);
                    let path = self.path.display();
                    let text = format!("{path}: frame {frame} cannot be decoded: {error}");
                    self.tell(&text);
                }
            }
        }
    }

    fn tell(&mut self, what: &dyn std::fmt::Display) {
        tracing::warn!("{what}");
        self.fault.get_or_insert_with(|| what.to_string());
    }

    /// The frame last decoded, where its contact map is polar: points without a grid.
    pub fn cloud(&self) -> Option<ExportCloud<'_>> {
        self.polar.as_ref().map(|map| ExportCloud {
            sequence: self.encoded.sequence,
            time: self.encoded.time,
            map,
        })
    }

    /// The frame last decoded. Where its contact map is polar this is a drawing of its points,
    /// for the eye only.
    pub fn frame(&self) -> ExportFrame<'_> {
        ExportFrame {
            camera: &self.camera,
            sequence: self.encoded.sequence,
            time: self.encoded.time,
            depth_m: &self.depth_m,
            labels: &self.labels,
            spheres: &self.spheres,
        }
    }

    /// Colour images that came with the frame last decoded.
    pub fn take_colors(&mut self) -> Vec<ColorFrame> {
        self.reader.take_colors()
    }

    /// The first damage met, once.
    pub fn take_fault(&mut self) -> Option<String> {
        self.fault.take()
    }

    /// Ends a command that read to the end: damage met on the way makes it a failure.
    pub fn finish(mut self) -> Result<(), Failure> {
        match self.take_fault() {
            None => Ok(()),
            Some(fault) => Err(Failure::new(
                Kind::Input,
                format_args!("{fault}; everything that could be read was used"),
            )),
        }
    }
}

/// A decoded frame put aside, to be shown later.
pub struct Kept {
    sequence: u64,
    time: FrameTime,
    depth_m: Vec<f32>,
    labels: Vec<u16>,
    spheres: Vec<Option<Sphere>>,
    polar: Option<ClaimMap>,
}

impl Frames for Tape {
    type Error = Failure;
    type Kept = Kept;

    fn frames(&self) -> u64 {
        Self::frames(self)
    }

    fn keep(&self) -> Kept {
        Kept {
            sequence: self.encoded.sequence,
            time: self.encoded.time,
            depth_m: self.depth_m.clone(),
            labels: self.labels.clone(),
            spheres: self.spheres.clone(),
            polar: self.polar.clone(),
        }
    }

    fn put_back(&mut self, kept: Kept) {
        self.encoded.sequence = kept.sequence;
        self.encoded.time = kept.time;
        self.depth_m = kept.depth_m;
        self.labels = kept.labels;
        self.spheres = kept.spheres;
        self.polar = kept.polar;
    }

    fn seek(&mut self, frame: u64) -> Result<u64, Failure> {
        Self::seek(self, frame)
    }

    fn advance(&mut self) -> Result<Option<(u64, i64)>, Failure> {
        let number = Self::advance(self);
        Ok(number.map(|number| (number, self.encoded.time.device_ns)))
    }
}
