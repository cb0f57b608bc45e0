//! Correlated normal noise, one image row at a time.
//!
//! White integers of chance, summed over a square window: a matcher that compares windows gives
//! errors that are alike over the window. 9 or more uniforms in a sum are normal enough. Running
//! column sums make it O(pixels), whatever the window; all integer, so exact in any order.

use super::random::scatter;
use multiversion::multiversion;

/// White noise of one frame: a part that stays (and moves with the picture), a part that is new.
#[derive(Clone, Copy, Debug)]
pub(super) struct White {
    /// Key of the lasting part: constant over a stream.
    pub lasting: u32,
    /// Key of the fleeting part: the frame's own.
    pub fleeting: u32,
    /// Shift of the lasting pattern, pixels (x, y).
    pub shift: (i32, i32),
}

/// Amplitudes (×1/256) of the lasting and the fleeting part of the two fields. Depth noise: half
/// of the variance stays. Hole noise: nine tenths stay, so masks flicker at their borders only.
const DEPTH_MIX: (i32, i32) = (181, 181);
const HOLE_MIX: (i32, i32) = (243, 81);
/// Standard deviation of a uniform 16-bit integer.
const UNIFORM_SIGMA: f64 = 65536.0 / 3.464_101_615_137_754_6;
/// Counters per row of the endless pattern, an odd number above any width.
const PITCH: u32 = 16411;

impl White {
    /// Fills one row of both fields' white noise, starting at column 0.
    pub fn row(&self, y: i32, depth: &mut [i32], hole: &mut [i32]) {
        let counter = |x: i32, y: i32| (y as u32).wrapping_mul(PITCH).wrapping_add(x as u32);
        let lasting = counter(self.shift.0, y.wrapping_add(self.shift.1));
        white_row(
            lasting.wrapping_add(self.lasting),
            counter(0, y).wrapping_add(self.fleeting),
            depth,
            hole,
        );
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn white_row(lasting: u32, fleeting: u32, depth: &mut [i32], hole: &mut [i32]) {
    let width = depth.len();
    assert_eq!(width, hole.len());
    let low = |bits: u32| (bits & 0xffff) as i32 - 0x8000;
    let high = |bits: u32| (bits >> 16) as i32 - 0x8000;
    for x in 0..width {
        let stays = scatter(lasting.wrapping_add(x as u32));
        let new = scatter(fleeting.wrapping_add(x as u32));
        depth[x] = (low(stays) * DEPTH_MIX.0 + low(new) * DEPTH_MIX.1) >> 8;
        hole[x] = (high(stays) * HOLE_MIX.0 + high(new) * HOLE_MIX.1) >> 8;
    }
}

/// Which field: their variances differ by their mix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Depth,
    Hole,
}

/// The moving window over one field.
#[derive(Debug)]
pub(super) struct Window {
    side: usize,
    /// The last `side` white rows, `width + side - 1` long each.
    rows: Vec<i32>,
    next: usize,
    columns: Vec<i32>,
    sums: Vec<i32>,
    scale: f32,
}

impl Window {
    pub fn new(kind: Kind, side: usize, width: usize) -> Self {
        let (a, b) = match kind {
            Kind::Depth => DEPTH_MIX,
            Kind::Hole => HOLE_MIX,
        };
        let amplitude = f64::from(a).hypot(f64::from(b)) / 256.0;
        let padded = width + side - 1;
        Self {
            side,
            rows: vec![0; padded * side],
            next: 0,
            columns: vec![0; padded],
            sums: vec![0; width],
            scale: (1.0 / (UNIFORM_SIGMA * amplitude * side as f64)) as f32,
        }
    }

    /// White values wanted per row.
    pub fn padded(&self) -> usize {
        self.columns.len()
    }

    /// Forgets the rows of the frame before.
    pub fn restart(&mut self) {
        self.rows.fill(0);
        self.columns.fill(0);
    }

