//! Warm start: the spheres of the frame before, tried first.
//!
//! Each block is offered the spheres that held it and its neighbours in the last frame and takes
//! the one its moments fit best: O(1) a block. The chosen blocks' moments refit each sphere. A
//! sphere whose refit would not save the bits of sending it anew is kept to the bit (hysteresis in
//! time): on a still scene nothing changes and nothing is sent.

use super::agglomerate::Patch;
use super::contact_distance::ContactDistance;
use super::live::{Blocks, FitReport, MIN_BLOCK_PIXELS};
use super::moments::{Fit, Moments, bits_per_point};
use super::motion::{self, Motion, Observation};
use super::sphere::Sphere;
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
    /// Slots whose sphere was refitted.
    changed: Vec<bool>,
    spheres: Vec<Option<Sphere>>,
    pub(super) used: Vec<u32>,
}

impl Workspace {
    /// Buffers for so many spheres.
    pub(super) fn with_room(spheres: usize) -> Self {
        Self {
            sums: Vec::with_capacity(spheres),
            changed: Vec::with_capacity(spheres),
            spheres: Vec::with_capacity(spheres),
            used: Vec::with_capacity(spheres),
            ..Self::default()
        }
    }
}

pub(super) fn start(
    rays: &Rays,
    blocks: &mut Blocks,
    slots: &mut [Option<Patch>],
    distance: &ContactDistance,
    work: &mut Workspace,
    report: &mut FitReport,
) -> Motion {
    if slots.is_empty() {
        return Motion::default();
    }
    let motion = follow(rays, blocks, slots, distance, work);
    work.changed.clear();
    work.changed.resize(slots.len(), true);
    choose(rays, blocks, slots, LOOSE, &work.changed);
    work.changed.fill(false);
    refit(blocks, slots, work, report);
    choose(rays, blocks, slots, TIGHT, &work.changed);
    for (spheres, valid) in blocks.spheres.iter().zip(&blocks.valid) {
        if spheres[0] != NO_SPHERE {
            report.warm_pixels += valid.count_ones();
        }
    }
    motion
}

/// Estimates the camera's motion and carries the spheres along where that explains the blocks
/// better by more bits than the motion costs.
fn follow(
    rays: &Rays,
    blocks: &Blocks,
    slots: &mut [Option<Patch>],
    distance: &ContactDistance,
    work: &mut Workspace,
) -> Motion {
    // one block of four: a motion has six numbers
    let (columns, rows) = (rays.block_columns, rays.block_rows);
    let chosen = || {
        (0..rows)
            .step_by(2)
            .flat_map(|y| (0..columns).step_by(2).map(move |x| y * columns + x))
    };
    work.observations.clear();
    for k in chosen() {
        if let (Some(Some(patch)), true) = (
            slots.get(usize::from(blocks.before[k][0])),
            blocks.valid[k].count_ones() >= 48,
        ) {
            let (w, u, v) = blocks.moments[k].mean();
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
    let spheres = slots.iter().map(|s| s.map(|p| p.fit.sphere));
    work.spheres.clear();
    work.spheres.extend(spheres.clone());
    let stays = price(blocks, chosen(), &work.spheres);
    work.spheres.clear();
    work.spheres
        .extend(spheres.map(|s| s.and_then(|s| mover.sphere(&s))));
    // one block of four is asked
    if 4.0 * (stays - price(blocks, chosen(), &work.spheres)) <= MOTION_BITS {
        return Motion::default();
    }
    for (slot, moved) in slots.iter_mut().zip(&work.spheres) {
        match (slot.as_mut(), moved) {
            (Some(patch), Some(moved)) => patch.fit.sphere = *moved,
            _ => *slot = None,
        }
    }
    motion
}

/// Bits of some blocks on the spheres that held them.
fn price(blocks: &Blocks, chosen: impl Iterator<Item = usize>, spheres: &[Option<Sphere>]) -> f64 {
    chosen
        .filter_map(|k| {
            let sphere = spheres.get(usize::from(blocks.before[k][0]))?.as_ref()?;
            let sums = &blocks.moments[k];
            Some(sums.count * bits_per_point(sums.misfit(sphere)).min(8.0))
        })
        .sum()
}

/// Gives each block the best of the last frame's spheres around it, where it is good enough.
/// A block that a sphere which is not `changed` holds well has been through this.
fn choose(rays: &Rays, blocks: &mut Blocks, slots: &[Option<Patch>], limit: f64, changed: &[bool]) {
    let columns = rays.block_columns;
    let before = &blocks.before;
    for k in 0..before.len() {
        let is = blocks.spheres[k][0];
        let holds = f64::from(blocks.misfit[k]) <= TIGHT
            && changed.get(usize::from(is)).is_some_and(|c| !*c);
        if holds || blocks.valid[k].count_ones() < MIN_BLOCK_PIXELS {
            continue;
        }
        let own = if blocks.spheres[k][0] == NO_SPHERE {
            before[k][0]
        } else {
            blocks.spheres[k][0]
        };
        let sums = &blocks.moments[k];
        let misfit = |id: u16| match slots.get(usize::from(id)) {
            Some(Some(patch)) => sums.misfit(&patch.fit.sphere),
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
        let near = best.0 <= limit;
        blocks.spheres[k][0] = if near { best.1 } else { NO_SPHERE };
        blocks.misfit[k] = if near { best.0 as f32 } else { f32::INFINITY };
    }
}

/// Refits every sphere from its blocks, or keeps it.
fn refit(
    blocks: &Blocks,
    slots: &mut [Option<Patch>],
    work: &mut Workspace,
    report: &mut FitReport,
) {
    work.sums.clear();
    work.sums.resize(slots.len(), Moments::default());
    for (spheres, moments) in blocks.spheres.iter().zip(&blocks.moments) {
        if let Some(sum) = work.sums.get_mut(usize::from(spheres[0])) {
            sum.add(moments);
        }
    }
    let slots = slots.iter_mut().zip(&work.sums);
    for ((slot, sums), changed) in slots.zip(&mut work.changed) {
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
                *changed = true;
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
