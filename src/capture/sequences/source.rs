//! A sequence of image files as a [`FrameSource`].

use super::camera::{Known, Said, rate};
use super::exr::{ExrChannel, ExrImage, read_exr_depth};
use super::layout::{Format, Layout};
use super::metres::{Planar, Refused};
use super::png::read_png_depth;
use super::{
    ColorFile, DEFAULT_FPS, DEFAULT_UNIT_M, FrameFile, SequenceOptions, in_frame, input, numbering,
};
use crate::capture::{CaptureError, FrameSource, Next, SourceLosses};
use crate::frame::{Camera, ColorFrame, DepthFrame, FrameTime};
use std::path::Path;

/// A colour image of a depth camera is a few megabytes.
const MAX_COLOR_BYTES: u64 = 1 << 26;

/// Image files, one frame each; never live: the caller's pace is the pace.
#[derive(Debug)]
pub(super) struct ImageSequence {
    camera: Camera,
    frames: Vec<FrameFile>,
    images: Images,
    planar: Planar,
    /// Index of the next frame.
    position: usize,
    /// Where times are counted from when a file has none: a frame number and its time.
    anchor: (u64, FrameTime),
    /// The camera came from the images' own attributes: all of them must agree.
    by_attributes: bool,
    losses: SourceLosses,
    refused: Refused,
    /// Colour of the frame returned last.
    color: Option<(u64, FrameTime, ColorFile)>,
    without_color: bool,
}

/// The decoder and the buffers it fills again for each frame.
#[derive(Debug)]
struct Images {
    format: Format,
    channel: Option<String>,
    layer: Option<String>,
    exr: ExrImage,
    png_bytes: Vec<u8>,
    png: Vec<u16>,
    size: (u32, u32),
    /// Index of the frame the buffers hold.
    held: Option<usize>,
}

impl Images {
    /// Decodes a frame into the buffers, unless they hold it already.
    fn load(&mut self, index: usize, path: &Path) -> Result<(), CaptureError> {
        if self.held == Some(index) {
            return Ok(());
        }
        self.held = None;
        self.size = match self.format {
            Format::Png => read_png_depth(path, &mut self.png_bytes, &mut self.png)?,
            Format::Exr => {
                let channel = ExrChannel {
                    name: self.channel.as_deref(),
                    layer: self.layer.as_deref(),
                };
                read_exr_depth(path, channel, &mut self.exr)?;
                (self.exr.width, self.exr.height)
            }
        };
        self.held = Some(index);
        Ok(())
    }
}

impl ImageSequence {
    /// Opens the sequence and reads its first frame.
    pub(super) fn open(
        mut layout: Layout,
        options: &SequenceOptions,
    ) -> Result<Self, CaptureError> {
        let origin = layout.frames.first().map_or(0, |frame| frame.number);
        let all = layout.frames.len();
        let mut frames: Vec<FrameFile> = std::mem::take(&mut layout.frames)
            .into_iter()
            .skip(options.first)
            .take(options.count.unwrap_or(usize::MAX))
            .collect();
        frames.shrink_to_fit();
        let Some(first) = frames.first() else {
            let (path, skip) = (layout.input.display(), options.first);
            return Err(CaptureError::Usage(format!(
                "{path}: no frame is left of {all} after skipping {skip} and keeping {}",
                options
                    .count
                    .map_or("the rest".to_owned(), |n| n.to_string())
            )));
        };
        report_gaps(&layout.input, &frames);
        let mut images = Images {
            format: layout.format,
            channel: options.exr_channel.clone(),
            layer: options.exr_layer.clone(),
            exr: ExrImage::default(),
            png_bytes: Vec::new(),
            png: Vec::new(),
            size: (0, 0),
            held: None,
        };
        images
            .load(0, &first.path)
            .map_err(|error| in_frame(error, first.number))?;
        if images.exr.half {
            tracing::warn!(
                "{}: half floats: depth steps are 1 mm from 1 m on, 2 mm from 2 m, 4 mm from 4 m",
                first.path.display()
            );
        }
        let known = Known {
            options,
            input: &layout.input,
            said: Said::from(&images.exr.attributes),
            sidecar: layout.sidecar.as_ref(),
            unit_m: layout.unit_m,
            invalid: layout.invalid,
            suggestion: layout.suggestion,
            name: &layout.name,
            integers: layout.format == Format::Png,
            fps: rate(&frames),
        };
        let (width, height) = images.size;
        let intrinsics = known.intrinsics(width, height)?;
        let planar = Planar::new(options.exr_depth, &intrinsics, width, height);
        let camera = known.camera(images.size, intrinsics, |said| {
            match (layout.format, said) {
                (_, Some(unit)) => unit,
                (Format::Png, None) => DEFAULT_UNIT_M,
                (Format::Exr, None) => planar.fitting_unit_m(&images.exr.values),
            }
        })?;
        let by_attributes =
            options.calibration.is_none() && images.exr.attributes.intrinsics.is_some();
        Ok(Self {
            camera,
            by_attributes,
            frames,
            images,
            planar,
            position: 0,
            anchor: (origin, FrameTime::default()),
            losses: SourceLosses::default(),
            refused: Refused::default(),
            color: None,
            without_color: options.without_color,
        })
    }

