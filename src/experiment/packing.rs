//! Figure 11: residual of hexagonal against cubic packing.

use super::{Cell, Chance, Curve, Effort, ExperimentError, Report, Series, Subject, Table};
use crate::fit::point_moments::PointMoments;
use crate::partition::cells::Cells;
use crate::partition::lattice::{Lattice, Packing};
use crate::partition::points::LocalPoints;
use glam::{DQuat, DVec3};
use rayon::prelude::*;

/// Cell sizes, as multiples of the subject's own.
pub const SIZES: [f64; 3] = [0.5, 1.0, 2.0];
/// Contact distances, as multiples of the subject's own.
pub const CONTACTS: [f64; 3] = [0.5, 1.0, 2.0];
/// Lattice offsets drawn, at least.
pub const OFFSETS: u64 = 12;
/// Corrections of the hexagonal spacing until both lattices have as many cells in use.
const CORRECTIONS: usize = 6;

/// How the two lattices are made comparable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Terms {
    title: &'static str,
    equal_count: bool,
    turned: bool,
}

const TERMS: [Terms; 3] = [
    Terms {
        title: "equal number of cells in use",
        equal_count: true,
        turned: false,
    },
    Terms {
        title: "equal number of cells in use, lattices turned at random",
        equal_count: true,
        turned: true,
    },
    Terms {
        title: "equal spacing of centres",
        equal_count: false,
        turned: false,
    },
];

/// Points and the contact distance of each.
struct Cloud {
    points: LocalPoints,
    contact: Vec<f64>,
}

/// What one lattice leaves.
#[derive(Clone, Copy, Default)]
struct Residual {
    rms_m: f64,
    /// Share of the points beyond each contact distance.
    beyond: [f64; CONTACTS.len()],
    cells: f64,
}

/// One sphere is fitted to each cell's points (least squares, no merging): what remains is the
/// packing's doing alone. Every lattice offset is drawn once and used for both packings.
///
/// # Errors
/// [`ExperimentError`].
pub fn run(subjects: &[Subject], effort: Effort) -> Result<Report, ExperimentError> {
    let offsets = effort.seeds.max(OFFSETS);
    let columns = [
        "data",
        "cell size m",
        "cubic RMS mm",
        "hex / cubic RMS",
        "hex wins",
        "hex / cubic beyond 0.5 contact",
        "beyond 1 contact",
        "beyond 2 contact",
        "hex / cubic cells",
    ];
    let mut tables = Vec::new();
    let mut findings = Vec::new();
    let mut curve = Curve {
        title: "Residual of hexagonal packing, cubic = 1".to_owned(),
        x: "cell size, times the data's own".to_owned(),
        y: "RMS residual, hexagonal / cubic".to_owned(),
        log: (true, false),
        ..Curve::default()
    };
    for terms in TERMS {
        let title = terms.title;
        let mut table = Table::new(title, &columns);
        let (mut wins, mut draws, mut ratios) = (0.0, 0.0, Vec::new());
        for subject in subjects {
            let points = subject.local()?;
            let contact = (0..points.len())
                .map(|i| subject.contact.at(points.world(i).z))
                .collect();
            let cloud = Cloud { points, contact };
            let mut series = Series {
                name: format!("{}, {title}", subject.name),
                points: Vec::new(),
            };
            for size in SIZES {
                let pairs: Vec<(Residual, Residual)> = (0..offsets)
                    .into_par_iter()
                    .map(|seed| pair(&cloud, size * subject.cube_size_m, terms, seed))
                    .collect();
                let rms: Vec<f64> = pairs.iter().map(|(c, h)| h.rms_m / c.rms_m).collect();
                let won = rms.iter().filter(|r| **r < 1.0).count();
                table.rows.push(row(subject, size, &pairs, &rms, won));
                let mean = rms.iter().sum::<f64>() / rms.len() as f64;
                series.points.push((size, mean));
                wins += won as f64;
                draws += rms.len() as f64;
                ratios.push(mean);
            }
            curve.series.push(series);
        }
        let mean = ratios.iter().sum::<f64>() / ratios.len().max(1) as f64;
        findings.push(format!(
            "With {title}, hexagonal packing leaves {mean:.3} times the RMS residual of cubic (mean over data and sizes) and wins {wins:.0} of {draws:.0} draws."
        ));
        tables.push(table);
    }
    Ok(Report {
        experiment: "packing",
        claim: "Fig. 11: hexagonal packing leaves clearly less residual error than regular packing",
        method: "One least-squares sphere per cell, no merging; RMS distance of all points from their cell's sphere; share of points beyond 0.5, 1 and 2 contact distances; lattice offsets (and turns) drawn at random, the same for both packings; cell size = spacing of the cubic lattice",
        data: subjects.iter().map(Subject::describe).collect(),
        seeds: offsets,
        tables,
        findings,
        curve,
    })
}

