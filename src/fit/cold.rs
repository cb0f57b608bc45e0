//! Cold fit: spheres where none touches (a first frame, a new object, a cut).
//!
//! Atoms are the untouched pixels of a block where they lie on one surface, or their near and far
//! part where a jump edge divides them. Four atoms that form a square and lie on one surface are
//! one at once, and four such squares again (as a quadtree is built). The rest is gathered by
//! hex-packed cell (paper 3.2, 4.1) and united inside cells, then across cells together with the
//! spheres already there ([`agglomerate`](super::agglomerate)).

use super::agglomerate::{Agglomeration, Patch};
use super::contact_distance::ContactDistance;
use super::live::{Blocks, FitReport, weight};
use super::meetings::Meetings;
use super::moments::{self, Moments, SPHERE_BITS, bits_per_point};
use crate::contact_map::assign::BlockContacts;
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::{BLOCK, Rays};
use crate::partition::lattice::{CellIndex, Lattice};
use glam::Vec3;

/// An atom's own surface may be this far off (mean square, contact distances).
const ATOM_MISFIT: f64 = 0.3;
/// Bits a point costs without any sphere: a rougher atom is one where that is dearer.
const FALLBACK_BITS: f64 = 5.0;
/// Fewest points of an atom.
const ATOM_POINTS: u32 = 8;
/// Fewest points for which a new sphere is worth its bits.
const SPHERE_POINTS: f64 = 25.0;
/// The same where spheres of the last frame share most blocks out: what is smaller comes again in
/// the next round if it is still left over.
const FIRST_POINTS: f64 = 40.0;
/// The same where time was up before all were united: coding many small ones takes longer than it
/// saves.
const HASTY_POINTS: f64 = 100.0;
/// Blocks looked at between two looks at the clock.
pub(super) const STRIDE: u32 = 256;
/// Fewest points beyond reach along the ray for which a surface they touch is not enough.
const ROUGH_POINTS: u32 = 20;
/// Bits each of four atoms may lose when a square of them becomes one.
const SQUARE_BITS: f64 = 6.0;
/// Blocks along the side of the largest square.
const SQUARE: usize = 8;
/// What the cold fit reads.
pub(super) struct Problem<'a> {
    pub rays: &'a Rays,
    pub plane: &'a [u16],
    pub lattice: &'a Lattice,
    pub distance: &'a ContactDistance,
    pub max_spheres: usize,
    /// Number of the frame, where the spheres already there take part.
    pub turn: Option<u32>,
    /// True where the last frame's spheres have been tried.
    pub warm: bool,
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
    /// Blocks with enough untouched pixels for an atom.
    open: Vec<u32>,
    meetings: Meetings,
    roots: Vec<u32>,
    /// Blocks at whose corner a square of one surface begins.
    square: Vec<bool>,
    /// Atoms that are part of another's union, and its slot.
    given: Vec<(u32, u16)>,
    /// Block at which the search for atoms was broken off.
    resume: usize,
    /// Most blocks to look at, as many as there was time for lately.
    most: u32,
    /// Slots of spheres that are new or other surfaces than before the last call.
    pub(super) fresh: Vec<bool>,
    /// For each slot that was here before: the slot that has its points now, and is another surface.
    heir: Vec<u16>,
}

impl Workspace {
    /// Buffers for so many spheres; the others follow the size of the image.
    pub(super) fn with_room(spheres: usize) -> Self {
        Self {
            meetings: Meetings::with_room(spheres),
            heir: Vec::with_capacity(spheres),
            fresh: Vec::with_capacity(spheres),
            most: u32::MAX,
            ..Self::default()
        }
    }

    /// Forgets what earlier frames left undone.
    pub(super) fn restart(&mut self) {
        (self.resume, self.most) = (0, u32::MAX);
    }
}

/// No node.
pub(super) const NONE: u32 = u32::MAX;

