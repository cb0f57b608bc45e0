//! Figure 18: a depth predictor trained with and without the SAINT loss.
//!
//! The paper adds its loss to large networks. Here the predictor is as small as can be and the
//! question the same: it sees one depth of each 8×8 block and predicts every pixel, as
//! `z = z₀ (1 + b + Σ wₖ (φₖ − z₀)/z₀)` from seven guesses φₖ (bilinear, nearest, mean, median,
//! least, largest of the samples around, a plane through them); `b` and `w` are learnt by
//! gradient descent (Adam) on some frames and judged on others. z₀ is the bilinear guess.
//!
//! The control. Spheres cover the pixels that are easy: smooth, without noise. A loss that looks
//! at those alone may help whatever it says there. So plain L1 on the same pixels stands beside.

use super::{Cell, Chance, Curve, DepthFrames, Effort, ExperimentError, Report, Series, Table};
use crate::contact_map::labels::{NO_SPHERE, SaintFrame};
use crate::deproject::{Rays, Validity};
use crate::fit::cloud::UNASSIGNED;
use crate::fit::live::{FitOptions, Modeler};
use crate::loss::{Ball, LossGradient, Owners, Penalty, SaintLoss};
use glam::DVec3;
use rayon::prelude::*;

/// Pixels between the samples that the predictor sees.
const BLOCK: usize = 8;
/// Guesses.
const GUESSES: usize = 6;
/// Numbers learnt: one for each guess and the bias.
const WEIGHTS: usize = GUESSES + 1;
/// Pixels taken of each frame.
const PIXELS: usize = 12_000;
/// Pixels of one step.
const BATCH: usize = 1024;
/// Steps of the descent.
const STEPS: usize = 300;
/// Steps between two looks at the held-out frames.
const LOOK: usize = 15;

/// What is minimised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Goal {
    L1,
    L1AndSaint,
    L1AndMask,
    Saint,
    Mask,
}

const GOALS: [(Goal, &str); 5] = [
    (Goal::L1, "L1"),
    (Goal::L1AndSaint, "L1 + SAINT"),
    (Goal::L1AndMask, "L1 + L1 on covered pixels (control)"),
    (Goal::Saint, "SAINT alone"),
    (Goal::Mask, "L1 on covered pixels alone (control)"),
];

/// One pixel: what is guessed, what was measured, the sphere it lies on.
#[derive(Clone, Copy, Debug)]
struct Pixel {
    ray: DVec3,
    base: f64,
    guesses: [f64; GUESSES],
    measured: f64,
    truth: Option<f64>,
    owner: u32,
}

impl Pixel {
    fn slope(&self, k: usize) -> f64 {
        if k < GUESSES {
            self.guesses[k] - self.base
        } else {
            self.base
        }
    }

    fn predict(&self, weights: &[f64; WEIGHTS]) -> f64 {
        self.base
            + (0..WEIGHTS)
                .map(|k| weights[k] * self.slope(k))
                .sum::<f64>()
    }
}

/// Pixels of some frames and the spheres of those frames.
#[derive(Default)]
struct Set {
    pixels: Vec<Pixel>,
    spheres: Vec<Ball>,
}

/// How well weights do on held-out frames.
#[derive(Clone, Copy)]
struct Score {
    rmse: f64,
    mean: f64,
    truth: Option<f64>,
}

