//! Cold fit: spheres where the last frame's do not hold (a first frame, a new object, a cut).
//!
//! Atoms are blocks whose pixels lie on one surface, or the near and the far part of a block that
//! a jump edge divides. They are gathered by hex-packed cell (paper 3.2, 4.1) and united inside
//! their cells, largest unexplained cells first, then across cells together with the spheres
//! already there ([`agglomerate`](super::agglomerate)).

use super::agglomerate::{Agglomeration, Patch};
use super::contact_distance::ContactDistance;
use super::live::{Block, FitReport, MIN_BLOCK_PIXELS, weight};
use super::moments::{self, Moments};
use crate::contact_map::assign::Candidates;
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::{BLOCK, Rays};
use crate::partition::lattice::{CellIndex, Lattice};
use glam::Vec3;

/// An atom's own surface may be this far off (mean square, contact distances).
const ATOM_MISFIT: f64 = 0.3;
/// Bits a point costs without any sphere: a rougher atom is one where that is dearer.
const FALLBACK_BITS: f64 = 3.0;
/// Fewest points of an atom.
const ATOM_POINTS: u32 = 8;
/// Fewest points for which a new sphere is worth its bits.
const SPHERE_POINTS: f64 = 10.0;

/// What the cold fit reads.
pub(super) struct Problem<'a> {
    pub rays: &'a Rays,
    pub plane: &'a [u16],
    pub lattice: &'a Lattice,
    pub distance: &'a ContactDistance,
    pub max_spheres: usize,
}

/// An atom: which block, which of its pixels, which cell.
#[derive(Clone, Copy, Debug)]
struct Atom {
    block: u32,
    cell: CellIndex,
}

/// Buffers of the cold fit.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    atoms: Vec<Atom>,
    of_block: Vec<[u32; 2]>,
    slot_of_root: Vec<u16>,
    node_of_slot: Vec<u32>,
    roots: Vec<u32>,
    pub(super) pending: Vec<bool>,
    pub(super) candidates: Vec<Candidates>,
}

impl Workspace {
    /// Buffers for so many spheres; the others follow the size of the image.
    pub(super) fn with_room(spheres: usize) -> Self {
        Self {
            node_of_slot: Vec::with_capacity(spheres),
            ..Self::default()
        }
    }
}

const NONE: u32 = u32::MAX;

/// Fits the blocks without a sphere. Sets `Block::sphere` of every block that got one.
pub(super) fn blocks(
    problem: &Problem<'_>,
    blocks: &mut [Block],
    slots: &mut Vec<Option<Patch>>,
    graph: &mut Agglomeration,
    work: &mut Workspace,
    time_is_up: &dyn Fn() -> bool,
    report: &mut FitReport,
) {
    begin(blocks.len(), graph, work);
    for (k, block) in blocks.iter().enumerate() {
        if block.sphere == NO_SPHERE && block.valid.count_ones() >= MIN_BLOCK_PIXELS {
            report.cold_pixels += block.valid.count_ones();
            atoms_of(problem, k, block.valid, Some(&block.moments), graph, work);
        }
    }
    if work.atoms.is_empty() {
        return;
    }
    connect(problem.rays, blocks, slots, graph, work);
    settle(problem, blocks, slots, graph, work, time_is_up, report);
}

/// Fits the pixels that touch nothing yet. False where there is nothing worth fitting. Marks in
/// `work.pending` the blocks that a new sphere may concern.
pub(super) fn missing(
    problem: &Problem<'_>,
    blocks: &mut [Block],
    slots: &mut Vec<Option<Patch>>,
    graph: &mut Agglomeration,
    work: &mut Workspace,
    time_is_up: &dyn Fn() -> bool,
    report: &mut FitReport,
) -> bool {
    begin(blocks.len(), graph, work);
    for (k, block) in blocks.iter().enumerate() {
        if block.contacts.missing.count_ones() >= ATOM_POINTS {
            report.cold_pixels += block.contacts.missing.count_ones();
            atoms_of(problem, k, block.contacts.missing, None, graph, work);
        }
    }
    if work.atoms.is_empty() {
        return false;
    }
    for block in blocks.iter_mut() {
        block.sphere = NO_SPHERE;
    }
    connect(problem.rays, blocks, &[], graph, work);
    settle(problem, blocks, slots, graph, work, time_is_up, report);
    // a new sphere reaches into the blocks around its own
    let (columns, rows) = (problem.rays.block_columns, problem.rays.block_rows);
    work.pending.clear();
    work.pending.resize(blocks.len(), false);
    for k in 0..blocks.len() {
        if blocks[k].sphere != NO_SPHERE {
            let (x, y) = (k % columns, k / columns);
            for ny in y.saturating_sub(1)..(y + 2).min(rows) {
                for nx in x.saturating_sub(1)..(x + 2).min(columns) {
                    let n = ny * columns + nx;
                    work.pending[n] |= blocks[n].contacts.missing != 0;
                }
            }
        }
    }
    true
}

