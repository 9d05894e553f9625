//! Times of a run: stages with their parts, each with wall seconds and processor seconds.
//!
//! The thread that leads a run opens stages; while a parallel loop runs, that thread waits. So its own processor time
//! is the work that kept all other threads waiting, independent of other load on the machine. [`concurrently`] adds the
//! time during which it waits for one other thread. Stages that other threads open are in their own record.
//!
//! ```
//! use heliosplat::timeline;
//! {
//!     let _whole = timeline::stage("whole");
//!     let _part = timeline::stage("part");
//! }
//! let stages = timeline::take();
//! assert_eq!((stages[0].stage, stages[0].parts[0].stage), ("whole", "part"));
//! ```

use serde::Serialize;
use std::cell::RefCell;
use std::time::Instant;

/// Times of a stage, summed over its runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stage {
    /// Name of the stage.
    pub stage: &'static str,
    /// Wall time, seconds.
    pub wall_s: f64,
    /// Processor time of all threads of the process, seconds; zero where the system does not measure it.
    pub processor_s: f64,
    /// Processor time of the leading thread, and of one that it waited for, seconds: work that ran on one core.
    pub one_core_s: f64,
    /// Mean number of threads in use: processor seconds per wall second.
    pub threads: f64,
    /// Stages within it, in the order of their first run.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<Stage>,
}

impl Stage {
    fn new(stage: &'static str) -> Self {
        Self {
            stage,
            wall_s: 0.0,
            processor_s: 0.0,
            one_core_s: 0.0,
            threads: 0.0,
            parts: Vec::new(),
        }
    }
}

/// The record of one thread.
#[derive(Default)]
struct Record {
    stages: Vec<Stage>,
    /// Places of the open stages, the outermost first.
    open: Vec<usize>,
    /// Processor seconds of single threads that this one waited for.
    waited_s: f64,
}

impl Record {
    /// The siblings of the `depth`-th open stage.
    fn level(&mut self, depth: usize) -> &mut Vec<Stage> {
        let mut level = &mut self.stages;
        for &place in &self.open[..depth] {
            level = &mut level[place].parts;
        }
        level
    }
}

thread_local! {
    static RECORD: RefCell<Record> = RefCell::default();
}

/// The clocks at one moment.
struct Clocks {
    wall: Instant,
    processor_s: f64,
    thread_s: f64,
}

impl Clocks {
    fn now() -> Self {
        let [processor_s, thread_s] = processor_seconds();
        Self {
            wall: Instant::now(),
            processor_s,
            thread_s: thread_s + RECORD.with_borrow(|record| record.waited_s),
        }
    }

    /// Counts the processor time of other threads since then as work on one core, at most the wall time less this
    /// thread's own.
    fn count_wait(&self) {
        let now = Self::now();
        let wall_s = (now.wall - self.wall).as_secs_f64();
        let others_s = (now.processor_s - self.processor_s).min(wall_s) - (now.thread_s - self.thread_s);
        RECORD.with_borrow_mut(|record| record.waited_s += others_s.max(0.0));
    }
}

/// Processor seconds of the process and of this thread.
#[cfg(unix)]
fn processor_seconds() -> [f64; 2] {
    use rustix::time::{ClockId, clock_gettime};
    [ClockId::ProcessCPUTime, ClockId::ThreadCPUTime].map(|clock| {
        let time = clock_gettime(clock);
        time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
    })
}

#[cfg(not(unix))]
fn processor_seconds() -> [f64; 2] {
    [0.0; 2]
}

/// A stage that is under way; it ends when this value is dropped, on the thread that opened it.
#[must_use = "a stage ends when this is dropped"]
pub struct Running {
    begun: Clocks,
    /// A stage ends on the thread whose record it is in.
    _same_thread: std::marker::PhantomData<*const ()>,
}

