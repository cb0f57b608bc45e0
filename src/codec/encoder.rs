//! SAINT frames to payloads.

use super::choice::{Cheapest, Errors};
use super::effort::{Effort, TRIALS, Thrift, USUAL};
use super::header::{Header, Stream};
use super::options::{CodecOptions, DEFAULT_BOUND};
use super::range_coder::Encoder as RangeEncoder;
use super::residual::Kind;
use super::spent::EncodeReport;
use super::sphere_table::{self, Entry, Statement, Support};
use super::state::{MAX_SPHERES, State};
use super::surface::{self, Surfaces, to_integer};
use super::{CodecError, EncodedFrame, mask, mask_choice, output, palette_choice};
use crate::contact_map::contact::Reach;
use crate::contact_map::labels::{Contacts, NO_SPHERE, SaintFrame};
use crate::deproject::{BLOCK, Rays, Validity};
use crate::fit::contact_distance::ContactDistance;
use crate::fit::live::FitOptions;
use crate::fit::motion::Motion;
use crate::fit::sphere::Sphere;
use crate::frame::{Camera, DepthFrame};
use rayon::prelude::*;

/// The encoder with its reference frame and buffers.
#[derive(Clone, Debug)]
pub struct Encoder {
    stream: Stream,
    rays: Rays,
    validity: Validity,
    reach: Reach,
    contact: Reach,
    options: CodecOptions,
    thrift: Thrift,
    /// The frame at hand is written plainly.
    plain: bool,
    state: State,
    plane: Vec<u16>,
    scratch: Vec<u16>,
    /// Pixels of each block that the payload calls measured, and those of them that touch the sphere
    /// they got.
    measured: Vec<u64>,
    /// Where the mask may differ: pixels of each block that the sensor measured, and those that it did
    /// not and the payload has.
    truth: Vec<u64>,
    invented: Vec<u64>,
    /// Number of blocks each model slot is in.
    blocks: Vec<u32>,
    /// Model slot to sphere number, and the surface as the model last gave it.
    numbers: Vec<Option<(u16, Sphere)>>,
    /// Sphere number to model slot.
    slots: Vec<u16>,
    sections: [Vec<u8>; super::header::SECTIONS],
    /// Labels of a fast frame.
    label_run: Vec<u8>,
    since_key: u32,
    last_sequence: Option<u64>,
}

/// A surface no model has: it never equals one, so the sphere is stated, not kept.
const NOWHERE: Sphere = Sphere {
    a: f32::NAN,
    m: glam::Vec3::NAN,
    far: false,
};

/// A block is dense where at least one pixel in so many misses its sphere.
const DENSE_FROM: u32 = 4;

impl Encoder {
    /// An encoder for frames of `camera`.
    ///
    /// # Errors
    /// [`CodecError::Limit`] where the camera is beyond the format's limits.
    pub fn new(camera: &Camera, options: CodecOptions) -> Result<Self, CodecError> {
        Stream::new(camera, options.tolerance).check()?;
        let rays = Rays::new(camera);
        // integers a unit apart keep no bound below half a unit along the most slanted ray
        let far = |side: &[f32]| side.iter().fold(0f32, |most, s| most.max(s.abs()));
        let slant = far(&rays.u).hypot(far(&rays.v)).hypot(1.0);
        let mut options = options;
        options.tolerance.lossless |=
            2.0 * options.tolerance.contact.floor_m < camera.depth_unit_m * f64::from(slant);
        let stream = Stream::new(camera, options.tolerance);
        // tables of spheres do not grow while a stream of the default fit runs
        let room = FitOptions::default().max_spheres;
        // nor do sections, below a bit for each pixel
        let bytes = rays.padded() / 8;
        Ok(Self {
            rays,
            validity: Validity::new(camera),
            reach: Reach::new(&options.tolerance.contact, camera.depth_unit_m),
            contact: Reach::new(&options.contact, camera.depth_unit_m),
            stream,
            options,
            thrift: USUAL,
            plain: false,
            state: State::with_room(room),
            plane: Vec::new(),
            scratch: Vec::new(),
            measured: Vec::new(),
            truth: Vec::new(),
            invented: Vec::new(),
            blocks: Vec::with_capacity(room),
            numbers: Vec::with_capacity(room),
            slots: Vec::with_capacity(room),
            sections: std::array::from_fn(|_| Vec::with_capacity(bytes)),
            label_run: Vec::with_capacity(bytes),
            since_key: 0,
            last_sequence: None,
        })
    }

