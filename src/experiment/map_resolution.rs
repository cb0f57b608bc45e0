//! Figure 15: error against the resolution of the contact map.

use super::{Cell, Curve, Effort, ExperimentError, Report, Series, Subject, Table, fit};
use crate::contact_map::merged::{ClaimMap, LiteralMap};
use crate::contact_map::polar::{Angles, PolarGrid};
use crate::fit::cloud::{CloudModel, CloudSphere, Scheme};
use crate::partition::points::LocalPoints;
use crate::quality::cloud_error;
use glam::DVec3;
use rayon::prelude::*;

/// Rows of the map; the columns are twice as many.
pub const RESOLUTIONS: [u32; 8] = [16, 32, 64, 128, 256, 512, 1024, 2048];
/// Halvings in the search for a metric step with as many cells.
const HALVINGS: usize = 8;
/// A surface may bend this share of the contact distance away from the plane that it is.
const BEND_SHARE: f64 = 0.25;

/// Results of one model at one resolution.
#[derive(Clone, Copy, Default)]
struct Point {
    literal: f64,
    kept: f64,
    collisions: f64,
    every_claim: f64,
    metric: f64,
    cells: f64,
    step: f64,
}

/// Three maps of the same model: the paper's merged map; the same angular cells with every claim
/// kept; and cells of constant arc length, as many of them as the second has.
///
/// # Errors
/// [`ExperimentError`].
pub fn run(subjects: &[Subject], effort: Effort) -> Result<Report, ExperimentError> {
    let columns = [
        "data",
        "mr",
        "merged (paper) Chamfer %",
        "points kept %",
        "contacts lost %",
        "every claim Chamfer %",
        "metric Chamfer %",
        "cells per point",
        "metric cell %",
    ];
    let mut single = Table::new("each data set", &columns);
    let mut all = vec![vec![Vec::new(); RESOLUTIONS.len()]; subjects.len()];
    for (subject, results) in subjects.iter().zip(&mut all) {
        let points = subject.local()?;
        for seed in 0..effort.seeds {
            let mut model = fit(&points, subject, Scheme::Random, seed)?;
            bend_planes(&points, &mut model, subject.contact.floor_m);
            let measured: Vec<Point> = RESOLUTIONS
                .par_iter()
                .map(|&mr| measure(subject, &points, &model, mr))
                .collect();
            for (result, point) in results.iter_mut().zip(measured) {
                result.push(point);
            }
        }
        for (mr, points) in RESOLUTIONS.iter().zip(results.iter()) {
            single.rows.push(row(&subject.name, *mr, points));
        }
    }
    // each seed's mean over the data sets, so that the spread is that of the seeds
    let mut mean = Table::new("mean over the data sets (errors: geometric mean)", &columns);
    let mut means = Vec::new();
    for (r, mr) in RESOLUTIONS.iter().enumerate() {
        let of_seed = |seed: usize| {
            let each: Vec<Point> = all.iter().map(|s| s[r][seed]).collect();
            average(&each)
        };
        let seeds: Vec<Point> = (0..effort.seeds as usize).map(of_seed).collect();
        mean.rows.push(row("mean", *mr, &seeds));
        means.push((f64::from(*mr), average(&seeds)));
    }
    let line = |name: &str, f: fn(&Point) -> f64| Series {
        name: name.to_owned(),
        points: means.iter().map(|(mr, p)| (*mr, f(p))).collect(),
    };
    let findings = match (means.first(), means.last()) {
        (Some((low, a)), Some((high, b))) => {
            let doublings = (high / low).log2();
            let per = |x: f64, y: f64| (y / x).powf(1.0 / doublings);
            vec![
                format!(
                    "Per doubling of mr, from {low} to {high}, the error becomes ×{:.2} in the paper's merged map, ×{:.2} with every claim kept, ×{:.2} in metric cells.",
                    per(a.literal, b.literal),
                    per(a.every_claim, b.every_claim),
                    per(a.metric, b.metric)
                ),
                format!(
                    "At mr {high} the merged map keeps {:.1} % of the points; {:.1} % of the contacts went to another sphere. At equal number of cells metric cells leave {:.2} times the error of angular ones.",
                    b.kept,
                    b.collisions,
                    b.metric / b.every_claim
                ),
            ]
        }
        _ => Vec::new(),
    };
    Ok(Report {
        experiment: "map-resolution",
        claim: "Fig. 15: the percentage error is reduced as the contact map resolution is increased",
        method: "Random scheme; Chamfer distance of the rebuilt points to the original, % of the diagonal; mr rows and 2 mr columns; a contact is a cell of one sphere; planes get the smallest radius that stays within a quarter of the contact distance of them (\"a sufficiently large radius\", 3.2); metric cells: equally many as the angular map with every claim has",
        data: subjects.iter().map(Subject::describe).collect(),
        seeds: effort.seeds,
        tables: vec![mean, single],
        findings,
        curve: Curve {
            title: "Error against map resolution, mean over the data".to_owned(),
            x: "map resolution mr (rows)".to_owned(),
            y: "Chamfer, % of diagonal".to_owned(),
            log: (true, true),
            series: vec![
                line("merged map of the paper", |p| p.literal),
                line("every claim kept", |p| p.every_claim),
                line("metric cells, as many", |p| p.metric),
            ],
        },
    })
}

