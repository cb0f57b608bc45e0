//! The live fit: one depth frame to spheres and contact map, warm from the frame before.
//!
//! A frame goes through these passes, each over blocks of 8×8 pixels:
//! 1. moments of every block ([`moments`]);
//! 2. warm start (`warm`): the last frame's spheres are moved with the camera and refitted from the
//!    moments of the blocks they still explain, or kept to the bit where that is as good;
//! 3. contact ([`assign`]): each block's pixels are given to the fewest spheres that touch them. A
//!    block that its last sphere explains is looked at once;
//! 4. cold fit (`cold`): what touches nothing is grown from block patches into spheres, inside each
//!    hex-packed cell first, then across cells, and the blocks concerned go through contact again;
//! 5. what still touches nothing is fitted again as points of its own (paper 3.1: "use the
//!    remaining points to fit the sphere again").
//!
//! The deadline is asked between and inside the passes. When time is up the frame is finished with
//! the spheres there are; pixels without one are coded by the codec's fallback and counted.

use super::agglomerate::{Agglomeration, Patch};
use super::contact_distance::ContactDistance;
use super::contacts::{View, touching};
use super::moments::{self, Moments};
use super::motion::Motion;
use super::sphere::Sphere;
use super::{cold, warm};
use crate::contact_map::assign::{self, BlockContacts, Candidates, EMPTY, Palette};
use crate::contact_map::contact::{Contact, measured};
use crate::contact_map::labels::{Contacts, NO_SPHERE, SaintFrame};
use crate::deproject::{BLOCK, Rays, Validity};
use crate::frame::{Camera, DepthFrame};
use crate::partition::lattice::{Lattice, Packing};
use rayon::prelude::*;

/// Parameters of the live fit, named as in the paper.
#[derive(Clone, Copy, Debug)]
pub struct FitOptions {
    /// How far a point may lie from its sphere.
    pub contact_distance: ContactDistance,
    /// Most spheres at a time (the paper's *ms*).
    pub max_spheres: usize,
    /// Distance of neighbouring cell centres, metres.
    pub cube_size_m: f64,
    /// Lattice of the cells.
    pub packing: Packing,
    /// False fits every frame from nothing.
    pub warm_start: bool,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            contact_distance: ContactDistance::default(),
            max_spheres: 4096,
            cube_size_m: 0.25,
            packing: Packing::Hexagonal,
            warm_start: true,
        }
    }
}

/// What one call of [`Modeler::model`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct FitReport {
    /// Pixels that hold a measurement.
    pub valid_pixels: u32,
    /// Pixels that touch a sphere.
    pub explained_pixels: u32,
    /// Pixels of blocks the warm start settled.
    pub warm_pixels: u32,
    /// Pixels that went through the cold fit.
    pub cold_pixels: u32,
    /// Spheres in the frame.
    pub spheres: u32,
    /// Spheres that came through from the frame before to the bit.
    pub kept: u32,
    /// Spheres refitted.
    pub refitted: u32,
    /// Spheres that are new.
    pub new: u32,
    /// True where the deadline cut the fit short.
    pub degraded: bool,
}

/// The blocks of a frame between the passes, one entry of each list a block.
#[derive(Debug, Default)]
pub(super) struct Blocks {
    /// Measured pixels.
    pub valid: Vec<u64>,
    /// Sums over them; empty where there are too few.
    pub moments: Vec<Moments>,
    /// The spheres fitted to the block or to parts of it, or `NO_SPHERE`.
    pub spheres: Vec<[u16; 2]>,
    /// Pixels by sphere.
    pub contacts: Vec<BlockContacts>,
    /// How far the block's moments lie from its sphere of the last frame (mean square, surface
    /// distances); infinite where it has none.
    pub misfit: Vec<f32>,
    /// Spheres that had pixels here in the last frame.
    pub before: Vec<Palette>,
}

impl Blocks {
    fn new(count: usize) -> Self {
        Self {
            valid: vec![0; count],
            moments: vec![Moments::default(); count],
            spheres: vec![NOTHING; count],
            misfit: vec![f32::INFINITY; count],
            contacts: vec![BlockContacts::default(); count],
            before: vec![EMPTY; count],
        }
    }

    /// Number of blocks.
    pub(super) fn len(&self) -> usize {
        self.valid.len()
    }
}

/// No sphere is fitted to a block.
pub(super) const NOTHING: [u16; 2] = [NO_SPHERE; 2];

