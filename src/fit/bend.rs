//! A sphere bent within the contact distance for more contacts.
//!
//! Deviation. Paper 3.2 keeps the sphere that was fitted. Least squares minimises distance, but
//! what counts is the number of contacts: bent spheres are a tenth fewer for the same points.

use super::cloud::CloudSphere;
use super::draw::Draw;
use super::lanes::Lanes;
use glam::DVec3;

/// First, and last, length of a bend, contact distances.
const BEND: (f64, f64) = (0.5, 0.003);
/// A bend that gains contacts lengthens the next ones so, any other shortens them.
const LONGER: f64 = 1.5;
const SHORTER: f64 = 0.975;
/// One in so many points is looked at first.
const FIRST: usize = 4;
/// Fewer points are looked at all at once.
const SPLIT_POINTS: usize = 256;
/// A bend that loses more of the first points is given up without a look at the others.
const LOSS: usize = 3;

/// The points a sphere is bent over, and scratch.
#[derive(Debug, Default)]
pub(crate) struct Bends {
    first: Lanes,
    others: Lanes,
    marks: Vec<u8>,
    places: Vec<u32>,
}

impl Bends {
    /// Takes in the points of `from` in these places.
    pub fn refill(&mut self, from: &Lanes, places: &[u32]) {
        let first = if places.len() < SPLIT_POINTS {
            1
        } else {
            FIRST
        };
        self.places.clear();
        self.places.extend(places.iter().step_by(first));
        self.first.pick(from, &self.places);
        self.places.clear();
        if first > 1 {
            let chunks = places.chunks(first);
            self.places.extend(chunks.flat_map(|chunk| &chunk[1..]));
        }
        self.others.pick(from, &self.places);
    }

    /// Shifts, tilts and bends the sphere at random; what gains contacts stays. Steps grow with
    /// success and shrink without (Rechenberg's rule for a (1+1) evolution strategy). `None`
    /// where nothing was gained.
    pub fn best(
        &mut self,
        start: &CloudSphere,
        bends: usize,
        draw: &mut Draw,
    ) -> Option<CloudSphere> {
        let Self {
            first,
            others,
            marks,
            places,
        } = self;
        places.clear();
        first.list_touching(start, marks, places);
        let shape = Shape::new(first, places, start)?;
        let mut best = *start;
        let mut gained = false;
        let mut of_first = places.len();
        let mut score = of_first + others.touching(start);
        let tau = f64::from(first.tau(places[0] as usize));
        let mut step = BEND.0 * tau;
        for _ in 0..bends {
            if step < BEND.1 * tau {
                break;
            }
            // two uniform numbers: mostly short
            let mut amount = || step * (draw.signed_unit() + draw.signed_unit());
            let amounts = [amount(), amount(), amount(), amount()];
            let Some(sphere) = shape.bend(&best, amounts) else {
                continue;
            };
            step *= SHORTER;
            if !first.resolves(&sphere) {
                continue;
            }
            let now = first.touching(&sphere);
            if now + LOSS < of_first {
                continue;
            }
            let all = now + others.touching(&sphere);
            // more, not as many: a plateau is no reason to leave the least-squares fit
            if all > score {
                step *= LONGER / SHORTER;
                (best, of_first, score, gained) = (sphere, now, all, true);
            }
        }
        gained.then_some(best)
    }
}

/// Where a sphere's contacts lie: the scale of what bends it.
#[derive(Clone, Copy, Debug)]
struct Shape {
    center: DVec3,
    /// Along the patch and across it, each divided by the spread of the contacts that way.
    tilts: [DVec3; 2],
    /// One over the mean square distance from the centre.
    bend: f64,
}

impl Shape {
    /// Of the points in `places`; `None` for fewer than five.
    fn new(points: &Lanes, places: &[u32], sphere: &CloudSphere) -> Option<Self> {
        if places.len() < 5 {
            return None;
        }
        let per_point = 1.0 / places.len() as f64;
        let at = || places.iter().map(|&i| points.at(i as usize));
        let center = at().sum::<DVec3>() * per_point;
        let on = sphere.project(center);
        let normal = (sphere.curvature * on + sphere.normal).try_normalize()?;
        let (a, b) = normal.any_orthonormal_pair();
        let (mut aa, mut ab, mut bb, mut square) = (0.0, 0.0, 0.0, 0.0);
        for p in at() {
            let r = p - center;
            let (u, v) = (r.dot(a), r.dot(b));
            aa += u * u;
            ab += u * v;
            bb += v * v;
            square += r.length_squared();
        }
        let (sin, cos) = (0.5 * (2.0 * ab).atan2(aa - bb)).sin_cos();
        let spread = |c: f64, s: f64| {
            let variance = (aa * c * c + 2.0 * ab * s * c + bb * s * s) * per_point;
            variance.max(1e-30).sqrt()
        };
        Some(Self {
            center,
            tilts: [
                (cos * a + sin * b) / spread(cos, sin),
                (cos * b - sin * a) / spread(-sin, cos),
            ],
            bend: 1.0 / (square * per_point).max(1e-30),
        })
    }

    /// The sphere moved by about these amounts (metres) at the patch's rim: a shift, two tilts
    /// and a bend.
    fn bend(&self, sphere: &CloudSphere, amounts: [f64; 4]) -> Option<CloudSphere> {
        let [shift, along, across, bend] = amounts;
        let c = self.center;
        let tilt = along * self.tilts[0] + across * self.tilts[1];
        let bend = bend * self.bend;
        CloudSphere::normalised(
            sphere.curvature + 2.0 * bend,
            sphere.normal + tilt - 2.0 * bend * c,
            sphere.offset + shift - tilt.dot(c) + bend * (c.length_squared() - 1.0 / self.bend),
        )
    }
}
