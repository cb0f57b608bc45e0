//! Bordered planes: images whose neighbours can be read without asking where the edge is.

use crate::deproject::{BLOCK, Rays};

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
    /// Makes the plane cover `rays` and fills it, border included.
    pub fn reset(&mut self, rays: &Rays, value: T) {
        self.stride = rays.stride() + 2 * SIDE;
        let cells = self.stride * (rays.block_rows * BLOCK + 2 * ROWS);
        self.cells.clear();
        self.cells.resize(cells, value);
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
