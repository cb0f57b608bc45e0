//! Points with their contact distances, and who of them touches a given sphere.

use super::block_set::BlockSet;
use super::cloud::CloudSphere;
use super::contact_distance::ContactDistance;
use super::point_moments::PointMoments;
use super::touch::{self, Arrays, Bounds, Surface};
use crate::partition::points::LocalPoints;
use glam::DVec3;

/// Points of a cloud, one array per coordinate.
#[derive(Clone, Debug, Default)]
pub(crate) struct Lanes {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    /// |p|², square metres.
    q: Vec<f32>,
    /// Contact distance of each point, metres; empty where all have `constant_tau`.
    tau: Vec<f32>,
    constant_tau: f32,
    /// Number of each point in the cloud.
    pub id: Vec<u32>,
    /// Curvature above which single precision no longer resolves the contact distance, 1/m.
    curvature_limit: f64,
    /// Scratch of [`Lanes::remove`].
    marks: Vec<u8>,
}

impl Lanes {
    /// Empties the set, keeping its memory.
    pub fn clear(&mut self) {
        for axis in self.axes_mut() {
            axis.clear();
        }
        self.id.clear();
    }

    fn axes_mut(&mut self) -> [&mut Vec<f32>; 5] {
        [
            &mut self.x,
            &mut self.y,
            &mut self.z,
            &mut self.q,
            &mut self.tau,
        ]
    }

    fn axes(&self) -> [&Vec<f32>; 5] {
        [&self.x, &self.y, &self.z, &self.q, &self.tau]
    }

