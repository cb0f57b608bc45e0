//! What the threads of a run ask of the system: workers for the model stage, and priority.
//!
//! *Workers.* The model stage's own thread is the first worker of its pool: the fit is not handed
//! to other threads and back at each pass, and with one worker it runs as it does alone. How many
//! are worth while is for the caller to say ([`super::Options::stage_threads`]).
//!
//! *Priority.* Where it is asked for, the stages ask for the round-robin real-time class, all at the
//! same priority: the channels between them spin for moments and give way to their equals only, so
//! that a higher one could wait for a lower one for ever. For the same reason nothing is asked for
//! where the caller's thread computes. Without the right to that class they ask for a better nice
//! value, and without that right too they run as they are. The report says what came of it.

use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::Serialize;
use std::sync::atomic::{AtomicU8, Ordering};
use thread_priority::ThreadPriority;
use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ScheduleParams, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

/// Priority in the real-time class, low on its scale of 1 to 99.
const RANK: i32 = 2;
/// Nice value where the real-time class is refused.
const NICE: i32 = -10;

/// How the threads of the stages are scheduled, least first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Priority {
    /// As other programs.
    #[default]
    Usual,
    /// Before other programs (nice value −10).
    Nice,
    /// Before all that is not real-time (`SCHED_RR`).
    Realtime,
}

/// What the threads of a run asked for, and what the least of them got.
#[derive(Debug)]
pub(super) struct Schedule {
    asked: Priority,
    refused: AtomicU8,
}

impl Schedule {
    pub(super) fn new(asked: Priority) -> Self {
        Self {
            asked,
            refused: AtomicU8::new(0),
        }
    }

    /// Asks for the calling thread.
    pub(super) fn enter(&self) {
        let got = match self.asked {
            Priority::Usual => return,
            Priority::Realtime if realtime() => Priority::Realtime,
            _ if rustix::process::setpriority_process(None, NICE).is_ok() => Priority::Nice,
            _ => Priority::Usual,
        };
        let short = self.asked as u8 - got as u8;
        if self.refused.fetch_max(short, Ordering::Relaxed) < short {
            let instead = match got {
                Priority::Usual => "the usual one",
                _ => "nice value -10",
            };
            tracing::warn!(
                "real-time priority is refused, {instead} is used instead; it needs CAP_SYS_NICE or `ulimit -r 5`"
            );
        }
    }

    /// What every thread got; `None` where nothing was asked for.
    pub(super) fn got(&self) -> Option<Priority> {
        let least = (self.asked as u8).saturating_sub(self.refused.load(Ordering::Relaxed));
        (self.asked != Priority::Usual).then_some(match least {
            0 => Priority::Usual,
            1 => Priority::Nice,
            _ => Priority::Realtime,
        })
    }
}

/// Puts the calling thread into the real-time class.
fn realtime() -> bool {
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::RoundRobin);
    let priority = ThreadPriority::from_posix(ScheduleParams {
        sched_priority: RANK,
    });
    set_thread_priority_and_policy(thread_native_id(), priority, policy).is_ok()
}

/// A pool of `count` workers, the calling thread first. With 0, or where the system has no more
/// threads, none: the process's common pool then does the work.
pub(super) fn workers(count: usize) -> Option<ThreadPool> {
    if count == 0 {
        return None;
    }
    ThreadPoolBuilder::new()
        .num_threads(count)
        .thread_name(|n| format!("model-{n}"))
        .use_current_thread()
        .build()
        .ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rights differ from machine to machine; what is said must be what the kernel says.
    #[test]
    fn what_is_told_is_what_the_thread_got() {
        for asked in [Priority::Usual, Priority::Nice, Priority::Realtime] {
            let schedule = Schedule::new(asked);
            std::thread::scope(|scope| {
                scope.spawn(|| {
                    let before = rustix::process::getpriority_process(None).unwrap();
                    schedule.enter();
                    let policy = thread_priority::unix::thread_schedule_policy().unwrap();
                    let nice = rustix::process::getpriority_process(None).unwrap();
                    match schedule.got() {
                        Some(Priority::Realtime) => {
                            assert!(matches!(policy, ThreadSchedulePolicy::Realtime(_)))
                        }
                        Some(Priority::Nice) => assert_eq!(nice, NICE),
                        Some(Priority::Usual) | None => assert_eq!(nice, before),
                    }
                    assert!(schedule.got() <= Some(asked));
                });
            });
        }
    }

    #[test]
    fn one_refusal_is_what_counts() {
        let schedule = Schedule::new(Priority::Realtime);
        schedule.refused.fetch_max(2, Ordering::Relaxed);
        schedule.refused.fetch_max(0, Ordering::Relaxed);
        assert_eq!(schedule.got(), Some(Priority::Usual));
        assert_eq!(Schedule::new(Priority::Usual).got(), None);
    }

    #[test]
    fn the_first_worker_is_the_thread_itself() {
        let inside = std::thread::scope(|scope| {
            let thread = scope.spawn(|| {
                let pool = workers(2);
                (
                    pool.is_some(),
                    rayon::current_num_threads(),
                    rayon::current_thread_index(),
                )
            });
            thread.join().unwrap()
        });
        assert_eq!(inside, (true, 2, Some(0)));
        assert!(workers(0).is_none());
    }
}
