//! Logistic mixing: one bit under several models at once.
//!
//! Each context keeps its own estimate of the bit. The estimates, as log-odds, are added with
//! weights that are learnt from how well the sum did (M. Mahoney, "Adaptive weighing of context
//! models for lossless data compression", 2005). Integers only, so that both sides agree
//! everywhere (`FORMAT.md` §1.4).

use super::range_coder::Coder;

/// Contexts that are mixed; the last lane is a constant.
pub const CONTEXTS: usize = 3;
const LANES: usize = CONTEXTS + 1;

/// `65536/(1 + e^(−i/2))` for i = −16 … 16.
const LOGISTIC: [i32; 33] = [
    22, 36, 60, 98, 162, 267, 439, 720, 1179, 1921, 3108, 4971, 7812, 11955, 17625, 24743, 32768,
    40793, 47911, 53581, 57724, 60565, 62428, 63615, 64357, 64816, 65097, 65269, 65374, 65438,
    65476, 65500, 65514,
];
/// Log-odds stay within ±8, in 1/256.
const MOST: i32 = 2047;
/// The constant lane.
const CONSTANT: i32 = 64;
/// A weight of one, its start and its bounds.
const ONE: u32 = 14;
const START: i32 = 9830;
const HEAVIEST: i32 = 1 << 17;
/// Counts from which an estimate adapts at a fixed rate.
const SETTLED: u32 = 250;

/// Probability (1/65536) of log-odds `x` (1/256).
const fn squash(x: i32) -> i32 {
    let at = ((x >> 7) + 16) as usize;
    let part = x & 127;
    (LOGISTIC[at] * (128 - part) + LOGISTIC[at + 1] * part + 64) >> 7
}

/// Probability of each log-odds, from `-MOST`, kept from certainty.
static SQUASH: [u16; 2 * MOST as usize + 1] = {
    let mut table = [0; 2 * MOST as usize + 1];
    let mut at = 0;
    while at < table.len() {
        let p = squash(at as i32 - MOST);
        table[at] = if p < 48 {
            48
        } else if p > 65488 {
            65488
        } else {
            p as u16
        };
        at += 1;
    }
    table
};

/// Log-odds of each probability in 1/4096: the inverse of [`squash`].
static STRETCH: [i16; 4096] = {
    let mut table = [MOST as i16; 4096];
    let (mut filled, mut x) = (0, -MOST);
    while x <= MOST {
        let p = squash(x) >> 4;
        while filled <= p {
            table[filled as usize] = x as i16;
            filled += 1;
        }
        x += 1;
    }
    table
};

/// Step towards the bit after so many bits, in 1/32768.
static RATE: [i32; SETTLED as usize + 1] = {
    let mut table = [0; SETTLED as usize + 1];
    let mut n = 0;
    while n < table.len() {
        table[n] = 327_680 / (10 * n as i32 + 16);
        n += 1;
    }
    table
};

/// One context's estimate: probability of a one in the upper, bits seen in the lower half.
#[derive(Clone, Copy, Debug)]
struct Estimate(u32);

impl Default for Estimate {
    fn default() -> Self {
        Self(1 << 31)
    }
}

impl Estimate {
    /// Probability of a one, in 1/65536, kept from certainty.
    #[inline(always)]
    fn one(self) -> u32 {
        (self.0 >> 16).clamp(48, 65488)
    }

    #[inline(always)]
    fn log_odds(self) -> i32 {
        i32::from(STRETCH[(self.0 >> 20) as usize])
    }

    #[inline(always)]
    fn learn(&mut self, bit: bool) {
        let (p, seen) = ((self.0 >> 16) as i32, (self.0 & 0xFFFF).min(SETTLED));
        let target = if bit { 65535 } else { 0 };
        let p = p + (((target - p) * RATE[seen as usize]) >> 15);
        self.0 = (p as u32) << 16 | (seen + 1).min(SETTLED);
    }
}

/// Weights of the lanes.
#[derive(Clone, Copy, Debug)]
struct Weights([i32; LANES]);

impl Default for Weights {
    fn default() -> Self {
        let mut weights = [START; LANES];
        weights[CONTEXTS] = 0;
        Self(weights)
    }
}

/// What one mixed bit looks at: a place in each list of estimates, and its weights.
#[derive(Clone, Copy, Debug, Default)]
pub struct Place {
    /// One for each context.
    pub contexts: [usize; CONTEXTS],
    /// Which weights.
    pub weights: usize,
}

/// What estimates and weights say of a bit that is still to be coded.
#[derive(Clone, Copy, Debug, Default)]
pub struct Mixture {
    lanes: [i32; LANES],
    one: u32,
}

impl Mixture {
    /// Probability of a one, in 1/65536.
    #[inline(always)]
    #[must_use]
    pub const fn one(&self) -> u32 {
        self.one
    }
}

/// The learnt estimates and weights of one section's mixed bits.
///
/// `FAST`, a bit is coded under its first context alone, and only that one learns: on frames of a
/// Kinect and two RealSense cameras 1 to 2 % more bits at the default bound, 4 % without loss, for
/// less than half the time a bit.
#[derive(Clone, Debug)]
pub struct Mixer {
    estimates: [Vec<Estimate>; CONTEXTS],
    weights: Vec<Weights>,
}

