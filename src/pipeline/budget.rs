//! The latency budget: how much time a frame may still have, decided by a pure function.
//!
//! Costs are learnt (an exponentially weighted mean per unit of work), the clock is the caller's,
//! so every decision here can be replayed in a test.

use std::time::Duration;

/// What to do with a frame that cannot be finished in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Late {
    /// Model it as well as the time left allows; what is left is coded by the cheapest fallback.
    #[default]
    Degrade,
    /// Give the frame up before work is spent on it, and count it.
    Drop,
    /// Finish it, however long it takes. Live queues then drop their oldest.
    Wait,
}

/// The contract: the age a frame may have when it leaves, and what happens otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// Age a frame may have at the sink.
    pub limit: Duration,
    /// What to do with a frame that will be late.
    pub late: Late,
}

impl Budget {
    /// Every frame takes the time it needs.
    pub const UNLIMITED: Self = Self {
        limit: Duration::MAX,
        late: Late::Wait,
    };

    /// One period of a camera with `fps` frames per second, 33 ms where the rate is not known.
    #[must_use]
    pub fn one_period(fps: Option<f64>, late: Late) -> Self {
        let fps = fps.filter(|f| f.is_finite() && *f >= 0.1).unwrap_or(30.0);
        Self {
            limit: Duration::from_secs_f64(1.0 / fps),
            late,
        }
    }
}

/// Predicted cost of what a frame still needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkLeft {
    /// This stage.
    pub stage: Duration,
    /// Every stage after it.
    pub after: Duration,
}

/// The decision for one frame at one stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Go on without a time limit.
    Run,
    /// Go on and stop refining after this long.
    RunFor(Duration),
    /// Give the frame up.
    GiveUp,
}

/// The least share of the budget a degraded stage gets, so that every frame keeps its warm pass
/// however late it came.
const LEAST_SHARE: u32 = 8;

/// Decides what a frame of age `elapsed` with `work` before it may do.
#[must_use]
pub fn decide(elapsed: Duration, work: WorkLeft, budget: Budget) -> Decision {
    match budget.late {
        Late::Wait => Decision::Run,
        Late::Drop => {
            let finish = elapsed
                .saturating_add(work.stage)
                .saturating_add(work.after);
            if finish > budget.limit {
                Decision::GiveUp
            } else {
                Decision::Run
            }
        }
        Late::Degrade => {
            let left = budget
                .limit
                .saturating_sub(elapsed)
                .saturating_sub(work.after);
            Decision::RunFor(left.max(budget.limit / LEAST_SHARE))
        }
    }
}

/// A frame leaves much where at least one of so many points is on no sphere: coded plainly they take
/// sixteen bits each.
const MUCH: u64 = 8;

/// True where `left` of the `points` are many to code without a sphere.
#[must_use]
pub fn leaves_much(points: u64, left: u64) -> bool {
    left * MUCH > points
}

/// What coding a frame is likely to take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Coding {
    /// Whole.
    pub whole: Duration,
    /// Plain; zero before one was measured.
    pub plain: Duration,
}

impl Coding {
    /// The time the fit leaves to it. A fit from nothing, as of a stream's first frame, and one that
    /// has to catch up, as after a frame that was hurried, may have no time to end (they are
    /// `behind`): they get all that a plain coding leaves them.
    #[must_use]
    pub fn kept(&self, behind: bool) -> Duration {
        if behind && !self.plain.is_zero() {
            self.plain
        } else {
            self.whole
        }
    }

    /// True where a frame with so much `time` should be hurried: coded plainly where no sphere
    /// explains it. It then takes many more bits, so it must leave `much`, be `behind`, or take twice
    /// its time otherwise.
    #[must_use]
    pub fn hurries(&self, time: Duration, much: bool, behind: bool) -> bool {
        let most = if much || behind { time } else { 2 * time };
        self.whole > most && self.plain < self.whole
    }
}

/// The pixels a whole fit is likely to leave, where the last one left `left` of `points`: few,
/// unless most of them are on no surface, as in noise.
#[must_use]
pub fn likely_left(points: u64, left: u64) -> u64 {
    if left > points / 2 { left } else { 0 }
}

/// What one unit of work costs, learnt from what it cost before.
#[derive(Clone, Copy, Debug, Default)]
pub struct CostModel {
    ns_per_unit: f64,
}

impl CostModel {
    /// Weight of the newest measurement when it is dearer than the estimate: fear comes fast.
    const RISE: f64 = 0.5;
    /// The same when it is cheaper: confidence comes slowly.
    const FALL: f64 = 0.125;

