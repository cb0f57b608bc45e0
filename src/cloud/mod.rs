//! Static clouds: files of points, read into metres.
//!
//! | file | read |
//! |---|---|
//! | PLY | element `vertex`, properties `x y z` of any number type; ASCII, both binary orders |
//! | PCD | fields `x y z` of any number type; ASCII, binary, compressed |
//! | OBJ | `v` lines, all other lines passed over |
//! | XYZ, TXT, CSV, ASC, PTS | a point a line, its first three numbers; `#` and `//` begin a comment |
//! | NPY | an array of numbers whose last axis has at least three entries: x, y, z, … |
//!
//! PLY, PCD and NPY are known by their first bytes, the others by the name's ending. Coordinates
//! stay f64 until [`LocalPoints`](crate::partition::points::LocalPoints) puts them about a local
//! origin. Every count in a file is checked against its length before memory is taken.

mod npy;
mod number;
mod pcd;
mod ply;
#[cfg(test)]
mod tests;
mod text;
mod unit;

pub use unit::{LengthUnit, UnknownUnit};

use glam::DVec3;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// Kind of a cloud file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CloudFormat {
    /// Polygon file format.
    Ply,
    /// Point cloud library.
    Pcd,
    /// Wavefront.
    Obj,
    /// A point a line.
    Xyz,
    /// NumPy array.
    Npy,
}

impl CloudFormat {
    const ENDINGS: [(&'static str, Self); 9] = [
        ("ply", Self::Ply),
        ("pcd", Self::Pcd),
        ("obj", Self::Obj),
        ("npy", Self::Npy),
        ("xyz", Self::Xyz),
        ("txt", Self::Xyz),
        ("csv", Self::Xyz),
        ("asc", Self::Xyz),
        ("pts", Self::Xyz),
    ];

    /// The kind that a file's name announces.
    #[must_use]
    pub fn named(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_str()?;
        let known = Self::ENDINGS
            .iter()
            .find(|(name, _)| name.eq_ignore_ascii_case(ending));
        known.map(|(_, format)| *format)
    }

    /// The kind of a file, by its first bytes and then by its name's ending.
    fn of(path: &Path, bytes: &[u8]) -> Option<Self> {
        if bytes.starts_with(npy::MAGIC) {
            return Some(Self::Npy);
        }
        if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r\n") {
            return Some(Self::Ply);
        }
        if bytes.starts_with(b"# .PCD") {
            return Some(Self::Pcd);
        }
        Self::named(path)
    }
}

impl fmt::Display for CloudFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ply => "PLY",
            Self::Pcd => "PCD",
            Self::Obj => "OBJ",
            Self::Xyz => "XYZ",
            Self::Npy => "NPY",
        })
    }
}

/// A cloud as its file has it.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    /// Positions in the file's unit, in the file's order; non-finite ones included.
    pub positions: Vec<DVec3>,
    /// Kind of the file.
    pub format: CloudFormat,
    /// The unit the file states: a comment `unit mm` of a PLY file.
    pub stated_unit: Option<LengthUnit>,
}

/// Why a cloud cannot be read: always the input's fault.
#[derive(Debug, thiserror::Error)]
pub enum CloudError {
    /// The file cannot be opened or read.
    #[error("cannot read {}: {source}; check the path and its permissions", .path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// No kind of file that is known.
    #[error("{}: is of no kind known here; give a .ply, .pcd, .obj, .xyz (.txt, .csv, .asc, .pts) or .npy file", .path.display())]
    Unknown {
        /// The file.
        path: PathBuf,
    },
    /// The bytes contradict the format.
    #[error("{}: is no whole {format} file: {what}; export the cloud again", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What it should be.
        format: CloudFormat,
        /// What is wrong.
        what: String,
    },
    /// There is nothing to model.
    #[error("{}: holds {points} points{}; a surface needs at least 5 that do not lie on one line", .path.display(), why(*.usable, *.points))]
    NoSurface {
        /// The file.
        path: PathBuf,
        /// Points in the file.
        points: usize,
        /// Points that are finite.
        usable: usize,
    },
}

fn why(usable: usize, points: usize) -> String {
    match (usable, points) {
        (0..5, 0..5) => String::new(),
        (0..5, _) => format!(", of which {usable} are finite"),
        _ => " in one place or on one line".to_owned(),
    }
}

impl Cloud {
    /// Reads a file.
    ///
    /// # Errors
    /// The file cannot be read, is of an unknown kind, or damaged. A file without points is no
    /// error here.
    pub fn read(path: &Path) -> Result<Self, CloudError> {
        let bytes = std::fs::read(path).map_err(|source| CloudError::Unreadable {
            path: path.to_owned(),
            source,
        })?;
        let format = CloudFormat::of(path, &bytes).ok_or_else(|| CloudError::Unknown {
            path: path.to_owned(),
        })?;
        Self::parse(&bytes, format).map_err(|what| CloudError::Damaged {
            path: path.to_owned(),
            format,
            what,
        })
    }

    /// Reads bytes of a known kind. Safe on any bytes.
    ///
    /// # Errors
    /// What is wrong with the bytes.
    pub fn parse(bytes: &[u8], format: CloudFormat) -> Result<Self, String> {
        let mut stated_unit = None;
        let positions = match format {
            CloudFormat::Ply => ply::read(bytes, &mut stated_unit),
            CloudFormat::Pcd => pcd::read(bytes),
            CloudFormat::Obj => text::read_obj(bytes),
            CloudFormat::Xyz => text::read_xyz(bytes),
            CloudFormat::Npy => npy::read(bytes),
        }?;
        Ok(Self {
            positions,
            format,
            stated_unit,
        })
    }

    /// The positions in metres.
    #[must_use]
    pub fn into_metres(mut self, unit: LengthUnit) -> Vec<DVec3> {
        let metres = unit.metres();
        if metres != 1.0 {
            for p in &mut self.positions {
                *p *= metres;
            }
        }
        self.positions
    }
}
