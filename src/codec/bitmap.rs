//! One bit for each pixel, with a border of zeros: a mask whose neighbourhoods are read as words.
//!
//! A byte holds eight pixels side by side, which are one row of a block, the left one lowest. A VGA mask
//! takes 40 kB and stays in the nearest caches; eight rows of a block are its pixels (bit
//! `8·row + column`).

use crate::deproject::{BLOCK, Rays};

/// Bytes of border on the left and right, and rows above and below.
const SIDE: usize = 4;
const ROWS: usize = 2;

/// Bits over the padded pixel grid.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bitmap {
    /// Bytes from one row to the next.
    stride: usize,
    bytes: Vec<u8>,
}

impl Bitmap {
    /// Makes the bitmap cover `rays`. One that does already keeps its bits: who uses it writes every bit
    /// it reads. A new one is zero.
    pub fn cover(&mut self, rays: &Rays) {
        let stride = rays.block_columns + 2 * SIDE;
        let bytes = stride * (rays.block_rows * BLOCK + 2 * ROWS);
        if self.stride != stride || self.bytes.len() != bytes {
            self.stride = stride;
            self.bytes.clear();
            self.bytes.resize(bytes, 0);
        }
    }

    #[inline(always)]
    fn index(&self, bx: usize, y: usize) -> usize {
        (y + ROWS) * self.stride + SIDE + bx
    }

    /// Row `y` of the blocks of column `bx`.
    #[inline(always)]
    #[must_use]
    pub fn row(&self, bx: usize, y: usize) -> u8 {
        self.bytes[self.index(bx, y)]
    }

    /// Sets bits of row `y` of the blocks of column `bx`.
    #[inline(always)]
    pub fn set(&mut self, bx: usize, y: usize, bits: u8) {
        let at = self.index(bx, y);
        self.bytes[at] |= bits;
    }

    /// All rows of a row of blocks, border excluded: eight lists, a byte for each block.
    pub fn block_row_mut(&mut self, by: usize) -> impl Iterator<Item = &mut [u8]> {
        let start = self.index(0, by * BLOCK) - SIDE;
        let stride = self.stride;
        self.bytes[start..start + BLOCK * stride]
            .chunks_exact_mut(stride)
            .map(move |row| &mut row[SIDE..stride - SIDE])
    }

    /// The pixels of a block (bit `8·row + column`).
    #[inline(always)]
    #[must_use]
    pub fn block(&self, bx: usize, by: usize) -> u64 {
        let start = self.index(bx, by * BLOCK);
        let mut bits = 0;
        for j in 0..BLOCK {
            bits |= u64::from(self.bytes[start + j * self.stride]) << (BLOCK * j);
        }
        bits
    }

    /// Sets the pixels of a block.
    #[inline(always)]
    pub fn set_block(&mut self, bx: usize, by: usize, bits: u64) {
        for (j, row) in bits.to_le_bytes().into_iter().enumerate() {
            self.set(bx, by * BLOCK + j, row);
        }
    }

    /// At least sixteen pixels of row `y − up` from pixel `x − left` on, the first lowest; `up` and
    /// `left` within the border.
    #[inline(always)]
    #[must_use]
    pub fn window(&self, (x, left): (usize, usize), (y, up): (usize, usize)) -> usize {
        let from = x + SIDE * BLOCK - left;
        let start = (y + ROWS - up) * self.stride + from / BLOCK;
        match self.bytes[start..].first_chunk::<4>() {
            Some(word) => u32::from_le_bytes(*word) as usize >> (from % BLOCK),
            None => 0,
        }
    }

    /// The bit of pixel (x, y).
    #[inline(always)]
    #[must_use]
    pub fn get(&self, x: usize, y: usize) -> bool {
        self.row(x / BLOCK, y) >> (x % BLOCK) & 1 != 0
    }
}
