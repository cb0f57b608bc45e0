//! What coding a frame costs, learnt apart from how well the frame was modelled.
//!
//! Pixels on no sphere are dearer than the rest, by how much is a matter of the scene: walls and
//! furniture without a sphere take three times as long as with one, noise 13 times, noise behind a mask
//! of noise 30 times (VGA). Were it not learnt apart, a fit cut short would make coding dear, which leaves
//! the next fit less time, and so on down.

use super::budget::{CostModel, leaves_much};
use std::time::Duration;

/// What a pixel is taken to cost before it was measured: more than it mostly does.
const FIRST_NS: u64 = 25;
/// What a pixel on no sphere is taken to cost beyond its own, in pixels, before it was measured.
const FIRST_LEFT: f64 = 10.0;
/// Weight of a measurement of that which is below the estimate; one above it is believed at once, since
/// the frame was most likely late.
const FALL: f64 = 0.125;
/// What a frame that was hurried leaves of the estimate: a whole one is tried again after a hundred or
/// more.
const FADE: f64 = 0.998;

/// What coding frames costs.
#[derive(Clone, Copy, Debug)]
pub struct CodingCost {
    pixel: CostModel,
    /// What a pixel on no sphere costs beyond its own, in pixels.
    left: f64,
}

impl Default for CodingCost {
    fn default() -> Self {
        Self {
            pixel: CostModel::default(),
            left: FIRST_LEFT,
        }
    }
}

impl CodingCost {
    fn work(&self, pixels: u64, left: u64) -> u64 {
        pixels + (self.left * left as f64) as u64
    }

    /// Takes a measurement: coding `pixels`, of which `left` were on no sphere, took `spent`.
    pub fn observe(&mut self, pixels: u64, left: u64, spent: Duration) {
        let one = self.pixel.predict(pixels);
        if one.is_zero() || !leaves_much(pixels, left) {
            self.pixel.observe(self.work(pixels, left), spent);
            return;
        }
        let beyond = spent.saturating_sub(one).as_secs_f64() / one.as_secs_f64();
        let measured = beyond * pixels as f64 / left as f64;
        let weight = if measured > self.left { 1.0 } else { FALL };
        self.left += weight * (measured - self.left);
    }

    /// What coding such a frame will cost; zero before the first measurement.
    #[must_use]
    pub fn predict(&self, pixels: u64, left: u64) -> Duration {
        self.pixel.predict(self.work(pixels, left))
    }

    /// The same with a guess before the first measurement, so that a stream that begins with noise is
    /// not late from the start.
    #[must_use]
    pub fn predict_or_guess(&self, pixels: u64, left: u64) -> Duration {
        match self.predict(pixels, left) {
            Duration::ZERO => Duration::from_nanos(self.work(pixels, left) * FIRST_NS),
            known => known,
        }
    }

    /// Forgets a little after a frame that was not coded, or coded in a hurry though little was `left`:
    /// what is feared may have been a moment's.
    pub fn relax(&mut self) {
        self.pixel.relax();
    }

    /// The same after a hurried frame that left much.
    pub fn fade(&mut self) {
        self.left *= FADE;
    }
}

#[cfg(test)]
mod tests {
    use super::super::budget::{Coding, likely_left};
    use super::*;

    fn ms(n: u64) -> Duration {
        Duration::from_millis(n)
    }

    #[test]
    fn noise_is_foreseen_before_anything_was_measured() {
        let mut cost = CodingCost::default();
        let coding = Coding {
            whole: cost.predict_or_guess(300_000, 300_000),
            plain: Duration::ZERO,
        };
        assert!(coding.hurries(ms(25), true, false));
        assert_eq!(cost.predict(300_000, 300_000), Duration::ZERO);
        cost.observe(1000, 0, ms(1));
        assert_eq!(cost.predict_or_guess(10, 5), cost.predict(10, 5));
    }

    #[test]
    fn a_fit_cut_short_does_not_shorten_the_next_one() {
        let (pixels, left) = (300_000, 60_000);
        let mut cost = CodingCost::default();
        cost.observe(pixels, 0, ms(8));
        let calm = cost.predict(pixels, likely_left(pixels, 0));
        // the fit was cut: a fifth of the pixels are coded plainly, in three times the time
        cost.observe(pixels, left, ms(24));
        let after = cost.predict(pixels, likely_left(pixels, left));
        assert!(
            after.abs_diff(calm) < Duration::from_micros(10),
            "{after:?}, {calm:?}"
        );
        // noise: no fit helps, so its cost is expected again
        let noise = cost.predict(pixels, likely_left(pixels, 299_000));
        assert!(noise > 10 * calm, "{noise:?}, {calm:?}");
    }

    #[test]
    fn what_noise_takes_is_known_from_its_first_frame_on() {
        let pixels = 300_000;
        for (share, takes) in [(1, 30), (2, 40), (4, 12), (1, 200)] {
            let mut cost = CodingCost::default();
            cost.observe(pixels, 0, ms(3));
            let left = pixels / share;
            cost.observe(pixels, left, ms(takes));
            // below the first guess it falls slowly
            let expected = cost.predict(pixels, left);
            assert!(expected > ms(takes) * 99 / 100, "{share}: {expected:?}");
            if takes > 3 + 30 / share {
                assert!(expected < ms(takes) * 101 / 100, "{share}: {expected:?}");
            }
            assert_eq!(cost.predict(pixels, 0), ms(3));
            let mut hurried = 0;
            while cost.predict(pixels, left) > expected / 2 {
                cost.fade();
                hurried += 1;
            }
            assert!(hurried > 300, "{hurried}");
        }
    }
}
