//! Rate control: the contact distance that keeps a stream at a bit rate.
//!
//! Bits fall with the contact distance, by about its power of −3/4 (Kinect and RealSense
//! sequences; by less where little but the mask is left): the controller learns it. Once for each key-frame interval the controller compares the bits since its last
//! decision with the target and scales the distance. A decision takes effect [`DELAY`] frames
//! later, at a frame both the fit and the encoder count to, so that the same input gives the same
//! bytes with any number of threads.

/// Frames from a decision to its effect: more than the pipeline holds.
pub const DELAY: u64 = 8;
/// Frames before the first decision.
const FIRST: u64 = 3;
/// The distance's power in the bits: usual, least and most.
const POWER: f64 = 0.75;
const POWERS: (f64, f64) = (0.25, 1.2);
/// The power is learnt from changes of the distance of this factor or more.
const TELLING: f64 = 1.15;
/// Least and greatest change of the distance by one decision, and at all.
const STEP: (f64, f64) = (0.4, 2.5);
const RANGE: (f64, f64) = (1.0 / 16.0, 32.0);
/// Bits over or under the target are paid back over so many seconds.
const PAYBACK_S: f64 = 2.0;

/// From frame `from` on (counted from 0), the contact distance is `scale` times the usual one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// First frame it holds for.
    pub from: u64,
    /// Factor of the contact distance.
    pub scale: f64,
}

/// The controller of one stream. Pure: it knows what it is told.
#[derive(Clone, Debug)]
pub struct RateControl {
    bits_per_s: f64,
    every: u64,
    scale: f64,
    power: f64,
    /// Scale and rate at the last decision.
    before: Option<(f64, f64)>,
    frames: u64,
    next: u64,
    /// When the distance last changed, and what came since.
    since: u64,
    key_bits: f64,
    p_bits: f64,
    /// Time stamps of the first and last frame since, seconds.
    first_s: f64,
    last_s: f64,
    /// Bits above the target, all in all.
    excess: f64,
    pending: Option<Decision>,
}

impl RateControl {
    /// A controller that aims at `bits_per_s` with a key frame every so many frames.
    #[must_use]
    pub fn new(bits_per_s: f64, keyframe_every: u32) -> Self {
        Self {
            bits_per_s,
            every: u64::from(keyframe_every).max(FIRST + DELAY),
            scale: 1.0,
            power: POWER,
            before: None,
            frames: 0,
            next: FIRST,
            since: 0,
            key_bits: 0.0,
            p_bits: 0.0,
            first_s: 0.0,
            last_s: 0.0,
            excess: 0.0,
            pending: None,
        }
    }

    /// Takes the next frame, of this time stamp and size; returns a decision where one is due.
    pub fn observe(&mut self, time_ns: i64, bytes: usize) -> Option<Decision> {
        let (time_s, bits) = (time_ns as f64 * 1e-9, bytes as f64 * 8.0);
        if let Some(decision) = self.pending.filter(|d| d.from <= self.frames) {
            self.pending = None;
            self.scale = decision.scale;
            self.since = self.frames;
        }
        if self.since == self.frames {
            (self.key_bits, self.p_bits, self.first_s) = (bits, 0.0, time_s);
        } else {
            self.p_bits += bits;
            // frames lost on the way give their time to the others
            let passed = (time_s - self.last_s).clamp(0.0, 1.0);
            let most = self.bits_per_s * PAYBACK_S;
            self.excess = (self.excess + bits - self.bits_per_s * passed).clamp(-most, most);
        }
        self.last_s = time_s;
        let index = self.frames;
        self.frames += 1;
        let passed = (index - self.since) as f64;
        if index < self.next || passed < 2.0 || self.last_s <= self.first_s {
            return None;
        }
        // what a whole key-frame interval takes at this distance
        let p_frames = self.every as f64 - 1.0;
        let interval_s = (self.last_s - self.first_s) / passed * self.every as f64;
        let rate = (self.key_bits + self.p_bits / passed * p_frames) / interval_s;
        let aim = self.bits_per_s - self.excess / PAYBACK_S;
        let aim = aim.clamp(0.5 * self.bits_per_s, 1.5 * self.bits_per_s);
        if let Some((scale, last)) = self.before.replace((self.scale, rate)) {
            let (wider, fewer) = ((self.scale / scale).ln(), (last / rate).ln());
            if wider.abs() >= TELLING.ln() && fewer.is_finite() {
                // the scene may have changed, too: half of what was seen
                let seen = (fewer / wider).clamp(POWERS.0, POWERS.1);
                self.power = 0.5 * (self.power + seen);
            }
        }
        let change = (rate / aim).powf(1.0 / self.power).clamp(STEP.0, STEP.1);
        let decision = Decision {
            from: index + DELAY,
            scale: (self.scale * change).clamp(RANGE.0, RANGE.1),
        };
        self.next = decision.from + self.every - DELAY;
        self.pending = Some(decision);
        Some(decision)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FPS: f64 = 30.0;
    const EVERY: u32 = 30;

    /// Bits of each frame of a stream whose frames take `cost(n)` bits at a scale of 1, and more or
    /// less by the power `power` at others; key frames take twice as much.
    fn stream(target: f64, frames: u64, power: f64, cost: impl Fn(u64) -> f64) -> Vec<f64> {
        let mut control = RateControl::new(target, EVERY);
        let (mut scale, mut key, mut next) = (1.0f64, 0, None::<Decision>);
        (0..frames)
            .map(|n| {
                if let Some(d) = next.filter(|d| d.from == n) {
                    (scale, key) = (d.scale, n);
                }
                let is_key = (n - key) % u64::from(EVERY) == 0;
                let bits = cost(n) * scale.powf(-power) * if is_key { 2.0 } else { 1.0 };
                let time = (n as f64 / FPS * 1e9) as i64;
                let decided = control.observe(time, (bits / 8.0) as usize);
                assert!(decided.is_none_or(|d| d.from == n + DELAY));
                next = decided.or(next);
                bits
            })
            .collect()
    }

    proptest! {
        /// Whatever the scene costs and however bits fall, the rate comes to the target and stays.
        #[test]
        fn the_rate_comes_to_the_target(cost in 5e3..5e5f64, power in 0.4..1.1f64, target in 3e5..8e6f64) {
            // the scale that is needed lies within the range
            let scale = (cost * FPS / target).powf(1.0 / power);
            prop_assume!((0.08..25.0).contains(&scale));
            let bits = stream(target, 900, power, |_| cost);
            let rate = bits[450..].iter().sum::<f64>() / 450.0 * FPS;
            prop_assert!((0.85..1.15).contains(&(rate / target)), "{rate} for {target}");
        }

        /// A scene three times as dear is back at the target within four seconds.
        #[test]
        fn a_harder_scene_is_caught(power in 0.6..1.0f64) {
            let target = 2e6;
            let bits = stream(target, 900, power, |n| if n < 450 { 6e4 } else { 1.8e5 });
            let rate = bits[570..].iter().sum::<f64>() / 330.0 * FPS;
            prop_assert!((0.8..1.2).contains(&(rate / target)), "{rate}");
        }
    }

    #[test]
    fn nothing_is_decided_without_time() {
        let mut control = RateControl::new(1e6, EVERY);
        assert!((0..100).all(|_| control.observe(5, 1000).is_none()));
    }
}
