//! Section *spheres*: the surfaces, quantised just finely enough.
//!
//! A sphere is stated about the middle of the blocks it touches (known from the section of blocks):
//! inverse depth there, its change across half the extent in x and y, and the curvature's bulge,
//! all in steps of one power of two chosen per sphere. A sphere that the reference frame has too
//! is kept (one bit), or stated as the difference to what it was.
//!
//! All arithmetic is double precision with +, −, ×, ÷ only, so encoder and decoder agree to the
//! bit on every platform; the surface itself is rounded to single precision at the end.

use super::label_map::LabelMap;
use super::range_coder::{Bit, Coder, Integer};
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::{BLOCK, Rays};
use crate::fit::sphere::Sphere;
use glam::Vec3;

/// Smallest and largest step, powers of two.
const STEP_MIN: i32 = -30;
const STEP_MAX: i32 = 10;
/// Largest coded number of steps.
const MOST: i32 = 1 << 21;

/// Learnt models of the section.
#[derive(Clone, Debug, Default)]
pub struct Models {
    keep: Bit,
    far: Bit,
    plane: Bit,
    step: Integer,
    step_change: Integer,
    fresh: [Integer; 4],
    change: [Integer; 4],
    runs_on: Bit,
    guided: [Integer; 4],
}

/// Where a sphere touches: middle (pixels) and half extent (pixels) of its blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Support {
    low: (u16, u16),
    high: (u16, u16),
    /// The first other sphere that is met beside it, or `NO_SPHERE`.
    beside: u16,
}

impl Support {
    const NOWHERE: Self = Self {
        low: (u16::MAX, u16::MAX),
        high: (0, 0),
        beside: NO_SPHERE,
    };

    /// Supports of all spheres with numbers below `count`.
    pub fn gather(rays: &Rays, map: &LabelMap, count: usize, out: &mut Vec<Self>) {
        out.clear();
        out.resize(count, Self::NOWHERE);
        for (k, (palette, &size)) in map.palettes.iter().zip(&map.sizes).enumerate() {
            let (x, y) = (
                (k % rays.block_columns) as u16,
                (k / rays.block_columns) as u16,
            );
            let palette = &palette[..usize::from(size)];
            for &id in palette {
                if id != NO_SPHERE && usize::from(id) < count {
                    let west = (x > 0).then(|| map.palettes[k - 1][0]);
                    let north = (y > 0).then(|| map.palettes[k - rays.block_columns][0]);
                    let s = &mut out[usize::from(id)];
                    if s.beside == NO_SPHERE {
                        let mut around =
                            west.into_iter().chain(north).chain(palette.iter().copied());
                        s.beside = around
                            .find(|&b| b != id && b != NO_SPHERE)
                            .unwrap_or(NO_SPHERE);
                    }
                    s.low = (s.low.0.min(x), s.low.1.min(y));
                    s.high = (s.high.0.max(x), s.high.1.max(y));
                }
            }
        }
    }

    /// The entry beside this one: as stated already in this frame, else as the reference frame has it.
    pub fn beside(
        &self,
        now: &[Option<Entry>],
        before: &[Option<Entry>],
        number: usize,
    ) -> Option<Entry> {
        let k = usize::from(self.beside);
        let stated = now[..number].get(k).copied().flatten();
        stated.or_else(|| before.get(k).copied().flatten())
    }

    /// True where the sphere touches nothing.
    #[must_use]
    pub fn is_nowhere(&self) -> bool {
        *self == Self::NOWHERE
    }

    /// Inverse depth (1/m) of `sphere` in the middle of the support.
    #[must_use]
    pub fn depth(&self, rays: &Rays, sphere: &Sphere) -> f64 {
        Chart::new(rays, self).inverse_depth(sphere)
    }

    fn middle(&self) -> (f64, f64) {
        let block = BLOCK as f64;
        (
            0.5 * block * (f64::from(self.low.0) + f64::from(self.high.0) + 1.0) - 0.5,
            0.5 * block * (f64::from(self.low.1) + f64::from(self.high.1) + 1.0) - 0.5,
        )
    }

    fn half(&self) -> (f64, f64) {
        let block = BLOCK as f64;
        (
            0.5 * block * (f64::from(self.high.0 - self.low.0) + 1.0),
            0.5 * block * (f64::from(self.high.1 - self.low.1) + 1.0),
        )
    }
}

