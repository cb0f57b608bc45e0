//! Figures 12 to 14: the random scheme against the progressive.

use super::{Cell, Chance, Curve, Effort, ExperimentError, Report, Series, Subject, Table};
use crate::contact_map::merged::ClaimMap;
use crate::fit::cloud::{CloudModel, FitParameters, Scheme, UNASSIGNED};
use crate::fit::scheme::CloudFit;
use crate::partition::lattice::{Lattice, Packing};
use crate::partition::points::LocalPoints;
use crate::quality::{cloud_error, percentile};
use glam::DVec3;
use std::time::Instant;

/// Boxes along each axis into which a cell is cut to look for a pattern.
const BOXES: usize = 4;
/// Other lattices that the pattern is compared with.
const PLACEBOS: usize = 12;

/// What one fit gives.
struct Outcome {
    spheres: f64,
    explained: f64,
    residual: f64,
    chamfer: f64,
    seconds: f64,
    pattern: f64,
}

/// Fits every subject by both schemes. The seed draws the random scheme's points and moves the
/// progressive scheme's lattice.
///
/// # Errors
/// [`ExperimentError`].
pub fn run(subjects: &[Subject], effort: Effort) -> Result<Report, ExperimentError> {
    let mut table = Table::new(
        "both schemes",
        &[
            "data",
            "scheme",
            "spheres",
            "explained %",
            "residual %",
            "Chamfer %",
            "time ms",
            "pattern %",
        ],
    );
    let mut curve = Curve {
        title: "Error and number of spheres: one point per fit".to_owned(),
        x: "spheres".to_owned(),
        y: "Chamfer, % of diagonal".to_owned(),
        log: (true, true),
        ..Curve::default()
    };
    let mut patterns = [Vec::new(), Vec::new()];
    let mut ratios = Vec::new();
    for subject in subjects {
        let mut means = Vec::new();
        for (k, scheme) in [Scheme::Random, Scheme::Progressive]
            .into_iter()
            .enumerate()
        {
            let mut fits = Vec::new();
            for seed in 0..effort.seeds {
                fits.push(outcome(subject, scheme, seed)?);
            }
            let spread =
                |f: fn(&Outcome) -> f64| Cell::spread(&fits.iter().map(f).collect::<Vec<_>>());
            let mut times: Vec<f64> = fits.iter().map(|f| 1e3 * f.seconds).collect();
            times.sort_by(f64::total_cmp);
            let chamfer = spread(|f| f.chamfer);
            means.push(chamfer.value().unwrap_or_default());
            table.rows.push(vec![
                Cell::text(&*subject.name),
                Cell::text(scheme.to_string()),
                spread(|f| f.spheres),
                spread(|f| f.explained),
                spread(|f| f.residual),
                chamfer,
                Cell::Number(percentile(&times, 0.5)),
                spread(|f| f.pattern),
            ]);
            patterns[k].extend(fits.iter().map(|f| f.pattern));
            curve.series.push(Series {
                name: format!("{}, {scheme}", subject.name),
                points: fits.iter().map(|f| (f.spheres, f.chamfer)).collect(),
            });
        }
        if let [random, progressive] = means[..] {
            ratios.push(progressive / random);
        }
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    Ok(Report {
        experiment: "schemes",
        claim: "Fig. 12–14: little difference, except for a slight pattern in the organised (progressive) model",
        method: "Residual: mean distance of the explained points from their sphere; Chamfer: points rebuilt from metric contact maps (cells of half the contact distance); both in % of the diagonal. Time: median, all cores. Pattern: share of the residual's variance explained by the place within the lattice cell, less the same for 12 lattices of other sizes",
        data: subjects.iter().map(Subject::describe).collect(),
        seeds: effort.seeds,
        tables: vec![table],
        findings: vec![format!(
            "Progressive has {:.2} times the Chamfer distance of random (mean over data). Place within the cell explains {:.2} % of the residual's variance beyond chance in progressive models, {:.2} % in random ones.",
            mean(&ratios),
            mean(&patterns[1]),
            mean(&patterns[0])
        )],
        curve,
    })
}

fn outcome(subject: &Subject, scheme: Scheme, seed: u64) -> Result<Outcome, ExperimentError> {
    let mut points = subject.local()?;
    // a moved lattice is a moved cloud
    let mut chance = Chance::new(seed);
    let shift = subject.cube_size_m * DVec3::new(chance.unit(), chance.unit(), chance.unit());
    let by = shift.as_vec3();
    points.x.iter_mut().for_each(|x| *x += by.x);
    points.y.iter_mut().for_each(|y| *y += by.y);
    points.z.iter_mut().for_each(|z| *z += by.z);
    points.origin -= by.as_dvec3();
    let parameters = FitParameters {
        contact_distance: subject.contact,
        cube_size_m: subject.cube_size_m,
        scheme,
        seed,
        ..FitParameters::default()
    };
    let start = Instant::now();
    let model = CloudFit::default().fit(&points, &parameters)?;
    let seconds = start.elapsed().as_secs_f64();
    let residuals = residuals(&points, &model);
    let diagonal = subject.diagonal_m();
    let total: f64 = residuals.iter().map(|(_, off)| off).sum();
    let (map, _) = ClaimMap::new(&points, &model, (0.5 * subject.contact.floor_m) as f32);
    let rebuilt: Vec<DVec3> = map.rebuild().iter().map(|p| *p + map.origin).collect();
    Ok(Outcome {
        spheres: model.spheres.len() as f64,
        explained: 100.0 * model.explained,
        residual: 100.0 * total / residuals.len().max(1) as f64 / diagonal,
        chamfer: 100.0 * cloud_error(&subject.points, &rebuilt).chamfer_m / diagonal,
        seconds,
        pattern: 100.0 * pattern(&residuals, subject.cube_size_m, &mut chance),
    })
}

/// Position and distance from its sphere of each explained point.
fn residuals(points: &LocalPoints, model: &CloudModel) -> Vec<(DVec3, f64)> {
    let own = model.assignment.iter().enumerate();
    own.filter(|(_, s)| **s != UNASSIGNED)
        .map(|(i, &s)| {
            let p = points.at(i).as_dvec3();
            (p, model.spheres[s as usize].distance(p))
        })
        .collect()
}

/// How much more of the residuals' variance the place within the fit's cell explains than the
/// place within cells of other sizes does.
fn pattern(residuals: &[(DVec3, f64)], cube_size_m: f64, chance: &mut Chance) -> f64 {
    let own = explained_by_place(residuals, &Lattice::new(Packing::Hexagonal, cube_size_m));
    let others: f64 = (0..PLACEBOS)
        .map(|_| {
            let spacing_m = cube_size_m * (0.75 + 0.5 * chance.unit());
            let offset = spacing_m * DVec3::new(chance.unit(), chance.unit(), chance.unit());
            let lattice = Lattice::new(Packing::Hexagonal, spacing_m);
            explained_by_place(residuals, &Lattice { offset, ..lattice })
        })
        .sum();
    own - others / PLACEBOS as f64
}

/// R²: share of the variance of the residuals that the mean of their box in the cell explains.
fn explained_by_place(residuals: &[(DVec3, f64)], lattice: &Lattice) -> f64 {
    let mut boxes = [(0.0, 0.0); BOXES * BOXES * BOXES];
    let reach = lattice.cell_radius();
    let (mut sum, mut squares) = (0.0, 0.0);
    for (p, off) in residuals {
        let from_center = *p - lattice.center(lattice.nearest(p.as_vec3()));
        let place = (from_center / reach + 1.0) * (0.5 * BOXES as f64);
        let along = |v: f64| (v as usize).min(BOXES - 1);
        let at = (along(place.z) * BOXES + along(place.y)) * BOXES + along(place.x);
        boxes[at].0 += 1.0;
        boxes[at].1 += off;
        sum += off;
        squares += off * off;
    }
    let n = residuals.len().max(1) as f64;
    let total = squares - sum * sum / n;
    let between: f64 = boxes
        .iter()
        .filter(|b| b.0 > 0.0)
        .map(|b| b.1 * b.1 / b.0)
        .sum::<f64>()
        - sum * sum / n;
    if total > 0.0 { between / total } else { 0.0 }
}
