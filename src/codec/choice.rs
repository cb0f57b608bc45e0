//! The encoder's choice of labels: fewest bits among the spheres a pixel touches.
//!
//! The fit gives a block its spheres. Which of them a pixel gets is a matter of bits and error: a
//! boundary between two spheres that both explain the noise runs where it costs least.

use super::label_map::LabelMap;
use super::labels::Choice;
use super::mask::{QUAD, extent};
use super::surface::{self, BEYOND, Depths, Surface, Surfaces, is_real, packed, packed_row};
use crate::contact_map::assign::PALETTE;
use crate::contact_map::contact::Reach;
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::{BLOCK, Rays};
use rayon::prelude::*;

/// What an error of the contact distance costs, in 1/16 bit; others cost by their square.
const ERROR_COST: f32 = 8.0;
/// What a pixel costs that its sphere does not give back, in 1/16 bit.
pub(super) const MISS_COST: u16 = 12 * 16;
/// Bits that dividing a quad costs beyond saying so, in 1/16 bit: at all, and for each pixel.
const DIVISION_COST: u32 = 6 * 16;
const DIVISION_PIXEL_COST: u32 = 4;

/// An invented pixel may be by so much nearer or farther than all that was measured in its block.
const ASIDE: f32 = 0.1;

/// Most blocks that are looked at together.
const TOGETHER: usize = 16;

/// Added to a small number, its integer stands in the low bits.
const WHOLE: f32 = 8_388_608.0;

/// What it costs to give a pixel to a sphere, beyond the label's bits.
#[derive(Clone, Copy)]
pub(super) struct Errors<'a> {
    /// Depth integers, padded.
    pub plane: &'a [u16],
    /// The bound.
    pub reach: &'a Reach,
    /// The contact distance.
    pub contact: &'a Reach,
}

impl Errors<'_> {
    /// Prices of block `k`'s pixels for a sphere at `depths`, in 1/16 bit: by the squared error, or
    /// [`MISS_COST`] and no less where it breaks the bound; 0 where nothing was measured.
    #[inline(always)]
    pub fn prices(&self, rays: &Rays, k: usize, depths: &Depths, out: &mut [u16; BLOCK * BLOCK]) {
        let (x0, y0) = (
            k % rays.block_columns * BLOCK,
            k / rays.block_columns * BLOCK,
        );
        let Some(u) = rays.u[x0..].first_chunk::<BLOCK>() else {
            return;
        };
        for j in 0..BLOCK {
            let v = rays.v[y0 + j];
            let raw = self.plane[(y0 + j) * rays.stride() + x0..].first_chunk::<BLOCK>();
            let depths = depths[j * BLOCK..].first_chunk::<BLOCK>();
            let out = out[j * BLOCK..].first_chunk_mut::<BLOCK>();
            let (Some(raw), Some(depths), Some(out)) = (raw, depths, out) else {
                return;
            };
            let mut row = [0u16; BLOCK];
            for i in 0..BLOCK {
                let q = u[i] * u[i] + v * v + 1.0;
                let (d, raw) = (depths[i], f32::from(raw[i]));
                // the decoder rebuilds other depths from integers
                let real = (d > 0.0) & (d < BEYOND);
                let contact = self.contact.at(raw);
                let share = (raw - d) * (raw - d) * q / (contact * contact);
                let price = (share * ERROR_COST).min(f32::from(MISS_COST - 1));
                let hit = self.reach.touches(raw, d, q) & real;
                let price = if hit { price } else { f32::from(MISS_COST) };
                let price = if raw > 0.0 { price } else { 0.0 };
                // an integer by its place behind the point: a cast would take eight times as long
                row[i] = (price + WHOLE).to_bits() as u16;
            }
            *out = row;
        }
    }

    /// Of blocks side by side, from (`bx`, `by`) on, the pixels that [`prices`](Self::prices) would price
    /// as a miss for this sphere; of those that hold no measurement any.
    #[inline(always)]
    fn missed(&self, rays: &Rays, (bx, by): (usize, usize), sphere: &Surface, missed: &mut [u64]) {
        let mut marks = [0u8; TOGETHER * BLOCK];
        let (x0, wide) = (bx * BLOCK, missed.len() * BLOCK);
        let (u, marks) = (&rays.u[x0..x0 + wide], &mut marks[..wide]);
        for j in 0..BLOCK {
            let v = rays.v[by * BLOCK + j];
            let raw = &self.plane[(by * BLOCK + j) * rays.stride() + x0..][..wide];
            for ((mark, &raw), &u) in marks.iter_mut().zip(raw).zip(u) {
                let (d, raw) = (sphere.depth(u, v), f32::from(raw));
                let touches = self.reach.touches(raw, d, u * u + v * v + 1.0);
                *mark = u8::from(!(touches & is_real(d)));
            }
            for (missed, marks) in missed.iter_mut().zip(marks.as_chunks().0) {
                *missed |= packed_row(marks) << (BLOCK * j);
            }
        }
    }
}

