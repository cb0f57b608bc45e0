//! Depth cameras through V4L2, the kernel's video interface.
//!
//! [`V4l2Source`] opens a node (`setup`), drains its buffers (`ring`) and turns each into a frame
//! ([`depth_format`], [`clock`], [`loss`]). What a camera may do to us (stall, break, leave and
//! come back) is met in one place (`recovery`); the decisions themselves are pure.

pub mod clock;
pub mod depth_format;
pub mod fourcc;
mod geometry;
pub mod grant;
pub mod loss;
pub mod negotiation;
pub mod node;
pub mod node_kind;
pub mod offer;
mod realsense;
pub mod reconnect;
mod recovery;
pub mod refusal;
mod reopen;
mod ring;
mod setup;
pub mod usb;

use super::color::ColorSource;
use super::{CaptureError, FrameSource, Next, SourceLosses};
use crate::frame::{Camera, ColorFrame, DepthFrame, Intrinsics};
use clock::{ClockNote, FrameClock, monotonic_ns};
use depth_format::Rows;
use loss::SequenceCounter;
use negotiation::{Plan, Wish};
use reconnect::Identity;
use reopen::Reopening;
use ring::{Ring, Waited};
use setup::Opened;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How to open a depth camera.
#[derive(Clone, Debug, PartialEq)]
pub struct V4l2Options {
    /// `/dev/videoN`, `N`, a serial number, a bus id, or `auto`
    /// ([`DeviceName`](super::devices::naming::DeviceName)).
    pub device: String,
    /// Width and height, pixels; `None` takes the size nearest to 640×480.
    pub size: Option<(u32, u32)>,
    /// Frames per second; `None` takes the fastest up to 30.
    pub fps: Option<u32>,
    /// `Z16`, `Y16`, `Y14`, `Y12`, `Y10` or `Y10B`; `None` takes Z16 alone.
    pub pixel_format: Option<String>,
    /// Metres per depth integer; `None` asks the camera, then assumes 0.001.
    pub depth_unit_m: Option<f64>,
    /// Intrinsics; `None` asks the camera (RealSense answers).
    pub intrinsics: Option<Intrinsics>,
    /// Image size the intrinsics are for; `None` means the size captured.
    pub intrinsics_size: Option<(u32, u32)>,
    /// Depths nearer than this are not measurements, metres.
    pub depth_min_m: f64,
    /// Depths farther than this are not measurements, metres.
    pub depth_max_m: f64,
    /// Depth integers that mean "no measurement", beside 0.
    pub invalid: Vec<u16>,
    /// How long to wait for a camera that is unplugged, silent or broken; `None` waits for ever.
    pub give_up: Option<Duration>,
}

impl Default for V4l2Options {
    fn default() -> Self {
        Self {
            device: "auto".into(),
            size: None,
            fps: None,
            pixel_format: None,
            depth_unit_m: None,
            intrinsics: None,
            intrinsics_size: None,
            depth_min_m: 0.0,
            depth_max_m: 65.0,
            invalid: Vec::new(),
            give_up: None,
        }
    }
}

/// Longest time [`V4l2Source::next`] takes to say that there is no frame.
const POLL: Duration = Duration::from_millis(150);

/// A depth camera behind a V4L2 node. Stopped and closed on drop.
pub struct V4l2Source {
    camera: Camera,
    path: PathBuf,
    identity: Identity,
    plan: Plan,
    wish: Wish,
    rows: Rows,
    link: Link,
    give_up: Option<Duration>,
    counter: SequenceCounter,
    clock: FrameClock,
    clock_noted: Option<ClockNote>,
    losses: SourceLosses,
    frames: u64,
    last_frame: Instant,
    restarts: u32,
    /// Why the camera is still away.
    trouble: String,
    notes: Vec<(&'static str, String)>,
    color: Option<ColorSource>,
}

/// Whether there is a stream.
enum Link {
    Streaming(Ring),
    /// The camera is being looked for, or its stream started anew.
    Opening(Reopening),
    /// It was not found, or would not start: it is looked for again then.
    Lost(Instant),
}

/// What one look at the camera gave.
enum Step {
    Frame,
    /// A frame was thrown away, or something changed: look again.
    Again,
    Waiting(Option<String>),
}

impl V4l2Source {
    /// Opens a camera and starts its stream.
    ///
    /// # Errors
    /// [`CaptureError::Device`] when the node cannot be opened, is not depth, or does not give
    /// what was asked; [`CaptureError::Usage`] when an option is wrong or the intrinsics are
    /// neither given nor told by the camera.
    pub fn open(options: &V4l2Options) -> Result<Self, CaptureError> {
        let Opened {
            path,
            ring,
            rows,
            plan,
            wish,
            camera,
            identity,
            from_zero,
            notes,
        } = setup::open(options)?;
        tracing::info!(
            "{}: `{}` {} {}x{} at {} frames/s",
            path.display(),
            camera.name,
            plan.format.fourcc(),
            plan.width,
            plan.height,
            camera.fps.map_or("unknown".into(), |f| f.to_string()),
        );
        Ok(Self {
            camera,
            path,
            identity,
            plan,
            wish,
            rows,
            link: Link::Streaming(ring),
            give_up: options.give_up,
            counter: SequenceCounter::new(from_zero),
            clock: FrameClock::now(),
            clock_noted: None,
            losses: SourceLosses::default(),
            frames: 0,
            last_frame: Instant::now(),
            restarts: 0,
            trouble: String::new(),
            notes,
            color: None,
        })
    }

