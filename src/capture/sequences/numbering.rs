//! Order and numbers of image files: `frame2` comes before `frame10`, a missing number is a gap.

use super::timestamps::{NANOSECOND_DIGITS, nanoseconds};
use std::cmp::Ordering;
use std::path::{Path, PathBuf};

/// Orders names as people count: runs of digits by their value, the rest by bytes.
///
/// A total order: names that differ only in leading zeros are ordered by their bytes.
#[must_use]
pub fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a.as_bytes(), b.as_bytes());
    loop {
        let (Some(&x), Some(&y)) = (left.first(), right.first()) else {
            return left.len().cmp(&right.len()).then_with(|| a.cmp(b));
        };
        if x.is_ascii_digit() && y.is_ascii_digit() {
            let (run_x, run_y) = (digits(left), digits(right));
            let (value_x, value_y) = (significant(run_x), significant(run_y));
            let order = value_x
                .len()
                .cmp(&value_y.len())
                .then_with(|| value_x.cmp(value_y));
            if order != Ordering::Equal {
                return order;
            }
            (left, right) = (&left[run_x.len()..], &right[run_y.len()..]);
        } else if x == y {
            (left, right) = (&left[1..], &right[1..]);
        } else {
            return x.cmp(&y);
        }
    }
}

fn digits(text: &[u8]) -> &[u8] {
    let end = text.iter().position(|c| !c.is_ascii_digit());
    &text[..end.unwrap_or(text.len())]
}

fn significant(digits: &[u8]) -> &[u8] {
    let start = digits.iter().position(|c| *c != b'0');
    &digits[start.unwrap_or(digits.len())..]
}

/// The runs of digits in a file's name without its extension.
fn runs(path: &Path) -> Vec<String> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    stem.split(|c: char| !c.is_ascii_digit())
        .filter(|run| !run.is_empty())
        .map(str::to_owned)
        .collect()
}

/// Sorts `files` naturally and numbers them.
///
/// The number is the last run of digits that is not the same in all names. Files whose numbers
/// do not grow, or that have none, are numbered by position.
pub(super) fn number(mut files: Vec<PathBuf>) -> Vec<(u64, PathBuf)> {
    files.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    let names: Vec<Vec<String>> = files.iter().map(|path| runs(path)).collect();
    let last = names.first().map_or(0, Vec::len);
    let same_shape = names.iter().all(|runs| runs.len() == last);
    let column = (0..last)
        .rev()
        .find(|&at| names.iter().any(|runs| runs.get(at) != names[0].get(at)))
        .or_else(|| last.checked_sub(1));
    // A time is no frame number: its fraction jumps, and every step would be a gap.
    let times = files.iter().all(|path| time_name(path).is_some());
    let numbers: Option<Vec<u64>> = column
        .filter(|_| same_shape && !times)
        .and_then(|at| names.iter().map(|runs| runs[at].parse().ok()).collect());
    let growing = numbers
        .as_ref()
        .is_some_and(|numbers| numbers.windows(2).all(|pair| pair[0] < pair[1]));
    match numbers.filter(|_| growing) {
        Some(numbers) => numbers.into_iter().zip(files).collect(),
        None => (0..).zip(files).collect(),
    }
}

/// The time a file is named by, ns: `1305031102.160407.png`, `1403636579763555584.png`.
pub(super) fn time_name(path: &Path) -> Option<i64> {
    let stem = path.file_stem()?.to_str()?;
    let is_time = stem.contains('.') || stem.len() >= NANOSECOND_DIGITS;
    nanoseconds(stem).filter(|_| is_time && !stem.starts_with('-'))
}

/// Numbers missing between `numbers` (growing): how many, and the first.
pub(super) fn gaps(numbers: impl Iterator<Item = u64>) -> (u64, Option<u64>) {
    let mut missing = 0u64;
    let mut first = None;
    let mut previous: Option<u64> = None;
    for number in numbers {
        if let Some(previous) = previous {
            let skipped = number.saturating_sub(previous).saturating_sub(1);
            if skipped > 0 {
                missing = missing.saturating_add(skipped);
                first = first.or(Some(previous + 1));
            }
        }
        previous = Some(number);
    }
    (missing, first)
}

/// A file name with one `%d` or `%06d`, as printf writes it.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Pattern {
    prefix: String,
    suffix: String,
    /// Smallest number of characters, and whether they are filled with zeros (else spaces).
    width: usize,
    zeros: bool,
}

impl Pattern {
    /// Reads a pattern; `None` if `name` has no conversion, or more than one.
    pub(super) fn parse(name: &str) -> Option<Self> {
        let (prefix, rest) = name.split_once('%')?;
        let zeros = rest.starts_with('0');
        let end = rest.find(|c: char| !c.is_ascii_digit())?;
        let width = if end == 0 {
            0
        } else {
            rest[..end].parse().ok()?
        };
        let suffix = rest[end..].strip_prefix(['d', 'u', 'i'])?;
        (width <= 20 && !suffix.contains('%')).then(|| Self {
            prefix: prefix.to_owned(),
            suffix: suffix.to_owned(),
            width,
            zeros,
        })
    }