    fn arrays(&self) -> Arrays<'_> {
        [&self.x, &self.y, &self.z, &self.q]
    }

    /// Takes in the points `ids` of the cloud. `shift` moves the zero (metres about the cloud's
    /// origin) nearer to them.
    pub fn fill(
        &mut self,
        points: &LocalPoints,
        ids: impl Iterator<Item = u32>,
        shift: DVec3,
        contact: &ContactDistance,
    ) {
        self.clear();
        self.id.extend(ids);
        let ids = || self.id.iter().map(|&id| id as usize);
        for (mine, (theirs, shift)) in [&mut self.x, &mut self.y, &mut self.z].into_iter().zip([
            (&points.x, shift.x),
            (&points.y, shift.y),
            (&points.z, shift.z),
        ]) {
            mine.extend(ids().map(|i| (f64::from(theirs[i]) - shift) as f32));
        }
        let square = |((x, y), z): ((&f32, &f32), &f32)| x * x + y * y + z * z;
        self.q
            .extend(self.x.iter().zip(&self.y).zip(&self.z).map(square));
        let far2 = self.q.iter().copied().fold(0f32, f32::max);
        self.constant_tau = contact.floor_m as f32;
        if !contact.is_constant() {
            let depth = |i: usize| f64::from(points.z[i]) + points.origin.z;
            self.tau.extend(ids().map(|i| contact.at(depth(i)) as f32));
        }
        let (mut least, mut most) = (f32::MAX, 0f32);
        for &tau in &self.tau {
            (least, most) = (least.min(tau), most.max(tau));
        }
        if self.tau.is_empty() {
            (least, most) = (self.constant_tau, self.constant_tau);
        }
        // (κ/2)|p|² is rounded to 2⁻²⁴ of itself: hold that below a sixteenth of τ. The band
        // test needs |κ|τ < 1 besides.
        let by_rounding = f64::from(least) * f64::from(1 << 20) / f64::from(far2).max(1e-30);
        self.curvature_limit = by_rounding.min(0.5 / f64::from(most).max(1e-30));
    }

    /// Curvature above which single precision no longer resolves the contact distance, 1/m.
    pub fn curvature_limit(&self) -> f64 {
        self.curvature_limit
    }

    /// True where the sphere's contacts can be told in single precision.
    pub fn resolves(&self, sphere: &CloudSphere) -> bool {
        sphere.curvature.abs() <= self.curvature_limit
    }

    /// Becomes the points of `from` in these places. They get no numbers.
    pub fn pick(&mut self, from: &Self, places: &[u32]) {
        self.clear();
        self.curvature_limit = from.curvature_limit;
        self.constant_tau = from.constant_tau;
        for (mine, theirs) in self.axes_mut().into_iter().zip(from.axes()) {
            if !theirs.is_empty() {
                mine.extend(places.iter().map(|&i| theirs[i as usize]));
            }
        }
    }

    pub fn len(&self) -> usize {
        self.x.len()
    }

    pub fn at(&self, i: usize) -> DVec3 {
        DVec3::new(
            f64::from(self.x[i]),
            f64::from(self.y[i]),
            f64::from(self.z[i]),
        )
    }

    pub fn tau(&self, i: usize) -> f32 {
        self.tau.get(i).copied().unwrap_or(self.constant_tau)
    }

    /// Coordinates of point `i`.
    pub fn lane(&self, i: usize) -> [f32; 3] {
        [self.x[i], self.y[i], self.z[i]]
    }

    /// Offers the sphere, with its number, to the points of `set`: those it is nearer to (to first
    /// order: they are within contact distance) than the `nearest` so far get it as `owner`.
    pub fn offer(
        &self,
        (number, sphere): (u32, &CloudSphere),
        set: &BlockSet,
        (nearest, owner): (&mut [f32], &mut [u32]),
    ) {
        let surface = sphere.into();
        touch::offer(
            &surface,
            number,
            self.arrays(),
            &set.blocks,
            (nearest, owner),
        );
    }

    /// Points that touch the sphere.
    pub fn touching(&self, sphere: &CloudSphere) -> usize {
        self.touching_surface(&sphere.into())
    }

    /// Points that touch the surface.
    pub fn touching_surface(&self, surface: &Surface) -> usize {
        let count = if self.tau.is_empty() {
            touch::count_constant(surface, self.arrays(), self.constant_tau)
        } else {
            touch::count(surface, self.arrays(), &self.tau)
        };
        count as usize
    }

    /// Marks the points within `widen` contact distances of the sphere by 1, the others by 0.
    fn mark(&self, sphere: &CloudSphere, widen: f32, marks: &mut Vec<u8>) {
        marks.resize(self.len(), 0);
        if self.tau.is_empty() {
            let reach = widen * self.constant_tau;
            touch::mark_constant(&sphere.into(), self.arrays(), reach, marks);
        } else {
            touch::mark(&sphere.into(), self.arrays(), &self.tau, widen, marks);
        }
    }

    /// Appends the places of the points that touch the sphere to `places`, ascending.
    pub fn list_touching(&self, sphere: &CloudSphere, marks: &mut Vec<u8>, places: &mut Vec<u32>) {
        self.mark(sphere, 1.0, marks);
        touch::list(marks, places);
    }

    /// Puts the points within `widen` contact distances of the sphere into `near`. `bounds` are
    /// those of these points.
    pub fn list_near(
        &self,
        bounds: &Bounds,
        sphere: &CloudSphere,
        widen: f32,
        near: &mut BlockSet,
    ) {
        let tau = (&self.tau[..], self.constant_tau);
        near.blocks.clear();
        touch::list_near(
            &sphere.into(),
            self.arrays(),
            tau,
            widen,
            bounds,
            &mut near.blocks,
        );
    }

    /// Bounds of these points, block by block.
    pub fn bound(&self, bounds: &mut Bounds) {
        bounds.refill(self.arrays(), &self.tau, self.constant_tau);
    }

    /// Moments of the points within `widen` contact distances of the sphere. `marks` and
    /// `places` are scratch.
    pub fn moments(
        &self,
        sphere: &CloudSphere,
        widen: f32,
        (marks, places): (&mut Vec<u8>, &mut Vec<u32>),
    ) -> PointMoments {
        self.mark(sphere, widen, marks);
        places.clear();
        touch::list(marks, places);
        let mut sums = PointMoments::default();
        for &i in places.iter() {
            sums.add(self.at(i as usize));
        }
        sums
    }

    /// Takes the points that touch the sphere out; says how many. The rest keep their order.
    pub fn remove(&mut self, sphere: &CloudSphere) -> usize {
        let before = self.len();
        let mut marks = std::mem::take(&mut self.marks);
        self.mark(sphere, 1.0, &mut marks);
        for axis in self.axes_mut() {
            keep_unmarked(axis, &marks);
        }
        keep_unmarked(&mut self.id, &marks);
        self.marks = marks;
        before - self.len()
    }
}

/// Keeps the values whose mark is 0, in order; an array without values stays so. Neighbours on
/// the curve mostly share their fate, so eight at a time are moved or passed over.
fn keep_unmarked<T: Copy>(values: &mut Vec<T>, marks: &[u8]) {
    if values.is_empty() {
        return;
    }
    let mut kept = 0;
    let (eights, rest) = marks.as_chunks::<8>();
    for (chunk, eight) in eights.iter().enumerate() {
        let from = 8 * chunk;
        match u64::from_le_bytes(*eight) {
            0 => {
                values.copy_within(from..from + 8, kept);
                kept += 8;
            }
            0x0101_0101_0101_0101 => {}
            _ => {
                // no branch on a single mark: they are noise to it
                for (i, &mark) in (from..).zip(eight) {
                    values[kept] = values[i];
                    kept += usize::from(mark == 0);
                }
            }
        }
    }
    for (i, &mark) in (marks.len() - rest.len()..).zip(rest) {
        values[kept] = values[i];
        kept += usize::from(mark == 0);
    }
    values.truncate(kept);
}
