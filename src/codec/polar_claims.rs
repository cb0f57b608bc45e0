//! Models of a polar payload (`FORMAT.md`, chapter 2): spheres, and the cells that each claims.
//!
//! Cells are coded in tiles of 8×8, row of tiles by row of tiles, and only tiles that hold a claim.
//! Points of a camera or a scanner lie in a lattice that the tiles cut at a slant: the contexts of
//! a cell are the pattern around it, how far the last claims of its row and column are off, and how
//! many there are.

use super::mixer::{Mixer, Place};
use super::range_coder::{Bit, Coder, Integer};
use crate::contact_map::polar::{MAX_STEPS, Patch, PatchCell};
use glam::Vec3;

/// Cells along a tile's side.
const SIDE: i32 = 8;
/// Farthest that the distance to the last claim of a row or column counts.
const FAR: u32 = 8;
/// Bits of sign and exponent of a float, and of its fraction.
const TOP: u32 = 9;
const FRACTION: u32 = 23;
/// A normal's greatest component is stated as what it differs from a unit's by, up to so much.
const NEAR: i64 = 1 << 20;

/// Claims of a tile, bit `8·row + column`; its place in tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    row: i32,
    column: i32,
    cells: u64,
}

/// The claims of one sphere as tiles, by row, then column.
pub fn tiles(cells: &[PatchCell], tiles: &mut Vec<Tile>) {
    tiles.clear();
    for cell in cells {
        let (row, column) = (cell.row.div_euclid(SIDE), cell.column.div_euclid(SIDE));
        let bit = SIDE * cell.row.rem_euclid(SIDE) + cell.column.rem_euclid(SIDE);
        match tiles.last_mut() {
            Some(t) if (t.row, t.column) == (row, column) => t.cells |= 1 << bit,
            _ => tiles.push(Tile {
                row,
                column,
                cells: 1 << bit,
            }),
        }
    }
    // cells come row by row, so pieces of a tile lie apart
    tiles.sort_unstable_by_key(|t| (t.row, t.column));
    tiles.dedup_by(|next, t| {
        let same = (t.row, t.column) == (next.row, next.column);
        if same {
            t.cells |= next.cells;
        }
        same
    });
}

/// Model of a 32-bit float: sign and exponent, then as much of the fraction as is not zero.
#[derive(Clone, Debug)]
struct Float {
    top: Vec<Bit>,
    used: Vec<[Bit; 32]>,
}

impl Default for Float {
    fn default() -> Self {
        Self {
            top: vec![Bit::default(); 1 << TOP],
            used: vec![[Bit::default(); 32]; 32],
        }
    }
}

impl Float {
    fn code<C: Coder>(&mut self, coder: &mut C, value: f32) -> f32 {
        let bits = value.to_bits();
        let mut node = 1;
        for k in (0..TOP).rev() {
            let bit = coder.bit(&mut self.top[node], bits >> (FRACTION + k) & 1 != 0);
            node = 2 * node + usize::from(bit);
        }
        let top = node as u32 - (1 << TOP);
        let fraction = bits & ((1 << FRACTION) - 1);
        let used = match fraction {
            0 => 0,
            some => FRACTION - some.trailing_zeros(),
        };
        let (model, mut node) = (&mut self.used[top as usize & 31], 1);
        for k in (0..5).rev() {
            let bit = coder.bit(&mut model[node], used >> k & 1 != 0);
            node = 2 * node + usize::from(bit);
        }
        let used = (node as u32 - 32).min(FRACTION);
        if used == 0 {
            return f32::from_bits(top << FRACTION);
        }
        // its last bit is a one
        let (mut read, mut left) = (0, used - 1);
        let stated = fraction >> (FRACTION - used) >> 1;
        while left > 0 {
            let take = left.min(16);
            left -= take;
            read = read << take | coder.plain(take, stated >> left & ((1 << take) - 1));
        }
        f32::from_bits(top << FRACTION | (read << 1 | 1) << (FRACTION - used))
    }
}

/// All that is learnt while a payload is coded.
#[derive(Debug)]
pub struct Models {
    claims: Bit,
    again: [Bit; 2],
    anchor: [Float; 3],
    side: [Float; 2],
    curvature: Float,
    pole: [Bit; 2],
    sign: [Bit; 3],
    near: Bit,
    off: Integer,
    last: [Patch; 2],
    first_row: Integer,
    first_column: Integer,
    rows_on: Integer,
    columns_on: Integer,
    beside: [Bit; 64],
    more: [Bit; 2],
    below: [Bit; 2],
    cells: Mixer,
}

