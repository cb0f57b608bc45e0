//! The points of a cloud that no sphere explains yet.

use super::block_set::{self, BlockSet};

/// Points still to be explained.
#[derive(Clone, Debug, Default)]
pub(crate) struct Remaining {
    /// Their places, ascending.
    places: Vec<u32>,
    /// The same, a bit for each point of the cloud.
    words: Vec<u64>,
}

impl Remaining {
    /// All of a cloud of `n` points.
    pub fn refill(&mut self, n: usize) {
        self.places.clear();
        self.places.extend(0..n as u32);
        block_set::full(n, &mut self.words);
    }

    pub fn len(&self) -> usize {
        self.places.len()
    }

    pub fn places(&self) -> &[u32] {
        &self.places
    }

    /// Leaves in the set what remains.
    pub fn keep(&self, set: &mut BlockSet) {
        set.blocks.retain_mut(|(block, bits)| {
            *bits &= self.words[*block as usize];
            *bits != 0
        });
    }

    /// Takes these points out; says how many of them were there.
    pub fn remove(&mut self, touching: &BlockSet) -> usize {
        let before = self.places.len();
        for &(block, bits) in &touching.blocks {
            self.words[block as usize] &= !bits;
        }
        self.places.clear();
        for (block, &bits) in (0u32..).zip(&self.words) {
            block_set::list_bits(block, bits, &mut self.places);
        }
        before - self.places.len()
    }
}
