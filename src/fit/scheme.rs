//! One door to both schemes: points and parameters in, model out.

use super::cloud::{CloudModel, FitParameters, Scheme};
use super::progressive::ProgressiveFit;
use super::random::RandomFit;
use crate::partition::points::LocalPoints;

/// Parameters no fit can be made with.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ParameterError {
    /// A cell without size.
    #[error("the cube size is {0} m; it must be above 0 and finite")]
    CubeSize(f64),
    /// No sphere allowed.
    #[error(
        "max spheres is {max_spheres} and spheres per cube {spheres_per_cube}; both must be at least 1"
    )]
    NoSpheres {
        /// Spheres allowed in the model.
        max_spheres: usize,
        /// Spheres allowed in a cell.
        spheres_per_cube: usize,
    },
    /// No distance at which a point touches.
    #[error(
        "the contact distance is {floor_m} m, growing by {per_z2} z2; the first must be above 0, the second at least 0"
    )]
    ContactDistance {
        /// Smallest distance, metres.
        floor_m: f64,
        /// Growth, 1/m.
        per_z2: f64,
    },
}

impl FitParameters {
    /// Whether a fit can be made with these.
    ///
    /// # Errors
    /// The first parameter that is out of range.
    pub fn check(&self) -> Result<(), ParameterError> {
        if !(self.cube_size_m > 0.0 && self.cube_size_m.is_finite()) {
            return Err(ParameterError::CubeSize(self.cube_size_m));
        }
        if self.max_spheres == 0 || self.spheres_per_cube == 0 {
            return Err(ParameterError::NoSpheres {
                max_spheres: self.max_spheres,
                spheres_per_cube: self.spheres_per_cube,
            });
        }
        let contact = self.contact_distance;
        let positive = contact.floor_m > 0.0 && contact.floor_m.is_finite();
        if !(positive && contact.per_z2 >= 0.0 && contact.per_z2.is_finite()) {
            return Err(ParameterError::ContactDistance {
                floor_m: contact.floor_m,
                per_z2: contact.per_z2,
            });
        }
        Ok(())
    }
}

/// Fits clouds one after the other, keeping its buffers.
#[derive(Debug, Default)]
pub struct CloudFit {
    progressive: ProgressiveFit,
    random: RandomFit,
}

impl CloudFit {
    /// Fits spheres to the points by the scheme that `parameters` names. Empty clouds and points
    /// that span no surface give a model without spheres.
    ///
    /// # Errors
    /// Parameters out of range.
    pub fn fit(
        &mut self,
        points: &LocalPoints,
        parameters: &FitParameters,
    ) -> Result<CloudModel, ParameterError> {
        parameters.check()?;
        Ok(match parameters.scheme {
            Scheme::Progressive => self.progressive.fit(points, parameters),
            Scheme::Random => self.random.fit(points, parameters),
        })
    }
}

#[cfg(test)]
#[path = "scheme_tests.rs"]
mod tests;
