//! `record`: the sensor's integers as they come, nothing modelled, nothing lost.
//!
//! The pipeline is the live one with other stages: the model passes frames by, the encoder packs
//! them, and many may wait, since a frame that is kept may be old.

use super::args::{RecordArg, RecordArgs, SyncArg};
use super::failure::{Failure, Kind};
use super::run::trace;
use super::status::Display;
use super::{message, signals, sink, source};
use saint_live::capture::sequences::camera_json::write_camera_json;
use saint_live::capture::sequences::exr::encode_exr_depth;
use saint_live::capture::sequences::png::encode_png_depth;
use saint_live::capture::sequences::timestamp_line;
use saint_live::codec::EncodedFrame;
use saint_live::contact_map::labels::SaintFrame;
use saint_live::frame::{Camera, ColorFrame, DepthFrame};
use saint_live::pipeline::budget::Budget;
use saint_live::pipeline::clock::Monotonic;
use saint_live::pipeline::color::ColorSource;
use saint_live::pipeline::packet::{CodingReport, ModelReport, Packet};
use saint_live::pipeline::stages::{Encode, Model, Sink};
use saint_live::pipeline::{self, Options, Pace, Priority, StageError, Stages};
use saint_live::recording::RecordingError;
use saint_live::recording::raw::{RawSummary, RawWriter, image_message};
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Times of the frames of a folder of images.
const TIMES: &str = "timestamps.txt";

/// Captures until Ctrl-C, a limit, or the end of the source.
pub fn run(args: &RecordArgs, quiet: bool) -> Result<(), Failure> {
    refuse(args)?;
    let stop = signals::stop_flag()?;
    let mut source = source::live(&args.device, &args.capture)?;
    let mut color = source::color(&args.capture);
    let camera = source.camera().clone();
    if !quiet {
        source::introduce(source.as_ref());
    }
    let mut output = Output::open(args, &camera)?;
    let trace = trace(&args.run)?;
    let mut encode = Pack {
        camera: camera.clone(),
        form: args.to,
    };
    let pace = if source.is_live() {
        Pace::Keep
    } else {
        Pace::Block
    };
    let options = Options {
        threads: 2,
        stage_threads: 0,
        priority: Priority::Usual,
        pace,
        budget: Budget::UNLIMITED,
        frames: args.run.frames,
        duration: args.run.duration,
    };
    let mut display = Display::of_raw(quiet, args.run.stats, args.run.frames);
    let stages = Stages {
        source: source.as_mut(),
        color: color.as_mut().map(|color| color as &mut dyn ColorSource),
        model: &mut PassBy,
        encode: &mut encode,
        sink: &mut output,
        trace,
        start: None,
    };
    let outcome = pipeline::run(stages, &options, &Monotonic, &stop, &mut |meter| {
        display.observe(meter, &stop);
    });
    let shown = display.finish(quiet, &outcome.report);
    if let Some(error) = &outcome.color {
        message::say(&format!("saint-live: colour ended early: {error}"));
    }
    if let (Some(written), false) = (&output.written, quiet) {
        message::wrote(
            &written.target,
            written.parts,
            written.frames,
            written.bytes,
        );
    }
    outcome.result?;
    shown
}

/// What only a file of messages has room for.
fn refuse(args: &RecordArgs) -> Result<(), Failure> {
    let only_mcap = [
        ("--split", args.run.split.is_some()),
        ("--sync chunk", args.run.sync == SyncArg::Chunk),
        ("--color-device", args.capture.color_device.is_some()),
    ];
    match only_mcap.iter().find(|(_, given)| *given) {
        Some((flag, _)) if args.to != RecordArg::Mcap => Err(Failure::usage(format_args!(
            "{flag} goes with --to mcap only"
        ))),
        _ => Ok(()),
    }
}

/// A model of nothing.
struct PassBy;

impl Model for PassBy {
    fn model(
        &mut self,
        _: &DepthFrame,
        _: &mut SaintFrame,
        _: &dyn Fn() -> bool,
    ) -> Result<ModelReport, StageError> {
        Ok(ModelReport::default())
    }
}

/// Packs a frame as the output takes it.
struct Pack {
    camera: Camera,
    form: RecordArg,
}

impl Encode for Pack {
    fn encode(
        &mut self,
        depth: &DepthFrame,
        _: &SaintFrame,
        _: &ModelReport,
        encoded: &mut EncodedFrame,
    ) -> Result<CodingReport, StageError> {
        let Camera { width, height, .. } = self.camera;
        let bytes = &mut encoded.payload;
        bytes.clear();
        match self.form {
            RecordArg::Mcap => image_message(&self.camera, &depth.depth, bytes),
            RecordArg::Png16 => encode_png_depth(width, height, &depth.depth, bytes)?,
            RecordArg::Exr => *bytes = encode_exr_depth(&self.camera, depth)?,
        }
        encoded.key = true;
        Ok(CodingReport::default())
    }
}

/// Where packed frames go.
struct Output {
    to: To,
    written: Option<RawSummary>,
    /// Frames that are safe, after a failure.
    kept: Option<u64>,
}

