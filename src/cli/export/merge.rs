//! `export --merge`: the cameras of a recording together, frame by frame of the first.

use super::super::failure::{Failure, Kind};
use super::super::message;
use super::super::tape::Tape;
use saint_live::export::union::{Seen, View};
use saint_live::frame::FrameTime;
use saint_live::recording::RecordingReader;
use saint_live::rig::{POSE_NOTE, Pose};
use std::path::Path;

/// A frame farther from the first camera's than this is of another moment, ns.
const SAME_MOMENT_NS: u64 = 250_000_000;

/// The first camera of a recording.
pub fn first(path: &Path) -> Result<Tape, Failure> {
    let reader = RecordingReader::open(path)?;
    let name = reader.cameras().first().map_or("", String::as_str);
    Tape::open_camera(path, name)
}

/// A camera and where it stands.
struct Placed {
    tape: Tape,
    pose: Pose,
    /// A frame was decoded.
    begun: bool,
}

/// The cameras beside the first.
pub struct Others {
    first: Pose,
    cameras: Vec<Placed>,
    /// Frames of the first camera for which one of the others had none near in time.
    alone: u64,
}

impl Others {
    /// Opens all cameras of a recording but the first, `tape`.
    pub fn open(path: &Path, tape: &Tape) -> Result<Self, Failure> {
        let Some(names) = tape.cameras().get(1..).filter(|names| !names.is_empty()) else {
            return Err(Failure::usage(format_args!(
                "{} holds one camera: there is nothing to merge",
                path.display()
            )));
        };
        let pose = |tape: &Tape, name: &str| {
            tape.note::<Pose>(POSE_NOTE).ok_or_else(|| {
                let path = path.display();
                let what = "does not say where it stands; record with poses in a rig file (--rig)";
                Failure::new(Kind::Input, format_args!("{path}: camera `{name}` {what}"))
            })
        };
        let mut cameras = Vec::new();
        for name in names {
            let tape = Tape::open_camera(path, name)?;
            cameras.push(Placed {
                pose: pose(&tape, name)?,
                tape,
                begun: false,
            });
        }
        Ok(Self {
            first: pose(tape, tape.cameras().first().map_or("", String::as_str))?,
            cameras,
            alone: 0,
        })
    }

    /// The first camera's frame and the frame of each other that is nearest in time.
    pub fn beside<'a>(&'a mut self, first: &'a Tape) -> Vec<View<'a>> {
        let mut views = vec![View {
            camera: 0,
            pose: self.first,
            seen: seen(first),
        }];
        let mut complete = true;
        for (placed, camera) in self.cameras.iter_mut().zip(1u8..) {
            if placed.go_to(first.time()) {
                views.push(View {
                    camera,
                    pose: placed.pose,
                    seen: seen(&placed.tape),
                });
            } else {
                complete = false;
            }
        }
        self.alone += u64::from(!complete);
        views
    }

    /// Says what was missing.
    pub fn finish(self, quiet: bool) -> Result<(), Failure> {
        if self.alone > 0 && !quiet {
            message::say(&format!(
                "{} frames lack a camera: it had none within {} ms",
                self.alone,
                SAME_MOMENT_NS / 1_000_000
            ));
        }
        for camera in self.cameras {
            camera.tape.finish()?;
        }
        Ok(())
    }
}

impl Placed {
    /// Goes on to the frame nearest to `time`; false where it is of another moment.
    fn go_to(&mut self, time: FrameTime) -> bool {
        loop {
            // before a damaged place there is no next time: the tape finds its way over it
            let next = self.tape.next_time();
            if self.begun
                && next.is_some_and(|next| apart(next, time) > apart(self.tape.time(), time))
            {
                break;
            }
            if self.tape.advance().is_none() {
                break;
            }
            self.begun = true;
        }
        self.begun && apart(self.tape.time(), time) <= SAME_MOMENT_NS
    }
}

/// Time between two frames, ns: by the wall clock where both know it, else by the device clocks.
fn apart(a: FrameTime, b: FrameTime) -> u64 {
    if a.wall_ns != 0 && b.wall_ns != 0 {
        a.wall_ns.abs_diff(b.wall_ns)
    } else {
        a.device_ns.abs_diff(b.device_ns)
    }
}

fn seen(tape: &Tape) -> Seen<'_> {
    match tape.cloud() {
        Some(cloud) => Seen::Cloud(cloud),
        None => Seen::Frame(tape.frame()),
    }
}
