//! Points gathered cell by cell: a counting sort over the cells that are in use.

use super::lattice::{Lattice, cell_key, key_cell};
use super::points::LocalPoints;
use glam::DVec3;
use rayon::prelude::*;

/// The points of a cloud in cell order.
///
/// Cell `c` holds the points `order[starts[c] .. starts[c + 1]]`, in ascending order; cells
/// ascend by z, then y, then x of their lattice index. The result is a function of the points
/// and the lattice alone: no hash map, no thread order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cells {
    /// Point numbers, cell by cell.
    pub order: Vec<u32>,
    /// First place in `order` of every cell, and the number of points at the end.
    pub starts: Vec<u32>,
    /// Centre of every cell, metres about the local origin.
    pub centers: Vec<DVec3>,
    /// Sort key of every point, then of every cell: kept for the next call.
    keys: Vec<u64>,
    used: Vec<u64>,
    cursors: Vec<u32>,
}

impl Cells {
    /// Cells of `points` on `lattice`.
    #[must_use]
    pub fn new(points: &LocalPoints, lattice: &Lattice) -> Self {
        let mut cells = Self::default();
        cells.refill(points, lattice);
        cells
    }

    /// As [`Cells::new`], into buffers that are kept. O(n) to place the points, O(u log u) to
    /// sort the u runs of points that follow each other in one cell.
    pub fn refill(&mut self, points: &LocalPoints, lattice: &Lattice) {
        let n = points.len();
        self.keys.resize(n, 0);
        self.keys
            .par_iter_mut()
            .with_min_len(4096)
            .enumerate()
            .for_each(|(i, key)| *key = cell_key(lattice.nearest(points.at(i))));

        // Neighbours in a scan mostly share their cell: sort one key per run, not per point.
        self.used.clear();
        for &key in &self.keys {
            if self.used.last() != Some(&key) {
                self.used.push(key);
            }
        }
        self.used.par_sort_unstable();
        self.used.dedup();

        self.starts.clear();
        self.starts.resize(self.used.len() + 1, 0);
        let mut cell = CellOfKey::default();
        for &key in &self.keys {
            self.starts[cell.find(&self.used, key) + 1] += 1;
        }
        for c in 1..self.starts.len() {
            self.starts[c] += self.starts[c - 1];
        }
        self.cursors.clear();
        self.cursors.extend_from_slice(&self.starts);
        self.order.resize(n, 0);
        for (i, &key) in self.keys.iter().enumerate() {
            let cursor = &mut self.cursors[cell.find(&self.used, key)];
            self.order[*cursor as usize] = i as u32;
            *cursor += 1;
        }
        self.centers.clear();
        self.centers
            .extend(self.used.iter().map(|&key| lattice.center(key_cell(key))));
    }

    /// Cells in use.
    #[must_use]
    pub fn len(&self) -> usize {
        self.centers.len()
    }

    /// True where there is no cell: no points.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.centers.is_empty()
    }

    /// Numbers of the points in `cell`, ascending. `cell` must be below [`Cells::len`].
    #[must_use]
    pub fn points(&self, cell: usize) -> &[u32] {
        &self.order[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }
}

/// Place of a key among the sorted keys; remembers the last answer, which mostly holds again.
#[derive(Default)]
struct CellOfKey {
    last: usize,
}

impl CellOfKey {
    fn find(&mut self, used: &[u64], key: u64) -> usize {
        if used.get(self.last) != Some(&key) {
            self.last = used.partition_point(|&k| k < key);
        }
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::partition::lattice::Packing;
    use proptest::prelude::*;

    fn cloud(seeds: &[(f64, f64, f64)]) -> LocalPoints {
        let positions: Vec<DVec3> = seeds.iter().map(|&(x, y, z)| DVec3::new(x, y, z)).collect();
        LocalPoints::new(&positions).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn every_point_is_in_exactly_one_cell_the_nearest(
            seeds in proptest::collection::vec((-2f64..2.0, -2f64..2.0, -2f64..2.0), 0..300),
            cubic in any::<bool>(),
        ) {
            let points = cloud(&seeds);
            let kind = if cubic { Packing::Cubic } else { Packing::Hexagonal };
            let lattice = Lattice::new(kind, 0.5);
            let cells = Cells::new(&points, &lattice);
            let mut seen = vec![0; points.len()];
            for c in 0..cells.len() {
                let own = cells.points(c);
                prop_assert!(!own.is_empty());
                prop_assert!(own.windows(2).all(|w| w[0] < w[1]), "order is stable");
                for &i in own {
                    seen[i as usize] += 1;
                    let center = lattice.center(lattice.nearest(points.at(i as usize)));
                    prop_assert_eq!(center, cells.centers[c]);
                }
            }
            prop_assert!(seen.iter().all(|&n| n == 1));
        }
    }

    #[test]
    fn reused_buffers_and_threads_change_nothing() {
        let seeds: Vec<_> = (0..20_000)
            .map(|i| {
                let t = f64::from(i) * 0.618;
                (t.sin() * 2.0, (t * 1.7).cos(), (t * 0.3).sin())
            })
            .collect();
        let points = cloud(&seeds);
        let lattice = Lattice::new(Packing::Hexagonal, 0.1);
        let fresh = Cells::new(&points, &lattice);
        let mut reused = Cells::new(&cloud(&seeds[..777]), &Lattice::new(Packing::Cubic, 1.0));
        let one = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        one.install(|| reused.refill(&points, &lattice));
        assert_eq!(
            (&fresh.order, &fresh.starts, &fresh.centers),
            (&reused.order, &reused.starts, &reused.centers)
        );
    }

    #[test]
    fn no_points_no_cells() {
        let cells = Cells::new(&cloud(&[]), &Lattice::new(Packing::Hexagonal, 0.1));
        assert!(cells.is_empty());
        assert_eq!(cells.starts, [0]);
    }
}
