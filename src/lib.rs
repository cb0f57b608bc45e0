//! saint-live: a live depth camera as a stream of spheres.

pub mod frame;

pub mod capture;
pub mod intrinsics;

pub mod codec;
pub mod contact_map;
pub mod deproject;
pub mod export;
pub mod fit;
pub mod partition;
pub mod pipeline;
pub mod play;
pub mod quality;
pub mod recording;
