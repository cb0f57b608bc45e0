//! Depth integers to rays and metres: the one place where the unit enters.
//!
//! A pixel (x, y) looks along `r = (u, v, 1)`, `u = (x − cx)/fx`, `v = (y − cy)/fy`; its point is
//! `z·r`. Everything after this stage works on inverse depth `w = 1/z`, where the noise of stereo
//! and structured light is uniform and a sphere is linear in its parameters (`fit::sphere`).

use crate::frame::{Camera, DepthFrame};
use glam::DVec3;

/// Pixels along one side of a block, the tile in which all image passes work.
pub const BLOCK: usize = 8;

/// The ray grid of a camera, padded to whole blocks.
#[derive(Clone, Debug)]
pub struct Rays {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Blocks per row.
    pub block_columns: usize,
    /// Block rows.
    pub block_rows: usize,
    /// `u` of each column, `block_columns * 8` of them.
    pub u: Vec<f32>,
    /// `v` of each row, `block_rows * 8` of them.
    pub v: Vec<f32>,
    /// Metres per depth integer.
    pub unit: f32,
    /// Depth integers per metre.
    pub per_metre: f32,
}

impl Rays {
    /// The ray grid of `camera`.
    #[must_use]
    pub fn new(camera: &Camera) -> Self {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let (block_columns, block_rows) = (width.div_ceil(BLOCK), height.div_ceil(BLOCK));
        let i = &camera.intrinsics;
        Self {
            width,
            height,
            block_columns,
            block_rows,
            u: (0..block_columns * BLOCK)
                .map(|x| ((x as f64 - i.cx) / i.fx) as f32)
                .collect(),
            v: (0..block_rows * BLOCK)
                .map(|y| ((y as f64 - i.cy) / i.fy) as f32)
                .collect(),
            unit: camera.depth_unit_m as f32,
            per_metre: (1.0 / camera.depth_unit_m) as f32,
        }
    }

    /// Padded columns: the stride of every padded plane.
    #[must_use]
    pub fn stride(&self) -> usize {
        self.block_columns * BLOCK
    }

    /// Pixels of a padded plane.
    #[must_use]
    pub fn padded(&self) -> usize {
        self.stride() * self.block_rows * BLOCK
    }

    /// Number of blocks.
    #[must_use]
    pub fn blocks(&self) -> usize {
        self.block_columns * self.block_rows
    }

    /// The point at planar depth `z` metres under pixel (x, y).
    #[must_use]
    pub fn point(&self, x: usize, y: usize, z: f64) -> DVec3 {
        DVec3::new(f64::from(self.u[x]) * z, f64::from(self.v[y]) * z, z)
    }
}

/// Which depth integers are measurements (`Camera::invalid`, `depth_min_m`, `depth_max_m`).
#[derive(Clone, Debug)]
pub struct Validity {
    low: u16,
    high: u16,
    codes: Vec<u16>,
}

impl Validity {
    /// The rule of `camera`.
    #[must_use]
    pub fn new(camera: &Camera) -> Self {
        let unit = camera.depth_unit_m;
        // a hair of slack, so that a limit written in decimals includes the integer it names
        let low = (camera.depth_min_m / unit - 1e-6)
            .ceil()
            .clamp(1.0, 65535.0) as u16;
        let high = (camera.depth_max_m / unit + 1e-6)
            .floor()
            .clamp(0.0, 65535.0) as u16;
        let codes = camera
            .invalid
            .iter()
            .copied()
            .filter(|c| (low..=high).contains(c))
            .collect();
        Self { low, high, codes }
    }

    /// True where `raw` is a measurement.
    #[inline]
    #[must_use]
    pub fn accepts(&self, raw: u16) -> bool {
        raw >= self.low && raw <= self.high && !self.codes.contains(&raw)
    }

    /// Copies a frame into a plane padded to whole blocks (`rays.padded()` values), 0 where there
    /// is no measurement. Returns the number of measurements.
    ///
    /// # Panics
    /// Where the frame does not have `width * height` pixels: sources guarantee it.
    pub fn clean(&self, rays: &Rays, frame: &DepthFrame, plane: &mut Vec<u16>) -> usize {
        assert_eq!(frame.depth.len(), rays.width * rays.height);
        plane.resize(rays.padded(), 0);
        self.clean_rows(rays, &frame.depth, plane)
    }

    /// [`clean`](Self::clean) for some rows of a frame and those of the plane they go to.
    pub fn clean_rows(&self, rays: &Rays, depth: &[u16], plane: &mut [u16]) -> usize {
        let mut count = 0;
        for (row, out) in depth
            .chunks_exact(rays.width)
            .zip(plane.chunks_exact_mut(rays.stride()))
        {
            count += self.clean_row(row, &mut out[..rays.width]);
        }
        count
    }

    fn clean_row(&self, row: &[u16], out: &mut [u16]) -> usize {
        let mut count = keep_between(row, out, self.low, self.high);
        for &code in &self.codes {
            for o in out.iter_mut() {
                if *o == code {
                    *o = 0;
                    count -= 1;
                }
            }
        }
        count
    }
}

/// Copies what lies between `low` and `high`, 0 for the rest; counts what was kept.
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn keep_between(row: &[u16], out: &mut [u16], low: u16, high: u16) -> usize {
    let mut count = 0u32;
    for (o, &raw) in out.iter_mut().zip(row) {
        let keep = (raw >= low) & (raw <= high);
        *o = if keep { raw } else { 0 };
        count += u32::from(keep);
    }
    count as usize
}
