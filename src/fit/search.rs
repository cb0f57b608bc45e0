//! The search for the one sphere that most of the remaining points touch.
//!
//! Paper 3.2 draws random points and keeps the best fit. Three deviations, each measured on
//! scanned objects at 1 mm contact distance to save spheres or time:
//! - the four points come from a window of random width on a Morton curve, as points drawn from
//!   the whole object seldom share a surface;
//! - hypotheses are scored on a coarse sample first, the short list on a fine one;
//! - runners-up stay candidates for the next sphere: what else they touch is still there;
//! - the winner is refitted by moments, then bent within the contact distance: least squares
//!   minimises distance, but what counts is the number of contacts (a tenth fewer spheres for
//!   the same points);
//! - the last fifth of the points gets more trials: it takes two thirds of the spheres.

use super::cloud::CloudSphere;
use super::remaining::Remaining;
use glam::DVec3;

/// Trials for one sphere. The paper gives no number.
#[derive(Clone, Copy, Debug)]
struct Trials {
    /// Hypotheses drawn.
    hypotheses: usize,
    /// Bends of the winner.
    bends: usize,
    /// Hypotheses that are refitted.
    refitted: usize,
}

/// While most points remain, large spheres are easy to find.
const EARLY: Trials = Trials {
    hypotheses: 200,
    bends: 200,
    refitted: 1,
};
/// Below this share of the points remaining, LATE holds.
const LATE_SHARE: f64 = 0.2;
const LATE: Trials = Trials {
    hypotheses: 800,
    bends: 400,
    refitted: 2,
};
/// Points of the coarse sample, scored for every hypothesis.
const COARSE_POINTS: usize = 256;
/// Points of the fine sample, scored for the short list.
const FINE_POINTS: usize = 1536;
/// Points near the winner, scored for its bends.
const NEAR_POINTS: usize = 1600;
/// How near, contact distances.
const NEAR: f32 = 4.0;
/// Hypotheses that reach the fine sample, and stay for the next sphere.
const SHORT_LIST: usize = 12;
/// Refits by moments per hypothesis, at most.
const REFIT_ROUNDS: usize = 4;
/// First, and last, length of a bend, contact distances.
const BEND: (f64, f64) = (0.5, 0.003);
/// A bend that gains contacts lengthens the next ones so, any other shortens them.
const LONGER: f64 = 1.5;
const SHORTER: f64 = 0.975;

/// splitmix64 (Steele, Lea & Flood, OOPSLA 2014): one seed, one stream.
#[derive(Clone, Debug)]
pub(crate) struct Draw(u64);

impl Draw {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number below `n`, which must be above 0.
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.next()) * n as u128) >> 64) as usize
    }

    /// Uniform in −1 to 1.
    pub fn signed_unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

/// A sphere and the points of a sample that touch it.
#[derive(Clone, Copy, Debug)]
struct Scored {
    score: usize,
    sphere: CloudSphere,
}

/// Buffers of the search.
#[derive(Debug, Default)]
pub(crate) struct SphereSearch {
    /// Points of the whole cloud.
    total: usize,
    coarse: Remaining,
    fine: Remaining,
    near: Remaining,
    drawn: Vec<Scored>,
    /// Runners-up of the sphere before.
    short_list: Vec<Scored>,
    marks: Vec<u8>,
    places: Vec<u32>,
}

impl SphereSearch {
    /// Forgets the cloud before; the next has `total` points.
    pub fn begin(&mut self, total: usize) {
        self.total = total;
        self.short_list.clear();
    }

    /// A sphere that many of `points` touch. The points must follow a space-filling curve.
    /// `None` where no four of those drawn span a surface.
    pub fn best(&mut self, points: &Remaining, draw: &mut Draw) -> Option<CloudSphere> {
        if points.len() < 4 {
            return None;
        }
        let late = (points.len() as f64) < LATE_SHARE * self.total as f64;
        let trials = if late { LATE } else { EARLY };
        self.fine.sample(points, points.len() / FINE_POINTS);
        self.coarse
            .sample(&self.fine, self.fine.len() / COARSE_POINTS);
        self.drawn.clear();
        for Scored { sphere, .. } in self.short_list.drain(..) {
            let score = self.coarse.touching(&sphere);
            keep_best(&mut self.drawn, Scored { score, sphere }, SHORT_LIST);
        }
        for _ in 0..trials.hypotheses {
            let Some(sphere) = hypothesis(points, draw) else {
                continue;
            };
            let score = self.coarse.touching(&sphere);
            keep_best(&mut self.drawn, Scored { score, sphere }, SHORT_LIST);
        }
        for &Scored { sphere, .. } in &self.drawn {
            let score = self.fine.touching(&sphere);
            keep_best(&mut self.short_list, Scored { score, sphere }, SHORT_LIST);
        }
        let mut best: Option<(usize, Scored)> = None;
        for place in 0..self.short_list.len().min(trials.refitted) {
            let fitted = self.refitted(self.short_list[place]);
            self.short_list[place] = fitted;
            if best.is_none_or(|(_, b)| fitted.score > b.score) {
                best = Some((place, fitted));
            }
        }
        let (place, best) = best?;
        self.short_list.remove(place);
        self.near
            .near(points, &best.sphere, NEAR, NEAR_POINTS, &mut self.places);
        Some(self.bent(best, trials.bends, draw).sphere)
    }

    /// Bends a sphere over some `places` of `points`; `None` where it touches no more of them
    /// than `before`.
    pub fn bent_over(
        &mut self,
        points: &Remaining,
        places: &[u32],
        sphere: &CloudSphere,
        before: usize,
        bends: usize,
        draw: &mut Draw,
    ) -> Option<CloudSphere> {
        self.near.pick(points, places);
        let start = Scored {
            score: before,
            sphere: *sphere,
        };
        let bent = self.bent(start, bends, draw);
        (bent.score > before).then_some(bent.sphere)
    }