    /// Makes the next frame a key frame.
    pub fn request_key(&mut self) {
        self.last_sequence = None;
    }

    /// From the next frame on, which becomes a key frame, spheres are fitted to `contact`: the bound is
    /// [`DEFAULT_BOUND`] times that.
    pub fn set_contact_distance(&mut self, contact: ContactDistance) {
        if contact == self.options.contact {
            return;
        }
        self.options.contact = contact;
        self.options.tolerance.contact = contact.scaled(DEFAULT_BOUND);
        self.stream.tolerance = self.options.tolerance;
        let unit_m = self.stream.depth_unit_m;
        self.reach = Reach::new(&self.options.tolerance.contact, unit_m);
        self.contact = Reach::new(&contact, unit_m);
        // another stream to the decoder: bins and planes begin anew there, too
        self.state = State::with_room(FitOptions::default().max_spheres);
        self.request_key();
    }

    /// Encodes one frame. `saint` explains `frame`: a label for each of its measured pixels.
    ///
    /// # Errors
    /// [`CodecError::Size`] where a frame is not of this camera.
    pub fn encode(
        &mut self,
        frame: &DepthFrame,
        saint: &SaintFrame,
        degraded: bool,
        out: &mut EncodedFrame,
    ) -> Result<EncodeReport, CodecError> {
        let pixels = self.rays.width * self.rays.height;
        let of_map = match &saint.contacts {
            Contacts::Labels(labels) => labels.len(),
            Contacts::Blocks(blocks) if blocks.len() == self.rays.blocks() => pixels,
            Contacts::Blocks(blocks) => blocks.len() * BLOCK * BLOCK,
        };
        for found in [frame.depth.len(), of_map] {
            if found != pixels {
                return Err(CodecError::Size {
                    found,
                    expected: pixels,
                });
            }
        }
        if self.options.effort != Effort::Max || self.plain {
            return self.encode_once(frame, saint, degraded, out);
        }
        let start = self.clone();
        let mut least = f64::INFINITY;
        let mut best = EncodeReport::default();
        let (mut trial, mut payload) = (start.clone(), EncodedFrame::default());
        for thrift in TRIALS {
            trial.clone_from(&start);
            trial.thrift = thrift;
            let report = trial.encode_once(frame, saint, degraded, &mut payload)?;
            let cost = 8.0 * payload.payload.len() as f64 + trial.error_bits();
            if cost < least {
                (least, best) = (cost, report);
                std::mem::swap(out, &mut payload);
                std::mem::swap(self, &mut trial);
            }
        }
        Ok(best)
    }

    /// Encodes one frame for which there is no time: mask pixels and the depths that no sphere gives
    /// back are written as they are, in blocks that have any, and a block gets one sphere. A VGA frame
    /// of noise takes some 2 ms, not 30, and 16 bits a pixel.
    ///
    /// # Errors
    /// As [`encode`](Self::encode).
    pub fn encode_plainly(
        &mut self,
        frame: &DepthFrame,
        saint: &SaintFrame,
        out: &mut EncodedFrame,
    ) -> Result<EncodeReport, CodecError> {
        self.plain = true;
        let report = self.encode(frame, saint, true, out);
        self.plain = false;
        report
    }

