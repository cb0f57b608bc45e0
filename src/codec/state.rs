//! What encoder and decoder both carry from frame to frame, and the prediction both compute.

use super::bins::{Bins, NoSuchInteger};
use super::bitmap::Bitmap;
use super::cells::{Cell, Cells};
use super::flow::{self, Past, Shift};
use super::label_map::LabelMap;
use super::labels::{self, Choice};
use super::mask::{self, Fill, Mask};
use super::palettes::{self, NewNumbers, NoSuchSphere};
use super::range_coder::Coder;
use super::residual::{self, Kind};
use super::sphere_table::{self, Entry, Support};
use super::surface::{self, Depths, Surfaces};
use super::tiles::Tiles;
use crate::contact_map::contact::Reach;
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::{BLOCK, Rays};
use crate::fit::motion::Motion;

/// Most spheres a frame may hold.
pub(super) const MAX_SPHERES: usize = NO_SPHERE as usize;

/// Learnt models of all sections; reset at key frames.
#[derive(Clone, Debug, Default)]
pub(super) struct Models {
    pub fills: mask::FillModels,
    pub palettes: palettes::Models,
    pub mask: mask::Models,
    pub labels: labels::Models,
    pub spheres: sphere_table::Models,
    pub residual: residual::Models,
}

/// One frame as both sides know it.
#[derive(Clone, Debug, Default)]
pub(super) struct Picture {
    pub mask: Mask,
    pub map: LabelMap,
    /// Depths that spheres predict, of the blocks of several.
    pub tiles: Tiles<f32>,
    pub entries: Vec<Option<Entry>>,
    pub kinds: Vec<Kind>,
}

/// A frame in the making, the one before, and the buffers between.
#[derive(Clone, Debug, Default)]
pub(super) struct State {
    pub models: Models,
    /// The frame is coded for speed (`FORMAT.md` §1.6, "Fast").
    pub fast: bool,
    pub now: Picture,
    pub before: Picture,
    pub new: NewNumbers,
    pub supports: Vec<Support>,
    pub bins: Bins,
    /// Where the blocks were in the last frame.
    pub shifts: Vec<Shift>,
    /// What pixels tell each other where some come back from bins.
    pub cells: Cells,
    /// Measured pixels of each block that touch the sphere they got (encoding only).
    pub hits: Vec<u64>,
    /// What the mask took of the sections of blocks and of pixels, in 1/16 bit (encoding only).
    pub mask_bits: [u64; 2],
}

impl State {
    /// A state whose tables hold so many spheres before they grow.
    pub fn with_room(spheres: usize) -> Self {
        let picture = || Picture {
            entries: Vec::with_capacity(spheres),
            ..Picture::default()
        };
        Self {
            now: picture(),
            before: picture(),
            new: NewNumbers::with_room(spheres),
            supports: Vec::with_capacity(spheres),
            ..Self::default()
        }
    }

    /// Starts a frame: the last one becomes the reference, or is forgotten for a key frame.
    pub fn begin(&mut self, rays: &Rays, key: bool, fast: bool) {
        self.fast = fast;
        std::mem::swap(&mut self.now, &mut self.before);
        if key {
            self.models.mask.reset();
            self.models.fills = mask::FillModels::default();
            self.models.palettes = palettes::Models::default();
            self.models.labels.reset();
            self.models.spheres = sphere_table::Models::default();
            self.models.residual.reset();
            self.before.entries.clear();
        }
        self.now.mask.reset(rays);
        self.now.map.reset(rays);
        self.now.tiles.reset(rays);
        self.now.kinds.clear();
        self.now.kinds.resize(rays.blocks(), Kind::Smooth);
        self.hits.resize(rays.blocks(), 0);
        self.bins.cover(rays);
        self.now.entries.clear();
        self.new
            .reset(self.before.entries.iter().map(Option::is_some));
    }

    /// Carries the reference frame's spheres along with the camera.
    pub fn follow(&mut self, motion: &Motion) {
        if !motion.is_still() {
            let mover = motion.mover();
            for entry in &mut self.before.entries {
                *entry = entry.and_then(|e| {
                    mover.sphere(&e.sphere).map(|sphere| Entry {
                        sphere,
                        step: e.step,
                    })
                });
            }
        }
    }

    /// Section *blocks*: fills and palettes. `wanted`: measured pixels of each block (not used to
    /// decode).
    ///
    /// # Errors
    /// [`NoSuchSphere`] where the bytes name one (decoding only).
    pub fn code_blocks<C: Coder>(
        &mut self,
        coder: &mut C,
        rays: &Rays,
        key: bool,
        wanted: &[u64],
    ) -> Result<(), NoSuchSphere> {
        let State {
            models,
            now,
            before,
            new,
            mask_bits,
            ..
        } = self;
        let past = (!key).then_some(&*before);
        let masks = past.map(|b| &b.mask);
        let start = coder.written();
        mask::code_fills(coder, &mut models.fills, rays, &mut now.mask, masks, wanted);
        *mask_bits = [coder.written() - start, 0];
        palettes::code(
            coder,
            &mut models.palettes,
            rays,
            &now.mask,
            &mut now.map,
            past.map(|b| &b.map),
            new,
            MAX_SPHERES,
            self.fast,
        )
    }

