//! A colour camera beside the depth camera. Whatever happens to it, depth goes on.

use super::super::args::CaptureArgs;
use super::super::message;
use saint_live::capture::color::{ColorLosses, ColorSource as ColorCamera};
use saint_live::capture::{CaptureError, Next};
use saint_live::frame::ColorFrame;
use saint_live::pipeline::color::ColorSource;
use std::time::{Duration, Instant};

/// Pause before a colour camera that failed is opened again.
const RETRY: Duration = Duration::from_secs(2);
/// How often the camera's own thread is asked for an image.
const LOOK: Duration = Duration::from_millis(5);
/// Longest time without an answer.
const POLL: Duration = Duration::from_millis(100);

/// The colour camera that `--color-device` names. One that does not open is told and tried again.
pub fn color(args: &CaptureArgs) -> Option<Color> {
    let mut color = Color {
        device: args.color_device.clone()?,
        fps: args.fps,
        camera: None,
        retry: Instant::now(),
        before: ColorLosses::default(),
        told: String::new(),
    };
    color.open();
    Some(color)
}

/// A colour camera as the pipeline asks it.
pub struct Color {
    device: String,
    fps: Option<u32>,
    /// `None` while it cannot be opened.
    camera: Option<ColorCamera>,
    retry: Instant,
    /// Losses of cameras that failed.
    before: ColorLosses,
    told: String,
}

impl Color {
    fn open(&mut self) {
        match ColorCamera::open(&self.device, None, self.fps) {
            Ok(camera) => {
                if !self.told.is_empty() {
                    message::say(&format!("{}: colour is back", self.device));
                }
                self.told.clear();
                self.camera = Some(camera);
            }
            Err(error) => self.failed(&error.to_string()),
        }
    }

    /// Says once what is wrong.
    fn failed(&mut self, what: &str) {
        if let Some(camera) = self.camera.take() {
            let losses = camera.losses();
            self.before.queue += losses.queue;
            self.before.damaged += losses.damaged;
        }
        if self.told != what {
            message::say(&format!("colour: {what}; depth goes on without it"));
            self.told = what.to_owned();
        }
        self.retry = Instant::now() + RETRY;
    }
}

impl ColorSource for Color {
    fn next(&mut self, color: &mut ColorFrame) -> Result<Next, CaptureError> {
        let until = Instant::now() + POLL;
        while Instant::now() < until {
            match &mut self.camera {
                Some(camera) => {
                    if let Some(image) = camera.take() {
                        *color = image;
                        return Ok(Next::Frame);
                    }
                    if let Some(error) = camera.error().map(str::to_owned) {
                        self.failed(&format!("{}: {error}", self.device));
                    }
                }
                None if Instant::now() >= self.retry => self.open(),
                None => {}
            }
            std::thread::sleep(LOOK);
        }
        Ok(Next::Waiting(None))
    }

    fn lost(&self) -> u64 {
        let now = self
            .camera
            .as_ref()
            .map(ColorCamera::losses)
            .unwrap_or_default();
        self.before.queue + self.before.damaged + now.queue + now.damaged
    }
}
