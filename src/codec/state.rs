//! What encoder and decoder both carry from frame to frame, and the prediction both compute.

use super::bins::Bins;
use super::grid::Plane;
use super::label_map::{self, LabelMap, NewNumbers};
use super::mask::{self, Fill, Mask};
use super::residual::{self, Kind, Trace};
use super::sphere_table::{self, Entry, Support};
use crate::contact_map::contact::Reach;
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::{BLOCK, Rays};
use crate::fit::motion::Motion;
use crate::fit::sphere::Sphere;

/// Most spheres a frame may hold.
pub(super) const MAX_SPHERES: usize = NO_SPHERE as usize;

/// The first predicted depth, in depth integers, that no sensor integer is near. Such a pixel is
/// rebuilt from the largest integer, not from its sphere.
pub(super) const BEYOND: f32 = 65536.0;

/// Learnt models of all sections; reset at key frames.
#[derive(Clone, Debug, Default)]
pub(super) struct Models {
    pub mask: mask::Models,
    pub labels: label_map::Models,
    pub spheres: sphere_table::Models,
    pub residual: residual::Models,
}

/// One frame as both sides know it.
#[derive(Clone, Debug, Default)]
pub(super) struct Picture {
    pub mask: Mask,
    pub map: LabelMap,
    pub entries: Vec<Option<Entry>>,
    pub kinds: Vec<Kind>,
}

/// A frame in the making, the one before, and the buffers between.
#[derive(Clone, Debug, Default)]
pub(super) struct State {
    pub models: Models,
    pub now: Picture,
    pub before: Picture,
    pub new: NewNumbers,
    pub supports: Vec<Support>,
    pub bins: Bins,
    /// Depth each measured pixel's sphere predicts, in depth integers; its negative where the pixel
    /// came back from a bin, 0 where that had no sphere.
    pub predicted: Plane<f32>,
    /// Rebuilt depth integers; 0 where nothing was measured.
    pub rebuilt: Plane<u16>,
    pub traces: Plane<Trace>,
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
    pub fn begin(&mut self, rays: &Rays, key: bool) {
        std::mem::swap(&mut self.now, &mut self.before);
        if key {
            self.models.mask.reset();
            self.models.labels = label_map::Models::default();
            self.models.spheres = sphere_table::Models::default();
            self.models.residual.reset();
            self.before.entries.clear();
        }
        self.now.mask.reset(rays);
        self.now.map.reset(rays);
        self.now.kinds.clear();
        self.now.kinds.resize(rays.blocks(), Kind::Smooth);
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

    /// Fills `predicted` and `rebuilt` from masks, labels and spheres, and clears `traces`.
    pub fn predict(&mut self, rays: &Rays) {
        self.cover(rays);
        let State {
            now,
            predicted,
            rebuilt,
            ..
        } = self;
        predict_all(rays, now, predicted, rebuilt);
        hide_unmeasured(rays, now, rebuilt);
    }

    /// The same, and marks in `hits` the pixels of `plane` that touch their sphere (bit `8·row +
    /// column` of each block).
    pub fn predict_and_test(
        &mut self,
        rays: &Rays,
        plane: &[u16],
        reach: &Reach,
        hits: &mut Vec<u64>,
    ) {
        self.cover(rays);
        hits.clear();
        hits.resize(rays.blocks(), 0);
        let State {
            now,
            predicted,
            rebuilt,
            ..
        } = self;
        predict_all(rays, now, predicted, rebuilt);
        hide_unmeasured(rays, now, rebuilt);
        test_all(rays, now, predicted, plane, reach, hits);
    }

    fn cover(&mut self, rays: &Rays) {
        self.predicted.cover(rays, 0.0);
        self.rebuilt.cover(rays, 0);
        self.traces.cover(rays, Trace::default());
        // only blocks that were not smooth in the last frame hold any trace
        for (block, &kind) in self.before.kinds.iter().enumerate() {
            if kind != Kind::Smooth {
                self.traces.fill_block(
                    block % rays.block_columns * BLOCK,
                    block / rays.block_columns * BLOCK,
                    Trace::default(),
                );
            }
        }
    }
}

/// Clears the rebuilt integers of pixels without a measurement: neighbours tell them by their 0.
fn hide_unmeasured(rays: &Rays, now: &Picture, rebuilt: &mut Plane<u16>) {
    for k in 0..rays.blocks() {
        let (x0, y0, w, h) = mask::extent(rays, k);
        match now.mask.fills[k] {
            Fill::Empty => rebuilt.fill_block(x0, y0, 0),
            Fill::Full if (w, h) == (BLOCK, BLOCK) => {}
            _ => {
                for j in 0..BLOCK {
                    let start = rebuilt.index(x0, y0 + j);
                    let on = &now.mask.pixels.cells()[start..start + BLOCK];
                    let row = &mut rebuilt.cells_mut()[start..start + BLOCK];
                    for (r, &m) in row.iter_mut().zip(on) {
                        *r *= u16::from(m);
                    }
                }
            }
        }
    }
}

#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn predict_all(rays: &Rays, now: &Picture, predicted: &mut Plane<f32>, rebuilt: &mut Plane<u16>) {
    for k in 0..rays.blocks() {
        let size = usize::from(now.map.sizes[k]);
        for &id in &now.map.palettes[k][..size] {
            if let Some(Some(entry)) = now.entries.get(usize::from(id)) {
                predict_block(
                    rays,
                    k,
                    &entry.sphere,
                    (size > 1).then_some(id),
                    &now.map.pixels,
                    predicted,
                    rebuilt,
                );
            }
        }
    }
}

