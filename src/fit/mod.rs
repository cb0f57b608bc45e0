//! Spheres from points (paper 3.1, 3.2).

pub mod cloud;
pub mod contact_distance;
pub mod point_moments;
pub mod sphere;
