//! A live depth camera as a stream of spheres: the 3DSAINT paper, frame by frame.
//!
//! SAINT models a surface by spheres fitted to it (centre and radius) and a *contact map* that says
//! which sphere each cell of a grid touches. Points come back from the two.
//!
//! # The path of a frame
//! ```text
//!  capture ──► deproject ──► partition ──► fit ──► contact_map ──► codec ──► recording
//!  a source    integers to   hex-packed   spheres,  pixels to      payload   MCAP file or pipe
//!  fills a     rays and      cells        warm from spheres        key or P
//!  buffer      metres                     the last frame
//!                                                                    │
//!                       export, play ◄── codec::Decoder ◄── recording reader
//! ```
//! Read in this order: [`frame`] (what crosses stages, units and axes), [`capture`] (where frames
//! come from), [`deproject`], [`fit::sphere`] (one sphere), [`fit::live`] (the live fit, five
//! passes), [`contact_map`], [`codec`] (the payload; `codec/FORMAT.md` is its specification),
//! [`recording`], and [`pipeline`], which runs all of it in named threads within a latency budget.
//!
//! Beside the path: [`features`] and [`loss`] for learning, [`experiment`] with the paper's
//! measurements.
//!
//! # Units and axes
//! Metres; right-handed optical frame (x right, y down, z forward); depth is planar z, not distance
//! along the ray; times are int64 nanoseconds. Depth integers become metres in one place,
//! [`deproject`].
//!
//! # Guarantees
//! The stages between source and sink are pure functions of their input and a workspace. The same
//! frames give the same bytes whatever the number of threads. No input makes the library panic;
//! every error names what happened and what to do.

pub mod frame;

pub mod capture;
pub mod cloud;
pub mod intrinsics;
pub mod rig;

pub mod deproject;
pub mod partition;

pub mod fit;

pub mod contact_map;

pub mod features;

pub mod loss;

pub mod codec;

pub mod recording;

pub mod model;

pub mod pipeline;

pub mod play;

pub mod export;

pub mod quality;

pub mod experiment;

#[cfg(feature = "capi")]
pub mod capi;
