//! Spheres from points (paper 3.1, 3.2).

pub mod contact_distance;
pub mod sphere;