/// Trains on the even frames, judges on the odd ones.
///
/// # Errors
/// Fewer than two frames, or frames without measurements.
pub fn run(sequences: &[DepthFrames], effort: Effort) -> Result<Report, ExperimentError> {
    let mut table = Table::new(
        "held-out frames, all measured pixels",
        &[
            "data",
            "loss",
            "RMSE mm",
            "mean error mm",
            "RMSE / L1's",
            "RMSE to truth mm",
        ],
    );
    let mut curve = Curve {
        title: String::new(),
        x: "step".to_owned(),
        y: "RMSE on held-out frames, mm".to_owned(),
        ..Curve::default()
    };
    let mut ratios = [const { Vec::new() }; GOALS.len()];
    let mut data = Vec::new();
    for sequence in sequences {
        let (train, test) = sets(sequence)?;
        let covered = train
            .pixels
            .iter()
            .filter(|p| p.owner != UNASSIGNED)
            .count();
        data.push(format!(
            "{}: {} frames, contact distance {}, {} training and {} held-out pixels, {:.1} % covered by spheres",
            sequence.name,
            sequence.frames.len(),
            sequence.contact,
            train.pixels.len(),
            test.pixels.len(),
            100.0 * covered as f64 / train.pixels.len() as f64
        ));
        let mut plain: Vec<f64> = Vec::new();
        for (g, (goal, name)) in GOALS.into_iter().enumerate() {
            let descents: Vec<Vec<(usize, Score)>> = (0..effort.seeds)
                .into_par_iter()
                .map(|seed| descend(&train, &test, goal, seed))
                .collect();
            let last: Vec<Score> = descents.iter().filter_map(|d| Some(d.last()?.1)).collect();
            let of = |f: fn(&Score) -> f64| last.iter().map(f).collect::<Vec<f64>>();
            let rmse = of(|s| s.rmse);
            if goal == Goal::L1 {
                plain.clone_from(&rmse);
            }
            // seed by seed: the same first weights, the same batches
            let paired: Vec<f64> = rmse.iter().zip(&plain).map(|(r, p)| r / p).collect();
            let truth: Vec<f64> = last.iter().filter_map(|s| s.truth).collect();
            table.rows.push(vec![
                Cell::text(&*sequence.name),
                Cell::text(name),
                Cell::spread(&rmse.iter().map(|r| 1e3 * r).collect::<Vec<_>>()),
                Cell::spread(&of(|s| 1e3 * s.mean)),
                Cell::spread(&paired),
                Cell::spread(&truth.iter().map(|r| 1e3 * r).collect::<Vec<_>>()),
            ]);
            ratios[g].extend(paired);
            if std::ptr::eq(sequence, &sequences[0]) {
                let looks = descents.first().map_or(0, Vec::len);
                let mean = |k: usize| {
                    let sum: f64 = descents.iter().map(|d| d[k].1.rmse).sum();
                    (descents[0][k].0 as f64, 1e3 * sum / descents.len() as f64)
                };
                curve.title = format!("{}: error while training", sequence.name);
                curve.series.push(Series {
                    name: name.to_owned(),
                    points: (1..looks).map(mean).collect(),
                });
            }
        }
    }
    let mean = |g: usize| ratios[g].iter().sum::<f64>() / ratios[g].len().max(1) as f64;
    Ok(Report {
        experiment: "loss",
        claim: "Fig. 18: the SAINT loss lowers the error (RMSE 0.304 to 0.301)",
        method: "Predictor of 7 weights from one depth per 8x8 block to every pixel; Adam, 300 steps of 1024 pixels; spheres by the live fit of the training frames; even frames train, odd frames judge. Control: plain L1 on the pixels that spheres cover, with the same weight as the SAINT loss",
        data,
        seeds: effort.seeds,
        tables: vec![table],
        findings: vec![format!(
            "RMSE against plain L1 (mean over data and seeds): L1 + SAINT ×{:.4}, the mask control ×{:.4}; SAINT alone ×{:.4}, its control ×{:.4}. What the spheres themselves add is the quotient: ×{:.4} and ×{:.4}.",
            mean(1),
            mean(2),
            mean(3),
            mean(4),
            mean(1) / mean(2),
            mean(3) / mean(4)
        )],
        curve,
    })
}

/// Pixels to learn from and to judge by. The draw is the same for every seed.
fn sets(sequence: &DepthFrames) -> Result<(Set, Set), ExperimentError> {
    let camera = &sequence.camera;
    let options = FitOptions {
        contact_distance: sequence.contact,
        ..FitOptions::default()
    };
    let mut modeler = Modeler::new(camera, &options);
    let mut saint = SaintFrame::default();
    let (rays, validity) = (Rays::new(camera), Validity::new(camera));
    let mut chance = Chance::new(7);
    let mut sets = (Set::default(), Set::default());
    for (k, frame) in sequence.frames.iter().enumerate() {
        let set = if k % 2 == 0 { &mut sets.0 } else { &mut sets.1 };
        modeler.reset();
        modeler.model(frame, &mut saint, &|| false);
        let first = set.spheres.len() as u32;
        let ball = |(center, radius)| Ball { center, radius };
        let slots = saint.spheres.iter();
        set.spheres
            .extend(slots.map(|s| s.map_or(Ball::default(), |s| ball(s.center_radius()))));
        let unit = camera.depth_unit_m;
        let depth: Vec<f64> = frame
            .depth
            .iter()
            .map(|&raw| {
                if validity.accepts(raw) {
                    f64::from(raw) * unit
                } else {
                    0.0
                }
            })
            .collect();
        let coarse = Coarse::new(&depth, rays.width, rays.height);
        let truth = sequence.truth_m.as_ref().map(|t| &t[k]);
        for _ in 0..PIXELS {
            let at = chance.below(depth.len());
            let (x, y) = (at % rays.width, at / rays.width);
            let (measured, label) = (depth[at], saint.contacts.label(rays.width, x, y));
            let Some((base, guesses)) = coarse.guesses(x, y) else {
                continue;
            };
            if measured > 0.0 {
                set.pixels.push(Pixel {
                    ray: rays.point(x, y, 1.0),
                    base,
                    guesses,
                    measured,
                    truth: truth.map(|t| t[at]).filter(|z| *z > 0.0),
                    owner: if label < NO_SPHERE {
                        first + u32::from(label)
                    } else {
                        UNASSIGNED
                    },
                });
            }
        }
    }
    if sets.0.pixels.is_empty() || sets.1.pixels.is_empty() {
        return Err(ExperimentError::Data(format!(
            "{} has {} frames; the loss experiment needs at least two with measurements, one to train and one to judge",
            sequence.name,
            sequence.frames.len()
        )));
    }
    Ok(sets)
}

