//! The search for the one sphere that most of the remaining points touch.
//!
//! Paper 3.2 draws random points and keeps the best fit. Three deviations, each measured on
//! scanned objects at 1 mm contact distance to save spheres or time:
//! - the four points come from a window of random width on a Morton curve, as points drawn from
//!   the whole object seldom share a surface;
//! - hypotheses are scored on a coarse sample first, the short list on a fine one;
//! - the winner is refitted by moments, then bent by random offsets within the contact distance:
//!   least squares minimises distance, but what counts is the number of contacts (a tenth fewer
//!   spheres for the same points).

use super::cloud::CloudSphere;
use super::remaining::Remaining;

/// Hypotheses per sphere. The paper gives no number.
const HYPOTHESES: usize = 400;
/// Points of the coarse sample, scored for every hypothesis.
const COARSE_POINTS: usize = 256;
/// Points of the fine sample, scored for the short list and all that follows.
const FINE_POINTS: usize = 1536;
/// The fine sample is never thinner than one point in this many.
const MAX_STRIDE: usize = 64;
/// Hypotheses that reach the fine sample.
const SHORT_LIST: usize = 12;
/// Hypotheses that are refitted.
const REFITTED: usize = 1;
/// Refits by moments per hypothesis, at most.
const REFIT_ROUNDS: usize = 4;
/// Random bends tried on the winner.
const BENDS: usize = 150;
/// Bends without gain after which they become smaller.
const PATIENCE: usize = 12;

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
    coarse: Remaining,
    fine: Remaining,
    drawn: Vec<Scored>,
    short_list: Vec<Scored>,
    marks: Vec<u8>,
    touching: Vec<u32>,
}

impl SphereSearch {
    /// A sphere that many of `points` touch. The points must follow a space-filling curve.
    /// `None` where no four of those drawn span a surface.
    pub fn best(&mut self, points: &Remaining, draw: &mut Draw) -> Option<CloudSphere> {
        if points.len() < 4 {
            return None;
        }
        self.fine
            .sample(points, (points.len() / FINE_POINTS).min(MAX_STRIDE));
        self.coarse
            .sample(&self.fine, self.fine.len() / COARSE_POINTS);
        self.drawn.clear();
        for _ in 0..HYPOTHESES {
            let Some(sphere) = hypothesis(points, draw) else {
                continue;
            };
            let score = self.coarse.touching(&sphere);
            keep_best(&mut self.drawn, Scored { score, sphere }, SHORT_LIST);
        }
        self.short_list.clear();
        for &Scored { sphere, .. } in &self.drawn {
            let score = self.fine.touching(&sphere);
            keep_best(&mut self.short_list, Scored { score, sphere }, REFITTED);
        }
        let mut best: Option<Scored> = None;
        for &start in &self.short_list {
            let fitted = self.refitted(start);
            if best.is_none_or(|b| fitted.score > b.score) {
                best = Some(fitted);
            }
        }
        Some(self.bent(best?, draw).sphere)
    }

    /// Refits by moments while that gains contacts. The first round takes a wider band in, so
    /// that the sphere can grow along the surface.
    fn refitted(&self, start: Scored) -> Scored {
        let mut best = start;
        for round in 0..REFIT_ROUNDS {
            let widen = if round == 0 { 1.5 } else { 1.0 };
            let moments = self.fine.moments(&best.sphere, widen);
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

    /// Spheres through four of the contacts, each moved along its normal within the contact
    /// distance: a random descent on the number of contacts itself.
    fn bent(&mut self, start: Scored, draw: &mut Draw) -> Scored {
        let mut best = start;
        let mut reach = 0.75;
        let mut without_gain = 0;
        self.list_touching(&best.sphere);
        for _ in 0..BENDS {
            if self.touching.len() < 5 {
                break;
            }
            let mut moved = || {
                let i = self.touching[draw.below(self.touching.len())] as usize;
                let on = best.sphere.project(self.fine.at(i));
                let normal = best.sphere.curvature * on + best.sphere.normal;
                on + normal * (reach * draw.signed_unit() * f64::from(self.fine.tau(i)))
            };
            let four = [moved(), moved(), moved(), moved()];
            let Some(sphere) = CloudSphere::through(four).filter(|s| self.fine.resolves(s)) else {
                continue;
            };
            let score = self.fine.touching(&sphere);
            if score > best.score {
                best = Scored { score, sphere };
                self.list_touching(&sphere);
                without_gain = 0;
            } else {
                without_gain += 1;
                if without_gain % PATIENCE == 0 {
                    reach *= 0.7;
                }
            }
        }
        best
    }

    fn list_touching(&mut self, sphere: &CloudSphere) {
        self.touching.clear();
        self.fine
            .list_touching(sphere, &mut self.marks, &mut self.touching);
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
