//! The SAINT loss (paper 4.2): how far predicted points lie from the modelled spheres.
//!
//! ```text
//! L = (1/W) Σ wᵢ ρ(sᵢ),   sᵢ = |pᵢ − c| − r,   W = Σ wᵢ
//! ```
//! over the points that have a sphere: the one they are given, or the nearest. `s` is the signed
//! distance from the sphere, metres, positive outside. A point that is given no sphere takes no
//! part. The gradients go to points, centres and radii:
//!
//! ```text
//! ∂L/∂pᵢ = (wᵢ/W) ρ'(sᵢ) uᵢ,   uᵢ = (pᵢ − c)/|pᵢ − c|
//! ∂L/∂c  = −Σ ∂L/∂pᵢ           ∂L/∂r = −Σ (wᵢ/W) ρ'(sᵢ)      over the sphere's points
//! ```
//! so Σ∂p + Σ∂c = 0: moving all of it together changes nothing.
//!
//! The paper says only that its loss "incorporates the distance from the spheres modeled"; the
//! mean, the weights and the choice of ρ are ours. A sphere has no border here: where owners are
//! not given, a point may be drawn to a part of a sphere that no measured point touches.

use crate::fit::cloud::UNASSIGNED;
use glam::DVec3;
use rayon::prelude::*;

/// Centre and radius, as the paper stores a sphere.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ball {
    /// Centre, metres.
    pub center: DVec3,
    /// Radius, metres.
    pub radius: f64,
}

/// ρ: what a distance costs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Penalty {
    /// |s|, metres. Its slope at 0 is taken as 0.
    #[default]
    Absolute,
    /// s², m².
    Squared,
    /// s²/2 up to this distance δ (metres, above 0), then δ(|s| − δ/2), m².
    Huber(f64),
}

impl Penalty {
    /// ρ(s).
    #[must_use]
    pub fn value(self, s: f64) -> f64 {
        match self {
            Self::Absolute => s.abs(),
            Self::Squared => s * s,
            Self::Huber(delta) if s.abs() <= delta => 0.5 * s * s,
            Self::Huber(delta) => delta * (s.abs() - 0.5 * delta),
        }
    }

    /// ρ'(s).
    #[must_use]
    pub fn slope(self, s: f64) -> f64 {
        match self {
            Self::Absolute if s == 0.0 => 0.0,
            Self::Absolute => s.signum(),
            Self::Squared => 2.0 * s,
            Self::Huber(delta) => s.clamp(-delta, delta),
        }
    }
}

/// Which sphere each point is held against.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Owners<'a> {
    /// The sphere whose surface is nearest, the lower number where two are equally near.
    #[default]
    Nearest,
    /// For each point its sphere's number, or [`UNASSIGNED`] for a point without one.
    Given(&'a [u32]),
}

/// Points, spheres, and what ties them.
#[derive(Clone, Copy, Debug, Default)]
pub struct SaintLoss<'a> {
    /// Predicted points, metres.
    pub points: &'a [DVec3],
    /// The spheres, metres, in the points' coordinates.
    pub spheres: &'a [Ball],
    /// Who belongs to whom.
    pub owners: Owners<'a>,
    /// Weight of each point, at least 0; 1 each where there are none.
    pub weights: Option<&'a [f64]>,
    /// What a distance costs.
    pub penalty: Penalty,
}

/// Slopes of the loss, in the loss's unit per metre.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LossGradient {
    /// To each point.
    pub points: Vec<DVec3>,
    /// To each sphere's centre.
    pub centers: Vec<DVec3>,
    /// To each sphere's radius.
    pub radii: Vec<f64>,
}

/// Input no loss can be computed from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LossError {
    /// One value per point is needed.
    #[error("there are {points} points and {found} {what}; give one for each point")]
    Length {
        /// What is counted.
        what: &'static str,
        /// Points.
        points: usize,
        /// Values found.
        found: usize,
    },
    /// A number that is not finite, or a negative radius or weight.
    #[error(
        "{what} {at} is not finite or is negative where it must not be; look at what made it (a learning rate too high, a depth of 0)"
    )]
    Value {
        /// Which array.
        what: &'static str,
        /// Place in it.
        at: usize,
    },
    /// A point names a sphere that is not there.
    #[error("point {at} names sphere {owner} and there are {spheres} spheres")]
    Owner {
        /// The point.
        at: usize,
        /// The sphere it names.
        owner: u32,
        /// Spheres there are.
        spheres: usize,
    },
    /// A Huber distance that is none.
    #[error("the Huber distance must be above 0 and finite, metres")]
    Huber,
}

