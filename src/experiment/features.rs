//! Figures 16 and 17 in small: do the features tell objects apart?
//!
//! The paper adds its features to networks for object classification. Here a patch of points is
//! given to the object it comes from by its nearest neighbours among patches of the objects'
//! other halves: no network, no training, every column visible.

use super::{Cell, Chance, Curve, Effort, ExperimentError, Report, Series, Subject, Table, fit};
use crate::features::{COLUMNS, FeatureOptions, Features, PAPER_COLUMNS};
use crate::fit::cloud::Scheme;
use crate::fit::contact_distance::ContactDistance;
use crate::loss::Ball;
use crate::quality::percentile;
use glam::{DQuat, DVec3};
use rayon::prelude::*;

/// Patches of each half of each object.
const PATCHES: usize = 40;
/// Points of a patch.
const POINTS: usize = 256;
/// Radius of a patch, as a share of the object's diagonal.
const RADIUS_SHARE: f64 = 0.12;
/// Neighbours that vote.
const VOTERS: usize = 5;
/// Numbers that sum up one column over a patch: mean, deviation, three percentiles.
const SUMMARY: usize = 5;

/// Groups of columns of a patch's description.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Group {
    Position,
    Paper,
    ShuffledPaper,
    Normals,
    Local,
    ShuffledLocal,
}

const SETS: [(&str, &[Group]); 7] = [
    ("position", &[Group::Position]),
    (
        "position + paper's features",
        &[Group::Position, Group::Paper],
    ),
    (
        "position + the same shuffled (placebo)",
        &[Group::Position, Group::ShuffledPaper],
    ),
    ("normals and density (control)", &[Group::Normals]),
    (
        "normals and density + local sphere",
        &[Group::Normals, Group::Local],
    ),
    (
        "normals and density + the same shuffled (placebo)",
        &[Group::Normals, Group::ShuffledLocal],
    ),
    ("local sphere alone", &[Group::Local]),
];

/// One patch: its object and the summary of each group.
#[derive(Clone, Debug, Default)]
struct Patch {
    object: usize,
    position: Vec<f64>,
    paper: Vec<f64>,
    normals: Vec<f64>,
    local: Vec<f64>,
}

/// Every subject is a class. Half of each object, cut by a random plane, gives the patches that
/// are known, the other half those to be told.
///
/// # Errors
/// Fewer than two subjects.
pub fn run(subjects: &[Subject], effort: Effort) -> Result<Report, ExperimentError> {
    if subjects.len() < 2 {
        return Err(ExperimentError::Data(format!(
            "the features experiment tells objects apart and got {}; give at least two",
            subjects.len()
        )));
    }
    let mut table = Table::new(
        "patches told right, %",
        &[
            "features",
            "upright",
            "turned at random",
            "turned, over its base",
        ],
    );
    let mut hits = vec![[Vec::new(), Vec::new()]; SETS.len()];
    for seed in 0..effort.seeds {
        for turned in [false, true] {
            let (known, asked) = patches(subjects, seed, turned)?;
            for (s, (_, groups)) in SETS.iter().enumerate() {
                hits[s][usize::from(turned)].push(100.0 * accuracy(&known, &asked, groups, seed));
            }
        }
    }
    // the set that each one adds to
    let base = [0, 0, 0, 3, 3, 3, 3];
    let mut findings = Vec::new();
    for (s, (name, _)) in SETS.iter().enumerate() {
        let paired: Vec<f64> = hits[s][1]
            .iter()
            .zip(&hits[base[s]][1])
            .map(|(a, b)| a - b)
            .collect();
        let gain = Cell::spread(&paired);
        if matches!(s, 1 | 2 | 4 | 5) {
            findings.push(format!(
                "Under free rotation, {name}: {gain} points over its base."
            ));
        }
        table.rows.push(vec![
            Cell::text(*name),
            Cell::spread(&hits[s][0]),
            Cell::spread(&hits[s][1]),
            gain,
        ]);
    }
    findings.push(format!("Chance is {:.1} %.", 100.0 / subjects.len() as f64));
    let bars = |turned: usize| {
        let mean = |h: &Vec<f64>| h.iter().sum::<f64>() / h.len().max(1) as f64;
        hits.iter()
            .enumerate()
            .map(|(s, h)| (s as f64 + 1.0, mean(&h[turned])))
            .collect()
    };
    Ok(Report {
        experiment: "features",
        claim: "Fig. 16, 17: the features of 4.2 raise classification by 0.3 to 0.6 points",
        method: "Which object does a patch of 256 points come from? Patches (radius 12 % of the diagonal, scaled to 1) of one half of each object are known, those of the other half are asked; each column is summed up by mean, deviation, 10th, 50th, 90th percentile; 5 nearest neighbours vote. Placebo: the same columns of another patch. Seeds are paired",
        data: subjects.iter().map(Subject::describe).collect(),
        seeds: effort.seeds,
        tables: vec![table],
        findings,
        curve: Curve {
            title: "Patches told right (feature sets in the order of the table)".to_owned(),
            x: "feature set".to_owned(),
            y: "told right, %".to_owned(),
            log: (false, false),
            series: vec![
                Series {
                    name: "upright".to_owned(),
                    points: bars(0),
                },
                Series {
                    name: "turned at random".to_owned(),
                    points: bars(1),
                },
            ],
        },
    })
}

