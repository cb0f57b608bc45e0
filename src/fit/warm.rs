//! Warm start: the spheres of the frame before, tried first.
//!
//! Each block is offered the spheres that held it and its neighbours in the last frame and takes
//! the one its moments fit best: O(1) a block. The chosen blocks' moments refit each sphere. A
//! sphere whose refit would not save the bits of sending it anew is kept to the bit (hysteresis in
//! time): on a still scene nothing changes and nothing is sent.

use super::agglomerate::Patch;
use super::contact_distance::ContactDistance;
use super::live::{Blocks, FitReport, MIN_BLOCK_PIXELS};
use super::moments::{Fit, Moments, bits_per_point, form_of};
use super::motion::{self, Motion, Observation, Observations};
use super::sphere::Sphere;
use crate::contact_map::assign::{PALETTE, Palette};
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
    observations: Observations,
    /// Slots whose sphere was refitted.
    changed: Vec<bool>,
    spheres: Vec<Option<Sphere>>,
    forms: Vec<[f64; 4]>,
    pub(super) used: Vec<u32>,
}

impl Workspace {
    /// Buffers for so many spheres.
    pub(super) fn with_room(spheres: usize) -> Self {
        Self {
            sums: Vec::with_capacity(spheres),
            changed: Vec::with_capacity(spheres),
            spheres: Vec::with_capacity(spheres),
            forms: Vec::with_capacity(spheres + 1),
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
    choose(rays, blocks, slots, LOOSE, work);
    work.changed.fill(false);
    refit(blocks, slots, work, report);
    report.warm_pixels = choose(rays, blocks, slots, TIGHT, work);
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
            work.observations.push(&Observation {
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
/// A block that a sphere which is not `changed` holds well has been through this. Returns the
/// measured pixels of blocks that got one.
fn choose(
    rays: &Rays,
    blocks: &mut Blocks,
    slots: &[Option<Patch>],
    limit: f64,
    work: &mut Workspace,
) -> u32 {
    work.forms.clear();
    work.forms.extend(slots.iter().map(|slot| match slot {
        Some(patch) => form_of(&patch.fit.sphere),
        None => NO_FORM,
    }));
    work.forms.push(NO_FORM);
    let choice = Choice {
        columns: rays.block_columns,
        valid: &blocks.valid,
        moments: &blocks.moments,
        before: &blocks.before,
        forms: &work.forms,
        changed: &work.changed,
        limit,
    };
    choose_all(&choice, &mut blocks.spheres, &mut blocks.misfit)
}

/// What [`choose`] reads.
struct Choice<'a> {
    columns: usize,
    valid: &'a [u64],
    moments: &'a [Moments],
    before: &'a [Palette],
    /// Those of the slots, and [`NO_FORM`] behind them.
    forms: &'a [[f64; 4]],
    changed: &'a [bool],
    limit: f64,
}

/// The numbers of a slot without a sphere: it fits nothing.
const NO_FORM: [f64; 4] = [f64::NAN; 4];
/// Others a block may lie on: those it had before besides its own, and those around it.
const OTHERS: usize = 8;
const _: () = assert!(PALETTE - 1 + 4 <= OTHERS);

impl Choice<'_> {
    #[inline(always)]
    fn form(&self, id: u16) -> [f64; 4] {
        // no branch: which of them are none cannot be foreseen
        let last = self.forms.len() - 1;
        self.forms[usize::from(id).min(last)]
    }

    /// The best of the spheres around block `k` where it is better than `best`.
    #[inline(always)]
    fn around(&self, k: usize, mut best: (f64, u16)) -> (f64, u16) {
        let (columns, before) = (self.columns, self.before);
        let bx = k % columns;
        let places = [
            (bx > 0).then(|| k - 1),
            (bx + 1 < columns).then_some(k + 1),
            k.checked_sub(columns),
            (k + columns < before.len()).then_some(k + columns),
        ];
        let mut ids = [NO_SPHERE; OTHERS];
        ids[..PALETTE - 1].copy_from_slice(&before[k][1..]);
        for (id, place) in ids[PALETTE - 1..].iter_mut().zip(places) {
            *id = place.map_or(NO_SPHERE, |n| before[n][0]);
        }
        if ids.iter().all(|&id| id == best.1 || id == NO_SPHERE) {
            return best;
        }
        // all at once: how many there are no branch can foresee
        let mut forms = [[0.0; OTHERS]; 4];
        for (i, &id) in ids.iter().enumerate() {
            let form = self.form(id);
            for (lanes, x) in forms.iter_mut().zip(form) {
                lanes[i] = x;
            }
        }
        let misfits = self.moments[k].misfits(&forms);
        for (&id, &misfit) in ids.iter().zip(&misfits) {
            let better = misfit < best.0;
            best.0 = if better { misfit } else { best.0 };
            best.1 = if better { id } else { best.1 };
        }
        best
    }
}

#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2+bmi1+popcnt"))]
fn choose_all<'a>(choice: &Choice<'a>, spheres: &mut [[u16; 2]], misfits: &mut [f32]) -> u32 {
    let mut pixels = 0;
    for (k, (sphere, misfit)) in spheres.iter_mut().zip(misfits).enumerate() {
        let is = sphere[0];
        let count = choice.valid[k].count_ones();
        let unchanged = choice.changed.get(usize::from(is)).is_some_and(|c| !*c);
        if f64::from(*misfit) <= TIGHT && unchanged {
            pixels += count;
            continue;
        }
        if count < MIN_BLOCK_PIXELS {
            continue;
        }
        let own = if is == NO_SPHERE {
            choice.before[k][0]
        } else {
            is
        };
        let [fits] = choice.moments[k].misfits(&choice.form(own).map(|x| [x]));
        let mut best = (if fits.is_nan() { f64::INFINITY } else { fits }, own);
        // hysteresis: only a block that its own sphere does not hold looks around
        if best.0 > TIGHT {
            best = choice.around(k, best);
        }
        let near = best.0 <= choice.limit;
        sphere[0] = if near { best.1 } else { NO_SPHERE };
        *misfit = if near { best.0 as f32 } else { f32::INFINITY };
        pixels += if near { count } else { 0 };
    }
    pixels
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
