//! `synthesize`: a recording of a synthetic scene, as a folder of EXR files.

use super::args::SynthesizeArgs;
use super::failure::{Failure, Kind};
use super::{export, message, signals, status};
use saint_live::capture::sequences::exr::write_exr_depth;
use saint_live::capture::synthetic::{SyntheticOptions, generate};
use std::fs;
use std::sync::atomic::Ordering;

/// Writes `000000.exr`, `000001.exr`, ...: the same options give the same files.
pub fn run(args: &SynthesizeArgs, quiet: bool) -> Result<(), Failure> {
    let stop = signals::stop_flag()?;
    let options = SyntheticOptions::parse(&args.scene)?;
    let folder = &args.output;
    let cannot = |source: std::io::Error| {
        Failure::new(
            Kind::Output,
            format_args!("cannot write {}: {source}", folder.display()),
        )
    };
    fs::create_dir_all(folder).map_err(cannot)?;
    let filled = fs::read_dir(folder).map_err(cannot)?.next().is_some();
    if filled && !args.overwrite {
        return Err(Failure::usage(format_args!(
            "{} is not empty; give another name or --overwrite",
            folder.display()
        )));
    }
    let bar = (!quiet).then(|| status::progress(args.frames));
    let mut stopped = None;
    let written = generate(options, args.frames, &mut |camera, frame| {
        if stop.load(Ordering::Relaxed) {
            stopped = Some(frame.sequence);
            return Err(Failure::new(Kind::Closed, ""));
        }
        let path = folder.join(format!("{:06}.exr", frame.sequence));
        write_exr_depth(&path, camera, frame).map_err(export::output_error)?;
        if let Some(bar) = &bar {
            bar.inc(1);
        }
        Ok(())
    });
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    let frames = match (written, stopped) {
        (_, Some(done)) => done,
        (written, None) => written?,
    };
    if !quiet {
        message::say(&format!("wrote {}: {frames} files", folder.display()));
    }
    Ok(())
}