impl Output {
    /// Writes a message; notes what is safe where that fails.
    fn message<T>(
        &mut self,
        write: impl FnOnce(&mut RawWriter) -> Result<T, RecordingError>,
    ) -> Result<Option<T>, StageError> {
        let To::Mcap(writer) = &mut self.to else {
            return Ok(None);
        };
        let result = write(writer);
        if result
            .as_ref()
            .is_err_and(|error| error.kept_frames().is_some())
        {
            self.kept.get_or_insert(writer.kept_frames());
        }
        Ok(Some(result?))
    }
}

enum To {
    Mcap(Box<RawWriter>),
    Folder(Folder),
}

/// A file for each frame.
struct Folder {
    path: PathBuf,
    extension: &'static str,
    /// Times of images that cannot keep them.
    times: Option<BufWriter<File>>,
    frames: u64,
    bytes: u64,
}

impl Output {
    fn open(args: &RecordArgs, camera: &Camera) -> Result<Self, Failure> {
        let to = match args.to {
            RecordArg::Mcap => {
                let target = sink::target(&args.output, &args.run)?;
                let options = sink::options(&args.run);
                To::Mcap(Box::new(RawWriter::create(target, camera, &options)?))
            }
            RecordArg::Png16 => {
                let folder = prepared(args)?;
                write_camera_json(&folder, camera).map_err(super::export::output_error)?;
                let times = folder.join(TIMES);
                let file = File::create(&times).map_err(|error| cannot_write(&times, &error))?;
                To::Folder(Folder {
                    path: folder,
                    extension: "png",
                    times: Some(BufWriter::new(file)),
                    frames: 0,
                    bytes: 0,
                })
            }
            RecordArg::Exr => To::Folder(Folder {
                path: prepared(args)?,
                extension: "exr",
                times: None,
                frames: 0,
                bytes: 0,
            }),
        };
        Ok(Self {
            to,
            written: None,
            kept: None,
        })
    }
}

/// The folder of `-o`, empty unless files in it may be replaced.
fn prepared(args: &RecordArgs) -> Result<PathBuf, Failure> {
    let folder = &args.output;
    if folder == Path::new("-") {
        return Err(Failure::usage("-o - takes --to mcap only; name a folder"));
    }
    let cannot = |error: std::io::Error| cannot_write(folder, &error);
    fs::create_dir_all(folder).map_err(cannot)?;
    let filled = fs::read_dir(folder).map_err(cannot)?.next().is_some();
    if filled && !args.run.overwrite {
        return Err(Failure::usage(format_args!(
            "{} is not empty; give another name or --overwrite",
            folder.display()
        )));
    }
    Ok(folder.clone())
}

fn cannot_write(path: &Path, error: &std::io::Error) -> Failure {
    let path = path.display();
    Failure::new(Kind::Output, format_args!("cannot write {path}: {error}"))
}

impl Folder {
    fn frame(&mut self, packet: &Packet) -> std::io::Result<()> {
        let number = packet.depth.sequence;
        let name = format!("{number:06}.{}", self.extension);
        fs::write(self.path.join(name), &packet.encoded.payload)?;
        if let Some(times) = &mut self.times {
            times.write_all(timestamp_line(number, packet.depth.time).as_bytes())?;
        }
        self.frames += 1;
        self.bytes += packet.encoded.payload.len() as u64;
        Ok(())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.times.as_mut().map_or(Ok(()), BufWriter::flush)
    }

    /// The same error, naming the folder.
    fn named(&self, result: std::io::Result<()>) -> Result<(), StageError> {
        let path = self.path.display();
        result.map_err(|error| format!("cannot write into {path}: {error}").into())
    }
}

impl Sink for Output {
    fn frame(&mut self, packet: &Packet) -> Result<(), StageError> {
        if let To::Folder(folder) = &mut self.to {
            let result = folder.frame(packet);
            return folder.named(result);
        }
        let (depth, image) = (&packet.depth, &packet.encoded.payload);
        self.message(|writer| writer.frame(depth.sequence, depth.time, image))?;
        Ok(())
    }

    fn color(&mut self, color: &ColorFrame) -> Result<(), StageError> {
        self.message(|writer| writer.color(color))?;
        Ok(())
    }

    fn idle(&mut self) -> Result<(), StageError> {
        if let To::Folder(folder) = &mut self.to {
            let result = folder.flush();
            return folder.named(result);
        }
        self.message(RawWriter::idle)?;
        Ok(())
    }

    fn finish(&mut self) -> Result<(), StageError> {
        if let To::Folder(folder) = &mut self.to {
            let result = folder.flush();
            folder.named(result)?;
            self.written = Some(RawSummary {
                target: folder.path.display().to_string(),
                parts: 1,
                frames: folder.frames,
                bytes: folder.bytes,
            });
        } else if self.kept.is_none() {
            self.written = self.message(RawWriter::finish)?;
        }
        Ok(())
    }

    fn kept(&self) -> Option<u64> {
        self.kept
    }
}
