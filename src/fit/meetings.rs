//! Which surfaces of a frame meet: the edges along which the cold fit unites patches.
//!
//! Every atom meets the atoms and the spheres of the blocks around it. Spheres of which no block is
//! to be fitted are offered each other once in some frames; only those that meet somebody become
//! nodes of the graph.

use super::agglomerate::{Agglomeration, Patch};
use super::cold::{NONE, STRIDE};
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::Rays;

/// Neighbouring spheres are offered each other in one of so many frames.
const TURNS: u16 = 8;
const _: () = assert!(TURNS.is_power_of_two());

/// Blocks around a block.
const AROUND: [(isize, isize); 8] = [
    (1, 0),
    (0, 1),
    (1, 1),
    (-1, 1),
    (-1, 0),
    (0, -1),
    (-1, -1),
    (1, -1),
];

/// Marks an end of an edge as a slot; others are nodes of the graph.
const SLOT: u32 = 1 << 31;
/// A slot that meets somebody and has no node yet.
const WANTED: u32 = NONE - 1;
/// A block and the one to the right of it, of two spheres whose turn it is.
const RIGHT: u8 = 1;
/// The same with the block below.
const BELOW: u8 = 2;

/// What meets, and the buffers to find it.
#[derive(Debug, Default)]
pub(super) struct Meetings {
    /// The sphere that has most of each block, or `NO_SPHERE`.
    pub(super) leaders: Vec<u16>,
    /// Node of each slot; `NONE` where it takes no part.
    pub(super) node_of_slot: Vec<u32>,
    /// `RIGHT` and `BELOW` of a row of blocks.
    marks: Vec<u8>,
    edges: Vec<[u32; 2]>,
}

impl Meetings {
    /// Buffers for so many spheres; the others follow the size of the image.
    pub(super) fn with_room(spheres: usize) -> Self {
        Self {
            node_of_slot: Vec::with_capacity(spheres),
            ..Self::default()
        }
    }

    /// Finds the edges between the atoms (`of_block`) and, where it is a `turn`, the spheres already
    /// there, and adds both to the graph. False, and no edge, where time was up before.
    pub(super) fn connect(
        &mut self,
        rays: &Rays,
        of_block: &[[u32; 2]],
        slots: &[Option<Patch>],
        turn: Option<u32>,
        graph: &mut Agglomeration,
        time_is_up: &dyn Fn() -> bool,
    ) -> bool {
        self.edges.clear();
        self.node_of_slot.clear();
        let columns = rays.block_columns;
        for y in 0..rays.block_rows {
            if (y * columns) as u32 / (2 * STRIDE) != ((y + 1) * columns) as u32 / (2 * STRIDE)
                && time_is_up()
            {
                return false;
            }
            self.connect_row(rays, y, of_block, slots, turn, graph);
        }
        self.push_spheres(slots, graph);
        for ends in &self.edges {
            let [a, b] = ends.map(|end| match end & SLOT {
                0 => end,
                _ => self.node_of_slot[(end & !SLOT) as usize],
            });
            graph.touch(a, b);
        }
        true
    }