/// Share of the contact distance to which surfaces are fitted. Fitted to all of it, a sphere would
/// take in its neighbours' noise; fitted to less, spheres describe surfaces and the rest of
/// the distance is room for noise. At equal Chamfer distance (Kinect, moving, 2 mm) that saves a
/// quarter of the bits; a still smaller share saves 5 % more but breaks plain walls into patches.
const SURFACE_SHARE: f64 = 0.7;
/// Share of the contact distance within which a point touches a sphere; what is left is room
/// for the quantisation of spheres in the payload.
const TOUCH_SHARE: f64 = 0.95;
/// Share of the contact distance, along the ray, that a sphere chosen for a pixel keeps.
const RAY_SHARE: f64 = 0.85;

/// A block's largest distance along the ray squared is at most its points' sum: with this factor
/// (surface distances to reach, and room for the slope inside the block) a sum below 1 says that
/// all of them are within reach.
pub(super) const SUM_TO_REACH: f32 =
    (SURFACE_SHARE * SURFACE_SHARE / (RAY_SHARE * RAY_SHARE) / 0.7) as f32;

/// Blocks offered to their neighbours' spheres between two looks at the clock.
const OFFERS: u32 = 128;

/// Fewest pixels from which a block's surface is judged.
pub(super) const MIN_BLOCK_PIXELS: u32 = 12;

/// The live fit with its state from frame to frame and its buffers.
#[derive(Debug)]
pub struct Modeler {
    rays: Rays,
    validity: Validity,
    contact: Contact,
    options: FitOptions,
    surface: ContactDistance,
    lattice: Lattice,
    plane: Vec<u16>,
    blocks: Blocks,
    /// Blocks that are to go through contact.
    pending: Vec<bool>,
    /// Blocks with room for a sphere of the blocks around.
    wanting: Vec<u32>,
    frames: u32,
    slots: Vec<Option<Patch>>,
    /// The slots' surfaces, where the contact pass reads them.
    surfaces: Vec<Option<Sphere>>,
    motion: Motion,
    graph: Agglomeration,
    warm: warm::Workspace,
    cold: cold::Workspace,
}

impl Modeler {
    /// A modeler for frames of `camera`.
    #[must_use]
    pub fn new(camera: &Camera, options: &FitOptions) -> Self {
        let rays = Rays::new(camera);
        // tables of spheres never grow while a stream runs
        let room = options.max_spheres.min(usize::from(NO_SPHERE));
        Self {
            validity: Validity::new(camera),
            contact: Contact::new(
                &options.contact_distance.scaled(TOUCH_SHARE),
                RAY_SHARE / TOUCH_SHARE,
            ),
            surface: options.contact_distance.scaled(SURFACE_SHARE),
            options: *options,
            lattice: Lattice::new(options.packing, options.cube_size_m),
            plane: Vec::new(),
            blocks: Blocks::new(rays.blocks()),
            pending: vec![true; rays.blocks()],
            wanting: Vec::with_capacity(rays.blocks()),
            frames: 0,
            slots: Vec::with_capacity(room),
            surfaces: Vec::with_capacity(room),
            motion: Motion::default(),
            graph: Agglomeration::default(),
            warm: warm::Workspace::with_room(room),
            cold: cold::Workspace::with_room(room),
            rays,
        }
    }

    /// Fits the frames that follow to this distance, the last frame's spheres first.
    pub fn set_contact_distance(&mut self, distance: &ContactDistance) {
        self.options.contact_distance = *distance;
        self.contact = Contact::new(&distance.scaled(TOUCH_SHARE), RAY_SHARE / TOUCH_SHARE);
        self.surface = distance.scaled(SURFACE_SHARE);
    }

    /// Forgets the frame before: the next one is fitted from nothing.
    pub fn reset(&mut self) {
        self.blocks.before.fill(EMPTY);
        self.slots.clear();
        self.surfaces.clear();
        self.cold.restart();
        self.frames = 0;
    }

    /// Fits `frame`; `time_is_up` is asked often and ends the search where it says true.
    pub fn model(
        &mut self,
        frame: &DepthFrame,
        out: &mut SaintFrame,
        time_is_up: &dyn Fn() -> bool,
    ) -> FitReport {
        if !self.options.warm_start {
            self.reset();
        }
        let warm = !self.slots.is_empty();
        let mut report = FitReport {
            valid_pixels: self.measure(frame) as u32,
            ..FitReport::default()
        };

        if warm {
            self.warm_start(&mut report);
            self.touch(false, time_is_up, &mut report);
        } else {
            self.start_cold();
        }
        self.fit(warm, time_is_up, &mut report);
        self.adopt(time_is_up, &mut report);
        self.finish(out, &mut report);
        self.frames = self.frames.wrapping_add(1);
        report
    }

