//! Which spheres each block touches: its palette.
//!
//! A palette has one to four entries, most of them repeated from the blocks around or from the last
//! frame and coded as "the n-th candidate". New spheres get their numbers here.

use super::label_map::LabelMap;
use super::mask::{Fill, Mask};
use super::range_coder::{Bit, Coder};
use crate::contact_map::assign::PALETTE;
use crate::contact_map::labels::NO_SPHERE;
use crate::deproject::Rays;

/// Most candidates a palette entry is looked for among.
const LIST: usize = 16;

/// Learnt models of the palettes.
#[derive(Clone, Debug)]
pub struct Models {
    alone: [Bit; 16 * 8],
    more: [Bit; 3 * 16],
    candidate: [Bit; 8 * 2 * 8],
    none: [Bit; 2],
    new: [Bit; 2],
}

impl Default for Models {
    fn default() -> Self {
        Self {
            alone: [Bit::default(); 16 * 8],
            more: [Bit::default(); 3 * 16],
            candidate: [Bit::default(); 8 * 2 * 8],
            none: Default::default(),
            new: Default::default(),
        }
    }
}

/// Numbers given to spheres that appear for the first time: the lowest not in use.
#[derive(Clone, Debug, Default)]
pub struct NewNumbers {
    taken: Vec<bool>,
    next: usize,
    given: usize,
}

impl NewNumbers {
    /// Numbers of which so many are looked after before a table grows.
    #[must_use]
    pub fn with_room(spheres: usize) -> Self {
        Self {
            taken: Vec::with_capacity(spheres),
            ..Self::default()
        }
    }

    /// `taken[n]` is true where number n is a sphere of the reference frame.
    pub fn reset(&mut self, taken: impl Iterator<Item = bool>) {
        self.taken.clear();
        self.taken.extend(taken);
        self.start_over();
    }

    /// Takes back all numbers that were given away.
    pub fn start_over(&mut self) {
        self.next = 0;
        self.given = 0;
    }

    /// One more than the highest number in use, in the reference frame or given away since.
    #[must_use]
    pub fn bound(&self) -> usize {
        self.taken.len().max(self.given)
    }

    /// The number the next new sphere gets.
    pub fn peek(&mut self) -> usize {
        while self.taken.get(self.next).copied().unwrap_or(false) {
            self.next += 1;
        }
        self.next
    }

    /// Gives the number away.
    pub fn take(&mut self) -> usize {
        let n = self.peek();
        self.next += 1;
        self.given = self.given.max(n + 1);
        n
    }
}

/// The candidates of a block's palette entries, in order; found as they are asked for, since the
/// first ones mostly do.
struct Candidates<'a> {
    ids: [u16; LIST],
    len: usize,
    /// Palettes in which they are looked for, and how far that came.
    sources: [&'a [u16]; SOURCES],
    source: usize,
    entry: usize,
}

/// Places in which candidates are looked for; the first three vote.
const SOURCES: usize = 9;

impl<'a> Candidates<'a> {
    fn new(map: &'a LabelMap, before: Option<&'a LabelMap>, columns: usize, k: usize) -> Self {
        let (x, blocks) = (k % columns, map.sizes.len());
        let (west, north, east) = (x > 0, k >= columns, x + 1 < columns);
        let palette = |m: Option<&'a LabelMap>, there: bool, k: usize| -> &'a [u16] {
            match m {
                Some(m) if there => &m.palettes[k][..usize::from(m.sizes[k])],
                _ => &[],
            }
        };
        let now = |there, k| palette(Some(map), there, k);
        let past = |there, k| palette(before, there, k);
        let above = k.wrapping_sub(columns);
        Self {
            ids: [NO_SPHERE; LIST],
            len: 0,
            sources: [
                past(true, k),
                now(west, k.wrapping_sub(1)),
                now(north, above),
                now(north && east, above.wrapping_add(1)),
                now(north && west, above.wrapping_sub(1)),
                past(east, k + 1),
                past(k + columns < blocks, k + columns),
                past(west, k.wrapping_sub(1)),
                past(north, above),
            ],
            source: 0,
            entry: 0,
        }
    }

