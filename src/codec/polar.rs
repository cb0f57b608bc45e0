//! Payload of a polar SAINT model: spheres and the contact map that keeps every claim (`FORMAT.md`,
//! chapter 2).

use super::polar_claims::{self, Misstated, Models, floats};
use super::range_coder::{Decoder as RangeDecoder, Encoder as RangeEncoder};
use crate::contact_map::merged::ClaimMap;
use crate::contact_map::polar::{MAX_STEPS, Patch};
use glam::DVec3;

/// First four bytes of a polar payload.
pub const MAGIC: [u8; 4] = *b"SPOL";
const VERSION: u8 = 2;
/// Most spheres and claims in a coded byte: what is read takes memory in proportion to the bytes.
const MOST_IN_A_BYTE: usize = 64;
/// Bytes of the check at the end.
const CHECK_BYTES: usize = 4;

/// Bytes that are no polar payload, or a map that has no payload.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PolarCodecError {
    /// The payload ends too early.
    #[error("the polar payload ends at byte {length} within {what}; it was cut, fetch it again")]
    Truncated {
        /// What was being read.
        what: &'static str,
        /// Bytes there are.
        length: usize,
    },
    /// Not this format.
    #[error(
        "the payload starts with {found:02x?}, a polar payload with {wanted:02x?}; it is of another kind"
    )]
    Magic {
        /// The bytes found.
        found: [u8; 4],
        /// The bytes of this kind.
        wanted: [u8; 4],
    },
    /// Another version, or a flag from the future.
    #[error(
        "the payload has version {version} and flags {flags}, this program reads version {known} and flags 0; {}",
        if version < known { "make the file anew from its source" } else { "use a newer program" }
    )]
    Unsupported {
        /// Version found.
        version: u8,
        /// Flags found.
        flags: u8,
        /// Version that is read.
        known: u8,
    },
    /// The check does not match.
    #[error(
        "the polar payload's check is {found:08x} and its bytes give {computed:08x}; it was damaged, fetch it again"
    )]
    Check {
        /// Check stored.
        found: u32,
        /// Check computed.
        computed: u32,
    },
    /// A count that the bytes left cannot hold.
    #[error(
        "the polar payload announces {count} {what} and has {left} bytes left for them; it was damaged"
    )]
    Count {
        /// What is counted.
        what: &'static str,
        /// The count.
        count: usize,
        /// Bytes left.
        left: usize,
    },
    /// A value the format forbids.
    #[error(
        "the polar payload holds a forbidden {what} at byte {at}; it was damaged or badly written"
    )]
    Value {
        /// The field.
        what: &'static str,
        /// Byte after the field.
        at: usize,
    },
    /// Bytes that belong to nothing.
    #[error("the polar payload has {extra} bytes after its last claim; it was damaged")]
    Extra {
        /// How many.
        extra: usize,
    },
    /// A map that breaks its own rules.
    #[error("the contact map cannot be written: {0}")]
    Map(&'static str),
}

/// Appends the payload of `map` to `bytes`.
///
/// # Errors
/// A map whose parts do not fit together, that holds non-finite numbers or cells out of order or
/// beyond ±2²⁴ steps. `bytes` is then as it was.
pub fn encode(map: &ClaimMap, bytes: &mut Vec<u8>) -> Result<(), PolarCodecError> {
    check_map(map)?;
    let start = bytes.len();
    bytes.extend_from_slice(&MAGIC);
    bytes.extend_from_slice(&[VERSION, 0]);
    for v in map.origin.to_array() {
        bytes.extend_from_slice(&v.to_le_bytes());
    }
    bytes.extend_from_slice(&map.step_m.to_le_bytes());
    put_varint(bytes, map.patches.len() as u32);
    put_varint(bytes, map.cells.len() as u32);
    let body = bytes.len();
    encode_spheres(map, bytes);
    let least = (map.patches.len() + map.cells.len()).div_ceil(MOST_IN_A_BYTE);
    bytes.resize(bytes.len().max(body + least), 0);
    let check = crc32fast::hash(&bytes[start..]);
    bytes.extend_from_slice(&check.to_le_bytes());
    Ok(())
}

/// Reads a payload. Safe on any bytes: allocates no more than a small multiple of their length.
///
/// # Errors
/// Any bytes that [`encode`] would not have written.
pub fn decode(bytes: &[u8]) -> Result<ClaimMap, PolarCodecError> {
    let mut reader = Reader::checked(bytes, MAGIC, VERSION)?;
    read_body(&mut reader)
}

