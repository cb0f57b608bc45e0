//! Sets of points as bits, 64 neighbours to a word, and how many sets hold each point.

use super::touch::BLOCK;

/// Some points of a cloud: of each block that has any, its number and a bit for each point.
/// Ascending.
#[derive(Clone, Debug, Default)]
pub(crate) struct BlockSet {
    pub blocks: Vec<(u32, u64)>,
}

impl BlockSet {
    /// Appends the places of the points to `places`, ascending.
    pub fn list(&self, places: &mut Vec<u32>) {
        places.reserve(self.len());
        for &(block, bits) in &self.blocks {
            list_bits(block, bits, places);
        }
    }

    /// Points in the set.
    pub fn len(&self) -> usize {
        let ones = |&(_, bits): &(u32, u64)| bits.count_ones() as usize;
        self.blocks.iter().map(ones).sum()
    }
}

/// Appends the places of a block's points to `places`, ascending.
pub(crate) fn list_bits(block: u32, mut bits: u64, places: &mut Vec<u32>) {
    let first = block * BLOCK as u32;
    if bits == u64::MAX {
        places.extend(first..first + BLOCK as u32);
        return;
    }
    while bits != 0 {
        places.push(first + bits.trailing_zeros());
        bits &= bits - 1;
    }
}

/// All of `n` points, a word for each block.
pub(crate) fn full(n: usize, words: &mut Vec<u64>) {
    words.clear();
    words.resize(n / BLOCK, u64::MAX);
    if !n.is_multiple_of(BLOCK) {
        words.push((1 << (n % BLOCK)) - 1);
    }
}

/// A count for each point, sliced: the k-th word of a block holds the k-th binary digit of its
/// 64 counts.
#[derive(Clone, Debug, Default)]
pub(crate) struct Counts {
    digits: Vec<Vec<u64>>,
    /// Which points there are.
    all: Vec<u64>,
}

impl Counts {
    /// 0 for each of `n` points.
    pub fn new(n: usize) -> Self {
        let mut all = Vec::new();
        full(n, &mut all);
        // counts of 0 and 1 must always be told
        let digits = vec![vec![0; all.len()]];
        Self { digits, all }
    }

    /// Counts the points of the set once more.
    pub fn add(&mut self, set: &BlockSet) {
        for &(block, bits) in &set.blocks {
            let mut carry = bits;
            let mut k = 0;
            while carry != 0 {
                if k == self.digits.len() {
                    self.digits.push(vec![0; self.all.len()]);
                }
                let digit = &mut self.digits[k][block as usize];
                (*digit, carry) = (*digit ^ carry, *digit & carry);
                k += 1;
            }
        }
    }

    /// Takes a set back that was added.
    pub fn remove(&mut self, set: &BlockSet) {
        for &(block, bits) in &set.blocks {
            let mut borrow = bits;
            for digit in &mut self.digits {
                let digit = &mut digit[block as usize];
                (*digit, borrow) = (*digit ^ borrow, !*digit & borrow);
            }
        }
    }

    /// The points of a block that are counted once.
    pub fn once(&self, block: u32) -> u64 {
        let block = block as usize;
        let more = self.digits[1..].iter().fold(0, |or, d| or | d[block]);
        self.digits[0][block] & !more
    }

    /// The points of a block that are never counted.
    pub fn never(&self, block: u32) -> u64 {
        let block = block as usize;
        self.all[block] & !self.digits.iter().fold(0, |or, d| or | d[block])
    }

    /// Words, one for each 64 points.
    pub fn blocks(&self) -> u32 {
        self.all.len() as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn counts_are_those_of_plain_numbers(sets in prop::collection::vec(prop::collection::vec(0u32..150, 0..80), 0..12)) {
            let mut plain = [0i32; 150];
            let mut counts = Counts::new(150);
            let mut kept: Vec<(BlockSet, Vec<u32>)> = Vec::new();
            for (number, mut places) in sets.into_iter().enumerate() {
                places.sort_unstable();
                places.dedup();
                let mut set = BlockSet::default();
                for &p in &places {
                    match set.blocks.last_mut() {
                        Some((block, bits)) if *block == p / 64 => *bits |= 1 << (p % 64),
                        _ => set.blocks.push((p / 64, 1 << (p % 64))),
                    }
                }
                let mut listed = Vec::new();
                set.list(&mut listed);
                prop_assert_eq!(&listed, &places);
                counts.add(&set);
                places.iter().for_each(|&p| plain[p as usize] += 1);
                kept.push((set, places));
                if number % 3 == 2 {
                    let (set, places) = kept.remove(0);
                    counts.remove(&set);
                    places.iter().for_each(|&p| plain[p as usize] -= 1);
                }
            }
            for block in 0..counts.blocks() {
                for i in 0..64 {
                    let count = plain.get(64 * block as usize + i);
                    prop_assert_eq!(counts.never(block) >> i & 1 == 1, count == Some(&0));
                    prop_assert_eq!(counts.once(block) >> i & 1 == 1, count == Some(&1));
                }
            }
        }
    }
}
