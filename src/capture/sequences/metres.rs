//! Float depth to depth integers: the one place where metres of an EXR become units.

use super::ExrDepth;
use crate::frame::Intrinsics;

/// Unit chosen for float depth that names none, where it reaches far enough: 0.25 mm.
const FINE_UNIT_M: f64 = 0.00025;
/// Unit for depth beyond the reach of the fine one: 1 mm.
const COARSE_UNIT_M: f64 = 0.001;
/// 65535 fine units, less a margin for frames that look a little farther than the first.
const FINE_REACH_M: f64 = 16.38;

/// Samples that became "no measurement", by cause. Samples that are exactly 0 are not counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::capture) struct Refused {
    /// NaN or infinite.
    pub(in crate::capture) not_finite: u64,
    /// Below 0.
    pub(in crate::capture) negative: u64,
    /// Above 65535 units.
    pub(in crate::capture) too_far: u64,
}

impl Refused {
    pub(in crate::capture) fn add(&mut self, other: Self) {
        self.not_finite += other.not_finite;
        self.negative += other.negative;
        self.too_far += other.too_far;
    }

    pub(in crate::capture) fn total(&self) -> u64 {
        self.not_finite + self.negative + self.too_far
    }
}

/// Turns stored values into planar depth in metres.
#[derive(Clone, Debug)]
pub(in crate::capture) struct Planar {
    meaning: ExrDepth,
    /// Planar distance per distance along the ray, per pixel; empty unless needed.
    per_ray: Vec<f64>,
}

impl Planar {
    /// For images of `width`×`height` pixels; `O(pixels)` once for ray depth.
    pub(in crate::capture) fn new(
        meaning: ExrDepth,
        k: &Intrinsics,
        width: u32,
        height: u32,
    ) -> Self {
        let per_ray = match meaning {
            ExrDepth::Ray => (0..height)
                .flat_map(|y| (0..width).map(move |x| (f64::from(x), f64::from(y))))
                .map(|(x, y)| {
                    let (u, v) = ((x - k.cx) / k.fx, (y - k.cy) / k.fy);
                    1.0 / (1.0 + u * u + v * v).sqrt()
                })
                .collect(),
            ExrDepth::Planar | ExrDepth::Inverse => Vec::new(),
        };
        Self { meaning, per_ray }
    }

    /// Planar depth of the sample at `pixel`, metres. An inverse depth of 0 is "nothing seen",
    /// not infinity.
    #[inline]
    fn metres(&self, pixel: usize, value: f32) -> f64 {
        let value = f64::from(value);
        match self.meaning {
            ExrDepth::Planar => value,
            ExrDepth::Ray => value * self.per_ray[pixel],
            ExrDepth::Inverse if value == 0.0 => 0.0,
            ExrDepth::Inverse => 1.0 / value,
        }
    }

    /// A unit for values that name none: 0.25 mm when all are nearer than 16.38 m, else 1 mm.
    pub(in crate::capture) fn fitting_unit_m(&self, values: &[f32]) -> f64 {
        let farthest = values
            .iter()
            .enumerate()
            .map(|(pixel, value)| self.metres(pixel, *value))
            .filter(|z| z.is_finite())
            .fold(0.0, f64::max);
        // Nothing seen says nothing about the scene: the unit with the longer reach is safe.
        if farthest > 0.0 && farthest < FINE_REACH_M {
            FINE_UNIT_M
        } else {
            COARSE_UNIT_M
        }
    }

    /// Depth integers of `values` (row-major), rounded to the nearest unit; refused samples
    /// become 0. Values that are whole multiples of `unit_m` come back exactly: an f32 is off by
    /// at most 65535·2⁻²⁴ = 0.004 units.
    pub(in crate::capture) fn quantise(
        &self,
        values: &[f32],
        unit_m: f64,
        out: &mut Vec<u16>,
    ) -> Refused {
        let mut refused = Refused::default();
        let units_per_m = 1.0 / unit_m;
        out.clear();
        out.extend(values.iter().enumerate().map(|(pixel, &value)| {
            let units = self.metres(pixel, value) * units_per_m + 0.5;
            if (0.5..65536.0).contains(&units) {
                return units as u16;
            }
            if !value.is_finite() {
                refused.not_finite += 1;
            } else if value < 0.0 {
                refused.negative += 1;
            } else {
                refused.too_far += 1;
            }
            0
        }));
        refused
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const K: Intrinsics = Intrinsics {
        fx: 2.0,
        fy: 4.0,
        cx: 0.5,
        cy: 0.0,
    };

    fn quantised(meaning: ExrDepth, values: &[f32], unit: f64) -> (Vec<u16>, Refused) {
        let mut out = vec![7; 3];
        let refused = Planar::new(meaning, &K, 2, 2).quantise(values, unit, &mut out);
        (out, refused)
    }

    #[test]
    fn bad_samples_are_zero_and_counted() {
        let values = [
            f32::NAN,
            f32::NEG_INFINITY,
            -1.0,
            65.5351,
            65.5356,
            0.0,
            -0.0,
            0.0004,
        ];
        let (out, refused) = quantised(ExrDepth::Planar, &values, 0.001);
        assert_eq!(out, [0, 0, 0, 65535, 0, 0, 0, 0]);
        let expected = Refused {
            not_finite: 2,
            negative: 1,
            too_far: 1,
        };
        assert_eq!(refused, expected);
        assert_eq!(refused.total(), 4);
    }

    #[test]
    fn ray_and_inverse_depth_become_planar() {
        let truth = |x: f64, y: f64| {
            let ray = glam::DVec3::new((x - 0.5) / 2.0, y / 4.0, 1.0);
            (3.0 * ray.normalize().z / 0.001).round() as u16
        };
        let (out, _) = quantised(ExrDepth::Ray, &[3.0; 4], 0.001);
        assert_eq!(
            out,
            [truth(0., 0.), truth(1., 0.), truth(0., 1.), truth(1., 1.)]
        );
        assert!(out[0] > out[2], "{out:?}");
        let (out, refused) = quantised(ExrDepth::Inverse, &[0.5, 0.0, -2.0, 4.0], 0.001);
        assert_eq!(out, [2000, 0, 0, 250]);
        assert_eq!(refused.total(), 1);
    }

    #[test]
    fn the_unit_follows_the_reach() {
        let planar = Planar::new(ExrDepth::Planar, &K, 2, 2);
        assert_eq!(planar.fitting_unit_m(&[1.0, f32::INFINITY, 16.3]), 0.00025);
        assert_eq!(planar.fitting_unit_m(&[1.0, 16.4]), 0.001);
        assert_eq!(planar.fitting_unit_m(&[f32::NAN, 0.0]), 0.001);
    }
}
