//! Chance without state: the same number for the same place and frame, in any order, on any thread.

/// Two 64-bit words into one, well mixed (the finaliser of Steele, Lea and Flood's SplitMix,
/// "Fast splittable pseudorandom number generators", 2014).
#[must_use]
pub(super) fn mix(a: u64, b: u64) -> u64 {
    let mut x = a.wrapping_add(b.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// 32 bits of chance for a counter: two multiplications, so that a row of counters vectorises.
/// Constants of C. Wellons' search for low-bias 32-bit mixers.
#[inline(always)]
#[must_use]
pub(super) fn scatter(counter: u32) -> u32 {
    let mut x = counter;
    x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// A short run of numbers from one seed, for laying out a scene.
pub(super) struct Stream {
    seed: u64,
    drawn: u64,
}

impl Stream {
    pub fn new(seed: u64) -> Self {
        Self { seed, drawn: 0 }
    }

    /// Uniform in −1…1.
    pub fn signed(&mut self) -> f64 {
        self.drawn += 1;
        let bits = mix(self.seed, self.drawn) >> 11;
        bits as f64 / (1_u64 << 52) as f64 - 1.0
    }
}
