//! Pictures of which only some blocks are written down.

use crate::deproject::{BLOCK, Rays};

/// Values of a block's pixels, row by row.
pub type Tile<T> = [T; BLOCK * BLOCK];

/// No place in the list of tiles.
const NOWHERE: u32 = u32::MAX;

/// Tiles of some blocks, in the order in which they were written: side by side in memory, where the
/// rows of a plane would lie pages apart.
#[derive(Clone, Debug, PartialEq)]
pub struct Tiles<T> {
    /// Of each block.
    place: Vec<u32>,
    tiles: Vec<Tile<T>>,
}

impl<T> Default for Tiles<T> {
    fn default() -> Self {
        Self {
            place: Vec::new(),
            tiles: Vec::new(),
        }
    }
}

impl<T> Tiles<T> {
    /// No tile yet, over `rays`.
    pub fn reset(&mut self, rays: &Rays) {
        self.place.clear();
        self.place.resize(rays.blocks(), NOWHERE);
        self.tiles.clear();
        // room for the worst frame: it does not grow while a stream runs
        self.tiles.reserve(rays.blocks());
    }

    /// The tile of block `k`, if it was written.
    #[inline(always)]
    #[must_use]
    pub fn get(&self, k: usize) -> Option<&Tile<T>> {
        self.tiles.get(self.place[k] as usize)
    }

    /// The same, to change it.
    #[inline(always)]
    #[must_use]
    pub fn get_mut(&mut self, k: usize) -> Option<&mut Tile<T>> {
        self.tiles.get_mut(self.place[k] as usize)
    }

    /// Writes the tile of block `k`, once.
    #[inline(always)]
    pub fn put(&mut self, k: usize, tile: Tile<T>) {
        self.place[k] = self.tiles.len() as u32;
        self.tiles.push(tile);
    }
}
