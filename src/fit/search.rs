//! The search for the one sphere that most of the remaining points touch.
//!
//! Paper 3.2 draws random points and keeps the best fit. Deviations, each measured on scanned
//! objects at 1 mm contact distance to save spheres or time:
//! - the four points come from a window of random width on a Morton curve, as points drawn from
//!   the whole object seldom share a surface;
//! - hypotheses are scored on a coarse sample first, the short list on a fine one;
//! - runners-up stay candidates for the next sphere: what else they touch is still there;
//! - some of the short list are refitted by moments, and the winner is bent (`fit/bend.rs`);
//! - the last fifth of the points gets more trials: it takes two thirds of the spheres.

use super::bend::Bends;
use super::block_set::BlockSet;
use super::cloud::CloudSphere;
use super::draw::Draw;
use super::hypothesis::{self, Hypotheses};
use super::lanes::Lanes;
use super::ordered::Ordered;
use super::remaining::Remaining;

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
    hypotheses: 400,
    bends: 400,
    refitted: 1,
};
/// Below this share of the points remaining, LATE holds.
const LATE_SHARE: f64 = 0.2;
const LATE: Trials = Trials {
    hypotheses: 400,
    bends: 200,
    refitted: 8,
};
/// More hypotheses then for each sphere found: the more surfaces a cloud has, the seldomer four
/// points share one.
const PER_SPHERE: usize = 14;
/// Points of the coarse sample, scored for every hypothesis.
const COARSE_POINTS: usize = 256;
/// Points of the fine sample, scored for the short list.
const FINE_POINTS: usize = 1536;
/// Points near the winner, scored for its bends.
const NEAR_POINTS: usize = 1600;
/// How near, contact distances.
const NEAR: f32 = 4.0;
/// Hypotheses that reach the fine sample, and stay for the next sphere.
const SHORT_LIST: usize = 24;
/// Refits by moments per hypothesis, at most.
const REFIT_ROUNDS: usize = 2;

/// A sphere and the points of a sample that touch it.
#[derive(Clone, Copy, Debug)]
struct Scored {
    score: usize,
    sphere: CloudSphere,
}

/// Buffers of the search.
#[derive(Debug, Default)]
pub(crate) struct SphereSearch {
    coarse: Lanes,
    fine: Lanes,
    bends: Bends,
    /// Points near the winner, all of them.
    around: BlockSet,
    drawn: Vec<Scored>,
    /// Runners-up of the sphere before.
    short_list: Vec<Scored>,
    marks: Vec<u8>,
    places: Vec<u32>,
    sample: Vec<u32>,
}

impl SphereSearch {
    /// Forgets the cloud before.
    pub fn begin(&mut self) {
        self.short_list.clear();
    }

    /// A sphere that many of the `remaining` points touch, after `found` others. `None` where no
    /// four of those drawn span a surface.
    pub fn best(
        &mut self,
        points: &Ordered,
        remaining: &Remaining,
        found: usize,
        draw: &mut Draw,
    ) -> Option<CloudSphere> {
        let left = remaining.places();
        if left.len() < 4 {
            return None;
        }
        let late = (left.len() as f64) < LATE_SHARE * points.len() as f64;
        let mut trials = if late { LATE } else { EARLY };
        if late {
            trials.hypotheses += PER_SPHERE * found;
        }
        every(left.len() / FINE_POINTS, left, &mut self.sample);
        self.fine.pick(&points.lanes, &self.sample);
        every(
            self.sample.len() / COARSE_POINTS,
            &self.sample,
            &mut self.places,
        );
        self.coarse.pick(&points.lanes, &self.places);
        self.drawn.clear();
        for Scored { sphere, .. } in self.short_list.drain(..) {
            let score = self.coarse.touching(&sphere);
            keep_best(&mut self.drawn, Scored { score, sphere }, SHORT_LIST);
        }
        for _ in 0..trials.hypotheses / hypothesis::LANES {
            let made = Hypotheses::draw(&points.lanes, left, draw);
            for lane in 0..hypothesis::LANES {
                let Some(surface) = made.get(lane, points.lanes.curvature_limit()) else {
                    continue;
                };
                let score = self.coarse.touching_surface(&surface);
                if enters(score, &self.drawn, SHORT_LIST)
                    && let Some(sphere) = surface.sphere()
                {
                    keep_best(&mut self.drawn, Scored { score, sphere }, SHORT_LIST);
                }
            }
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
        points.list_near(&best.sphere, NEAR, &mut self.around);
        remaining.keep(&mut self.around);
        self.places.clear();
        self.around.list(&mut self.places);
        let stride = self.places.len().div_ceil(NEAR_POINTS);
        every(stride, &self.places, &mut self.sample);
        self.bends.refill(&points.lanes, &self.sample);
        let bent = self.bends.best(&best.sphere, trials.bends, draw);
        Some(bent.unwrap_or(best.sphere))
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
}

/// Every `stride`-th of the places, into `sample`.
fn every(stride: usize, places: &[u32], sample: &mut Vec<u32>) {
    sample.clear();
    sample.extend(places.iter().step_by(stride.max(1)));
}

/// True where a newcomer of this score enters a list of at most `limit`.
fn enters(score: usize, list: &[Scored], limit: usize) -> bool {
    list.get(limit - 1).is_none_or(|last| score > last.score)
}

/// Inserts into a list of at most `limit`, best first; the earlier of two equals stays ahead.
fn keep_best(list: &mut Vec<Scored>, new: Scored, limit: usize) {
    let place = list.partition_point(|old| old.score >= new.score);
    if place < limit {
        list.truncate(limit - 1);
        list.insert(place, new);
    }
}