    /// Differences along z, metres, between `frame`, the last one encoded, and what its payload gives
    /// back: of pixels that both have, in one block of 8×8 in `every`, from block `first` on. None where
    /// another frame was the last one.
    pub fn errors(
        &self,
        frame: &DepthFrame,
        (first, every): (usize, usize),
        mut error: impl FnMut(f32),
    ) {
        let (rays, stream) = (&self.rays, &self.stream);
        let known = self.last_sequence == Some(frame.sequence);
        if !known || frame.depth.len() != rays.width * rays.height {
            return;
        }
        for k in (first..rays.blocks()).step_by(every.max(1)) {
            let depths = output::block_depths(&self.state, rays, k, stream, &self.reach);
            let (x0, y0, w, h) = mask::extent(rays, k);
            for (j, row) in depths.chunks_exact(BLOCK).take(h).enumerate() {
                let raw = &frame.depth[(y0 + j) * rays.width + x0..][..w];
                for (&z, &raw) in row.iter().zip(raw) {
                    if z > 0.0 && self.validity.accepts(raw) {
                        error((f64::from(raw) * stream.depth_unit_m) as f32 - z);
                    }
                }
            }
        }
    }

    /// What the errors of the frame last encoded are worth, in bits, by the price that labels were
    /// chosen at.
    fn error_bits(&self) -> f64 {
        let errors = Errors {
            plane: &self.plane,
            reach: &self.reach,
            contact: &self.contact,
        };
        let (mut depths, mut prices) = (surface::NOTHING, [0u16; BLOCK * BLOCK]);
        let mut sum = 0u64;
        for (k, &hits) in self.state.hits.iter().enumerate().filter(|h| *h.1 != 0) {
            self.state.now.depths(&self.rays, k, &mut depths);
            errors.prices(&self.rays, k, &depths, &mut prices);
            let hit = |i: usize| u64::from(prices[i]) * (hits >> i & 1);
            sum += (0..BLOCK * BLOCK).map(hit).sum::<u64>();
        }
        sum as f64 / 16.0
    }

    fn encode_once(
        &mut self,
        frame: &DepthFrame,
        saint: &SaintFrame,
        degraded: bool,
        out: &mut EncodedFrame,
    ) -> Result<EncodeReport, CodecError> {
        let reference = self
            .last_sequence
            .filter(|_| self.since_key + 1 < self.options.keyframe_every);
        let key = reference.is_none();
        // an error on the way leaves no reference
        self.last_sequence = None;
        let fast = self.options.effort == Effort::Live;
        self.state.begin(&self.rays, key, fast);
        if !key {
            self.state.follow(&saint.motion);
            let mover = saint.motion.mover();
            for (_, sphere) in self
                .numbers
                .iter_mut()
                .flatten()
                .filter(|_| !saint.motion.is_still())
            {
                *sphere = mover.sphere(sphere).unwrap_or(NOWHERE);
            }
        }
        let mut report = EncodeReport {
            valid_pixels: self.take_in(frame) as u32,
            ..Default::default()
        };
        if self.smooths() {
            self.truth.clone_from(&self.measured);
            let past = (!key).then_some(&self.state.before.mask.pixels);
            mask_choice::smooth(&self.rays, &mut self.plane, past, &mut self.scratch);
            mask::measure(&self.rays, &self.plane, &mut self.measured);
        }
        self.choose_palettes(saint);
        self.number_spheres(key);
        for s in &mut self.sections {
            s.clear();
        }
        self.code_blocks(key)?;
        self.code_spheres(saint, &mut report);
        let motion = if key { Motion::default() } else { saint.motion };
        self.code_pixels(key, &motion, &mut report);
        self.choose_kinds(&mut report);
        self.code_residuals(key)?;

        let header = Header {
            stream: key.then_some(self.stream),
            sequence: frame.sequence,
            reference: reference.unwrap_or(0),
            time: frame.time,
            motion: saint.motion,
            degraded,
            plain: self.plain,
            fast,
            sections: [0, 1, 2, 3].map(|k| self.sections[k].len()),
        };
        out.sequence = frame.sequence;
        out.time = frame.time;
        out.key = key;
        out.payload.clear();
        header.write(&mut out.payload);
        report.header_bytes = out.payload.len() as u32 + 4;
        [
            report.block_bytes,
            report.sphere_bytes,
            report.pixel_bytes,
            report.residual_bytes,
        ] = header.sections.map(|n| n as u32);
        // a section lacks the zeros at its end
        let within = |spent: u64, bytes: u32| (spent.div_ceil(16) as u32).min(8 * bytes);
        let [fills, mask] = self.state.mask_bits;
        report.fill_bits = within(fills, report.block_bytes);
        report.mask_bits = within(mask, report.pixel_bytes);
        for s in &self.sections {
            out.payload.extend_from_slice(s);
        }
        let checksum = crc32fast::hash(&out.payload);
        out.payload.extend(checksum.to_le_bytes());
        self.last_sequence = Some(frame.sequence);
        self.since_key = if key { 0 } else { self.since_key + 1 };
        Ok(report)
    }