impl Default for Models {
    fn default() -> Self {
        let nothing = Patch {
            anchor: Vec3::ZERO,
            normal: Vec3::ZERO,
            curvature: 0.0,
        };
        Self {
            claims: Bit::default(),
            again: Default::default(),
            anchor: Default::default(),
            side: Default::default(),
            curvature: Float::default(),
            pole: Default::default(),
            sign: Default::default(),
            near: Bit::default(),
            off: Integer::default(),
            last: [nothing; 2],
            first_row: Integer::default(),
            first_column: Integer::default(),
            rows_on: Integer::default(),
            columns_on: Integer::default(),
            beside: [Bit::default(); 64],
            more: Default::default(),
            below: Default::default(),
            cells: Mixer::new([1 << 14, 81 * 72, 30 * 81], 8),
        }
    }
}

/// Codes whether a sphere claims anything.
pub fn code_claims<C: Coder>(coder: &mut C, models: &mut Models, any: bool) -> bool {
    coder.bit(&mut models.claims, any)
}

/// Codes a sphere, one that claims something or not (`any`). What is read may be any floats.
pub fn code_patch<C: Coder>(
    coder: &mut C,
    models: &mut Models,
    any: bool,
    patch: Option<&Patch>,
) -> Patch {
    let last = models.last[usize::from(any)];
    let patch = *patch.unwrap_or(&last);
    let bits = |p: &Patch| floats(p).map(f32::to_bits);
    if coder.bit(
        &mut models.again[usize::from(any)],
        bits(&patch) == bits(&last),
    ) {
        return last;
    }
    let mut anchor = patch.anchor.to_array();
    for (v, model) in anchor.iter_mut().zip(&mut models.anchor) {
        *v = model.code(coder, *v);
    }
    let normal = code_normal(coder, models, patch.normal.to_array());
    let patch = Patch {
        anchor: anchor.into(),
        normal: normal.into(),
        curvature: models.curvature.code(coder, patch.curvature),
    };
    models.last[usize::from(any)] = patch;
    patch
}

/// Two components and what the third, the greatest, differs from a unit normal's by.
fn code_normal<C: Coder>(coder: &mut C, models: &mut Models, normal: [f32; 3]) -> [f32; 3] {
    let size = normal.map(f32::abs);
    let greatest = match size {
        [x, y, z] if z >= x && z >= y => 2,
        [x, y, _] => usize::from(y >= x),
    };
    let pole = if coder.bit(&mut models.pole[0], greatest == 2) {
        2
    } else {
        usize::from(coder.bit(&mut models.pole[1], greatest == 1))
    };
    let mut read = [0f32; 3];
    for (k, model) in models.side.iter_mut().enumerate() {
        let at = (pole + 1 + k) % 3;
        read[at] = model.code(coder, normal[at]);
    }
    let [a, b] = [1, 2].map(|k| f64::from(read[(pole + k) % 3]));
    let unit = (1.0 - a * a - b * b).max(0.0).sqrt() as f32;
    let negative = coder.bit(&mut models.sign[pole], normal[pole].is_sign_negative());
    let guess = i64::from(unit.to_bits());
    let bits = normal[pole].to_bits() & 0x7FFF_FFFF;
    let off = i64::from(bits) - guess;
    let bits = if coder.bit(&mut models.near, off.abs() < NEAR) {
        let off = models.off.code_signed(coder, off as i32);
        (guess + i64::from(off)).clamp(0, 0x7FFF_FFFF) as u32
    } else {
        coder.plain(15, bits >> 16) << 16 | coder.plain(16, bits & 0xFFFF)
    };
    read[pole] = f32::from_bits(u32::from(negative) << 31 | bits);
    read
}

/// The seven floats of a sphere, in the order of the payload.
pub fn floats(patch: &Patch) -> [f32; 7] {
    let (a, n) = (patch.anchor, patch.normal);
    [a.x, a.y, a.z, n.x, n.y, n.z, patch.curvature]
}

/// Claims that no writer states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Misstated {
    /// More of them than announced.
    Many,
    /// One beyond ±2²⁴.
    Far,
}

