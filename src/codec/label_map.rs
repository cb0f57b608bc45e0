//! A frame's contact map as it is kept: by blocks, and read by windows.
//!
//! Most blocks have one sphere, so the labels of their pixels are not written down.

use super::surface;
use super::tiles::Tiles;
use crate::contact_map::assign::{EMPTY, PALETTE, Palette};
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::{BLOCK, Rays};

/// A frame's contact map: palettes of blocks and labels of pixels, by sphere number.
#[derive(Clone, Debug, Default)]
pub struct LabelMap {
    /// One for each block; [`NO_SPHERE`] is a palette entry like any other in a block that has
    /// measurements but no sphere.
    pub palettes: Vec<Palette>,
    /// Entries in each palette; 0 for an empty block.
    pub sizes: Vec<u8>,
    /// Of the blocks of several spheres, the labels of their pixels. Those without a measurement hold a
    /// label, too: that of their quad, or the one to their left. The pixels of other blocks are not
    /// written down: they all have the block's one.
    pub tiles: Tiles<u16>,
}

impl LabelMap {
    /// A map over `rays` without any palette.
    pub fn reset(&mut self, rays: &Rays) {
        self.palettes.clear();
        self.palettes.resize(rays.blocks(), EMPTY);
        self.sizes.clear();
        self.sizes.resize(rays.blocks(), 0);
        self.tiles.reset(rays);
    }

    /// The label of a pixel (bit `8·row + column`) of block `k`.
    #[inline(always)]
    #[must_use]
    pub fn label(&self, k: usize, bit: usize) -> u16 {
        self.tiles
            .get(k)
            .map_or(self.palettes[k][0], |tile| tile[bit])
    }

    /// The pixels of block `k` that have a sphere.
    #[inline(always)]
    #[must_use]
    pub fn with_sphere(&self, k: usize) -> u64 {
        let Some(tile) = self.tiles.get(k) else {
            return u64::from(self.palettes[k][0] != NO_SPHERE).wrapping_neg();
        };
        let mut cells = [0u8; BLOCK * BLOCK];
        for (cell, label) in cells.iter_mut().zip(tile) {
            *cell = u8::from(*label != NO_SPHERE);
        }
        surface::packed(&cells)
    }

    /// The labels right above block `k` and to its left, as far as they are decoded; its own are yet
    /// to come.
    #[inline(always)]
    pub(super) fn around(&self, rays: &Rays, k: usize) -> Window {
        let columns = rays.block_columns;
        let (west, north) = (!k.is_multiple_of(columns), k >= columns);
        let east = !(k + 1).is_multiple_of(columns);
        let mut window = Window([NO_SPHERE; WINDOW]);
        let labels = &mut window.0;
        if north {
            let above = k - columns;
            let row = &mut labels[1..=BLOCK];
            match self.tiles.get(above) {
                None => row.fill(self.palettes[above][0]),
                Some(tile) => row.copy_from_slice(&tile[BLOCK * (BLOCK - 1)..]),
            }
            if west {
                labels[0] = self.label(above - 1, BLOCK * BLOCK - 1);
            }
            if east {
                labels[BLOCK + 1] = self.label(above + 1, BLOCK * (BLOCK - 1));
            }
        }
        if west {
            for j in 0..BLOCK {
                labels[Window::at(0, j) - 1] = self.label(k - 1, BLOCK * j + BLOCK - 1);
            }
        }
        window
    }

    /// The labels from pixel (x, y) on, a row and a column more than a block's.
    #[inline(always)]
    pub(super) fn past(&self, rays: &Rays, (x, y): (usize, usize)) -> Window {
        let mut window = Window([NO_SPHERE; WINDOW]);
        let (columns, rows) = (rays.block_columns, rays.block_rows);
        let (right, low) = (x % BLOCK, y % BLOCK);
        for (by, from, to) in [(y / BLOCK, low, BLOCK), (y / BLOCK + 1, 0, low + 1)] {
            for (bx, left, end) in [(x / BLOCK, right, BLOCK), (x / BLOCK + 1, 0, right + 1)] {
                if bx >= columns || by >= rows {
                    continue;
                }
                let k = by * columns + bx;
                let (i, j) = (bx * BLOCK + left - x, by * BLOCK + from - y);
                let tile = self.tiles.get(k);
                for n in 0..to - from {
                    let at = Window::at(i, j + n);
                    let row = &mut window.0[at..at + end - left];
                    match tile {
                        None => row.fill(self.palettes[k][0]),
                        Some(tile) => {
                            let start = (from + n) * BLOCK + left;
                            row.copy_from_slice(&tile[start..start + end - left]);
                        }
                    }
                }
            }
        }
        window
    }
}

/// Cells from one row of a window to the next, and of a window.
pub(super) const STEP: usize = 16;
pub(super) const WINDOW: usize = STEP * (BLOCK + 2);

/// Labels in and around a block.
pub(super) struct Window(pub [u16; WINDOW]);

impl Window {
    /// Cell of the pixel in column `i`, row `j` of the block.
    #[inline(always)]
    pub const fn at(i: usize, j: usize) -> usize {
        (j + 1) * STEP + i + 1
    }

    /// Palette entry of each label, `PALETTE` for one of another block.
    #[inline(always)]
    pub fn ranks(&self, palette: &[u16]) -> [u8; WINDOW] {
        let mut ranks = [PALETTE as u8; WINDOW];
        for (e, id) in palette.iter().enumerate().rev() {
            for (rank, label) in ranks.iter_mut().zip(&self.0) {
                *rank = if label == id { e as u8 } else { *rank };
            }
        }
        ranks
    }
}
