//! The payload's header: what a decoder must know before the sections (`FORMAT.md` §1.2).

use super::CodecError;
use crate::fit::contact_distance::ContactDistance;
use crate::fit::motion::{self, Motion};
use crate::frame::{Camera, FrameTime, Intrinsics};

/// First two bytes of a payload.
pub const MAGIC: [u8; 2] = *b"SL";
/// Version of the format this library writes and reads.
pub const VERSION: u8 = 3;
/// Most pixels of a frame: a little over 3840×2160.
pub const MAX_PIXELS: u64 = 1 << 23;
/// Largest side of a frame, pixels.
pub const MAX_SIDE: u64 = 1 << 13;
/// Number of sections.
pub const SECTIONS: usize = 4;

const KEY: u8 = 1;
const LOSSLESS: u8 = 2;
const DEGRADED: u8 = 4;
const MOVED: u8 = 8;
const PLAIN: u8 = 16;
/// 32 was an earlier form of it.
const FAST: u8 = 64;

/// How well a measurement must come back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Every kept pixel comes back within this distance along its ray.
    pub contact: ContactDistance,
    /// The sensor's integers come back exactly.
    pub lossless: bool,
}

/// What only key frames carry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stream {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Pinhole intrinsics.
    pub intrinsics: Intrinsics,
    /// Metres per depth integer.
    pub depth_unit_m: f64,
    /// Bound on the error.
    pub tolerance: Tolerance,
}

impl Stream {
    /// The stream of `camera` at this tolerance.
    #[must_use]
    pub fn new(camera: &Camera, tolerance: Tolerance) -> Self {
        Self {
            width: camera.width,
            height: camera.height,
            intrinsics: camera.intrinsics,
            depth_unit_m: camera.depth_unit_m,
            tolerance,
        }
    }

    /// The camera as far as a payload knows it.
    #[must_use]
    pub fn camera(&self) -> Camera {
        Camera {
            width: self.width,
            height: self.height,
            intrinsics: self.intrinsics,
            depth_unit_m: self.depth_unit_m,
            invalid: vec![0],
            depth_min_m: 0.0,
            depth_max_m: 65535.0 * self.depth_unit_m,
            fps: None,
            name: String::new(),
        }
    }

    /// Refuses what no camera is: the limits of `FORMAT.md` §1.3.
    ///
    /// # Errors
    /// [`CodecError::Limit`] with the value and the limit.
    pub fn check(&self) -> Result<(), CodecError> {
        let (w, h) = (u64::from(self.width), u64::from(self.height));
        if w < 2 || h < 2 || w > MAX_SIDE || h > MAX_SIDE || w * h > MAX_PIXELS {
            return Err(CodecError::Limit(format!(
                "image size {w}x{h} (2 to {MAX_SIDE} a side, {MAX_PIXELS} pixels)"
            )));
        }
        let i = &self.intrinsics;
        let focal = |f: f64| f.is_finite() && (1.0..=1e6).contains(&f);
        let centre = |c: f64| c.is_finite() && c.abs() <= 1e6;
        if !(focal(i.fx) && focal(i.fy) && centre(i.cx) && centre(i.cy)) {
            return Err(CodecError::Limit(format!(
                "intrinsics {}, {}, {}, {} (focal lengths 1 to 1e6 px)",
                i.fx, i.fy, i.cx, i.cy
            )));
        }
        if !(1e-7..=1.0).contains(&self.depth_unit_m) {
            return Err(CodecError::Limit(format!(
                "depth unit {} m (1e-7 to 1)",
                self.depth_unit_m
            )));
        }
        let c = &self.tolerance.contact;
        if !((1e-7..=1e3).contains(&c.floor_m) && (0.0..=1.0).contains(&c.per_z2)) {
            return Err(CodecError::Limit(format!(
                "contact distance {c} (floor 1e-7 to 1e3 m, growth 0 to 1)"
            )));
        }
        Ok(())
    }
}

/// A parsed or to be written header.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Present in key frames.
    pub stream: Option<Stream>,
    /// The source's frame number.
    pub sequence: u64,
    /// Sequence of the frame this one refers to (P frames).
    pub reference: u64,
    /// When the frame was taken.
    pub time: FrameTime,
    /// Camera motion since the reference frame (P frames).
    pub motion: Motion,
    /// True where the latency budget cut the fit short.
    pub degraded: bool,
    /// True where mask pixels and depths are written plainly, for speed.
    pub plain: bool,
    /// True where bits have one context each, and mask and labels are apart, for speed.
    pub fast: bool,
    /// Bytes of each section: blocks, spheres, pixels, residual.
    pub sections: [usize; SECTIONS],
}

impl Header {
    fn is_moved(&self) -> bool {
        self.stream.is_none() && !self.motion.is_still()
    }

