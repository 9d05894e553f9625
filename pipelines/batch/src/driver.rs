//! Runs all units of a batch on this machine, a few at a time, each in its own process.
//!
//! The standard input of a unit's process is a pipe that closes when this process ends, even if it is killed. The unit
//! then saves its state and ends, and the next batch resumes from there.

use super::plan::{Plan, Unit};
use super::row::{self, log_of};
use super::stamp::{finished, other_build};
use super::{BatchError, Result};
use heliosplat_fitting::program::build;
use heliosplat_fitting::run_folder::create_folder;
use heliosplat_pages::summary::{Row, State};
use heliosplat_session::{Progress, Session, about_left};
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Time between two checks of the running units.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Number of checks between two readings of their logs.
const LOOKS_PER_READING: usize = 10;
/// Bytes at the end of a log that are read for its last lines.
const TAIL: u64 = 4096;
/// Most characters of a log line that are shown.
const SHOWN: usize = 70;

/// Units of a batch and the settings they run with.
pub struct Batch<'a> {
    /// Units of the batch.
    pub plan: &'a Plan,
    /// File of the manifest.
    pub manifest: &'a Path,
    /// Folder of the batch.
    pub out: &'a Path,
    /// Most units that run at a time.
    pub jobs: usize,
    /// Number of threads, shared by the running units.
    pub threads: usize,
    /// Time between two checkpoints of a training.
    pub checkpoint_every: Duration,
}

/// Running unit.
struct Running<'a> {
    unit: &'a Unit,
    place: usize,
    child: Child,
    begun: Instant,
    line: Progress,
}

impl Batch<'_> {
    /// Runs every unit that is not finished, and returns the row of each unit in the order of the plan. A failed unit
    /// blocks only the units that wait for it. A stop by the user is no error: the remaining units stay pending.
    ///
    /// # Errors
    /// When a process cannot be started, or a unit waits for one that is not in the plan.
    pub fn run(&self, session: &Session) -> Result<Vec<Row>> {
        session.stop_gently();
        let units = &self.plan.units;
        let mut rows: Vec<Row> = units.iter().map(|unit| row::pending(unit, self.out)).collect();
        for (row, unit) in rows.iter_mut().zip(units) {
            if let Some(stamp) = finished(self.out, unit) {
                row::finish(row, State::Skipped, &stamp);
            }
        }
        let done = rows.iter().filter(|row| row.state == State::Skipped).count();
        let (count, jobs) = (units.len(), self.jobs);
        tracing::info!("Batch of {count} units, {done} of them finished; up to {jobs} at a time");
        let others: Vec<String> = units.iter().filter_map(|unit| other_build(self.out, unit)).collect();
        if let Some(other) = others.first() {
            let (count, own) = (others.len(), build());
            tracing::warn!("{count} units of another build of the program ({other}; this is {own}) are run again");
        }
        let places: BTreeMap<&str, usize> = units.iter().zip(0..).map(|(unit, k)| (unit.id.as_str(), k)).collect();
        let place = |id: &String| {
            let found = places.get(id.as_str()).copied();
            found.ok_or_else(|| BatchError::no_unit(id))
        };
        let waits = units.iter().map(|unit| unit.after.iter().map(place).collect());
        let waits: Vec<Vec<usize>> = waits.collect::<Result<_, _>>()?;
        let order = order(units);
        let begun = Instant::now();
        let progress = session.progress("units", units.len() as u64);
        let mut running: Vec<Running> = Vec::new();
        let mut looks = 0;
        loop {
            if !session.stopped() {
                self.start((&waits, &order), &mut rows, &mut running, session)?;
            } else {
                // Their input ends: they save their state and exit.
                running.iter_mut().for_each(|r| drop(r.child.stdin.take()));
            }
            progress.set(rows.iter().filter(|row| row.state.is_final()).count() as u64);
            if running.is_empty() {
                break;
            }
            std::thread::sleep(LOOK_EVERY);
            looks += 1;
            if looks % LOOKS_PER_READING == 0 {
                for r in &running {
                    r.line.message(&last_line(&log_of(self.out, r.unit)));
                }
            }
            let mut left = Vec::with_capacity(running.len());
            for mut r in running {
                match r.child.try_wait() {
                    Ok(None) => left.push(r),
                    Ok(Some(status)) => {
                        self.ended(&mut rows[r.place], &r, status.code(), session);
                        if rows[r.place].state == State::Done {
                            let (seconds, left) = (r.begun.elapsed().as_secs_f64(), self.left(&rows, begun));
                            tracing::info!("{}: done in {seconds:.1} s; {left}", r.unit.id);
                        }
                    }
                    Err(error) => rows[r.place].fail(error.to_string()),
                }
            }
            running = left;
        }
        Ok(rows)
    }

    /// Starts units until `jobs` of them run. `waits` lists, for each unit, the indices of the units that must be done
    /// before; units that wait for a lost one are blocked. `order` lists the units by urgency.
    fn start<'u>(
        &'u self,
        (waits, order): (&[Vec<usize>], &[usize]),
        rows: &mut [Row],
        running: &mut Vec<Running<'u>>,
        session: &Session,
    ) -> Result<()> {
        if running.len() >= self.jobs {
            return Ok(());
        }
        for (place, after) in waits.iter().enumerate() {
            if rows[place].state == State::Pending
                && let Some(lost) = after.iter().find(|other| rows[**other].state.is_lost())
            {
                rows[place].state = State::Blocked;
                rows[place].error = Some(format!("{} failed", self.plan.units[*lost].id));
            }
        }
        let is_ready = |&&place: &&usize| {
            rows[place].state == State::Pending && waits[place].iter().all(|other| rows[*other].state.is_done())
        };
        let ready: Vec<usize> = order.iter().filter(is_ready).copied().collect();
        for (started, &place) in ready.iter().enumerate().take(self.jobs - running.len()) {
            let unit = &self.plan.units[place];
            // The last units have more threads than their share: the jobs beside them end before.
            let threads = self.threads / self.jobs.min(ready.len() - started);
            let child = self.spawn(unit, threads.max(1))?;
            rows[place].state = State::Running;
            tracing::info!("{}: started", unit.id);
            let (begun, line) = (Instant::now(), session.watch(&unit.id));
            running.push(Running {
                unit,
                place,
                child,
                begun,
                line,
            });
        }
        Ok(())
    }

    /// Starts a unit in a process of its own, with its log in its folder.
    fn spawn(&self, unit: &Unit, threads: usize) -> Result<Child> {
        let failed = |reason: String| BatchError::Failed(format!("{}: {reason}", unit.id));
        create_folder(&self.out.join(&unit.id))?;
        let path = log_of(self.out, unit);
        let log = File::options().create(true).append(true).open(&path);
        let log = log.map_err(|error| failed(format!("its log cannot be written ({error})")))?;
        let program = std::env::current_exe();
        let program = program.map_err(|error| failed(format!("this program is not found ({error})")))?;
        let threads = threads.to_string();
        let every = format!("{}s", self.checkpoint_every.as_secs_f64());
        let mut command = Command::new(program);
        command.arg("batch").arg(self.manifest).arg("--out").arg(self.out);
        command.args(["--only", &unit.id, "--attended", "--threads", &threads]);
        command.args(["--checkpoint-every", &every]);
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(log);
        let child = command.spawn();
        child.map_err(|error| failed(format!("it cannot be started ({error})")))
    }

    /// Number of units that are finished, and the time left: that of this run since it has `begun`, by the estimated
    /// times of the units.
    fn left(&self, rows: &[Row], begun: Instant) -> String {
        let estimated = |wanted: &dyn Fn(State) -> bool| -> f64 {
            let units = self.plan.units.iter().zip(rows).filter(|(_, row)| wanted(row.state));
            units.map(|(unit, _)| unit.runtime_s as f64).sum()
        };
        let left = estimated(&|state| !state.is_final()) / estimated(&|state| state == State::Done);
        let finished = rows.iter().filter(|row| row.state.is_done()).count();
        let text = format!("{finished} of {} units", rows.len());
        match rows.iter().all(|row| row.state.is_final()) {
            true => text,
            false => format!("{text}, {}", about_left(left * begun.elapsed().as_secs_f64())),
        }
    }

    fn ended(&self, row: &mut Row, running: &Running, code: Option<i32>, session: &Session) {
        let unit = running.unit;
        match (code, finished(self.out, unit)) {
            (Some(0), Some(stamp)) => row::finish(row, State::Done, &stamp),
            (Some(130), _) if session.stopped() => row.state = State::Pending,
            (code, _) => {
                let line = last_error(&log_of(self.out, unit));
                let line = line.unwrap_or_else(|| match code {
                    Some(code) => format!("it ended with exit code {code}"),
                    None => "it was killed".into(),
                });
                tracing::error!("{}: failed: {line}", unit.id);
                row.fail(line);
            }
        }
    }
}

