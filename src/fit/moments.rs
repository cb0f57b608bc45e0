//! Moments of image blocks: the sums from which a sphere is solved, refitted and merged in O(1).
//!
//! In inverse depth a sphere is `w = a·s + b·u + c·v + e` with `s = q/w` (`fit::sphere`), linear
//! in its four parameters. The 14 sums and the count of the least-squares system are additive, so
//! the fit of a union costs one addition and one 4×4 elimination, whatever the number of points.
//! Sums are weighted by `1/τ²`, the squared contact distance in inverse depth: a residual is in
//! units of the contact distance and near and far parts of one surface count alike.

use super::sphere::Sphere;
use crate::deproject::{BLOCK, Rays};
use glam::Vec3;

/// Weighted sums over (u, v, s, w) about the camera's own axes, and the number of points.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    /// Number of points, unweighted.
    pub count: f64,
    /// Σ over the weight ω of: 1, u, v, s, w, uu, uv, us, uw, vv, vs, vw, ss, sw, ww.
    pub sums: [f64; 15],
}

/// A sphere fitted to moments.
#[derive(Clone, Copy, Debug)]
pub struct Fit {
    /// The surface.
    pub sphere: Sphere,
    /// Mean squared residual in units of the squared contact distance.
    pub misfit: f64,
}

/// Bits one more sphere costs (parameters and boundary), for the choice between surfaces.
pub const SPHERE_BITS: f64 = 60.0;
/// Bits the curvature of a sphere costs beyond a plane.
const CURVATURE_BITS: f64 = 8.0;

/// Bits a point costs on a surface it misses by `misfit` (mean square, contact distances): the
/// share of a normal distribution outside the contact distance times the cost of an escape, and a
/// small price on distortion itself.
#[inline]
#[must_use]
pub fn bits_per_point(misfit: f64) -> f64 {
    let x3 = misfit * misfit * misfit;
    let escape = if misfit > 1.0 {
        0.5 * log2(misfit)
    } else {
        0.0
    };
    3.0 * x3 / (0.12 + x3) + escape + 0.15 * misfit
}

/// log₂ of a normal number to 0.01, without the library's call.
#[inline(always)]
fn log2(x: f64) -> f64 {
    let bits = x.to_bits();
    let exponent = (bits >> 52 & 0x7FF) as f64 - 1023.0;
    let m = f64::from_bits(bits & (u64::MAX >> 12) | 1023 << 52);
    exponent + (2.0 - m * (1.0 / 3.0)) * m - 5.0 / 3.0
}

impl Moments {
    /// Adds one point at ray (u, v) with inverse depth `w` and weight `omega`.
    pub fn add_point(&mut self, u: f64, v: f64, w: f64, omega: f64) {
        let s = (u * u + v * v + 1.0) / w;
        let terms = [
            1.0,
            u,
            v,
            s,
            w,
            u * u,
            u * v,
            u * s,
            u * w,
            v * v,
            v * s,
            v * w,
            s * s,
            s * w,
            w * w,
        ];
        for (sum, t) in self.sums.iter_mut().zip(terms) {
            *sum += omega * t;
        }
        self.count += 1.0;
    }

    /// Adds the moments of other points.
    #[inline]
    pub fn add(&mut self, other: &Self) {
        self.count += other.count;
        for (a, b) in self.sums.iter_mut().zip(&other.sums) {
            *a += b;
        }
    }

    /// The moments of both sets of points.
    #[inline]
    #[must_use]
    pub fn union(&self, other: &Self) -> Self {
        let mut sum = *self;
        sum.add(other);
        sum
    }

    /// Squared distance of the points' middle from the camera, m².
    #[inline]
    fn power(&self) -> f64 {
        let [o, u, v, _, w, ..] = self.sums;
        (u * u + v * v + o * o) / (w * w)
    }

    /// Mean squared residual of these points on `sphere`, in squared contact distances. The linear
    /// form over its slope in `w` at the points' middle, the distance to first order.
    #[inline]
    #[must_use]
    pub fn misfit(&self, sphere: &Sphere) -> f64 {
        let [misfit] = self.misfits(&form_of(sphere).map(|x| [x]));
        misfit
    }

    /// [`misfit`](Self::misfit) of several spheres, the k-th number of each in array k
    /// (see [`form_of`]).
    #[inline(always)]
    #[must_use]
    pub fn misfits<const N: usize>(&self, forms: &[[f64; N]; 4]) -> [f64; N] {
        let [o, u, v, s, w, uu, uv, us, uw, vv, vs, vw, ss, sw, ww] = self.sums;
        let (power, count) = (self.power(), self.count.max(1.0));
        let mut misfits = [0.0; N];
        for (i, misfit) in misfits.iter_mut().enumerate() {
            let [a, b, c, e] = [forms[0][i], forms[1][i], forms[2][i], forms[3][i]];
            let square = a * (a * ss + 2.0 * (b * us + c * vs + e * s - sw))
                + b * (b * uu + 2.0 * (c * uv + e * u - uw))
                + c * (c * vv + 2.0 * (e * v - vw))
                + e * (e * o - 2.0 * w)
                + ww;
            let slope = 1.0 + a * power;
            *misfit = square.max(0.0) / (slope * slope * count);
        }
        misfits
    }