/// One depth of each block: the measured pixel nearest its middle; 0 where there is none.
struct Coarse {
    columns: usize,
    rows: usize,
    depth: Vec<f64>,
}

impl Coarse {
    fn new(depth: &[f64], width: usize, height: usize) -> Self {
        let (columns, rows) = (width.div_ceil(BLOCK), height.div_ceil(BLOCK));
        let mut coarse = Self {
            columns,
            rows,
            depth: vec![0.0; columns * rows],
        };
        let mut nearest = vec![f64::INFINITY; columns * rows];
        let middle = 0.5 * (BLOCK as f64 - 1.0);
        for (at, &z) in depth.iter().enumerate().filter(|(_, z)| **z > 0.0) {
            let (x, y) = (at % width, at / width);
            let cell = y / BLOCK * columns + x / BLOCK;
            let off = ((x % BLOCK) as f64 - middle).hypot((y % BLOCK) as f64 - middle);
            if off < nearest[cell] {
                (nearest[cell], coarse.depth[cell]) = (off, z);
            }
        }
        coarse
    }

    /// The bilinear guess and the others, metres; `None` where no sample is near.
    fn guesses(&self, x: usize, y: usize) -> Option<(f64, [f64; GUESSES])> {
        let place = |v: usize| (v as f64 + 0.5) / BLOCK as f64 - 0.5;
        let (px, py) = (place(x), place(y));
        let mut near: Vec<(f64, f64, f64)> = Vec::with_capacity(9);
        for row in (y / BLOCK).saturating_sub(1)..(y / BLOCK + 2).min(self.rows) {
            for column in (x / BLOCK).saturating_sub(1)..(x / BLOCK + 2).min(self.columns) {
                let z = self.depth[row * self.columns + column];
                if z > 0.0 {
                    near.push((column as f64 - px, row as f64 - py, z));
                }
            }
        }
        let nearest = near
            .iter()
            .min_by(|a, b| a.0.hypot(a.1).total_cmp(&b.0.hypot(b.1)))?
            .2;
        let (mut sum, mut weight) = (0.0, 0.0);
        for (dx, dy, z) in &near {
            let w = (1.0 - dx.abs()).max(0.0) * (1.0 - dy.abs()).max(0.0);
            (sum, weight) = (sum + w * z, weight + w);
        }
        let base = if weight > 1e-6 { sum / weight } else { nearest };
        let mut depths: Vec<f64> = near.iter().map(|n| n.2).collect();
        depths.sort_by(f64::total_cmp);
        let n = depths.len();
        let mean = depths.iter().sum::<f64>() / n as f64;
        let plane = plane_at_zero(&near).unwrap_or(base);
        let guesses = [
            nearest,
            mean,
            depths[n / 2],
            depths[0],
            depths[n - 1],
            plane,
        ];
        Some((base, guesses))
    }
}

/// Depth at (0, 0) of the plane (in inverse depth) through the samples by least squares; `None`
/// for fewer than four, or where it leaves their range by more than half.
fn plane_at_zero(near: &[(f64, f64, f64)]) -> Option<f64> {
    if near.len() < 4 {
        return None;
    }
    let row = |n: &(f64, f64, f64)| DVec3::new(n.0, n.1, 1.0);
    let mut normal = glam::DMat3::ZERO;
    let mut right = DVec3::ZERO;
    for n in near {
        let r = row(n);
        normal += glam::DMat3::from_cols(r * r.x, r * r.y, r * r.z);
        right += r / n.2;
    }
    if normal.determinant().abs() < 1e-6 {
        return None;
    }
    let z = 1.0 / (normal.inverse() * right).z;
    let low = near.iter().map(|n| n.2).fold(f64::MAX, f64::min);
    let high = near.iter().map(|n| n.2).fold(0.0, f64::max);
    (z > 0.5 * low && z < 1.5 * high).then_some(z)
}

