//! Camera calibration from the files people have: one type, many layouts.
//!
//! Read here: our `camera.json`, ROS `camera_info` YAML, OpenCV `FileStorage` YAML and JSON,
//! ORB-SLAM settings, Open3D and RealSense JSON, a bare 3×3 matrix, and the text `fx,fy,cx,cy`.
//! `layouts` finds the numbers, `yaml` turns YAML into the tree JSON gives.
//!
//! The model is a pinhole without lens distortion. Depth cameras deliver rectified depth, so a
//! file with non-zero distortion is read, and said aloud, but the distortion is not applied.

mod layouts;
mod yaml;

use crate::frame::Intrinsics;
use std::path::{Path, PathBuf};

/// Calibration files are a few kilobytes; anything larger is some other file.
const MAX_FILE_BYTES: u64 = 1 << 20;
/// Largest relative difference of the two scales that still counts as the same aspect.
/// Sensor modes such as 848×480 are 0.6 % off the exact 16:9.
const ASPECT_TOLERANCE: f64 = 0.01;
/// How to give intrinsics: the remedy of every error here and of the sources.
pub const HOW_TO_GIVE: &str = "give --intrinsics FILE (camera.json, ROS or OpenCV YAML, \
     Open3D or RealSense JSON) or --intrinsics fx,fy,cx,cy";

/// Why a calibration cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum IntrinsicsError {
    /// The file cannot be read.
    #[error("{}: cannot read the calibration: {source}; check the path and its permissions", .path.display())]
    Io {
        /// The calibration file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file was read but holds no usable calibration.
    #[error("{}: {what}; {HOW_TO_GIVE}", .path.display())]
    Unreadable {
        /// The calibration file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// The text is not `fx,fy,cx,cy`.
    #[error("intrinsics \"{text}\": {what}; {HOW_TO_GIVE}")]
    Text {
        /// The text as given.
        text: String,
        /// What is wrong with it.
        what: String,
    },
    /// The image has another shape than the calibrated one, so the crop is unknown.
    #[error(
        "the calibration is for {}x{} and the image is {}x{}: another aspect, so it was cropped and \
         cannot be rescaled; give the intrinsics of the {}x{} mode",
        .calibrated.0, .calibrated.1, .image.0, .image.1, .image.0, .image.1
    )]
    Aspect {
        /// Width and height the calibration is for, pixels.
        calibrated: (u32, u32),
        /// Width and height of the image, pixels.
        image: (u32, u32),
    },
}

/// What a calibration file says about a camera. Only the intrinsics are always there.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Pinhole intrinsics, pixels, at [`Calibration::size`].
    pub intrinsics: Intrinsics,
    /// Image width and height they are for, pixels. `None`: for whatever image they are used on.
    pub size: Option<(u32, u32)>,
    /// Metres per depth integer.
    pub depth_unit_m: Option<f64>,
    /// Nearest depth that is a measurement, metres.
    pub depth_min_m: Option<f64>,
    /// Farthest depth that is a measurement, metres.
    pub depth_max_m: Option<f64>,
    /// Depth integers that mean "no measurement".
    pub invalid: Option<Vec<u16>>,
    /// Frames per second.
    pub fps: Option<f64>,
}

impl Calibration {
    /// A calibration of intrinsics alone, for an image of any size.
    #[must_use]
    pub fn from_intrinsics(intrinsics: Intrinsics) -> Self {
        Self {
            intrinsics,
            size: None,
            depth_unit_m: None,
            depth_min_m: None,
            depth_max_m: None,
            invalid: None,
            fps: None,
        }
    }

    /// Reads a calibration file; its layout is told by its content, not by its name.
    ///
    /// # Errors
    /// [`IntrinsicsError::Io`] when it cannot be read, [`IntrinsicsError::Unreadable`] when it
    /// holds no pinhole camera in a layout known here.
    pub fn read(path: &Path) -> Result<Self, IntrinsicsError> {
        let io = |source| IntrinsicsError::Io {
            path: path.to_owned(),
            source,
        };
        let unreadable = |what| IntrinsicsError::Unreadable {
            path: path.to_owned(),
            what,
        };
        let about = std::fs::metadata(path).map_err(io)?;
        if about.is_file() && about.len() > MAX_FILE_BYTES {
            return Err(unreadable(format!(
                "{} bytes, but a calibration has at most {MAX_FILE_BYTES}",
                about.len()
            )));
        }
        let bytes = std::fs::read(path).map_err(io)?;
        let text = String::from_utf8(bytes)
            .map_err(|_| unreadable("not a text file, so not a calibration".to_owned()))?;
        let (calibration, distorted) = parse(&text).map_err(unreadable)?;
        if distorted {
            tracing::warn!(
                "{}: lens distortion is not applied; the depth images must be rectified",
                path.display()
            );
        }
        Ok(calibration)
    }

    /// Reads the value of `--intrinsics`: `fx,fy,cx,cy` in pixels, or the path of a file.
    ///
    /// # Errors
    /// [`IntrinsicsError::Text`] for a list that is not four usable numbers, else as
    /// [`Calibration::read`].
    pub fn parse_flag(text: &str) -> Result<Self, IntrinsicsError> {
        let path = Path::new(text);
        if !text.contains(',') || path.exists() {
            return Self::read(path);
        }
        let fail = |what: String| IntrinsicsError::Text {
            text: text.to_owned(),
            what,
        };
        let numbers = text
            .split(',')
            .map(|part| part.trim().parse::<f64>().map_err(|_| part.trim()))
            .collect::<Result<Vec<_>, _>>()
            .map_err(|part| fail(format!("\"{part}\" is not a number")))?;
        let [fx, fy, cx, cy] = numbers[..] else {
            return Err(fail(format!("4 numbers expected, got {}", numbers.len())));
        };
        layouts::pinhole(fx, fy, cx, cy)
            .map(Self::from_intrinsics)
            .map_err(fail)
    }

    /// The intrinsics for an image of `width`×`height` pixels, rescaled when it is another size
    /// of the same aspect.
    ///
    /// # Errors
    /// [`IntrinsicsError::Aspect`] when the two shapes differ by more than 1 %.
    pub fn for_size(&self, width: u32, height: u32) -> Result<Intrinsics, IntrinsicsError> {
        let image = (width, height);
        let Some(calibrated) = self.size.filter(|size| *size != image) else {
            return Ok(self.intrinsics);
        };
        let sx = f64::from(width) / f64::from(calibrated.0);
        let sy = f64::from(height) / f64::from(calibrated.1);
        let same_aspect = (sx - sy).abs() <= ASPECT_TOLERANCE * sx.max(sy);
        if !same_aspect {
            return Err(IntrinsicsError::Aspect { calibrated, image });
        }
        Ok(self.intrinsics.rescaled(calibrated, image))
    }
}

/// Tells the layout by the first character and reads it; the flag is "the lens is distorted".
fn parse(text: &str) -> Result<(Calibration, bool), String> {
    let text = text.trim_start_matches('\u{feff}').trim();
    if text.is_empty() {
        return Err("the file is empty".to_owned());
    }
    if let Some(matrix) = layouts::bare_matrix(text) {
        return matrix.map(|intrinsics| (Calibration::from_intrinsics(intrinsics), false));
    }
    let tree = if text.starts_with(['{', '[']) {
        serde_json::from_str(text).map_err(|error| format!("not valid JSON ({error})"))?
    } else {
        yaml::parse(text)?
    };
    layouts::calibration(&tree)
}

#[cfg(test)]
mod tests;
