//! The contact map on the sensor's own ray grid: a label image.
//!
//! Deviation. The paper's grid is each sphere's own latitude and longitude; ours, for live frames,
//! is the camera's: a pixel is a latitude/longitude of the viewing sphere. No two contacts can
//! fall into one cell, no angle is rounded, and the rebuilt points are a depth image again.

/// A pixel that holds no measurement.
pub const INVALID: u16 = u16::MAX;
/// A measured pixel that no sphere explains.
pub const NO_SPHERE: u16 = u16::MAX - 1;

/// One SAINT frame in the sensor domain: spheres with stable ids and the map of who touches which.
#[derive(Clone, Debug, Default)]
pub struct SaintFrame {
    /// Sphere slots; a slot keeps its number from frame to frame while its surface lives.
    pub spheres: Vec<Option<crate::fit::sphere::Sphere>>,
    /// Per pixel, row-major: a slot of `spheres`, [`NO_SPHERE`] or [`INVALID`].
    pub labels: Vec<u16>,
    /// How the camera moved since the frame before; still where it is not known. Spheres that
    /// stand still in the world have moved by this and are otherwise unchanged to the bit.
    pub motion: crate::fit::motion::Motion,
}
