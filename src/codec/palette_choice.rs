//! The encoder's choice of palettes: the fewest spheres that are worth their bits.
//!
//! The fit says which spheres a block's pixels touch within the contact distance. The payload may
//! give a pixel to another one within the bound: a sphere whose pixels the others of the block
//! explain about as well is left out.

use super::choice::Errors;
use super::mask::extent;
use super::surface::Depths;
use crate::contact_map::assign::{EMPTY, PALETTE, Palette};
use crate::contact_map::labels::{INVALID, NO_SPHERE, SaintFrame};
use crate::deproject::{BLOCK, Rays};

/// Bits that one more sphere costs in a block, its boundary included, in 1/16 bit.
const ENTRY_COST: u32 = 20 * 16;
/// Bits that stating a sphere costs, in 1/16 bit: shared by its blocks.
const SPHERE_COST: u32 = 28 * 16;
/// Labels that are told apart in a block.
const FOUND: usize = 16;

/// The palette of block `k` in model slots, and its size, before any is left out; `measured` are its
/// pixels.
///
/// Of the labels of `saint` those with most pixels are taken, four at most. Pixels that touch
/// nothing join a sphere of theirs, unless they are many: then "no sphere" is in the palette and
/// they are predicted from each other.
pub(super) fn gather(saint: &SaintFrame, rays: &Rays, k: usize, measured: u64) -> (Palette, u8) {
    let mut palette = EMPTY;
    if measured == 0 {
        return (palette, 0);
    }
    let (x0, y0, w, h) = extent(rays, k);
    if let Some(label) = single_label(saint, rays, (x0, y0, w, h)) {
        palette[0] = label;
        return (palette, 1);
    }
    let mut found: [(u32, u16); FOUND] = [(0, NO_SPHERE); FOUND];
    let mut n = 0;
    let mut left = measured;
    while left != 0 {
        let bit = left.trailing_zeros() as usize;
        left &= left - 1;
        let label = saint
            .labels
            .get((y0 + bit / BLOCK) * rays.width + x0 + bit % BLOCK);
        let id = match label.map(|&l| (l, saint.spheres.get(usize::from(l)))) {
            Some((l, Some(Some(_)))) => l,
            _ => NO_SPHERE,
        };
        if let Some(f) = found[..n].iter_mut().find(|f| f.1 == id) {
            f.0 += 1;
        } else if n < found.len() {
            found[n] = (1, id);
            n += 1;
        }
    }
    // few loners are cheaper as residuals of a sphere
    let total = measured.count_ones();
    let spheres = found[..n].iter().any(|f| f.1 != NO_SPHERE);
    for f in &mut found[..n] {
        if f.1 == NO_SPHERE && spheres && f.0 * 3 < total {
            f.0 = 0;
        }
    }
    found[..n].sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut size = 0;
    for f in found[..n].iter().take(PALETTE).filter(|f| f.0 > 0) {
        palette[size] = f.1;
        size += 1;
    }
    (palette, size as u8)
}

/// Leaves out entries of block `k` that are not worth it, the last first; returns how many are
/// left. `blocks` is the number of blocks that each model slot is in.
pub(super) fn prune(
    saint: &SaintFrame,
    rays: &Rays,
    errors: &Errors<'_>,
    (k, measured): (usize, u64),
    blocks: &[u32],
    palette: &mut Palette,
    mut size: usize,
) -> usize {
    let mut prices = [[0u16; BLOCK * BLOCK]; PALETTE];
    let mut depths: Depths = super::surface::NOTHING;
    for (prices, &id) in prices.iter_mut().zip(&palette[..size]) {
        match saint.spheres.get(usize::from(id)) {
            Some(Some(sphere)) => {
                super::surface::depths_of(rays, k, sphere, &mut depths);
                errors.prices(rays, k, &depths, prices);
            }
            _ => prices.fill(super::choice::MISS_COST),
        }
    }
    let mut entry = size;
    while size > 1 && entry > 0 {
        entry -= 1;
        if palette[entry] == NO_SPHERE {
            continue;
        }
        let mut loss = 0u32;
        let mut left = measured;
        while left != 0 {
            let i = left.trailing_zeros() as usize;
            left &= left - 1;
            let others = (0..size).filter(|&e| e != entry).map(|e| prices[e][i]);
            let other = others.min().unwrap_or(u16::MAX);
            loss += u32::from(other.saturating_sub(prices[entry][i]));
        }
        let blocks = blocks
            .get(usize::from(palette[entry]))
            .map_or(1, |&n| n.max(1));
        if loss < ENTRY_COST + SPHERE_COST / blocks {
            for e in entry..size - 1 {
                palette[e] = palette[e + 1];
                prices[e] = prices[e + 1];
            }
            size -= 1;
            palette[size] = NO_SPHERE;
        }
    }
    size
}

/// The one label of all measured pixels of a block, where they have one and it names a sphere.
#[inline]
fn single_label(
    saint: &SaintFrame,
    rays: &Rays,
    (x0, y0, w, h): (usize, usize, usize, usize),
) -> Option<u16> {
    let rows = || (0..h).map(|j| &saint.labels[(y0 + j) * rays.width + x0..][..w]);
    let first = rows().flatten().copied().find(|l| *l != INVALID)?;
    saint.spheres.get(usize::from(first)).copied().flatten()?;
    let same = |row: &[u16]| {
        row.iter()
            .fold(true, |s, &l| s & ((l == first) | (l == INVALID)))
    };
    rows().all(same).then_some(first)
}
