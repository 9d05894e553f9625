//! `heliosplat batch`: plans, runs or summarises the batch of a manifest.

use crate::outcome::{CliError, Outcome};
use crate::parse;
use clap::Args;
use heliosplat_batch::driver::Batch;
use heliosplat_batch::plan::{Plan, Units};
use heliosplat_batch::stamp::{STAMP, finished, other_build};
use heliosplat_batch::summary;
use heliosplat_batch::unit::do_unit;
use heliosplat_pages::summary::{Row, State, json as json_of, table};
use heliosplat_session::Session;
use serde_json::json;
use std::path::PathBuf;
use std::time::Duration;

/// `batch`.
#[derive(Debug, Clone, Args)]
pub struct BatchArgs {
    /// A manifest of areas, images and presets (docs/guide/batch.md)
    #[arg(value_name = "MANIFEST.toml")]
    pub manifest: PathBuf,
    /// Folder for all units, summary.csv, summary.json and summary.html; finished units are kept
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Number of units at a time, which share the threads
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub jobs: u16,
    /// Run this unit alone; units that it depends on must be finished
    #[arg(long, value_name = "UNIT", conflicts_with_all = ["plan", "dry_run", "summary"])]
    pub only: Option<String>,
    /// Print the units with their memory, time and order, and stop
    #[arg(long, conflicts_with_all = ["dry_run", "summary"])]
    pub plan: bool,
    /// Print the unfinished units, and stop
    #[arg(long, conflicts_with = "summary")]
    pub dry_run: bool,
    /// Write the summary of the finished units, and stop
    #[arg(long)]
    pub summary: bool,
    /// Time between two checkpoints of a training; 0 keeps one after every step
    #[arg(long, value_parser = parse::duration, value_name = "TIME", default_value = "60s")]
    pub checkpoint_every: Duration,
    /// Stop when standard input ends
    #[arg(long, hide = true)]
    pub attended: bool,
}

/// Plans, runs or summarises a batch, or runs one of its units.
///
/// # Errors
/// When the manifest or a unit cannot be used, a unit fails, a file cannot be written, or the user stops the batch.
pub(crate) fn run(args: &BatchArgs, threads: Option<usize>, session: &Session) -> Result<Outcome, CliError> {
    if args.attended {
        session.stop_with_input();
    }
    if let Some(id) = &args.only {
        return only(args, id, session);
    }
    let looks = args.plan || args.dry_run || args.summary;
    let plan = Plan::of(&args.manifest, &args.out, !looks)?;
    if args.plan || args.dry_run {
        return Ok(planned(args, &plan));
    }
    if args.summary {
        let rows = summary::of_stamps(&plan, &args.out);
        return finish(args, &plan, &rows);
    }
    let batch = Batch {
        plan: &plan,
        manifest: &args.manifest,
        out: &args.out,
        jobs: args.jobs.into(),
        threads: threads.unwrap_or_else(rayon::current_num_threads),
        checkpoint_every: args.checkpoint_every,
    };
    let rows = batch.run(session)?;
    let outcome = finish(args, &plan, &rows)?;
    let lost = rows.iter().filter(|row| row.state.is_lost());
    let failed: Vec<&str> = lost.map(|row| row.unit.as_str()).collect();
    if session.stopped() && rows.iter().any(|row| row.state == State::Pending) {
        let text = "stopped; what is finished is kept, and trainings have their checkpoints: the same command goes on";
        return Err(CliError::Interrupted(text.into()));
    }
    if failed.is_empty() {
        return Ok(outcome);
    }
    let (count, all, names) = (failed.len(), rows.len(), failed.join(", "));
    let share = format!("{count} of {all} units are not done ({names})");
    let page = args.out.join("summary.html");
    let told = format!(
        "{share}; {} says why, the same command tries them again",
        page.display()
    );
    Err(CliError::Failed(told))
}

fn only(args: &BatchArgs, id: &str, session: &Session) -> Result<Outcome, CliError> {
    let units = Units::open(&args.manifest, &args.out)?;
    let unit = units.unit(id)?;
    let (stamp, before) = do_unit(&units, &unit, &args.out, args.checkpoint_every, session)?;
    let how = if before { "finished before" } else { "done" };
    let text = format!("{id}: {how}, {:.1} s", stamp.seconds);
    Ok(Outcome::new(text, serde_json::to_value(&stamp).unwrap_or_default()))
}

/// Outcome of `--plan` and `--dry-run`: the units with their memory, time and state.
fn planned(args: &BatchArgs, plan: &Plan) -> Outcome {
    let mut text = String::new();
    let mut units = Vec::new();
    for unit in &plan.units {
        let done = finished(&args.out, unit).is_some();
        let other = other_build(&args.out, unit);
        let what = match (done, &other) {
            (true, _) => "finished",
            (false, Some(_)) => "to do, done by another build",
            (false, None) => "to do",
        };
        let (id, mem_mb, runtime_s) = (&unit.id, unit.mem_mb, unit.runtime_s);
        text += &match unit.refusal() {
            Some(reason) => format!("refused   {id}: {reason}\n"),
            None => format!("{what:<8}  {id}  ({mem_mb} MiB, {runtime_s} s)\n"),
        };
        let mut told = serde_json::to_value(unit).unwrap_or_default();
        told["done"] = json!(done);
        told["other_build"] = json!(other);
        told["stamp"] = json!(format!("{id}/{STAMP}"));
        units.push(told);
    }
    Outcome::new(text, json!({"units": units}))
}

fn finish(args: &BatchArgs, plan: &Plan, rows: &[Row]) -> Result<Outcome, CliError> {
    summary::write(rows, plan, &args.out)?;
    let page = args.out.join("summary.html");
    let text = format!("{}summary        {}", table(rows), page.display());
    Ok(Outcome::new(text, json_of(rows)))
}
