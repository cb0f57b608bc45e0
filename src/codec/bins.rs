//! Bins: the depths that corrected pixels come back as.
//!
//! A sensor gives few distinct integers (a Kinect some 300 in a scene), each standing for a step of
//! disparity. A bin is a run of them that one depth represents within the bound; where steps are
//! wider than the bound, and always without loss, a bin is one integer. Neighbouring pixels mostly
//! share a bin or are one apart, whatever the depth: that is what the residual section codes.

use super::mask::extent;
use super::range_coder::{Coder, Integer};
use crate::contact_map::contact::Reach;
use crate::deproject::{BLOCK, Rays};

/// Bins narrow towards the corners of the image, where rays are slanted, in so many classes.
const CLASSES: usize = 8;
/// All integers.
const INTEGERS: usize = 1 << 16;

/// Learnt models of the list of integers.
#[derive(Clone, Debug, Default)]
pub struct Models {
    count: Integer,
    gap: Integer,
}

/// Bins of one stream.
#[derive(Clone, Debug, Default)]
pub struct Bins {
    /// 1 where the integer may be measured; all are where nothing is listed.
    present: Vec<bool>,
    listed: bool,
    /// Scratch: the integers of one frame.
    seen: Vec<bool>,
    /// Class of each pixel, block by block.
    classes: Vec<[u8; BLOCK * BLOCK]>,
    tables: Vec<Table>,
    fresh: bool,
}

/// Bins of one class of pixels.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// Bins of the integers.
    runs: Vec<Run>,
    /// Depth integer of each bin.
    centers: Vec<u16>,
    /// Four by the way to the next bin.
    quarters: Vec<f32>,
}

/// Integers of a run, whose bins stand in one place: eight times less to look up than a list of them all,
/// and all tables stay in the nearer caches.
const RUN: usize = 32;

/// Bins of [`RUN`] integers side by side.
#[derive(Clone, Copy, Debug, Default)]
struct Run {
    /// Bit n: the n-th integer's bin is the one after the integer's before it.
    begins: u32,
    /// Bin of the integer before the first.
    before: u16,
}

impl Table {
    /// Bin of a depth integer (of one that is not listed: the bin below).
    #[inline(always)]
    #[must_use]
    pub fn of(&self, integer: u16) -> i32 {
        let run = self.runs[usize::from(integer) / RUN];
        let upto = u32::MAX >> (RUN - 1 - usize::from(integer) % RUN);
        i32::from(run.before) + (run.begins & upto).count_ones() as i32
    }

    /// Depth integer of the bin nearest to `bin`.
    #[inline(always)]
    #[must_use]
    pub fn center(&self, bin: i32) -> u16 {
        self.centers[self.clamp(bin) as usize]
    }

    /// The bin nearest to `bin` that exists.
    #[inline(always)]
    #[must_use]
    pub fn clamp(&self, bin: i32) -> i32 {
        bin.clamp(0, self.centers.len() as i32 - 1)
    }

    /// Where in its bin a depth lies: −3 … 3, in quarters of the way to the next bin.
    #[inline(always)]
    #[must_use]
    pub fn part(&self, bin: i32, depth: f32) -> i32 {
        let bin = self.clamp(bin) as usize;
        let way = (depth - f32::from(self.centers[bin])) * self.quarters[bin];
        // the nearest, by a cast that drops the fraction of a positive number
        (way.clamp(-3.0, 3.0) + 8.5) as i32 - 8
    }

    /// Greedy from the smallest integer: a bin grows while its ends lie within `half` of its
    /// centre.
    fn fill(&mut self, present: impl Fn(usize) -> bool, half: impl Fn(usize) -> usize) {
        self.runs.clear();
        self.runs.resize(INTEGERS / RUN, Run::default());
        self.centers.clear();
        let (mut first, mut last, mut widest) = (0, 0, 0);
        let mut before = 0u16;
        for integer in 1..INTEGERS {
            if present(integer) {
                if first == 0 || integer - first > widest {
                    if first != 0 {
                        self.centers.push(((first + last) / 2) as u16);
                    }
                    first = integer;
                    widest = 2 * half(integer);
                }
                last = integer;
            }
            // the first bin takes what lies below it
            let bin = self.centers.len() as u16;
            let run = &mut self.runs[integer / RUN];
            if integer.is_multiple_of(RUN) {
                run.before = before;
            }
            run.begins |= u32::from(bin != before) << (integer % RUN);
            before = bin;
        }
        // an empty list, which only damaged bytes have, is one bin
        self.centers.push(((first + last) / 2).max(1) as u16);
        self.quarters.clear();
        self.quarters.resize(self.centers.len(), 4.0);
        for (quarter, pair) in self.quarters.iter_mut().zip(self.centers.windows(2)) {
            *quarter = 4.0 / f32::from(pair[1] - pair[0]);
        }
    }
}

