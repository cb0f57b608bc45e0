//! All spheres' contact maps as one sparse map: as the paper has it, and keeping every claim.

use super::polar::{Angles, Patch, PatchCell, PolarGrid};
use crate::fit::cloud::{CloudModel, UNASSIGNED};
use crate::partition::points::LocalPoints;
use glam::DVec3;
use rayon::prelude::*;

/// The paper's merged map (3.2): "a sparse matrix with integer numbers (sphere numbers) at
/// various grid locations". A location holds one number, so where two spheres touch the same
/// latitude and longitude one of them is lost. The lower number stays: models list the spheres
/// with most contacts first.
#[derive(Clone, Debug, PartialEq)]
pub struct LiteralMap {
    /// The grid all spheres share.
    pub grid: PolarGrid,
    /// Cell and sphere number, ascending by cell.
    pub cells: Vec<(u32, u32)>,
    /// Points in the model, those of no sphere left out.
    pub points: usize,
    /// Points whose cell went to another sphere: not in the map.
    pub lost_points: usize,
    /// Contacts (a cell of one sphere, however many points) that another sphere displaced.
    pub lost_contacts: usize,
}

impl LiteralMap {
    /// Fuses the model's binary contact maps into one. O(n log n).
    #[must_use]
    pub fn new(points: &LocalPoints, model: &CloudModel, grid: PolarGrid) -> Self {
        let centers: Vec<DVec3> = model.spheres.iter().map(|s| s.center_radius().0).collect();
        let mut contacts: Vec<(u32, u32)> = assigned(points, model)
            .map(|(i, s)| {
                let from_center = points.at(i).as_dvec3() - centers[s as usize];
                (grid.cell(Angles::of(from_center)), s)
            })
            .collect();
        contacts.par_sort_unstable();
        let mut map = Self {
            grid,
            cells: Vec::new(),
            points: contacts.len(),
            lost_points: 0,
            lost_contacts: 0,
        };
        let mut before = None;
        for &contact in &contacts {
            match map.cells.last() {
                Some(kept) if kept.0 == contact.0 => {
                    if kept.1 != contact.1 {
                        map.lost_points += 1;
                        map.lost_contacts += usize::from(before != Some(contact));
                    }
                }
                _ => map.cells.push(contact),
            }
            before = Some(contact);
        }
        map
    }

    /// The points by Eq. 1, one per cell, metres about the model's origin.
    #[must_use]
    pub fn rebuild(&self, model: &CloudModel) -> Vec<DVec3> {
        let spheres: Vec<(DVec3, f64)> = model.spheres.iter().map(|s| s.center_radius()).collect();
        let point = |&(cell, s): &(u32, u32)| {
            let (center, radius) = spheres[s as usize];
            center + self.grid.middle(cell).point(radius)
        };
        self.cells.iter().map(point).collect()
    }
}

/// A contact map that keeps every claim: a cell may hold several sphere numbers.
///
/// Rows and columns are steps of arc on each sphere's own turned grid ([`Patch`]). The claims
/// are listed sphere by sphere; [`ClaimMap::merged`] lists the same claims cell by cell.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClaimMap {
    /// Zero of all coordinates in the source's, metres.
    pub origin: DVec3,
    /// Arc length of a cell's side, metres.
    pub step_m: f32,
    /// The spheres, with their points about the middle of their grids.
    pub patches: Vec<Patch>,
    /// First claim of every sphere, and the number of claims at the end.
    pub starts: Vec<u32>,
    /// The cells each sphere claims, ascending by row, then column, each once.
    pub cells: Vec<PatchCell>,
}

impl ClaimMap {
    /// The contact map of a model at cells of `step_m` (above 0, metres), and the number of
    /// points with a sphere that could not be put on its grid (beyond 2²⁴ steps).
    #[must_use]
    pub fn new(points: &LocalPoints, model: &CloudModel, step_m: f32) -> (Self, usize) {
        let count = model.spheres.len();
        let mut sums = vec![(DVec3::ZERO, 0.0); count];
        for (i, s) in assigned(points, model) {
            let sum = &mut sums[s as usize];
            *sum = (sum.0 + points.at(i).as_dvec3(), sum.1 + 1.0);
        }
        let exact: Vec<Patch> = model
            .spheres
            .iter()
            .zip(&sums)
            .map(|(sphere, &(sum, n))| Patch::new(sphere, sum / f64::max(n, 1.0)))
            .collect();
        let mut reach = vec![0f32; count];
        for (i, s) in assigned(points, model) {
            let from = points.at(i).distance(exact[s as usize].anchor);
            reach[s as usize] = reach[s as usize].max(from);
        }
        let patches: Vec<Patch> = exact
            .iter()
            .zip(reach)
            .map(|(patch, reach)| patch.rounded(f64::from(reach), f64::from(step_m)))
            .collect();
        let grids: Vec<_> = patches.iter().map(|p| p.grid(f64::from(step_m))).collect();
        let mut outside = 0;
        let mut claims: Vec<(u32, PatchCell)> = Vec::new();
        for (i, s) in assigned(points, model) {
            match grids[s as usize].cell(points.at(i).as_dvec3()) {
                Some(cell) => claims.push((s, cell)),
                None => outside += 1,
            }
        }
        claims.par_sort_unstable();
        claims.dedup();
        let mut starts = vec![0u32; count + 1];
        for &(s, _) in &claims {
            starts[s as usize + 1] += 1;
        }
        for s in 0..count {
            starts[s + 1] += starts[s];
        }
        let map = Self {
            origin: points.origin,
            step_m,
            patches,
            starts,
            cells: claims.into_iter().map(|(_, cell)| cell).collect(),
        };
        (map, outside)
    }

    /// The cells that sphere `s` claims. `s` must be below the number of patches.
    #[must_use]
    pub fn claims(&self, s: usize) -> &[PatchCell] {
        &self.cells[self.starts[s] as usize..self.starts[s + 1] as usize]
    }

    /// One sparse map of all spheres: cell and sphere number, ascending, every claim kept.
    #[must_use]
    pub fn merged(&self) -> Vec<(PatchCell, u32)> {
        let mut merged: Vec<(PatchCell, u32)> = (0..self.patches.len())
            .flat_map(|s| self.claims(s).iter().map(move |&cell| (cell, s as u32)))
            .collect();
        merged.par_sort_unstable();
        merged
    }

    /// The points, one per claim, metres about the origin, sphere by sphere.
    #[must_use]
    pub fn rebuild(&self) -> Vec<DVec3> {
        let mut points = Vec::with_capacity(self.cells.len());
        for (s, patch) in self.patches.iter().enumerate() {
            let grid = patch.grid(f64::from(self.step_m));
            points.extend(self.claims(s).iter().map(|&cell| grid.point(cell)));
        }
        points
    }
}

/// Points that have a sphere, with its number.
fn assigned<'a>(
    points: &'a LocalPoints,
    model: &'a CloudModel,
) -> impl Iterator<Item = (usize, u32)> + 'a {
    let own = model.assignment.iter().take(points.len()).copied();
    own.enumerate()
        .filter(|&(_, s)| s != UNASSIGNED && (s as usize) < model.spheres.len())
}

#[cfg(test)]
#[path = "merged_tests.rs"]
mod tests;
