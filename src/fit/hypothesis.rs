//! Spheres through four random points each, many at a time.

use super::draw::Draw;
use super::lanes::Lanes;
use super::touch::Surface;
use multiversion::multiversion;

/// Hypotheses made at a time.
pub(crate) const LANES: usize = 40;
/// Four points whose normal, sides scaled to 1, is shorter than the root of this lie on a line
/// as far as single precision tells.
const FLAT: f32 = 1e-12;

/// A number for each hypothesis.
type Lane = [f32; LANES];

/// Points o, a, b and c of each hypothesis: x, y and z.
type Corners = [[Lane; 3]; 4];

/// Surfaces, one for each hypothesis; those of four points without a surface are not finite.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hypotheses {
    h: Lane,
    n: [Lane; 3],
    d: Lane,
}

impl Default for Hypotheses {
    fn default() -> Self {
        Self {
            h: [0.0; LANES],
            n: [[0.0; LANES]; 3],
            d: [0.0; LANES],
        }
    }
}

impl Hypotheses {
    /// Each through four of the points in `left`, from a window of random place and width (every
    /// octave from 8 points to all alike). `left` holds at least four places and follows a
    /// space-filling curve.
    pub fn draw(points: &Lanes, left: &[u32], draw: &mut Draw) -> Self {
        let n = left.len();
        let octaves = (n.ilog2() as usize).saturating_sub(2).max(1);
        let mut corners = [[[0.0; LANES]; 3]; 4];
        for lane in 0..LANES {
            let (octave, middle) = draw.two_below(octaves, n);
            let width = (n >> octave).max(8).min(n);
            let from = middle.saturating_sub(width / 2).min(n - width);
            let (o, a) = draw.two_below(width, width);
            let (b, c) = draw.two_below(width, width);
            for (corner, place) in corners.iter_mut().zip([o, a, b, c]) {
                let point = points.lane(left[from + place] as usize);
                for (axis, v) in corner.iter_mut().zip(point) {
                    axis[lane] = v;
                }
            }
        }
        let mut made = Self::default();
        through(&corners, &mut made);
        made
    }

    /// Hypothesis `lane`, where it is a surface whose curvature is within `limit` (1/m).
    pub fn get(&self, lane: usize, limit: f64) -> Option<Surface> {
        let surface = Surface {
            h: self.h[lane],
            n: self.n.map(|axis| axis[lane]),
            d: self.d[lane],
        };
        (f64::from(2.0 * surface.h.abs()) <= limit && surface.d.is_finite()).then_some(surface)
    }
}

/// As [`CloudSphere::through`](super::cloud::CloudSphere::through), in single precision: about
/// o, with the longest side scaled to 1.
#[multiversion(targets("x86_64+avx2"))]
fn through(corners: &Corners, made: &mut Hypotheses) {
    let [[ox, oy, oz], [ax, ay, az], [bx, by, bz], [cx, cy, cz]] = corners;
    let Hypotheses { h, n, d } = made;
    let [nx, ny, nz] = n;
    for i in 0..LANES {
        let (ax, ay, az) = (ax[i] - ox[i], ay[i] - oy[i], az[i] - oz[i]);
        let (bx, by, bz) = (bx[i] - ox[i], by[i] - oy[i], bz[i] - oz[i]);
        let (cx, cy, cz) = (cx[i] - ox[i], cy[i] - oy[i], cz[i] - oz[i]);
        let aa = ax * ax + ay * ay + az * az;
        let bb = bx * bx + by * by + bz * bz;
        let cc = cx * cx + cy * cy + cz * cz;
        let scale = 1.0 / aa.max(bb).max(cc).sqrt();
        let (ax, ay, az, aa) = (ax * scale, ay * scale, az * scale, aa * scale * scale);
        let (bx, by, bz, bb) = (bx * scale, by * scale, bz * scale, bb * scale * scale);
        let (cx, cy, cz, cc) = (cx * scale, cy * scale, cz * scale, cc * scale * scale);
        // b × c, and the determinant
        let (px, py, pz) = (by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx);
        let volume = ax * px + ay * py + az * pz;
        let x = aa * px + bb * (cy * az - cz * ay) + cc * (ay * bz - az * by);
        let y = aa * py + bb * (cz * ax - cx * az) + cc * (az * bx - ax * bz);
        let z = aa * pz + bb * (cx * ay - cy * ax) + cc * (ax * by - ay * bx);
        let square = x * x + y * y + z * z;
        let unit = -1.0 / square.sqrt();
        let unit = if square > FLAT { unit } else { f32::NAN };
        let (x, y, z) = (x * unit, y * unit, z * unit);
        let bend = -volume * unit * scale;
        h[i] = bend;
        nx[i] = x - 2.0 * bend * ox[i];
        ny[i] = y - 2.0 * bend * oy[i];
        nz[i] = z - 2.0 * bend * oz[i];
        let far = ox[i] * ox[i] + oy[i] * oy[i] + oz[i] * oz[i];
        d[i] = bend * far - (x * ox[i] + y * oy[i] + z * oz[i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::cloud::CloudSphere;
    use glam::DVec3;

    #[test]
    fn hypotheses_are_the_spheres_of_double_precision() {
        let mut draw = Draw::new(3);
        for size in [1e-6, 1e-3, 0.3, 1e4] {
            let mut unit = || draw.signed_unit();
            let at: [[DVec3; 4]; LANES] = std::array::from_fn(|lane| {
                let zero = DVec3::new(unit(), unit(), unit()) * size;
                // small patches about the zero they are far from, and two without a surface
                let spread = size * [1.0, 0.1, 0.02][lane % 3];
                let mut four = std::array::from_fn(|_| {
                    let p = zero + DVec3::new(unit(), unit(), unit()) * spread;
                    p.as_vec3().as_dvec3()
                });
                match lane {
                    0 => four = [four[0]; 4],
                    1 => {
                        four =
                            [1.0, 2.0, 3.0, 4.0].map(|k| (k * size * DVec3::X).as_vec3().as_dvec3())
                    }
                    _ => {}
                }
                four
            });
            let mut corners = [[[0.0; LANES]; 3]; 4];
            for (lane, four) in at.iter().enumerate() {
                for (corner, p) in corners.iter_mut().zip(four) {
                    for (axis, v) in corner.iter_mut().zip(p.to_array()) {
                        axis[lane] = v as f32;
                    }
                }
            }
            let mut made = Hypotheses::default();
            through(&corners, &mut made);
            for (lane, four) in at.into_iter().enumerate() {
                let surface = made.get(lane, f64::INFINITY);
                if lane < 2 {
                    assert!(surface.is_none(), "size {size}, lane {lane}");
                    continue;
                }
                let truth = CloudSphere::through(four).unwrap();
                let sphere = surface.unwrap().sphere().unwrap();
                let side = truth.normal.dot(sphere.normal).signum();
                for p in four {
                    let off = sphere.distance(p) / size;
                    let rounding = 3e-6 * (1.0 + truth.curvature.abs() * size);
                    assert!(off < rounding, "size {size}, lane {lane}: {off} of it off");
                }
                let bend = (truth.curvature - side * sphere.curvature).abs() * size;
                let scale = 1.0 + truth.curvature.abs() * size;
                assert!(
                    bend < 0.02 * scale * scale,
                    "size {size}, lane {lane}: {bend}"
                );
            }
        }
    }
}
