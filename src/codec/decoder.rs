//! Payloads to depth frames, spheres and contact maps.

use super::CodecError;
use super::cells;
use super::header::{self, Header, Stream};
use super::label_map::AsRead;
use super::mask::{self, Fill};
use super::range_coder::Decoder as RangeDecoder;
use super::residual::Kind;
use super::sphere_table::{self, Support};
use super::state::State;
use super::surface::{self, BEYOND, Depths, Surface, Surfaces, packed, to_integer};
use crate::contact_map::contact::Reach;
use crate::contact_map::labels::{INVALID, NO_SPHERE};
use crate::deproject::{BLOCK, Rays};
use crate::fit::motion::Motion;
use crate::fit::sphere::Sphere;
use crate::frame::{Camera, FrameTime};
use rayon::prelude::*;
use std::ops::Range;

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
    state.state_plainly(rays, |_, _| {
        depths.next().map_or(0, |bytes| u16::from_le_bytes(*bytes))
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

/// A frame of spheres only: of each block's first one, or of each pixel's.
fn write_coarse(frame: &mut DecodedFrame, state: &State, rays: &Rays, level: Level) {
    let now = &state.now;
    frame.depth_m.clear();
    frame.depth_m.resize(rays.width * rays.height, 0.0);
    frame.labels.clear();
    frame.labels.resize(rays.width * rays.height, INVALID);
    let surfaces = Surfaces(&now.entries);
    let mut depths = surface::NOTHING;
    for k in 0..rays.blocks() {
        if now.mask.fills[k] == Fill::Empty {
            continue;
        }
        if level == Level::Blocks {
            surfaces.depths(rays, k, now.map.palettes[k][0], &mut depths);
        }
        let (x0, y0, w, h) = mask::extent(rays, k);
        let (whole, on) = if level == Level::Blocks {
            (Some(now.map.palettes[k][0]), u64::MAX)
        } else {
            now.depths(rays, k, &state.tiles, &mut depths);
            (None, now.mask.block(rays, k))
        };
        for j in 0..h {
            for i in (0..w).filter(|i| on >> (BLOCK * j + i) & 1 != 0) {
                let bit = BLOCK * j + i;
                let (depth, label) = (depths[bit], whole.unwrap_or(now.map.label(k, bit)));
                if label != NO_SPHERE && depth > 0.0 && depth < BEYOND {
                    let at = (y0 + j) * rays.width + x0 + i;
                    frame.depth_m[at] = depth * rays.unit;
                    frame.labels[at] = label;
                }
            }
        }
    }
    frame.spheres.clear();
    frame
        .spheres
        .extend(now.entries.iter().map(|e| e.map(|e| e.sphere)));
}

/// Planes to the public frame (`FORMAT.md` §1.6, "Output").
fn write_frame(
    frame: &mut DecodedFrame,
    state: &State,
    rays: &Rays,
    stream: &Stream,
    reach: &Reach,
) {
    let pixels = rays.width * rays.height;
    frame.depth_m.resize(pixels, 0.0);
    frame.labels.resize(pixels, INVALID);
    let out = (&mut frame.depth_m[..], &mut frame.labels[..]);
    write_pixels(out, state, rays, stream, reach);
    frame.spheres.clear();
    frame
        .spheres
        .extend(state.now.entries.iter().map(|e| e.map(|e| e.sphere)));
}

fn write_pixels(
    (depth_m, labels): (&mut [f32], &mut [u16]),
    state: &State,
    rays: &Rays,
    stream: &Stream,
    reach: &Reach,
) {
    let row = rays.width * BLOCK;
    let rows = depth_m.par_chunks_mut(row).zip(labels.par_chunks_mut(row));
    rows.enumerate()
        .for_each(|(by, out)| write_block_row(out, by, state, rays, stream, reach));
}

#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn write_block_row(
    (depth_m, labels): (&mut [f32], &mut [u16]),
    by: usize,
    state: &State,
    rays: &Rays,
    stream: &Stream,
    reach: &Reach,
) {
    let single = stream.depth_unit_m as f32;
    let lossless = stream.tolerance.lossless;
    let mut block = Pixels {
        depths: surface::NOTHING,
        labels: [INVALID; BLOCK * BLOCK],
    };
    let surfaces = Surfaces(&state.now.entries);
    let mut next = 0;
    for bx in 0..rays.block_columns {
        if bx < next {
            continue;
        }
        let k = by * rays.block_columns + bx;
        let id = state.now.map.palettes[k][0];
        let run = if lossless {
            0
        } else {
            full_run(state, rays, k)
        };
        if let (1.., Some(sphere)) = (run, surfaces.surface(rays, id)) {
            let columns = bx * BLOCK..(bx + run) * BLOCK;
            if write_run((depth_m, labels), rays, by, columns, &sphere, (id, single)) {
                next = bx + run;
                continue;
            }
        }
        let on = state.now.mask.block(rays, k);
        let odd = block.look_up(state, rays, (bx, by), on, single);
        let again = if lossless { on } else { odd };
        if again != 0 {
            block.rebuild(state, rays, k, again, stream, reach);
        }
        let (x0, _, w, h) = mask::extent(rays, k);
        let rows = depth_m
            .chunks_exact_mut(rays.width)
            .zip(labels.chunks_exact_mut(rays.width));
        let own = block.depths.as_chunks::<BLOCK>().0.iter();
        let own = own.zip(block.labels.as_chunks::<BLOCK>().0);
        for ((depth_m, labels), (depths, ids)) in rows.zip(own).take(h) {
            let (depth_m, labels) = (&mut depth_m[x0..x0 + w], &mut labels[x0..x0 + w]);
            // of a size known beforehand, but at the edge
            match (depth_m.first_chunk_mut(), labels.first_chunk_mut()) {
                (Some(depth_m), Some(labels)) => (*depth_m, *labels) = (*depths, *ids),
                _ => {
                    depth_m.copy_from_slice(&depths[..w]);
                    labels.copy_from_slice(&ids[..w]);
                }
            }
        }
    }
}

/// Blocks from `k` on, side by side, that are full, of the same one sphere and given back by it.
#[inline(always)]
fn full_run(state: &State, rays: &Rays, k: usize) -> usize {
    let now = &state.now;
    let id = now.map.palettes[k][0];
    let whole = rays.width / BLOCK;
    let most = whole.saturating_sub(k % rays.block_columns);
    let alike = |&k: &usize| {
        now.mask.fills[k] == Fill::Full
            && now.kinds[k] == Kind::Smooth
            && now.map.sizes[k] == 1
            && now.map.palettes[k][0] == id
    };
    (k..k + most).take_while(alike).count()
}

/// Writes such `columns`; false where the sphere does not give a depth to each of them after all.
#[inline(always)]
fn write_run(
    (depth_m, labels): (&mut [f32], &mut [u16]),
    rays: &Rays,
    by: usize,
    columns: Range<usize>,
    sphere: &Surface,
    (id, single): (u16, f32),
) -> bool {
    let rows = depth_m.chunks_exact_mut(rays.width);
    let rows = rows.zip(labels.chunks_exact_mut(rays.width));
    let mut odd = 0u32;
    for ((depth_m, labels), &v) in rows.zip(&rays.v[by * BLOCK..]) {
        labels[columns.clone()].fill(id);
        for (z, &u) in depth_m[columns.clone()]
            .iter_mut()
            .zip(&rays.u[columns.clone()])
        {
            let depth = sphere.depth(u, v);
            odd |= u32::from(!surface::is_real(depth));
            *z = depth * single;
        }
    }
    odd == 0
}

/// The cells of block `k`, where some of its pixels may come back from bins.
#[inline(always)]
fn rough_tile(state: &State, k: usize) -> Option<&cells::Tile> {
    let rough = state.now.kinds[k] != Kind::Smooth;
    rough.then(|| state.cells.tile(k)).flatten()
}

/// The pixels of a block of the public frame.
struct Pixels {
    /// Metres; 0 where there is no measurement.
    depths: Depths,
    labels: [u16; BLOCK * BLOCK],
}

impl Pixels {
    /// As if every pixel's sphere gave its depth; returns those of `on` where that is not so. `single`:
    /// metres of a depth integer.
    #[inline(always)]
    fn look_up(
        &mut self,
        state: &State,
        rays: &Rays,
        (bx, by): (usize, usize),
        on: u64,
        single: f32,
    ) -> u64 {
        let (now, k) = (&state.now, by * rays.block_columns + bx);
        if on == 0 {
            (self.depths, self.labels) = (surface::NOTHING, [INVALID; BLOCK * BLOCK]);
            return 0;
        }
        let Self { depths, labels } = self;
        now.depths(rays, k, &state.tiles, depths);
        let mut coded = [0u8; BLOCK * BLOCK];
        if let Some(tile) = rough_tile(state, k) {
            for (coded, cell) in coded.iter_mut().zip(tile) {
                *coded = u8::from(cell.is_coded());
            }
        }
        *labels = match now.map.tile(k) {
            Some(tile) => *tile,
            None => [now.map.palettes[k][0]; BLOCK * BLOCK],
        };
        let mut odd = [0u8; BLOCK * BLOCK];
        let rows = depths.as_chunks_mut::<BLOCK>().0.iter_mut();
        let rows = rows.zip(labels.as_chunks_mut::<BLOCK>().0);
        let rows = rows.zip(odd.as_chunks_mut::<BLOCK>().0);
        for (((depths, labels), odd), bits) in rows.zip(on.to_le_bytes()) {
            let (mut z, mut ids) = (*depths, *labels);
            for i in 0..BLOCK {
                let on = u32::from(bits) >> i & 1;
                odd[i] = u8::from(!surface::is_real(z[i]));
                z[i] = f32::from_bits((z[i] * single).to_bits() & on.wrapping_neg());
                // `INVALID` is all ones
                ids[i] |= (on as u16).wrapping_sub(1);
            }
            (*depths, *labels) = (z, ids);
        }
        (packed(&odd) | packed(&coded)) & on
    }

    /// These pixels of block `k` again, by their integers.
    #[inline(always)]
    fn rebuild(
        &mut self,
        state: &State,
        rays: &Rays,
        k: usize,
        mut pixels: u64,
        stream: &Stream,
        reach: &Reach,
    ) {
        let now = &state.now;
        let (unit, lossless) = (stream.depth_unit_m, stream.tolerance.lossless);
        let (x0, y0, ..) = mask::extent(rays, k);
        let tile = rough_tile(state, k);
        let mut depths = surface::NOTHING;
        now.depths(rays, k, &state.tiles, &mut depths);
        while pixels != 0 {
            let bit = pixels.trailing_zeros() as usize;
            pixels &= pixels - 1;
            let (x, y) = (x0 + bit % BLOCK, y0 + bit / BLOCK);
            let (whole, own) = match tile.map(|tile| tile[bit]) {
                None => (to_integer(depths[bit]), depths[bit]),
                Some(cell) if cell.is_coded() && !surface::is_real(depths[bit]) => {
                    (cell.integer, 0.0)
                }
                Some(cell) => (cell.integer, depths[bit]),
            };
            // 0 would mean that nothing was measured
            let integer = whole.max(1);
            self.depths[bit] = if lossless {
                (f64::from(integer) * unit) as f32
            } else {
                f32::from(integer) * unit as f32
            };
            let (u, v) = (rays.u[x], rays.v[y]);
            let q = u * u + v * v + 1.0;
            if !reach.touches(f32::from(integer), own.abs(), q) {
                self.labels[bit] = NO_SPHERE;
            }
        }
    }
}