impl Mixer {
    /// So many places of each context, and so many weights.
    #[must_use]
    pub fn new(contexts: [usize; CONTEXTS], weights: usize) -> Self {
        Self {
            estimates: contexts.map(|n| vec![Estimate::default(); n]),
            weights: vec![Weights::default(); weights],
        }
    }

    /// Back to the start.
    pub fn reset(&mut self) {
        for estimates in &mut self.estimates {
            estimates.fill(Estimate::default());
        }
        self.weights.fill(Weights::default());
    }

    /// What is known of a bit at this place.
    #[inline(always)]
    #[must_use]
    pub fn mix<const FAST: bool>(&self, at: &Place) -> Mixture {
        let [a, b, c] = &self.estimates;
        if FAST {
            return Mixture {
                lanes: [0; LANES],
                one: a[at.contexts[0]].one(),
            };
        }
        let mut lanes = [CONSTANT; LANES];
        let estimates = [a[at.contexts[0]], b[at.contexts[1]], c[at.contexts[2]]];
        for (lane, e) in lanes.iter_mut().zip(estimates) {
            *lane = e.log_odds();
        }
        let weights = &self.weights[at.weights].0;
        let sum: i32 = lanes.iter().zip(weights).map(|(s, w)| s * w).sum();
        let one = u32::from(SQUASH[((sum >> ONE).clamp(-MOST, MOST) + MOST) as usize]);
        Mixture { lanes, one }
    }

    /// Codes `value` under `mixture`, that of this place; what was mixed learns it.
    #[inline(always)]
    pub fn code_mixed<const FAST: bool, C: Coder>(
        &mut self,
        coder: &mut C,
        at: &Place,
        mixture: &Mixture,
        value: bool,
    ) -> bool {
        let bit = coder.chance(mixture.one, value);
        let [a, b, c] = &mut self.estimates;
        a[at.contexts[0]].learn(bit);
        if FAST {
            return bit;
        }
        b[at.contexts[1]].learn(bit);
        c[at.contexts[2]].learn(bit);
        let error = ((i32::from(bit) << 16) - mixture.one as i32) >> 4;
        let weights = &mut self.weights[at.weights].0;
        for (w, s) in weights.iter_mut().zip(mixture.lanes) {
            *w = (*w + ((s * error + (1 << 12)) >> 13)).clamp(-HEAVIEST, HEAVIEST);
        }
        bit
    }

    /// Codes `value` at this place.
    #[inline(always)]
    pub fn code<const FAST: bool, C: Coder>(
        &mut self,
        coder: &mut C,
        at: &Place,
        value: bool,
    ) -> bool {
        let mixture = self.mix::<FAST>(at);
        self.code_mixed::<FAST, C>(coder, at, &mixture, value)
    }
}

#[cfg(test)]
mod tests {
    use super::super::range_coder::{Decoder, Encoder};
    use super::*;

    #[test]
    fn the_table_is_the_logistic_function() {
        for x in -MOST..=MOST {
            let p = 65536.0 / (1.0 + (-f64::from(x) / 256.0).exp());
            let ours = f64::from(squash(x));
            // chords of a curve, half a step of logit apart
            assert!(
                (ours - p).abs() < 0.008 * p.min(65536.0 - p) * 4.0 + 2.0,
                "{x}: {ours} {p}"
            );
        }
        for p in 64..4032 {
            let back = squash(i32::from(STRETCH[p])) >> 4;
            assert!(back.abs_diff(p as i32) <= 8, "{p} {back}");
        }
    }

    /// A bit that is the exclusive or of two others is known to one context of three.
    #[test]
    fn the_mixture_follows_the_context_that_knows() {
        let mut state = 1u64;
        let mut random = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state
        };
        let bits: Vec<[bool; 3]> = (0..20_000)
            .map(|_| {
                let r = random();
                let (a, b) = (r & 1 != 0, r & 2 != 0);
                [a, b, (a ^ b) ^ (r % 997 < 10)]
            })
            .collect();
        let code_all = |coder: &mut dyn FnMut(&mut Mixer, &Place, bool) -> bool| {
            let mut mixer = Mixer::new([4; CONTEXTS], 1);
            let mut read = Vec::new();
            for &[a, b, value] in &bits {
                let [a, b] = [a, b].map(usize::from);
                let at = Place {
                    contexts: [a, b, a * 2 + b],
                    weights: 0,
                };
                read.push(coder(&mut mixer, &at, value));
            }
            read
        };
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes);
        code_all(&mut |mixer, at, v| mixer.code::<false, _>(&mut encoder, at, v));
        encoder.finish();
        let mut decoder = Decoder::new(&bytes);
        let read = code_all(&mut |mixer, at, _| mixer.code::<false, _>(&mut decoder, at, false));
        assert!(read.iter().zip(&bits).all(|(r, b)| *r == b[2]));
        let p = 10.0 / 997.0f64;
        let entropy = 20_000.0 * -(p * p.log2() + (1.0 - p) * (1.0 - p).log2());
        let spent = 8.0 * bytes.len() as f64;
        assert!(spent < 1.2 * entropy + 200.0, "{spent} bits for {entropy}");
    }
}