/// Codes the claims of a sphere that has some, at most `most`. The encoder says them as `wanted`;
/// `tiles` gets them, and `cells` has them appended in order.
pub fn code_cells<C: Coder>(
    coder: &mut C,
    models: &mut Models,
    wanted: &[Tile],
    most: usize,
    tiles: &mut Vec<Tile>,
    cells: &mut Vec<PatchCell>,
) -> Result<(), Misstated> {
    tiles.clear();
    let mut left = most;
    // rows of tiles: the one above and this one begin here
    let (mut above, mut start) = (0, 0);
    let want = |n: usize| wanted.get(n);
    let mut row = models
        .first_row
        .code_signed(coder, want(0).map_or(0, |t| t.row));
    let mut first = 0;
    loop {
        let from = want(start).map_or(0, |t| t.column);
        first += i64::from(
            models
                .first_column
                .code_signed(coder, (i64::from(from) - first) as i32),
        );
        let mut column = i32::try_from(first).map_err(|_| Misstated::Far)?;
        loop {
            check_place(row, column)?;
            let around = Around::of(tiles, above, start, row, column);
            let tile = code_tile(
                coder,
                models,
                &around,
                want(tiles.len()).map_or(0, |t| t.cells),
            );
            left = left
                .checked_sub(tile.count_ones() as usize)
                .ok_or(Misstated::Many)?;
            tiles.push(Tile {
                row,
                column,
                cells: tile,
            });
            let next = want(tiles.len()).filter(|t| t.row == row).map(|t| t.column);
            let edge = (tile & RIGHT).count_ones().min(3) as usize;
            let sides = (around.north_east >> 56).count_ones().min(3) as usize;
            let beside = edge
                | sides << 2
                | usize::from(around.north_east != 0) << 4
                | usize::from(around.beyond != 0) << 5;
            if coder.bit(&mut models.beside[beside], next == Some(column + 1)) {
                column += 1;
                continue;
            }
            let more = &mut models.more[usize::from(around.more)];
            if !coder.bit(more, next.is_some()) {
                break;
            }
            let on = next.map_or(0, |next| (next - column - 2) as u32);
            column += models.columns_on.code(coder, on) as i32 + 2;
        }
        expand(&tiles[start..], cells)?;
        let bottom = tiles[start..].iter().any(|t| t.cells >> 56 != 0);
        (above, start) = (start, tiles.len());
        let below = &mut models.below[usize::from(bottom)];
        if !coder.bit(below, start < wanted.len()) {
            return Ok(());
        }
        let on = want(start).map_or(0, |t| (t.row - row - 1) as u32);
        let on = models.rows_on.code(coder, on) as i32;
        row += on + 1;
        if on > 0 {
            above = start;
        }
    }
}

/// Columns at the right of a tile.
const RIGHT: u64 = 0x8080_8080_8080_8080;

/// Tiles lie within the cells that there may be, and one is not past them.
fn check_place(row: i32, column: i32) -> Result<(), Misstated> {
    let last = MAX_STEPS / SIDE;
    let inside = |v: i32| (-last..=last).contains(&v);
    if inside(row) && inside(column) {
        Ok(())
    } else {
        Err(Misstated::Far)
    }
}

/// Appends the cells of a row of tiles.
fn expand(tiles: &[Tile], cells: &mut Vec<PatchCell>) -> Result<(), Misstated> {
    for j in 0..SIDE {
        for tile in tiles {
            let mut bits = tile.cells >> (SIDE * j) & 0xFF;
            while bits != 0 {
                let cell = PatchCell {
                    row: tile.row * SIDE + j,
                    column: tile.column * SIDE + bits.trailing_zeros() as i32,
                };
                if cell.row.abs() > MAX_STEPS || cell.column.abs() > MAX_STEPS {
                    return Err(Misstated::Far);
                }
                cells.push(cell);
                bits &= bits - 1;
            }
        }
    }
    Ok(())
}

/// What lies around a tile.
struct Around {
    west: u64,
    north_west: u64,
    north: u64,
    north_east: u64,
    /// Right of north east.
    beyond: u64,
    /// The row above has a tile from north east on.
    more: bool,
}

