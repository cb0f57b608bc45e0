//! From the points of an object to a part of the scene: fit, contact map, payload, figures.

use super::{Geometry, MapInfo, ObjectInfo, Part, PartInfo, Residual};
use crate::codec::merged::{self, MergedModel};
use crate::codec::polar::{self, PolarCodecError};
use crate::contact_map::merged::{ClaimMap, LiteralMap};
use crate::contact_map::polar::PolarGrid;
use crate::contact_map::polar_frame::default_step_m;
use crate::fit::cloud::{CloudModel, FitParameters, UNASSIGNED};
use crate::fit::contact_distance::ContactDistance;
use crate::fit::point_moments::PointMoments;
use crate::partition::points::LocalPoints;
use crate::quality::cloud_error;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Cells over 180° of a merged map where nobody says (paper: `mr`).
pub const DEFAULT_ROWS: u32 = 1024;
/// Most points whose repetitions are counted; beyond, sorting them costs as much as the fit.
const COUNTED_POINTS: usize = 2_000_000;
/// Most points whose Chamfer distance is measured; beyond, it takes minutes.
const COMPARED_POINTS: usize = 1_000_000;
/// Single precision resolves this part of a cloud's extent.
const RESOLVED: f64 = 1.0 / (1 << 20) as f64;

/// Which contact map a part gets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MapChoice {
    /// Keeps every claim, at cells of this arc length, metres; half the contact distance where
    /// none is given.
    Claims(Option<f64>),
    /// The paper's: one sphere number a cell, this many cells over 180°.
    Merged(u32),
}

impl Default for MapChoice {
    fn default() -> Self {
        Self::Claims(None)
    }
}

/// An object that no model can be made of.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Unfit {
    /// Fewer than five points, or all in one place or on one line.
    #[error("its {points} points span no surface")]
    NoSurface {
        /// Points that are finite.
        points: usize,
    },
    /// The object is too large for its contact distance.
    #[error(
        "it extends over {extent_m} m, so that positions are told apart to {resolved_m:.2e} m, and the contact distance is {contact_m} m; give the right --unit, leave far outliers out, or give a larger --contact-distance"
    )]
    TooWide {
        /// Largest side of the bounding box, metres.
        extent_m: f64,
        /// What single precision about the middle resolves, metres.
        resolved_m: f64,
        /// Contact distance, metres.
        contact_m: f64,
    },
}

/// Bounding box of the points, metres; 0 without points.
#[must_use]
pub fn extent_m(points: &LocalPoints) -> DVec3 {
    let (mut low, mut high) = (Vec3::MAX, Vec3::MIN);
    for i in 0..points.len() {
        low = low.min(points.at(i));
        high = high.max(points.at(i));
    }
    if points.is_empty() {
        return DVec3::ZERO;
    }
    high.as_dvec3() - low.as_dvec3()
}

/// A contact distance for an object nobody gave one for: half a percent of the diagonal, to two
/// digits, so that what is printed is what was used.
#[must_use]
pub fn default_contact_m(extent_m: DVec3) -> f64 {
    printed_distance(two_digits(0.005 * extent_m.length()), 2)
}

/// A cube size for an object nobody gave one for: an eighth of the diagonal, to two digits.
#[must_use]
pub fn default_cube_m(extent_m: DVec3) -> f64 {
    two_digits(extent_m.length() / 8.0)
}

fn two_digits(length_m: f64) -> f64 {
    let rounded = digits(length_m, 2);
    if rounded > 0.0 { rounded } else { 1.0 }
}

/// The contact distance with so many digits of a millimetre, exactly as its text reads back.
pub(crate) fn printed_distance(length_m: f64, count: usize) -> f64 {
    let text = format!("{}mm", digits(1e3 * length_m, count));
    let read = text.parse::<ContactDistance>();
    read.map_or(length_m, |distance| distance.floor_m)
}

/// The number with so many digits, at least one, as the double nearest to what is printed.
pub(crate) fn digits(value: f64, digits: usize) -> f64 {
    let text = format!("{value:.*e}", digits.saturating_sub(1));
    text.parse().unwrap_or(value)
}

/// Whether a model can be made of the points at this contact distance (metres).
///
/// # Errors
/// [`Unfit`] says why not.
pub fn check(points: &LocalPoints, contact_m: f64) -> Result<(), Unfit> {
    let extent_m = extent_m(points).max_element();
    let resolved_m = extent_m * RESOLVED;
    if resolved_m > contact_m {
        return Err(Unfit::TooWide {
            extent_m,
            resolved_m,
            contact_m,
        });
    }
    let mut sums = PointMoments::default();
    // scaled to the unit cube: fourth powers of large extents leave the range of f64
    let scale = 1.0 / extent_m.max(f64::MIN_POSITIVE);
    for i in 0..points.len() {
        sums.add(points.at(i).as_dvec3() * scale);
    }
    if sums.fit().is_none() {
        let points = points.len();
        return Err(Unfit::NoSurface { points });
    }
    Ok(())
}

