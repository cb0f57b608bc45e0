//! The progressive scheme (paper 3.2, 4.1): space in cells, in each cell spheres from the
//! smallest radius to the largest that fits, their contacts taken out, up to 25 spheres a cell.
//!
//! Deviations. Paper 3.2 starts every sphere at the cell's centre and varies its radius. Here the
//! centre and the radii are starts only: the points of each shell around the centre are refitted
//! by moments, so that centre and radius follow the surface (paper-literal spheres cover 89 % of
//! a frame where free ones cover 99.8 %). Patches of one surface are then merged across cells
//! (`fit/merge.rs`), and points left over are partitioned again with cells twice as large.

use super::cloud::{CloudModel, CloudSphere, FitParameters, UNASSIGNED, UNEXPLAINED_SHARE};
use super::contact_distance::ContactDistance;
use super::cover::Cover;
use super::lanes::Lanes;
use super::merge::{Patch, merge_patches};
use super::ordered::Ordered;
use super::point_moments::PointMoments;
use crate::partition::cells::Cells;
use crate::partition::lattice::Lattice;
use crate::partition::points::LocalPoints;
use rayon::prelude::*;

/// Starting radii per sphere.
const SHELLS: usize = 6;
/// Refits by moments per start, at most.
const REFIT_ROUNDS: usize = 3;
/// Partitions: the given cells, then twice as large, and so on.
const PASSES: usize = 5;

/// Largest number of points times spheres for which superfluous spheres are looked for.
const PRUNE_LIMIT: usize = 300_000_000;

/// The progressive scheme and its buffers, kept from cloud to cloud.
#[derive(Debug, Default)]
pub struct ProgressiveFit {
    cells: Cells,
    rest: LocalPoints,
    leftover: Vec<u32>,
}

/// Buffers of one cell's fit.
#[derive(Default)]
struct CellFit {
    remaining: Lanes,
    distances: Vec<f64>,
    marks: Vec<u8>,
    places: Vec<u32>,
}

impl ProgressiveFit {
    /// Fits spheres cell by cell. Same points and parameters: same model, whatever the number
    /// of threads. Every assigned point is within contact distance of its sphere.
    #[must_use]
    pub fn fit(&mut self, points: &LocalPoints, parameters: &FitParameters) -> CloudModel {
        let mut model = CloudModel {
            origin: points.origin,
            assignment: vec![UNASSIGNED; points.len()],
            ..CloudModel::default()
        };
        let allowed = (points.len() as f64 * UNEXPLAINED_SHARE) as usize;
        let contact = &parameters.contact_distance;
        self.leftover.clear();
        self.leftover.extend(0..points.len() as u32);
        for pass in 0..PASSES {
            if self.leftover.len() <= allowed {
                break;
            }
            self.rest.take(points, &self.leftover);
            let spacing_m = parameters.cube_size_m * f64::from(1u32 << pass);
            let lattice = Lattice::new(parameters.packing, spacing_m);
            self.cells.refill(&self.rest, &lattice);
            let (cells, rest) = (&self.cells, &self.rest);
            let patches: Vec<Patch> = (0..cells.len())
                .into_par_iter()
                .map_init(CellFit::default, |fit, cell| {
                    fit.patches(rest, cells, cell, contact, parameters.spheres_per_cube)
                })
                .flatten_iter()
                .collect();
            let merged = merge_patches(patches, cells, parameters.packing, rest, contact);
            for patch in &merged {
                let number = model.spheres.len() as u32;
                for &i in &patch.members {
                    let p = rest.at(i as usize).as_dvec3();
                    if patch.sphere.distance(p) <= contact.at(p.z + points.origin.z) {
                        model.assignment[self.leftover[i as usize] as usize] = number;
                    }
                }
                model.spheres.push(patch.sphere);
            }
            let assignment = &mut model.assignment;
            adopt(rest, cells, &merged, parameters, |i, patch| {
                let slot = &mut assignment[self.leftover[i as usize] as usize];
                if *slot == UNASSIGNED {
                    *slot = (model.spheres.len() - merged.len() + patch) as u32;
                }
            });
            self.leftover
                .retain(|&i| model.assignment[i as usize] == UNASSIGNED);
        }
        if model.spheres.len() * points.len() <= PRUNE_LIMIT {
            prune(points, parameters, allowed, &mut model);
        }
        model.order_and_limit(parameters.max_spheres);
        model
    }
}

/// Drops the spheres whose points others touch as well: a sphere has no border, so one fitted
/// in one cell often explains points of another.
fn prune(points: &LocalPoints, parameters: &FitParameters, allowed: usize, model: &mut CloudModel) {
    let mut all = Ordered::default();
    all.fill(points, &parameters.contact_distance);
    if !model.spheres.iter().all(|s| all.lanes.resolves(s)) {
        return;
    }
    let mut cover = Cover::new(all.len());
    for sphere in &model.spheres {
        cover.push(*sphere, all.touching(sphere));
    }
    cover.prune(allowed);
    model.assignment.fill(UNASSIGNED);
    cover.assign(&all, &mut model.assignment);
    model.spheres = cover.spheres;
}

