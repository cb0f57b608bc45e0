//! ScanNet's `.sens`: a header, then frames of a pose, two times, a colour and a depth image.
//!
//! Layout, little endian (the dataset's `SensorData`, version 4): u32 version, text (u64 length)
//! sensor name, four 4×4 matrices of f32 (intrinsics and extrinsics of colour, then of depth), i32
//! colour and depth compression, u32 colour width and height, depth width and height, f32 depth
//! integers per metre, u64 frames. Frame: 4×4 f32 pose, u64 colour and depth time (µs), u64 bytes
//! of colour and of depth, the two images.

use super::open::unpack_image;
use super::{About, Container, DepthImage, Stamp, Stored, damaged};
use crate::capture::CaptureError;
use crate::capture::sequences::{input, pixel_count};
use crate::frame::Intrinsics;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

const VERSION: u32 = 4;
/// Bytes of a 4×4 matrix.
const MATRIX: usize = 64;
/// Longest sensor name, bytes.
const MAX_NAME: u64 = 4096;

/// A `.sens` file read from its beginning.
pub(super) struct SensImages {
    path: PathBuf,
    file: BufReader<File>,
    /// Bytes not read yet.
    left: u64,
    about: About,
    width: u32,
    height: u32,
    pixels: usize,
    compression: &'static str,
    frames: u64,
    position: u64,
    packed: Vec<u8>,
    scratch: Vec<u8>,
}

impl SensImages {
    /// Reads the header.
    pub(super) fn open(path: &Path) -> Result<Self, CaptureError> {
        let unreadable = |error: std::io::Error| input(path, error.to_string(), "check the file");
        let file = BufReader::new(File::open(path).map_err(unreadable)?);
        let mut sens = Self {
            path: path.to_owned(),
            left: file.get_ref().metadata().map_err(unreadable)?.len(),
            file,
            about: About::default(),
            width: 0,
            height: 0,
            pixels: 0,
            compression: "none",
            frames: 0,
            position: 0,
            packed: Vec::new(),
            scratch: Vec::new(),
        };
        sens.read_header()?;
        Ok(sens)
    }

    fn read_header(&mut self) -> Result<(), CaptureError> {
        let version = self.u32()?;
        if version != VERSION {
            let what = format!("version {version}, but {VERSION} is read");
            return Err(input(
                &self.path,
                what,
                "check that it is a ScanNet .sens file",
            ));
        }
        let length = self.u64()?;
        if length > MAX_NAME {
            return Err(self.damaged(format!("a name of {length} bytes, the limit is {MAX_NAME}")));
        }
        let mut name = vec![0; length as usize];
        self.read(&mut name)?;
        let [_, _, depth, _] = [
            self.matrix()?,
            self.matrix()?,
            self.matrix()?,
            self.matrix()?,
        ];
        let _color_compression = self.u32()?;
        let depth_compression = self.u32()?;
        let _color_size = (self.u32()?, self.u32()?);
        (self.width, self.height) = (self.u32()?, self.u32()?);
        let per_metre = f64::from(f32::from_bits(self.u32()?));
        self.frames = self.u64()?;
        self.compression = match depth_compression {
            0 => "none",
            1 => "zlib",
            other => {
                let what = format!("depth compression {other}, but raw (0) and zlib (1) are read");
                let remedy = "export its depth images as PNG with the dataset's own tools";
                return Err(input(&self.path, what, remedy));
            }
        };
        self.pixels = pixel_count(u64::from(self.width), u64::from(self.height))
            .map_err(|what| self.damaged(what))?;
        let element = |row: usize, column: usize| f64::from(depth[row * 4 + column]);
        let [fx, fy, cx, cy] = [element(0, 0), element(1, 1), element(0, 2), element(1, 2)];
        let seen = [fx, fy, cx, cy].iter().all(|value| value.is_finite());
        if seen && fx > 0.0 && fy > 0.0 {
            self.about.said.intrinsics = Some(Intrinsics { fx, fy, cx, cy });
        }
        if (1.0..=1e6).contains(&per_metre) {
            self.about.said.depth_unit_m = Some(1.0 / per_metre);
        }
        let name = String::from_utf8_lossy(&name).into_owned();
        self.about.said.name = Some(name).filter(|name| !name.is_empty());
        self.about.images = Some(self.frames);
        Ok(())
    }