impl Bins {
    /// Classes of the pixels of `rays`, once; bins are made by [`Self::prepare`].
    pub fn cover(&mut self, rays: &Rays) {
        if !self.present.is_empty() {
            return;
        }
        self.present.resize(INTEGERS, false);
        self.seen.resize(INTEGERS, false);
        let most = steepest(rays);
        let edges: [f64; CLASSES - 1] = std::array::from_fn(|n| edge(most, n + 1));
        self.classes.extend((0..rays.blocks()).map(|k| {
            let (x0, y0, ..) = extent(rays, k);
            std::array::from_fn(|bit| {
                let (u, v) = (rays.u[x0 + bit % BLOCK], rays.v[y0 + bit / BLOCK]);
                // classes by squared length: no root to agree on
                let q = f64::from(u * u + v * v + 1.0);
                edges.iter().map(|&edge| u8::from(q >= edge)).sum()
            })
        }));
    }

    /// The bins of a pixel (bit `8·row + column`) of block `k`.
    #[inline(always)]
    #[must_use]
    pub fn of(&self, k: usize, bit: usize) -> &Table {
        &self.tables[usize::from(self.classes[k][bit])]
    }

    /// A key frame begins: the integers are listed anew, or every integer has its place.
    pub fn begin(&mut self, listed: bool) {
        if listed || self.listed {
            self.present.fill(false);
            self.fresh = false;
        }
        self.listed = listed;
    }

    /// True where integers must be listed before they come back.
    #[must_use]
    pub fn is_listed(&self) -> bool {
        self.listed
    }

    /// True where listing the integers of `plane` makes fewer bins than every integer would: the
    /// encoder's choice in a key frame.
    #[must_use]
    pub fn worth_listing(&mut self, plane: &[u16], reach: &Reach, lossless: bool) -> bool {
        self.look(plane);
        let seen = &self.seen;
        let (mut bins, mut integers, mut most) = (0usize, 0usize, 0usize);
        let mut end = 0;
        for integer in (1..INTEGERS).filter(|&i| seen[i]) {
            integers += 1;
            most = integer;
            if integer > end {
                bins += 1;
                end = integer
                    + if lossless {
                        0
                    } else {
                        2 * half(reach, integer, 1.0)
                    };
            }
        }
        // every integer up to the largest, in bins of the same width
        let (mut plain, mut at) = (0usize, 1);
        while at <= most {
            plain += 1;
            at += 1 + if lossless {
                0
            } else {
                2 * half(reach, at, 1.0)
            };
        }
        // a list costs time and bits: it must halve the bins, where it is not all that there is
        integers > 0 && bins * if lossless { 1 } else { 2 } < plain
    }

    /// Codes the integers that are not listed yet; `wanted` is the plane that must be covered (not
    /// used to decode).
    ///
    /// # Errors
    /// [`NoSuchInteger`] where the bytes name an integer beyond 65535.
    pub fn code_list<C: Coder>(
        &mut self,
        coder: &mut C,
        models: &mut Models,
        wanted: &[u16],
    ) -> Result<(), NoSuchInteger> {
        self.look(wanted);
        let missing = |after: usize, present: &[bool]| {
            (after + 1..INTEGERS).find(|&i| self.seen[i] && !present[i])
        };
        let count = (1..INTEGERS)
            .filter(|&i| self.seen[i] && !self.present[i])
            .count();
        let count = models.count.code(coder, count as u32) as usize;
        let mut last = 0usize;
        for _ in 0..count {
            // the decoder has nothing to look for, and would look through all for each
            let next = C::WRITES.then(|| missing(last, &self.present)).flatten();
            let gap = next.map_or(0, |m| m - last - 1);
            last += 1 + models.gap.code(coder, gap as u32) as usize;
            if last >= INTEGERS {
                return Err(NoSuchInteger);
            }
            self.present[last] = true;
        }
        self.fresh &= count == 0;
        Ok(())
    }

    fn look(&mut self, plane: &[u16]) {
        self.seen.fill(false);
        for &raw in plane {
            self.seen[usize::from(raw)] = true;
        }
    }

    /// Makes the bins, where the list changed and `needed`.
    pub fn prepare(&mut self, rays: &Rays, reach: &Reach, lossless: bool, needed: bool) {
        if self.fresh || !needed {
            return;
        }
        self.fresh = true;
        let most = steepest(rays);
        self.tables.resize(CLASSES, Table::default());
        let every = !self.listed;
        for (class, table) in self.tables.iter_mut().enumerate() {
            if lossless && class > 0 {
                break;
            }
            let slant = edge(most, class + 1).sqrt();
            table.fill(
                |i| every || self.present[i],
                |i| if lossless { 0 } else { half(reach, i, slant) },
            );
        }
        if lossless {
            let (first, others) = self.tables.split_at_mut(1);
            for table in others {
                table.clone_from(&first[0]);
            }
        }
    }
}

/// A list that names an integer beyond the largest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoSuchInteger;

/// Squared length of the longest ray.
fn steepest(rays: &Rays) -> f64 {
    let far = |side: &[f32]| side.iter().fold(0f32, |most, s| most.max(s.abs()));
    let (u, v) = (far(&rays.u[..rays.width]), far(&rays.v[..rays.height]));
    f64::from(u) * f64::from(u) + f64::from(v) * f64::from(v) + 1.0
}

/// Squared ray length at which class `class` begins.
fn edge(most: f64, class: usize) -> f64 {
    1.0 + (most - 1.0) * class as f64 / CLASSES as f64
}

/// Integers on either side of a bin's centre, for a bin that begins at `integer`.
fn half(reach: &Reach, integer: usize, slant: f64) -> usize {
    (f64::from(reach.at(integer as f32)) * 0.999 / slant) as usize
}
