//! Where frames go: a recording, or nowhere (then only the numbers count).

use super::args::{RunArgs, StreamArgs, SyncArg};
use super::failure::Failure;
use saint_live::frame::Camera;
use saint_live::pipeline::recorder::Recorder;
use saint_live::recording::{CameraStream, RecordingWriter, Sync, Target, WriterOptions};
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::Path;

/// Opens what `-o` names, for one camera.
pub fn open(
    args: &StreamArgs,
    camera: &Camera,
    notes: BTreeMap<String, String>,
) -> Result<Recorder, Failure> {
    let only = CameraStream {
        name: String::new(),
        camera: camera.clone(),
        notes,
    };
    let mut recorders = open_rig(args, &[only])?;
    Ok(recorders.pop().unwrap_or_default())
}

/// Opens what `-o` names; each camera gets its side of it.
pub fn open_rig(args: &StreamArgs, cameras: &[CameraStream]) -> Result<Vec<Recorder>, Failure> {
    let Some(path) = &args.output else {
        return Ok(cameras.iter().map(|_| Recorder::default()).collect());
    };
    let writer =
        RecordingWriter::create_rig(target(path, &args.run)?, cameras, &options(&args.run))?;
    Ok(Recorder::rig(writer, cameras.len()))
}

/// What `-o PATH` means; `-` is standard output.
pub fn target(path: &Path, args: &RunArgs) -> Result<Target, Failure> {
    if path != Path::new("-") {
        return Ok(Target::File {
            path: path.to_owned(),
            overwrite: args.overwrite,
        });
    }
    if std::io::stdout().is_terminal() {
        return Err(Failure::usage(
            "-o - writes binary data, and standard output is a terminal; redirect it or name a file",
        ));
    }
    if args.stats.is_some() {
        return Err(Failure::usage(
            "-o - and --stats both write to standard output; name a file for one of them",
        ));
    }
    Ok(Target::stdout()?)
}

/// How the file is written.
pub fn options(args: &RunArgs) -> WriterOptions {
    WriterOptions {
        sync: match args.sync {
            SyncArg::End => Sync::End,
            SyncArg::Chunk => Sync::Chunk,
        },
        split: args.split,
    }
}