/// What is known of an object from its points; name, source and unit are the caller's.
#[must_use]
pub fn describe(points: &LocalPoints) -> ObjectInfo {
    ObjectInfo {
        points: points.len() as u64,
        rejected: points.rejected as u64,
        duplicates: (points.len() <= COUNTED_POINTS).then(|| duplicates(points)),
        extent_m: extent_m(points).to_array(),
        raw_bytes: 12 * points.len() as u64,
        ..ObjectInfo::default()
    }
}

fn duplicates(points: &LocalPoints) -> u64 {
    let bits = |v: f32| (v + 0.0).to_bits();
    let mut keys: Vec<[u32; 3]> = (0..points.len())
        .map(|i| points.at(i).to_array().map(bits))
        .collect();
    keys.par_sort_unstable();
    keys.windows(2).filter(|w| w[0] == w[1]).count() as u64
}

/// Distances of the assigned points from their spheres.
#[must_use]
pub fn residual(points: &LocalPoints, model: &CloudModel) -> Residual {
    let mut distances: Vec<f64> = (model.assignment.iter().enumerate())
        .filter(|&(_, &s)| s != UNASSIGNED)
        .map(|(i, &s)| model.spheres[s as usize].distance(points.at(i).as_dvec3()))
        .collect();
    if distances.is_empty() {
        return Residual::default();
    }
    let n = distances.len();
    let mean_m = distances.iter().sum::<f64>() / n as f64;
    let rank = (n * 99).div_ceil(100) - 1;
    let (_, p99, above) = distances.select_nth_unstable_by(rank, f64::total_cmp);
    Residual {
        mean_m,
        p99_m: *p99,
        max_m: above.iter().copied().fold(*p99, f64::max),
    }
}

/// Chamfer distance between the object's points and those that the part's payload gives back,
/// metres. None for more than a million points, and where nothing comes back.
///
/// # Errors
/// A payload that does not decode.
pub fn chamfer_m(points: &LocalPoints, part: &Part) -> Result<Option<f64>, PolarCodecError> {
    if points.len() > COMPARED_POINTS {
        return Ok(None);
    }
    let geometry = Geometry::decode(&part.payload)?;
    let shift = geometry.origin() - points.origin;
    let rebuilt: Vec<DVec3> = geometry
        .points()
        .into_iter()
        .map(|(p, _)| p + shift)
        .collect();
    let original: Vec<DVec3> = (0..points.len()).map(|i| points.at(i).as_dvec3()).collect();
    let chamfer_m = cloud_error(&original, &rebuilt).chamfer_m;
    Ok(Some(chamfer_m).filter(|c| c.is_finite()))
}

/// Codes a fitted model with its contact map, and counts what the map keeps.
///
/// # Errors
/// A map that the payload cannot hold: a step beyond single precision.
pub fn part(
    points: &LocalPoints,
    model: &CloudModel,
    parameters: &FitParameters,
    choice: MapChoice,
) -> Result<Part, PolarCodecError> {
    let mut part = Part::default();
    let assigned = model.assignment.iter().filter(|&&s| s != UNASSIGNED);
    let assigned = assigned.count() as u64;
    let map = match choice {
        MapChoice::Claims(step_m) => {
            let step_m = step_m.unwrap_or_else(|| default_step_m(&parameters.contact_distance));
            let (map, outside) = ClaimMap::new(points, model, step_m as f32);
            polar::encode(&map, &mut part.payload)?;
            let cells = map.cells.len() as u64;
            MapInfo {
                kind: "claims".to_owned(),
                resolution: step_m,
                points: assigned,
                cells,
                shared: assigned - outside as u64 - cells,
                lost: outside as u64,
                collisions: 0,
            }
        }
        MapChoice::Merged(rows) => {
            let map = LiteralMap::new(points, model, PolarGrid::new(rows));
            let (lost, collisions) = (map.lost_points as u64, map.lost_contacts as u64);
            let cells = map.cells.len() as u64;
            let rows = map.grid.rows;
            merged::encode(&MergedModel::new(model, map), &mut part.payload)?;
            MapInfo {
                kind: "merged".to_owned(),
                resolution: f64::from(rows),
                points: assigned,
                cells,
                shared: assigned - lost - cells,
                lost,
                collisions,
            }
        }
    };
    part.info = PartInfo {
        contact_distance: parameters.contact_distance.to_string(),
        spheres: model.spheres.len() as u32,
        explained: model.explained,
        residual: residual(points, model),
        map,
        bytes: part.payload.len() as u64,
        ..PartInfo::default()
    };
    Ok(part)
}
