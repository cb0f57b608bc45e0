//! What pixels tell their neighbours about depth, where any of them comes back from a bin.
//!
//! Block by block, and only of the blocks that are not smooth and those beside them: a plane of them all
//! is mostly not looked at and falls out of the caches.

use super::surface::{Depths, to_integer};
use super::tiles::Tiles;
use crate::deproject::{BLOCK, Rays};
use std::ops::Range;

/// What a decoded pixel tells its neighbours.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cell {
    /// Rebuilt depth integer; 0 where nothing was measured.
    pub integer: u16,
    /// Bins from the predicted to its own, at most 255.
    pub error: u8,
    /// Where its depth is a bin's, twice the bins from its sphere's to its own, at most 8 either way (0
    /// without a sphere), plus one; else 0.
    mark: i8,
}

impl Cell {
    /// The cell of a pixel that came back from a bin, `off` bins from its sphere's.
    #[inline(always)]
    #[must_use]
    pub fn of_bin(integer: u16, error: u8, off: i32) -> Self {
        let mark = 2 * off.clamp(-8, 8) + 1;
        Self {
            integer,
            error,
            mark: mark as i8,
        }
    }

    /// True where its depth is a bin's.
    #[inline(always)]
    #[must_use]
    pub const fn is_coded(self) -> bool {
        self.mark & 1 != 0
    }

    /// Bins from its sphere's to its own.
    #[inline(always)]
    #[must_use]
    pub fn off(self) -> i32 {
        i32::from(self.mark >> 1)
    }
}

/// The cells of a frame.
pub type Cells = Tiles<Cell>;

impl Cells {
    /// Cells of block `k`: the integers that its spheres give, `depths`, where `on` is measured.
    #[inline(always)]
    pub fn write(&mut self, k: usize, on: u64, depths: &Depths) {
        let mut tile = [Cell::default(); BLOCK * BLOCK];
        let rows = tile.chunks_exact_mut(BLOCK).zip(depths.chunks_exact(BLOCK));
        for ((cells, depths), on) in rows.zip(on.to_le_bytes()) {
            for (i, (cell, &depth)) in cells.iter_mut().zip(depths).enumerate() {
                let on = u16::from(on >> i & 1).wrapping_neg();
                cell.integer = to_integer(depth) & on;
            }
        }
        self.put(k, tile);
    }

    /// Cell of row `j`, column `i` of block `k`, if that is `there`.
    #[inline(always)]
    fn cell(&self, there: bool, k: usize, i: usize, j: usize) -> Cell {
        match there.then(|| self.get(k)).flatten() {
            Some(tile) => tile[j * BLOCK + i],
            None => Cell::default(),
        }
    }

    /// Row `j` of block `k`, if that is `there`.
    #[inline(always)]
    fn row(&self, there: bool, k: usize, j: usize) -> [Cell; BLOCK] {
        let tile = there.then(|| self.get(k)).flatten();
        match tile.and_then(|tile| tile[j * BLOCK..].first_chunk()) {
            Some(row) => *row,
            None => [Cell::default(); BLOCK],
        }
    }

    /// The `rows` of block `k` and what was decoded around them: above and to the left, and to the right
    /// above the first of them. What lies elsewhere looks as if nothing was measured there.
    #[inline(always)]
    #[must_use]
    pub fn around(&self, rays: &Rays, k: usize, rows: Range<usize>) -> Window {
        let columns = rays.block_columns;
        let (west, north) = (!k.is_multiple_of(columns), k >= columns);
        let east = !(k + 1).is_multiple_of(columns);
        let up = k.wrapping_sub(columns);
        let mut window = Window {
            first: rows.start,
            cells: [Cell::default(); WINDOW],
        };
        let lines = window.cells.chunks_exact_mut(STEP);
        for (n, line) in lines.take(rows.len() + 2).enumerate() {
            // of this row of blocks or the one above
            let (there, k, j) = match (rows.start + n).checked_sub(2) {
                Some(j) => (true, k, j),
                None => (north, up, BLOCK + rows.start + n - 2),
            };
            line[2..BLOCK + 2].copy_from_slice(&self.row(there, k, j));
            line[0] = self.cell(there && west, k.wrapping_sub(1), BLOCK - 2, j);
            line[1] = self.cell(there && west, k.wrapping_sub(1), BLOCK - 1, j);
            if n == 1 {
                line[BLOCK + 2] = self.cell(there && east, k.wrapping_add(1), 0, j);
            }
        }
        window
    }

    /// Keeps row `j` of block `k` as it is in `window`.
    #[inline(always)]
    pub fn keep(&mut self, k: usize, j: usize, window: &Window) {
        let start = window.at(0, j);
        if let Some(tile) = self.get_mut(k) {
            tile[j * BLOCK..][..BLOCK].copy_from_slice(&window.cells[start..start + BLOCK]);
        }
    }
}

/// Cells from one row of a window to the next, and of a window.
const STEP: usize = 12;
const WINDOW: usize = STEP * (BLOCK + 2);

/// Rows of a block and their surroundings.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    /// The first row that is whole.
    first: usize,
    cells: [Cell; WINDOW],
}

/// The cells that were decoded around a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Neighbours {
    /// To the left, and two to the left.
    pub west: [Cell; 2],
    /// Above, and two above.
    pub north: [Cell; 2],
    /// Above to the left.
    pub north_west: Cell,
    /// Above to the right.
    pub north_east: Cell,
}

impl Window {
    #[inline(always)]
    const fn at(&self, i: usize, j: usize) -> usize {
        (j - self.first + 2) * STEP + i + 2
    }

    /// Around column `i` of row `j`.
    #[inline(always)]
    #[must_use]
    pub fn neighbours(&self, i: usize, j: usize) -> Neighbours {
        let (at, cells) = (self.at(i, j), &self.cells);
        Neighbours {
            west: [cells[at - 1], cells[at - 2]],
            north: [cells[at - STEP], cells[at - 2 * STEP]],
            north_west: cells[at - STEP - 1],
            north_east: cells[at - STEP + 1],
        }
    }

    /// Writes the cell of column `i`, row `j`.
    #[inline(always)]
    pub fn set(&mut self, i: usize, j: usize, cell: Cell) {
        let at = self.at(i, j);
        self.cells[at] = cell;
    }
}