    /// Where the blocks were in the last frame: what the section *pixels* needs first.
    pub fn look_back(&mut self, rays: &Rays, motion: &Motion) {
        let State { now, shifts, .. } = self;
        // others have neither pixels nor labels to code
        let asked = |k: usize| now.mask.fills[k] == Fill::Mixed || now.map.sizes[k] > 1;
        flow::shifts(rays, &now.map, asked, &now.entries, motion, shifts);
    }

    /// Section *pixels*, the mask. `wanted`: measured pixels of each block, of which some may go
    /// another way (not used to decode).
    pub fn code_mask<C: Coder>(
        &mut self,
        coder: &mut C,
        rays: &Rays,
        key: bool,
        wanted: &[u64],
        how: mask::Precision,
    ) {
        let past = (!key).then_some(Past {
            picture: &self.before.mask.pixels,
            shifts: &self.shifts,
        });
        let (models, mask) = (&mut self.models.mask, &mut self.now.mask);
        self.mask_bits[1] = code_mask(coder, models, rays, mask, past, wanted, how, self.fast);
    }

    /// Section *pixels*, the labels: after the mask, or, fast, without it.
    pub fn code_labels<C: Coder, W: Choice>(
        &mut self,
        coder: &mut C,
        rays: &Rays,
        reach: &Reach,
        key: bool,
        choice: &mut W,
    ) {
        let State {
            models,
            fast,
            now,
            before,
            shifts,
            hits,
            ..
        } = self;
        let scene = labels::Scene {
            rays,
            reach,
            mask: (!*fast).then_some(&now.mask),
            before: (!key).then_some(Past {
                picture: &before.map,
                shifts,
            }),
            surfaces: Surfaces(&now.entries),
        };
        let outcome = labels::Outcome {
            depths: &mut now.tiles,
            touching: hits,
        };
        labels::code(
            coder,
            &mut models.labels,
            &scene,
            &mut now.map,
            choice,
            outcome,
        );
    }

    /// Both of a fast frame, side by side: neither needs the other.
    pub fn code_pixels_fast<C: Coder + Send, W: Choice + Send>(
        &mut self,
        (of_mask, of_labels): (&mut C, &mut C),
        rays: &Rays,
        reach: &Reach,
        key: bool,
        (wanted, how): (&[u64], mask::Precision),
        choice: &mut W,
    ) {
        let State {
            models,
            now,
            before,
            shifts,
            hits,
            mask_bits,
            ..
        } = self;
        let past = (!key).then_some(Past {
            picture: &before.mask.pixels,
            shifts,
        });
        let scene = labels::Scene {
            rays,
            reach,
            mask: None,
            before: (!key).then_some(Past {
                picture: &before.map,
                shifts,
            }),
            surfaces: Surfaces(&now.entries),
        };
        let outcome = labels::Outcome {
            depths: &mut now.tiles,
            touching: hits,
        };
        let (mask, map) = (&mut now.mask, &mut now.map);
        rayon::join(
            || {
                let models = &mut models.mask;
                mask_bits[1] = code_mask(of_mask, models, rays, mask, past, wanted, how, true);
            },
            || labels::code(of_labels, &mut models.labels, &scene, map, choice, outcome),
        );
    }

    /// Section *residual*: integers, kinds of blocks and the pixels that come back from bins. `wanted`
    /// tells the integer of a pixel, `hits` whether its sphere gives it back, `plane` holds all integers
    /// (none used to decode).
    ///
    /// # Errors
    /// [`NoSuchInteger`] where the bytes list one (decoding only).
    pub fn code_residual<C: Coder, W: Fn(usize, usize) -> u16>(
        &mut self,
        coder: &mut C,
        rays: &Rays,
        reach: &Reach,
        (key, lossless): (bool, bool),
        plane: Option<&[u16]>,
        wanted: W,
    ) -> Result<(), NoSuchInteger> {
        let State {
            models,
            fast,
            now,
            before,
            cells,
            bins,
            hits,
            ..
        } = self;
        let models = &mut models.residual;
        let listed = plane.map(|plane| (plane, reach, lossless));
        residual::code_bins(coder, models, bins, key, listed)?;
        let past = (!key).then_some(&before.kinds[..]);
        residual::code_kinds(coder, models, rays, now, past);
        if now.kinds.iter().all(|kind| *kind == Kind::Smooth) {
            return Ok(());
        }
        bins.prepare(rays, reach, lossless, true);
        write_near(rays, now, cells, *fast);
        let scene = residual::Scene {
            rays,
            bins,
            now,
            hits,
        };
        if *fast {
            residual::code_pixels_fast(coder, models, &scene, cells, wanted);
        } else {
            residual::code_pixels(coder, models, &scene, cells, wanted);
        }
        Ok(())
    }

