//! Where exported frames go: one file each into a folder, or one file.

use super::color::Rgb;
use super::union::{self, View};
use super::{ExportCloud, ExportError, ExportFrame, exr, npz, pcd, ply, png, png16};
use crate::capture::CaptureError;
use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// What a frame is exported to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Points: binary PLY with colour and sphere number.
    Ply,
    /// Spheres: binary PLY with centre and radius.
    Spheres,
    /// Points: binary PCD.
    Pcd,
    /// Depth: EXR, metres.
    Exr,
    /// A picture coloured by sphere.
    Png,
    /// Depth: 16-bit PNG in the sensor's unit.
    Png16,
    /// Points with normals and features: NumPy arrays.
    Npz,
}

impl Format {
    /// All formats, as the command line names them.
    pub const NAMES: [(&'static str, Self); 7] = [
        ("ply", Self::Ply),
        ("spheres", Self::Spheres),
        ("pcd", Self::Pcd),
        ("exr", Self::Exr),
        ("png", Self::Png),
        ("png16", Self::Png16),
        ("npz", Self::Npz),
    ];

    /// Whether a frame of points without a grid can be written.
    ///
    /// # Errors
    /// [`ExportError::NoGrid`] for formats that are images.
    pub fn check_cloud(self, sequence: u64) -> Result<(), ExportError> {
        match self {
            Self::Ply | Self::Spheres | Self::Pcd | Self::Npz => Ok(()),
            Self::Exr | Self::Png | Self::Png16 => Err(ExportError::NoGrid {
                sequence,
                format: self.name(),
            }),
        }
    }

    /// Whether the frames of several cameras can be written together.
    ///
    /// # Errors
    /// [`ExportError::NoUnion`] for formats of one camera.
    pub fn check_union(self) -> Result<(), ExportError> {
        match self {
            Self::Ply | Self::Spheres => Ok(()),
            _ => Err(ExportError::NoUnion {
                format: self.name(),
            }),
        }
    }

    fn name(self) -> &'static str {
        let found = Self::NAMES.iter().find(|(_, format)| *format == self);
        found.map_or("an image", |(name, _)| name)
    }

    /// Ending of its files.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Ply | Self::Spheres => "ply",
            Self::Pcd => "pcd",
            Self::Exr => "exr",
            Self::Png | Self::Png16 => "png",
            Self::Npz => "npz",
        }
    }
}

impl FromStr for Format {
    type Err = ExportError;

    fn from_str(name: &str) -> Result<Self, ExportError> {
        let known = Self::NAMES
            .iter()
            .find(|(n, _)| n.eq_ignore_ascii_case(name));
        known
            .map(|(_, format)| *format)
            .ok_or_else(|| ExportError::UnknownFormat(name.to_owned()))
    }
}

/// Where the files go.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Output {
    /// One file for the one frame that comes.
    File(PathBuf),
    /// `000000.ext`, `000001.ext`, … in this folder, which is made where it is missing.
    Folder(PathBuf),
}

impl Output {
    /// Its path.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Self::File(path) | Self::Folder(path) => path,
        }
    }
}

/// What an export has written.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct ExportSummary {
    /// File or folder.
    pub path: String,
    /// Files, `camera.json` not counted.
    pub files: u64,
    /// Their bytes.
    pub bytes: u64,
}

/// Writes frames as files.
pub struct FileSequence {
    format: Format,
    output: Output,
    overwrite: bool,
    files: u64,
    bytes: u64,
    buffer: Vec<u8>,
}