/// Known and asked patches of all subjects.
fn patches(
    subjects: &[Subject],
    seed: u64,
    turned: bool,
) -> Result<(Vec<Patch>, Vec<Patch>), ExperimentError> {
    let mut halves = (Vec::new(), Vec::new());
    for (object, subject) in subjects.iter().enumerate() {
        let mut chance = Chance::new(seed ^ (object as u64) << 32);
        let centroid = subject.points.iter().sum::<DVec3>() / subject.points.len() as f64;
        let cut = direction(&mut chance);
        let is_known = |p: &&DVec3| (**p - centroid).dot(cut) > 0.0;
        let known: Vec<DVec3> = subject.points.iter().filter(is_known).copied().collect();
        let asked: Vec<DVec3> = subject
            .points
            .iter()
            .filter(|p| !is_known(p))
            .copied()
            .collect();
        for (half, points) in [(&mut halves.0, &known), (&mut halves.1, &asked)] {
            let crops: Vec<Vec<DVec3>> = (0..PATCHES)
                .map(|_| {
                    crop(
                        points,
                        subject.diagonal_m() * RADIUS_SHARE,
                        turned,
                        &mut chance,
                    )
                })
                .collect();
            let described: Result<Vec<Patch>, _> =
                crops.par_iter().map(|c| describe(object, c)).collect();
            half.extend(described?);
        }
    }
    Ok(halves)
}

fn direction(chance: &mut Chance) -> DVec3 {
    let v = DVec3::new(chance.normal(), chance.normal(), chance.normal());
    v.try_normalize().unwrap_or(DVec3::X)
}

/// About [`POINTS`] points around a random one, their middle at 0, scaled to radius 1.
fn crop(points: &[DVec3], radius: f64, turned: bool, chance: &mut Chance) -> Vec<DVec3> {
    if points.is_empty() {
        return Vec::new();
    }
    let around = points[chance.below(points.len())];
    let mut near: Vec<DVec3> = points
        .iter()
        .copied()
        .filter(|p| p.distance(around) < radius)
        .collect();
    chance.shuffle(&mut near);
    near.truncate(POINTS);
    let middle = near.iter().sum::<DVec3>() / near.len().max(1) as f64;
    let turn = DQuat::from_axis_angle(direction(chance), std::f64::consts::TAU * chance.unit());
    let turn = if turned { turn } else { DQuat::IDENTITY };
    near.iter().map(|p| turn * (*p - middle) / radius).collect()
}

