//! A colour camera beside the depth camera, read through `nokhwa`.
//!
//! It has its own thread, which hands images over in a short queue; when nobody takes them, the
//! oldest is dropped and counted. Its errors end colour and are told; depth goes on.

use super::CaptureError;
use super::color_image::{jpeg_image, png_of_yuyv};
use super::color_open::{ColorPlan, open_camera, plan, prepare, refuse};
use super::devices::naming::DeviceName;
use super::devices::{self, DeviceReport};
use super::v4l2::clock::{FrameClock, monotonic_ns};
use super::v4l2::node_kind::NodeKind;
use super::v4l2::refusal;
use crate::frame::ColorFrame;
use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use nokhwa::Camera;
use nokhwa::utils::FrameFormat;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Images that may wait. Two, so that one may arrive while the other is taken.
const QUEUE: usize = 2;
/// How long a stop waits for the thread. A silent camera holds it in the driver: it is left
/// behind then, and ends with the process or the camera's next image.
const STOP_WAIT: Duration = Duration::from_millis(300);

/// How long opening may take.
const OPEN_WAIT: Duration = Duration::from_secs(3);

/// Images lost, by cause.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct ColorLosses {
    /// Nobody took them in time.
    pub queue: u64,
    /// Damaged on the way.
    pub damaged: u64,
}

/// A colour camera and the thread that reads it. Stopped on drop.
pub struct ColorSource {
    path: PathBuf,
    size: (u32, u32),
    images: Receiver<ColorFrame>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<Result<(), String>>>,
    error: Option<String>,
}

/// What both sides see.
#[derive(Debug, Default)]
struct Shared {
    stop: AtomicBool,
    dropped: AtomicU64,
    damaged: AtomicU64,
}

impl ColorSource {
    /// Opens the camera `device` names ([`DeviceName`]) and starts its thread. MJPG is preferred,
    /// YUYV taken.
    ///
    /// # Errors
    /// [`CaptureError::Device`] when the node is not a colour camera, has neither format, or is
    /// busy or forbidden.
    pub fn open(
        device: &str,
        size: Option<(u32, u32)>,
        fps: Option<u32>,
    ) -> Result<Self, CaptureError> {
        let path = match DeviceName::parse(device) {
            DeviceName::Path(path) => path,
            name => {
                let is_color = |report: &DeviceReport| report.kind == NodeKind::Color;
                let chosen = name.choose(&devices::describe_all(), is_color, "colour");
                chosen.map_err(|what| {
                    let remedy = "choose a colour camera that `saint-live devices` lists";
                    refuse(Path::new(device), what, remedy.into())
                })?
            }
        };
        let path = std::fs::canonicalize(&path)
            .map_err(|error| refusal::device_error(&path, "open it", &error))?;
        let report = devices::describe(&path);
        let plan =
            plan(&report, size, fps).map_err(|(what, remedy)| refuse(&path, what, remedy))?;
        prepare(&path, &plan)?;
        let (to, images) = bounded(QUEUE);
        let shared = Arc::new(Shared::default());
        let mailbox = Mailbox {
            to,
            oldest: images.clone(),
            shared: shared.clone(),
        };
        let (opened, result) = bounded(1);
        let node = path.clone();
        let thread = thread::Builder::new()
            .name("color".into())
            .spawn(move || {
                block_signals();
                // A nokhwa camera stays in the thread that opened it.
                match open_camera(&node, &plan) {
                    Ok(camera) => {
                        let _ = opened.send(Ok(()));
                        read(camera, plan, &mailbox)
                    }
                    Err(error) => {
                        let text = error.to_string();
                        let _ = opened.send(Err(error));
                        Err(text)
                    }
                }
            })
            .map_err(|error| refusal::device_error(&path, "start its thread", &error))?;
        match result.recv_timeout(OPEN_WAIT) {
            Ok(opened) => opened?,
            Err(_) => {
                let what = "the colour camera did not open".to_string();
                return Err(refuse(&path, what, "plug it in again".into()));
            }
        }
        Ok(Self {
            path,
            size: plan.size,
            images,
            shared,
            thread: Some(thread),
            error: None,
        })
    }

    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        self.size
    }

    /// The oldest image waiting. Never blocks.
    pub fn take(&mut self) -> Option<ColorFrame> {
        let image = self.images.try_recv().ok();
        if image.is_none() && self.thread.as_ref().is_some_and(JoinHandle::is_finished) {
            self.join();
        }
        image
    }

    /// Why there are no more images, once there are none.
    #[must_use]
    pub fn error(&self) -> Option<&str> {
        self.error.as_deref()
    }

    /// Images lost so far.
    #[must_use]
    pub fn losses(&self) -> ColorLosses {
        ColorLosses {
            queue: self.shared.dropped.load(Ordering::Relaxed),
            damaged: self.shared.damaged.load(Ordering::Relaxed),
        }
    }

    fn join(&mut self) {
        let result = self.thread.take().map(JoinHandle::join);
        let error = match result {
            None | Some(Ok(Ok(()))) => return,
            Some(Ok(Err(error))) => error,
            Some(Err(_)) => "its thread ended unexpectedly".into(),
        };
        tracing::debug!("{}: no more colour: {error}", self.path.display());
        self.error = Some(error);
    }
}

