//! Bordered planes: images whose neighbours can be read without asking where the edge is.

use crate::deproject::{BLOCK, Rays};
use rayon::prelude::*;

/// Cells of border on the left and right (also keeps rows aligned) and rows above and below.
const SIDE: usize = 8;
const ROWS: usize = 2;

/// An image over the padded pixel grid with a border of a constant value.
#[derive(Clone, Debug, Default)]
pub struct Plane<T> {
    stride: usize,
    cells: Vec<T>,
}

impl<T: Copy> Plane<T> {
    /// Makes the plane cover `rays`. A plane that does already keeps its cells: who uses it writes
    /// every cell it reads. A new one is filled, border included.
    pub fn cover(&mut self, rays: &Rays, value: T) {
        let stride = rays.stride() + 2 * SIDE;
        let cells = stride * (rays.block_rows * BLOCK + 2 * ROWS);
        if self.stride != stride || self.cells.len() != cells {
            self.stride = stride;
            self.cells.clear();
            self.cells.resize(cells, value);
        }
    }

    /// Writes `value` to all pixels of the block that starts at (x, y).
    #[inline]
    pub fn fill_block(&mut self, x: usize, y: usize, value: T) {
        for j in 0..BLOCK {
            let start = self.index(x, y + j);
            self.cells[start..start + BLOCK].fill(value);
        }
    }

    /// The rows of blocks, to be written side by side.
    pub fn block_rows(&mut self) -> impl IndexedParallelIterator<Item = BlockRow<'_, T>>
    where
        T: Send,
    {
        let stride = self.stride;
        let border = ROWS * stride;
        let inner = self.cells.len().saturating_sub(2 * border);
        let rows = &mut self.cells[border..][..inner];
        rows.par_chunks_exact_mut((BLOCK * stride).max(1))
            .map(move |cells| BlockRow { stride, cells })
    }

    /// Writes the pixels of the block that starts at (x, y), row by row.
    #[inline(always)]
    pub fn write_block(&mut self, x: usize, y: usize, values: &[T; BLOCK * BLOCK]) {
        for (j, row) in values.chunks_exact(BLOCK).enumerate() {
            let start = self.index(x, y + j);
            self.cells[start..start + BLOCK].copy_from_slice(row);
        }
    }

    /// Index of pixel (x, y); neighbours are at ±1 and ±`stride()`.
    #[inline(always)]
    #[must_use]
    pub fn index(&self, x: usize, y: usize) -> usize {
        (y + ROWS) * self.stride + SIDE + x
    }

    /// Cells from one row to the next.
    #[inline(always)]
    #[must_use]
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// All cells, border included.
    #[inline(always)]
    #[must_use]
    pub fn cells(&self) -> &[T] {
        &self.cells
    }

    /// All cells, border included, to write.
    #[inline(always)]
    pub fn cells_mut(&mut self) -> &mut [T] {
        &mut self.cells
    }
}

/// One row of a plane's blocks.
pub struct BlockRow<'a, T> {
    stride: usize,
    cells: &'a mut [T],
}

impl<T: Copy> BlockRow<'_, T> {
    /// Writes the pixels of blocks side by side, the first of which starts at column `x`: a row of all
    /// of them at a time, since a cache line holds the rows of several blocks.
    #[inline(always)]
    pub fn write_blocks(&mut self, x: usize, blocks: &[[T; BLOCK * BLOCK]]) {
        let rows = self.cells.chunks_exact_mut(self.stride);
        for (j, row) in rows.enumerate() {
            let row = row[SIDE + x..][..BLOCK * blocks.len()].as_chunks_mut().0;
            for (row, block) in row.iter_mut().zip(blocks) {
                if let Some(values) = block[j * BLOCK..].first_chunk::<BLOCK>() {
                    *row = *values;
                }
            }
        }
    }
}