/// Offers every point to the spheres that hold points in its own cell and the cells around.
fn adopt(
    points: &LocalPoints,
    cells: &Cells,
    patches: &[Patch],
    parameters: &FitParameters,
    mut found: impl FnMut(u32, usize),
) {
    let mut cell_of = vec![0u32; points.len()];
    for cell in 0..cells.len() {
        for &i in cells.points(cell) {
            cell_of[i as usize] = cell as u32;
        }
    }
    // patches by cell, each once per cell
    let mut present: Vec<(u32, u32)> = Vec::new();
    let mut held = vec![false; points.len()];
    for (number, patch) in patches.iter().enumerate() {
        for &i in &patch.members {
            let p = points.at(i as usize).as_dvec3();
            let contact = parameters.contact_distance.at(p.z + points.origin.z);
            held[i as usize] = patch.sphere.distance(p) <= contact;
            let entry = (cell_of[i as usize], number as u32);
            if present.last() != Some(&entry) {
                present.push(entry);
            }
        }
    }
    present.par_sort_unstable();
    present.dedup();
    let of_cell = |cell: u32| {
        let from = present.partition_point(|e| e.0 < cell);
        present[from..].iter().take_while(move |e| e.0 == cell)
    };
    for cell in 0..cells.len() {
        if cells.points(cell).iter().all(|&i| held[i as usize]) {
            continue;
        }
        let near: Vec<u32> = std::iter::once(cell)
            .chain(cells.neighbours(cell, parameters.packing))
            .flat_map(|c| of_cell(c as u32).map(|e| e.1))
            .collect();
        for &i in cells.points(cell).iter().filter(|&&i| !held[i as usize]) {
            let p = points.at(i as usize).as_dvec3();
            let nearest = near
                .iter()
                .map(|&n| (patches[n as usize].sphere.distance(p), n))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let contact = parameters.contact_distance.at(p.z + points.origin.z);
            if let Some((_, n)) = nearest.filter(|&(distance, _)| distance <= contact) {
                found(i, n as usize);
            }
        }
    }
}

impl CellFit {
    /// The patches of one cell.
    fn patches(
        &mut self,
        points: &LocalPoints,
        cells: &Cells,
        cell: usize,
        contact: &ContactDistance,
        limit: usize,
    ) -> Vec<Patch> {
        let center = cells.centers[cell];
        let ids = cells.points(cell).iter().copied();
        self.remaining.fill(points, ids, center, contact);
        let mut patches = Vec::new();
        while patches.len() < limit {
            let Some(sphere) = self.best_sphere() else {
                break;
            };
            self.places.clear();
            self.remaining
                .list_touching(&sphere, &mut self.marks, &mut self.places);
            let mut moments = PointMoments::default();
            let mut members = Vec::with_capacity(self.places.len());
            for &place in &self.places {
                moments.add(self.remaining.at(place as usize));
                members.push(self.remaining.id[place as usize]);
            }
            if members.is_empty() {
                break;
            }
            patches.push(Patch {
                sphere: sphere.translated(center),
                zero: center,
                moments,
                members,
                cell: cell as u32,
            });
            self.remaining.remove(&sphere);
        }
        patches
    }

    /// The sphere most points touch, among refits of all points and of shells around the
    /// cell's centre, smallest radius first.
    fn best_sphere(&mut self) -> Option<CloudSphere> {
        let n = self.remaining.len();
        if n < 5 {
            return None;
        }
        let mut all = PointMoments::default();
        self.distances.clear();
        for i in 0..n {
            let p = self.remaining.at(i);
            all.add(p);
            self.distances.push(p.length());
        }
        let mut best = self.refitted(all.fit()?.sphere);
        if best.0 == n {
            return Some(best.1);
        }
        self.distances.sort_by(f64::total_cmp);
        for shell in 0..SHELLS {
            let inner = self.distances[shell * (n - 1) / SHELLS];
            let outer = self.distances[(shell + 1) * (n - 1) / SHELLS];
            let (radius, half) = (0.5 * (inner + outer), 0.5 * (outer - inner));
            let mut sums = PointMoments::default();
            for i in 0..n {
                let p = self.remaining.at(i);
                if (p.length() - radius).abs() <= half.max(f64::from(self.remaining.tau(i))) {
                    sums.add(p);
                }
            }
            let Some(start) = sums.fit() else { continue };
            let found = self.refitted(start.sphere);
            if found.0 > best.0 {
                best = found;
            }
        }
        (best.0 > 0).then_some(best.1)
    }

    /// Refits by moments of the contacts while that gains contacts.
    fn refitted(&mut self, start: CloudSphere) -> (usize, CloudSphere) {
        let mut best = (0, start);
        if self.remaining.resolves(&start) {
            best.0 = self.remaining.touching(&start);
        }
        for round in 0..REFIT_ROUNDS {
            let widen = if round == 0 { 2.0 } else { 1.0 };
            let scratch = (&mut self.marks, &mut self.places);
            let Some(fit) = self.remaining.moments(&best.1, widen, scratch).fit() else {
                break;
            };
            if !self.remaining.resolves(&fit.sphere) {
                break;
            }
            let touching = self.remaining.touching(&fit.sphere);
            if touching > best.0 {
                best = (touching, fit.sphere);
            } else if round > 0 {
                break;
            }
        }
        best
    }
}
