//! The sphere through a point's own neighbours.

use crate::fit::point_moments::PointMoments;
use glam::DVec3;
use rstar::RTree;

/// Largest neighbourhood, in multiples of what was asked for, where points tie.
const TIES: usize = 4;

/// Finite points of a cloud, searchable by place.
#[derive(Debug)]
pub struct Neighbourhoods {
    tree: RTree<[f64; 3]>,
}

impl Neighbourhoods {
    /// Takes in the finite ones of `points`. O(n log n).
    #[must_use]
    pub fn new(points: &[DVec3]) -> Self {
        let finite = points.iter().filter(|p| p.is_finite());
        Self {
            tree: RTree::bulk_load(finite.map(DVec3::to_array).collect()),
        }
    }

    /// The `count` points nearest to `p`, and those as far as the last of them (at most four
    /// times `count` in all): which of two equally far points comes first must not matter.
    pub fn around<'a>(&self, p: DVec3, count: usize, buffer: &'a mut Vec<DVec3>) -> &'a [DVec3] {
        buffer.clear();
        let mut reach = f64::INFINITY;
        for (neighbour, square) in self
            .tree
            .nearest_neighbor_iter_with_distance_2(p.to_array())
        {
            if square > reach || buffer.len() >= TIES * count {
                break;
            }
            buffer.push(DVec3::from_array(*neighbour));
            if buffer.len() == count {
                reach = square * (1.0 + 1e-9);
            }
        }
        buffer
    }
}

/// A sphere fitted to a neighbourhood, seen from its point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalSphere {
    /// Unit normal at the foot of the point.
    pub normal: DVec3,
    /// 1/radius, 1/m: above 0 where the surface bulges along the normal, 0 for a plane.
    pub curvature: f64,
    /// Signed distance of the point from the surface, along the normal, metres.
    pub offset_m: f64,
    /// RMS distance of the neighbours from the surface, metres.
    pub residual_m: f64,
    /// RMS distance of the neighbours from the point, metres.
    pub spread_m: f64,
}

impl LocalSphere {
    /// Fits `hood` about `p`; of the two normals the one with a positive part along `outward`
    /// is taken. `None` where the neighbours span no surface (fewer than five, in one place, on
    /// a line).
    #[must_use]
    pub fn fit(p: DVec3, hood: &[DVec3], outward: DVec3) -> Option<Self> {
        let mut moments = PointMoments::default();
        for q in hood {
            moments.add(*q - p);
        }
        // about the point itself: its own coordinates are 0
        let sphere = moments.fit()?.sphere;
        let gradient = sphere.normal.try_normalize()?;
        let side = if gradient.dot(outward) < 0.0 {
            -1.0
        } else {
            1.0
        };
        let count = hood.len() as f64;
        let square = |q: &DVec3| sphere.distance(*q - p).powi(2);
        Some(Self {
            normal: side * gradient,
            curvature: side * sphere.curvature,
            offset_m: side * sphere.signed_distance(DVec3::ZERO),
            residual_m: (hood.iter().map(square).sum::<f64>() / count).sqrt(),
            spread_m: (moments.square.element_sum() / count).sqrt(),
        })
    }
}