    /// Puts a colour camera beside this one: its images come out of `take_color`.
    #[must_use]
    pub fn with_color(mut self, color: ColorSource) -> Self {
        self.color = Some(color);
        self
    }

    /// The node in use; another one after the camera was plugged in again.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The colour camera beside this one: its losses, and why it ended if it did.
    #[must_use]
    pub fn color(&self) -> Option<&ColorSource> {
        self.color.as_ref()
    }

    fn read(&mut self, frame: &mut DepthFrame, timeout: Duration) -> Result<Step, CaptureError> {
        let Link::Streaming(ring) = &mut self.link else {
            return Ok(Step::Again);
        };
        let taken = match ring.wait(timeout) {
            Ok(Waited::Nothing) => return self.silent(),
            Ok(Waited::Ready) => ring.take(),
            Err(error) => Err(error),
        };
        let taken = match taken {
            Ok(taken) => taken,
            Err(error) => return self.broken(&error),
        };
        let (stamp_ns, monotonic) = (taken.stamp_ns, taken.monotonic);
        let arrival_ns = monotonic_ns();
        let (sequence, gap) = self.counter.accept(taken.sequence);
        let damage = match taken.damaged {
            true => Some("the driver calls it damaged".to_string()),
            false => (self.plan.format)
                .unpack(ring.bytes(&taken), self.rows, &mut frame.depth)
                .err()
                .map(|short| short.to_string()),
        };
        // The frame is copied: an error here is met again at the next look.
        if let Err(error) = ring.give_back(taken) {
            tracing::debug!(%error, "a frame buffer was not given back");
        }
        self.losses.sensor_gap += gap;
        self.last_frame = Instant::now();
        self.restarts = 0;
        if let Some(damage) = damage {
            self.losses.damaged += 1;
            tracing::debug!(sequence, damage, "frame skipped");
            return Ok(Step::Again);
        }
        let (time, note) = self.clock.frame_time(stamp_ns, monotonic, arrival_ns);
        self.note_clock(note);
        frame.sequence = sequence;
        frame.time = time;
        self.frames += 1;
        Ok(Step::Frame)
    }

    /// Says once per kind what is wrong with the driver's stamps.
    fn note_clock(&mut self, note: Option<ClockNote>) {
        let Some(kind) = note.filter(|_| note != self.clock_noted) else {
            return;
        };
        self.clock_noted = note;
        let path = self.path.display();
        match kind {
            ClockNote::Future => {
                tracing::debug!("{path}: frame stamps in the future, arrival times used");
            }
            ClockNote::Unmarked => {
                tracing::warn!("{path}: frame stamps are not marked monotonic, taken as such");
            }
            ClockNote::Unknown => {
                tracing::warn!("{path}: frame stamps on an unknown clock, arrival times used");
            }
        }
    }
}

impl FrameSource for V4l2Source {
    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn is_live(&self) -> bool {
        true
    }

    fn next(&mut self, frame: &mut DepthFrame) -> Result<Next, CaptureError> {
        let until = Instant::now() + POLL;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let step = match self.link {
                Link::Streaming(_) => self.read(frame, left)?,
                Link::Opening(_) | Link::Lost(_) => self.come_back(left)?,
            };
            match step {
                Step::Frame => return Ok(Next::Frame),
                Step::Waiting(text) => return Ok(Next::Waiting(text)),
                Step::Again if Instant::now() >= until => return Ok(Next::Waiting(None)),
                Step::Again => {}
            }
        }
    }

    fn take_color(&mut self) -> Option<ColorFrame> {
        self.color.as_mut()?.take()
    }

    fn losses(&self) -> SourceLosses {
        self.losses
    }

    fn notes(&self) -> Vec<(&'static str, String)> {
        self.notes.clone()
    }
}