/// Fits the pixels that touch nothing. Sets `Blocks::spheres` of the blocks concerned and marks in
/// `pending` those that must go through contact again. False where there is nothing to fit.
#[allow(clippy::too_many_arguments)] // the modeler's buffers, borrowed apart
pub(super) fn fit(
    problem: &Problem<'_>,
    blocks: &mut Blocks,
    slots: &mut Vec<Option<Patch>>,
    graph: &mut Agglomeration,
    work: &mut Workspace,
    pending: &mut [bool],
    time_is_up: &dyn Fn() -> bool,
    report: &mut FitReport,
) -> bool {
    begin(blocks.len(), graph, work);
    let (looked, all) = gather(problem, blocks, graph, work, time_is_up, report);
    report.degraded |= !all;
    if work.atoms.is_empty() {
        return false;
    }
    squares(problem.rays, graph, work);
    let connected = work.meetings.connect(
        problem.rays,
        &work.of_block,
        slots,
        problem.turn,
        graph,
        time_is_up,
    );
    let united = connected && unite(graph, work, time_is_up);
    // atoms that are not united are worth little: the next frame takes on what there is time for
    work.most = if united && !time_is_up() {
        work.most.saturating_mul(2).max(looked)
    } else {
        (looked / 2).max(STRIDE)
    };
    report.degraded |= !united;
    settle(problem, blocks, slots, graph, work, united, report);
    mark(problem.rays, blocks, work, pending);
    true
}

/// Makes the atoms: first of whole blocks, whose moments are there already and which explain most
/// points for the time, then of parts of blocks. Where time is up the search ends and goes on from
/// there in the next frame; some blocks are always looked at, so that every frame gets on. Returns
/// how many were, and whether these were all.
fn gather(
    problem: &Problem<'_>,
    blocks: &Blocks,
    graph: &mut Agglomeration,
    work: &mut Workspace,
    time_is_up: &dyn Fn() -> bool,
    report: &mut FitReport,
) -> (u32, bool) {
    let count = blocks.len();
    let begin = std::mem::take(&mut work.resume) % count.max(1);
    list_open(&blocks.contacts, &mut work.open, &mut work.meetings.leaders);
    let middle = work.open.partition_point(|&k| (k as usize) < begin);
    work.open.rotate_left(middle);
    let mut looked = 0u32;
    for whole_blocks in [true, false] {
        for entry in 0..work.open.len() {
            let k = work.open[entry] as usize;
            let missing = untouched(&blocks.contacts[k]);
            let whole = missing == blocks.valid[k] && blocks.moments[k].count > 0.0;
            let done = work.of_block[k][0] != NONE;
            if done || (whole_blocks && !whole) {
                continue;
            }
            looked += 1;
            if looked > work.most || (looked.is_multiple_of(STRIDE) && time_is_up()) {
                work.resume = k;
                return (looked, false);
            }
            if whole_blocks {
                report.cold_pixels += missing.count_ones();
                push_atom(problem, k, blocks.moments[k], graph, work);
                continue;
            }
            if !whole {
                report.cold_pixels += missing.count_ones();
            }
            atoms_of(problem, k, missing, whole, graph, work);
        }
    }
    (looked, true)
}

/// Lists the blocks with enough untouched pixels for an atom, and the sphere that has most of each.
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2+bmi1+popcnt"))]
fn list_open(contacts: &[BlockContacts], open: &mut Vec<u32>, leaders: &mut Vec<u16>) {
    open.clear();
    open.resize(contacts.len(), 0);
    leaders.resize(contacts.len(), NO_SPHERE);
    let mut found = 0;
    for (k, (contacts, leader)) in contacts.iter().zip(leaders).enumerate() {
        *leader = contacts.palette[0];
        // no branch: one block in some is open
        open[found] = k as u32;
        found += usize::from(untouched(contacts).count_ones() >= ATOM_POINTS);
    }
    open.truncate(found);
}

/// Pixels of a block that are to be fitted.
#[inline(always)]
fn untouched(contacts: &BlockContacts) -> u64 {
    if contacts.rough.count_ones() >= ROUGH_POINTS {
        // a surface that is off along the ray costs residuals: where many, it is fitted anew
        contacts.rough
    } else {
        contacts.missing
    }
}

/// Marks the blocks that a new sphere or a change of one may concern.
fn mark(rays: &Rays, blocks: &mut Blocks, work: &Workspace, pending: &mut [bool]) {
    let (columns, rows) = (rays.block_columns, rays.block_rows);
    pending.fill(false);
    if work.heir.iter().any(|&h| h != NO_SPHERE) {
        for (k, contacts) in blocks.contacts.iter().enumerate() {
            for &id in contacts.palette.iter().take_while(|&&id| id != NO_SPHERE) {
                let heir = work.heir.get(usize::from(id)).copied();
                if let Some(heir) = heir.filter(|h| *h != NO_SPHERE) {
                    blocks.spheres[k] = [heir, NO_SPHERE];
                    pending[k] = true;
                }
            }
        }
    }
    // a new sphere reaches into the blocks around its own
    for (node, atom) in work.atoms.iter().enumerate() {
        if work.slot_of_root[node] == NO_SPHERE {
            continue;
        }
        let k = atom.block as usize;
        let (x, y) = (k % columns, k / columns);
        for ny in y.saturating_sub(1)..(y + 2).min(rows) {
            for nx in x.saturating_sub(1)..(x + 2).min(columns) {
                let n = ny * columns + nx;
                pending[n] |= n == k || blocks.contacts[n].rough.count_ones() >= ATOM_POINTS;
            }
        }
    }
}