fn describe(object: usize, points: &[DVec3]) -> Result<Patch, ExperimentError> {
    let subject = Subject {
        name: String::new(),
        points: points.to_vec(),
        is_frame: false,
        contact: ContactDistance::constant(0.02),
        cube_size_m: 0.5,
    };
    let model = fit(&subject.local()?, &subject, Scheme::Random, 0)?;
    let spheres: Vec<Ball> = model
        .spheres
        .iter()
        .map(|s| s.center_radius())
        .map(|(center, radius)| Ball {
            center: center + model.origin,
            radius,
        })
        .collect();
    let options = FeatureOptions {
        neighbours: 16,
        ..FeatureOptions::default()
    };
    let features = Features::new(points, &spheres, &model.assignment, &options);
    let value = |i: usize, c: usize| f64::from(features.row(i)[c]);
    let column = |c: usize| {
        (0..points.len())
            .map(move |i| (i, c))
            .map(|(i, c)| value(i, c))
    };
    let spread = COLUMNS.iter().position(|c| c.name == "spread").unwrap_or(0);
    let mut patch = Patch {
        object,
        ..Patch::default()
    };
    for axis in 0..3 {
        summarise(points.iter().map(|p| p[axis]), &mut patch.position);
        summarise(
            features.normals.iter().map(|n| f64::from(n[axis])),
            &mut patch.normals,
        );
    }
    summarise(points.iter().map(|p| p.length()), &mut patch.position);
    summarise(column(spread), &mut patch.normals);
    for c in 0..COLUMNS.len() {
        // a plane's radius of 10 km would drown the rest
        let bounded = column(c).map(|v| v.signum() * v.abs().ln_1p());
        match c {
            c if c < PAPER_COLUMNS => summarise(bounded, &mut patch.paper),
            c if c != spread => summarise(bounded, &mut patch.local),
            _ => {}
        }
    }
    Ok(patch)
}

/// Appends mean, deviation and three percentiles.
fn summarise(values: impl Iterator<Item = f64>, out: &mut Vec<f64>) {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
    let summary: [f64; SUMMARY] = [
        mean,
        square.sqrt(),
        percentile(&values, 0.1),
        percentile(&values, 0.5),
        percentile(&values, 0.9),
    ];
    out.extend(summary);
}

/// Share of the asked patches that their neighbours give to the right object.
fn accuracy(known: &[Patch], asked: &[Patch], groups: &[Group], seed: u64) -> f64 {
    let mut chance = Chance::new(seed ^ 0x70_6c61_6365_626f);
    let mut table = |patches: &[Patch]| -> Vec<Vec<f64>> {
        let mut other: Vec<usize> = (0..patches.len()).collect();
        chance.shuffle(&mut other);
        let row = |i: usize| {
            let of = |group: &Group| match group {
                Group::Position => patches[i].position.clone(),
                Group::Paper => patches[i].paper.clone(),
                Group::Normals => patches[i].normals.clone(),
                Group::Local => patches[i].local.clone(),
                Group::ShuffledPaper => patches[other[i]].paper.clone(),
                Group::ShuffledLocal => patches[other[i]].local.clone(),
            };
            groups.iter().flat_map(of).collect()
        };
        (0..patches.len()).map(row).collect()
    };
    let (mut a, mut b) = (table(known), table(asked));
    standardise(&mut a, &mut b);
    let right = asked
        .iter()
        .zip(&b)
        .filter(|(patch, row)| vote(known, &a, row) == Some(patch.object))
        .count();
    right as f64 / asked.len().max(1) as f64
}

/// Each column of both tables to mean 0 and deviation 1 of the first.
fn standardise(a: &mut [Vec<f64>], b: &mut [Vec<f64>]) {
    let columns = a.first().map_or(0, Vec::len);
    let n = a.len().max(1) as f64;
    for c in 0..columns {
        let mean = a.iter().map(|r| r[c]).sum::<f64>() / n;
        let deviation = (a.iter().map(|r| (r[c] - mean).powi(2)).sum::<f64>() / n).sqrt();
        let scale = if deviation > 1e-12 {
            1.0 / deviation
        } else {
            0.0
        };
        for row in a.iter_mut().chain(b.iter_mut()) {
            row[c] = (row[c] - mean) * scale;
        }
    }
}

/// The object most of the nearest known patches belong to; of several the nearest one's.
fn vote(known: &[Patch], table: &[Vec<f64>], row: &[f64]) -> Option<usize> {
    let distance =
        |other: &[f64]| -> f64 { other.iter().zip(row).map(|(x, y)| (x - y).powi(2)).sum() };
    let mut near: Vec<(f64, usize)> = table
        .iter()
        .zip(known)
        .map(|(r, p)| (distance(r), p.object))
        .collect();
    near.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
    near.truncate(VOTERS);
    let votes = |object: usize| near.iter().filter(|n| n.1 == object).count();
    let most = near.iter().map(|n| votes(n.1)).max()?;
    near.iter().find(|n| votes(n.1) == most).map(|n| n.1)
}