fn average(points: &[Point]) -> Point {
    let n = points.len().max(1) as f64;
    let mean = |f: fn(&Point) -> f64| points.iter().map(f).sum::<f64>() / n;
    // errors of scenes and of objects differ by orders of magnitude
    let error = |f: fn(&Point) -> f64| (points.iter().map(|p| f(p).ln()).sum::<f64>() / n).exp();
    Point {
        literal: error(|p| p.literal),
        kept: mean(|p| p.kept),
        collisions: mean(|p| p.collisions),
        every_claim: error(|p| p.every_claim),
        metric: error(|p| p.metric),
        cells: mean(|p| p.cells),
        step: mean(|p| p.step),
    }
}

fn row(name: &str, mr: u32, points: &[Point]) -> Vec<Cell> {
    let spread = |f: fn(&Point) -> f64| Cell::spread(&points.iter().map(f).collect::<Vec<_>>());
    vec![
        Cell::text(name),
        Cell::from(mr as usize),
        spread(|p| p.literal),
        spread(|p| p.kept),
        spread(|p| p.collisions),
        spread(|p| p.every_claim),
        spread(|p| p.metric),
        spread(|p| p.cells),
        spread(|p| p.step),
    ]
}

fn measure(subject: &Subject, points: &LocalPoints, model: &CloudModel, mr: u32) -> Point {
    let local: Vec<DVec3> = (0..points.len()).map(|i| points.at(i).as_dvec3()).collect();
    let diagonal = subject.diagonal_m();
    let error = |rebuilt: &[DVec3]| 100.0 * cloud_error(&local, rebuilt).chamfer_m / diagonal;
    let grid = PolarGrid::new(mr);
    let literal = LiteralMap::new(points, model, grid);
    let claims = every_claim(points, model, grid);
    let (metric, step_m) = with_cells(points, model, claims.len(), diagonal);
    let contacts = (literal.cells.len() + literal.lost_contacts).max(1);
    Point {
        literal: error(&literal.rebuild(model)),
        kept: 100.0 * (literal.points - literal.lost_points) as f64 / points.len().max(1) as f64,
        collisions: 100.0 * literal.lost_contacts as f64 / contacts as f64,
        every_claim: error(&claims),
        metric: error(&metric.rebuild()),
        cells: claims.len() as f64 / points.len().max(1) as f64,
        step: 100.0 * step_m / diagonal,
    }
}

/// Gives every sphere that is larger than its points need a radius just large enough.
///
/// Paper 3.2 models a plane by "a sphere of a sufficiently large radius". On a grid of angles a
/// larger one is worse: at a radius of 10 km a cell of the finest map holds a whole room.
pub fn bend_planes(points: &LocalPoints, model: &mut CloudModel, contact_m: f64) {
    let mut sums = vec![(DVec3::ZERO, 0.0); model.spheres.len()];
    let own = || model.assignment.iter().enumerate();
    for (i, &s) in own() {
        if let Some(sum) = sums.get_mut(s as usize) {
            *sum = (sum.0 + points.at(i).as_dvec3(), sum.1 + 1.0);
        }
    }
    let middles: Vec<DVec3> = sums
        .iter()
        .map(|(sum, n)| *sum / f64::max(*n, 1.0))
        .collect();
    let mut extents = vec![0.0f64; middles.len()];
    for (i, &s) in own() {
        if let Some(middle) = middles.get(s as usize) {
            let extent = &mut extents[s as usize];
            *extent = extent.max(points.at(i).as_dvec3().distance(*middle));
        }
    }
    for ((sphere, middle), extent) in model.spheres.iter_mut().zip(&middles).zip(&extents) {
        // a cap of radius R and half-width e is e² / 2R high
        let enough = extent * extent / (2.0 * BEND_SHARE * contact_m);
        if sphere.curvature.abs() * enough >= 1.0 || enough <= 0.0 {
            continue;
        }
        let foot = sphere.project(*middle);
        let gradient = sphere.curvature * foot + sphere.normal;
        if let Some(normal) = gradient.try_normalize() {
            *sphere = CloudSphere {
                curvature: (1.0 / enough).copysign(sphere.curvature),
                normal,
                offset: 0.0,
            }
            .translated(foot);
        }
    }
}

/// The points of the paper's grid with every sphere's claims kept, metres about the origin.
#[must_use]
pub fn every_claim(points: &LocalPoints, model: &CloudModel, grid: PolarGrid) -> Vec<DVec3> {
    let spheres: Vec<(DVec3, f64)> = model.spheres.iter().map(|s| s.center_radius()).collect();
    let mut claims: Vec<(u32, u32)> = Vec::new();
    for (i, &s) in model.assignment.iter().enumerate() {
        if let Some((center, _)) = spheres.get(s as usize) {
            claims.push((s, grid.cell(Angles::of(points.at(i).as_dvec3() - *center))));
        }
    }
    claims.sort_unstable();
    claims.dedup();
    let point = |&(s, cell): &(u32, u32)| {
        let (center, radius) = spheres[s as usize];
        center + grid.middle(cell).point(radius)
    };
    claims.iter().map(point).collect()
}

/// The metric map with about `cells` cells, and its step, metres.
fn with_cells(
    points: &LocalPoints,
    model: &CloudModel,
    cells: usize,
    diagonal: f64,
) -> (ClaimMap, f64) {
    let (mut low, mut high) = (1e-5 * diagonal, diagonal);
    for _ in 0..HALVINGS {
        let middle = (low * high).sqrt();
        if ClaimMap::new(points, model, middle as f32).0.cells.len() > cells {
            low = middle;
        } else {
            high = middle;
        }
    }
    (ClaimMap::new(points, model, high as f32).0, high)
}
