//! The live fit: one depth frame to spheres and contact map, warm from the frame before.
//!
//! A frame goes through five passes, each over blocks of 8×8 pixels:
//! 1. moments of every block ([`moments`]);
//! 2. warm start (`warm`): blocks that the last frame's spheres still explain keep them, the
//!    spheres are refitted from the blocks' moments, or kept to the bit where that is as good;
//! 3. cold fit (`cold`): what is left is grown from block patches into spheres, inside each
//!    hex-packed cell first, then across cells;
//! 4. contact ([`assign`]): each block's pixels are given to the fewest spheres that touch them;
//! 5. what still touches nothing is fitted again as points of its own (paper 3.1: "use the
//!    remaining points to fit the sphere again"), twice.
//!
//! The deadline is asked between and inside the passes. When time is up the frame is finished with
//! the spheres there are; pixels without one are coded by the codec's fallback and counted.

use super::agglomerate::{Agglomeration, Patch};
use super::contact_distance::ContactDistance;
use super::moments::{self, Moments};
use super::{cold, warm};
use crate::contact_map::assign::{self, BlockContacts, Candidates, EMPTY, Palette};
use crate::contact_map::contact::{Reach, measured};
use crate::contact_map::labels::{INVALID, NO_SPHERE, SaintFrame};
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

/// One block between the passes.
#[derive(Clone, Debug)]
pub(super) struct Block {
    /// Measured pixels.
    pub valid: u64,
    /// Sums over them; empty where there are too few.
    pub moments: Moments,
    /// The sphere that explains the block as a whole, or `NO_SPHERE`.
    pub sphere: u16,
    /// Pixels by sphere.
    pub contacts: BlockContacts,
}

impl Default for Block {
    fn default() -> Self {
        Self {
            valid: 0,
            moments: Moments::default(),
            sphere: NO_SPHERE,
            contacts: BlockContacts::default(),
        }
    }
}

/// Share of the contact distance to which surfaces are fitted. Fitted to all of it, a sphere would
/// take in its neighbours' noise; fitted to less, spheres describe surfaces and the rest of
/// the distance is room for noise. At equal Chamfer distance (Kinect, moving, 2 mm) that saves a
/// quarter of the bits; a still smaller share saves 5 % more but breaks plain walls into patches.
const SURFACE_SHARE: f64 = 0.7;
/// Share of the contact distance within which a pixel is given to a sphere; what is left is room
/// for the quantisation of spheres in the payload.
const TOUCH_SHARE: f64 = 0.85;

/// Fewest pixels from which a block's surface is judged.
pub(super) const MIN_BLOCK_PIXELS: u32 = 12;

