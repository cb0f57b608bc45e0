//! Payloads to depth frames, spheres and contact maps.

use super::CodecError;
use super::header::{self, Header, Stream};
use super::labels::AsRead;
use super::mask;
use super::output::{write_coarse, write_frame};
use super::range_coder::Decoder as RangeDecoder;
use super::sphere_table::{self, Support};
use super::state::State;
use crate::contact_map::contact::Reach;
use crate::deproject::{BLOCK, Rays};
use crate::fit::motion::Motion;
use crate::fit::sphere::Sphere;
use crate::frame::{Camera, FrameTime};

/// A decoded frame.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedFrame {
    /// The camera, as far as the payload knows it.
    pub camera: Camera,
    /// The source's frame number.
    pub sequence: u64,
    /// When the frame was taken.
    pub time: FrameTime,
    /// True where the latency budget cut the fit short.
    pub degraded: bool,
    /// Planar depth, metres, row-major; 0 where there is no measurement.
    pub depth_m: Vec<f32>,
    /// Sphere number of each pixel, `NO_SPHERE` or `INVALID`, row-major.
    pub labels: Vec<u16>,
    /// Spheres by number; a number lives from key frame to key frame while its sphere does.
    pub spheres: Vec<Option<Sphere>>,
}

impl Default for DecodedFrame {
    fn default() -> Self {
        let intrinsics = crate::frame::Intrinsics {
            fx: 1.0,
            fy: 1.0,
            cx: 0.0,
            cy: 0.0,
        };
        let camera = Camera {
            width: 0,
            height: 0,
            intrinsics,
            depth_unit_m: 1.0,
            invalid: vec![0],
            depth_min_m: 0.0,
            depth_max_m: 0.0,
            fps: None,
            name: String::new(),
        };
        Self {
            camera,
            sequence: 0,
            time: FrameTime::default(),
            degraded: false,
            depth_m: Vec::new(),
            labels: Vec::new(),
            spheres: Vec::new(),
        }
    }
}

/// How much of a payload is decoded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// One sphere for each block of 8×8 pixels: the first of its palette. Blocks with any measurement
    /// count as measured.
    Blocks,
    /// Each measured pixel on its sphere, however far from it the sensor saw something. Pixels of no
    /// sphere are missing.
    Spheres,
    /// All: every pixel within its bound.
    #[default]
    Full,
}

impl Level {
    /// Sections that are read.
    const fn sections(self) -> usize {
        match self {
            Self::Blocks => 2,
            Self::Spheres => 3,
            Self::Full => header::SECTIONS,
        }
    }
}

/// The decoder with its reference frame and buffers.
///
/// Memory is bounded by the frame size the last key frame named (at most 2²³ pixels, about 30
/// bytes each); time by the same. No bytes make it panic.
#[derive(Debug, Default)]
pub struct Decoder {
    level: Level,
    stream: Option<(Stream, Rays, Reach)>,
    state: State,
    last_sequence: Option<u64>,
    frame: DecodedFrame,
}

impl Decoder {
    /// A decoder that waits for a key frame.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// A decoder of coarser frames, which waits for a key frame. It reads less and is faster, and takes
    /// payloads that were cut behind what it reads; the checksum of those cannot be verified.
    #[must_use]
    pub fn at(level: Level) -> Self {
        Self {
            level,
            ..Self::default()
        }
    }

    /// Decodes one payload.
    ///
    /// # Errors
    /// [`CodecError`]; after one the decoder waits for the next key frame.
    pub fn decode(&mut self, payload: &[u8]) -> Result<&DecodedFrame, CodecError> {
        let reference = self.last_sequence.take();
        let (header, sections, end) = Header::read(payload, self.level.sections())?;
        match payload.get(end..).map(<[u8]>::first_chunk) {
            Some(Some(checksum)) if payload.len() == end + checksum.len() => {
                let found = u32::from_le_bytes(*checksum);
                let computed = crc32fast::hash(&payload[..end]);
                if found != computed {
                    return Err(CodecError::Checksum { found, computed });
                }
            }
            Some(Some(_)) => {
                return Err(CodecError::Corrupt {
                    at: end,
                    what: "bytes follow the checksum",
                });
            }
            _ if self.level == Level::Full => {
                return Err(CodecError::Truncated {
                    need: end.saturating_add(4),
                    have: payload.len(),
                });
            }
            _ => {}
        }
        let key = header.stream.is_some();
        if let Some(stream) = header.stream {
            if self.stream.as_ref().is_none_or(|(s, ..)| *s != stream) {
                let camera = stream.camera();
                let reach = Reach::new(&stream.tolerance.contact, stream.depth_unit_m);
                self.stream = Some((stream, Rays::new(&camera), reach));
                self.frame.camera = camera;
                self.state = State::default();
            }
        } else if reference != Some(header.reference) {
            return Err(CodecError::MissingReference {
                sequence: header.sequence,
                reference: header.reference,
            });
        }
        let Some((stream, rays, reach)) = &self.stream else {
            return Err(CodecError::MissingReference {
                sequence: header.sequence,
                reference: header.reference,
            });
        };
        let state = &mut self.state;
        state.begin(rays, key, header.fast);
        if !key {
            state.follow(&header.motion);
        }
        let level = self.level;
        let moved = (key, &header.motion, header.plain);
        let read = read_sections(state, rays, reach, moved, sections, level).and_then(|()| {
            if level < Level::Full {
                return Ok(());
            }
            if header.plain {
                return read_plainly(state, rays, key, sections[3]);
            }
            let mut coder = RangeDecoder::new(sections[3]);
            let how = (key, stream.tolerance.lossless);
            let nothing = |_, _| 0;
            state
                .code_residual(&mut coder, rays, reach, how, None, nothing)
                .map_err(|_| CodecError::Corrupt {
                    at: 0,
                    what: "a depth integer beyond 65535 is listed",
                })?;
            overrun(&coder)
        });
        if let Err(error) = read {
            // planes left half filled would be read by the next frame, even by a key frame
            *state = State::default();
            return Err(error);
        }
        match level {
            Level::Full => write_frame(&mut self.frame, state, rays, stream, reach),
            _ => write_coarse(&mut self.frame, state, rays, level),
        }
        self.frame.sequence = header.sequence;
        self.frame.time = header.time;
        self.frame.degraded = header.degraded;
        self.last_sequence = Some(header.sequence);
        Ok(&self.frame)
    }
}