impl Around {
    /// Of the tile behind `tiles`, of which the row above begins at `above`, this row at `start`.
    fn of(tiles: &[Tile], above: usize, start: usize, row: i32, column: i32) -> Self {
        let (upper, own) = tiles.split_at(start);
        let west = own.last().filter(|t| t.column == column - 1);
        let upper = &upper[above..];
        let upper = if upper.last().is_some_and(|t| t.row == row - 1) {
            upper
        } else {
            &[]
        };
        let mut at = upper.partition_point(|t| t.column < column - 1);
        let mut found = [0; 4];
        for (cells, column) in found.iter_mut().zip(column - 1..) {
            if let Some(tile) = upper.get(at).filter(|t| t.column == column) {
                *cells = tile.cells;
                at += 1;
            }
        }
        let [north_west, north, north_east, beyond] = found;
        Self {
            west: west.map_or(0, |t| t.cells),
            north_west,
            north,
            north_east,
            beyond,
            more: upper.last().is_some_and(|t| t.column > column),
        }
    }
}

/// The cells of a tile and of those around it, as far as they are known.
struct Window {
    /// Rows, 8 above and 8 own; columns from the lowest bit, 8 at the left, 8 own, 8 at the right.
    rows: [u32; 16],
    /// Each column above the row at hand, the nearest cell in the highest bit.
    above: [u32; 24],
}

impl Window {
    fn of(around: &Around) -> Self {
        let mut window = Self {
            rows: [0; 16],
            above: [0; 24],
        };
        let row = |cells: u64, j: usize| (cells >> (8 * j)) as u32 & 0xFF;
        for j in 0..8 {
            window.rows[j] = row(around.north_west, j)
                | row(around.north, j) << 8
                | row(around.north_east, j) << 16;
            window.rows[j + 8] = row(around.west, j);
            window.pass(j);
        }
        window
    }

    /// Row `j` is above from now on.
    fn pass(&mut self, j: usize) {
        let row = self.rows[j];
        for (x, above) in self.above.iter_mut().enumerate() {
            *above = *above >> 1 | (row >> x & 1) << 31;
        }
    }

    /// The contexts of the cell at row `j`, column `x`: the pattern around it, the gaps to the
    /// claims before it, and their number with the gaps above it.
    fn contexts(&self, j: usize, x: usize) -> [usize; 3] {
        // the cells of a row from `back` columns before to `count` columns on
        let piece = |up: usize, back: usize, count: usize| {
            self.rows[j - up] as usize >> (x - back) & ((1 << count) - 1)
        };
        let pattern =
            piece(0, 3, 3) | piece(1, 2, 5) << 3 | piece(2, 2, 5) << 8 | piece(3, 0, 1) << 13;
        let [left, left_next] = gaps(self.rows[j] << (32 - x));
        let [up, up_next] = gaps(self.above[x]);
        let right = gaps(self.above[x + 1])[0].min(7);
        let claims = [
            piece(0, 4, 4),
            piece(1, 4, 9),
            piece(2, 4, 9),
            piece(3, 3, 7),
        ];
        let number: u32 = claims.iter().map(|piece| piece.count_ones()).sum();
        [
            pattern,
            ((left * 9 + left_next) * 9 + up) * 8 + right,
            (number as usize * 9 + up) * 9 + up_next,
        ]
    }
}

/// Cells without a claim before the first one and before the next one, each at most [`FAR`].
fn gaps(cells: u32) -> [usize; 2] {
    let first = cells.leading_zeros().min(FAR);
    let next = if first < FAR {
        (cells << (first + 1)).leading_zeros().min(FAR)
    } else {
        FAR
    };
    [first as usize, next as usize]
}

/// Codes the cells of a tile; at least one is claimed.
fn code_tile<C: Coder>(coder: &mut C, models: &mut Models, around: &Around, wanted: u64) -> u64 {
    let mut window = Window::of(around);
    let mut tile = 0u64;
    for j in 0..8 {
        for i in 0..8 {
            if 8 * j + i == 63 && tile == 0 {
                return 1 << 63;
            }
            let contexts = window.contexts(8 + j, 8 + i);
            let at = Place {
                contexts,
                weights: contexts[2] / 324,
            };
            let wanted = wanted >> (8 * j + i) & 1 != 0;
            let claimed = models.cells.code::<false, C>(coder, &at, wanted);
            tile |= u64::from(claimed) << (8 * j + i);
            window.rows[8 + j] |= u32::from(claimed) << (8 + i);
        }
        window.pass(8 + j);
    }
    tile
}