    /// The number in `name` if printf would have written that name.
    pub(super) fn number(&self, name: &str) -> Option<u64> {
        let text = name
            .strip_prefix(&self.prefix)?
            .strip_suffix(&self.suffix)?;
        let number: u64 = text.trim_start_matches(' ').parse().ok()?;
        let written = if self.zeros {
            format!("{number:0width$}", width = self.width)
        } else {
            format!("{number:width$}", width = self.width)
        };
        (written == text).then_some(number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn numbers(names: &[&str]) -> Vec<u64> {
        let files = names.iter().map(PathBuf::from).collect();
        number(files)
            .into_iter()
            .map(|(number, _)| number)
            .collect()
    }

    #[test]
    fn numbers_come_from_the_run_that_changes() {
        assert_eq!(numbers(&["frame10.png", "frame2.png"]), [2, 10]);
        assert_eq!(numbers(&["d435_0001_z.png", "d435_0003_z.png"]), [1, 3]);
        assert_eq!(numbers(&["007.png"]), [7]);
        assert_eq!(numbers(&["0001_d435.png", "0002_d435.png"]), [1, 2]);
    }

    #[test]
    fn names_without_growing_numbers_are_counted() {
        assert_eq!(numbers(&["a.png", "b.png"]), [0, 1]);
        assert_eq!(numbers(&["1.png", "01.png"]), [0, 1]);
        assert_eq!(numbers(&["1.5.png", "2.4.png"]), [0, 1]);
        assert_eq!(
            numbers(&["1403636579763555584.png", "1403636579813555456.png"]),
            [0, 1]
        );
        assert_eq!(numbers(&["a1.png", "b1c2.png"]), [0, 1]);
        assert_eq!(numbers(&["99999999999999999999999.png"]), [0]);
        assert_eq!(numbers(&[]), [0u64; 0]);
    }

    #[test]
    fn gaps_are_counted() {
        assert_eq!(gaps([3, 4, 7, 9].into_iter()), (3, Some(5)));
        assert_eq!(gaps([0, 1, 2].into_iter()), (0, None));
        assert_eq!(gaps([0, u64::MAX].into_iter()), (u64::MAX - 1, Some(1)));
        assert_eq!(gaps(std::iter::empty()), (0, None));
    }

    #[test]
    fn patterns_match_what_printf_writes() {
        let six = Pattern::parse("depth_%06d.exr").unwrap();
        assert_eq!(six.number("depth_000012.exr"), Some(12));
        assert_eq!(six.number("depth_1234567.exr"), Some(1_234_567));
        assert_eq!(six.number("depth_0012.exr"), None);
        assert_eq!(six.number("depth_0000012.exr"), None);
        assert_eq!(six.number("depth_.exr"), None);
        let plain = Pattern::parse("%d.png").unwrap();
        assert_eq!(plain.number("12.png"), Some(12));
        assert_eq!(plain.number("012.png"), None);
        assert_eq!(plain.number("+12.png"), None);
        let spaces = Pattern::parse("%4d.png").unwrap();
        assert_eq!(spaces.number("  12.png"), Some(12));
        for not in [
            "depth.png",
            "100%.png",
            "%s.png",
            "%d_%d.png",
            "%099d.png",
            "%",
        ] {
            assert_eq!(Pattern::parse(not), None, "{not}");
        }
    }

    fn name() -> impl Strategy<Value = String> {
        "[a-b_.0-3]{0,9}"
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(512))]

        #[test]
        fn natural_order_is_total(a in name(), b in name(), c in name()) {
            prop_assert_eq!(natural_order(&a, &b), natural_order(&b, &a).reverse());
            prop_assert_eq!(natural_order(&a, &b) == Ordering::Equal, a == b);
            let mut sorted = [a, b, c];
            sorted.sort_by(|x, y| natural_order(x, y));
            prop_assert_ne!(natural_order(&sorted[0], &sorted[2]), Ordering::Greater);
        }

        #[test]
        fn natural_order_counts(prefix in "[a-z_]{0,4}", a: u64, b: u64, zeros in 0usize..24) {
            let (x, y) = (format!("{prefix}{a:0zeros$}.png"), format!("{prefix}{b}.png"));
            prop_assume!(a != b);
            prop_assert_eq!(natural_order(&x, &y), a.cmp(&b));
        }

        #[test]
        fn printf_names_are_found(number: u64, width in 0usize..12) {
            let pattern = Pattern::parse(&format!("d_%0{width}d.png")).unwrap();
            prop_assert_eq!(pattern.number(&format!("d_{number:0width$}.png")), Some(number));
        }
    }
}
