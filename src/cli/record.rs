//! `record`: the sensor's integers as they come, nothing modelled, nothing lost.
//!
//! The pipeline is the live one with other stages: the model passes frames by, the encoder packs
//! them, and many may wait, since a frame that is kept may be old.

use super::args::{LiveArgs, RecordArg, RecordArgs};
use super::failure::{Failure, Kind};
use super::{message, signals, source};
use saint_live::capture::sequences::camera_json::write_camera_json;
use saint_live::capture::sequences::exr::encode_exr_depth;
use saint_live::capture::sequences::png::encode_png_depth;
use saint_live::capture::sequences::timestamp_line;
use saint_live::codec::EncodedFrame;
use saint_live::contact_map::labels::SaintFrame;
use saint_live::frame::{Camera, DepthFrame};
use saint_live::pipeline::budget::Budget;
use saint_live::pipeline::clock::Monotonic;
use saint_live::pipeline::packet::{CodingReport, ModelReport, Packet};
use saint_live::pipeline::report::Report;
use saint_live::pipeline::stages::{Encode, Model, Sink};
use saint_live::pipeline::{self, Meter, Options, Pace, StageError, Stages};
use saint_live::recording::Target;
use saint_live::recording::raw::{RawWriter, image_message};
use std::fs::{self, File};
use std::io::{BufWriter, IsTerminal, Write};
use std::path::{Path, PathBuf};

/// Times of the frames of a folder of images.
const TIMES: &str = "timestamps.txt";
/// The status line is rewritten this often, ns.
const STATUS_NS: i64 = 500_000_000;

/// Captures until Ctrl-C, a limit, or the end of the source.
pub fn run(args: &RecordArgs, quiet: bool) -> Result<(), Failure> {
    let stop = signals::stop_flag()?;
    let mut source = source::live(&LiveArgs::of_camera(args))?;
    let camera = source.camera().clone();
    if !quiet {
        source::introduce(source.as_ref());
    }
    let mut output = Output::open(args, &camera)?;
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
        pace,
        budget: Budget::UNLIMITED,
        frames: args.frames,
        duration: args.duration,
    };
    let stages = Stages {
        source: source.as_mut(),
        color: None,
        model: &mut PassBy,
        encode: &mut encode,
        sink: &mut output,
        trace: None,
    };
    let shown = !quiet && std::io::stderr().is_terminal();
    let mut told_ns = 0;
    let outcome = pipeline::run(stages, &options, &Monotonic, &stop, &mut |meter: &Meter<
        '_,
        '_,
    >| {
        if shown && meter.now_ns() - told_ns >= STATUS_NS {
            told_ns = meter.now_ns();
            message::status(&status(&meter.total()));
        }
    });
    message::end_status();
    if !quiet {
        message::say(&status(&outcome.report));
        if let Some((name, bytes)) = &output.written {
            let frames = outcome.report.frames;
            message::say(&format!("wrote {name}: {frames} frames, {bytes} bytes"));
        }
    }
    outcome.result?;
    Ok(())
}

/// One line: frames, losses by cause, rate, size.
fn status(report: &Report) -> String {
    let drops = &report.drops;
    let bits = 8.0 * report.bytes as f64 / report.frames.max(1) as f64;
    format!(
        "{} of {} frames, {:.1} fps, dropped {} (sensor {}, damaged {}, stall {}, queue {}), \
         {:.0} KB a frame, encode p99 {:.1} ms",
        report.frames,
        report.sensor_frames,
        report.fps,
        drops.total(),
        drops.sensor_gap,
        drops.damaged,
        drops.stall,
        drops.queue,
        bits / 8e3,
        report.stage_ms.encode.p99,
    )
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
    /// Name and bytes of the finished output.
    written: Option<(String, u64)>,
}

enum To {
    Mcap(Option<Box<RawWriter>>),
    Folder(Folder),
}

/// A file for each frame.
struct Folder {
    path: PathBuf,
    extension: &'static str,
    /// Times of images that cannot keep them.
    times: Option<BufWriter<File>>,
    bytes: u64,
}

impl Output {
    fn open(args: &RecordArgs, camera: &Camera) -> Result<Self, Failure> {
        let to = match args.to {
            RecordArg::Mcap => To::Mcap(Some(Box::new(RawWriter::create(target(args)?, camera)?))),
            RecordArg::Png16 => {
                let folder = prepared(args)?;
                write_camera_json(&folder, camera).map_err(super::export::output_error)?;
                let times = folder.join(TIMES);
                let file = File::create(&times).map_err(|error| cannot_write(&times, &error))?;
                To::Folder(Folder {
                    path: folder,
                    extension: "png",
                    times: Some(BufWriter::new(file)),
                    bytes: 0,
                })
            }
            RecordArg::Exr => To::Folder(Folder {
                path: prepared(args)?,
                extension: "exr",
                times: None,
                bytes: 0,
            }),
        };
        Ok(Self { to, written: None })
    }
}

fn target(args: &RecordArgs) -> Result<Target, Failure> {
    let path = &args.output;
    if path != Path::new("-") {
        return Ok(Target::File {
            path: path.clone(),
            overwrite: args.overwrite,
        });
    }
    if std::io::stdout().is_terminal() {
        return Err(Failure::usage(
            "-o - writes binary data, and standard output is a terminal; redirect it or name a file",
        ));
    }
    Ok(Target::stdout()?)
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
    if filled && !args.overwrite {
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
        match &mut self.to {
            To::Mcap(None) => {}
            To::Mcap(Some(writer)) => {
                let depth = &packet.depth;
                writer.frame(depth.sequence, depth.time, &packet.encoded.payload)?;
            }
            To::Folder(folder) => {
                let result = folder.frame(packet);
                folder.named(result)?;
            }
        }
        Ok(())
    }

    fn idle(&mut self) -> Result<(), StageError> {
        match &mut self.to {
            To::Mcap(None) => {}
            To::Mcap(Some(writer)) => writer.idle()?,
            To::Folder(folder) => {
                let result = folder.flush();
                folder.named(result)?;
            }
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), StageError> {
        match &mut self.to {
            To::Mcap(writer) => {
                if let Some(writer) = writer.take() {
                    let summary = writer.finish()?;
                    self.written = Some((summary.target, summary.bytes));
                }
            }
            To::Folder(folder) => {
                let result = folder.flush();
                folder.named(result)?;
                self.written = Some((folder.path.display().to_string(), folder.bytes));
            }
        }
        Ok(())
    }
}