    /// Mean inverse depth and mean ray (u, v) of the points.
    #[must_use]
    pub fn mean(&self) -> (f64, f64, f64) {
        let o = self.sums[0];
        (self.sums[4] / o, self.sums[1] / o, self.sums[2] / o)
    }

    /// Least-squares surface through the points: a plane, or a sphere where its curvature saves
    /// more bits than it costs. `None` for fewer than three points or points on one line.
    ///
    /// One Gaussian elimination in the order (1, u, v, s) yields both: the plane before the last
    /// column, the sphere after it. The last column is not `s = |p|²/z`, whose noise is that of `w`
    /// itself (a regression on it finds the degenerate sphere through every reading), but
    /// `|p − p₀|²/z` about the points' middle `p₀`: that is `s + |p₀|²·w` up to terms in u, v, 1
    /// already eliminated, and to first order free of noise.
    #[must_use]
    pub fn fit(&self) -> Option<Fit> {
        let [o, u, v, s, w, uu, uv, us, uw, vv, vs, vw, ss, sw, ww] = self.sums;
        if self.count < 3.0 || o <= 0.0 {
            return None;
        }
        // centred on the mean: the sums are f64, block sums about local origins (module docs)
        let i = 1.0 / o;
        let (cuu, cuv, cus, cuw) = (
            uu - u * u * i,
            uv - u * v * i,
            us - u * s * i,
            uw - u * w * i,
        );
        let (cvv, cvs, cvw) = (vv - v * v * i, vs - v * s * i, vw - v * w * i);
        let (css, csw, cww) = (ss - s * s * i, sw - s * w * i, ww - w * w * i);
        if cuu <= 1e-14 * uu.max(o * 1e-6) {
            return None;
        }
        let per_uu = 1.0 / cuu;
        let f = cuv * per_uu;
        let dvv = cvv - f * cuv;
        if dvv <= 1e-9 * cvv.max(cuu) {
            return None;
        }
        let per_vv = 1.0 / dvv;
        let (dvs, dvw) = (cvs - f * cus, cvw - f * cuw);
        let plane_square = (cww - cuw * cuw * per_uu - dvw * dvw * per_vv).max(0.0);
        let n = self.count;
        let p = self.power();
        // w = k·(s + p·w) + b·u + c·v + e, then the form w = a·s + m·r
        let solve = |k: f64| {
            let c = (dvw - k * (dvs + p * dvw)) * per_vv;
            let b = (cuw - k * (cus + p * cuw) - c * cuv) * per_uu;
            let e = (w - k * (s + p * w) - b * u - c * v) * i;
            let d = 1.0 / (1.0 - k * p);
            Sphere {
                a: (k * d) as f32,
                m: Vec3::new((b * d) as f32, (c * d) as f32, (e * d) as f32),
                far: false,
            }
        };
        let plane = |square: f64| Fit {
            sphere: solve(0.0),
            misfit: square / n,
        };
        let plane_bits = n * bits_per_point(plane_square / n);
        // a plane so near that no curvature can save its own bits
        if n < 8.0 || plane_bits <= CURVATURE_BITS {
            return Some(plane(plane_square));
        }
        let (g, h) = (cus * per_uu, dvs * per_vv);
        let dss = css - g * cus - h * dvs;
        let dsw = csw - g * cuw - h * dvw;
        let (bend, lift) = (
            dss + p * (2.0 * dsw + p * plane_square),
            dsw + p * plane_square,
        );
        if bend <= 1e-12 * ss.max(0.0) {
            return Some(plane(plane_square));
        }
        let k = lift / bend;
        let sphere_square = (plane_square - lift * k).max(0.0);
        let misfit = sphere_square / n;
        if plane_bits - n * bits_per_point(misfit) < CURVATURE_BITS {
            return Some(plane(plane_square));
        }
        let turn = 1.0 - k * p;
        if turn.abs() < 0.02 {
            return Some(plane(plane_square)); // seen edge-on: no stable sphere
        }
        let mut sphere = solve(k);
        // bent by more than the sphere around the camera: a hollow, seen from outside
        sphere.far = turn < 0.0;
        Some(Fit { sphere, misfit })
    }

    /// Bits to code these points on the surface `fit` found for them.
    #[must_use]
    pub fn bits(&self, misfit: f64) -> f64 {
        SPHERE_BITS + self.count * bits_per_point(misfit)
    }
}