/// Indices of the units by urgency: preset after preset, and of a preset the longest units first, so that all jobs have
/// work until the end.
fn order(units: &[Unit]) -> Vec<usize> {
    let home = |unit: &Unit| unit.id.rsplit_once('/').map_or("", |(home, _)| home).to_owned();
    let mut first = BTreeMap::new();
    let homes = units.iter().zip(0..);
    let homes: Vec<usize> = homes
        .map(|(unit, place)| *first.entry(home(unit)).or_insert(place))
        .collect();
    let mut order: Vec<usize> = (0..units.len()).collect();
    order.sort_by_key(|&place| (homes[place], Reverse(units[place].runtime_s)));
    order
}

/// Last [`TAIL`] bytes of a log, as text; empty if it cannot be read.
fn tail(path: &Path) -> String {
    let read = || -> std::io::Result<Vec<u8>> {
        let mut file = File::open(path)?;
        let length = file.metadata()?.len();
        file.seek(SeekFrom::Start(length.saturating_sub(TAIL)))?;
        let mut bytes = Vec::new();
        file.take(TAIL).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    String::from_utf8_lossy(&read().unwrap_or_default()).into_owned()
}

fn last_line(path: &Path) -> String {
    let text = tail(path);
    let line = text.lines().last().unwrap_or("").trim();
    line.chars().filter(|c| !c.is_control()).take(SHOWN).collect()
}

/// Last error message in a log.
fn last_error(path: &Path) -> Option<String> {
    let text = tail(path);
    let line = text.lines().rev().find_map(|line| line.strip_prefix("error: "));
    line.map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Work;

    #[test]
    fn the_longest_tiles_of_a_preset_are_first_and_presets_follow_each_other() {
        let unit = |id: &str, runtime_s| Unit {
            id: id.into(),
            work: Work::Refused { reason: String::new() },
            after: Vec::new(),
            mem_mb: 0,
            runtime_s,
            key: String::new(),
            deliver: None,
        };
        let units = [
            unit("a/i/adjust", 9),
            unit("a/i/sweep/tile-r0c0", 20),
            unit("a/i/sweep/tile-r0c1", 30),
            unit("a/i/sweep/tile-r1c0", 20),
            unit("a/i/sweep/mosaic", 5),
            unit("a/i/fast/tile-r0c0", 90),
        ];
        assert_eq!(order(&units), [0, 2, 1, 3, 4, 5]);
    }
}
