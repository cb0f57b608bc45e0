//! Which points each sphere covers, and the spheres that the others make superfluous.

use super::cloud::{CloudSphere, UNASSIGNED};
use super::point_moments::PointMoments;
use super::remaining::Remaining;

/// Shares of the way to the least-squares fit that are tried.
const SETTLE: [f64; 3] = [1.0, 0.5, 0.25];

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

/// A sphere of the cover as it was.
#[derive(Clone, Debug)]
pub(crate) struct Former {
    s: usize,
    sphere: CloudSphere,
    members: Vec<u32>,
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

    /// Drops the sphere with the fewest points of its own, again and again, while no more than
    /// `allowed` points stay uncovered. Greedy covering leaves such spheres: later ones cover
    /// what an early one was chosen for. O(sum of members + spheres²).
    pub fn prune(&mut self, allowed: usize) {
        let mut uncovered = self.covers.iter().filter(|&&c| c == 0).count();
        // the numbers of a point's spheres, xored: where there is one, that one
        let mut owner = vec![0u32; self.covers.len()];
        for (s, members) in self.members.iter().enumerate() {
            for &i in members {
                owner[i as usize] ^= s as u32;
            }
        }
        let mut own = vec![0usize; self.spheres.len()];
        for (&covers, &owner) in self.covers.iter().zip(&owner) {
            if covers == 1 {
                own[owner as usize] += 1;
            }
        }
        let mut left: Vec<u32> = (0..self.spheres.len() as u32).collect();
        while let Some(place) = (0..left.len()).min_by_key(|&k| own[left[k] as usize]) {
            let s = left[place];
            if uncovered + own[s as usize] > allowed {
                break;
            }
            uncovered += own[s as usize];
            left.remove(place);
            for i in std::mem::take(&mut self.members[s as usize]) {
                let i = i as usize;
                self.covers[i] -= 1;
                owner[i] ^= s;
                if self.covers[i] == 1 {
                    own[owner[i] as usize] += 1;
                }
            }
        }
        self.spheres = left.iter().map(|&s| self.spheres[s as usize]).collect();
        let members = left
            .iter()
            .map(|&s| std::mem::take(&mut self.members[s as usize]));
        self.members = members.collect();
    }

    /// Points that only sphere `s` covers, for each `s`.
    pub fn own_counts(&self) -> Vec<usize> {
        let own = |members: &Vec<u32>| {
            let alone = |&&i: &&u32| self.covers[i as usize] == 1;
            members.iter().filter(alone).count()
        };
        self.members.iter().map(own).collect()
    }

    /// The points that only sphere `s` covers, into `places`.
    pub fn own(&self, s: usize, places: &mut Vec<u32>) {
        places.clear();
        let alone = |i: &u32| self.covers[*i as usize] == 1;
        places.extend(self.members[s].iter().copied().filter(alone));
    }

    /// Takes the members of sphere `s` away. `open` gets the points that nobody covers then,
    /// as it has those nobody covered before.
    pub fn take(&mut self, s: usize, open: &mut Vec<u32>) -> Former {
        let none = Former {
            s,
            sphere: self.spheres[s],
            members: Vec::new(),
        };
        self.put(none, open)
    }

    /// Puts `sphere` in the place of sphere `s`; gives what was there. `open` as in
    /// [`Cover::take`].
    pub fn replace(
        &mut self,
        s: usize,
        sphere: CloudSphere,
        points: &Remaining,
        open: &mut Vec<u32>,
    ) -> Former {
        let mut members = Vec::new();
        points.list_touching(&sphere, &mut self.marks, &mut members);
        self.put(Former { s, sphere, members }, open)
    }

    /// The points that no sphere covers.
    pub fn uncovered(&self) -> Vec<u32> {
        let bare = (0u32..).zip(&self.covers).filter(|&(_, &c)| c == 0);
        bare.map(|(i, _)| i).collect()
    }

    fn put(&mut self, new: Former, open: &mut Vec<u32>) -> Former {
        for &i in &self.members[new.s] {
            self.covers[i as usize] -= 1;
        }
        for &i in &new.members {
            self.covers[i as usize] += 1;
        }
        let former = Former {
            s: new.s,
            sphere: std::mem::replace(&mut self.spheres[new.s], new.sphere),
            members: std::mem::replace(&mut self.members[new.s], new.members),
        };
        open.retain(|&i| self.covers[i as usize] == 0);
        // those that were open already are none of the former's
        let bare = |i: &u32| self.covers[*i as usize] == 0;
        open.extend(former.members.iter().copied().filter(bare));
        former
    }

    /// Takes the steps back, the last first.
    pub fn undo(&mut self, steps: Vec<Former>) {
        for step in steps.into_iter().rev() {
            self.put(step, &mut Vec::new());
        }
    }

    /// Forgets sphere `s`, which has no members.
    pub fn forget(&mut self, s: usize) {
        self.spheres.remove(s);
        self.members.remove(s);
    }

    /// Moves each sphere towards the least-squares fit of its members, as far as it keeps the
    /// points that only it covers: what was bent for more contacts need not lie at the rim of
    /// the contact band.
    pub fn settle(&mut self, points: &Remaining) {
        let mut alone = Remaining::default();
        let mut own = Vec::new();
        for s in 0..self.spheres.len() {
            let mut moments = PointMoments::default();
            for &i in &self.members[s] {
                moments.add(points.at(i as usize));
            }
            let Some(fit) = moments.fit() else { continue };
            self.own(s, &mut own);
            alone.pick(points, &own);
            let before = self.spheres[s];
            let settled = SETTLE
                .iter()
                .filter_map(|&share| {
                    before.towards(
                        &fit.sphere,
                        points.at(own.first().map_or(0, |&i| i as usize)),
                        share,
                    )
                })
                .find(|sphere| points.resolves(sphere) && alone.touching(sphere) == own.len());
            if let Some(sphere) = settled {
                self.replace(s, sphere, points, &mut Vec::new());
            }
        }
    }

    /// Gives every covered point to the nearest of its spheres: `assignment[id]`, by number in
    /// `spheres`.
    pub fn assign(&self, points: &Remaining, assignment: &mut [u32]) {
        let mut nearest = vec![f64::INFINITY; self.covers.len()];
        for (s, (sphere, members)) in self.spheres.iter().zip(&self.members).enumerate() {
            for &i in members {
                let i = i as usize;
                let place = &mut assignment[points.id[i] as usize];
                if self.covers[i] == 1 {
                    *place = s as u32;
                    continue;
                }
                // to first order: the points are within contact distance
                let distance = sphere.value(points.at(i)).abs();
                if distance < nearest[i] {
                    nearest[i] = distance;
                    *place = s as u32;
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
