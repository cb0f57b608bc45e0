//! Adaptive binary range coder: the entropy primitive of every section.
//!
//! A carry-propagating 32-bit range coder in the manner of G. N. N. Martin (1979), with adaptive
//! bit models that mix a fast and a slow estimate. Why our own: the frame codec needs one
//! description of its model for both directions, a bounded decoder on any bytes, and some ten
//! nanoseconds a bit; the kept crates code static models of many symbols or fix the models to one
//! video standard.

/// Probability of a one bit, learnt as it goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bit {
    fast: u16,
    slow: u16,
    seen: u8,
}

impl Default for Bit {
    fn default() -> Self {
        Self {
            fast: 1 << 15,
            slow: 1 << 15,
            seen: 0,
        }
    }
}

/// Slowest adaptation (shift) of the two estimates.
const FAST: u8 = 5;
const SLOW: u8 = 7;
/// Most zero bytes that a section may lack at its end.
const PAST_END: usize = 8;

impl Bit {
    /// Probability of a one, in 1/65536, never 0 or 1.
    #[inline(always)]
    fn one(self) -> u32 {
        ((u32::from(self.fast) + u32::from(self.slow)) >> 1).clamp(48, 65536 - 48)
    }

    #[inline(always)]
    fn learn(&mut self, value: bool) {
        // first a running mean, then the fixed rates
        let (f, s) = (FAST.min(self.seen + 1), SLOW.min(self.seen + 1));
        self.seen += u8::from(self.seen < SLOW);
        if value {
            self.fast += (65535 - self.fast) >> f;
            self.slow += (65535 - self.slow) >> s;
        } else {
            self.fast -= self.fast >> f;
            self.slow -= self.slow >> s;
        }
    }

    /// What coding `value` costs now, in 1/16 bit.
    #[inline(always)]
    #[must_use]
    pub fn cost(self, value: bool) -> u32 {
        cost(self.one(), value)
    }
}

/// What a bit costs that is a one with probability `one`/65536, in 1/16 bit (a little more than the
/// logarithm, which is taken piece by piece).
#[inline(always)]
#[must_use]
pub fn cost(one: u32, value: bool) -> u32 {
    let p = if value { one } else { (1 << 16) - one };
    let whole = p.ilog2();
    256 - 16 * whole - ((p << (16 - whole)) >> 12 & 15)
}

/// Either direction of the coder. A model is written once, against this trait: the encoder codes
/// the value it is given and returns it, the decoder ignores it and returns what it read.
pub trait Coder {
    /// True for the direction that writes: it alone chooses.
    const WRITES: bool;
    /// Codes one bit that is a one with probability `one`/65536, which is above 0 and below 65536.
    fn chance(&mut self, one: u32, value: bool) -> bool;
    /// Codes one bit under a model.
    #[inline(always)]
    fn bit(&mut self, model: &mut Bit, value: bool) -> bool {
        let bit = self.chance(model.one(), value);
        model.learn(bit);
        bit
    }
    /// Codes the low `count` (≤ 16) bits of `value` without a model.
    fn plain(&mut self, count: u32, value: u32) -> u32;
    /// Codes `value`, one of `total` (1 to 65536) that are all as likely.
    fn uniform(&mut self, total: u32, value: u32) -> u32;
    /// Bits written so far, in 1/16 bit, to a quarter of a bit: what lies between two calls took their difference. 0 while
    /// reading.
    fn written(&self) -> u64 {
        0
    }
}

/// Writes bits to a byte buffer.
#[derive(Debug)]
pub struct Encoder<'a> {
    out: &'a mut Vec<u8>,
    low: u64,
    range: u32,
    cache: u8,
    pending: u64,
    first: bool,
}

impl<'a> Encoder<'a> {
    /// Appends to `out`.
    pub fn new(out: &'a mut Vec<u8>) -> Self {
        Self {
            out,
            low: 0,
            range: u32::MAX,
            cache: 0,
            pending: 0,
            first: true,
        }
    }

    #[inline(never)]
    fn shift(&mut self) {
        if self.low < 0xFF00_0000 || self.low > 0xFFFF_FFFF {
            let carry = (self.low >> 32) as u8;
            if !self.first {
                self.out.push(self.cache.wrapping_add(carry));
            }
            self.first = false;
            for _ in 0..self.pending {
                self.out.push(0xFFu8.wrapping_add(carry));
            }
            self.pending = 0;
            self.cache = (self.low >> 24) as u8;
        } else {
            self.pending += 1;
        }
        self.low = (self.low & 0x00FF_FFFF) << 8;
    }

