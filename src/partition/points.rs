//! Points about a local origin: the one door through which clouds come in.

use glam::{DVec3, Vec3};

/// A cloud as every stage behind the door sees it: finite single-precision coordinates about a
/// local origin, one array per axis.
///
/// Single precision about the cloud's own middle keeps 24 bits of the cloud's extent, whatever
/// the distance to the file's zero; about a distant zero (UTM: 5·10⁶ m) it would keep 0.5 m.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LocalPoints {
    /// Where the local zero lies in the source's coordinates, metres.
    pub origin: DVec3,
    /// Coordinates along x about the origin, metres.
    pub x: Vec<f32>,
    /// Coordinates along y about the origin, metres.
    pub y: Vec<f32>,
    /// Coordinates along z about the origin, metres.
    pub z: Vec<f32>,
    /// For each kept point its place in the source; empty where nothing was rejected.
    pub source: Vec<u32>,
    /// Positions of the source that were not finite, and are not kept.
    pub rejected: usize,
}

/// A cloud that cannot be taken in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the cloud has {points} points and at most {limit} can be numbered; split it", limit = u32::MAX - 1)]
pub struct TooManyPoints {
    /// Points offered.
    pub points: usize,
}

impl LocalPoints {
    /// Takes in positions (metres, any frame). The origin is the middle of their bounding box,
    /// cut to whole metres where it is farther than 1 m away so that sums stay readable; the
    /// coordinates are exact to a 2⁻²⁴ part of the cloud's extent.
    ///
    /// # Errors
    /// More points than a `u32` can number.
    pub fn new(positions: &[DVec3]) -> Result<Self, TooManyPoints> {
        let mut points = Self::default();
        points.refill(positions)?;
        Ok(points)
    }

    /// As [`LocalPoints::new`], into buffers that are kept.
    ///
    /// # Errors
    /// More points than a `u32` can number.
    pub fn refill(&mut self, positions: &[DVec3]) -> Result<(), TooManyPoints> {
        if positions.len() >= u32::MAX as usize {
            return Err(TooManyPoints {
                points: positions.len(),
            });
        }
        // Finite is not enough: what overflows single precision when squared is no measurement.
        let usable = |p: &DVec3| p.is_finite() && p.abs().max_element() < 1e15;
        let (mut low, mut high) = (DVec3::MAX, DVec3::MIN);
        let mut kept = 0;
        for p in positions.iter().filter(|p| usable(p)) {
            low = low.min(*p);
            high = high.max(*p);
            kept += 1;
        }
        self.origin = if kept == 0 {
            DVec3::ZERO
        } else {
            (0.5 * (low + high)).trunc()
        };
        self.rejected = positions.len() - kept;
        for axis in [&mut self.x, &mut self.y, &mut self.z] {
            axis.clear();
            axis.reserve(kept);
        }
        self.source.clear();
        for (i, p) in positions.iter().enumerate().filter(|(_, p)| usable(p)) {
            let local = (*p - self.origin).as_vec3();
            self.x.push(local.x);
            self.y.push(local.y);
            self.z.push(local.z);
            if self.rejected > 0 {
                self.source.push(i as u32);
            }
        }
        Ok(())
    }

    /// Points kept.
    #[must_use]
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// True where no point was kept.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Point `i` about the local origin, metres. `i` must be below [`LocalPoints::len`].
    #[inline]
    #[must_use]
    pub fn at(&self, i: usize) -> Vec3 {
        Vec3::new(self.x[i], self.y[i], self.z[i])
    }

    /// Point `i` in the source's coordinates, metres.
    #[must_use]
    pub fn world(&self, i: usize) -> DVec3 {
        self.at(i).as_dvec3() + self.origin
    }

    /// Place in the source of kept point `i`.
    #[must_use]
    pub fn source_index(&self, i: usize) -> usize {
        self.source.get(i).map_or(i, |&s| s as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rejects_and_counts_what_is_not_finite() {
        let p = DVec3::new(1.0, 2.0, 3.0);
        let given = [
            p,
            DVec3::new(f64::NAN, 0.0, 0.0),
            p * 2.0,
            DVec3::new(0.0, f64::INFINITY, 0.0),
            DVec3::new(0.0, 1e30, 0.0),
        ];
        let points = LocalPoints::new(&given).unwrap();
        assert_eq!((points.len(), points.rejected), (2, 3));
        assert_eq!(points.source, [0, 2]);
        assert_eq!(points.source_index(1), 2);
        assert!((points.world(1) - p * 2.0).length() < 1e-6);
    }

    #[test]
    fn huge_offsets_cost_no_precision() {
        let utm = DVec3::new(448_262.123, 5_411_932.678, 113.456);
        let given: Vec<DVec3> = (0..1000)
            .map(|i| utm + DVec3::new(f64::from(i) * 1e-4, f64::from(i % 7) * 1e-3, 0.0))
            .collect();
        let points = LocalPoints::new(&given).unwrap();
        for (i, p) in given.iter().enumerate() {
            assert!((points.world(i) - *p).length() < 1e-6, "point {i}");
        }
    }

    #[test]
    fn nothing_in_nothing_out() {
        let points = LocalPoints::new(&[DVec3::NAN]).unwrap();
        assert!(points.is_empty());
        assert_eq!((points.rejected, points.origin), (1, DVec3::ZERO));
    }
}