/// The frame of reference in which one sphere is stated.
#[derive(Clone, Copy, Debug)]
struct Chart {
    /// Ray of the middle.
    u: f64,
    v: f64,
    q: f64,
    /// Half extents in ray units.
    hu: f64,
    hv: f64,
    /// (hu² + hv²)/2, what the bulge is measured over.
    bulge: f64,
}

impl Chart {
    fn new(rays: &Rays, support: &Support) -> Self {
        let (x, y) = support.middle();
        let (hx, hy) = support.half();
        // ray steps of a pixel, from the single-precision table that all sides share
        let du = f64::from(rays.u[1]) - f64::from(rays.u[0]);
        let dv = f64::from(rays.v[1]) - f64::from(rays.v[0]);
        let (u, v) = (f64::from(rays.u[0]) + x * du, f64::from(rays.v[0]) + y * dv);
        let (hu, hv) = (hx * du, hy * dv);
        Self {
            u,
            v,
            q: u * u + v * v + 1.0,
            hu,
            hv,
            bulge: 0.5 * (hu * hu + hv * hv),
        }
    }

    /// Inverse depth at the middle, or a stand-in where the sphere does not reach it.
    fn inverse_depth(&self, sphere: &Sphere) -> f64 {
        let (a, m) = (f64::from(sphere.a), sphere.m.as_dvec3());
        let l = m.x * self.u + m.y * self.v + m.z;
        let root = (l * l + 4.0 * a * self.q).max(0.0).sqrt();
        0.5 * if sphere.far { l - root } else { l + root }
    }

    /// The sphere in steps of `step`: inverse depth, its changes in x and y, bulge.
    fn quantise(&self, sphere: &Sphere, step: f64) -> [i32; 4] {
        let (a, m) = (f64::from(sphere.a), sphere.m.as_dvec3());
        let w = self.inverse_depth(sphere);
        let round = |x: f64| {
            // the largest integer not above it; `floor` is a call without SSE 4.1
            let x = (x / step + 0.5).clamp(-f64::from(MOST), f64::from(MOST));
            let whole = x as i32;
            whole - i32::from(x < f64::from(whole))
        };
        // implicit derivative of w = a·q/w + m·r
        let slope = 1.0 + a * self.q / (w * w);
        let slope = if slope.abs() < 1e-3 { 1e-3 } else { slope };
        let (wu, wv) = (
            (2.0 * a * self.u / w + m.x) / slope,
            (2.0 * a * self.v / w + m.y) / slope,
        );
        let (n0, n1, n2) = (round(w), round(wu * self.hu), round(wv * self.hv));
        let (w, bulge) = self.scale([n0, n1, n2], step);
        [n0, n1, n2, round(a / slope * bulge / w)]
    }

    /// Inverse depth (1/m), and what the curvature is multiplied with: half the squared half extent of
    /// the surface, its run in depth included, over the squared depth.
    fn scale(&self, n: [i32; 3], step: f64) -> (f64, f64) {
        let w = (f64::from(n[0]) * step).max(step * 0.5);
        let (du, dv) = (f64::from(n[1]) * step / w, f64::from(n[2]) * step / w);
        (w, self.bulge + 0.5 * (du * du + dv * dv))
    }

    /// The sphere that the four numbers state.
    fn restore(&self, n: [i32; 4], step: f64, far: bool) -> Sphere {
        let (w, bulge) = self.scale([n[0], n[1], n[2]], step);
        // curvature about the middle, then about the camera (`fit::moments`)
        let bend = f64::from(n[3]) * step * w / bulge;
        let turn = 1.0 - bend * self.q / (w * w);
        let a = bend / if turn.abs() < 1e-3 { 1e-3 } else { turn };
        let (wu, wv) = (
            f64::from(n[1]) * step / self.hu,
            f64::from(n[2]) * step / self.hv,
        );
        let slope = 1.0 + a * self.q / (w * w);
        let mx = wu * slope - 2.0 * a * self.u / w;
        let my = wv * slope - 2.0 * a * self.v / w;
        let mz = w - a * self.q / w - mx * self.u - my * self.v;
        Sphere {
            a: a as f32,
            m: Vec3::new(mx as f32, my as f32, mz as f32),
            far,
        }
    }
}

