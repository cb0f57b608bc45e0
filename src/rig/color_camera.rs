//! A colour camera beside a depth camera: its lens, and where it stands to the depth camera.
//!
//! ```toml
//! width = 1280
//! height = 720
//! intrinsics = [910.0, 910.0, 640.0, 360.0]   # fx, fy, cx, cy, pixels
//! translation = [0.015, 0.0, 0.0]             # the colour camera in the depth camera's frame
//! rotation = [0.0, 0.0, 0.0, 1.0]             # quaternion x, y, z, w; or a 4x4 matrix
//! ```

use super::pose::Pose;
use super::{RigError, read_pose, read_text, wrong};
use crate::frame::Intrinsics;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Lens and place of a colour camera. No distortion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ColorCamera {
    /// Image width the lens is stated for, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Pinhole intrinsics, pixels.
    pub intrinsics: Intrinsics,
    /// Colour camera's frame to depth camera's frame.
    pub pose: Pose,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ColorFile {
    width: u32,
    height: u32,
    intrinsics: [f64; 4],
    matrix: Option<[[f64; 4]; 4]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
}

impl ColorCamera {
    /// Reads the file described above.
    ///
    /// # Errors
    /// [`RigError`] names the file and what is wrong in it.
    pub fn read(path: &Path) -> Result<Self, RigError> {
        let text = read_text(path)?;
        let file: ColorFile = toml::from_str(&text).map_err(|e| wrong(path, e.to_string()))?;
        let [fx, fy, cx, cy] = file.intrinsics;
        let focal = fx.is_finite() && fy.is_finite() && fx > 0.0 && fy > 0.0;
        if !focal || !cx.is_finite() || !cy.is_finite() || file.width == 0 || file.height == 0 {
            let what = "size and focal lengths must be positive, all numbers finite";
            return Err(wrong(path, what.into()));
        }
        let pose = read_pose(file.matrix, file.translation, file.rotation);
        Ok(Self {
            width: file.width,
            height: file.height,
            intrinsics: Intrinsics { fx, fy, cx, cy },
            pose: pose.map_err(|what| wrong(path, what))?.unwrap_or_default(),
        })
    }

    /// The pixel (column, row) of a `size` image that a point of the depth camera's frame falls
    /// on, and its depth from the colour camera, metres; `None` behind the camera or outside the
    /// image.
    #[must_use]
    pub fn pixel_of(&self, point: DVec3, size: (u32, u32)) -> Option<(u32, u32, f64)> {
        let lens = match (self.width, self.height) {
            own if own == size => self.intrinsics,
            own => self.intrinsics.rescaled(own, size),
        };
        let seen = self.pose.to_camera(point);
        if seen.z <= 0.0 {
            return None;
        }
        let column = (lens.fx * seen.x / seen.z + lens.cx).round();
        let row = (lens.fy * seen.y / seen.z + lens.cy).round();
        let inside = |at: f64, size: u32| at >= 0.0 && at < f64::from(size);
        // both are whole and inside the image
        let fits = inside(column, size.0) && inside(row, size.1);
        fits.then_some((column as u32, row as u32, seen.z))
    }
}
