//! The camera of a sequence: what the user, the images and the sidecar say, in that order.

use super::exr_attributes::ExrAttributes;
use super::{FrameFile, SequenceOptions, calibration_error, input};
use crate::capture::CaptureError;
use crate::frame::{Camera, Intrinsics};
use crate::intrinsics::{Calibration, HOW_TO_GIVE};
use std::path::Path;

/// What a file says of the camera that made it; nothing is required.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::capture) struct Said {
    pub(in crate::capture) intrinsics: Option<Intrinsics>,
    pub(in crate::capture) depth_unit_m: Option<f64>,
    pub(in crate::capture) depth_min_m: Option<f64>,
    pub(in crate::capture) depth_max_m: Option<f64>,
    pub(in crate::capture) fps: Option<f64>,
    pub(in crate::capture) invalid: Option<Vec<u16>>,
    pub(in crate::capture) name: Option<String>,
}

impl From<&ExrAttributes> for Said {
    fn from(attributes: &ExrAttributes) -> Self {
        Self {
            intrinsics: attributes.intrinsics,
            depth_unit_m: attributes.depth_unit_m,
            depth_min_m: attributes.depth_min_m,
            depth_max_m: attributes.depth_max_m,
            fps: attributes.fps,
            invalid: attributes.invalid.clone(),
            name: attributes.name.clone(),
        }
    }
}

impl From<Camera> for Said {
    fn from(camera: Camera) -> Self {
        Self {
            intrinsics: Some(camera.intrinsics),
            depth_unit_m: Some(camera.depth_unit_m),
            depth_min_m: Some(camera.depth_min_m),
            depth_max_m: Some(camera.depth_max_m),
            fps: camera.fps,
            invalid: Some(camera.invalid),
            name: Some(camera.name),
        }
    }
}

/// All that is known of the camera, by who said it.
pub(in crate::capture) struct Known<'a> {
    pub(in crate::capture) options: &'a SequenceOptions,
    /// The input as given.
    pub(in crate::capture) input: &'a Path,
    /// What the images say.
    pub(in crate::capture) said: Said,
    /// What stands beside them.
    pub(in crate::capture) sidecar: Option<&'a Calibration>,
    /// Metres per depth integer by the format's own convention.
    pub(in crate::capture) unit_m: Option<f64>,
    /// Integers that mean "no measurement" by the format's own convention.
    pub(in crate::capture) invalid: &'static [u16],
    /// Intrinsics to suggest when there are none.
    pub(in crate::capture) suggestion: &'a str,
    /// What the input is called.
    pub(in crate::capture) name: &'a str,
    /// True where depth is stored as integers, false where it is stored as metres.
    pub(in crate::capture) integers: bool,
    /// Rate of the listed times, frames per second.
    pub(in crate::capture) fps: Option<f64>,
}

impl Known<'_> {
    /// The user's calibration, else the images' own, else the one beside them.
    pub(in crate::capture) fn intrinsics(
        &self,
        width: u32,
        height: u32,
    ) -> Result<Intrinsics, CaptureError> {
        let sized = |calibration: &Calibration| {
            let sized = calibration.for_size(width, height);
            sized.map_err(|error| calibration_error(error, self.input))
        };
        if let Some(calibration) = &self.options.calibration {
            return sized(calibration);
        }
        if let Some(intrinsics) = self.said.intrinsics {
            return Ok(intrinsics);
        }
        if let Some(calibration) = self.sidecar {
            return sized(calibration);
        }
        let what = "the camera's intrinsics are missing";
        let remedy = format!("{HOW_TO_GIVE}{}", self.suggestion);
        Err(input(self.input, what, remedy))
    }

    /// The camera of images of this size; `unit` says which unit to take, given the one that was said.
    pub(in crate::capture) fn camera(
        &self,
        (width, height): (u32, u32),
        intrinsics: Intrinsics,
        unit: impl Fn(Option<f64>) -> f64,
    ) -> Result<Camera, CaptureError> {
        let (options, said) = (self.options, &self.said);
        let (given, sidecar) = (options.calibration.as_ref(), self.sidecar);
        // The image's own unit is before the calibration file: only with it do integers come back exact.
        let named = options
            .depth_unit_m
            .or(said.depth_unit_m)
            .or_else(|| given?.depth_unit_m)
            .or_else(|| sidecar?.depth_unit_m)
            .or(self.unit_m);
        let depth_unit_m = unit(named);
        let input_path = self.input.display();
        if named.is_some() {
            tracing::info!("{input_path}: depth unit {depth_unit_m} m");
        } else if self.integers {
            tracing::warn!(
                "{input_path}: no depth unit given: {depth_unit_m} m assumed; --depth-unit sets it"
            );
        } else {
            tracing::info!(
                "{input_path}: depth is rounded to {depth_unit_m} m; --depth-unit sets it"
            );
        }
        let depth_min_m = options
            .depth_min_m
            .or_else(|| given?.depth_min_m)
            .or(said.depth_min_m)
            .or_else(|| sidecar?.depth_min_m)
            .unwrap_or(0.0);
        let depth_max_m = options
            .depth_max_m
            .or_else(|| given?.depth_max_m)
            .or(said.depth_max_m)
            .or_else(|| sidecar?.depth_max_m)
            .unwrap_or(65535.0 * depth_unit_m);
        if depth_min_m >= depth_max_m {
            return Err(CaptureError::Usage(format!(
                "{input_path}: the depth range {depth_min_m} to {depth_max_m} m is empty"
            )));
        }
        let mut invalid = options
            .invalid
            .clone()
            .or_else(|| given?.invalid.clone())
            .or_else(|| said.invalid.clone())
            .or_else(|| sidecar?.invalid.clone())
            .unwrap_or_else(|| self.invalid.to_vec());
        invalid.sort_unstable();
        invalid.dedup();
        Ok(Camera {
            width,
            height,
            intrinsics,
            depth_unit_m,
            invalid,
            depth_min_m,
            depth_max_m,
            fps: options
                .fps
                .or_else(|| given?.fps)
                .or(said.fps)
                .or_else(|| sidecar?.fps)
                .or(self.fps),
            name: said.name.clone().unwrap_or_else(|| self.name.to_owned()),
        })
    }
}

/// Median frame rate of listed times, frames per second.
pub(super) fn rate(frames: &[FrameFile]) -> Option<f64> {
    let mut periods: Vec<f64> = frames
        .windows(2)
        .filter_map(|pair| {
            let ns = pair[1]
                .time?
                .device_ns
                .saturating_sub(pair[0].time?.device_ns);
            let steps = pair[1].number.saturating_sub(pair[0].number);
            (ns > 0 && steps > 0).then(|| ns as f64 / steps as f64)
        })
        .collect();
    periods.sort_by(f64::total_cmp);
    periods.get(periods.len() / 2).map(|period| 1e9 / period)
}
