//! Spheres from points (paper 3.1, 3.2).

pub mod agglomerate;
mod bend;
mod block_set;
pub mod cloud;
mod cold;
pub mod contact_distance;
mod contacts;
mod cover;
pub(crate) mod draw;
mod fewer;
pub mod framewise;
mod hypothesis;
mod lanes;
pub mod live;
mod merge;
pub mod moments;
pub mod motion;
mod ordered;
pub mod point_moments;
pub mod progressive;
pub mod random;
mod remaining;
pub mod scheme;
mod search;
pub mod sphere;
mod touch;
mod warm;