    /// The n-th candidate; each below n was asked for before.
    #[inline(always)]
    fn get(&mut self, n: usize) -> Option<u16> {
        while n == self.len && self.len < LIST {
            let source = self.sources.get(self.source)?;
            match source.get(self.entry) {
                None => (self.source, self.entry) = (self.source + 1, 0),
                Some(id) => {
                    self.entry += 1;
                    if !self.ids[..self.len].contains(id) {
                        self.ids[self.len] = *id;
                        self.len += 1;
                    }
                }
            }
        }
        (n < self.len).then(|| self.ids[n])
    }

    /// Which of past, west and north hold it.
    #[inline(always)]
    fn votes(&self, id: u16) -> usize {
        let holds = |source: usize| self.sources[source].contains(&id);
        let vote = |source: usize| usize::from(holds(source)) << source;
        vote(0) | vote(1) | vote(2)
    }
}

/// A palette that names a sphere that cannot be: damaged bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoSuchSphere(pub u32);

/// Codes the palettes. Numbers of new spheres come from `new` (reset to the reference frame's), all
/// below `limit`. `fast`, a palette of the first candidate alone, as most are, is one bit.
///
/// # Errors
/// [`NoSuchSphere`] where the bytes name a number beyond `limit` (decoding only).
#[allow(clippy::too_many_arguments)] // one section's whole state
pub fn code<C: Coder>(
    coder: &mut C,
    models: &mut Models,
    rays: &Rays,
    mask: &Mask,
    map: &mut LabelMap,
    before: Option<&LabelMap>,
    new: &mut NewNumbers,
    limit: usize,
    fast: bool,
) -> Result<(), NoSuchSphere> {
    let columns = rays.block_columns;
    for k in 0..rays.blocks() {
        if mask.fills[k] == Fill::Empty {
            continue;
        }
        let west = if k % columns > 0 { map.sizes[k - 1] } else { 1 };
        let north = if k >= columns {
            map.sizes[k - columns]
        } else {
            1
        };
        let past = before.map_or(1, |b| b.sizes[k]);
        let context = usize::from(west > 1)
            | usize::from(north > 1) << 1
            | usize::from(past > 1) << 2
            | usize::from(mask.fills[k] == Fill::Mixed) << 3;
        let size = usize::from(map.sizes[k]);
        let mut palette = map.palettes[k];
        let mut list = Candidates::new(map, before, columns, k);
        let first = if fast { list.get(0) } else { None };
        if let Some(id) = first {
            let context = context * 8 + list.votes(id);
            if coder.bit(&mut models.alone[context], size == 1 && palette[0] == id) {
                (map.sizes[k], map.palettes[k][0]) = (1, id);
                continue;
            }
        }
        let mut n = 1;
        while n < PALETTE && coder.bit(&mut models.more[(n - 1) * 16 + context], n < size) {
            n += 1;
        }
        // one sphere alone is not the first candidate
        let mut tried = u32::from(first.is_some() && n == 1);
        for (entry, label) in palette[..n].iter_mut().enumerate() {
            let id = *label;
            let (mut found, mut rank, mut c) = (None, 0usize, 0usize);
            while let Some(this) = list.get(c) {
                if tried >> c & 1 == 0 {
                    let context = (rank.min(7) * 2 + usize::from(entry > 0)) * 8 + list.votes(this);
                    if coder.bit(&mut models.candidate[context], this == id) {
                        tried |= 1 << c;
                        found = Some(this);
                        break;
                    }
                    rank += 1;
                }
                c += 1;
            }
            let first = usize::from(entry > 0);
            *label = if let Some(id) = found {
                id
            } else if coder.bit(&mut models.none[first], id == NO_SPHERE) {
                NO_SPHERE
            } else if new.bound() == 0
                || coder.bit(&mut models.new[first], usize::from(id) == new.peek())
            {
                let number = new.take();
                if number >= limit {
                    return Err(NoSuchSphere(number as u32));
                }
                number as u16
            } else {
                let bound = new.bound();
                let width = usize::BITS - (bound - 1).leading_zeros();
                let number = coder.plain(width, u32::from(id));
                if number as usize >= bound {
                    return Err(NoSuchSphere(number));
                }
                number as u16
            };
        }
        (map.sizes[k], map.palettes[k]) = (n as u8, palette);
    }
    Ok(())
}