/// Opens a stage within the innermost one that is open on this thread. An earlier stage of the same name there
/// continues.
pub fn stage(name: &'static str) -> Running {
    RECORD.with_borrow_mut(|record| {
        let depth = record.open.len();
        let level = record.level(depth);
        let place = level.iter().position(|stage| stage.stage == name).unwrap_or_else(|| {
            level.push(Stage::new(name));
            level.len() - 1
        });
        record.open.push(place);
    });
    Running {
        begun: Clocks::now(),
        _same_thread: std::marker::PhantomData,
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let now = Clocks::now();
        RECORD.with_borrow_mut(|record| {
            let Some(place) = record.open.pop() else { return };
            let depth = record.open.len();
            // Absent where the record was taken meanwhile.
            let Some(stage) = record.level(depth).get_mut(place) else {
                return;
            };
            stage.wall_s += (now.wall - self.begun.wall).as_secs_f64();
            stage.processor_s += now.processor_s - self.begun.processor_s;
            stage.one_core_s += now.thread_s - self.begun.thread_s;
            stage.threads = stage.processor_s / stage.wall_s.max(1e-9);
        });
    }
}

/// Takes the finished stages of this thread, whose record starts anew. Call it while no stage is open.
pub fn take() -> Vec<Stage> {
    RECORD.take().stages
}

/// Runs `lead` on this thread, with its stages in this thread's record, and `aside` on another. Time waited for `aside`
/// after `lead` counts as work on one core.
pub fn concurrently<A: Send, B>(aside: impl FnOnce() -> A + Send, lead: impl FnOnce() -> B) -> (A, B) {
    let mut done = None;
    let (led, waits) = rayon::in_place_scope(|scope| {
        let done = &mut done;
        scope.spawn(move |_| *done = Some(aside()));
        (lead(), Clocks::now())
    });
    waits.count_wait();
    match done {
        Some(done) => (done, led),
        None => unreachable!("a scope ends when all that it spawned has"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    /// Keeps one thread busy for about this many milliseconds of its own processor time.
    fn work(milliseconds: f64) {
        let begun = Clocks::now().thread_s;
        while Clocks::now().thread_s - begun < 1e-3 * milliseconds {
            std::hint::black_box((0..1000).sum::<u64>());
        }
    }

    #[test]
    fn a_stage_that_runs_again_is_the_same_stage_and_parts_stand_within() {
        take();
        for _ in 0..2 {
            let _outer = stage("outer");
            drop(stage("first"));
            drop(stage("second"));
        }
        drop(stage("after"));
        let stages = take();
        let names = |stages: &[Stage]| stages.iter().map(|s| s.stage).collect::<Vec<_>>();
        assert_eq!(names(&stages), ["outer", "after"]);
        assert_eq!(names(&stages[0].parts), ["first", "second"]);
        assert!(take().is_empty());
    }

    #[test]
    #[cfg(unix)]
    fn work_of_the_leading_thread_counts_as_one_core_and_that_of_a_pool_does_not() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("a pool");
        take();
        {
            let _alone = stage("alone");
            work(30.0);
        }
        {
            let _pooled = stage("pooled");
            pool.install(|| (0..4).into_par_iter().for_each(|_| work(10.0)));
        }
        let stages = take();
        let (alone, pooled) = (&stages[0], &stages[1]);
        assert!(alone.one_core_s >= 0.029 && alone.processor_s >= 0.029, "{alone:?}");
        assert!(pooled.processor_s >= 0.039 && pooled.one_core_s < 0.01, "{pooled:?}");
    }

    #[test]
    #[cfg(unix)]
    fn work_of_one_other_thread_counts_as_one_core_where_the_leading_one_waits_for_it() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
        take();
        {
            let _waited = stage("waited");
            let _within = stage("within");
            concurrently(|| pool.install(|| work(30.0)), || ());
        }
        {
            let _short = stage("short");
            assert_eq!(
                concurrently(
                    || work(5.0),
                    || {
                        work(60.0);
                        7
                    }
                ),
                ((), 7)
            );
        }
        {
            let _long = stage("long");
            concurrently(|| work(60.0), || work(5.0));
        }
        let stages = take();
        assert!(
            stages[0].one_core_s >= 0.029 && stages[0].parts[0].one_core_s >= 0.029,
            "{stages:?}"
        );
        // The clocks of the process are read a moment after those of the thread.
        let most_s = |stage: &Stage| stage.processor_s + 1e-3;
        assert!(
            stages.iter().all(|stage| stage.one_core_s <= most_s(stage)),
            "{stages:?}"
        );
        assert!(stages[1].one_core_s >= 0.059, "{stages:?}");
        assert!(
            stages[2].one_core_s >= 0.03,
            "what is left of the long work: {stages:?}"
        );
    }
}