fn begin(blocks: usize, graph: &mut Agglomeration, work: &mut Workspace) {
    graph.clear();
    work.atoms.clear();
    work.of_block.clear();
    work.of_block.resize(blocks, [NONE; 2]);
}

/// Makes the atoms of one block: one where its pixels lie on one surface, else the near and the
/// far part, each where it does.
fn atoms_of(
    problem: &Problem<'_>,
    k: usize,
    pixels: u64,
    whole: Option<&Moments>,
    graph: &mut Agglomeration,
    work: &mut Workspace,
) {
    let columns = problem.rays.block_columns;
    let at = (k % columns, k / columns);
    let sums = |keep: u64| {
        moments::of_block(problem.plane, problem.rays, at, keep, |z| {
            weight(problem.distance, z)
        })
    };
    let mut push = |m: Moments, graph: &mut Agglomeration| -> bool {
        let Some(patch) = Patch::new(m) else {
            return false;
        };
        if patch.fit.misfit > ATOM_MISFIT && patch.bits > FALLBACK_BITS * patch.moments.count {
            return false;
        }
        let (w, u, v) = m.mean();
        let p = Vec3::new((u / w) as f32, (v / w) as f32, (1.0 / w) as f32);
        let node = graph.push(patch);
        work.atoms.push(Atom {
            block: k as u32,
            cell: problem.lattice.nearest(p),
        });
        let entry = &mut work.of_block[k];
        entry[usize::from(entry[0] != NONE)] = node;
        true
    };
    let all = whole.copied().unwrap_or_else(|| sums(pixels));
    if push(all, graph) {
        return;
    }
    let (near, far) = divide(problem, at, pixels);
    for part in [near, far] {
        if part.count_ones() >= ATOM_POINTS {
            push(sums(part), graph);
        }
    }
}

/// The pixels nearer and farther than the middle of the block's range of inverse depth.
fn divide(problem: &Problem<'_>, at: (usize, usize), pixels: u64) -> (u64, u64) {
    let stride = problem.rays.stride();
    let raw = |bit: u32| {
        problem.plane[(at.1 * BLOCK + bit as usize / 8) * stride + at.0 * BLOCK + bit as usize % 8]
    };
    let each = |mut bits: u64| {
        std::iter::from_fn(move || {
            let bit = (bits != 0).then(|| bits.trailing_zeros())?;
            bits &= bits - 1;
            Some(bit)
        })
    };
    let (low, high) = each(pixels).fold((u16::MAX, 1), |(l, h), b| (l.min(raw(b)), h.max(raw(b))));
    // the middle in inverse depth is the harmonic mean
    let middle = 2.0 / (1.0 / f32::from(low) + 1.0 / f32::from(high));
    let near = each(pixels)
        .filter(|&b| f32::from(raw(b)) < middle)
        .fold(0u64, |m, b| m | 1 << b);
    (near, pixels & !near)
}