impl Drop for ColorSource {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        let until = Instant::now() + STOP_WAIT;
        while let Some(thread) = &self.thread {
            if thread.is_finished() {
                self.join();
            } else if Instant::now() >= until {
                tracing::debug!(
                    "{}: the colour camera is silent, left behind",
                    self.path.display()
                );
                return;
            } else {
                thread::sleep(Duration::from_millis(5));
            }
        }
    }
}

/// The sending side of the queue.
struct Mailbox {
    to: Sender<ColorFrame>,
    /// The queue's own end, to drop the oldest from.
    oldest: Receiver<ColorFrame>,
    shared: Arc<Shared>,
}

impl Mailbox {
    /// Puts an image into the queue, in the place of the oldest when it is full.
    fn post(&self, image: ColorFrame) {
        let mut image = image;
        while let Err(TrySendError::Full(back)) = self.to.try_send(image) {
            if self.oldest.try_recv().is_ok() {
                self.shared.dropped.fetch_add(1, Ordering::Relaxed);
            }
            image = back;
        }
    }
}

/// Reads until told to stop or the camera fails.
fn read(mut camera: Camera, plan: ColorPlan, mailbox: &Mailbox) -> Result<(), String> {
    let clock = FrameClock::now();
    let mut sequence = 0;
    while !mailbox.shared.stop.load(Ordering::Relaxed) {
        let buffer = match camera.frame() {
            Ok(buffer) => buffer,
            Err(error) => {
                // Closing a broken stream panics in v4l; the process closes it at its end.
                std::mem::forget(camera);
                return Err(error.to_string());
            }
        };
        let stamp = buffer.capture_timestamp();
        let stamp_ns = stamp.and_then(|s| i64::try_from(s.as_nanos()).ok());
        let time = match stamp_ns {
            Some(wall_ns) => clock.at_wall(wall_ns),
            None => clock.at(monotonic_ns()),
        };
        let image = match plan.format {
            FrameFormat::MJPEG => jpeg_image(buffer.buffer()).map(|i| ("jpeg", i.to_vec())),
            _ => png_of_yuyv(buffer.buffer(), plan.size.0, plan.size.1).map(|i| ("png", i)),
        };
        match image {
            Some((format, data)) => mailbox.post(ColorFrame {
                sequence,
                time,
                format: format.into(),
                data,
            }),
            None => {
                mailbox.shared.damaged.fetch_add(1, Ordering::Relaxed);
            }
        }
        sequence += 1;
    }
    Ok(())
}

/// Keeps signals away from this thread: one that interrupts `v4l` in its wait leaves its stream
/// out of step for ever. Other threads still get them.
fn block_signals() {
    // SAFETY: both calls only read or write the local set and this thread's mask; zero bytes are
    // a valid set, which sigfillset then fills.
    #[allow(unsafe_code)]
    unsafe {
        let mut all: libc::sigset_t = std::mem::zeroed();
        libc::sigfillset(&raw mut all);
        libc::pthread_sigmask(libc::SIG_BLOCK, &raw const all, std::ptr::null_mut());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_queue_drops_its_oldest_and_counts() {
        let (to, images) = bounded(QUEUE);
        let shared = Arc::new(Shared::default());
        let mailbox = Mailbox {
            to,
            oldest: images.clone(),
            shared: shared.clone(),
        };
        for sequence in 0..5 {
            mailbox.post(ColorFrame {
                sequence,
                ..ColorFrame::default()
            });
        }
        let left: Vec<u64> = images.try_iter().map(|i| i.sequence).collect();
        assert_eq!(left, [3, 4]);
        assert_eq!(shared.dropped.load(Ordering::Relaxed), 3);
    }

    #[test]
    fn a_missing_node_is_a_device_error() {
        let error = ColorSource::open("/nonexistent/video1", None, None);
        assert!(matches!(error.err(), Some(CaptureError::Device { .. })));
    }
}
