//! The random scheme (paper 3.1, 3.2, 4.1): the sphere that most points touch, of many through
//! randomly drawn points; its contacts are taken out; again, until about 0.1 % remain.

use super::cloud::{CloudModel, FitParameters, UNASSIGNED, UNEXPLAINED_SHARE};
use super::cover::Cover;
use super::fewer::fewer;
use super::remaining::Remaining;
use super::search::{Draw, SphereSearch};
use crate::partition::points::LocalPoints;
use glam::{DVec3, Vec3};

/// The random scheme and its buffers, kept from cloud to cloud.
#[derive(Debug, Default)]
pub struct RandomFit {
    codes: Vec<u64>,
    sorted: Vec<u64>,
    all: Remaining,
    remaining: Remaining,
    search: SphereSearch,
}

impl RandomFit {
    /// Fits spheres to the whole cloud as to one object (paper 3.2: "to the entire object for a
    /// single object"). Same points, parameters and seed: same model.
    ///
    /// Every assigned point is within contact distance of its sphere up to the rounding of
    /// single precision. Stops at 0.1 % unexplained, at `max_spheres`, or where the points left
    /// span no surface.
    #[must_use]
    pub fn fit(&mut self, points: &LocalPoints, parameters: &FitParameters) -> CloudModel {
        let mut model = CloudModel {
            origin: points.origin,
            assignment: vec![UNASSIGNED; points.len()],
            ..CloudModel::default()
        };
        morton_order(points, &mut self.codes, &mut self.sorted);
        let ids = self.codes.iter().map(|&code| code as u32);
        let contact = &parameters.contact_distance;
        self.all.fill(points, ids, DVec3::ZERO, contact);
        self.remaining.clone_from(&self.all);

        let allowed = (points.len() as f64 * UNEXPLAINED_SHARE) as usize;
        let mut draw = Draw::new(parameters.seed);
        self.search.begin(points.len());
        let mut spheres = Vec::new();
        while self.remaining.len() > allowed && spheres.len() < parameters.max_spheres {
            let Some(sphere) = self.search.best(&self.remaining, &mut draw) else {
                break;
            };
            if self.remaining.remove(&sphere) == 0 {
                break;
            }
            spheres.push(sphere);
        }
        let mut cover = Cover::new(&self.all, &spheres);
        if self.remaining.len() <= allowed {
            cover.prune(allowed);
            fewer(
                &mut cover,
                &self.all,
                allowed,
                (&mut self.search, &mut draw),
            );
        }
        cover.settle(&self.all);
        cover.assign(&self.all, &mut model.assignment);
        model.spheres = cover.spheres;
        model.order_and_limit(parameters.max_spheres);
        model
    }
}

/// The points' numbers (low 32 bits) in Morton order (high bits, 10 per axis): neighbours in the
/// list are neighbours in space, and every k-th of them is a fair sample. Radix sort in three
/// passes: O(n), and points of one code keep their order.
fn morton_order(points: &LocalPoints, codes: &mut Vec<u64>, sorted: &mut Vec<u64>) {
    let (mut low, mut high) = (Vec3::MAX, Vec3::MIN);
    for i in 0..points.len() {
        low = low.min(points.at(i));
        high = high.max(points.at(i));
    }
    let scale = 1023.0 / (high - low).max_element().max(f32::MIN_POSITIVE);
    let mut counts = [[0u32; 1024]; 3];
    codes.clear();
    codes.extend((0..points.len()).map(|i| {
        let q = (points.at(i) - low) * scale;
        let code = spread(q.x as u32) | spread(q.y as u32) << 1 | spread(q.z as u32) << 2;
        for (pass, counts) in counts.iter_mut().enumerate() {
            counts[(code >> (10 * pass)) as usize & 1023] += 1;
        }
        u64::from(code) << 32 | i as u64
    }));
    for (pass, counts) in counts.iter_mut().enumerate() {
        let mut first = 0;
        for count in counts.iter_mut() {
            (*count, first) = (first, first + *count);
        }
        sorted.resize(codes.len(), 0);
        for &code in codes.iter() {
            let place = &mut counts[(code >> (32 + 10 * pass)) as usize & 1023];
            sorted[*place as usize] = code;
            *place += 1;
        }
        std::mem::swap(codes, sorted);
    }
}

/// The ten low bits of `v`, each moved to three times its place.
fn spread(v: u32) -> u32 {
    let v = v & 0x3ff;
    let v = (v | v << 16) & 0x0300_00ff;
    let v = (v | v << 8) & 0x0300_f00f;
    let v = (v | v << 4) & 0x030c_30c3;
    (v | v << 2) & 0x0924_9249
}