/// Edges between atoms of neighbouring blocks, and nodes for the spheres already there.
fn connect(
    rays: &Rays,
    blocks: &[Block],
    slots: &[Option<Patch>],
    graph: &mut Agglomeration,
    work: &mut Workspace,
) {
    let (columns, rows) = (rays.block_columns, rays.block_rows);
    work.node_of_slot.clear();
    for slot in slots {
        work.node_of_slot.push(match slot {
            Some(patch) if patch.moments.count >= 16.0 => graph.push(*patch),
            _ => NONE,
        });
    }
    for k in 0..blocks.len() {
        let own = nodes(k, blocks, work);
        if own[0] == NONE {
            continue;
        }
        let (x, y) = (k % columns, k / columns);
        let ahead = [
            (x + 1 < columns, k + 1),
            (y + 1 < rows, k + columns),
            (x + 1 < columns && y + 1 < rows, k + columns + 1),
            (x > 0 && y + 1 < rows, k + columns - usize::from(x > 0)),
        ];
        for (there, n) in ahead {
            if !there {
                continue;
            }
            for a in own {
                for b in nodes(n, blocks, work) {
                    if a != NONE && b != NONE {
                        graph.touch(a, b);
                    }
                }
            }
        }
    }
}

/// Graph nodes of a block: its atoms, or the sphere that holds it.
fn nodes(k: usize, blocks: &[Block], work: &Workspace) -> [u32; 2] {
    let atoms = work.of_block[k];
    if atoms[0] != NONE {
        return atoms;
    }
    [
        work.node_of_slot
            .get(usize::from(blocks[k].sphere))
            .copied()
            .unwrap_or(NONE),
        NONE,
    ]
}

/// Unites atoms, gives the unions to slots and the blocks their spheres.
fn settle(
    problem: &Problem<'_>,
    blocks: &mut [Block],
    slots: &mut Vec<Option<Patch>>,
    graph: &mut Agglomeration,
    work: &mut Workspace,
    time_is_up: &dyn Fn() -> bool,
    report: &mut FitReport,
) {
    let atoms = &work.atoms;
    let cell = |k: u32| atoms.get(k as usize).map(|a| a.cell);
    graph.run(|a, b| cell(a).is_some() && cell(a) == cell(b), time_is_up);
    graph.run(|_, _| true, time_is_up);
    report.degraded |= time_is_up();

    work.slot_of_root.clear();
    work.slot_of_root.resize(graph.len(), NO_SPHERE);
    // spheres already there: of those united the one with most points keeps its number
    for (slot, &node) in work.node_of_slot.iter().enumerate() {
        if node == NONE {
            continue;
        }
        let root = graph.root(node) as usize;
        let holder = work.slot_of_root[root];
        let count = |s: usize| slots[s].as_ref().map_or(0.0, |p| p.moments.count);
        if holder == NO_SPHERE || count(slot) > count(usize::from(holder)) {
            work.slot_of_root[root] = slot as u16;
        }
    }
    for (slot, &node) in work.node_of_slot.iter().enumerate() {
        if node == NONE {
            continue;
        }
        let root = graph.root(node);
        if usize::from(work.slot_of_root[root as usize]) != slot {
            slots[slot] = None;
        } else if graph.patch(root).moments.count
            > slots[slot].as_ref().map_or(0.0, |p| p.moments.count)
        {
            slots[slot] = Some(*graph.patch(root));
            report.refitted += 1;
        }
    }
    // unions of atoms alone: new spheres, largest first
    work.roots.clear();
    for k in 0..work.atoms.len() as u32 {
        let root = graph.root(k);
        if root == k
            && work.slot_of_root[root as usize] == NO_SPHERE
            && graph.patch(root).moments.count >= SPHERE_POINTS
        {
            work.roots.push(root);
        }
    }
    let count = |r: u32| graph.patch(r).moments.count;
    work.roots
        .sort_unstable_by(|&a, &b| count(b).total_cmp(&count(a)).then(a.cmp(&b)));
    let limit = problem.max_spheres.min(usize::from(NO_SPHERE));
    let room = limit.saturating_sub(slots.iter().flatten().count());
    work.roots.truncate(room);
    work.roots.sort_unstable();
    let mut free = 0;
    for &root in &work.roots {
        while free < slots.len() && slots[free].is_some() {
            free += 1;
        }
        if free == slots.len() {
            slots.push(None);
        }
        slots[free] = Some(*graph.patch(root));
        work.slot_of_root[root as usize] = free as u16;
        report.new += 1;
    }
    for (k, atom) in work.atoms.iter().enumerate() {
        let id = work.slot_of_root[graph.root(k as u32) as usize];
        let block = &mut blocks[atom.block as usize];
        if block.sphere == NO_SPHERE {
            block.sphere = id;
        }
    }
}