/// The live fit with its state from frame to frame and its buffers.
#[derive(Debug)]
pub struct Modeler {
    rays: Rays,
    validity: Validity,
    reach: Reach,
    options: FitOptions,
    surface: ContactDistance,
    lattice: Lattice,
    plane: Vec<u16>,
    blocks: Vec<Block>,
    before: Vec<Palette>,
    slots: Vec<Option<Patch>>,
    frame: SaintFrame,
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
            reach: Reach::new(
                &options.contact_distance.scaled(TOUCH_SHARE),
                camera.depth_unit_m,
            ),
            surface: options.contact_distance.scaled(SURFACE_SHARE),
            options: *options,
            lattice: Lattice::new(options.packing, options.cube_size_m),
            plane: Vec::new(),
            blocks: vec![Block::default(); rays.blocks()],
            before: vec![EMPTY; rays.blocks()],
            slots: Vec::with_capacity(room),
            frame: SaintFrame {
                spheres: Vec::with_capacity(room),
                ..SaintFrame::default()
            },
            graph: Agglomeration::default(),
            warm: warm::Workspace::with_room(room),
            cold: cold::Workspace::with_room(room),
            rays,
        }
    }

    /// Forgets the frame before: the next one is fitted from nothing.
    pub fn reset(&mut self) {
        self.before.fill(EMPTY);
        self.slots.clear();
        self.frame.spheres.clear();
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
        let valid = self.validity.clean(&self.rays, frame, &mut self.plane);
        let mut report = FitReport {
            valid_pixels: valid as u32,
            ..FitReport::default()
        };
        self.measure();
        self.warm_start(&mut report);
        self.cold_start(time_is_up, &mut report);
        self.contact();
        self.remaining(time_is_up, &mut report);
        self.finish(out, &mut report);
        report
    }

    /// Pass 1: measured pixels and moments of each block.
    fn measure(&mut self) {
        let (rays, plane, distance) = (&self.rays, &self.plane, &self.surface);
        self.blocks
            .par_chunks_mut(rays.block_columns)
            .enumerate()
            .for_each(|(by, row)| {
                measure_row(plane, rays, by, row, distance);
            });
    }

    /// Pass 2: the last frame's spheres.
    fn warm_start(&mut self, report: &mut FitReport) {
        self.frame.motion = warm::start(
            &self.rays,
            &mut self.blocks,
            &self.before,
            &mut self.slots,
            &self.surface,
            &mut self.warm,
            report,
        );
        self.sync_spheres();
    }

    /// Pass 3: new spheres where no old one holds.
    fn cold_start(&mut self, time_is_up: &dyn Fn() -> bool, report: &mut FitReport) {
        let problem = cold::Problem {
            rays: &self.rays,
            plane: &self.plane,
            lattice: &self.lattice,
            distance: &self.surface,
            max_spheres: self.options.max_spheres,
        };
        cold::blocks(
            &problem,
            &mut self.blocks,
            &mut self.slots,
            &mut self.graph,
            &mut self.cold,
            time_is_up,
            report,
        );
        self.sync_spheres();
    }

    /// Pass 4: pixels to spheres.
    fn contact(&mut self) {
        self.cold.pending.clear();
        self.cold.pending.resize(self.blocks.len(), true);
        self.contact_pending();
    }

    /// Pass 5: what is left, fitted again.
    fn remaining(&mut self, time_is_up: &dyn Fn() -> bool, report: &mut FitReport) {
        for _ in 0..2 {
            if time_is_up() {
                report.degraded = true;
                return;
            }
            let problem = cold::Problem {
                rays: &self.rays,
                plane: &self.plane,
                lattice: &self.lattice,
                distance: &self.surface,
                max_spheres: self.options.max_spheres,
            };
            if !cold::missing(
                &problem,
                &mut self.blocks,
                &mut self.slots,
                &mut self.graph,
                &mut self.cold,
                time_is_up,
                report,
            ) {
                return;
            }
            self.sync_spheres();
            self.contact_pending();
        }
    }

    /// Assigns the blocks marked in `cold.pending`.
    fn contact_pending(&mut self) {
        let columns = self.rays.block_columns;
        let (rays, plane, reach, before, spheres) = (
            &self.rays,
            &self.plane,
            &self.reach,
            &self.before,
            &self.frame.spheres,
        );
        // spheres of the blocks around, gathered first: the pass itself is independent per block
        let blocks = &self.blocks;
        let pending = &self.cold.pending;
        let rows = self.rays.block_rows;
        self.cold
            .candidates
            .resize(self.blocks.len(), Candidates::default());
        self.cold
            .candidates
            .par_chunks_mut(columns)
            .enumerate()
            .for_each(|(by, row)| {
                for (bx, out) in row.iter_mut().enumerate() {
                    let k = by * columns + bx;
                    if pending[k] && blocks[k].valid != 0 {
                        *out = candidates(blocks, before, columns, rows, (bx, by));
                    }
                }
            });
        let lists = &self.cold.candidates;
        self.blocks
            .par_chunks_mut(columns)
            .enumerate()
            .for_each(|(by, row)| {
                assign_row(
                    plane,
                    rays,
                    by,
                    row,
                    &lists[by * columns..],
                    &pending[by * columns..],
                    spheres,
                    reach,
                );
            });
    }

    /// Copies the slots' surfaces to where the contact pass reads them.
    fn sync_spheres(&mut self) {
        self.frame.spheres.clear();
        self.frame
            .spheres
            .extend(self.slots.iter().map(|s| s.map(|p| p.fit.sphere)));
    }

    /// Frees spheres nothing touches, writes labels, remembers the palettes.
    fn finish(&mut self, out: &mut SaintFrame, report: &mut FitReport) {
        let (width, height, columns) = (self.rays.width, self.rays.height, self.rays.block_columns);
        let used = &mut self.warm.used;
        used.clear();
        used.resize(self.slots.len(), 0);
        for (block, before) in self.blocks.iter().zip(&mut self.before) {
            *before = block.contacts.palette;
            for (&id, pixels) in block.contacts.palette.iter().zip(&block.contacts.pixels) {
                if id != NO_SPHERE {
                    used[usize::from(id)] += pixels.count_ones();
                }
            }
        }
        for (slot, &n) in self.slots.iter_mut().zip(used.iter()) {
            report.explained_pixels += n;
            if n == 0 {
                *slot = None;
            }
        }
        report.spheres = self.slots.iter().flatten().count() as u32;
        out.motion = self.frame.motion;
        out.spheres.clear();
        out.spheres.reserve(self.slots.capacity());
        out.spheres
            .extend(self.slots.iter().map(|s| s.map(|p| p.fit.sphere)));
        out.labels.resize(width * height, INVALID);
        for (k, block) in self.blocks.iter().enumerate() {
            let (x0, y0) = (k % columns * BLOCK, k / columns * BLOCK);
            let across = BLOCK.min(width - x0);
            for j in 0..BLOCK.min(height - y0) {
                let start = (y0 + j) * width + x0;
                write_row(&mut out.labels[start..start + across], block, 8 * j);
            }
        }
    }
}

