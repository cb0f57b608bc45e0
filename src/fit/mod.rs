//! Spheres from points (paper 3.1, 3.2).

pub mod agglomerate;
mod cold;
pub mod contact_distance;
pub mod live;
pub mod moments;
pub mod cloud;
pub mod contact_distance;
mod cover;
mod merge;
pub mod point_moments;
pub mod progressive;
pub mod random;
mod remaining;
pub mod scheme;
mod search;
pub mod sphere;
mod warm;