    /// Writes what is left. Up to eight trailing zero bytes are dropped: the decoder reads so many
    /// zeros past the end.
    pub fn finish(mut self) {
        let start = self.out.len();
        // the value in [low, low + range) with most trailing zeros
        let (low, high) = (self.low, self.low + u64::from(self.range) - 1);
        let mut mask = u64::MAX << 32;
        while (high & mask) < low {
            mask >>= 1;
            mask |= 1 << 40;
        }
        self.low = high & mask;
        for _ in 0..5 {
            self.shift();
        }
        // a carry can make zeros of any number of pending bytes
        let start = start.max(self.out.len().saturating_sub(PAST_END));
        while self.out.len() > start && self.out.last() == Some(&0) {
            self.out.pop();
        }
    }
}

impl Coder for Encoder<'_> {
    const WRITES: bool = true;

    #[inline(always)]
    fn chance(&mut self, one: u32, value: bool) -> bool {
        let bound = (self.range >> 16) * one;
        if value {
            self.range = bound;
        } else {
            self.low += u64::from(bound);
            self.range -= bound;
        }
        while self.range < 1 << 24 {
            self.range <<= 8;
            self.shift();
        }
        value
    }

    #[inline]
    fn plain(&mut self, count: u32, value: u32) -> u32 {
        for k in (0..count).rev() {
            self.range >>= 1;
            if value >> k & 1 != 0 {
                self.low += u64::from(self.range);
            }
            while self.range < 1 << 24 {
                self.range <<= 8;
                self.shift();
            }
        }
        value
    }

    #[inline]
    fn uniform(&mut self, total: u32, value: u32) -> u32 {
        self.range /= total;
        self.low += u64::from(self.range) * u64::from(value);
        while self.range < 1 << 24 {
            self.range <<= 8;
            self.shift();
        }
        value
    }

    fn written(&self) -> u64 {
        let whole = self.range.ilog2();
        let part = u64::from(self.range) << 4 >> whole & 15;
        let open = u64::from(16 * (32 - whole)) - part;
        128 * (self.out.len() as u64 + self.pending + u64::from(!self.first)) + open
    }
}

/// Reads bits from bytes. Never fails while reading: past the end it reads zeros and counts them.
#[derive(Debug)]
pub struct Decoder<'a> {
    bytes: &'a [u8],
    at: usize,
    code: u32,
    range: u32,
}

impl<'a> Decoder<'a> {
    /// Reads `bytes` from their start.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Self {
            bytes,
            at: 0,
            code: 0,
            range: u32::MAX,
        };
        for _ in 0..4 {
            decoder.code = decoder.code << 8 | decoder.next();
        }
        decoder
    }

    #[inline(always)]
    fn next(&mut self) -> u32 {
        let byte = self.bytes.get(self.at).copied().unwrap_or(0);
        self.at += 1;
        u32::from(byte)
    }

    /// Bytes that nothing was read from.
    #[must_use]
    pub fn rest(&self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or(&[])
    }

    /// True where more was read than any encoder would have left out: the bytes are damaged.
    #[must_use]
    pub fn overran(&self) -> bool {
        self.at > self.bytes.len() + PAST_END
    }
}

impl Coder for Decoder<'_> {
    const WRITES: bool = false;

    #[inline(always)]
    fn chance(&mut self, one: u32, _: bool) -> bool {
        let bound = (self.range >> 16) * one;
        let value = self.code < bound;
        if value {
            self.range = bound;
        } else {
            self.code -= bound;
            self.range -= bound;
        }
        while self.range < 1 << 24 {
            self.range <<= 8;
            self.code = self.code << 8 | self.next();
        }
        value
    }

    #[inline]
    fn plain(&mut self, count: u32, _: u32) -> u32 {
        let mut value = 0;
        for _ in 0..count {
            self.range >>= 1;
            let one = self.code >= self.range;
            if one {
                self.code -= self.range;
            }
            value = value << 1 | u32::from(one);
            while self.range < 1 << 24 {
                self.range <<= 8;
                self.code = self.code << 8 | self.next();
            }
        }
        value
    }

    #[inline]
    fn uniform(&mut self, total: u32, _: u32) -> u32 {
        self.range /= total;
        // what the division left over belongs to nobody; damaged bytes may lie there
        let value = (self.code / self.range).min(total - 1);
        self.code -= self.range * value;
        while self.range < 1 << 24 {
            self.range <<= 8;
            self.code = self.code << 8 | self.next();
        }
        value
    }
}

/// Model of an unsigned integer: Elias-gamma with learnt length and leading bits.
#[derive(Clone, Copy, Debug, Default)]
pub struct Integer {
    length: [Bit; 25],
    leading: [[Bit; 4]; 25],
}

impl Integer {
    /// Largest value.
    pub const MAX: u32 = (1 << 24) - 2;

