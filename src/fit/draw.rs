//! Random numbers of the fits and the experiments.

/// splitmix64 (Steele, Lea & Flood, OOPSLA 2014): one seed, one stream.
#[derive(Clone, Debug)]
pub(crate) struct Draw(u64);

impl Draw {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number below `a` and one below `b`; both must be above 0 and at most 2³².
    pub fn two_below(&mut self, a: usize, b: usize) -> (usize, usize) {
        let bits = self.next();
        let of = |bits: u64, n: usize| ((bits * n as u64) >> 32) as usize;
        (of(bits >> 32, a), of(bits & 0xffff_ffff, b))
    }

    /// Uniform in −1 to 1.
    pub fn signed_unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}
