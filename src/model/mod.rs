//! Models of static clouds: objects as unions of spheres (paper 3.2, Eq. 2), scenes as unions of
//! objects (Eq. 3), each at one or several scales (Fig. 5, 7), in one file.
//!
//! ```text
//! points of an object ─► build::part ─► Part ─┐
//!   one for each scale (scales::fit)          ├─► file::write ─► .mcap ─► file::read ─► export
//! what is known of the objects ─► Scene ──────┘
//! ```
//! A *part* is one object at one scale: spheres and their contact map as a payload that decodes
//! alone (`codec/FORMAT.md`, chapters 2 and 4). Parts stand in the file scale by scale, coarse to
//! fine: the beginning of a file is the coarse scene.

pub mod build;
pub mod export;
pub mod file;
pub mod scales;
#[cfg(test)]
mod tests;

use crate::codec::merged::MergedModel;
use crate::codec::polar::PolarCodecError;
use crate::codec::{merged, polar};
use crate::contact_map::merged::ClaimMap;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// What a model file says of itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    /// Program and version that wrote it.
    pub generator: String,
    /// Scheme of the fit: `random` or `progressive`.
    pub scheme: String,
    /// Seed of the random scheme.
    pub seed: u64,
    /// Lattice of the progressive scheme's cells: `hex` or `cubic`.
    pub packing: String,
    /// Distance of neighbouring cell centres, metres.
    pub cube_size_m: f64,
    /// Most spheres fitted in one cell.
    pub spheres_per_cube: u32,
    /// The objects, in the order they were given.
    pub objects: Vec<ObjectInfo>,
    /// Most spheres of an object at each scale, coarse to fine; one entry for a single scale.
    pub scales: Vec<u32>,
    /// The parts in the order of the file: by scale, then by object.
    pub parts: Vec<PartInfo>,
}

/// One object of a scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ObjectInfo {
    /// Its name, unlike all others in the scene.
    pub name: String,
    /// File it was read from.
    pub source: String,
    /// Unit of the file's coordinates.
    pub unit: String,
    /// Points that were modelled.
    pub points: u64,
    /// Positions left out because they were not finite.
    pub rejected: u64,
    /// Points that repeat another's position; none where they were not counted.
    pub duplicates: Option<u64>,
    /// Size of the bounding box, metres.
    pub extent_m: [f64; 3],
    /// Bytes of the positions as the paper counts raw points: three f32 each.
    pub raw_bytes: u64,
}

/// One object at one scale.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PartInfo {
    /// Place in [`Scene::objects`].
    pub object: u32,
    /// Place in [`Scene::scales`].
    pub scale: u32,
    /// Contact distance, as `--contact-distance` takes it.
    pub contact_distance: String,
    /// Spheres.
    pub spheres: u32,
    /// Share of the points within contact distance of their sphere, 0 to 1.
    pub explained: f64,
    /// Distance of the explained points from their spheres.
    pub residual: Residual,
    /// Symmetric Chamfer distance between the object's points and those the payload gives back,
    /// metres; none where it was not measured.
    #[serde(default)]
    pub chamfer_m: Option<f64>,
    /// What became of the points in the contact map.
    pub map: MapInfo,
    /// Size of the payload.
    pub bytes: u64,
}

/// Distances of points from their spheres, metres; 0 without points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Residual {
    /// Mean.
    pub mean_m: f64,
    /// 99th percentile (nearest rank).
    pub p99_m: f64,
    /// Largest.
    pub max_m: f64,
}

/// A contact map, counted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MapInfo {
    /// `claims`: every sphere's claims are kept; `merged`: one number a cell, as in the paper.
    pub kind: String,
    /// Cell: arc length in metres (`claims`), or cells over 180° (`merged`).
    pub resolution: f64,
    /// Explained points.
    pub points: u64,
    /// Cells in the map: the points that come back.
    pub cells: u64,
    /// Points beyond the first in a cell of their own sphere: they come back as that one.
    pub shared: u64,
    /// Points whose cell went to another sphere: they do not come back.
    pub lost: u64,
    /// Contacts (a sphere's cell, however many points) displaced by another sphere's.
    pub collisions: u64,
}

impl MapInfo {
    /// Points that come back, by themselves or as their cell's.
    #[must_use]
    pub fn kept(&self) -> u64 {
        self.points - self.lost.min(self.points)
    }
}

/// One object at one scale, coded.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Part {
    /// What is known of it.
    pub info: PartInfo,
    /// Its payload.
    pub payload: Vec<u8>,
}

/// A part's spheres and points.
#[derive(Clone, Debug, PartialEq)]
pub enum Geometry {
    /// With the map that keeps every claim.
    Claims(ClaimMap),
    /// With the paper's merged map.
    Merged(MergedModel),
}

impl Geometry {
    /// Reads a payload of either kind; the first four bytes tell.
    ///
    /// # Errors
    /// Bytes that are neither.
    pub fn decode(payload: &[u8]) -> Result<Self, PolarCodecError> {
        if payload.starts_with(&merged::MAGIC) {
            merged::decode(payload).map(Self::Merged)
        } else {
            polar::decode(payload).map(Self::Claims)
        }
    }

    /// Zero of all coordinates in the source's, metres.
    #[must_use]
    pub fn origin(&self) -> DVec3 {
        match self {
            Self::Claims(map) => map.origin,
            Self::Merged(model) => model.origin,
        }
    }

    /// Centre (about the origin) and radius of each sphere, metres.
    #[must_use]
    pub fn spheres(&self) -> Vec<(DVec3, f64)> {
        match self {
            Self::Claims(map) => map.patches.iter().map(|p| p.center_radius()).collect(),
            Self::Merged(model) => model.spheres().collect(),
        }
    }

    /// The points (metres about the origin), each with its sphere's number.
    #[must_use]
    pub fn points(&self) -> Vec<(DVec3, u32)> {
        match self {
            Self::Claims(map) => {
                let mut points = Vec::with_capacity(map.cells.len());
                for (s, patch) in map.patches.iter().enumerate() {
                    let grid = patch.grid(f64::from(map.step_m));
                    let own = map.claims(s).iter();
                    points.extend(own.map(|&cell| (grid.point(cell), s as u32)));
                }
                points
            }
            Self::Merged(model) => model.points().collect(),
        }
    }
}