    /// Appends the header's bytes.
    pub fn write(&self, out: &mut Vec<u8>) {
        out.extend(MAGIC);
        out.push(VERSION);
        let lossless = self.stream.as_ref().is_some_and(|s| s.tolerance.lossless);
        out.push(
            (u8::from(self.stream.is_some()) * KEY)
                | (u8::from(lossless) * LOSSLESS)
                | (u8::from(self.degraded) * DEGRADED)
                | (u8::from(self.is_moved()) * MOVED)
                | (u8::from(self.plain) * PLAIN)
                | (u8::from(self.fast) * FAST),
        );
        write_varint(out, self.sequence);
        out.extend(self.time.device_ns.to_le_bytes());
        out.extend(self.time.wall_ns.to_le_bytes());
        match &self.stream {
            Some(s) => {
                write_varint(out, u64::from(s.width));
                write_varint(out, u64::from(s.height));
                let i = &s.intrinsics;
                for f in [
                    i.fx,
                    i.fy,
                    i.cx,
                    i.cy,
                    s.depth_unit_m,
                    s.tolerance.contact.floor_m,
                    s.tolerance.contact.per_z2,
                ] {
                    out.extend(f.to_le_bytes());
                }
            }
            None => {
                write_varint(out, self.sequence.wrapping_sub(self.reference));
                if self.is_moved() {
                    for n in self.motion.turn.into_iter().chain(self.motion.shift) {
                        write_varint(out, u64::from(((n << 1) ^ (n >> 31)) as u32));
                    }
                }
            }
        }
        for &bytes in &self.sections {
            write_varint(out, bytes as u64);
        }
    }

    /// Reads a header from the start of a payload and returns it with the bytes of the first `wanted`
    /// sections (the others empty) and where the last section ends. The checksum behind is not read;
    /// a payload may be cut behind the wanted sections.
    ///
    /// # Errors
    /// [`CodecError`] where the bytes are not a payload of this version, or end before that.
    pub fn read(
        payload: &[u8],
        wanted: usize,
    ) -> Result<(Self, [&[u8]; SECTIONS], usize), CodecError> {
        let mut r = Reader {
            bytes: payload,
            at: 0,
        };
        if r.take(2)? != MAGIC {
            return Err(CodecError::Corrupt {
                at: 0,
                what: "no payload of saint-live starts like this",
            });
        }
        let version = r.byte()?;
        if version != VERSION {
            return Err(CodecError::Version { found: version });
        }
        let flags = r.byte()?;
        if flags & !(KEY | LOSSLESS | DEGRADED | MOVED | PLAIN | FAST) != 0 {
            return Err(CodecError::Corrupt {
                at: 3,
                what: "flags of no known meaning are set",
            });
        }
        let sequence = r.varint()?;
        let time = FrameTime {
            device_ns: i64::from_le_bytes(r.array()?),
            wall_ns: i64::from_le_bytes(r.array()?),
        };
        let (mut stream, mut reference, mut motion) = (None, 0, Motion::default());
        if flags & KEY != 0 {
            let (width, height) = (r.varint()?, r.varint()?);
            let side = |v: u64| u32::try_from(v).unwrap_or(u32::MAX);
            let mut f = [0.0; 7];
            for f in &mut f {
                *f = f64::from_le_bytes(r.array()?);
            }
            let s = Stream {
                width: side(width),
                height: side(height),
                intrinsics: Intrinsics {
                    fx: f[0],
                    fy: f[1],
                    cx: f[2],
                    cy: f[3],
                },
                depth_unit_m: f[4],
                tolerance: Tolerance {
                    contact: ContactDistance {
                        floor_m: f[5],
                        per_z2: f[6],
                    },
                    lossless: flags & LOSSLESS != 0,
                },
            };
            s.check()?;
            stream = Some(s);
        } else {
            reference = sequence.wrapping_sub(r.varint()?);
            if flags & MOVED != 0 {
                for n in motion.turn.iter_mut().chain(&mut motion.shift) {
                    *n = r.steps()?;
                }
            }
        }
        let mut sections = [0; SECTIONS];
        for s in &mut sections {
            *s = usize::try_from(r.varint()?).unwrap_or(usize::MAX);
        }
        let mut bytes: [&[u8]; SECTIONS] = [&[]; SECTIONS];
        let end = sections.iter().fold(r.at, |end, &n| end.saturating_add(n));
        for (b, &n) in bytes.iter_mut().zip(&sections).take(wanted) {
            *b = r.take(n)?;
        }
        Ok((
            Self {
                stream,
                sequence,
                reference,
                time,
                motion,
                degraded: flags & DEGRADED != 0,
                plain: flags & PLAIN != 0,
                fast: flags & FAST != 0,
                sections,
            },
            bytes,
            end,
        ))
    }
}

/// Appends `value` in groups of seven bits, lowest first.
pub fn write_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn take(&mut self, n: usize) -> Result<&'a [u8], CodecError> {
        let left = &self.bytes[self.at..];
        let taken = left.get(..n).ok_or(CodecError::Truncated {
            need: self.at.saturating_add(n),
            have: self.bytes.len(),
        })?;
        self.at += n;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, CodecError> {
        Ok(self.take(1)?[0])
    }

    fn array(&mut self) -> Result<[u8; 8], CodecError> {
        let mut a = [0; 8];
        a.copy_from_slice(self.take(8)?);
        Ok(a)
    }

    /// A component of a motion.
    fn steps(&mut self) -> Result<i32, CodecError> {
        let folded = self.varint()?;
        if folded > 2 * motion::MOST as u64 + 1 {
            return Err(CodecError::Corrupt {
                at: self.at,
                what: "a motion no frame can make",
            });
        }
        Ok((folded >> 1) as i32 ^ -((folded & 1) as i32))
    }

    fn varint(&mut self) -> Result<u64, CodecError> {
        let mut value = 0u64;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7F) << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(CodecError::Corrupt {
            at: self.at,
            what: "a number runs over 64 bits",
        })
    }
}