    /// Depth integers and measured pixels of a frame; returns how many are measured.
    fn take_in(&mut self, frame: &DepthFrame) -> usize {
        let (rays, validity) = (&self.rays, &self.validity);
        self.plane.resize(rays.padded(), 0);
        self.measured.resize(rays.blocks(), 0);
        // a row of blocks is looked at while its pixels are at hand
        let planes = self.plane.par_chunks_mut(rays.stride() * BLOCK);
        let frames = frame.depth.par_chunks(rays.width * BLOCK);
        let rows = self.measured.par_chunks_mut(rays.block_columns);
        planes
            .zip(frames)
            .zip(rows)
            .map(|((plane, depth), row)| {
                let pixels = validity.clean_rows(rays, depth, plane);
                mask::measure_row(rays, plane, row);
                pixels
            })
            .sum()
    }

    fn choose_palettes(&mut self, saint: &SaintFrame) {
        let errors = Errors {
            plane: &self.plane,
            reach: &self.reach,
            contact: &self.contact,
        };
        let (measured, truth) = (&self.measured, &self.truth);
        palette_choice::choose(
            saint,
            &self.rays,
            &errors,
            measured,
            |k| {
                // what was not measured has no label
                let known = truth.get(k).map_or(measured[k], |t| measured[k] & t);
                if known == 0 { measured[k] } else { known }
            },
            self.plain,
            &self.thrift,
            &mut self.blocks,
            &mut self.state.now.map,
        );
    }

    /// Model slots to sphere numbers: a slot keeps its number while it lives; new ones get the
    /// lowest free number in the order in which the payload meets them.
    fn number_spheres(&mut self, key: bool) {
        if key {
            self.numbers.clear();
            self.slots.clear();
        }
        let State { now, new, .. } = &mut self.state;
        for k in 0..self.rays.blocks() {
            let size = usize::from(now.map.sizes[k]);
            for entry in &mut now.map.palettes[k][..size] {
                let slot = *entry;
                if slot == NO_SPHERE {
                    continue;
                }
                if self.numbers.len() <= usize::from(slot) {
                    self.numbers.resize(usize::from(slot) + 1, None);
                }
                let number = match self.numbers[usize::from(slot)] {
                    Some((n, _)) => n,
                    None => {
                        let n = new.take() as u16;
                        self.numbers[usize::from(slot)] = Some((n, NOWHERE));
                        n
                    }
                };
                if self.slots.len() <= usize::from(number) {
                    self.slots.resize(usize::from(number) + 1, NO_SPHERE);
                }
                self.slots[usize::from(number)] = slot;
                *entry = number;
            }
        }
        // the coder gives the numbers away a second time
        new.start_over();
    }

