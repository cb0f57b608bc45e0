//! Times as percentiles, in constant memory.

use hdrhistogram::Histogram;
use serde::Serialize;

/// Longest time told apart, µs (one hour); longer ones count as this.
const LONGEST_US: u64 = 3_600_000_000;

/// Percentiles of a set of times, milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile.
    pub p999: f64,
    /// Largest.
    pub max: f64,
}

/// A histogram of times: 1 µs to 1 h, within 1 %.
#[derive(Clone, Debug)]
pub struct Percentiles(Histogram<u32>);

impl Default for Percentiles {
    fn default() -> Self {
        Self::new()
    }
}

impl Percentiles {
    /// No times yet.
    #[must_use]
    pub fn new() -> Self {
        match Histogram::new_with_bounds(1, LONGEST_US, 2) {
            Ok(histogram) => Self(histogram),
            Err(_) => unreachable!("the bounds are constants the histogram accepts"),
        }
    }

    /// Adds a time, ns. Negative times count as 0.
    pub fn record_ns(&mut self, ns: i64) {
        let us = u64::try_from(ns / 1000).unwrap_or(0);
        self.0.saturating_record(us);
    }

    /// The percentiles so far; all 0 where nothing was recorded.
    #[must_use]
    pub fn summary(&self) -> Summary {
        if self.0.is_empty() {
            return Summary::default();
        }
        let at = |q| self.0.value_at_quantile(q) as f64 * 1e-3;
        Summary {
            mean: self.0.mean() * 1e-3,
            p50: at(0.5),
            p95: at(0.95),
            p99: at(0.99),
            p999: at(0.999),
            max: self.0.max() as f64 * 1e-3,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_agree_with_a_sorted_list() {
        let mut histogram = Percentiles::new();
        for n in 1..=1000 {
            histogram.record_ns(n * 100_000);
        }
        let got = histogram.summary();
        for (name, got, want) in [
            ("p50", got.p50, 50.0),
            ("p95", got.p95, 95.0),
            ("p99", got.p99, 99.0),
            ("p999", got.p999, 99.9),
            ("max", got.max, 100.0),
        ] {
            assert!(
                (got - want).abs() <= 0.01 * want,
                "{name}: {got}, not {want}"
            );
        }
    }

    #[test]
    fn odd_times_are_kept_inside_the_range() {
        let mut histogram = Percentiles::new();
        histogram.record_ns(-5);
        histogram.record_ns(i64::MAX);
        assert!(histogram.summary().max >= 3.59e6);
        assert_eq!(Percentiles::new().summary(), Summary::default());
    }
}