    /// Section *residual* of a plain frame, but for its depths: kinds of blocks.
    pub fn code_plain_kinds<C: Coder>(&mut self, coder: &mut C, rays: &Rays, key: bool) {
        if key {
            self.bins.begin(false);
        }
        let past = (!key).then_some(&self.before.kinds[..]);
        residual::code_kinds(coder, &mut self.models.residual, rays, &mut self.now, past);
    }

    /// Number of pixels whose depth a plain frame states.
    pub fn plain_pixels(&self, rays: &Rays) -> usize {
        let rough = (0..rays.blocks()).filter(|&k| self.now.kinds[k] != Kind::Smooth);
        rough
            .map(|k| self.now.mask.block(rays, k).count_ones() as usize)
            .sum()
    }

    /// States the depths of a plain frame, in raster order: `integers` tells or takes those of eight
    /// pixels from (x, y) on, of which `on` are measured, bit by bit.
    pub fn state_plainly(
        &mut self,
        rays: &Rays,
        mut integers: impl FnMut(usize, usize, u8) -> [u16; BLOCK],
    ) {
        let State { now, cells, .. } = self;
        cells.reset(rays);
        for y in 0..rays.height {
            let (first, j) = (y / BLOCK * rays.block_columns, y % BLOCK);
            for bx in 0..rays.block_columns {
                if now.kinds[first + bx] == Kind::Smooth {
                    continue;
                }
                if j == 0 {
                    cells.put(first + bx, [Cell::default(); BLOCK * BLOCK]);
                }
                let on = now.mask.pixels.row(bx, y);
                let rows = cells.get_mut(first + bx).map(|tile| tile.as_chunks_mut().0);
                if let (1.., Some(rows)) = (on, rows) {
                    let given = integers(bx * BLOCK, y, on);
                    let mut row = [Cell::default(); BLOCK];
                    for i in 0..BLOCK {
                        if on >> i & 1 != 0 {
                            row[i] = Cell::of_bin(given[i], 0, 0);
                        }
                    }
                    rows[j] = row;
                }
            }
        }
    }
}

/// Quads and pixels of the mask; returns the bits they took, in 1/16 bit.
#[allow(clippy::too_many_arguments)] // one section's whole state
fn code_mask<C: Coder>(
    coder: &mut C,
    models: &mut mask::Models,
    rays: &Rays,
    mask: &mut Mask,
    past: Option<Past<'_, Bitmap>>,
    wanted: &[u64],
    how: mask::Precision,
    fast: bool,
) -> u64 {
    let start = coder.written();
    mask::code_quads(coder, models, rays, mask, past, wanted);
    if fast {
        mask::code_pixels::<true, C>(coder, models, rays, mask, past, wanted, how);
    } else {
        mask::code_pixels::<false, C>(coder, models, rays, mask, past, wanted, how);
    }
    coder.written() - start
}

impl Picture {
    /// Depths that the spheres of block `k` predict for its pixels.
    #[inline(always)]
    pub fn depths(&self, rays: &Rays, k: usize, out: &mut Depths) {
        match self.tiles.get(k) {
            Some(tile) => *out = *tile,
            None => Surfaces(&self.entries).depths(rays, k, self.map.palettes[k][0], out),
        }
    }

    /// Row `j` of them.
    #[inline(always)]
    pub fn depth_row(&self, rays: &Rays, k: usize, j: usize) -> [f32; BLOCK] {
        match self.tiles.get(k) {
            Some(tile) => *tile[j * BLOCK..].first_chunk().unwrap_or(&[0.0; BLOCK]),
            None => Surfaces(&self.entries).depth_row(rays, k, j, self.map.palettes[k][0]),
        }
    }
}

/// Cells of the blocks that are not smooth and of those that these look at: above and to the left, and,
/// but for a fast frame, to the right.
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn write_near(rays: &Rays, now: &Picture, cells: &mut Cells, fast: bool) {
    cells.reset(rays);
    let columns = rays.block_columns;
    let rough = |there: bool, k: usize| there && now.kinds[k] != Kind::Smooth;
    let mut depths = surface::NOTHING;
    for k in 0..rays.blocks() {
        let x = k % columns;
        let (west, east, below) = (x > 0, x + 1 < columns, k + columns < rays.blocks());
        let seen = rough(true, k)
            || rough(east, k + 1)
            || rough(west && !fast, k.wrapping_sub(1))
            || rough(below, k + columns)
            || rough(below && east, k + columns + 1)
            || rough(below && west, (k + columns).wrapping_sub(1));
        if seen && now.mask.fills[k] != Fill::Empty {
            now.depths(rays, k, &mut depths);
            cells.write(k, now.mask.block(rays, k), &depths);
        }
    }
}