    /// The edges that begin in one row of blocks.
    fn connect_row(
        &mut self,
        rays: &Rays,
        y: usize,
        of_block: &[[u32; 2]],
        slots: &[Option<Patch>],
        turn: Option<u32>,
        graph: &Agglomeration,
    ) {
        let (columns, rows) = (rays.block_columns, rays.block_rows);
        let leaders = &self.leaders;
        self.marks.clear();
        self.marks.resize(columns, 0);
        if let Some(turn) = turn {
            let row = &leaders[y * columns..(y + 1) * columns];
            mark(
                row,
                row.get(1..).unwrap_or_default(),
                turn as u16,
                RIGHT,
                &mut self.marks,
            );
            if y + 1 < rows {
                let next = &leaders[(y + 1) * columns..(y + 2) * columns];
                mark(row, next, turn as u16, BELOW, &mut self.marks);
            }
        }
        let sphere = |k: usize| {
            let id = leaders[k];
            match slots.get(usize::from(id)) {
                Some(Some(patch)) if turn.is_some() && patch.moments.count >= 16.0 => {
                    SLOT | u32::from(id)
                }
                _ => NONE,
            }
        };
        // graph nodes of a block: its atoms, or the sphere that has most of it
        let nodes = |k: usize| match of_block[k] {
            [NONE, _] => [sphere(k), NONE],
            atoms => atoms.map(|n| if n == NONE { NONE } else { graph.root(n) }),
        };
        for (x, &marks) in self.marks.iter().enumerate() {
            let k = y * columns + x;
            if of_block[k][0] == NONE {
                if marks == 0 {
                    continue;
                }
                // two spheres that meet: some of them are offered each other now, others later
                for (mark, n) in [(RIGHT, k + 1), (BELOW, k + columns)] {
                    if marks & mark != 0 && of_block[n][0] == NONE {
                        let ends = [sphere(k), sphere(n)];
                        if !ends.contains(&NONE) {
                            self.edges.push(ends);
                        }
                    }
                }
                continue;
            }
            let own = nodes(k);
            for (dx, dy) in AROUND {
                let (nx, ny) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
                let n = ny.wrapping_mul(columns).wrapping_add(nx);
                // of two blocks with atoms the first one sees to it
                if nx >= columns || ny >= rows || (n < k && of_block[n][0] != NONE) {
                    continue;
                }
                for b in nodes(n) {
                    for a in own {
                        if a != b && a != NONE && b != NONE {
                            self.edges.push([a, b]);
                        }
                    }
                }
            }
        }
    }

    /// Makes nodes of the spheres that meet somebody, in the order of their slots.
    fn push_spheres(&mut self, slots: &[Option<Patch>], graph: &mut Agglomeration) {
        self.node_of_slot.resize(slots.len(), NONE);
        for &end in self.edges.as_flattened() {
            if end & SLOT != 0 {
                self.node_of_slot[(end & !SLOT) as usize] = WANTED;
            }
        }
        for (node, slot) in self.node_of_slot.iter_mut().zip(slots) {
            if let (WANTED, Some(patch)) = (*node, slot) {
                *node = graph.push(*patch);
            }
        }
    }
}

/// Adds `side` to the marks of blocks whose sphere is another than that of the block beyond, where
/// it is the turn of these two.
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn mark(row: &[u16], beyond: &[u16], turn: u16, side: u8, marks: &mut [u8]) {
    for ((marks, &a), &b) in marks.iter_mut().zip(row).zip(beyond) {
        let due = (a ^ b).wrapping_add(turn) & (TURNS - 1) == 0;
        let both = (a != b) & (a != NO_SPHERE) & (b != NO_SPHERE);
        *marks |= if due & both { side } else { 0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pair_is_marked_when_its_turn_comes() {
        let row: Vec<u16> = (0..40).map(|k| k * 7 % 23).collect();
        let beyond: Vec<u16> = (0..40)
            .map(|k| if k % 9 == 0 { NO_SPHERE } else { k % 23 })
            .collect();
        let mut met = [0; 40];
        for turn in 0..u32::from(TURNS) {
            let mut marks = [RIGHT; 40];
            // any later frame is the same turn again
            mark(&row, &beyond, (turn + 80_000) as u16, BELOW, &mut marks);
            for (k, &marks) in marks.iter().enumerate() {
                let (a, b) = (row[k], beyond[k]);
                let due = (u32::from(a ^ b) + turn).is_multiple_of(u32::from(TURNS));
                let both = a != b && b != NO_SPHERE;
                assert_eq!(marks, if due && both { RIGHT | BELOW } else { RIGHT });
                met[k] += u32::from(marks & BELOW != 0);
            }
        }
        for (k, &times) in met.iter().enumerate() {
            let pair = row[k] != beyond[k] && beyond[k] != NO_SPHERE;
            assert_eq!(times, u32::from(pair), "pair {k}");
        }
    }
}