/// The numbers a, b, c and e of `w = a·s + b·u + c·v + e`.
#[inline(always)]
#[must_use]
pub fn form_of(sphere: &Sphere) -> [f64; 4] {
    [sphere.a, sphere.m.x, sphere.m.y, sphere.m.z].map(f64::from)
}

/// Sum of eight lanes, by halves.
#[inline(always)]
fn sum_of(a: [f32; BLOCK]) -> f32 {
    let b = [a[0] + a[4], a[1] + a[5], a[2] + a[6], a[3] + a[7]];
    (b[0] + b[2]) + (b[1] + b[3])
}

/// Σ over a block's rows (or columns) of the squared distance from its middle, in steps.
const SPREAD: f32 = 42.0;

/// Lane numbers from the middle of a block, in steps.
const FROM_MIDDLE: [f32; BLOCK] = [-3.5, -2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 3.5];

/// Mean depth of a block's pixels of `keep`, the centre (u, v, s, w) and the sums about it in the
/// order of [`Moments::sums`]. `FULL` where `keep` is all of them: what depends on the grid alone is
/// then known.
#[inline(always)]
fn local_sums<const FULL: bool>(
    (plane, first): (&[u16], usize),
    rays: &Rays,
    at: (usize, usize),
    keep: u64,
) -> Option<(f64, [f64; 4], [f64; 15])> {
    const BIT: [u32; BLOCK] = [1, 2, 4, 8, 16, 32, 64, 128];
    if keep == 0 {
        return None;
    }
    let stride = rays.stride();
    let (x0, y0) = (at.0 * BLOCK, at.1 * BLOCK);
    let u = rays.u[x0..].first_chunk::<BLOCK>()?;
    let v = rays.v[y0..].first_chunk::<BLOCK>()?;
    let top = (at.1 - first) * BLOCK * stride + x0;
    let rows = plane.get(top..top + (BLOCK - 1) * stride + BLOCK)?;
    // sums are taken about the depth of one of the pixels
    let one = if FULL {
        27
    } else {
        keep.trailing_zeros() as usize
    };
    let z0 = f32::from(rows[one / BLOCK * stride + one % BLOCK]) * rays.unit;
    let (step_u, step_v) = ((u[7] - u[0]) / 7.0, (v[7] - v[0]) / 7.0);
    let (w0, u0, v0) = (1.0 / z0, 0.5 * (u[3] + u[4]), 0.5 * (v[3] + v[4]));
    let s0 = (u0 * u0 + v0 * v0 + 1.0) * z0;
    let mut uu1 = [0f32; BLOCK];
    for (uu1, u) in uu1.iter_mut().zip(u) {
        *uu1 = u * u + 1.0;
    }
    // columns: sums over the rows, v in steps
    let zero = [0f32; BLOCK];
    let (mut n, mut nv, mut nvv, mut total) = (zero, zero, zero, zero);
    let (mut cw, mut cwv, mut cww) = (zero, zero, zero);
    let (mut cs, mut csv, mut css, mut csw) = (zero, zero, zero, zero);
    for j in 0..BLOCK {
        let row = rows[j * stride..].first_chunk::<BLOCK>()?;
        let (dv, vv) = (FROM_MIDDLE[j], v[j] * v[j]);
        let bits = (keep >> (8 * j)) as u32;
        for i in 0..BLOCK {
            let z = f32::from(row[i]) * rays.unit;
            let here = FULL || bits & BIT[i] != 0;
            let m = if here { 1f32 } else { 0.0 };
            // a pixel that is not kept may have no depth: it is divided by
            let kept = if here { z } else { z0 };
            let w = m * (1.0 / kept - w0);
            let s = m * ((uu1[i] + vv) * kept - s0);
            if !FULL {
                n[i] += m;
                nv[i] += m * dv;
                nvv[i] += m * (dv * dv);
            }
            total[i] += m * kept;
            cw[i] += w;
            cwv[i] += w * dv;
            cww[i] += w * w;
            cs[i] += s;
            csv[i] += s * dv;
            css[i] += s * s;
            csw[i] += s * w;
        }
    }
    let across = |c: [f32; BLOCK]| sum_of(std::array::from_fn(|i| c[i] * FROM_MIDDLE[i]));
    let count = keep.count_ones() as f32;
    // 1, u, v, uu, uv, vv
    let grid = if FULL {
        [count, 0.0, 0.0, 8.0 * SPREAD, 0.0, 8.0 * SPREAD]
    } else {
        let uu = std::array::from_fn(|i| n[i] * FROM_MIDDLE[i] * FROM_MIDDLE[i]);
        let (u, uv) = (across(n), across(nv));
        [count, u, sum_of(nv), sum_of(uu), uv, sum_of(nvv)]
    };
    let sums = [
        grid[0],
        grid[1] * step_u,
        grid[2] * step_v,
        sum_of(cs),
        sum_of(cw),
        grid[3] * (step_u * step_u),
        grid[4] * (step_u * step_v),
        across(cs) * step_u,
        across(cw) * step_u,
        grid[5] * (step_v * step_v),
        sum_of(csv) * step_v,
        sum_of(cwv) * step_v,
        sum_of(css),
        sum_of(csw),
        sum_of(cww),
    ];
    // not `map`, which is compiled without the caller's vector instructions
    let (mut center, mut wide) = ([0.0; 4], [0.0; 15]);
    for (to, from) in center.iter_mut().zip([u0, v0, s0, w0]) {
        *to = f64::from(from);
    }
    for (to, from) in wide.iter_mut().zip(sums) {
        *to = f64::from(from);
    }
    Some((f64::from(sum_of(total) / count), center, wide))
}

