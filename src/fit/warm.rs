//! Warm start: the spheres of the frame before, tried first.
//!
//! Each block is offered the spheres that held it and its neighbours in the last frame and takes
//! the one its moments fit best: O(1) a block. The chosen blocks' moments refit each sphere. A
//! sphere whose refit would not save the bits of sending it anew is kept to the bit (hysteresis in
//! time): on a still scene nothing changes and nothing is sent.

use super::agglomerate::Patch;
use super::contact_distance::ContactDistance;
use super::live::{Block, FitReport, MIN_BLOCK_PIXELS};
use super::moments::{Fit, Moments, bits_per_point};
use super::motion::{self, Motion, Observation};
use crate::contact_map::assign::Palette;
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::Rays;
use glam::DVec3;

/// Bits it costs to send a sphere's change.
const CHANGE_BITS: f64 = 28.0;
/// Bits a motion must save: its own and those of what it unsettles.
const MOTION_BITS: f64 = 300.0;
/// Blocks this far off (mean square, contact distances) still pull a sphere along: the camera moved.
const LOOSE: f64 = 4.0;
/// Blocks this near are explained.
pub(super) const TIGHT: f64 = 0.3;

/// Buffers of the warm start.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    sums: Vec<Moments>,
    observations: Vec<Observation>,
    pub(super) used: Vec<u32>,
}

impl Workspace {
    /// Buffers for so many spheres.
    pub(super) fn with_room(spheres: usize) -> Self {
        Self {
            sums: Vec::with_capacity(spheres),
            used: Vec::with_capacity(spheres),
            ..Self::default()
        }
    }
}

pub(super) fn start(
    rays: &Rays,
    blocks: &mut [Block],
    before: &[Palette],
    slots: &mut [Option<Patch>],
    distance: &ContactDistance,
    work: &mut Workspace,
    report: &mut FitReport,
) -> Motion {
    if slots.is_empty() {
        return Motion::default();
    }
    let motion = follow(blocks, before, slots, distance, work);
    choose(rays, blocks, before, slots, LOOSE);
    refit(blocks, slots, work, report);
    choose(rays, blocks, before, slots, TIGHT);
    for block in blocks.iter() {
        if block.sphere != NO_SPHERE {
            report.warm_pixels += block.valid.count_ones();
        }
    }
    motion
}

/// Estimates the camera's motion and carries the spheres along where that explains the blocks
/// better by more bits than the motion costs.
fn follow(
    blocks: &[Block],
    before: &[Palette],
    slots: &mut [Option<Patch>],
    distance: &ContactDistance,
    work: &mut Workspace,
) -> Motion {
    work.observations.clear();
    for (block, palette) in blocks.iter().zip(before) {
        if let (Some(Some(patch)), true) = (
            slots.get(usize::from(palette[0])),
            block.valid.count_ones() >= 48,
        ) {
            let (w, u, v) = block.moments.mean();
            let z = 1.0 / w;
            work.observations.push(Observation {
                point: DVec3::new(u * z, v * z, z),
                reach: distance.at(z),
                sphere: patch.fit.sphere,
            });
        }
    }
    let Some(motion) = motion::estimate(&work.observations).filter(|m| !m.is_still()) else {
        return Motion::default();
    };
    let mover = motion.mover();
    let price = |moved: bool| -> f64 {
        let cost = |(block, palette): (&Block, &Palette)| {
            let sphere = slots.get(usize::from(palette[0]))?.as_ref()?.fit.sphere;
            let sphere = if moved {
                mover.sphere(&sphere)?
            } else {
                sphere
            };
            Some(block.moments.count * bits_per_point(block.moments.misfit(&sphere)).min(8.0))
        };
        blocks.iter().zip(before).filter_map(cost).sum()
    };
    if price(true) + MOTION_BITS >= price(false) {
        return Motion::default();
    }
    for slot in slots {
        if let Some(patch) = slot {
            match mover.sphere(&patch.fit.sphere) {
                Some(moved) => patch.fit.sphere = moved,
                None => *slot = None,
            }
        }
    }
    motion
}

/// Gives each block the best of the last frame's spheres around it, where it is good enough.
fn choose(
    rays: &Rays,
    blocks: &mut [Block],
    before: &[Palette],
    slots: &[Option<Patch>],
    limit: f64,
) {
    let columns = rays.block_columns;
    for k in 0..blocks.len() {
        let block = &blocks[k];
        if block.valid.count_ones() < MIN_BLOCK_PIXELS {
            continue;
        }
        let own = if block.sphere == NO_SPHERE {
            before[k][0]
        } else {
            block.sphere
        };
        let misfit = |id: u16| match slots.get(usize::from(id)) {
            Some(Some(patch)) => block.moments.misfit(&patch.fit.sphere),
            _ => f64::INFINITY,
        };
        let mut best = (misfit(own), own);
        // hysteresis: only a block that its own sphere does not hold looks around
        if best.0 > TIGHT {
            let bx = k % columns;
            let around = [
                (bx > 0).then(|| k - 1),
                (bx + 1 < columns).then_some(k + 1),
                k.checked_sub(columns),
                (k + columns < before.len()).then_some(k + columns),
            ];
            let others = before[k][1..]
                .iter()
                .copied()
                .chain(around.into_iter().flatten().map(|n| before[n][0]));
            for id in others {
                if id != NO_SPHERE && id != best.1 {
                    let m = misfit(id);
                    if m < best.0 {
                        best = (m, id);
                    }
                }
            }
        }
        blocks[k].sphere = if best.0 <= limit { best.1 } else { NO_SPHERE };
    }
}

/// Refits every sphere from its blocks, or keeps it.
fn refit(
    blocks: &[Block],
    slots: &mut [Option<Patch>],
    work: &mut Workspace,
    report: &mut FitReport,
) {
    work.sums.clear();
    work.sums.resize(slots.len(), Moments::default());
    for block in blocks {
        if let Some(sum) = work.sums.get_mut(usize::from(block.sphere)) {
            sum.add(&block.moments);
        }
    }
    for (slot, sums) in slots.iter_mut().zip(&work.sums) {
        let Some(patch) = slot else { continue };
        if sums.count < 16.0 {
            patch.moments = *sums; // last frame's sums are of another camera position
            report.kept += 1;
            continue;
        }
        let stays = sums.misfit(&patch.fit.sphere);
        match sums.fit() {
            Some(fit)
                if sums.count * (bits_per_point(stays) - bits_per_point(fit.misfit))
                    > CHANGE_BITS =>
            {
                *patch = Patch {
                    moments: *sums,
                    fit,
                    bits: sums.bits(fit.misfit),
                };
                report.refitted += 1;
            }
            _ => {
                let fit = Fit {
                    sphere: patch.fit.sphere,
                    misfit: stays,
                };
                *patch = Patch {
                    moments: *sums,
                    fit,
                    bits: sums.bits(stays),
                };
                report.kept += 1;
            }
        }
    }
}