    /// Takes a measurement: `units` of work took `spent`. Nothing is learnt from no work.
    pub fn observe(&mut self, units: u64, spent: Duration) {
        if units == 0 {
            return;
        }
        let measured = spent.as_nanos() as f64 / units as f64;
        let weight = if self.ns_per_unit == 0.0 {
            1.0
        } else if measured > self.ns_per_unit {
            Self::RISE
        } else {
            Self::FALL
        };
        self.ns_per_unit += weight * (measured - self.ns_per_unit);
    }

    /// What `units` of work will cost; zero before the first measurement (the first frame runs).
    #[must_use]
    pub fn predict(&self, units: u64) -> Duration {
        Duration::from_nanos((self.ns_per_unit * units as f64) as u64)
    }

    /// Forgets a little after a frame was given up: nothing was measured, and an estimate that
    /// nothing corrects would refuse every frame for ever.
    pub fn relax(&mut self) {
        self.ns_per_unit *= 0.9;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ms(n: u64) -> Duration {
        Duration::from_millis(n)
    }

    #[test]
    fn waiting_never_limits() {
        let work = WorkLeft {
            stage: ms(500),
            after: ms(500),
        };
        assert_eq!(decide(ms(900), work, Budget::UNLIMITED), Decision::Run);
    }

    #[test]
    fn dropping_gives_up_exactly_above_the_limit() {
        let budget = Budget {
            limit: ms(30),
            late: Late::Drop,
        };
        let work = WorkLeft {
            stage: ms(10),
            after: ms(5),
        };
        assert_eq!(decide(ms(15), work, budget), Decision::Run);
        assert_eq!(decide(ms(16), work, budget), Decision::GiveUp);
    }

    #[test]
    fn degrading_leaves_time_for_what_follows_and_never_starves() {
        let budget = Budget {
            limit: ms(32),
            late: Late::Degrade,
        };
        let work = WorkLeft {
            stage: ms(99),
            after: ms(6),
        };
        assert_eq!(decide(ms(6), work, budget), Decision::RunFor(ms(20)));
        assert_eq!(decide(ms(900), work, budget), Decision::RunFor(ms(4)));
    }

    #[test]
    fn only_late_frames_that_leave_much_are_hurried() {
        let coding = Coding {
            whole: ms(24),
            plain: ms(8),
        };
        assert!(leaves_much(1000, 126) && !leaves_much(1000, 125) && !leaves_much(0, 0));
        assert!(coding.hurries(ms(20), true, false));
        assert!(!coding.hurries(ms(24), true, false));
        assert!(!coding.hurries(ms(20), false, false));
        // a stream that is behind has its time shared out for it
        assert!(coding.hurries(ms(20), false, true));
        assert!(!coding.hurries(ms(24), false, true));
        // much too late, whatever it leaves
        assert!(coding.hurries(ms(11), false, false));
        // where it does not help it is not done
        let plain = ms(25);
        assert!(!Coding { plain, ..coding }.hurries(ms(5), true, true));
    }

    #[test]
    fn a_first_fit_gets_what_a_plain_coding_leaves() {
        let (whole, plain) = (ms(15), ms(5));
        let coding = Coding { whole, plain };
        assert_eq!(coding.kept(true), plain);
        assert_eq!(coding.kept(false), whole);
        let unknown = Coding {
            whole,
            plain: ms(0),
        };
        assert_eq!(unknown.kept(true), whole);
    }

    #[test]
    fn a_cold_first_frame_keeps_the_budget_at_any_cost_of_fit_and_coding() {
        // times in ms: what fit and codings would take, the fit's longest piece
        let limit = ms(33);
        let budget = Budget {
            limit,
            late: Late::Degrade,
        };
        for fit in [5, 20, 60, 500] {
            for whole in [5, 10, 20, 80] {
                let coding = Coding {
                    whole: ms(whole),
                    plain: ms(6),
                };
                let piece = ms(1);
                let work = WorkLeft {
                    after: coding.kept(true),
                    ..WorkLeft::default()
                };
                let Decision::RunFor(most) = decide(ms(0), work, budget) else {
                    panic!("it is not limited");
                };
                let fitted = ms(fit).min(most + piece);
                // what a cut fit leaves is dear to code
                let left = if ms(fit) > most { 300 } else { 0 };
                let dear = Coding {
                    whole: coding.whole * if left > 0 { 4 } else { 1 },
                    ..coding
                };
                let work = WorkLeft::default();
                let Decision::RunFor(time) = decide(fitted, work, budget) else {
                    panic!("it is not limited");
                };
                let hurried = dear.hurries(time, leaves_much(1000, left), true);
                let age = fitted + if hurried { dear.plain } else { dear.whole };
                let most = limit + piece;
                assert!(age <= most, "fit {fit}, coding {whole}: {age:?}");
            }
        }
    }

    #[test]
    fn the_default_budget_is_one_period() {
        let limit = |fps| Budget::one_period(fps, Late::Degrade).limit;
        assert_eq!(limit(Some(50.0)), ms(20));
        assert_eq!(limit(None), limit(Some(30.0)));
        assert_eq!(limit(Some(f64::NAN)), limit(None));
        assert_eq!(limit(Some(0.0)), limit(None));
    }

    /// One worker, frames every `period`, the newest waits (latest wins). `cost(n)` is what frame
    /// n would take unlimited, `floor` what it takes at least. Returns (ages of finished frames,
    /// degraded, given up), by frame.
    fn simulate(
        budget: Budget,
        period: u64,
        floor: u64,
        encode: u64,
        costs: &[u64],
    ) -> Vec<Option<(u64, bool)>> {
        let mut cost = CostModel::default();
        let mut now = 0u64;
        let mut out = Vec::new();
        for (n, &want) in costs.iter().enumerate() {
            let stamp = n as u64 * period;
            // a newer frame is already there: this one was evicted from the queue
            if n + 1 < costs.len() && now >= stamp + period {
                out.push(None);
                continue;
            }
            now = now.max(stamp);
            let work = WorkLeft {
                stage: cost.predict(1),
                after: Duration::from_nanos(encode),
            };
            let spent = match decide(Duration::from_nanos(now - stamp), work, budget) {
                Decision::Run => want,
                Decision::RunFor(most) => want.min((most.as_nanos() as u64).max(floor)),
                Decision::GiveUp => {
                    cost.relax();
                    out.push(None);
                    continue;
                }
            };
            cost.observe(1, Duration::from_nanos(spent));
            now += spent + encode;
            out.push(Some((now - stamp, spent < want)));
        }
        out
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Whatever the scene costs, a degraded frame's age is bounded by a frame's wait, its
        /// share of the budget and the coding; and once the scene is easy again nothing degrades.
        #[test]
        fn degraded_age_is_bounded_and_recovers(
            hard in proptest::collection::vec(1_000u64..1_000_000_000, 1..60),
            period in 10_000_000u64..50_000_000,
        ) {
            let budget = Budget { limit: Duration::from_nanos(period), late: Late::Degrade };
            let (floor, encode) = (period / 8, period / 8);
            let mut costs = hard;
            costs.extend(std::iter::repeat_n(period / 4, 10));
            let out = simulate(budget, period, floor, encode, &costs);
            let bound = period + period / 4 + 2;
            for (n, frame) in out.iter().enumerate() {
                if let Some((age, _)) = frame {
                    prop_assert!(*age <= bound, "frame {}: age {} over {}", n, age, bound);
                }
            }
            for (n, frame) in out.iter().enumerate().skip(out.len() - 5) {
                prop_assert_eq!(frame.map(|f| f.1), Some(false), "frame {} still degraded", n);
            }
        }

        /// Dropping: the policy recovers from any burst, since given-up frames fade the fear.
        #[test]
        fn dropping_recovers(hard in proptest::collection::vec(1_000u64..1_000_000_000, 1..20)) {
            let period = 33_000_000;
            let budget = Budget { limit: Duration::from_nanos(period), late: Late::Drop };
            let mut costs = hard;
            costs.extend(std::iter::repeat_n(period / 4, 120));
            let out = simulate(budget, period, 0, period / 8, &costs);
            for frame in &out[out.len() - 5..] {
                prop_assert!(frame.is_some_and(|(age, _)| age <= period));
            }
        }

        /// The estimate stays between the least and the most that was measured.
        #[test]
        fn the_cost_model_stays_inside_its_measurements(
            seen in proptest::collection::vec((1u64..1000, 1u64..1_000_000), 1..50),
        ) {
            let mut cost = CostModel::default();
            let (mut low, mut high) = (f64::MAX, 0f64);
            for (units, ns) in seen {
                cost.observe(units, Duration::from_nanos(ns));
                let per = ns as f64 / units as f64;
                (low, high) = (low.min(per), high.max(per));
                let got = cost.predict(1_000_000).as_nanos() as f64 / 1e6;
                prop_assert!(got >= low - 1e-6 && got <= high + 1e-6, "{} outside {}..{}", got, low, high);
            }
        }
    }
}