fn begin(blocks: usize, graph: &mut Agglomeration, work: &mut Workspace) {
    graph.clear();
    work.atoms.clear();
    work.of_block.clear();
    work.of_block.resize(blocks, [NONE; 2]);
}

/// Makes the atoms of a part of a block: one where its pixels lie on one surface, else the near and
/// the far part, each where it does. A `whole` block has been tried as one.
fn atoms_of(
    problem: &Problem<'_>,
    k: usize,
    pixels: u64,
    whole: bool,
    graph: &mut Agglomeration,
    work: &mut Workspace,
) {
    let columns = problem.rays.block_columns;
    let at = (k % columns, k / columns);
    let sums = |keep: u64| sums_of(problem.plane, problem.rays, at, keep, problem.distance);
    if !whole && push_atom(problem, k, sums(pixels), graph, work) {
        return;
    }
    let (near, far) = divide(problem, at, pixels);
    for part in [near, far] {
        if part.count_ones() >= ATOM_POINTS {
            push_atom(problem, k, sums(part), graph, work);
        }
    }
}

/// Makes these points of block `k` an atom where they lie on one surface.
fn push_atom(
    problem: &Problem<'_>,
    k: usize,
    moments: Moments,
    graph: &mut Agglomeration,
    work: &mut Workspace,
) -> bool {
    let Some(patch) = Patch::new(moments) else {
        return false;
    };
    if patch.fit.misfit > ATOM_MISFIT && patch.bits > FALLBACK_BITS * patch.moments.count {
        return false;
    }
    let (w, u, v) = moments.mean();
    let p = Vec3::new((u / w) as f32, (v / w) as f32, (1.0 / w) as f32);
    let node = graph.push(patch);
    work.atoms.push(Atom {
        block: k as u32,
        cell: problem.lattice.nearest(p),
    });
    let entry = &mut work.of_block[k];
    entry[usize::from(entry[0] != NONE)] = node;
    true
}

/// Moments of the pixels of `keep`.
#[allow(unsafe_code)] // run-time dispatch generated by the macro
#[multiversion::multiversion(targets("x86_64+avx2+bmi1+popcnt"))]
fn sums_of(
    plane: &[u16],
    rays: &Rays,
    at: (usize, usize),
    keep: u64,
    distance: &ContactDistance,
) -> Moments {
    moments::of_block((plane, 0), rays, at, keep, |z| weight(distance, z))
}

/// The pixels nearer and farther than the middle of the block's range of inverse depth.
fn divide(problem: &Problem<'_>, at: (usize, usize), pixels: u64) -> (u64, u64) {
    let stride = problem.rays.stride();
    let row = |j: usize| &problem.plane[(at.1 * BLOCK + j) * stride + at.0 * BLOCK..][..BLOCK];
    let (mut low, mut high) = (u16::MAX, 1);
    for j in 0..BLOCK {
        let bits = pixels >> (8 * j);
        for (i, &raw) in row(j).iter().enumerate() {
            let on = bits >> i & 1 != 0;
            low = low.min(if on { raw } else { u16::MAX });
            high = high.max(if on { raw } else { 1 });
        }
    }
    // the middle in inverse depth is the harmonic mean
    let middle = 2.0 / (1.0 / f32::from(low) + 1.0 / f32::from(high));
    let mut near = 0u64;
    for j in 0..BLOCK {
        for (i, &raw) in row(j).iter().enumerate() {
            near |= u64::from(f32::from(raw) < middle) << (8 * j + i);
        }
    }
    (near & pixels, pixels & !near)
}

/// Unites squares of 2×2 atoms on one surface, then 2×2 such squares, up to `SQUARE` blocks wide.
fn squares(rays: &Rays, graph: &mut Agglomeration, work: &mut Workspace) {
    let (columns, rows) = (rays.block_columns, rays.block_rows);
    work.square.clear();
    work.square
        .extend(work.of_block.iter().map(|a| a[0] != NONE && a[1] == NONE));
    let mut half = 1;
    while 2 * half <= SQUARE {
        for y in (0..rows).step_by(2 * half) {
            for x in (0..columns).step_by(2 * half) {
                let k = y * columns + x;
                let inside = x + half < columns && y + half < rows;
                let corners = [k, k + half, k + half * columns, k + half * (columns + 1)];
                let all = inside && corners.iter().all(|&c| work.square[c]);
                work.square[k] = all && {
                    let nodes = corners.map(|c| graph.root(work.of_block[c][0]));
                    unite_square(nodes, graph)
                };
            }
        }
        half *= 2;
    }
}