fn overrun(coder: &RangeDecoder<'_>) -> Result<(), CodecError> {
    if coder.overran() {
        return Err(CodecError::Corrupt {
            at: 0,
            what: "a section ends early",
        });
    }
    Ok(())
}

/// The bytes of mask and labels in the section *pixels* of a fast frame.
fn halves(section: &[u8]) -> Result<(&[u8], &[u8]), CodecError> {
    let split = || {
        let (length, rest) = section.split_first_chunk::<4>()?;
        rest.split_at_checked(usize::try_from(u32::from_le_bytes(*length)).ok()?)
    };
    split().ok_or(CodecError::Corrupt {
        at: 0,
        what: "the mask is longer than its section",
    })
}

/// Section *residual* of a plain frame.
fn read_plainly(
    state: &mut State,
    rays: &Rays,
    key: bool,
    section: &[u8],
) -> Result<(), CodecError> {
    let wrong = CodecError::Corrupt {
        at: 0,
        what: "plain depths are not as many as the pixels that want them",
    };
    let (length, rest) = section.split_first_chunk::<4>().ok_or(wrong.clone())?;
    let length = usize::try_from(u32::from_le_bytes(*length)).unwrap_or(usize::MAX);
    let (kinds, depths) = rest.split_at_checked(length).ok_or(wrong.clone())?;
    let mut coder = RangeDecoder::new(kinds);
    state.code_plain_kinds(&mut coder, rays, key);
    overrun(&coder)?;
    let (depths, []) = depths.as_chunks::<2>() else {
        return Err(wrong);
    };
    if depths.len() != state.plain_pixels(rays) {
        return Err(wrong);
    }
    let mut depths = depths.iter();
    state.state_plainly(rays, |_, _, on| {
        let mut row = [0; BLOCK];
        for (i, integer) in row.iter_mut().enumerate() {
            if on >> i & 1 != 0 {
                *integer = depths.next().map_or(0, |bytes| u16::from_le_bytes(*bytes));
            }
        }
        row
    });
    Ok(())
}

/// Contact map by blocks, spheres, contact map by pixels.
fn read_sections(
    state: &mut State,
    rays: &Rays,
    reach: &Reach,
    (key, motion, plain): (bool, &Motion, bool),
    sections: [&[u8]; header::SECTIONS],
    level: Level,
) -> Result<(), CodecError> {
    let mut coder = RangeDecoder::new(sections[0]);
    state
        .code_blocks(&mut coder, rays, key, &[])
        .map_err(|_| CodecError::Corrupt {
            at: 0,
            what: "a block names a sphere that does not exist",
        })?;
    overrun(&coder)?;
    let mut coder = RangeDecoder::new(sections[1]);
    let State {
        models,
        now,
        before,
        new,
        supports,
        ..
    } = state;
    Support::gather(rays, &now.map, new.bound(), supports);
    now.entries.resize(new.bound(), None);
    let mut last = None;
    for (number, support) in supports.iter().enumerate() {
        if !support.is_nowhere() {
            let past = before.entries.get(number).copied().flatten();
            let beside = support.beside(&now.entries, &before.entries, number);
            now.entries[number] = Some(sphere_table::code_entry(
                &mut coder,
                &mut models.spheres,
                rays,
                support,
                None,
                past,
                beside,
                &mut last,
            ));
        }
    }
    overrun(&coder)?;
    if level == Level::Blocks {
        return Ok(());
    }
    let how = if plain {
        mask::Precision::Plain
    } else {
        mask::Precision::Exact
    };
    state.look_back(rays, motion);
    if state.fast {
        let (of_mask, of_labels) = halves(sections[2])?;
        let (mut of_mask, mut of_labels) =
            (RangeDecoder::new(of_mask), RangeDecoder::new(of_labels));
        let coders = (&mut of_mask, &mut of_labels);
        state.code_pixels_fast(coders, rays, reach, key, (&[], how), &mut AsRead);
        overrun(&of_mask)?;
        return overrun(&of_labels);
    }
    let mut coder = RangeDecoder::new(sections[2]);
    state.code_mask(&mut coder, rays, key, &[], how);
    state.code_labels(&mut coder, rays, reach, key, &mut AsRead);
    overrun(&coder)
}
