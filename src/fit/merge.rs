//! Merging spheres across cells: two patches become one while their union still lies on one
//! sphere within the contact distance.
//!
//! Deviation. Paper 3.2 keeps every cell's spheres. A wall cut by forty cells is one surface;
//! moments add, so asking whether two patches share a sphere costs one small fit, whatever
//! their size.

use super::cloud::CloudSphere;
use super::contact_distance::ContactDistance;
use super::point_moments::PointMoments;
use crate::partition::cells::Cells;
use crate::partition::lattice::Packing;
use crate::partition::points::LocalPoints;
use glam::DVec3;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};

/// A sphere fitted in one cell, later in several, and the points it holds.
#[derive(Clone, Debug)]
pub(crate) struct Patch {
    /// About the cloud's origin.
    pub sphere: CloudSphere,
    /// Zero of `moments`, about the cloud's origin.
    pub zero: DVec3,
    pub moments: PointMoments,
    /// Numbers of the points.
    pub members: Vec<u32>,
    /// The cell it was fitted in.
    pub cell: u32,
}

/// RMS residual of a union, in contact distances, up to which it may be one sphere. Points
/// spread evenly over the contact band have 0.58.
const UNION_RMS: f64 = 0.5;
/// Share of a union's probed points that may lie outside the contact distance.
const UNION_MISSES: f64 = 0.02;
/// Points probed per patch.
const PROBES: usize = 128;
/// A patch's centroid may lie this many contact distances off the other's sphere.
const CENTROID_REACH: f64 = 6.0;

/// What deciding on a union needs.
struct Union<'a> {
    points: &'a LocalPoints,
    contact: &'a ContactDistance,
}

impl Union<'_> {
    fn tau(&self, p: DVec3) -> f64 {
        self.contact.at(p.z + self.points.origin.z)
    }

    /// The union's moments about `a.zero`.
    fn moments(&self, a: &Patch, b: &Patch) -> PointMoments {
        let mut sums = a.moments;
        sums.merge(&b.moments.shifted(a.zero - b.zero));
        sums
    }

    /// RMS of the union in contact distances, where it is small enough.
    fn rms(&self, a: &Patch, b: &Patch) -> Option<f64> {
        let centroid = |p: &Patch| p.zero + p.moments.first / p.moments.count;
        let (ca, cb) = (centroid(a), centroid(b));
        let (off_a, off_b) = (b.sphere.distance(ca), a.sphere.distance(cb));
        if off_a.min(off_b) > CENTROID_REACH * self.tau(ca).max(self.tau(cb)) {
            return None;
        }
        let rms = self.moments(a, b).fit()?.rms_m / self.tau(0.5 * (ca + cb));
        (rms <= UNION_RMS).then_some(rms)
    }

    /// The union, where both parts' points touch its sphere.
    fn join(&self, a: &Patch, b: &Patch) -> Option<Patch> {
        let moments = self.moments(a, b);
        let sphere = moments.fit()?.sphere.translated(a.zero);
        for part in [a, b] {
            let stride = part.members.len().div_ceil(PROBES).max(1);
            let (mut probed, mut missed) = (0.0, 0.0);
            for &i in part.members.iter().step_by(stride) {
                let p = self.points.at(i as usize).as_dvec3();
                probed += 1.0;
                missed += f64::from(u8::from(sphere.distance(p) > self.tau(p)));
            }
            if missed > UNION_MISSES * probed {
                return None;
            }
        }
        Some(Patch {
            sphere,
            zero: a.zero,
            moments,
            members: Vec::new(),
            cell: a.cell,
        })
    }
}

/// Merges the patches of one partition, best unions first. Deterministic: ties go to the lower
/// numbers. O(p log p) for p patches, as each has a bounded number of neighbours.
pub(crate) fn merge_patches(
    patches: Vec<Patch>,
    cells: &Cells,
    packing: Packing,
    points: &LocalPoints,
    contact: &ContactDistance,
) -> Vec<Patch> {
    let union = Union { points, contact };
    // first patch of every cell; patches come cell by cell
    let mut first = vec![0usize; cells.len() + 1];
    for patch in &patches {
        first[patch.cell as usize + 1] += 1;
    }
    for c in 0..cells.len() {
        first[c + 1] += first[c];
    }
    let edges: Vec<(u64, u32, u32)> = (0..patches.len())
        .into_par_iter()
        .flat_map_iter(|a| {
            let own = patches[a].cell as usize;
            let (first, patches, union) = (&first, &patches, &union);
            std::iter::once(own)
                .chain(cells.neighbours(own, packing))
                .flat_map(move |cell| first[cell]..first[cell + 1])
                .filter(move |&b| b > a)
                .filter_map(move |b| {
                    let rms = union.rms(&patches[a], &patches[b])?;
                    Some((rms.to_bits(), a as u32, b as u32))
                })
        })
        .collect();

    // Positive floats order as their bits do. A union is a new patch at the end of the list;
    // entries that name a patch already merged are void.
    let mut near: Vec<BTreeSet<u32>> = vec![BTreeSet::new(); patches.len()];
    for &(_, a, b) in &edges {
        near[a as usize].insert(b);
        near[b as usize].insert(a);
    }
    let mut heap: BinaryHeap<Reverse<(u64, u32, u32)>> = edges.into_iter().map(Reverse).collect();
    let mut all: Vec<Option<Patch>> = patches.into_iter().map(Some).collect();
    while let Some(Reverse((_, a, b))) = heap.pop() {
        let (Some(pa), Some(pb)) = (&all[a as usize], &all[b as usize]) else {
            continue;
        };
        let Some(mut joined) = union.join(pa, pb) else {
            continue;
        };
        let (Some(pa), Some(pb)) = (all[a as usize].take(), all[b as usize].take()) else {
            continue;
        };
        let (mut long, short) = if pa.members.len() < pb.members.len() {
            (pb.members, pa.members)
        } else {
            (pa.members, pb.members)
        };
        long.extend(short);
        joined.members = long;
        let number = all.len() as u32;
        let mut around = std::mem::take(&mut near[a as usize]);
        around.append(&mut near[b as usize]);
        around.retain(|&o| all[o as usize].is_some());
        for &other in &around {
            if let Some(patch) = &all[other as usize] {
                near[other as usize].insert(number);
                if let Some(rms) = union.rms(&joined, patch) {
                    heap.push(Reverse((rms.to_bits(), other, number)));
                }
            }
        }
        near.push(around);
        all.push(Some(joined));
    }
    all.into_iter().flatten().collect()
}