    /// Time of a frame: from the lists, from the file, else counted on at the frame rate.
    fn time(&mut self, index: usize) -> FrameTime {
        let file = &self.frames[index];
        let inside = match self.images.format {
            Format::Exr => self.images.exr.attributes.time(),
            Format::Png => None,
        };
        if let Some(time) = file.time.or(inside) {
            self.anchor = (file.number, time);
            return time;
        }
        let (number, time) = self.anchor;
        let fps = self.camera.fps.unwrap_or(DEFAULT_FPS);
        let steps = file.number.saturating_sub(number) as f64;
        let later = (steps * 1e9 / fps).round() as i64;
        FrameTime {
            device_ns: time.device_ns.saturating_add(later),
            wall_ns: match time.wall_ns {
                0 => 0,
                wall => wall.saturating_add(later),
            },
        }
    }

    fn count_refused(&mut self, refused: Refused, path: &Path) {
        if self.refused.total() == 0 && refused.total() > 0 {
            tracing::warn!(
                "{}: samples without a depth: {} not finite, {} negative, {} beyond {:.2} m; \
                 they count as not measured, here and in later frames",
                path.display(),
                refused.not_finite,
                refused.negative,
                refused.too_far,
                65535.0 * self.camera.depth_unit_m
            );
        }
        self.refused.add(refused);
    }
}

impl FrameSource for ImageSequence {
    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn is_live(&self) -> bool {
        false
    }

    fn len_hint(&self) -> Option<u64> {
        Some((self.frames.len() - self.position) as u64)
    }

    /// A damaged image is an error; the next call goes on with the image after it.
    fn next(&mut self, frame: &mut DepthFrame) -> Result<Next, CaptureError> {
        let index = self.position;
        self.color = None;
        let Some(file) = self.frames.get(index) else {
            if self.refused.total() > 0 {
                tracing::debug!("samples without a depth in all frames: {:?}", self.refused);
            }
            return Ok(Next::End);
        };
        self.position += 1;
        let (number, path) = (file.number, file.path.clone());
        if let Some(before) = index.checked_sub(1) {
            let skipped = number
                .saturating_sub(self.frames[before].number)
                .saturating_sub(1);
            self.losses.sensor_gap = self.losses.sensor_gap.saturating_add(skipped);
        }
        self.images
            .load(index, &path)
            .map_err(|error| in_frame(error, number))?;
        let (width, height) = self.images.size;
        if (width, height) != (self.camera.width, self.camera.height) {
            let what = format!(
                "{width}x{height} pixels, but the first frame has {}x{}",
                self.camera.width, self.camera.height
            );
            let error = input(&path, what, "keep images of one size in a sequence");
            return Err(in_frame(error, number));
        }
        let own = self
            .images
            .exr
            .attributes
            .intrinsics
            .filter(|_| self.by_attributes);
        if let Some(own) = own.filter(|own| *own != self.camera.intrinsics) {
            let what = format!(
                "{own:?}, but the first frame has {:?}",
                self.camera.intrinsics
            );
            let remedy = "keep images of one camera in a sequence, or give --intrinsics for all";
            return Err(in_frame(input(&path, what, remedy), number));
        }
        match self.images.format {
            Format::Png => {
                std::mem::swap(&mut frame.depth, &mut self.images.png);
                self.images.held = None;
            }
            Format::Exr => {
                let unit = self.camera.depth_unit_m;
                let values = &self.images.exr.values;
                let refused = self.planar.quantise(values, unit, &mut frame.depth);
                self.count_refused(refused, &path);
            }
        }
        frame.sequence = number;
        frame.time = self.time(index);
        let color = self.frames[index].color.clone();
        self.color = color
            .filter(|_| !self.without_color)
            .map(|color| (number, frame.time, color));
        Ok(Next::Frame)
    }

    fn take_color(&mut self) -> Option<ColorFrame> {
        let (sequence, time, file) = self.color.take()?;
        match read_color(&file.path) {
            Ok((format, data)) => Some(ColorFrame {
                sequence,
                time: file.time.unwrap_or(time),
                format: format.to_owned(),
                data,
            }),
            Err(what) => {
                tracing::warn!("{}: colour left out: {what}", file.path.display());
                None
            }
        }
    }

    fn losses(&self) -> SourceLosses {
        self.losses
    }
}

/// The bytes of a colour image, untouched; the format is told by them, not by the name.
fn read_color(path: &Path) -> Result<(&'static str, Vec<u8>), String> {
    let bytes = std::fs::metadata(path)
        .map_err(|error| error.to_string())?
        .len();
    if bytes > MAX_COLOR_BYTES {
        return Err(format!(
            "{bytes} bytes, but at most {MAX_COLOR_BYTES} are carried"
        ));
    }
    let data = std::fs::read(path).map_err(|error| error.to_string())?;
    if data.starts_with(&[0xff, 0xd8]) {
        Ok(("jpeg", data))
    } else if data.starts_with(b"\x89PNG") {
        Ok(("png", data))
    } else {
        Err("neither JPEG nor PNG".to_owned())
    }
}

fn report_gaps(input_path: &Path, frames: &[FrameFile]) {
    let (missing, first) = numbering::gaps(frames.iter().map(|frame| frame.number));
    if let Some(first) = first {
        tracing::warn!(
            "{}: {missing} frame numbers are missing, the first is {first}",
            input_path.display()
        );
    }
}