/// Chooses labels for one frame.
pub(super) struct Cheapest<'a> {
    rays: &'a Rays,
    errors: Errors<'a>,
    measured: &'a [u64],
    /// Pixels that the payload has and the sensor has not: any depth near those around will do. None
    /// where it is empty.
    invented: &'a [u64],
    /// Of the block at hand, by palette entry: prices, and the pixels whose price is a miss's.
    prices: [[u16; BLOCK * BLOCK]; PALETTE],
    missed: [u64; PALETTE],
}

impl<'a> Cheapest<'a> {
    /// Choices for one frame.
    pub fn new(
        rays: &'a Rays,
        errors: Errors<'a>,
        (measured, invented): (&'a [u64], &'a [u64]),
    ) -> Self {
        Self {
            rays,
            errors,
            measured,
            invented,
            prices: [[0; BLOCK * BLOCK]; PALETTE],
            missed: [0; PALETTE],
        }
    }
}

impl Cheapest<'_> {
    /// Pixels of each block that touch its sphere, where it has one; there is nothing to choose from.
    /// Of blocks of several spheres none, yet.
    pub fn touch_alone(&self, map: &LabelMap, surfaces: &Surfaces<'_>, touching: &mut [u64]) {
        let columns = self.rays.block_columns;
        let rows = touching.par_chunks_mut(columns).enumerate();
        rows.for_each(|(by, touching)| {
            touch_row_alone(self, by * columns, map, surfaces, touching)
        });
    }

    /// The invented pixels of block `k`, by sphere, that cost nothing and miss nothing: where that is
    /// about as far away as what was measured in the block.
    #[inline(always)]
    fn forgiven(&self, k: usize, depths: &[Depths]) -> [u64; PALETTE] {
        let mut forgiven = [0; PALETTE];
        let invented = self.invented.get(k).copied().unwrap_or(0);
        if invented == 0 {
            return forgiven;
        }
        let (x0, y0, ..) = extent(self.rays, k);
        let (mut near, mut far) = (u16::MAX, 0);
        for i in bits(self.measured[k] & !invented) {
            let raw = self.errors.plane[(y0 + i / BLOCK) * self.rays.stride() + x0 + i % BLOCK];
            (near, far) = (near.min(raw), far.max(raw));
        }
        let near = f32::from(near) * (1.0 - ASIDE);
        let far = (f32::from(far) * (1.0 + ASIDE)).min(BEYOND);
        for i in bits(invented) {
            for (forgiven, depths) in forgiven.iter_mut().zip(depths) {
                *forgiven |= u64::from(near <= depths[i] && depths[i] < far) << i;
            }
        }
        forgiven
    }
}

