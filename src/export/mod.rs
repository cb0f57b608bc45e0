//! Decoded frames as files other tools open.
//!
//! | format | one file holds | units |
//! |---|---|---|
//! | [`ply`] | points with colour and sphere number; or the spheres | metres, optical frame |
//! | [`pcd`] | the same points, for PCL and Open3D | metres, optical frame |
//! | [`exr`] | planar depth, camera and time as attributes | metres, 0 = no measurement |
//! | [`png`] | a picture: each sphere its colour | – |
//! | [`png16`] | planar depth as integers, `camera.json` beside | the sensor's unit, 0 = none |
//! | [`npz`] | points with normals and SAINT features, as NumPy arrays | metres, optical frame |
//!
//! A frame with a polar contact map ([`ExportCloud`]) has points and spheres, no depth image.
//! EXR and 16-bit PNG are inputs again. [`FileSequence`] writes one file a frame, or one file.

mod cloud;
pub mod color;
pub mod exr;
pub mod npz;
mod paint;
pub mod pcd;
pub mod ply;
pub mod png;
pub mod png16;
mod sequence;
#[cfg(test)]
mod tests;
pub mod union;

pub use cloud::ExportCloud;
pub use paint::Painter;
pub use sequence::{ExportSummary, FileSequence, Format, Output};

use crate::contact_map::labels::{INVALID, NO_SPHERE};
use crate::fit::sphere::Sphere;
use crate::frame::{Camera, FrameTime};
use glam::Vec3;
use std::io;
use std::path::PathBuf;

/// A frame as the decoder gives it.
#[derive(Clone, Copy, Debug)]
pub struct ExportFrame<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// The source's frame number.
    pub sequence: u64,
    /// When the frame was taken.
    pub time: FrameTime,
    /// Planar depth, metres, row-major, one per pixel; 0 = no measurement.
    pub depth_m: &'a [f32],
    /// Sphere of each pixel, row-major: a slot of `spheres`, `NO_SPHERE` or `INVALID`.
    pub labels: &'a [u16],
    /// Sphere slots.
    pub spheres: &'a [Option<Sphere>],
}

/// One measured pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Position, metres, optical frame.
    pub position: Vec3,
    /// The sphere it lies on, where there is one.
    pub sphere: Option<u16>,
}

impl<'a> ExportFrame<'a> {
    /// Checks that depth and labels have one value per pixel.
    ///
    /// # Errors
    /// [`ExportError::FrameSize`].
    pub fn check(&self) -> Result<(), ExportError> {
        let pixels = self.camera.pixels();
        if self.depth_m.len() == pixels && self.labels.len() == pixels && pixels > 0 {
            return Ok(());
        }
        Err(ExportError::FrameSize {
            sequence: self.sequence,
            depth: self.depth_m.len(),
            labels: self.labels.len(),
            pixels,
        })
    }

    /// The measured pixels as points, in row-major order.
    pub fn points(&self) -> impl Iterator<Item = Point> + use<'a> {
        let width = self.camera.width.max(1) as usize;
        let lens = self.camera.intrinsics;
        let rows = self.depth_m.chunks(width).zip(self.labels.chunks(width));
        rows.enumerate().flat_map(move |(v, (depth, labels))| {
            let down = (v as f64 - lens.cy) / lens.fy;
            let row = depth.iter().zip(labels).enumerate();
            row.filter(|(_, (z, _))| is_measured(**z))
                .map(move |(u, (z, label))| {
                    let (across, z64) = ((u as f64 - lens.cx) / lens.fx, f64::from(*z));
                    Point {
                        position: Vec3::new((across * z64) as f32, (down * z64) as f32, *z),
                        sphere: sphere_of(*label),
                    }
                })
        })
    }
}

/// True for a depth that is one: finite and in front of the camera.
#[must_use]
pub fn is_measured(depth_m: f32) -> bool {
    depth_m.is_finite() && depth_m > 0.0
}

/// The sphere a label names.
#[must_use]
pub fn sphere_of(label: u16) -> Option<u16> {
    (label != INVALID && label != NO_SPHERE).then_some(label)
}

/// Why an export cannot go on; a variant is what the caller does about it.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The output exists and nobody asked to overwrite it: usage, exit 2.
    #[error("{} exists already{}; give another name or --overwrite", .path.display(), if *.folder { " and is not empty" } else { "" })]
    Exists {
        /// File or folder.
        path: PathBuf,
        /// True for a folder.
        folder: bool,
    },
    /// The name of a format is not known: usage, exit 2.
    #[error("cannot export to {0:?}; choose one of ply, spheres, pcd, exr, png, png16, npz")]
    UnknownFormat(String),
    /// The format is an image and the frame has no grid: usage, exit 2.
    #[error(
        "frame {sequence} has a polar contact map: its points have no grid, so {format} cannot hold them; export to ply, pcd, spheres or npz, or record with a sensor contact map"
    )]
    NoGrid {
        /// The source's frame number.
        sequence: u64,
        /// Name of the format.
        format: &'static str,
    },
    /// The format cannot hold several cameras: usage, exit 2.
    #[error("{format} cannot hold the frames of several cameras; merge to ply or spheres")]
    NoUnion {
        /// Name of the format.
        format: &'static str,
    },
    /// A second frame came for an output that is one file: usage, exit 2.
    #[error("{} is one file and a second frame came; choose one frame or give a folder", .path.display())]
    SingleFile {
        /// The file.
        path: PathBuf,
    },
    /// A file cannot be written: exit 5.
    #[error("cannot write {}: {source}; {files} files are kept; choose a place that may be written and has room", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Whole files written before it.
        files: u64,
        /// What the system said.
        source: io::Error,
    },
    /// An image or cloud cannot be made of the frame: exit 1.
    #[error("cannot write {}: {what}; {files} files are kept", .path.display())]
    Encode {
        /// The file.
        path: PathBuf,
        /// Whole files written before it.
        files: u64,
        /// What the encoder said.
        what: String,
    },
    /// Depth or labels are not one per pixel: a fault of the caller.
    #[error(
        "frame {sequence} has {depth} depths and {labels} labels, the camera has {pixels} pixels"
    )]
    FrameSize {
        /// The source's frame number.
        sequence: u64,
        /// Depths there are.
        depth: usize,
        /// Labels there are.
        labels: usize,
        /// Pixels there should be.
        pixels: usize,
    },
    /// No frame came: exit 4, since the input had none.
    #[error("nothing was written to {}: the input gave no frame", .path.display())]
    Empty {
        /// File or folder.
        path: PathBuf,
    },
}
