//! Dividing space into cells (paper 3.2 "bounding volumes", 4.1 packing).
//!
//! [`points`] is the door: positions about a local origin, non-finite ones counted and left out.
//! [`lattice`] says which cell a position belongs to, [`cells`] gathers the points cell by cell.

pub mod cells;
pub mod lattice;
pub mod points;