#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2+bmi1+popcnt"))]
fn touch_row_alone<'a>(
    choice: &Cheapest<'a>,
    first: usize,
    map: &LabelMap,
    surfaces: &Surfaces<'a>,
    touching: &mut [u64],
) {
    let rays = choice.rays;
    let columns = rays.block_columns;
    touching.fill(0);
    let mut bx = 0;
    while bx < columns {
        let id = map.palettes[first + bx][0];
        let alike = |bx: usize| map.sizes[first + bx] == 1 && map.palettes[first + bx][0] == id;
        // blocks of one sphere side by side, looked at together
        let most = columns.min(bx + TOGETHER);
        let end = (bx..most).find(|&bx| !alike(bx)).unwrap_or(most);
        let sphere = surfaces.surface(rays, id).filter(|_| id != NO_SPHERE);
        if let (true, Some(sphere)) = (bx < end, sphere) {
            let missed = &mut [0u64; TOGETHER][..end - bx];
            choice
                .errors
                .missed(rays, (bx, first / columns), &sphere, missed);
            for (n, missed) in missed.iter().enumerate() {
                let k = first + bx + n;
                let mut forgiven = 0;
                if !choice.invented.is_empty() {
                    let mut depths = surface::NOTHING;
                    surfaces.depths(rays, k, id, &mut depths);
                    [forgiven, ..] = choice.forgiven(k, std::slice::from_ref(&depths));
                }
                touching[bx + n] = choice.measured[k] & (!missed | forgiven);
            }
        }
        bx = end.max(bx + 1);
    }
}

/// The numbers of the bits that are set, lowest first.
fn bits(mut set: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = (set != 0).then(|| set.trailing_zeros() as usize)?;
        set &= set - 1;
        Some(bit)
    })
}

impl Choice for Cheapest<'_> {
    #[inline(always)]
    fn block(&mut self, k: usize, palette: &[u16], depths: &[Depths; PALETTE]) {
        let depths = &depths[..palette.len()];
        let forgiven = self.forgiven(k, depths);
        let lists = self.prices.iter_mut().zip(&mut self.missed);
        for (((prices, missed), depths), forgiven) in lists.zip(depths).zip(forgiven) {
            self.errors.prices(self.rays, k, depths, prices);
            let mut cells = [0u8; BLOCK * BLOCK];
            for (cell, price) in cells.iter_mut().zip(&*prices) {
                *cell = u8::from(*price == MISS_COST);
            }
            *missed = packed(&cells) & !forgiven;
            for i in bits(forgiven) {
                prices[i] = 0;
            }
        }
    }

    #[inline(always)]
    fn quad(&mut self, pixels: u64, costs: &[u32], division: u32) -> Option<usize> {
        // nothing measured costs nothing, so all sixteen are summed; at most sixteen misses
        let mut sums = [0u32; PALETTE];
        let mut least = [u16::MAX; QUAD * QUAD];
        let first = pixels.trailing_zeros() as usize / BLOCK / QUAD * QUAD * BLOCK
            + pixels.trailing_zeros() as usize % BLOCK / QUAD * QUAD;
        for (sum, prices) in sums.iter_mut().zip(&self.prices[..costs.len()]) {
            let mut here = [0u16; QUAD * QUAD];
            for (j, row) in here.chunks_exact_mut(QUAD).enumerate() {
                row.copy_from_slice(&prices[first + j * BLOCK..][..QUAD]);
            }
            for (least, &price) in least.iter_mut().zip(&here) {
                *least = price.min(*least);
            }
            *sum = u32::from(here.iter().sum::<u16>());
        }
        let each = u32::from(least.iter().sum::<u16>());
        let best = (0..costs.len()).min_by_key(|&e| costs[e] + sums[e])?;
        let divided = division + each + DIVISION_COST + pixels.count_ones() * DIVISION_PIXEL_COST;
        (costs[best] + sums[best] <= divided).then_some(best)
    }

    #[inline(always)]
    fn pixel(&mut self, bit: u32, costs: &[u32]) -> usize {
        let price = |&e: &usize| costs[e] + u32::from(self.prices[e][bit as usize]);
        (0..costs.len()).min_by_key(price).unwrap_or(0)
    }

    #[inline(always)]
    fn given(&mut self, k: usize, pixels: u64, entry: usize) -> u64 {
        pixels & !self.missed[entry] & self.measured[k]
    }
}
