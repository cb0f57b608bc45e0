//! The paper's experiments (3DSAINT, section 4), each as a function from data to a [`Report`].
//!
//! | module | figure | question |
//! |---|---|---|
//! | [`multi_scale`] | 5, 7 | what does a model with few spheres keep? |
//! | [`map_resolution`] | 15 | how does the error fall with the resolution of the contact map? |
//! | [`storage`] | 8–10 | is SAINT a third of a standard compression? |
//! | [`packing`] | 11 | does hexagonal packing leave less residual than cubic? |
//! | [`schemes`] | 12–14 | what tells the random scheme from the progressive? |
//! | [`loss`] | 18 | does the SAINT loss help, and is it the spheres that help? |
//! | [`features`] | 16, 17 | do the features tell objects apart, and which of them? |
//!
//! Pure computation: nothing here prints, reads a file or knows the command line. Each experiment
//! is repeated for several seeds; a [`Cell::Spread`] is their mean and standard deviation.
//! Lengths of clouds are given in per cent of the cloud's diagonal, since many clouds do not
//! state a unit.

pub mod features;
pub mod loss;
pub mod map_resolution;
pub mod multi_scale;
pub mod packing;
pub mod report;
pub mod schemes;
pub mod storage;
pub mod subject;

use crate::fit::cloud::{CloudModel, FitParameters, Scheme};
use crate::fit::draw::Draw;
use crate::fit::scheme::{CloudFit, ParameterError};
use crate::partition::points::{LocalPoints, TooManyPoints};
pub use report::{Cell, Curve, Report, Series, Table};
pub use subject::{DepthFrames, Subject};

/// What every experiment is told beside its data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Repetitions, at least 1; seeds are 0, 1, 2, …
    pub seeds: u64,
}

/// An experiment that cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExperimentError {
    /// A cloud is too large.
    #[error(transparent)]
    Points(#[from] TooManyPoints),
    /// Parameters out of range.
    #[error(transparent)]
    Parameters(#[from] ParameterError),
    /// The data do not suit the experiment.
    #[error("{0}")]
    Data(String),
}

/// Random numbers of the experiments.
#[derive(Clone, Debug)]
pub(crate) struct Chance(Draw);

impl Chance {
    pub fn new(seed: u64) -> Self {
        // a stream of its own: the fits draw from the bare seed
        Self(Draw::new(
            seed.wrapping_mul(0xd134_2543_de82_ef95) ^ 0x5851_f42d_4c95_7f2d,
        ))
    }

    pub fn next(&mut self) -> u64 {
        self.0.next()
    }

    /// Below `n`, which must be above 0.
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.next()) * n as u128) >> 64) as usize
    }

    /// Uniform from 0 to below 1.
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal (Box and Muller, 1958).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }

    /// Puts `items` in an order of chance (Fisher and Yates).
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.below(i + 1));
        }
    }
}

/// A fit of the whole cloud by one scheme.
fn fit(
    points: &LocalPoints,
    subject: &Subject,
    scheme: Scheme,
    seed: u64,
) -> Result<CloudModel, ExperimentError> {
    let parameters = FitParameters {
        contact_distance: subject.contact,
        cube_size_m: subject.cube_size_m,
        scheme,
        seed,
        ..FitParameters::default()
    };
    Ok(CloudFit::default().fit(points, &parameters)?)
}

#[cfg(test)]
mod tests;
