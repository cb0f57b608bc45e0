//! Features of points for learning (paper 4.2): the paper's four, and the sphere through each
//! point's own neighbours.
//!
//! The paper adds to each point "the sphere center, radius, length of the vector projected onto
//! the xy-plane, and the angle between the projected vector and the x-axis". It does not say
//! which vector: here it is the one from the sphere's centre to the point. These numbers change
//! when the object turns. The rest come from a sphere fitted to the point's neighbours
//! ([`local`]) and do not: they are lengths, curvatures and angles between vectors that turn
//! along.
//!
//! [`COLUMNS`] names every column; README and `export --to npz` show the same list.

pub mod local;

use crate::fit::cloud::UNASSIGNED;
use crate::loss::Ball;
use glam::DVec3;
use local::{LocalSphere, Neighbourhoods};
use rayon::prelude::*;

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Column {
    /// Short name.
    pub name: &'static str,
    /// Unit; empty for a plain number.
    pub unit: &'static str,
    /// One line for people.
    pub meaning: &'static str,
}

const fn column(name: &'static str, unit: &'static str, meaning: &'static str) -> Column {
    Column {
        name,
        unit,
        meaning,
    }
}

/// Columns of the paper: they change when the object turns. The first of [`COLUMNS`].
pub const PAPER_COLUMNS: usize = 6;

/// All columns, in order. 0 everywhere where a point has no sphere (the first six) or no local
/// sphere (the rest but `centroid_distance`).
pub const COLUMNS: [Column; 15] = [
    column(
        "center_x",
        "m",
        "centre of the point's sphere, about the cloud's origin",
    ),
    column("center_y", "m", "the same along y"),
    column("center_z", "m", "the same along z"),
    column(
        "radius",
        "m",
        "radius of the point's sphere; 10000 for a plane",
    ),
    column(
        "xy_length",
        "m",
        "length of (point - centre) projected on the xy-plane",
    ),
    column("xy_angle", "rad", "its angle to the x-axis, -pi to pi"),
    column(
        "curvature",
        "1/m",
        "local sphere: 1/radius, above 0 where the surface bulges along the normal",
    ),
    column(
        "bend",
        "",
        "the same without a unit: k s / (1 + |k| s), s the spread; -1 to 1",
    ),
    column(
        "residual",
        "m",
        "RMS distance of the neighbours from the local sphere",
    ),
    column(
        "offset",
        "m",
        "signed distance of the point from the local sphere, along the normal",
    ),
    column(
        "spread",
        "m",
        "RMS distance of the neighbours from the point",
    ),
    column(
        "view_cosine",
        "",
        "cosine between the normal and the way to the camera; with no camera 0",
    ),
    column(
        "centroid_distance",
        "m",
        "distance of the point from the cloud's centroid",
    ),
    column(
        "centroid_cosine",
        "",
        "cosine between the normal and the way from the centroid to the point",
    ),
    column(
        "centroid_offset",
        "m",
        "distance of the centroid from the local tangent plane, along the normal",
    ),
];

/// How features are computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeatureOptions {
    /// Points of a neighbourhood, the point itself included; at least 5. Equally far ones are
    /// all taken, so that no tie decides.
    pub neighbours: usize,
    /// Where the camera stood, metres: normals then point to it. Without a camera they point
    /// away from the cloud's centroid.
    pub view: Option<DVec3>,
    /// What `center_x`, `center_y`, `center_z` count from, metres.
    pub origin: DVec3,
}

impl Default for FeatureOptions {
    fn default() -> Self {
        Self {
            neighbours: 24,
            view: None,
            origin: DVec3::ZERO,
        }
    }
}

/// One row of features per point.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// Row-major, [`COLUMNS`] wide.
    pub values: Vec<f32>,
    /// Unit normal of each point's local sphere; 0 0 0 where there is none.
    pub normals: Vec<[f32; 3]>,
}

impl Features {
    /// The features of `points` (metres), whose spheres are `spheres[owners[i]]`; a number that
    /// is not there ([`UNASSIGNED`]), or no number at all, means none. Non-finite points get
    /// zeros and are no one's neighbour. O(n log n).
    #[must_use]
    pub fn new(
        points: &[DVec3],
        spheres: &[Ball],
        owners: &[u32],
        options: &FeatureOptions,
    ) -> Self {
        let finite = || points.iter().filter(|p| p.is_finite());
        let count = finite().count().max(1) as f64;
        // about one of the points: a sum of UTM coordinates would lose digits
        let near = finite().next().copied().unwrap_or_default();
        let centroid = near + finite().map(|p| *p - near).sum::<DVec3>() / count;
        let hoods = Neighbourhoods::new(points);
        let rows: Vec<_> = points
            .par_iter()
            .enumerate()
            .map_init(Vec::new, |buffer, (i, &p)| {
                let mut row = [0f32; COLUMNS.len()];
                if !p.is_finite() {
                    return (row, [0.0; 3]);
                }
                let owner = owners.get(i).copied().unwrap_or(UNASSIGNED);
                if let Some(ball) = spheres.get(owner as usize) {
                    row[..PAPER_COLUMNS].copy_from_slice(&paper(p, ball, options.origin));
                }
                let hood = hoods.around(p, options.neighbours.max(5), buffer);
                let outward = options.view.map_or(p - centroid, |view| view - p);
                let normal = match LocalSphere::fit(p, hood, outward) {
                    Some(local) => {
                        invariant(p, &local, centroid, options.view, &mut row[PAPER_COLUMNS..]);
                        local.normal.as_vec3().to_array()
                    }
                    None => {
                        row[PAPER_COLUMNS + 6] = p.distance(centroid) as f32;
                        [0.0; 3]
                    }
                };
                (row, normal)
            })
            .collect();
        Self {
            values: rows.iter().flat_map(|(row, _)| *row).collect(),
            normals: rows.into_iter().map(|(_, normal)| normal).collect(),
        }
    }

    /// Row of point `i`, which must be below the number of points.
    #[must_use]
    pub fn row(&self, i: usize) -> &[f32] {
        &self.values[i * COLUMNS.len()..(i + 1) * COLUMNS.len()]
    }
}

/// The paper's columns.
fn paper(p: DVec3, ball: &Ball, origin: DVec3) -> [f32; PAPER_COLUMNS] {
    let center = ball.center - origin;
    let from_center = p - ball.center;
    [
        center.x,
        center.y,
        center.z,
        ball.radius,
        from_center.x.hypot(from_center.y),
        from_center.y.atan2(from_center.x),
    ]
    .map(|v| v as f32)
}

/// The columns behind the paper's.
fn invariant(p: DVec3, local: &LocalSphere, centroid: DVec3, view: Option<DVec3>, row: &mut [f32]) {
    let (k, s, n) = (local.curvature, local.spread_m, local.normal);
    let from_centroid = p - centroid;
    let values = [
        k,
        k * s / (1.0 + k.abs() * s),
        local.residual_m,
        local.offset_m,
        s,
        view.map_or(0.0, |view| n.dot((view - p).normalize_or_zero())),
        from_centroid.length(),
        n.dot(from_centroid.normalize_or_zero()),
        n.dot(centroid - p),
    ];
    for (to, value) in row.iter_mut().zip(values) {
        *to = value as f32;
    }
}

#[cfg(test)]
mod tests;
