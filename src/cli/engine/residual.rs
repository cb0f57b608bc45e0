//! Depth errors as numbers for people: sampled while live, complete in the bench.

use saint_live::codec::Encoder;
use saint_live::contact_map::labels::SaintFrame;
use saint_live::deproject::{Rays, Validity};
use saint_live::frame::{Camera, DepthFrame};
use saint_live::pipeline::packet::Residual;

/// About so many pixels of a frame are looked at while live.
const LOOKED_AT: usize = 5000;

/// A set of errors, millimetres.
#[derive(Debug, Default)]
pub struct Residuals(Vec<f32>);

impl Residuals {
    /// Forgets all.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Adds an error, metres.
    pub fn push_m(&mut self, error_m: f32) {
        self.0.push(error_m.abs() * 1e3);
    }

    /// Mean and percentiles (nearest rank); zeros for no errors. Reorders the set.
    pub fn summary(&mut self) -> Residual {
        let Some(last) = self.0.len().checked_sub(1) else {
            return Residual::default();
        };
        let sum: f64 = self.0.iter().map(|e| f64::from(*e)).sum();
        let mut at = |share: f64| {
            let rank = (share * last as f64).round() as usize;
            *self.0.select_nth_unstable_by(rank, f32::total_cmp).1
        };
        Residual {
            mean: (sum / (last + 1) as f64) as f32,
            p95: at(0.95),
            p99: at(0.99),
            max: at(1.0),
        }
    }
}

/// Looks at the errors of some pixels of each frame.
pub struct Sampler {
    rays: Rays,
    validity: Validity,
    unit: f32,
    errors: Residuals,
}

impl Sampler {
    /// For frames of `camera`.
    pub fn new(camera: &Camera) -> Self {
        Self {
            rays: Rays::new(camera),
            validity: Validity::new(camera),
            unit: camera.depth_unit_m as f32,
            errors: Residuals::default(),
        }
    }

    /// Errors of the payload that `encoder` made of `depth`: of some blocks, others in each frame.
    pub fn of_payload(&mut self, depth: &DepthFrame, encoder: &Encoder) -> Residual {
        self.errors.clear();
        let every = (depth.depth.len() / LOOKED_AT).max(1);
        let first = (depth.sequence % every as u64) as usize;
        encoder.errors(depth, (first, every), |error_m| self.errors.push_m(error_m));
        self.errors.summary()
    }

    /// Distances of a modelled frame's measurements from their spheres, of some of its pixels. Those
    /// without a sphere are left out.
    pub fn of_spheres(&mut self, depth: &DepthFrame, saint: &SaintFrame) -> Residual {
        self.errors.clear();
        let width = self.rays.width;
        // one pixel in so many along x and along y
        let stride = (depth.depth.len() / LOOKED_AT).isqrt().max(1);
        let rows = depth.depth.chunks_exact(width);
        for (y, row) in rows.enumerate().step_by(stride) {
            let v = self.rays.v[y];
            for x in (0..width).step_by(stride) {
                let label = saint.contacts.label(width, x, y);
                let sphere = saint.spheres.get(usize::from(label)).copied().flatten();
                let Some(sphere) = sphere.filter(|_| self.validity.accepts(row[x])) else {
                    continue;
                };
                let u = self.rays.u[x];
                let inverse = sphere.inverse_depth(u, v, u * u + v * v + 1.0);
                if inverse.is_finite() && inverse > 0.0 {
                    self.errors
                        .push_m(f32::from(row[x]) * self.unit - 1.0 / inverse);
                }
            }
        }
        self.errors.summary()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_ranks() {
        let mut errors = Residuals::default();
        for n in (0..=100).rev() {
            errors.push_m(n as f32 * -1e-3);
        }
        let got = errors.summary();
        let want = [50.0, 95.0, 99.0, 100.0];
        for (got, want) in [got.mean, got.p95, got.p99, got.max].iter().zip(want) {
            assert!((got - want).abs() < 1e-3, "{got} {want}");
        }
        errors.clear();
        assert_eq!(errors.summary(), Residual::default());
    }
}
