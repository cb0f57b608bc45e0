//! Spheres from points (paper 3.1, 3.2).

pub mod cloud;
pub mod contact_distance;
mod cover;
pub mod point_moments;
pub mod random;
mod remaining;
mod search;
pub mod sphere;