    /// Refits by moments while that gains contacts. The first round takes a wider band in, so
    /// that the sphere can grow along the surface.
    fn refitted(&mut self, start: Scored) -> Scored {
        let mut best = start;
        for round in 0..REFIT_ROUNDS {
            let widen = if round == 0 { 1.5 } else { 1.0 };
            let scratch = (&mut self.marks, &mut self.places);
            let moments = self.fine.moments(&best.sphere, widen, scratch);
            let Some(sphere) = moments.fit().map(|f| f.sphere) else {
                break;
            };
            let score = self.fine.touching(&sphere);
            if score > best.score && self.fine.resolves(&sphere) {
                best = Scored { score, sphere };
            } else if round > 0 {
                break;
            }
        }
        best
    }

    /// Shifts, tilts and bends the sphere at random; what gains contacts stays. Steps
    /// grow with success and shrink without (Rechenberg's rule for a (1+1) evolution strategy).
    fn bent(&mut self, start: Scored, bends: usize, draw: &mut Draw) -> Scored {
        self.places.clear();
        let near = &self.near;
        near.list_touching(&start.sphere, &mut self.marks, &mut self.places);
        let Some(shape) = Shape::new(near, &self.places, &start.sphere) else {
            return start;
        };
        let mut best = Scored {
            score: self.places.len(),
            ..start
        };
        let tau = f64::from(near.tau(self.places[0] as usize));
        let mut step = BEND.0 * tau;
        for _ in 0..bends {
            if step < BEND.1 * tau {
                break;
            }
            // two uniform numbers: mostly short
            let mut amount = || step * (draw.signed_unit() + draw.signed_unit());
            let amounts = [amount(), amount(), amount(), amount()];
            let Some(sphere) = shape.bend(&best.sphere, amounts) else {
                continue;
            };
            if !near.resolves(&sphere) {
                step *= SHORTER;
                continue;
            }
            let score = near.touching(&sphere);
            // more, not as many: a plateau is no reason to leave the least-squares fit
            if score > best.score {
                step *= LONGER;
                best = Scored { score, sphere };
            } else {
                step *= SHORTER;
            }
        }
        best
    }
}

/// Where a sphere's contacts lie: the scale of what bends it.
#[derive(Clone, Copy, Debug)]
struct Shape {
    center: DVec3,
    /// Along the patch and across it, each divided by the spread of the contacts that way.
    tilts: [DVec3; 2],
    /// One over the mean square distance from the centre.
    bend: f64,
}

impl Shape {
    /// Of the points in `places`; `None` for fewer than five.
    fn new(points: &Remaining, places: &[u32], sphere: &CloudSphere) -> Option<Self> {
        if places.len() < 5 {
            return None;
        }
        let per_point = 1.0 / places.len() as f64;
        let at = || places.iter().map(|&i| points.at(i as usize));
        let center = at().sum::<DVec3>() * per_point;
        let on = sphere.project(center);
        let normal = (sphere.curvature * on + sphere.normal).try_normalize()?;
        let (a, b) = normal.any_orthonormal_pair();
        let (mut aa, mut ab, mut bb, mut square) = (0.0, 0.0, 0.0, 0.0);
        for p in at() {
            let r = p - center;
            let (u, v) = (r.dot(a), r.dot(b));
            aa += u * u;
            ab += u * v;
            bb += v * v;
            square += r.length_squared();
        }
        let (sin, cos) = (0.5 * (2.0 * ab).atan2(aa - bb)).sin_cos();
        let spread = |c: f64, s: f64| {
            let variance = (aa * c * c + 2.0 * ab * s * c + bb * s * s) * per_point;
            variance.max(1e-30).sqrt()
        };
        Some(Self {
            center,
            tilts: [
                (cos * a + sin * b) / spread(cos, sin),
                (cos * b - sin * a) / spread(-sin, cos),
            ],
            bend: 1.0 / (square * per_point).max(1e-30),
        })
    }

    /// The sphere moved by about these amounts (metres) at the patch's rim: a shift, two tilts
    /// and a bend.
    fn bend(&self, sphere: &CloudSphere, amounts: [f64; 4]) -> Option<CloudSphere> {
        let [shift, along, across, bend] = amounts;
        let c = self.center;
        let tilt = along * self.tilts[0] + across * self.tilts[1];
        let bend = bend * self.bend;
        CloudSphere::normalised(
            sphere.curvature + 2.0 * bend,
            sphere.normal + tilt - 2.0 * bend * c,
            sphere.offset + shift - tilt.dot(c) + bend * (c.length_squared() - 1.0 / self.bend),
        )
    }
}

/// The sphere through four points of a window of random place and width (every octave from 8
/// points to all alike).
fn hypothesis(points: &Remaining, draw: &mut Draw) -> Option<CloudSphere> {
    let n = points.len();
    let octaves = (n.ilog2() as usize).saturating_sub(2).max(1);
    let width = (n >> draw.below(octaves)).max(8).min(n);
    let from = draw.below(n).saturating_sub(width / 2).min(n - width);
    let mut pick = || points.at(from + draw.below(width));
    let four = [pick(), pick(), pick(), pick()];
    CloudSphere::through(four).filter(|s| points.resolves(s))
}

/// Inserts into a list of at most `limit`, best first; the earlier of two equals stays ahead.
fn keep_best(list: &mut Vec<Scored>, new: Scored, limit: usize) {
    let place = list.partition_point(|old| old.score >= new.score);
    if place < limit {
        list.truncate(limit - 1);
        list.insert(place, new);
    }
}
