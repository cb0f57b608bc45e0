//! Sources as the commands ask for them: a camera, a synthetic sensor, a folder, a recording.

use super::args::{CameraArgs, CaptureArgs, ExrDepthArg, RangeArgs};
use super::failure::Failure;
use super::message;
use saint_live::capture::containers;
use saint_live::capture::sequences::{self, ExrDepth, SequenceOptions};
use saint_live::capture::synthetic::{SyntheticOptions, SyntheticSource};
use saint_live::capture::v4l2::{V4l2Options, V4l2Source};
use saint_live::capture::{CaptureError, FrameSource, Next, SourceLosses};
use saint_live::frame::{Camera, ColorFrame, DepthFrame};
use saint_live::intrinsics::{Calibration, IntrinsicsError};
use saint_live::rig::Pose;
use std::io::Read;
use std::path::Path;

mod color;
mod recorded;
mod repeated;

pub use color::{Color, color};

use recorded::RecordedSource;
use repeated::Repeated;

/// First bytes of every MCAP file.
const RECORDING_MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// Shortest frame period for which a looped input without times is continued, ns.
const LOOP_PERIOD_NS: i64 = 33_333_333;

/// The camera that `--device` names.
pub fn live(device: &str, args: &CaptureArgs) -> Result<Box<dyn FrameSource>, Failure> {
    if device.is_empty() {
        return Err(Failure::usage(
            "no --device given; name a camera (saint-live devices lists them), auto, or synthetic:room",
        ));
    }
    if device == "synthetic" || device.starts_with("synthetic:") {
        return synthetic(device, args);
    }
    let camera = &args.camera;
    let calibration = calibration(camera)?;
    let told = |f: fn(&Calibration) -> Option<f64>| calibration.as_ref().and_then(f);
    let defaults = V4l2Options::default();
    let options = V4l2Options {
        device: device.to_owned(),
        size: args.size,
        fps: args.fps,
        pixel_format: args.pixel_format.clone(),
        depth_unit_m: camera.depth_unit.map(|l| l.0).or(told(|c| c.depth_unit_m)),
        intrinsics: calibration.as_ref().map(|c| c.intrinsics),
        intrinsics_size: calibration.as_ref().and_then(|c| c.size),
        depth_min_m: camera
            .depth_min
            .map(|l| l.0)
            .or(told(|c| c.depth_min_m))
            .unwrap_or(defaults.depth_min_m),
        depth_max_m: camera
            .depth_max
            .map(|l| l.0)
            .or(told(|c| c.depth_max_m))
            .unwrap_or(defaults.depth_max_m),
        invalid: camera
            .invalid
            .clone()
            .or(calibration.and_then(|c| c.invalid))
            .unwrap_or(defaults.invalid),
        give_up: args.give_up,
    };
    Ok(Box::new(V4l2Source::open(&options)?))
}

fn synthetic(device: &str, args: &CaptureArgs) -> Result<Box<dyn FrameSource>, Failure> {
    let camera = &args.camera;
    let unused = [
        ("--pixel-format", args.pixel_format.is_some()),
        ("--intrinsics", camera.intrinsics.is_some()),
        ("--depth-min", camera.depth_min.is_some()),
        ("--depth-max", camera.depth_max.is_some()),
        ("--invalid", camera.invalid.is_some()),
        ("--give-up", args.give_up.is_some()),
        ("--reconnect", args.reconnect),
    ];
    if let Some((flag, _)) = unused.iter().find(|(_, given)| *given) {
        return Err(Failure::usage(format_args!(
            "{flag} has no meaning for the synthetic sensor, which knows its own camera"
        )));
    }
    let mut options = SyntheticOptions::parse(device)?;
    if let Some((width, height)) = args.size {
        (options.width, options.height) = (width, height);
    }
    if let Some(fps) = args.fps {
        options.fps = f64::from(fps);
    }
    if let Some(unit) = camera.depth_unit {
        options.unit_m = unit.0;
    }
    Ok(Box::new(SyntheticSource::open(options)?))
}

/// How a recorded input is read.
#[derive(Clone, Debug, Default)]
pub struct InputOptions {
    /// What the user knows of the camera.
    pub camera: CameraArgs,
    /// Which frames.
    pub range: RangeArgs,
    /// Frames per second of an input that does not say.
    pub fps: Option<f64>,
    /// What the values of EXR files measure.
    pub exr_depth: ExrDepthArg,
    /// Topic of the depth images in a file of messages.
    pub topic: Option<String>,
    /// Take the colour images beside the depth along.
    pub color: bool,
}