/// One sphere as the payload states it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// The surface after quantisation: what encoder and decoder compute with.
    pub sphere: Sphere,
    /// log₂ of the quantisation step, 1/m.
    pub step: i8,
}

/// How one sphere of the encoder is to be stated.
#[derive(Clone, Copy, Debug)]
pub enum Statement {
    /// As the reference frame has it.
    Keep,
    /// This surface, quantised with steps of this size (1/m) or a little less.
    Sphere(Sphere, f64),
}

/// Codes entry after entry: `statement` (encoding) or nothing (decoding) to the entry, given the
/// reference frame's entry under the same number.
#[allow(clippy::too_many_arguments)]
pub fn code_entry<C: Coder>(
    coder: &mut C,
    models: &mut Models,
    rays: &Rays,
    support: &Support,
    statement: Option<Statement>,
    before: Option<Entry>,
    beside: Option<Entry>,
    last: &mut Option<Entry>,
) -> Entry {
    if let Some(before) = before
        && coder.bit(&mut models.keep, matches!(statement, Some(Statement::Keep)))
    {
        return before;
    }
    let chart = Chart::new(rays, support);
    let (sphere, size) = match statement {
        Some(Statement::Sphere(sphere, size)) => (sphere, size),
        _ => (
            Sphere {
                a: 0.0,
                m: Vec3::Z,
                far: false,
            },
            1.0,
        ),
    };
    // the exponent of a positive number is its logarithm, rounded down
    let exponent = (size.to_bits() >> 52) as i32 - 1023;
    let wanted = exponent.clamp(STEP_MIN, STEP_MAX);
    let guide = before.or(beside).or(*last);
    let log = match guide {
        Some(g) => {
            i32::from(g.step)
                + models
                    .step_change
                    .code_signed(coder, wanted - i32::from(g.step))
        }
        None => models.step.code(coder, (wanted - STEP_MIN) as u32) as i32 + STEP_MIN,
    };
    // any bytes decode to something in range
    let log = log.clamp(STEP_MIN, STEP_MAX);
    let step = power_of_two(log);
    let far = coder.bit(&mut models.far, sphere.far);
    let numbers = chart.quantise(&sphere, step);
    let plane = coder.bit(&mut models.plane, numbers[3] == 0);
    let mut read = [0i32; 4];
    if let Some(b) = before {
        let guess = chart.quantise(&b.sphere, step);
        for k in 0..4 {
            if k < 3 || !plane {
                read[k] = add(
                    guess[k],
                    models.change[k].code_signed(coder, clamp(numbers[k] - guess[k])),
                );
            }
        }
    } else if let Some(beside) = beside
        && {
            let guess = chart.quantise(&beside.sphere, step);
            let size = |n: i32| 32 - n.unsigned_abs().leading_zeros();
            let on: u32 = (0..4)
                .map(|k| size(numbers[k].wrapping_sub(guess[k])))
                .sum();
            let anew: u32 = size(numbers[0].wrapping_sub(guess[0]))
                + (1..4).map(|k| size(numbers[k])).sum::<u32>();
            coder.bit(&mut models.runs_on, on < anew)
        }
    {
        let guess = chart.quantise(&beside.sphere, step);
        for k in 0..4 {
            if k < 3 || !plane {
                read[k] = add(
                    guess[k],
                    models.guided[k].code_signed(coder, clamp(numbers[k] - guess[k])),
                );
            }
        }
    } else {
        // depth runs on from the sphere before, tilt and curvature do not
        let guess = beside
            .or(*last)
            .map_or(0, |l| chart.quantise(&l.sphere, step)[0]);
        read[0] = add(
            guess,
            models.fresh[0].code_signed(coder, clamp(numbers[0] - guess)),
        );
        for k in 1..4 {
            if k < 3 || !plane {
                read[k] = models.fresh[k].code_signed(coder, numbers[k]);
            }
        }
    }
    let entry = Entry {
        sphere: chart.restore(read, step, far),
        step: log as i8,
    };
    *last = Some(entry);
    entry
}

fn clamp(n: i32) -> i32 {
    n.clamp(-2 * MOST, 2 * MOST)
}

fn add(a: i32, b: i32) -> i32 {
    a.saturating_add(b).clamp(-MOST, MOST)
}

/// 2ⁿ exactly.
fn power_of_two(n: i32) -> f64 {
    f64::from_bits(((1023 + n) as u64) << 52)
}