/// Makes four patches one where each of them is on its surface as well as on its own.
fn unite_square(nodes: [u32; 4], graph: &mut Agglomeration) -> bool {
    let mut moments = graph.patch(nodes[0]).moments;
    for &n in &nodes[1..] {
        moments.add(&graph.patch(n).moments);
    }
    let Some(fit) = moments.fit() else {
        return false;
    };
    let mut bits = SPHERE_BITS;
    for &n in &nodes {
        let own = graph.patch(n);
        let there = own.moments.count * bits_per_point(own.moments.misfit(&fit.sphere));
        if there > own.bits - SPHERE_BITS + SQUARE_BITS {
            return false;
        }
        bits += there;
    }
    graph.absorb(nodes, Patch { moments, fit, bits });
    true
}

/// Unites the atoms, each other and with the spheres that are there: inside cells first. False where
/// time was up before.
fn unite(graph: &mut Agglomeration, work: &Workspace, time_is_up: &dyn Fn() -> bool) -> bool {
    let atoms = &work.atoms;
    let cell = |k: u32| atoms.get(k as usize).map(|a| a.cell);
    let same = |a, b| cell(a).is_some() && cell(a) == cell(b);
    // twice across cells: a pair that saved nothing may do so once one of them has grown
    graph.run(same, |_, _| false, time_is_up)
        && graph.run(|_, _| true, same, time_is_up)
        && graph.run(|_, _| true, |_, _| true, time_is_up)
}

/// Gives the unions to slots and the blocks their spheres.
fn settle(
    problem: &Problem<'_>,
    blocks: &mut Blocks,
    slots: &mut Vec<Option<Patch>>,
    graph: &mut Agglomeration,
    work: &mut Workspace,
    united: bool,
    report: &mut FitReport,
) {
    work.slot_of_root.clear();
    work.slot_of_root.resize(graph.len(), NO_SPHERE);
    // spheres already there: of those united the one with most points keeps its number
    for (slot, &node) in work.meetings.node_of_slot.iter().enumerate() {
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
    work.heir.clear();
    work.heir.resize(slots.len(), NO_SPHERE);
    work.fresh.clear();
    work.fresh.resize(slots.len(), false);
    for (slot, &node) in work.meetings.node_of_slot.iter().enumerate() {
        if node == NONE {
            continue;
        }
        let root = graph.root(node);
        let holder = work.slot_of_root[root as usize];
        if usize::from(holder) != slot {
            slots[slot] = None;
            work.heir[slot] = holder;
        } else if graph.patch(root).moments.count
            > slots[slot].as_ref().map_or(0.0, |p| p.moments.count)
        {
            slots[slot] = Some(*graph.patch(root));
            work.heir[slot] = holder;
            work.fresh[slot] = true;
            report.refitted += 1;
        }
    }
    // unions of atoms alone: new spheres, largest first
    let least = if !united {
        HASTY_POINTS
    } else if problem.turn.is_some() && problem.warm {
        FIRST_POINTS
    } else {
        SPHERE_POINTS
    };
    work.roots.clear();
    for k in 0..work.atoms.len() as u32 {
        let root = graph.root(k);
        if root == k
            && work.slot_of_root[root as usize] == NO_SPHERE
            && graph.patch(root).moments.count >= least
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
            work.fresh.push(false);
        }
        work.fresh[free] = true;
        slots[free] = Some(*graph.patch(root));
        work.slot_of_root[root as usize] = free as u16;
        report.new += 1;
    }
    for (node, atom) in work.atoms.iter().enumerate() {
        // every atom's own entry from here on, not only its root's
        let id = work.slot_of_root[graph.root(node as u32) as usize];
        let there = &mut blocks.spheres[atom.block as usize];
        let second = work.of_block[atom.block as usize][0] != node as u32;
        if second {
            there[1] = id;
        } else {
            *there = [id, NO_SPHERE];
        }
        if graph.root(node as u32) != node as u32 {
            work.given.push((node as u32, id));
        }
    }
    for (node, id) in work.given.drain(..) {
        work.slot_of_root[node as usize] = id;
    }
}
