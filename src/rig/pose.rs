//! Where a camera stands: a rotation and a shift from its own frame into a common one.

use glam::{DMat3, DMat4, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// How far a matrix may be from a rotation, largest entry of `RᵀR − I`.
const ROTATION_TOLERANCE: f64 = 1e-3;
/// How far the length of a quaternion may be from 1.
const LENGTH_TOLERANCE: f64 = 1e-3;

/// Camera to common frame: `p_common = rotation · p_camera + translation`, metres, both frames
/// right-handed. As JSON, a 4×4 matrix by rows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "[[f64; 4]; 4]", try_from = "[[f64; 4]; 4]")]
pub struct Pose {
    rotation: DMat3,
    translation: DVec3,
}

impl Default for Pose {
    fn default() -> Self {
        Self {
            rotation: DMat3::IDENTITY,
            translation: DVec3::ZERO,
        }
    }
}

impl Pose {
    /// From a shift (metres) and a quaternion `x, y, z, w`.
    ///
    /// # Errors
    /// What is wrong: a number that is not finite, a quaternion whose length is not 1.
    pub fn from_quaternion(translation: [f64; 3], rotation: [f64; 4]) -> Result<Self, String> {
        let quaternion = DQuat::from_array(rotation);
        let translation = DVec3::from_array(translation);
        if !quaternion.is_finite() || !translation.is_finite() {
            return Err("a number of the pose is not finite".into());
        }
        let length = quaternion.length();
        if (length - 1.0).abs() > LENGTH_TOLERANCE {
            return Err(format!(
                "the quaternion {rotation:?} (x, y, z, w) has length {length:.4} instead of 1"
            ));
        }
        Ok(Self {
            rotation: DMat3::from_quat(quaternion.normalize()),
            translation,
        })
    }

    /// From a 4×4 matrix by rows. A rotation that is one but for rounding is made exact.
    ///
    /// # Errors
    /// What is wrong: the last row, or the upper left part is no rotation.
    pub fn from_rows(rows: [[f64; 4]; 4]) -> Result<Self, String> {
        let matrix = DMat4::from_cols_array_2d(&rows).transpose();
        if !matrix.is_finite() {
            return Err("a number of the matrix is not finite".into());
        }
        if rows[3] != [0.0, 0.0, 0.0, 1.0] {
            let last = rows[3];
            return Err(format!(
                "the last row of the matrix is {last:?} instead of 0 0 0 1"
            ));
        }
        let rotation = DMat3::from_mat4(matrix);
        let off = rotation.transpose() * rotation - DMat3::IDENTITY;
        let worst = off
            .to_cols_array()
            .iter()
            .fold(0.0f64, |m, v| m.max(v.abs()));
        if worst > ROTATION_TOLERANCE || rotation.determinant() < 0.0 {
            return Err(format!(
                "the upper left 3x3 of the matrix is no rotation (off by {worst:.4}, determinant \
                 {:.4})",
                rotation.determinant()
            ));
        }
        let exact = DQuat::from_mat3(&rotation).normalize();
        Ok(Self {
            // one step through a quaternion loses the last digit: keep what is exact already
            rotation: if worst < 1e-12 {
                rotation
            } else {
                DMat3::from_quat(exact)
            },
            translation: matrix.w_axis.truncate(),
        })
    }

    /// The matrix by rows.
    #[must_use]
    pub fn rows(&self) -> [[f64; 4]; 4] {
        let mut matrix = DMat4::from_mat3(self.rotation);
        matrix.w_axis = self.translation.extend(1.0);
        matrix.transpose().to_cols_array_2d()
    }

    /// A point of the camera's frame in the common frame, metres.
    #[must_use]
    pub fn to_common(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// A point of the common frame in the camera's, metres.
    #[must_use]
    pub fn to_camera(&self, point: DVec3) -> DVec3 {
        self.rotation.transpose() * (point - self.translation)
    }
}

impl From<Pose> for [[f64; 4]; 4] {
    fn from(pose: Pose) -> Self {
        pose.rows()
    }
}

impl TryFrom<[[f64; 4]; 4]> for Pose {
    type Error = String;

    fn try_from(rows: [[f64; 4]; 4]) -> Result<Self, String> {
        Self::from_rows(rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn a_pose_turns_points_there_and_back(
            axis in prop::array::uniform3(-1.0f64..1.0),
            angle in -3.1f64..3.1,
            translation in prop::array::uniform3(-5.0f64..5.0),
            point in prop::array::uniform3(-9.0f64..9.0),
        ) {
            let axis = DVec3::from_array(axis).try_normalize().unwrap_or(DVec3::X);
            let quaternion = DQuat::from_axis_angle(axis, angle);
            let pose = Pose::from_quaternion(translation, quaternion.to_array()).unwrap();
            let point = DVec3::from_array(point);
            // Rodrigues' formula says the same
            let turned = point * angle.cos() + axis.cross(point) * angle.sin()
                + axis * axis.dot(point) * (1.0 - angle.cos());
            let want = turned + DVec3::from_array(translation);
            prop_assert!((pose.to_common(point) - want).length() < 1e-12);
            prop_assert!((pose.to_camera(want) - point).length() < 1e-12);
            let text = serde_json::to_string(&pose).unwrap();
            prop_assert_eq!(serde_json::from_str::<Pose>(&text).unwrap(), pose);
        }
    }

    #[test]
    fn what_is_no_pose_is_refused() {
        let identity = Pose::default().rows();
        assert_eq!(Pose::from_rows(identity), Ok(Pose::default()));
        let with = |row: usize, column: usize, value: f64| {
            let mut rows = identity;
            rows[row][column] = value;
            Pose::from_rows(rows).unwrap_err()
        };
        assert!(with(3, 0, 1.0).contains("last row"));
        assert!(with(0, 0, 1.1).contains("no rotation"));
        assert!(with(2, 2, -1.0).contains("no rotation"), "a mirror");
        assert!(with(0, 3, f64::NAN).contains("finite"));
        let none = Pose::from_quaternion([0.0; 3], [0.0, 0.0, 0.0, 2.0]);
        assert!(none.unwrap_err().contains("length 2.0000"));
        let none = Pose::from_quaternion([f64::INFINITY, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]);
        assert!(none.unwrap_err().contains("finite"));
    }
}