    /// Codes `value` (at most [`Integer::MAX`]).
    #[inline]
    pub fn code<C: Coder>(&mut self, coder: &mut C, value: u32) -> u32 {
        let v = value.min(Self::MAX) + 1;
        let length = v.ilog2();
        let mut n = 0;
        while n < 23 && coder.bit(&mut self.length[n as usize], n < length) {
            n += 1;
        }
        // the two bits behind the leading one are learnt, the rest is noise
        let mut read = 1u32;
        let mut left = n;
        let mut node = 0usize;
        while left > 0 && n - left < 2 {
            left -= 1;
            let bit = coder.bit(&mut self.leading[n as usize][node], v >> left & 1 != 0);
            read = read << 1 | u32::from(bit);
            node = 1 + usize::from(bit);
        }
        while left > 0 {
            let take = left.min(16);
            left -= take;
            read = read << take | coder.plain(take, v >> left & ((1 << take) - 1));
        }
        read - 1
    }

    /// Codes a signed value by the order 0, −1, 1, −2, …
    #[inline]
    pub fn code_signed<C: Coder>(&mut self, coder: &mut C, value: i32) -> i32 {
        let folded = ((value << 1) ^ (value >> 31)) as u32;
        let read = self.code(coder, folded);
        (read >> 1) as i32 ^ -((read & 1) as i32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// One step of a mixed stream: a bit, two integers, plain bits.
    type Step = (bool, u32, i32, u32);

    proptest! {
        #[test]
        fn bits_and_integers_come_back(values in prop::collection::vec((any::<bool>(), 0u32..70_000, -5000i32..5000, 0u32..65536), 0..400)) {
            let run = |coder: &mut dyn FnMut(&mut Bit, &mut Integer, &mut Integer, Step) -> Step| {
                let (mut bit, mut a, mut b) = (Bit::default(), Integer::default(), Integer::default());
                values.iter().map(|&v| coder(&mut bit, &mut a, &mut b, v)).collect::<Vec<_>>()
            };
            let mut bytes = Vec::new();
            let mut encoder = Encoder::new(&mut bytes);
            run(&mut |m, a, b, v| {
                encoder.bit(m, v.0); a.code(&mut encoder, v.1); b.code_signed(&mut encoder, v.2); encoder.plain(16, v.3); v
            });
            encoder.finish();
            let mut decoder = Decoder::new(&bytes);
            let read = run(&mut |m, a, b, _| {
                (decoder.bit(m, false), a.code(&mut decoder, 0), b.code_signed(&mut decoder, 0), decoder.plain(16, 0))
            });
            prop_assert_eq!(read, values);
            prop_assert!(!decoder.overran());
        }

        #[test]
        fn skewed_bits_cost_what_they_should(ones in 1usize..40) {
            let mut state = 0x9E37_79B9_7F4A_7C15u64;
            let values: Vec<bool> = (0..20_000).map(|_| {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                (state % 1000) < ones as u64
            }).collect();
            let mut bytes = Vec::new();
            let mut encoder = Encoder::new(&mut bytes);
            let mut model = Bit::default();
            for &v in &values { encoder.bit(&mut model, v); }
            encoder.finish();
            let p = values.iter().filter(|v| **v).count() as f64 / 20_000.0;
            let entropy = -20_000.0 * (p * p.log2() + (1.0 - p) * (1.0 - p).log2());
            prop_assert!(8.0 * bytes.len() as f64 <= 1.15 * entropy + 64.0, "{} bits for an entropy of {entropy}", 8 * bytes.len());
        }
    }

    #[test]
    fn what_was_written_is_known_to_a_quarter_of_a_bit() {
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes);
        let (mut model, mut bits) = (Bit::default(), 0.0);
        let start = encoder.written() as f64 / 16.0;
        for n in 0..3000u32 {
            let value = n * n % 7 < 2;
            let one = f64::from(model.one()) / 65536.0;
            bits -= if value { one } else { 1.0 - one }.log2();
            encoder.bit(&mut model, value);
            if n % 5 == 0 {
                encoder.plain(3, n & 7);
                bits += 3.0;
            }
            let written = encoder.written() as f64 / 16.0 - start;
            // the coder itself rounds its range
            assert!(
                (written - bits).abs() < 0.25 + 2e-3 * bits,
                "{n}: {written} {bits}"
            );
        }
        encoder.finish();
        assert!((8.0 * bytes.len() as f64 - bits).abs() < 40.0);
    }

    #[test]
    fn an_empty_stream_is_no_bytes() {
        let mut bytes = Vec::new();
        Encoder::new(&mut bytes).finish();
        assert!(bytes.is_empty());
    }
}