impl FileSequence {
    /// Prepares the output. With `overwrite`, numbered files of this format that an earlier
    /// export left in the folder are removed, so that two exports never mix; other files stay.
    ///
    /// # Errors
    /// [`ExportError::Exists`] for a file, or a folder that is not empty; [`ExportError::Write`]
    /// where the folder cannot be made or read.
    pub fn create(format: Format, output: Output, overwrite: bool) -> Result<Self, ExportError> {
        match &output {
            Output::File(path) if path.exists() && !overwrite => {
                return Err(exists(path, false));
            }
            Output::File(_) => {}
            Output::Folder(folder) if folder.exists() && !folder.is_dir() => {
                return Err(write_error(
                    folder,
                    0,
                    io::Error::from(io::ErrorKind::NotADirectory),
                ));
            }
            Output::Folder(folder) => prepare(folder, format, overwrite)
                .map_err(|source| write_error(folder, 0, source))?,
        }
        if let Output::Folder(folder) = &output
            && !overwrite
            && fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some())
        {
            return Err(exists(folder, true));
        }
        Ok(Self {
            format,
            output,
            overwrite,
            files: 0,
            bytes: 0,
            buffer: Vec::new(),
        })
    }

    /// Writes one frame; `number` names its file (the frame's place in the recording).
    ///
    /// # Errors
    /// [`ExportError::SingleFile`], [`ExportError::FrameSize`], [`ExportError::Exists`], or what
    /// went wrong on writing; a file that was begun is removed.
    pub fn frame(&mut self, frame: &ExportFrame<'_>, number: u64) -> Result<(), ExportError> {
        frame.check()?;
        let path = self.place(number)?;
        let size = self.write(frame, &path)?;
        self.files += 1;
        self.bytes += size;
        Ok(())
    }

    /// Writes one frame of points without a grid, as [`FileSequence::frame`] does.
    ///
    /// # Errors
    /// [`ExportError::NoGrid`] for formats that are images, and as [`FileSequence::frame`].
    pub fn cloud(&mut self, cloud: &ExportCloud<'_>, number: u64) -> Result<(), ExportError> {
        self.format.check_cloud(cloud.sequence)?;
        let path = self.place(number)?;
        let buffer = &mut self.buffer;
        match self.format {
            Format::Spheres => ply::cloud_spheres(cloud, buffer),
            Format::Pcd => {
                pcd::cloud_points(cloud, buffer).map_err(|what| self.encode_error(&path, what))?
            }
            Format::Npz => {
                npz::cloud_points(cloud, buffer).map_err(|what| self.encode_error(&path, what))?
            }
            _ => ply::cloud_points(cloud, buffer),
        }
        self.put(&path)
    }

    /// Writes one frame as points in the colours given, one per pixel; for other formats than
    /// [`Format::Ply`] as [`FileSequence::frame`] does.
    ///
    /// # Errors
    /// As [`FileSequence::frame`].
    pub fn painted(
        &mut self,
        frame: &ExportFrame<'_>,
        colors: &[Rgb],
        number: u64,
    ) -> Result<(), ExportError> {
        if self.format != Format::Ply || colors.len() != frame.depth_m.len() {
            return self.frame(frame, number);
        }
        frame.check()?;
        let path = self.place(number)?;
        ply::painted_points(frame, colors, &mut self.buffer);
        self.put(&path)
    }

    /// Writes the frames of several cameras, in their common frame.
    ///
    /// # Errors
    /// [`ExportError::NoUnion`] for formats of one camera, and as [`FileSequence::frame`].
    pub fn union(&mut self, views: &[View<'_>], number: u64) -> Result<(), ExportError> {
        self.format.check_union()?;
        for view in views {
            view.check()?;
        }
        let path = self.place(number)?;
        match self.format {
            Format::Spheres => union::spheres(views, &mut self.buffer),
            _ => union::points(views, &mut self.buffer),
        }
        self.put(&path)
    }

    /// Writes the file that stands in the buffer.
    fn put(&mut self, path: &Path) -> Result<(), ExportError> {
        put(path, &self.buffer, self.overwrite)
            .map_err(|source| write_error(path, self.files, source))?;
        self.files += 1;
        self.bytes += self.buffer.len() as u64;
        Ok(())
    }

    /// Path of the next file.
    fn place(&self, number: u64) -> Result<PathBuf, ExportError> {
        let path = match &self.output {
            Output::File(path) if self.files > 0 => {
                return Err(ExportError::SingleFile { path: path.clone() });
            }
            Output::File(path) => path.clone(),
            Output::Folder(folder) => {
                folder.join(format!("{number:06}.{}", self.format.extension()))
            }
        };
        if !self.overwrite && path.exists() {
            return Err(exists(&path, false));
        }
        Ok(path)
    }

    /// Ends the export.
    ///
    /// # Errors
    /// [`ExportError::Empty`] where no frame came.
    pub fn finish(self) -> Result<ExportSummary, ExportError> {
        let path = self.output.path().to_owned();
        if self.files == 0 {
            return Err(ExportError::Empty { path });
        }
        Ok(ExportSummary {
            path: path.display().to_string(),
            files: self.files,
            bytes: self.bytes,
        })
    }

    /// Files written so far.
    #[must_use]
    pub fn files(&self) -> u64 {
        self.files
    }

    fn write(&mut self, frame: &ExportFrame<'_>, path: &Path) -> Result<u64, ExportError> {
        let buffer = &mut self.buffer;
        let encoded = match self.format {
            Format::Ply => {
                ply::points(frame, buffer);
                Ok(())
            }
            Format::Spheres => {
                ply::spheres(frame, buffer);
                Ok(())
            }
            Format::Pcd => pcd::points(frame, buffer),
            Format::Npz => npz::points(frame, buffer),
            Format::Png => png::picture(frame, buffer),
            Format::Exr => return self.image(frame, path, exr::depth),
            Format::Png16 => {
                if self.files == 0 {
                    self.camera(frame, path)?;
                }
                return self.image(frame, path, png16::depth);
            }
        };
        encoded.map_err(|what| self.encode_error(path, what))?;
        let written = put(path, &self.buffer, self.overwrite);
        written.map_err(|source| write_error(path, self.files, source))?;
        Ok(self.buffer.len() as u64)
    }

    /// Depth images are written by the code that reads them.
    fn image(
        &self,
        frame: &ExportFrame<'_>,
        path: &Path,
        write: impl Fn(&ExportFrame<'_>, &Path) -> Result<(), CaptureError>,
    ) -> Result<u64, ExportError> {
        let written = write(frame, path);
        written.map_err(|e| {
            let _ = fs::remove_file(path);
            self.encode_error(path, plain(e))
        })?;
        let facts = fs::metadata(path).map_err(|source| write_error(path, self.files, source))?;
        Ok(facts.len())
    }

    /// `camera.json`, without which the images have no scale.
    fn camera(&self, frame: &ExportFrame<'_>, image: &Path) -> Result<(), ExportError> {
        let folder = match image.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let path = folder.join("camera.json");
        if !self.overwrite && path.exists() {
            return Err(exists(&path, false));
        }
        png16::camera(folder, frame.camera).map_err(|e| self.encode_error(&path, plain(e)))
    }

    fn encode_error(&self, path: &Path, what: String) -> ExportError {
        ExportError::Encode {
            path: path.to_owned(),
            files: self.files,
            what,
        }
    }
}

/// What an image writer said, without the path it repeats.
fn plain(error: CaptureError) -> String {
    match error {
        CaptureError::Input { what, .. } => what,
        other => other.to_string(),
    }
}

fn exists(path: &Path, folder: bool) -> ExportError {
    ExportError::Exists {
        path: path.to_owned(),
        folder,
    }
}

fn write_error(path: &Path, files: u64, source: io::Error) -> ExportError {
    ExportError::Write {
        path: path.to_owned(),
        files,
        source,
    }
}

/// Makes the folder; with `overwrite` removes the numbered files of this format in it.
fn prepare(folder: &Path, format: Format, overwrite: bool) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    if !overwrite {
        return Ok(());
    }
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let numbered = path
            .file_stem()
            .and_then(|stem| stem.to_str())
            .is_some_and(|stem| stem.len() >= 6 && stem.bytes().all(|b| b.is_ascii_digit()));
        if numbered && path.extension().is_some_and(|e| e == format.extension()) {
            fs::remove_file(path)?;
        }
    }
    Ok(())
}

/// Writes a whole file, or leaves none.
fn put(path: &Path, bytes: &[u8], overwrite: bool) -> io::Result<()> {
    let mut options = OpenOptions::new();
    options.write(true);
    if overwrite {
        options.create(true).truncate(true);
    } else {
        options.create_new(true);
    }
    let mut file = options.open(path)?;
    file.write_all(bytes).inspect_err(|_| {
        if file.metadata().is_ok_and(|m| m.is_file()) {
            let _ = fs::remove_file(path);
        }
    })
}
