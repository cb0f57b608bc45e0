//! Where frames go: a recording, or nowhere (then only the numbers count).

use super::args::{StreamArgs, SyncArg};
use super::failure::Failure;
use saint_live::frame::Camera;
use saint_live::pipeline::recorder::Recorder;
use saint_live::recording::{CameraStream, RecordingWriter, Sync, Target, WriterOptions};
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::Path;

/// True where `-o -` was given.
pub fn is_stdout(args: &StreamArgs) -> bool {
    args.output.as_deref() == Some(Path::new("-"))
}

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
    let target = if is_stdout(args) {
        if std::io::stdout().is_terminal() {
            return Err(Failure::usage(
                "-o - writes a binary recording, and standard output is a terminal; redirect it or name a file",
            ));
        }
        Target::stdout()?
    } else {
        Target::File {
            path: path.clone(),
            overwrite: args.overwrite,
        }
    };
    let options = WriterOptions {
        sync: match args.sync {
            SyncArg::End => Sync::End,
            SyncArg::Chunk => Sync::Chunk,
        },
        split: args.split,
    };
    let writer = RecordingWriter::create_rig(target, cameras, &options)?;
    Ok(Recorder::rig(writer, cameras.len()))
}
