//! Spheres from points (paper 3.1, 3.2).

pub mod agglomerate;
mod cold;
pub mod contact_distance;
pub mod live;
pub mod moments;
pub mod sphere;
mod warm;
