//! The contact map on the sensor's own ray grid: a label for each pixel.
//!
//! Deviation. The paper's grid is each sphere's own latitude and longitude; ours, for live frames,
//! is the camera's: a pixel is a latitude/longitude of the viewing sphere. No two contacts can
//! fall into one cell, no angle is rounded, and the rebuilt points are a depth image again.

use super::assign::BlockContacts;
use crate::deproject::BLOCK;
use crate::fit::motion::Motion;
use crate::fit::sphere::Sphere;

/// A pixel that holds no measurement.
pub const INVALID: u16 = u16::MAX;
/// A measured pixel that no sphere explains.
pub const NO_SPHERE: u16 = u16::MAX - 1;

/// Which sphere each pixel of a frame touches. A label is a slot of the frame's spheres, [`NO_SPHERE`] or
/// [`INVALID`].
#[derive(Clone, Debug, PartialEq)]
pub enum Contacts {
    /// Of each block of 8×8 pixels, row by row: a label image of frames that come 30 times a second would be
    /// written and read for the sake of blocks that are mostly all one.
    Blocks(Vec<BlockContacts>),
    /// A label a pixel, row-major: of fits that do not divide by blocks.
    Labels(Vec<u16>),
}

impl Default for Contacts {
    fn default() -> Self {
        Self::Labels(Vec::new())
    }
}

impl Contacts {
    /// The label of a pixel in an image `width` pixels wide; beyond the image [`INVALID`].
    #[inline(always)]
    #[must_use]
    pub fn label(&self, width: usize, x: usize, y: usize) -> u16 {
        match self {
            Self::Blocks(blocks) => {
                let k = y / BLOCK * width.div_ceil(BLOCK) + x / BLOCK;
                let block = blocks.get(k).filter(|_| x < width);
                block.map_or(INVALID, |b| b.label(y % BLOCK * BLOCK + x % BLOCK))
            }
            Self::Labels(labels) => {
                let label = labels.get(y * width + x).filter(|_| x < width);
                label.copied().unwrap_or(INVALID)
            }
        }
    }
}

/// One SAINT frame in the sensor domain: spheres with stable ids and the map of who touches which.
#[derive(Clone, Debug, Default)]
pub struct SaintFrame {
    /// Sphere slots; a slot keeps its number from frame to frame while its surface lives.
    pub spheres: Vec<Option<Sphere>>,
    /// Who touches which.
    pub contacts: Contacts,
    /// How the camera moved since the frame before; still where it is not known. Spheres that
    /// stand still in the world have moved by this and are otherwise unchanged to the bit.
    pub motion: Motion,
}

impl SaintFrame {
    /// The label image, row-major, of a frame of `width` by `height` pixels.
    #[must_use]
    pub fn labels(&self, width: usize, height: usize) -> Vec<u16> {
        let rows = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        rows.map(|(x, y)| self.contacts.label(width, x, y))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::assign::PALETTE;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Images of any size, whole and divided blocks, holes: by block and by pixel the same.
        #[test]
        fn every_pixel_has_the_label_of_its_block(
            width in 1usize..90, height in 1usize..20,
            made in prop::collection::vec((any::<u64>(), any::<[u64; PALETTE]>(), 0usize..4), 36),
        ) {
            let (columns, rows) = (width.div_ceil(BLOCK), height.div_ceil(BLOCK));
            let mut blocks = vec![BlockContacts::default(); columns * rows];
            let mut labels = vec![INVALID; width * height];
            for (k, block) in blocks.iter_mut().enumerate() {
                let (on, pixels, kind) = made[k];
                block.missing = [0, u64::MAX, on, on][kind];
                let mut name = |block: &BlockContacts, own: u64, label: u16| {
                    for bit in (0..BLOCK * BLOCK).filter(|bit| own >> bit & 1 != 0) {
                        let (x, y) = (k % columns * BLOCK + bit % BLOCK, k / columns * BLOCK + bit / BLOCK);
                        if x < width && y < height {
                            labels[y * width + x] = label;
                        }
                    }
                    assert_eq!(own & block.missing, 0);
                };
                for p in 0..if kind == 1 { 1 } else { PALETTE } {
                    let own = if kind == 1 { u64::MAX } else { pixels[p] & block.missing };
                    (block.palette[p], block.pixels[p]) = ((10 * k + p) as u16, own);
                    block.missing &= !own;
                    name(block, own, block.palette[p]);
                }
                let missing = std::mem::take(&mut block.missing);
                name(block, missing, NO_SPHERE);
                block.missing = missing;
            }
            let by_block = SaintFrame { contacts: Contacts::Blocks(blocks), ..SaintFrame::default() };
            prop_assert_eq!(&by_block.labels(width, height), &labels);
            prop_assert_eq!(by_block.contacts.label(width, width, 0), INVALID);
            prop_assert_eq!(by_block.contacts.label(width, 0, rows * BLOCK), INVALID);
            let by_pixel = SaintFrame { contacts: Contacts::Labels(labels.clone()), ..SaintFrame::default() };
            prop_assert_eq!(by_pixel.labels(width, height), labels);
            prop_assert_eq!(by_pixel.contacts.label(width, width, 0), INVALID);
        }
    }
}