fn read_body(reader: &mut Reader<'_>) -> Result<ClaimMap, PolarCodecError> {
    let origin = reader.origin()?;
    let step_m = f32::from_le_bytes(reader.array("step")?);
    if !usable_step(step_m) {
        return Err(reader.value("step"));
    }
    let spheres = reader.varint("number of spheres")? as usize;
    let claims = reader.varint("number of claims")? as usize;
    let count = spheres.saturating_add(claims);
    if count > reader.left().saturating_mul(MOST_IN_A_BYTE) {
        return Err(reader.count("spheres and claims", count));
    }
    let mut map = ClaimMap {
        origin,
        step_m,
        patches: Vec::with_capacity(spheres),
        starts: Vec::with_capacity(spheres + 1),
        cells: Vec::with_capacity(claims),
    };
    read_spheres(reader, spheres, claims, &mut map)?;
    Ok(map)
}

fn encode_spheres(map: &ClaimMap, bytes: &mut Vec<u8>) {
    let mut coder = RangeEncoder::new(bytes);
    let mut models = Models::default();
    let (mut tiles, mut coded, mut cells) = (Vec::new(), Vec::new(), Vec::new());
    for (s, patch) in map.patches.iter().enumerate() {
        polar_claims::tiles(map.claims(s), &mut tiles);
        let any = polar_claims::code_claims(&mut coder, &mut models, !tiles.is_empty());
        polar_claims::code_patch(&mut coder, &mut models, any, Some(patch));
        if any {
            cells.clear();
            let most = map.cells.len();
            let (c, m) = (&mut coder, &mut models);
            let coded = polar_claims::code_cells(c, m, &tiles, most, &mut coded, &mut cells);
            debug_assert!(coded.is_ok() && cells == map.claims(s));
        }
    }
    coder.finish();
}

fn read_spheres(
    reader: &Reader<'_>,
    spheres: usize,
    claims: usize,
    map: &mut ClaimMap,
) -> Result<(), PolarCodecError> {
    let value = |what| PolarCodecError::Value {
        what,
        at: reader.bytes.len(),
    };
    let mut coder = RangeDecoder::new(&reader.bytes[reader.at..]);
    let mut models = Models::default();
    let mut tiles = Vec::new();
    map.starts.push(0);
    for _ in 0..spheres {
        let any = polar_claims::code_claims(&mut coder, &mut models, false);
        let patch = polar_claims::code_patch(&mut coder, &mut models, any, None);
        if !usable_patch(&patch) {
            return Err(value("sphere"));
        }
        map.patches.push(patch);
        if any {
            let left = claims - map.cells.len();
            let (c, m, cells) = (&mut coder, &mut models, &mut map.cells);
            polar_claims::code_cells(c, m, &[], left, &mut tiles, cells).map_err(|misstated| {
                match misstated {
                    Misstated::Many => value("number of claims"),
                    Misstated::Far => value("cell"),
                }
            })?;
        }
        if coder.overran() {
            return Err(PolarCodecError::Truncated {
                what: "spheres and claims",
                length: reader.bytes.len(),
            });
        }
        map.starts.push(map.cells.len() as u32);
    }
    if map.cells.len() != claims {
        return Err(value("number of claims"));
    }
    // zeros fill up what a byte may hold
    let extra = coder.rest();
    match extra.iter().rposition(|byte| *byte != 0) {
        Some(last) => Err(PolarCodecError::Extra { extra: last + 1 }),
        None => Ok(()),
    }
}

/// Everything [`encode`] relies on.
fn check_map(map: &ClaimMap) -> Result<(), PolarCodecError> {
    let refuse = |why| Err(PolarCodecError::Map(why));
    if !map.origin.is_finite() || !usable_step(map.step_m) {
        return refuse("the origin must be finite and the step finite and above 0");
    }
    let whole = map.starts.first() == Some(&0)
        && map.starts.windows(2).all(|w| w[0] <= w[1])
        && map.starts.last().map(|&e| e as usize) == Some(map.cells.len());
    if map.starts.len() != map.patches.len() + 1 || !whole {
        return refuse("the starts must ascend from 0 to the number of claims, one per sphere");
    }
    if !map.patches.iter().all(usable_patch) {
        return refuse("a sphere has a number that is not finite or a normal that is not a unit");
    }
    for s in 0..map.patches.len() {
        let claims = map.claims(s);
        let inside = |v: i32| (-MAX_STEPS..=MAX_STEPS).contains(&v);
        if !claims.iter().all(|c| inside(c.row) && inside(c.column)) {
            return refuse("a cell lies beyond 2^24 steps");
        }
        if !claims.windows(2).all(|w| w[0] < w[1]) {
            return refuse("the cells of a sphere must ascend by row, then column");
        }
    }
    Ok(())
}

