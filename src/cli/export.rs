//! `export`: the frames of a recording as files.

use super::args::{ExportArg, ExportArgs};
use super::failure::{Failure, Kind};
use super::tape::Tape;
use super::{message, model_file, signals, status};
use saint_live::capture::CaptureError;
use saint_live::export::{ExportError, FileSequence, Format, Output};
use saint_live::model::file::is_model;
use std::sync::atomic::Ordering;

impl From<ExportError> for Failure {
    fn from(error: ExportError) -> Self {
        let kind = match &error {
            ExportError::Exists { .. }
            | ExportError::UnknownFormat(_)
            | ExportError::SingleFile { .. }
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
    };
    let mut tape = Tape::open(&args.file)?;
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
    let bar = (!quiet).then(|| status::progress(to.saturating_sub(from)));
    while let Some(number) = tape.advance() {
        if number >= to || stop.load(Ordering::Relaxed) {
            break;
        }
        if number >= from {
            match tape.cloud() {
                Some(cloud) => files.cloud(&cloud, number)?,
                None => files.frame(&tape.frame(), number)?,
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
    tape.finish()
}

/// A failed write of a depth image, where the output is at fault and not the input.
pub fn output_error(error: CaptureError) -> Failure {
    match error {
        CaptureError::Input { .. } => Failure::new(Kind::Output, error),
        other => other.into(),
    }
}