/// Moments of the block `at` column and row of a padded plane of depth integers (0 = invalid), given
/// from some row of blocks on, with the pixels of `keep` only, all of them measured (bit
/// `8·row + column`). `weight` gives ω from the block's mean depth in metres.
///
/// Sums are single precision about the block's own centre (64 terms, no cancellation), then moved
/// to the camera's axes in double precision.
#[inline(always)]
pub fn of_block(
    plane: (&[u16], usize),
    rays: &Rays,
    at: (usize, usize),
    keep: u64,
    weight: impl Fn(f64) -> f64,
) -> Moments {
    // a block without holes, which most are, needs no mask
    let local = if keep == u64::MAX {
        local_sums::<true>(plane, rays, at, keep)
    } else {
        local_sums::<false>(plane, rays, at, keep)
    };
    let Some((z0, [u0, v0, s0, w0], local)) = local else {
        return Moments::default();
    };
    let [
        n,
        lu,
        lv,
        ls,
        lw,
        luu,
        luv,
        lus,
        luw,
        lvv,
        lvs,
        lvw,
        lss,
        lsw,
        lww,
    ] = local;
    let shift = |xy: f64, x: f64, y: f64, x0: f64, y0: f64| xy + x0 * y + y0 * x + n * x0 * y0;
    let mut sums = [
        n,
        lu + n * u0,
        lv + n * v0,
        ls + n * s0,
        lw + n * w0,
        shift(luu, lu, lu, u0, u0),
        shift(luv, lu, lv, u0, v0),
        shift(lus, lu, ls, u0, s0),
        shift(luw, lu, lw, u0, w0),
        shift(lvv, lv, lv, v0, v0),
        shift(lvs, lv, ls, v0, s0),
        shift(lvw, lv, lw, v0, w0),
        shift(lss, ls, ls, s0, s0),
        shift(lsw, ls, lw, s0, w0),
        shift(lww, lw, lw, w0, w0),
    ];
    let omega = weight(z0);
    for sum in &mut sums {
        *sum *= omega;
    }
    Moments { count: n, sums }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn misfit_is_the_mean_square_over_the_points() {
        let point = |i: i32| {
            let (u, v) = (
                0.1 + 0.002 * f64::from(i % 8),
                -0.2 + 0.002 * f64::from(i / 8),
            );
            let w = 0.5 + 0.1 * u - 0.2 * v + 1e-3 * f64::from(i * 37 % 11);
            (u, v, w)
        };
        let omega = 3e4;
        let mut moments = Moments::default();
        let (mut mean, mut n) = ([0.0; 3], 0.0);
        for (u, v, w) in (0..64).map(point) {
            moments.add_point(u, v, w, omega);
            mean = [mean[0] + u, mean[1] + v, mean[2] + w];
            n += 1.0;
        }
        let spheres: [Sphere; 8] = std::array::from_fn(|k| Sphere {
            a: 0.02 * (k as f32 - 3.0),
            m: Vec3::new(0.1, -0.2 + 0.01 * k as f32, 0.5),
            far: false,
        });
        let forms = std::array::from_fn(|x| spheres.map(|s| form_of(&s)[x]));
        let misfits = moments.misfits(&forms);
        for (sphere, misfit) in spheres.iter().zip(misfits) {
            let [a, b, c, e] = form_of(sphere);
            let square: f64 = (0..64)
                .map(point)
                .map(|(u, v, w)| {
                    let s = (u * u + v * v + 1.0) / w;
                    (a * s + b * u + c * v + e - w).powi(2) * omega
                })
                .sum();
            let [u, v, w] = mean.map(|x| x / n);
            let slope = 1.0 + a * (u * u + v * v + 1.0) / (w * w);
            let truth = square / (slope * slope * n);
            assert!(
                (misfit - truth).abs() < 1e-6 * truth,
                "{misfit}, not {truth}"
            );
            assert_eq!(moments.misfit(sphere), misfit);
        }
    }
}