/// Predicts one block from one sphere: all of it, or the pixels labelled `only`.
#[inline(always)]
fn predict_block(
    rays: &Rays,
    k: usize,
    sphere: &Sphere,
    only: Option<u16>,
    labels: &Plane<u16>,
    predicted: &mut Plane<f32>,
    rebuilt: &mut Plane<u16>,
) {
    let (x0, y0) = (
        k % rays.block_columns * BLOCK,
        k / rays.block_columns * BLOCK,
    );
    let Some(u) = rays.u[x0..].first_chunk::<BLOCK>() else {
        return;
    };
    let (a4, side) = (4.0 * sphere.a, if sphere.far { -1.0 } else { 1.0 });
    for j in 0..BLOCK {
        let v = rays.v[y0 + j];
        let start = predicted.index(x0, y0 + j);
        let mut d = [0f32; BLOCK];
        for i in 0..BLOCK {
            let q = u[i] * u[i] + v * v + 1.0;
            let l = sphere.m.x * u[i] + sphere.m.y * v + sphere.m.z;
            d[i] = rays.per_metre / (0.5 * (l + side * (l * l + a4 * q).sqrt()));
        }
        let Some(row) = predicted.cells_mut()[start..].first_chunk_mut::<BLOCK>() else {
            return;
        };
        let Some(whole) = rebuilt.cells_mut()[start..].first_chunk_mut::<BLOCK>() else {
            return;
        };
        match only {
            None => {
                *row = d;
                for i in 0..BLOCK {
                    whole[i] = to_integer(d[i]);
                }
            }
            Some(id) => {
                let Some(labels) = labels.cells()[start..].first_chunk::<BLOCK>() else {
                    return;
                };
                for i in 0..BLOCK {
                    let this = labels[i] == id;
                    row[i] = if this { d[i] } else { row[i] };
                    whole[i] = if this { to_integer(d[i]) } else { whole[i] };
                }
            }
        }
    }
}

#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn test_all(
    rays: &Rays,
    now: &Picture,
    predicted: &Plane<f32>,
    plane: &[u16],
    reach: &Reach,
    hits: &mut [u64],
) {
    let stride = rays.stride();
    for (k, hits) in hits.iter_mut().enumerate() {
        let size = usize::from(now.map.sizes[k]);
        if size == 0 {
            continue;
        }
        let (x0, y0) = (
            k % rays.block_columns * BLOCK,
            k / rays.block_columns * BLOCK,
        );
        let Some(u) = rays.u[x0..].first_chunk::<BLOCK>() else {
            return;
        };
        let all_spheres = !now.map.palettes[k][..size].contains(&NO_SPHERE);
        for j in 0..BLOCK {
            let v = rays.v[y0 + j];
            let start = predicted.index(x0, y0 + j);
            let Some(p) = predicted.cells()[start..].first_chunk::<BLOCK>() else {
                return;
            };
            let Some(raw) = plane[(y0 + j) * stride + x0..].first_chunk::<BLOCK>() else {
                return;
            };
            let Some(labels) = now.map.pixels.cells()[start..].first_chunk::<BLOCK>() else {
                return;
            };
            let mut on = [0u8; BLOCK];
            for i in 0..BLOCK {
                let q = u[i] * u[i] + v * v + 1.0;
                // the decoder rebuilds other depths from integers
                let real = (p[i] > 0.0) & (p[i] < BEYOND);
                let sphere = (all_spheres | (labels[i] != NO_SPHERE)) & real;
                on[i] =
                    u8::from(reach.touches(f32::from(raw[i]), p[i], q) & (raw[i] != 0) & sphere);
            }
            let packed = u64::from_le_bytes(on).wrapping_mul(0x0102_0408_1020_4080) >> 56;
            *hits |= packed << (8 * j);
        }
    }
}

/// A predicted depth as the integer a residual adds to: nearest, 0 where there is no surface.
#[inline(always)]
pub(super) fn to_integer(depth: f32) -> u16 {
    // the cast takes NaN and negatives to 0 and large values to the largest integer
    (depth + 0.5) as u16
}