    fn code_blocks(&mut self, key: bool) -> Result<(), CodecError> {
        let mut coder = RangeEncoder::new(&mut self.sections[0]);
        self.state
            .code_blocks(&mut coder, &self.rays, key, &self.measured)
            .map_err(|e| {
                CodecError::Limit(format!(
                    "{} spheres in one frame (at most {MAX_SPHERES})",
                    e.0
                ))
            })?;
        coder.finish();
        Ok(())
    }

    /// True where the mask may differ from the sensor's.
    fn smooths(&self) -> bool {
        self.options.smooth_mask && !self.options.tolerance.lossless
    }

    fn code_pixels(&mut self, key: bool, motion: &Motion, report: &mut EncodeReport) {
        let smooths = self.smooths();
        let how = match (self.plain, smooths) {
            (true, _) => mask::Precision::Plain,
            (_, true) => mask::Precision::Within(mask_choice::PATIENCE),
            _ => mask::Precision::Exact,
        };
        self.state.look_back(&self.rays, motion);
        let fast = self.state.fast;
        let [.., section, _] = &mut self.sections;
        self.label_run.clear();
        if fast {
            section.extend([0; 4]);
        }
        let mut of_mask = RangeEncoder::new(section);
        let mut of_labels = RangeEncoder::new(&mut self.label_run);
        if smooths || !fast {
            self.state
                .code_mask(&mut of_mask, &self.rays, key, &self.measured, how);
        }
        if smooths {
            let decided = (&self.state.now.mask, &self.truth[..]);
            let (measured, invented) = (&mut self.measured, &mut self.invented);
            let planes = (&mut self.plane[..], &self.scratch[..]);
            let changed = mask_choice::settle(&self.rays, decided, planes, measured, invented);
            (report.lost_pixels, report.invented_pixels) = (changed.lost, changed.invented);
        }
        let errors = Errors {
            plane: &self.plane,
            reach: &self.reach,
            contact: &self.contact,
        };
        let pixels = (&self.measured[..], &self.invented[..]);
        let mut choice = Cheapest::new(&self.rays, errors, pixels);
        let (rays, reach) = (&self.rays, &self.reach);
        let State { now, hits, .. } = &mut self.state;
        choice.touch_alone(&now.map, &Surfaces(&now.entries), hits);
        if !fast {
            self.state
                .code_labels(&mut of_mask, rays, reach, key, &mut choice);
            of_mask.finish();
            return;
        }
        if smooths {
            self.state
                .code_labels(&mut of_labels, rays, reach, key, &mut choice);
        } else {
            let coders = (&mut of_mask, &mut of_labels);
            let wanted = (&self.measured[..], how);
            self.state
                .code_pixels_fast(coders, rays, reach, key, wanted, &mut choice);
        }
        of_mask.finish();
        of_labels.finish();
        let length = (section.len() - 4) as u32;
        section[..4].copy_from_slice(&length.to_le_bytes());
        section.extend_from_slice(&self.label_run);
    }

    fn code_spheres(&mut self, saint: &SaintFrame, report: &mut EncodeReport) {
        let State {
            models,
            now,
            before,
            new,
            supports,
            ..
        } = &mut self.state;
        Support::gather(&self.rays, &now.map, new.bound(), supports);
        now.entries.resize(new.bound(), None);
        let mut coder = RangeEncoder::new(&mut self.sections[1]);
        let mut last = None;
        for (number, support) in supports.iter().enumerate() {
            let past: Option<Entry> = before.entries.get(number).copied().flatten();
            if support.is_nowhere() {
                if let Some(slot) = self.slots.get(number).filter(|s| **s != NO_SPHERE) {
                    self.numbers[usize::from(*slot)] = None;
                }
                if let Some(slot) = self.slots.get_mut(number) {
                    *slot = NO_SPHERE;
                }
                continue;
            }
            report.spheres += 1;
            let slot = usize::from(self.slots[number]);
            let Some(sphere) = saint.spheres[slot] else {
                continue;
            };
            let statement = match self.numbers[slot] {
                Some((_, known)) if past.is_some() && known == sphere => {
                    report.kept_spheres += 1;
                    Statement::Keep
                }
                _ => {
                    let w = support.depth(&self.rays, &sphere).max(1e-3);
                    let z = 1.0 / w;
                    let size = self.thrift.step * self.options.contact.at(z) * w * w;
                    Statement::Sphere(sphere, size)
                }
            };
            self.numbers[slot] = Some((number as u16, sphere));
            let beside = support.beside(&now.entries, &before.entries, number);
            let entry = sphere_table::code_entry(
                &mut coder,
                &mut models.spheres,
                &self.rays,
                support,
                Some(statement),
                past,
                beside,
                &mut last,
            );
            now.entries[number] = Some(entry);
        }
        coder.finish();
    }