/// Gradient descent from random weights; the scores on `test` on the way.
fn descend(train: &Set, test: &Set, goal: Goal, seed: u64) -> Vec<(usize, Score)> {
    let mut chance = Chance::new(seed);
    let mut weights = [0.0; WEIGHTS];
    for w in &mut weights {
        *w = 0.1 * chance.normal();
    }
    let (mut first, mut second) = ([0.0; WEIGHTS], [0.0; WEIGHTS]);
    let mut scores = vec![(0, score(test, &weights))];
    let mut gradient = LossGradient::default();
    for step in 1..=STEPS {
        let batch: Vec<Pixel> = (0..BATCH)
            .map(|_| train.pixels[chance.below(train.pixels.len())])
            .collect();
        let slopes = slopes(&batch, &train.spheres, &weights, goal, &mut gradient);
        // Adam (Kingma & Ba, ICLR 2015), the step shrinking to nothing
        let rate = 0.03 * (1.0 - (step - 1) as f64 / STEPS as f64);
        for k in 0..WEIGHTS {
            first[k] = 0.9 * first[k] + 0.1 * slopes[k];
            second[k] = 0.99 * second[k] + 0.01 * slopes[k] * slopes[k];
            let (m, v) = (
                first[k] / (1.0 - 0.9f64.powi(step as i32)),
                second[k] / (1.0 - 0.99f64.powi(step as i32)),
            );
            // the bias scales every depth: it needs a finer step than the mixture
            let size = if k < GUESSES { rate } else { 0.1 * rate };
            weights[k] -= size * m / (v.sqrt() + 1e-9);
        }
        if step % LOOK == 0 {
            scores.push((step, score(test, &weights)));
        }
    }
    scores
}

/// Slopes of the goal to the weights over a batch.
fn slopes(
    batch: &[Pixel],
    spheres: &[Ball],
    weights: &[f64; WEIGHTS],
    goal: Goal,
    gradient: &mut LossGradient,
) -> [f64; WEIGHTS] {
    let predicted: Vec<f64> = batch.iter().map(|p| p.predict(weights)).collect();
    // slope of the goal to each predicted depth
    let mut to_depth = vec![0.0; batch.len()];
    let covered = batch
        .iter()
        .filter(|p| p.owner != UNASSIGNED)
        .count()
        .max(1) as f64;
    let all = matches!(goal, Goal::L1 | Goal::L1AndSaint | Goal::L1AndMask);
    let masked = matches!(goal, Goal::L1AndMask | Goal::Mask);
    for ((slope, pixel), z) in to_depth.iter_mut().zip(batch).zip(&predicted) {
        let side = Penalty::Absolute.slope(z - pixel.measured);
        if all {
            *slope += side / batch.len() as f64;
        }
        if masked && pixel.owner != UNASSIGNED {
            *slope += side / covered;
        }
    }
    if matches!(goal, Goal::L1AndSaint | Goal::Saint) {
        let points: Vec<DVec3> = batch
            .iter()
            .zip(&predicted)
            .map(|(p, z)| p.ray * *z)
            .collect();
        let owners: Vec<u32> = batch.iter().map(|p| p.owner).collect();
        let loss = SaintLoss {
            points: &points,
            spheres,
            owners: Owners::Given(&owners),
            ..SaintLoss::default()
        };
        // a descent that ran away has no slope to follow
        if loss.gradient(gradient).is_ok() {
            for ((slope, pixel), push) in to_depth.iter_mut().zip(batch).zip(&gradient.points) {
                *slope += push.dot(pixel.ray);
            }
        }
    }
    let mut slopes = [0.0; WEIGHTS];
    for (pixel, slope) in batch.iter().zip(&to_depth) {
        for (k, sum) in slopes.iter_mut().enumerate() {
            *sum += slope * pixel.slope(k);
        }
    }
    slopes
}

fn score(test: &Set, weights: &[f64; WEIGHTS]) -> Score {
    let n = test.pixels.len() as f64;
    let (mut squares, mut sum) = (0.0, 0.0);
    let (mut true_squares, mut true_count) = (0.0, 0.0);
    for pixel in &test.pixels {
        let z = pixel.predict(weights);
        squares += (z - pixel.measured).powi(2);
        sum += (z - pixel.measured).abs();
        if let Some(truth) = pixel.truth {
            true_squares += (z - truth).powi(2);
            true_count += 1.0;
        }
    }
    Score {
        rmse: (squares / n).sqrt(),
        mean: sum / n,
        truth: (true_count > 0.0).then(|| (true_squares / true_count).sqrt()),
    }
}

#[cfg(test)]
#[path = "loss_tests.rs"]
mod tests;