fn row(
    subject: &Subject,
    size: f64,
    pairs: &[(Residual, Residual)],
    rms: &[f64],
    won: usize,
) -> Vec<Cell> {
    let mut row = vec![
        Cell::text(&*subject.name),
        Cell::Number(size * subject.cube_size_m),
        Cell::spread(&pairs.iter().map(|(c, _)| 1e3 * c.rms_m).collect::<Vec<_>>()),
        Cell::spread(rms),
        Cell::text(format!("{won} of {}", rms.len())),
    ];
    for k in 0..CONTACTS.len() {
        // a ratio of nothing to nothing says nothing
        let ratios = pairs.iter().filter(|(c, _)| c.beyond[k] > 0.0);
        let ratios: Vec<f64> = ratios.map(|(c, h)| h.beyond[k] / c.beyond[k]).collect();
        row.push(Cell::spread(&ratios));
    }
    row.push(Cell::spread(
        &pairs
            .iter()
            .map(|(c, h)| h.cells / c.cells)
            .collect::<Vec<_>>(),
    ));
    row
}

/// Cubic and hexagonal at the same offset and turn.
fn pair(cloud: &Cloud, spacing: f64, terms: Terms, seed: u64) -> (Residual, Residual) {
    let mut chance = Chance::new(seed);
    let offset = spacing * DVec3::new(chance.unit(), chance.unit(), chance.unit());
    let axis = DVec3::new(chance.normal(), chance.normal(), chance.normal());
    let axis = axis.try_normalize().unwrap_or(DVec3::X);
    let turn = DQuat::from_axis_angle(axis, std::f64::consts::TAU * chance.unit());
    let mut turned = cloud.points.clone();
    if terms.turned {
        for i in 0..turned.len() {
            let p = (turn * turned.at(i).as_dvec3()).as_vec3();
            (turned.x[i], turned.y[i], turned.z[i]) = (p.x, p.y, p.z);
        }
    }
    let place = |lattice: Lattice| Cells::new(&turned, &Lattice { offset, ..lattice });
    let cubic = place(Lattice::new(Packing::Cubic, spacing));
    let mut hexagonal = if terms.equal_count {
        Lattice::with_cell_volume(Packing::Hexagonal, spacing.powi(3))
    } else {
        Lattice::new(Packing::Hexagonal, spacing)
    };
    let mut cells = place(hexagonal);
    if terms.equal_count {
        // equal volume is not equal number: a rounder cell is hit by less of a surface
        let mut last = cells.len();
        let off = |cells: &Cells| cells.len().abs_diff(cubic.len());
        for _ in 0..CORRECTIONS {
            // cells in use grow with the square of fineness where points lie on surfaces
            hexagonal.spacing_m *= (last as f64 / cubic.len() as f64).sqrt();
            let tried = place(hexagonal);
            last = tried.len();
            if off(&tried) < off(&cells) {
                cells = tried;
            }
        }
    }
    (
        residual(&turned, &cloud.contact, &cubic),
        residual(&turned, &cloud.contact, &cells),
    )
}

/// A cell whose points determine no sphere has one through all of them: residual 0.
fn residual(points: &LocalPoints, contact: &[f64], cells: &Cells) -> Residual {
    let mut squares = 0.0;
    let mut beyond = [0usize; CONTACTS.len()];
    for cell in 0..cells.len() {
        let center = cells.centers[cell];
        let at = |i: u32| points.at(i as usize).as_dvec3() - center;
        let mut moments = PointMoments::default();
        for &i in cells.points(cell) {
            moments.add(at(i));
        }
        let Some(fit) = moments.fit() else { continue };
        for &i in cells.points(cell) {
            let off = fit.sphere.distance(at(i));
            squares += off * off;
            for (count, factor) in beyond.iter_mut().zip(CONTACTS) {
                *count += usize::from(off > factor * contact[i as usize]);
            }
        }
    }
    let n = points.len().max(1) as f64;
    Residual {
        rms_m: (squares / n).sqrt(),
        beyond: beyond.map(|count| count as f64 / n),
        cells: cells.len() as f64,
    }
}