    /// Takes one white row in, the oldest out.
    pub fn push(&mut self, white: &[i32]) {
        let padded = self.columns.len();
        let oldest = &mut self.rows[self.next * padded..(self.next + 1) * padded];
        slide(&mut self.columns, oldest, &white[..padded]);
        self.next = (self.next + 1) % self.side;
    }

    /// The field's current row: mean 0, standard deviation 1, `width` values.
    pub fn normal(&mut self, out: &mut [f32]) {
        sum_windows(&self.columns, self.side, &mut self.sums);
        for (out, &sum) in out.iter_mut().zip(&self.sums) {
            *out = sum as f32 * self.scale;
        }
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn slide(columns: &mut [i32], oldest: &mut [i32], newest: &[i32]) {
    assert!(columns.len() == oldest.len() && columns.len() == newest.len());
    for ((column, old), &new) in columns.iter_mut().zip(oldest).zip(newest) {
        *column += new - *old;
        *old = new;
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn sum_windows(columns: &[i32], side: usize, sums: &mut [i32]) {
    let width = sums.len();
    sums.copy_from_slice(&columns[..width]);
    for offset in 1..side {
        for (sum, &column) in sums.iter_mut().zip(&columns[offset..offset + width]) {
            *sum += column;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(side: usize, kind: Kind, fleeting: u32) -> Vec<Vec<f32>> {
        let (width, height) = (640, 240);
        let mut window = Window::new(kind, side, width);
        let white = White {
            lasting: 7,
            fleeting,
            shift: (0, 0),
        };
        let (mut a, mut b) = (vec![0; window.padded()], vec![0; window.padded()]);
        let mut rows = Vec::new();
        for y in 0..height + side - 1 {
            white.row(y as i32, &mut a, &mut b);
            window.push(if kind == Kind::Depth { &a } else { &b });
            if y + 1 >= side {
                let mut row = vec![0.0; width];
                window.normal(&mut row);
                rows.push(row);
            }
        }
        rows
    }

    fn correlation(a: impl Iterator<Item = f32>, b: impl Iterator<Item = f32>) -> f64 {
        let (mut ab, mut n) = (0.0, 0.0);
        for (a, b) in a.zip(b) {
            ab += f64::from(a) * f64::from(b);
            n += 1.0;
        }
        ab / n
    }

    #[test]
    fn a_field_is_normal_and_correlated_over_its_window_only() {
        let rows = field(5, Kind::Depth, 99);
        let all = || rows.iter().flatten().copied();
        let mean = all().map(f64::from).sum::<f64>() / all().count() as f64;
        assert!(mean.abs() < 0.05, "mean {mean}");
        let variance = correlation(all(), all());
        assert!((variance - 1.0).abs() < 0.08, "variance {variance}");
        let beyond_2 = all().filter(|n| n.abs() > 2.0).count() as f64 / all().count() as f64;
        assert!(
            (beyond_2 - 0.0455).abs() < 0.01,
            "beyond 2 sigma {beyond_2}"
        );
        for (lag, expected) in [(1, 0.8), (3, 0.4), (5, 0.0), (9, 0.0)] {
            let shifted = rows.iter().flat_map(|r| r[lag..].iter().copied());
            let here = rows.iter().flat_map(|r| r[..r.len() - lag].iter().copied());
            let found = correlation(here, shifted);
            assert!((found - expected).abs() < 0.07, "lag {lag}: {found}");
        }
    }

    #[test]
    fn half_of_the_depth_noise_and_most_of_the_hole_noise_stays() {
        for (kind, expected) in [(Kind::Depth, 0.5), (Kind::Hole, 0.9)] {
            let (one, two) = (field(3, kind, 99), field(3, kind, 1_000_099));
            let found = correlation(one.into_iter().flatten(), two.into_iter().flatten());
            assert!((found - expected).abs() < 0.05, "{kind:?}: {found}");
        }
    }
}
