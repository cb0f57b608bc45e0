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
    more: [Bit; 3 * 16],
    candidate: [Bit; 8 * 2 * 8],
    none: [Bit; 2],
    new: [Bit; 2],
}

impl Default for Models {
    fn default() -> Self {
        Self {
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

/// The candidates of one palette entry and how many of (west, north, past) hold each.
struct List {
    ids: [u16; LIST],
    votes: [u8; LIST],
    len: usize,
}

impl List {
    fn add(&mut self, id: u16, vote: u8) {
        if let Some(k) = self.ids[..self.len].iter().position(|&i| i == id) {
            self.votes[k] |= vote;
        } else if self.len < LIST {
            self.ids[self.len] = id;
            self.votes[self.len] = vote;
            self.len += 1;
        }
    }

    fn gather(map: &LabelMap, before: Option<&LabelMap>, columns: usize, k: usize) -> Self {
        let mut list = Self {
            ids: [NO_SPHERE; LIST],
            votes: [0; LIST],
            len: 0,
        };
        let mut all = |m: &LabelMap, k: usize, vote: u8| {
            for &id in &m.palettes[k][..usize::from(m.sizes[k])] {
                list.add(id, vote);
            }
        };
        if let Some(b) = before {
            all(b, k, 1);
        }
        let (x, blocks) = (k % columns, map.sizes.len());
        if x > 0 {
            all(map, k - 1, 2);
        }
        if k >= columns {
            all(map, k - columns, 4);
            if x + 1 < columns {
                all(map, k - columns + 1, 0);
            }
            if x > 0 {
                all(map, k - columns - 1, 0);
            }
        }
        if let Some(b) = before {
            for (there, n) in [
                (x + 1 < columns, k + 1),
                (k + columns < blocks, k + columns),
                (x > 0, k.wrapping_sub(1)),
                (k >= columns, k.wrapping_sub(columns)),
            ] {
                if there {
                    all(b, n, 0);
                }
            }
        }
        list
    }
}

/// A palette that names a sphere that cannot be: damaged bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoSuchSphere(pub u32);

/// Codes the palettes. Numbers of new spheres come from `new` (reset to the reference frame's), all
/// below `limit`.
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
        let mut n = 1;
        while n < PALETTE && coder.bit(&mut models.more[(n - 1) * 16 + context], n < size) {
            n += 1;
        }
        map.sizes[k] = n as u8;
        let list = List::gather(map, before, columns, k);
        let mut tried = [false; LIST];
        for entry in 0..n {
            let id = map.palettes[k][entry];
            let mut found = None;
            let mut rank = 0usize;
            for c in 0..list.len {
                if tried[c] {
                    continue;
                }
                let model = &mut models.candidate
                    [(rank.min(7) * 2 + usize::from(entry > 0)) * 8 + usize::from(list.votes[c])];
                if coder.bit(model, list.ids[c] == id) {
                    found = Some(c);
                    break;
                }
                rank += 1;
            }
            let first = usize::from(entry > 0);
            map.palettes[k][entry] = if let Some(c) = found {
                tried[c] = true;
                list.ids[c]
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
    }
    Ok(())
}