    /// Pass 1: measured pixels and moments of each block. Returns how many are measured.
    ///
    /// # Panics
    /// Where the frame does not have `width * height` pixels: sources guarantee it.
    fn measure(&mut self, frame: &DepthFrame) -> usize {
        let (rays, validity, distance) = (&self.rays, &self.validity, &self.surface);
        assert_eq!(frame.depth.len(), rays.width * rays.height);
        self.plane.resize(rays.padded(), 0);
        let columns = rays.block_columns;
        let blocks = &mut self.blocks;
        // a row of blocks is measured while its pixels are at hand
        let pixels = self
            .plane
            .par_chunks_mut(rays.stride() * BLOCK)
            .zip(frame.depth.par_chunks(rays.width * BLOCK))
            .zip(blocks.valid.par_chunks_mut(columns))
            .zip(blocks.moments.par_chunks_mut(columns))
            .enumerate()
            .map(|(by, (((plane, depth), valid), moments))| {
                let pixels = validity.clean_rows(rays, depth, plane);
                measure_row(plane, rays, by, valid, moments, distance);
                pixels
            })
            .sum();
        blocks.spheres.fill(NOTHING);
        blocks.misfit.fill(f32::INFINITY);
        self.motion = Motion::default();
        pixels
    }

    /// No block has a sphere yet.
    fn start_cold(&mut self) {
        let blocks = &mut self.blocks;
        for (contacts, &valid) in blocks.contacts.iter_mut().zip(&blocks.valid) {
            *contacts = BlockContacts::untouched(valid);
        }
    }

    /// Pass 2: the last frame's spheres.
    fn warm_start(&mut self, report: &mut FitReport) {
        self.motion = warm::start(
            &self.rays,
            &mut self.blocks,
            &mut self.slots,
            &self.surface,
            &mut self.warm,
            report,
        );
        self.sync_spheres();
    }

    /// Passes 4 and 5: new spheres where none touches, twice; once more where no sphere is left from
    /// the last frame.
    fn fit(&mut self, warm: bool, time_is_up: &dyn Fn() -> bool, report: &mut FitReport) {
        for round in 0..if warm { 2 } else { 3 } {
            if round > 0 && time_is_up() {
                report.degraded = true;
                return;
            }
            let problem = cold::Problem {
                rays: &self.rays,
                plane: &self.plane,
                lattice: &self.lattice,
                distance: &self.surface,
                max_spheres: self.options.max_spheres,
                // old spheres are offered each other once in a while
                turn: (round == 0).then_some(self.frames),
                warm,
            };
            if !cold::fit(
                &problem,
                &mut self.blocks,
                &mut self.slots,
                &mut self.graph,
                &mut self.cold,
                &mut self.pending,
                time_is_up,
                report,
            ) {
                return;
            }
            self.sync_spheres();
            self.touch(warm || round > 0, time_is_up, report);
        }
    }

    /// Pass 3: pixels to spheres, those of all blocks or, `again`, of the pending ones.
    fn touch(&mut self, again: bool, time_is_up: &dyn Fn() -> bool, report: &mut FitReport) {
        let blocks = &mut self.blocks;
        let view = View {
            plane: &self.plane,
            rays: &self.rays,
            valid: &blocks.valid,
            spheres: &blocks.spheres,
            misfit: &blocks.misfit,
            before: &blocks.before,
            fresh: again.then_some(&self.cold.fresh),
            surfaces: &self.surfaces,
            contact: &self.contact,
        };
        if !again {
            view.hold(&mut blocks.contacts, &mut self.pending);
        }
        report.degraded |= !view.divide(&mut blocks.contacts, &self.pending, time_is_up);
    }

