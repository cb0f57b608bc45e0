//! The encoder's choice of labels: fewest bits among the spheres a pixel touches.
//!
//! The fit gives a block its spheres. Which of them a pixel gets is a matter of bits as long as it
//! touches: a boundary between two spheres that both explain the noise runs where it costs least.

use super::label_map::Choice;
use super::mask::inside;
use super::surface::{self, BEYOND, Depths};
use crate::contact_map::assign::PALETTE;
use crate::contact_map::contact::Reach;
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::{BLOCK, Rays};

/// What an error of the whole reach costs, in 1/16 bit; smaller ones cost by their square.
const ERROR_COST: f32 = 24.0;
/// Bits that a pixel costs that its quad's sphere does not explain, in 1/16 bit.
const MISS_COST: u32 = 12 * 16;
/// Bits that dividing a quad costs beyond saying so, in 1/16 bit.
const DIVISION_COST: u32 = 6 * 16;

/// Chooses labels for one frame and notes which pixels touch the sphere they got.
pub(super) struct Cheapest<'a> {
    rays: &'a Rays,
    plane: &'a [u16],
    reach: &'a Reach,
    measured: &'a [u64],
    /// Touching pixels of each block.
    hits: &'a mut [u64],
    /// Of the block at hand: touching pixels by palette entry, their errors, and no sphere.
    touching: [u64; PALETTE],
    errors: [[u8; BLOCK * BLOCK]; PALETTE],
}

impl<'a> Cheapest<'a> {
    /// Choices for the frame `plane` (padded); `hits` has an entry for each block.
    pub fn new(
        rays: &'a Rays,
        plane: &'a [u16],
        reach: &'a Reach,
        measured: &'a [u64],
        hits: &'a mut [u64],
    ) -> Self {
        Self {
            rays,
            plane,
            reach,
            measured,
            hits,
            touching: [0; PALETTE],
            errors: [[0; BLOCK * BLOCK]; PALETTE],
        }
    }

    /// What giving entry `e` to `pixels` costs beyond its bits.
    #[inline(always)]
    fn price(&self, e: usize, pixels: u64, explained: u64) -> u32 {
        let missed = pixels & explained & !self.touching[e];
        let mut price = missed.count_ones() * MISS_COST;
        let mut left = pixels & self.touching[e];
        while left != 0 {
            price += u32::from(self.errors[e][left.trailing_zeros() as usize]);
            left &= left - 1;
        }
        price
    }
}

impl Choice for Cheapest<'_> {
    #[inline(always)]
    fn block(&mut self, k: usize, palette: &[u16], depths: &[Depths; PALETTE]) {
        let rays = self.rays;
        let (x0, y0) = (
            k % rays.block_columns * BLOCK,
            k / rays.block_columns * BLOCK,
        );
        let measured = self.measured[k];
        self.hits[k] = 0;
        let alone = palette.len() == 1;
        for (e, &id) in palette.iter().enumerate() {
            self.touching[e] = 0;
            if id == NO_SPHERE {
                continue;
            }
            let Some(u) = rays.u[x0..].first_chunk::<BLOCK>() else {
                return;
            };
            let mut on = [0u8; BLOCK * BLOCK];
            for j in 0..BLOCK {
                let v = rays.v[y0 + j];
                let Some(raw) = self.plane[(y0 + j) * rays.stride() + x0..].first_chunk::<BLOCK>()
                else {
                    return;
                };
                for i in 0..BLOCK {
                    let q = u[i] * u[i] + v * v + 1.0;
                    let d = depths[e][j * BLOCK + i];
                    // the decoder rebuilds other depths from integers
                    let real = (d > 0.0) & (d < BEYOND);
                    let raw = f32::from(raw[i]);
                    on[j * BLOCK + i] = u8::from(self.reach.touches(raw, d, q) & real);
                    if !alone {
                        let reach = self.reach.at(raw);
                        let share = (raw - d) * (raw - d) * q / (reach * reach);
                        self.errors[e][j * BLOCK + i] = (share * ERROR_COST) as u8;
                    }
                }
            }
            self.touching[e] = surface::packed(&on) & measured;
        }
    }

    #[inline(always)]
    fn quad(&mut self, pixels: u64, costs: &[u32], division: u32) -> Option<usize> {
        let touching = &self.touching[..costs.len()];
        let explained = touching.iter().fold(0, |all, t| all | t) & pixels;
        let (mut best, mut least) = (0, u32::MAX);
        for (e, &cost) in costs.iter().enumerate() {
            let price = cost + self.price(e, pixels, explained);
            if price < least {
                (best, least) = (e, price);
            }
        }
        let mut each = 0;
        let mut left = explained;
        while left != 0 {
            let i = left.trailing_zeros() as usize;
            let error = |e: usize| match touching[e] >> i & 1 {
                0 => u32::MAX,
                _ => u32::from(self.errors[e][i]),
            };
            each += (0..costs.len()).map(error).min().unwrap_or(0);
            left &= left - 1;
        }
        (least <= division + each + DIVISION_COST + pixels.count_ones() * 4).then_some(best)
    }

    #[inline(always)]
    fn pixel(&mut self, bit: u32, costs: &[u32]) -> usize {
        let touches = |e: usize| self.touching[e] >> bit & 1 != 0;
        let any = (0..costs.len()).any(touches);
        let price = |e: usize| {
            costs[e]
                + match (touches(e), any) {
                    (true, _) => u32::from(self.errors[e][bit as usize]),
                    (false, true) => MISS_COST,
                    _ => 0,
                }
        };
        (0..costs.len()).min_by_key(|&e| price(e)).unwrap_or(0)
    }

    #[inline(always)]
    fn given(&mut self, k: usize, pixels: u64, entry: usize) {
        self.hits[k] |= pixels & self.touching[entry] & inside(self.rays, k);
    }
}
