//! The camera of a sequence: what the user, the images and the sidecar say, in that order.

use super::exr_attributes::ExrAttributes;
use super::layout::{Format, Layout};
use super::{FrameFile, SequenceOptions, calibration_error, input};
use crate::capture::CaptureError;
use crate::frame::{Camera, Intrinsics};
use crate::intrinsics::{Calibration, HOW_TO_GIVE};

/// All that is known of the camera, by who said it.
pub(super) struct Known<'a> {
    pub(super) options: &'a SequenceOptions,
    pub(super) layout: &'a Layout,
    pub(super) attributes: &'a ExrAttributes,
}

impl Known<'_> {
    /// The user's calibration, else the image's attributes, else `camera.json`.
    pub(super) fn intrinsics(&self, width: u32, height: u32) -> Result<Intrinsics, CaptureError> {
        let path = &self.layout.input;
        let sized = |calibration: &Calibration| {
            let sized = calibration.for_size(width, height);
            sized.map_err(|error| calibration_error(error, path))
        };
        if let Some(calibration) = &self.options.calibration {
            return sized(calibration);
        }
        if let Some(intrinsics) = self.attributes.intrinsics {
            return Ok(intrinsics);
        }
        if let Some(calibration) = &self.layout.sidecar {
            return sized(calibration);
        }
        let what = "the camera's intrinsics are missing";
        let remedy = format!("{HOW_TO_GIVE}{}", self.layout.suggestion);
        Err(input(path, what, remedy))
    }

    /// The camera of images of this size; `unit` says which unit to take, given the one that was said.
    pub(super) fn camera(
        &self,
        (width, height): (u32, u32),
        intrinsics: Intrinsics,
        frames: &[FrameFile],
        unit: impl Fn(Option<f64>) -> f64,
    ) -> Result<Camera, CaptureError> {
        let (options, attributes) = (self.options, self.attributes);
        let (given, sidecar) = (options.calibration.as_ref(), self.layout.sidecar.as_ref());
        // The attribute is before the calibration file: only with it do integers come back exact.
        let said = options
            .depth_unit_m
            .or(attributes.depth_unit_m)
            .or_else(|| given?.depth_unit_m)
            .or_else(|| sidecar?.depth_unit_m)
            .or(self.layout.unit_m);
        let depth_unit_m = unit(said);
        let input_path = self.layout.input.display();
        if said.is_some() {
            tracing::info!("{input_path}: depth unit {depth_unit_m} m");
        } else if self.layout.format == Format::Png {
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
            .or(attributes.depth_min_m)
            .or_else(|| sidecar?.depth_min_m)
            .unwrap_or(0.0);
        let depth_max_m = options
            .depth_max_m
            .or_else(|| given?.depth_max_m)
            .or(attributes.depth_max_m)
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
            .or_else(|| attributes.invalid.clone())
            .or_else(|| sidecar?.invalid.clone())
            .unwrap_or_else(|| vec![0]);
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
                .or(attributes.fps)
                .or_else(|| sidecar?.fps)
                .or_else(|| rate(frames)),
            name: attributes
                .name
                .clone()
                .unwrap_or_else(|| self.layout.name.clone()),
        })
    }
}

/// Median frame rate of listed times, frames per second.
fn rate(frames: &[FrameFile]) -> Option<f64> {
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