    /// What the last round left untouched is offered to the spheres of the blocks around, all that
    /// these were divided among.
    fn adopt(&mut self, time_is_up: &dyn Fn() -> bool, report: &mut FitReport) {
        let (columns, rows) = (self.rays.block_columns, self.rays.block_rows);
        list_wanting(&self.blocks.contacts, &mut self.wanting);
        for (offered, &k) in self.wanting.iter().enumerate() {
            if (offered as u32 + 1).is_multiple_of(OFFERS) && time_is_up() {
                report.degraded = true;
                return;
            }
            let k = k as usize;
            let contacts = &self.blocks.contacts[k];
            let mut list = Candidates::default();
            let (x, y) = (k % columns, k / columns);
            for ny in y.saturating_sub(1)..(y + 2).min(rows) {
                for nx in x.saturating_sub(1)..(x + 2).min(columns) {
                    for id in self.blocks.contacts[ny * columns + nx].palette {
                        if !contacts.palette.contains(&id) {
                            list.add(id);
                        }
                    }
                }
            }
            let pixels = |id: u16| match self.surfaces.get(usize::from(id)) {
                Some(Some(sphere)) => {
                    touching(&self.contact, &self.plane, &self.rays, (x, y), sphere)
                }
                _ => 0,
            };
            assign::adopt(&mut self.blocks.contacts[k], &list, pixels);
        }
    }

    /// Copies the slots' surfaces to where the contact pass reads them.
    fn sync_spheres(&mut self) {
        self.surfaces.clear();
        let surfaces = self.slots.iter().map(|s| s.map(|p| p.fit.sphere));
        self.surfaces.extend(surfaces);
    }

    /// Frees spheres nothing touches, gives away the contacts, remembers the palettes.
    fn finish(&mut self, out: &mut SaintFrame, report: &mut FitReport) {
        let used = &mut self.warm.used;
        used.clear();
        used.resize(self.slots.len(), 0);
        count_used(&self.blocks.contacts, &mut self.blocks.before, used);
        for (slot, &n) in self.slots.iter_mut().zip(used.iter()) {
            report.explained_pixels += n;
            if n == 0 {
                *slot = None;
            }
        }
        report.spheres = self.slots.iter().flatten().count() as u32;
        out.motion = self.motion;
        out.spheres.clear();
        out.spheres.reserve(self.slots.capacity());
        out.spheres
            .extend(self.slots.iter().map(|s| s.map(|p| p.fit.sphere)));
        // the next frame is divided in the list of an earlier one
        let contacts = std::mem::take(&mut self.blocks.contacts);
        if let Contacts::Blocks(earlier) =
            std::mem::replace(&mut out.contacts, Contacts::Blocks(contacts))
        {
            self.blocks.contacts = earlier;
        }
        let count = self.blocks.len();
        self.blocks.contacts.resize(count, BlockContacts::default());
    }
}

/// Measures the blocks of row `by`, of which `plane` has the pixels.
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2+bmi1+popcnt"))]
fn measure_row(
    plane: &[u16],
    rays: &Rays,
    by: usize,
    valid: &mut [u64],
    sums: &mut [Moments],
    distance: &ContactDistance,
) {
    for (bx, (valid, sums)) in valid.iter_mut().zip(sums).enumerate() {
        *valid = measured(plane, rays, (bx, 0));
        *sums = if valid.count_ones() >= MIN_BLOCK_PIXELS {
            moments::of_block((plane, by), rays, (bx, by), *valid, |z| weight(distance, z))
        } else {
            Moments::default()
        };
    }
}

/// Lists the blocks whose untouched pixels are worth another sphere.
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2+bmi1+popcnt"))]
fn list_wanting(contacts: &[BlockContacts], wanting: &mut Vec<u32>) {
    wanting.clear();
    for (k, contacts) in contacts.iter().enumerate() {
        if contacts.missing != 0 && contacts.wants().is_some() {
            wanting.push(k as u32);
        }
    }
}

/// Adds the pixels of each sphere to `used` and copies the palettes.
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2+bmi1+popcnt"))]
fn count_used(contacts: &[BlockContacts], palettes: &mut [Palette], used: &mut [u32]) {
    for (contacts, palette) in contacts.iter().zip(palettes) {
        *palette = contacts.palette;
        for (&id, pixels) in contacts.palette.iter().zip(&contacts.pixels) {
            if id == NO_SPHERE {
                break;
            }
            used[usize::from(id)] += pixels.count_ones();
        }
    }
}

/// ω of a block at depth `z` metres: one over the squared contact distance in inverse depth.
#[inline(always)]
pub(super) fn weight(distance: &ContactDistance, z: f64) -> f64 {
    let w = distance.at(z) / (z * z);
    1.0 / (w * w)
}