fn usable_step(step_m: f32) -> bool {
    step_m.is_finite() && step_m > 0.0
}

fn usable_patch(patch: &Patch) -> bool {
    floats(patch).iter().all(|v| v.is_finite()) && (patch.normal.length() - 1.0).abs() < 1e-3
}

pub(super) fn put_varint(bytes: &mut Vec<u8>, mut v: u32) {
    while v >= 0x80 {
        bytes.push(v as u8 | 0x80);
        v >>= 7;
    }
    bytes.push(v as u8);
}

/// A place in the bytes; every read checks what is left.
pub(super) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    /// The fields of a payload, its first six bytes and its check passed over. The check is
    /// looked at before all else: nothing behind it need guess whether bytes were damaged.
    pub(super) fn checked(
        bytes: &'a [u8],
        wanted: [u8; 4],
        known: u8,
    ) -> Result<Self, PolarCodecError> {
        let mut reader = Self { bytes, at: 0 };
        let found = reader.array::<4>("magic")?;
        if found != wanted {
            return Err(PolarCodecError::Magic { found, wanted });
        }
        let [version, flags] = reader.array("version")?;
        if version != known || flags != 0 {
            return Err(PolarCodecError::Unsupported {
                version,
                flags,
                known,
            });
        }
        let body = bytes
            .len()
            .checked_sub(CHECK_BYTES)
            .filter(|&body| body >= reader.at)
            .ok_or(PolarCodecError::Truncated {
                what: "check",
                length: bytes.len(),
            })?;
        let mut tail = Self { bytes, at: body };
        let found = u32::from_le_bytes(tail.array("check")?);
        let computed = crc32fast::hash(&bytes[..body]);
        if found != computed {
            return Err(PolarCodecError::Check { found, computed });
        }
        reader.bytes = &bytes[..body];
        Ok(reader)
    }

    /// Zero of all coordinates.
    pub(super) fn origin(&mut self) -> Result<DVec3, PolarCodecError> {
        let mut origin = [0.0; 3];
        for v in &mut origin {
            *v = f64::from_le_bytes(self.array("origin")?);
        }
        let origin = DVec3::from_array(origin);
        if origin.is_finite() {
            Ok(origin)
        } else {
            Err(self.value("origin"))
        }
    }

    /// All fields are read: no byte may be left.
    pub(super) fn end(&self) -> Result<(), PolarCodecError> {
        match self.left() {
            0 => Ok(()),
            extra => Err(PolarCodecError::Extra { extra }),
        }
    }

    pub(super) fn left(&self) -> usize {
        self.bytes.len() - self.at
    }

    pub(super) fn array<const N: usize>(
        &mut self,
        what: &'static str,
    ) -> Result<[u8; N], PolarCodecError> {
        let taken = self.bytes[self.at..].first_chunk::<N>().copied();
        let taken = taken.ok_or(PolarCodecError::Truncated {
            what,
            length: self.bytes.len(),
        })?;
        self.at += N;
        Ok(taken)
    }

    pub(super) fn varint(&mut self, what: &'static str) -> Result<u32, PolarCodecError> {
        let mut value = 0u64;
        for shift in (0..35).step_by(7) {
            let [byte] = self.array(what)?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                // one way to write each number: no superfluous zero byte
                let shortest = byte != 0 || shift == 0;
                return u32::try_from(value)
                    .ok()
                    .filter(|_| shortest)
                    .ok_or(self.value(what));
            }
        }
        Err(self.value(what))
    }

    pub(super) fn value(&self, what: &'static str) -> PolarCodecError {
        PolarCodecError::Value { what, at: self.at }
    }

    pub(super) fn count(&self, what: &'static str, count: usize) -> PolarCodecError {
        PolarCodecError::Count {
            what,
            count,
            left: self.left(),
        }
    }
}

#[cfg(test)]
#[path = "polar_tests.rs"]
mod tests;
