//! Run-length variable-length coding of depth images: A. D. Wilson, "Fast Lossless Depth Image
//! Compression", ISS 2017. Runs without and with measurements alternate; measurements are coded as
//! zigzag differences, all numbers as groups of three bits with a continuation bit.
//!
//! Written from the paper's description, as a baseline of the bench only.

/// Nibbles, first one lowest.
struct Nibbles<'a> {
    bytes: &'a mut Vec<u8>,
    half: Option<u8>,
}

impl Nibbles<'_> {
    fn put(&mut self, mut value: u32) {
        loop {
            let more = value > 7;
            let nibble = (value & 7) as u8 | u8::from(more) << 3;
            match self.half.take() {
                Some(low) => self.bytes.push(low | nibble << 4),
                None => self.half = Some(nibble),
            }
            if !more {
                return;
            }
            value >>= 3;
        }
    }
}

/// Replaces `bytes` by the frame.
pub fn encode(depth: &[u16], bytes: &mut Vec<u8>) {
    bytes.clear();
    let mut out = Nibbles { bytes, half: None };
    let (mut rest, mut last) = (depth, 0);
    while !rest.is_empty() {
        let holes = rest.iter().take_while(|d| **d == 0).count();
        rest = &rest[holes..];
        let run = rest.iter().take_while(|d| **d != 0).count();
        out.put(holes as u32);
        out.put(run as u32);
        for &raw in &rest[..run] {
            let difference = i32::from(raw) - last;
            out.put((difference << 1 ^ difference >> 31) as u32);
            last = i32::from(raw);
        }
        rest = &rest[run..];
    }
    if let Some(low) = out.half {
        out.bytes.push(low);
    }
}

/// Replaces `depth` by the `pixels` pixels that `bytes` (of [`encode`]) hold.
pub fn decode(bytes: &[u8], pixels: usize, depth: &mut Vec<u16>) {
    depth.clear();
    let mut at = 0;
    let mut get = || {
        let (mut value, mut shift) = (0, 0);
        loop {
            let nibble = bytes[at / 2] >> (at % 2 * 4);
            at += 1;
            value |= u32::from(nibble & 7) << shift;
            shift += 3;
            if nibble & 8 == 0 {
                return value;
            }
        }
    };
    let mut last = 0;
    while depth.len() < pixels {
        let holes = get() as usize;
        depth.resize(depth.len() + holes, 0);
        for _ in 0..get() {
            let zigzag = get();
            last += (zigzag >> 1) as i32 ^ -((zigzag & 1) as i32);
            depth.push(last as u16);
        }
    }
}