    /// What of each block its spheres give back, and so its kind.
    fn choose_kinds(&mut self, report: &mut EncodeReport) {
        report.touching_pixels = self.state.hits.iter().map(|h| h.count_ones()).sum();
        if self.options.tolerance.lossless {
            self.keep_exact_hits();
        }
        let State { now, hits, .. } = &mut self.state;
        for (k, kind) in now.kinds.iter_mut().enumerate() {
            let size = usize::from(now.map.sizes[k]);
            if size == 0 {
                continue;
            }
            let all = self.measured[k];
            let missed = (all & !hits[k]).count_ones();
            *kind = if missed == 0 {
                Kind::Smooth
            } else if !self.plain && missed * DENSE_FROM < all.count_ones() {
                Kind::Sparse
            } else {
                Kind::Dense
            };
        }
    }

    /// Lossless, a hit is a pixel whose sphere gives the integer itself.
    fn keep_exact_hits(&mut self) {
        let (rays, stride) = (&self.rays, self.rays.stride());
        let State { now, hits, .. } = &mut self.state;
        let mut depths = surface::NOTHING;
        for (k, hits) in hits.iter_mut().enumerate().filter(|h| *h.1 != 0) {
            now.depths(rays, k, &mut depths);
            let (x0, y0, ..) = mask::extent(rays, k);
            for (j, row) in depths.chunks_exact(BLOCK).enumerate() {
                let raw = &self.plane[(y0 + j) * stride + x0..][..BLOCK];
                for (i, (&depth, &raw)) in row.iter().zip(raw).enumerate() {
                    *hits &= !(u64::from(to_integer(depth) != raw) << (BLOCK * j + i));
                }
            }
        }
    }

    fn code_residuals(&mut self, key: bool) -> Result<(), CodecError> {
        let (rays, plane) = (&self.rays, &self.plane);
        let stride = rays.stride();
        if self.plain {
            let section = &mut self.sections[3];
            section.extend([0; 4]);
            let mut coder = RangeEncoder::new(section);
            self.state.code_plain_kinds(&mut coder, rays, key);
            coder.finish();
            let length = (section.len() - 4) as u32;
            section[..4].copy_from_slice(&length.to_le_bytes());
            section.reserve(2 * self.state.plain_pixels(rays));
            self.state.state_plainly(rays, |x, y, on| {
                let row = plane[y * stride + x..].first_chunk();
                let row = row.copied().unwrap_or_default();
                let bytes = row.map(u16::to_le_bytes);
                if on == u8::MAX {
                    section.extend_from_slice(bytes.as_flattened());
                } else {
                    let some = (0..BLOCK).filter(|i| on >> i & 1 != 0);
                    section.extend(some.flat_map(|i| bytes[i]));
                }
                row
            });
            return Ok(());
        }
        let mut coder = RangeEncoder::new(&mut self.sections[3]);
        let how = (key, self.options.tolerance.lossless);
        let wanted = |x: usize, y: usize| plane[y * stride + x];
        self.state
            .code_residual(&mut coder, rays, &self.reach, how, Some(plane), wanted)
            .map_err(|_| CodecError::Limit("a depth integer beyond 65535".to_string()))?;
        coder.finish();
        Ok(())
    }
}
