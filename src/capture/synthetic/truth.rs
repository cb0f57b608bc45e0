//! What a synthetic frame really shows.

use super::surface::{Pose, Surface};
use glam::DVec3;

/// A sphere of the scene, as the camera sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueSphere {
    /// Its number in [`SceneTruth::surface`].
    pub surface: u16,
    /// Centre in the camera's optical frame, metres.
    pub center_m: DVec3,
    /// Radius, metres.
    pub radius_m: f64,
}

/// The truth behind one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneTruth {
    /// The frame.
    pub index: u64,
    /// Camera to world.
    pub pose: Pose,
    /// Exact planar depth, metres, row-major, one per pixel; 0 = nothing there.
    pub depth_m: Vec<f64>,
    /// Surface seen by each pixel: 0 = nothing, else 1 + its place in `surfaces`.
    pub surface: Vec<u16>,
    /// All spheres of the scene, seen or not.
    pub spheres: Vec<TrueSphere>,
    /// All surfaces of the scene, in the world.
    pub surfaces: Vec<Surface>,
}
