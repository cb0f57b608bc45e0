//! A whole cloud in Morton order, in blocks of 64 with bounds: who touches a sphere is found
//! without a look at the blocks it passes by far.

use super::block_set::BlockSet;
use super::cloud::CloudSphere;
use super::contact_distance::ContactDistance;
use super::lanes::Lanes;
use super::touch::Bounds;
use crate::partition::points::LocalPoints;
use glam::DVec3;

/// Points along a Morton curve: neighbours in the list are neighbours in space, and every k-th of
/// them is a fair sample.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ordered {
    /// The points.
    pub lanes: Lanes,
    bounds: Bounds,
}

impl Ordered {
    /// Takes in all points.
    pub fn fill(&mut self, points: &LocalPoints, contact: &ContactDistance) {
        let order = morton_order(points);
        let ids = order.iter().map(|&code| code as u32);
        self.lanes.fill(points, ids, DVec3::ZERO, contact);
        drop(order);
        self.lanes.bound(&mut self.bounds);
    }

    pub fn len(&self) -> usize {
        self.lanes.len()
    }

    pub fn at(&self, i: usize) -> DVec3 {
        self.lanes.at(i)
    }

    /// Puts the points within `widen` contact distances of the sphere into `near`.
    pub fn list_near(&self, sphere: &CloudSphere, widen: f32, near: &mut BlockSet) {
        self.lanes.list_near(&self.bounds, sphere, widen, near);
    }

    /// The points that touch the sphere.
    pub fn touching(&self, sphere: &CloudSphere) -> BlockSet {
        let mut touching = BlockSet::default();
        self.list_near(sphere, 1.0, &mut touching);
        touching
    }
}

/// The points' numbers (low 32 bits) in Morton order (high bits, 10 per axis). Radix sort in three
/// passes: O(n), and points of one code keep their order.
fn morton_order(points: &LocalPoints) -> Vec<u64> {
    let ends = |axis: &[f32]| {
        let both = |(low, high): (f32, f32), &v: &f32| (low.min(v), high.max(v));
        axis.iter().fold((f32::MAX, f32::MIN), both)
    };
    let [x, y, z] = [ends(&points.x), ends(&points.y), ends(&points.z)];
    let widest = (x.1 - x.0).max(y.1 - y.0).max(z.1 - z.0);
    let scale = 1023.0 / widest.max(f32::MIN_POSITIVE);
    let spread = spread_table();
    // above 2²³ the last binary digit is worth 1: the digits are the whole number
    let whole = |v: f32| (v + 8_388_608.0).to_bits() as usize & 1023;
    let cell = |v: f32, low: f32| spread[whole((v - low) * scale)];
    let mut counts = [[0u32; 1024]; 3];
    let axes = points.x.iter().zip(&points.y).zip(&points.z);
    let codes = axes.zip(0u32..).map(|(((&px, &py), &pz), i)| {
        let code = cell(px, x.0) | cell(py, y.0) << 1 | cell(pz, z.0) << 2;
        u64::from(code) << 32 | u64::from(i)
    });
    let mut codes: Vec<u64> = codes.collect();
    for code in &codes {
        for (pass, counts) in counts.iter_mut().enumerate() {
            counts[(code >> (32 + 10 * pass)) as usize & 1023] += 1;
        }
    }
    let mut sorted = vec![0; codes.len()];
    for (pass, counts) in counts.iter_mut().enumerate() {
        let mut first = 0;
        for count in counts.iter_mut() {
            (*count, first) = (first, first + *count);
        }
        for &code in codes.iter() {
            let place = &mut counts[(code >> (32 + 10 * pass)) as usize & 1023];
            sorted[*place as usize] = code;
            *place += 1;
        }
        std::mem::swap(&mut codes, &mut sorted);
    }
    codes
}

/// For each number of ten bits, each bit moved to three times its place.
fn spread_table() -> [u32; 1024] {
    let spread = |v: u32| (0..10).fold(0, |sum, bit| sum | (v >> bit & 1) << (3 * bit));
    std::array::from_fn(|v| spread(v as u32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points(positions: &[(f64, f64, f64)]) -> LocalPoints {
        let positions: Vec<DVec3> = positions.iter().map(|&p| p.into()).collect();
        LocalPoints::new(&positions).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        /// What the bounds pass over touches nothing: judged in double precision by distance, a
        /// point is listed where it is well inside the contact distance and not where it is well
        /// outside.
        #[test]
        fn no_contact_is_passed_over(
            positions in prop::collection::vec((-1.0..1.0, -1.0..1.0, -1.0..1.0), 1..700),
            center in (-1.5..1.5, -1.5..1.5, -1.5..1.5),
            radius in 0.03f64..50.0,
            floor_m in 0.001f64..0.02,
            per_z2 in prop::sample::select(vec![0.0, 0.01]),
            widen in 1f32..4.0,
        ) {
            let points = points(&positions);
            let contact = ContactDistance { floor_m, per_z2 };
            let mut ordered = Ordered::default();
            ordered.fill(&points, &contact);
            // 50 m away the other side is out of reach
            let center = DVec3::from(center);
            let center = center + center.normalize_or(DVec3::X) * (radius - 0.5).max(0.0);
            let sphere = CloudSphere::from_center_radius(center, radius).unwrap();
            let mut near = BlockSet::default();
            ordered.list_near(&sphere, widen, &mut near);
            let mut places = Vec::new();
            near.list(&mut places);
            let mut listed = vec![false; points.len()];
            for &place in &places {
                listed[ordered.lanes.id[place as usize] as usize] = true;
            }
            for (i, &listed) in listed.iter().enumerate() {
                let p = points.at(i).as_dvec3();
                let tau = contact.at(p.z + points.origin.z);
                let reach = tau * f64::from(widen);
                // the band is told from the first order on for |curvature| reach < 1 only
                prop_assume!(reach < 0.5 * radius);
                let off = (p.distance(center) - radius).abs();
                if off < reach - 0.1 * tau {
                    prop_assert!(listed, "{off} m off, reach {reach} m");
                } else if off > reach + 0.1 * tau {
                    prop_assert!(!listed, "{off} m off, reach {reach} m");
                }
            }
        }

        #[test]
        fn every_point_once_and_neighbours_together(
            positions in prop::collection::vec((-1.0..1.0, -1.0..1.0, -1.0..1.0), 0..300),
        ) {
            let points = points(&positions);
            let order = morton_order(&points);
            let mut ids: Vec<u32> = order.iter().map(|&code| code as u32).collect();
            prop_assert!(order.iter().map(|code| code >> 32).is_sorted());
            ids.sort_unstable();
            prop_assert!(ids.into_iter().eq(0..positions.len() as u32));
        }
    }
}