/// A recorded input, once.
pub fn recorded(input: &Path, options: &InputOptions) -> Result<Box<dyn FrameSource>, Failure> {
    let (from, to) = (options.range.from, options.range.to);
    if to.is_some_and(|to| to <= from) {
        return Err(Failure::usage(format_args!(
            "--from {from} --to {} holds no frame; --to is the frame after the last",
            to.unwrap_or_default()
        )));
    }
    if is_recording(input) {
        let given = &options.camera;
        let unused = [
            ("--intrinsics", given.intrinsics.is_some()),
            ("--depth-unit", given.depth_unit.is_some()),
            ("--invalid", given.invalid.is_some()),
            ("--topic", options.topic.is_some()),
        ];
        if let Some((flag, _)) = unused.iter().find(|(_, given)| *given) {
            return Err(Failure::usage(format_args!(
                "{flag} cannot be given for a recording: {} says it itself",
                input.display()
            )));
        }
        let mut source = RecordedSource::open(input, from, to)?;
        source.limit_depth(given.depth_min.map(|l| l.0), given.depth_max.map(|l| l.0));
        return Ok(Box::new(source));
    }
    let given = SequenceOptions {
        calibration: calibration(&options.camera)?,
        depth_unit_m: options.camera.depth_unit.map(|l| l.0),
        depth_min_m: options.camera.depth_min.map(|l| l.0),
        depth_max_m: options.camera.depth_max.map(|l| l.0),
        invalid: options.camera.invalid.clone(),
        fps: options.fps,
        exr_depth: match options.exr_depth {
            ExrDepthArg::Planar => ExrDepth::Planar,
            ExrDepthArg::Ray => ExrDepth::Ray,
            ExrDepthArg::Inverse => ExrDepth::Inverse,
        },
        first: usize::try_from(from).unwrap_or(usize::MAX),
        count: to.map(|to| usize::try_from(to - from).unwrap_or(usize::MAX)),
        topic: options.topic.clone(),
        without_color: !options.color,
        ..SequenceOptions::default()
    };
    Ok(sequences::open(input, &given)?)
}

/// A recorded input that begins again at its end.
pub fn repeated(input: &Path, options: &InputOptions) -> Result<Box<dyn FrameSource>, Failure> {
    let first = recorded(input, options)?;
    let (input, options) = (input.to_owned(), options.clone());
    let reopen = move || {
        recorded(&input, &options).map_err(|failure| CaptureError::Input {
            path: input.clone(),
            frame: None,
            what: format!("cannot be opened again: {failure}"),
            remedy: "keep the input in place while it is looped".to_owned(),
        })
    };
    Ok(Box::new(Repeated::new(
        first,
        Box::new(reopen),
        LOOP_PERIOD_NS,
    )))
}

/// True where the file is a recording of spheres rather than depth images.
pub fn is_recording(path: &Path) -> bool {
    let mut start = [0; RECORDING_MAGIC.len()];
    let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut start));
    let named = path.extension().is_some_and(|ext| ext == "mcap") && path.is_file();
    let is_mcap = named || (read.is_ok() && start == RECORDING_MAGIC);
    is_mcap && !containers::holds_depth_images(path)
}

fn calibration(args: &CameraArgs) -> Result<Option<Calibration>, Failure> {
    let Some(text) = args.intrinsics.as_deref() else {
        return Ok(None);
    };
    match Calibration::parse_flag(text) {
        Ok(calibration) => Ok(Some(calibration)),
        Err(error @ IntrinsicsError::Text { .. }) => Err(Failure::usage(error)),
        Err(error) => Err(Failure::new(super::failure::Kind::Input, error)),
    }
}

/// Where a synthetic camera stands in its scene; `None` for other devices.
pub fn synthetic_pose(device: &str) -> Option<Pose> {
    let text = device.strip_prefix("synthetic:")?;
    let place = SyntheticOptions::parse(text).ok()?.placement();
    Pose::from_quaternion(place.position.to_array(), place.rotation.to_array()).ok()
}

/// Says what the camera is: size, rate, intrinsics, unit, and who says so.
pub fn introduce(source: &dyn FrameSource) {
    let camera = source.camera();
    let notes = source.notes();
    let from = |name: &str| {
        let note = notes.iter().find(|(known, _)| *known == name);
        note.map_or(String::new(), |(_, who)| format!(" ({who})"))
    };
    let k = &camera.intrinsics;
    let rate = camera
        .fps
        .map_or(String::new(), |fps| format!(" at {fps:.2} fps"));
    message::say(&format!(
        "{}: {}x{}{rate}, fx {:.2} fy {:.2} cx {:.2} cy {:.2}{}, 1 unit = {} mm{}, {} to {:.1} m",
        camera.name,
        camera.width,
        camera.height,
        k.fx,
        k.fy,
        k.cx,
        k.cy,
        from("intrinsics_from"),
        camera.depth_unit_m * 1e3,
        from("depth_unit_from"),
        camera.depth_min_m,
        camera.depth_max_m,
    ));
}
