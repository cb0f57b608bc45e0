//! `export`: the frames of a recording as files.

use super::args::{ExportArg, ExportArgs};
use super::failure::{Failure, Kind};
use super::tape::Tape;
use super::{message, model_file, signals, status};
use saint_live::capture::CaptureError;
use saint_live::export::{ExportError, FileSequence, Format, Output, Painter};
use saint_live::model::file::is_model;
use saint_live::rig::{COLOR_CAMERA_NOTE, ColorCamera};
use std::sync::atomic::Ordering;

mod merge;

impl From<ExportError> for Failure {
    fn from(error: ExportError) -> Self {
        let kind = match &error {
            ExportError::Exists { .. }
            | ExportError::UnknownFormat(_)
            | ExportError::SingleFile { .. }
            | ExportError::NoUnion { .. }
            | ExportError::NoGrid { .. } => Kind::Usage,
            ExportError::Write { .. } => Kind::Output,
            ExportError::Empty { .. } => Kind::Input,
            ExportError::Encode { .. } | ExportError::FrameSize { .. } => Kind::Failure,
        };
        Self::new(kind, error)
    }
}

/// Writes one file per frame into a folder, or one file where `-o` ends like a file of the format.
pub fn run(args: &ExportArgs, quiet: bool) -> Result<(), Failure> {
    if is_model(&args.file) {
        return model_file::export(args, quiet);
    }
    if args.scale.is_some() || args.object.is_some() {
        return Err(Failure::usage(format_args!(
            "{} is a recording: scales and objects are in models; choose frames with --from and -n",
            args.file.display()
        )));
    }
    let stop = signals::stop_flag()?;
    let format = match args.to {
        ExportArg::Ply => Format::Ply,
        ExportArg::Spheres => Format::Spheres,
        ExportArg::Pcd => Format::Pcd,
        ExportArg::Exr => Format::Exr,
        ExportArg::Png => Format::Png,
        ExportArg::Png16 => Format::Png16,
        ExportArg::Npz => Format::Npz,
    };
    let mut tape = match &args.camera {
        Some(name) => Tape::open_camera(&args.file, name)?,
        None if args.merge => merge::first(&args.file)?,
        None => Tape::open(&args.file)?,
    };
    tape.decode_at(args.level);
    let mut others = match args.merge {
        true => {
            format.check_union()?;
            Some(merge::Others::open(&args.file, &tape)?)
        }
        false => None,
    };
    let from = args.from;
    let to = args
        .frames
        .map_or(u64::MAX, |most| from.saturating_add(most))
        .min(tape.frames());
    let one_file = args
        .output
        .extension()
        .is_some_and(|ext| ext.eq_ignore_ascii_case(format.extension()))
        && !args.output.is_dir();
    let output = if one_file {
        Output::File(args.output.clone())
    } else {
        Output::Folder(args.output.clone())
    };
    if one_file && to.saturating_sub(from) > 1 {
        return Err(Failure::usage(format_args!(
            "{} is one file and {} frames were asked for; choose one with --from {from} -n 1 or name a folder",
            args.output.display(),
            to - from,
        )));
    }
    tape.seek(from)?;
    if tape.is_polar() {
        // told before a folder is made
        format.check_cloud(from)?;
    }
    let mut files = FileSequence::create(format, output, args.overwrite)?;
    let color_camera: Option<ColorCamera> = tape.note(COLOR_CAMERA_NOTE);
    let mut painter = color_camera
        .filter(|_| format == Format::Ply)
        .map(Painter::new);
    let bar = (!quiet).then(|| status::progress(to.saturating_sub(from)));
    while let Some(number) = tape.advance() {
        if number >= to || stop.load(Ordering::Relaxed) {
            break;
        }
        if let Some(painter) = &mut painter {
            for image in tape.take_colors() {
                painter.offer(image);
            }
        }
        if number >= from {
            if let Some(others) = &mut others {
                files.union(&others.beside(&tape), number)?;
            } else {
                match (tape.cloud(), &mut painter) {
                    (Some(cloud), _) => files.cloud(&cloud, number)?,
                    (None, Some(painter)) => match painter.paint(&tape.frame()) {
                        Some(colors) => files.painted(&tape.frame(), colors, number)?,
                        None => files.frame(&tape.frame(), number)?,
                    },
                    (None, None) => files.frame(&tape.frame(), number)?,
                }
            }
            if let Some(bar) = &bar {
                bar.inc(1);
            }
        }
    }
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    let summary = files.finish()?;
    if !quiet {
        message::say(&format!(
            "wrote {}: {} files, {} bytes",
            summary.path, summary.files, summary.bytes
        ));
    }
    if let Some(others) = others {
        others.finish(quiet)?;
    }
    tape.finish()
}

/// A failed write of a depth image, where the output is at fault and not the input.
pub fn output_error(error: CaptureError) -> Failure {
    match error {
        CaptureError::Input { .. } => Failure::new(Kind::Output, error),
        other => other.into(),
    }
}