/// Labels of one row of a block; `shift` is the bit of its first pixel.
#[inline]
fn write_row(row: &mut [u16], block: &Block, shift: usize) {
    let c = &block.contacts;
    for (i, label) in row.iter_mut().enumerate() {
        let bit = 1u64 << (shift + i);
        *label = if block.valid & bit == 0 {
            INVALID
        } else if c.pixels[0] & bit != 0 {
            c.palette[0]
        } else {
            (1..assign::PALETTE)
                .find(|&p| c.pixels[p] & bit != 0)
                .map_or(NO_SPHERE, |p| c.palette[p])
        };
    }
}

/// Spheres worth trying for a block: its own, then those of the blocks around, now and before.
fn candidates(
    blocks: &[Block],
    before: &[Palette],
    columns: usize,
    rows: usize,
    at: (usize, usize),
) -> Candidates {
    let mut list = Candidates::default();
    let k = at.1 * columns + at.0;
    list.add(blocks[k].sphere);
    for &id in &before[k] {
        list.add(id);
    }
    for &id in &blocks[k].contacts.palette {
        list.add(id);
    }
    for (dx, dy) in [
        (0, -1),
        (-1, 0),
        (1, 0),
        (0, 1),
        (-1, -1),
        (1, -1),
        (-1, 1),
        (1, 1),
    ] {
        let (x, y) = (at.0 as isize + dx, at.1 as isize + dy);
        if x >= 0 && y >= 0 && (x as usize) < columns && (y as usize) < rows {
            let n = y as usize * columns + x as usize;
            list.add(blocks[n].sphere);
            list.add(before[n][0]);
        }
    }
    list
}

#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn measure_row(
    plane: &[u16],
    rays: &Rays,
    by: usize,
    row: &mut [Block],
    distance: &ContactDistance,
) {
    for (bx, block) in row.iter_mut().enumerate() {
        block.valid = measured(plane, rays, (bx, by));
        block.sphere = NO_SPHERE;
        block.contacts = BlockContacts::default();
        block.moments = if block.valid.count_ones() >= MIN_BLOCK_PIXELS {
            moments::of_block(plane, rays, (bx, by), block.valid, |z| weight(distance, z))
        } else {
            Moments::default()
        };
    }
}

#[allow(unsafe_code, clippy::too_many_arguments)]
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn assign_row(
    plane: &[u16],
    rays: &Rays,
    by: usize,
    row: &mut [Block],
    lists: &[Candidates],
    pending: &[bool],
    spheres: &[Option<super::sphere::Sphere>],
    reach: &Reach,
) {
    for (bx, block) in row.iter_mut().enumerate() {
        if pending[bx] {
            block.contacts = assign::assign(
                plane,
                rays,
                (bx, by),
                block.valid,
                &lists[bx],
                spheres,
                reach,
            );
        }
    }
}

/// ω of a block at depth `z` metres: one over the squared contact distance in inverse depth.
#[inline(always)]
pub(super) fn weight(distance: &ContactDistance, z: f64) -> f64 {
    let w = distance.at(z) / (z * z);
    1.0 / (w * w)
}
