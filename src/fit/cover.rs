//! Which points each sphere covers, and the spheres that the others make superfluous.

use super::cloud::{CloudSphere, UNASSIGNED};
use super::remaining::Remaining;

/// Spheres over a fixed set of points. A point may be covered by several.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cover {
    pub spheres: Vec<CloudSphere>,
    /// Places of the points each sphere covers, ascending.
    members: Vec<Vec<u32>>,
    /// How many spheres cover each point.
    covers: Vec<u32>,
    marks: Vec<u8>,
}

impl Cover {
    /// The cover of `points` by `spheres`.
    pub fn new(points: &Remaining, spheres: &[CloudSphere]) -> Self {
        let mut cover = Self {
            covers: vec![0; points.len()],
            ..Self::default()
        };
        for sphere in spheres {
            let mut members = Vec::new();
            points.list_touching(sphere, &mut cover.marks, &mut members);
            for &i in &members {
                cover.covers[i as usize] += 1;
            }
            cover.spheres.push(*sphere);
            cover.members.push(members);
        }
        cover
    }

    /// Points that only sphere `s` covers.
    fn exclusive(&self, s: usize) -> usize {
        let alone = |&&i: &&u32| self.covers[i as usize] == 1;
        self.members[s].iter().filter(alone).count()
    }

    /// Drops the sphere with the fewest points of its own, again and again, while no more than
    /// `allowed` points stay uncovered. Greedy covering leaves such spheres: later ones cover
    /// what an early one was chosen for.
    pub fn prune(&mut self, allowed: usize) {
        let mut uncovered = self.covers.iter().filter(|&&c| c == 0).count();
        while let Some((own, s)) = (0..self.spheres.len())
            .map(|s| (self.exclusive(s), s))
            .min()
        {
            if uncovered + own > allowed {
                break;
            }
            uncovered += own;
            for i in self.members.remove(s) {
                self.covers[i as usize] -= 1;
            }
            self.spheres.remove(s);
        }
    }

    /// Gives every covered point to the nearest of its spheres: `assignment[id]`, by number in
    /// `spheres`.
    pub fn assign(&self, points: &Remaining, assignment: &mut [u32]) {
        let mut nearest = vec![f64::INFINITY; self.covers.len()];
        for (s, (sphere, members)) in self.spheres.iter().zip(&self.members).enumerate() {
            for &i in members {
                let i = i as usize;
                // to first order: the points are within contact distance
                let distance = sphere.value(points.at(i)).abs();
                if distance < nearest[i] {
                    nearest[i] = distance;
                    assignment[points.id[i] as usize] = s as u32;
                }
            }
        }
        debug_assert!(
            self.covers
                .iter()
                .zip(&points.id)
                .all(|(&c, &id)| { (c == 0) == (assignment[id as usize] == UNASSIGNED) })
        );
    }
}
