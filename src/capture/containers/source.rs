//! A container's images as a [`FrameSource`]: who is believed about the camera, numbers, times.

use super::{Container, DepthImage, Stamp, Stored, damaged};
use crate::capture::sequences::camera::Known;
use crate::capture::sequences::metres::{Planar, Refused};
use crate::capture::sequences::timestamps::frame_time;
use crate::capture::sequences::{DEFAULT_FPS, DEFAULT_UNIT_M, SequenceOptions, in_frame, input};
use crate::capture::{CaptureError, FrameSource, Next, SourceLosses};
use crate::frame::{Camera, ColorFrame, DepthFrame, FrameTime};
use std::path::{Path, PathBuf};

/// Never live: the caller's pace is the pace.
pub(super) struct ContainerSource {
    container: Box<dyn Container>,
    path: PathBuf,
    camera: Camera,
    planar: Planar,
    image: DepthImage,
    /// The image was read on opening and not given yet.
    held: bool,
    /// Images to give yet.
    left: u64,
    given: u64,
    /// First time on the file's one clock, ns: where the device clock begins.
    zero_ns: Option<i64>,
    /// Number and time of the frame given last.
    last: Option<(u64, FrameTime)>,
    losses: SourceLosses,
    refused: Refused,
    /// Colour images are wanted.
    color: bool,
}

impl ContainerSource {
    /// Reads the first image and settles the camera.
    pub(super) fn open(
        mut container: Box<dyn Container>,
        path: &Path,
        options: &SequenceOptions,
    ) -> Result<Self, CaptureError> {
        let mut image = DepthImage::default();
        for skipped in 0..=options.first {
            if !container.next(&mut image)? {
                return Err(match (skipped, options.first) {
                    (0, 0) => input(path, "holds no depth image", "give a longer recording"),
                    (all, first) => CaptureError::Usage(format!(
                        "{}: no frame is left of {all} after skipping {first}",
                        path.display()
                    )),
                });
            }
        }
        let about = container.about();
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let known = Known {
            options,
            input: path,
            said: about.said.clone(),
            sidecar: about.calibration.as_ref(),
            unit_m: about.unit_m,
            invalid: &[0],
            suggestion: "",
            name: &name,
            integers: image.stored == Stored::Integers,
            fps: None,
        };
        let intrinsics = known.intrinsics(image.width, image.height)?;
        let planar = Planar::new(
            crate::capture::sequences::ExrDepth::Planar,
            &intrinsics,
            image.width,
            image.height,
        );
        let camera = known.camera((image.width, image.height), intrinsics, |said| {
            match (image.stored, said) {
                (_, Some(unit)) => unit,
                (Stored::Integers, None) => DEFAULT_UNIT_M,
                (Stored::Metres, None) => planar.fitting_unit_m(&image.metres),
            }
        })?;
        let most = options.count.map_or(u64::MAX, |count| count as u64);
        let left = about.images.map_or(most, |images| {
            images.saturating_sub(options.first as u64).min(most)
        });
        Ok(Self {
            container,
            path: path.to_owned(),
            camera,
            planar,
            image,
            held: true,
            left: left.max(1),
            given: 0,
            zero_ns: None,
            last: None,
            losses: SourceLosses::default(),
            refused: Refused::default(),
            color: !options.without_color,
        })
    }

    /// The file's number where it grows, else counted on.
    fn number(&mut self) -> u64 {
        match (self.image.number, &self.last) {
            (Some(number), Some((last, _))) if number > *last => {
                let skipped = number - last - 1;
                self.losses.sensor_gap = self.losses.sensor_gap.saturating_add(skipped);
                number
            }
            (Some(number), None) => number,
            (_, Some((last, _))) => last.saturating_add(1),
            (None, None) => 0,
        }
    }

    /// The file's time, else counted on at the frame rate.
    fn time(&mut self, number: u64) -> FrameTime {
        match self.image.time {
            Stamp::Exact(time) => time,
            Stamp::Clock(ns) => frame_time(ns, *self.zero_ns.get_or_insert(ns)),
            Stamp::Unknown => {
                let (last, time) = self.last.unwrap_or((number, FrameTime::default()));
                let fps = self.camera.fps.unwrap_or(DEFAULT_FPS);
                let later = (number.saturating_sub(last) as f64 * 1e9 / fps).round() as i64;
                FrameTime {
                    device_ns: time.device_ns.saturating_add(later),
                    wall_ns: match time.wall_ns {
                        0 => 0,
                        wall => wall.saturating_add(later),
                    },
                }
            }
        }
    }
}

impl FrameSource for ContainerSource {
    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn is_live(&self) -> bool {
        false
    }

    fn len_hint(&self) -> Option<u64> {
        self.container.about().images.map(|_| self.left)
    }

    /// A damaged image is an error; the next call goes on behind it where that is possible.
    fn next(&mut self, frame: &mut DepthFrame) -> Result<Next, CaptureError> {
        if self.left == 0 {
            return Ok(Next::End);
        }
        let position = self.given;
        if !std::mem::take(&mut self.held) {
            let read = self.container.next(&mut self.image);
            if !read.map_err(|error| in_frame(error, position))? {
                self.left = 0;
                return Ok(Next::End);
            }
        }
        self.left -= 1;
        self.given += 1;
        let (width, height) = (self.image.width, self.image.height);
        if (width, height) != (self.camera.width, self.camera.height) {
            let what = format!(
                "{width}x{height} pixels, but the first image has {}x{}",
                self.camera.width, self.camera.height
            );
            return Err(in_frame(damaged(&self.path, what), position));
        }
        match self.image.stored {
            Stored::Integers => std::mem::swap(&mut frame.depth, &mut self.image.integers),
            Stored::Metres => {
                let unit = self.camera.depth_unit_m;
                let refused = self
                    .planar
                    .quantise(&self.image.metres, unit, &mut frame.depth);
                self.refused.add(refused);
            }
        }
        let number = self.number();
        let time = self.time(number);
        self.last = Some((number, time));
        (frame.sequence, frame.time) = (number, time);
        Ok(Next::Frame)
    }

    fn take_color(&mut self) -> Option<ColorFrame> {
        let color = self.container.take_color();
        color.filter(|_| self.color)
    }

    fn losses(&self) -> SourceLosses {
        self.losses
    }
}

impl Drop for ContainerSource {
    fn drop(&mut self) {
        if self.refused.total() > 0 {
            tracing::debug!(
                "{}: samples without a depth: {:?}",
                self.path.display(),
                self.refused
            );
        }
    }
}