impl SaintLoss<'_> {
    /// The loss alone. 0 where no point has a sphere or all weights are 0.
    ///
    /// # Errors
    /// [`LossError`].
    pub fn value(&self) -> Result<f64, LossError> {
        self.check()?;
        let owners = self.owners();
        Ok(self.sum(&owners).0)
    }

    /// The loss, and its slopes into `gradient`, whose contents are replaced. O(n) with owners
    /// given, O(n·m) with the nearest of m spheres. The same input gives the same bits on any
    /// number of threads.
    ///
    /// # Errors
    /// [`LossError`]; `gradient` is then as it was.
    pub fn gradient(&self, gradient: &mut LossGradient) -> Result<f64, LossError> {
        self.check()?;
        let owners = self.owners();
        let (loss, total) = self.sum(&owners);
        gradient.points.clear();
        gradient.points.resize(self.points.len(), DVec3::ZERO);
        gradient.centers.clear();
        gradient.centers.resize(self.spheres.len(), DVec3::ZERO);
        gradient.radii.clear();
        gradient.radii.resize(self.spheres.len(), 0.0);
        if total == 0.0 {
            return Ok(loss);
        }
        for (i, &owner) in owners.iter().enumerate() {
            let Some(ball) = self.spheres.get(owner as usize) else {
                continue;
            };
            let from_center = self.points[i] - ball.center;
            let slope = self.penalty.slope(from_center.length() - ball.radius);
            let slope = slope * self.weight(i) / total;
            // at the very centre every direction is as good: none
            let push = slope * from_center.normalize_or_zero();
            gradient.points[i] = push;
            gradient.centers[owner as usize] -= push;
            gradient.radii[owner as usize] -= slope;
        }
        Ok(loss)
    }

    /// For each point the number of its sphere, or [`UNASSIGNED`].
    fn owners(&self) -> Vec<u32> {
        match self.owners {
            Owners::Given(owners) => owners.to_vec(),
            Owners::Nearest => nearest_owners(self.points, self.spheres),
        }
    }

    fn weight(&self, i: usize) -> f64 {
        self.weights.map_or(1.0, |w| w[i])
    }

    /// Loss and the sum of the weights.
    fn sum(&self, owners: &[u32]) -> (f64, f64) {
        let (mut cost, mut total) = (0.0, 0.0);
        for (i, &owner) in owners.iter().enumerate() {
            if let Some(ball) = self.spheres.get(owner as usize) {
                let s = self.points[i].distance(ball.center) - ball.radius;
                cost += self.weight(i) * self.penalty.value(s);
                total += self.weight(i);
            }
        }
        let loss = if total > 0.0 { cost / total } else { 0.0 };
        (loss, total)
    }

    fn check(&self) -> Result<(), LossError> {
        let points = self.points.len();
        let length = |what, found| match found == points {
            true => Ok(()),
            false => Err(LossError::Length {
                what,
                points,
                found,
            }),
        };
        let value = |what, bad: Option<usize>| match bad {
            None => Ok(()),
            Some(at) => Err(LossError::Value { what, at }),
        };
        if let Penalty::Huber(delta) = self.penalty
            && !(delta > 0.0 && delta.is_finite())
        {
            return Err(LossError::Huber);
        }
        value("point", self.points.iter().position(|p| !p.is_finite()))?;
        let ball_is_bad =
            |b: &Ball| !(b.center.is_finite() && b.radius.is_finite() && b.radius >= 0.0);
        value("sphere", self.spheres.iter().position(ball_is_bad))?;
        if let Some(weights) = self.weights {
            length("weights", weights.len())?;
            let bad = |w: &f64| !(w.is_finite() && *w >= 0.0);
            value("weight", weights.iter().position(bad))?;
        }
        if let Owners::Given(owners) = self.owners {
            length("owners", owners.len())?;
            let spheres = self.spheres.len();
            let bad = |o: &u32| *o != UNASSIGNED && *o as usize >= spheres;
            if let Some(at) = owners.iter().position(bad) {
                let owner = owners[at];
                return Err(LossError::Owner { at, owner, spheres });
            }
        }
        Ok(())
    }
}

/// For each point the sphere whose surface is nearest, the lower number where two are equally
/// near; [`UNASSIGNED`] where there is no sphere. O(n·m).
#[must_use]
pub fn nearest_owners(points: &[DVec3], spheres: &[Ball]) -> Vec<u32> {
    let nearest = |p: &DVec3| {
        let mut best = (f64::INFINITY, UNASSIGNED);
        for (number, ball) in spheres.iter().enumerate() {
            let off = (p.distance(ball.center) - ball.radius).abs();
            if off < best.0 {
                best = (off, number as u32);
            }
        }
        best.1
    };
    points.par_iter().map(nearest).collect()
}

#[cfg(test)]
#[path = "loss_tests.rs"]
mod tests;