    fn damaged(&self, what: impl Into<String>) -> CaptureError {
        damaged(&self.path, what)
    }

    /// Fills `bytes`.
    fn read(&mut self, bytes: &mut [u8]) -> Result<(), CaptureError> {
        let needed = bytes.len() as u64;
        let left = self.left;
        if needed > left || self.file.read_exact(bytes).is_err() {
            self.left = 0;
            return Err(self.damaged(format!("cut: {needed} bytes are needed, {left} are left")));
        }
        self.left -= needed;
        Ok(())
    }

    fn u32(&mut self) -> Result<u32, CaptureError> {
        let mut bytes = [0; 4];
        self.read(&mut bytes)?;
        Ok(u32::from_le_bytes(bytes))
    }

    fn u64(&mut self) -> Result<u64, CaptureError> {
        let mut bytes = [0; 8];
        self.read(&mut bytes)?;
        Ok(u64::from_le_bytes(bytes))
    }

    fn matrix(&mut self) -> Result<[f32; 16], CaptureError> {
        let mut bytes = [0; MATRIX];
        self.read(&mut bytes)?;
        let (elements, _) = bytes.as_chunks::<4>();
        let mut matrix = [0.0; 16];
        for (value, bytes) in matrix.iter_mut().zip(elements) {
            *value = f32::from_le_bytes(*bytes);
        }
        Ok(matrix)
    }

    fn skip(&mut self, bytes: u64) -> Result<(), CaptureError> {
        let step = i64::try_from(bytes).ok().filter(|_| bytes <= self.left);
        let moved = step.is_some_and(|step| self.file.seek_relative(step).is_ok());
        if !moved {
            let left = std::mem::take(&mut self.left);
            return Err(self.damaged(format!("cut: {bytes} bytes of colour, {left} are left")));
        }
        self.left -= bytes;
        Ok(())
    }
}

impl Container for SensImages {
    fn about(&self) -> &About {
        &self.about
    }

    fn next(&mut self, image: &mut DepthImage) -> Result<bool, CaptureError> {
        if self.position >= self.frames || self.left == 0 {
            let missing = self.frames - self.position;
            self.position = self.frames;
            return match missing {
                0 => Ok(false),
                _ => Err(self.damaged(format!("cut: {missing} of {} frames miss", self.frames))),
            };
        }
        self.matrix()?;
        let _color_time = self.u64()?;
        let microseconds = self.u64()?;
        let color_bytes = self.u64()?;
        let depth_bytes = self.u64()?;
        self.skip(color_bytes)?;
        // zlib never makes an image much longer than it was
        let most = self.pixels as u64 * 2 + 4096 + self.pixels as u64 / 100;
        if depth_bytes > most {
            self.left = 0;
            let what = format!("a depth image of {depth_bytes} bytes, the limit is {most}");
            return Err(self.damaged(what));
        }
        let mut packed = std::mem::take(&mut self.packed);
        packed.resize(depth_bytes as usize, 0);
        let read = self.read(&mut packed);
        self.packed = packed;
        read?;
        image.number = Some(self.position);
        self.position += 1;
        let (path, pixels) = (&self.path, self.pixels);
        unpack_image(
            path,
            self.compression,
            &self.packed,
            pixels,
            &mut self.scratch,
        )?;
        let (pairs, _) = self.scratch.as_chunks::<2>();
        image.integers.clear();
        image
            .integers
            .extend(pairs.iter().map(|pair| u16::from_le_bytes(*pair)));
        (image.width, image.height, image.stored) = (self.width, self.height, Stored::Integers);
        // recordings without times have zeros
        image.time = match i64::try_from(microseconds)
            .ok()
            .and_then(|us| us.checked_mul(1000))
        {
            Some(ns) if ns > 0 => Stamp::Clock(ns),
            _ => Stamp::Unknown,
        };
        Ok(true)
    }
}
