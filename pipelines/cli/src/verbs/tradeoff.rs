//! `heliosplat tradeoff`: arguments and output.

use crate::outcome::{CliError, Outcome};
use clap::Args;
use heliosplat_batch::tradeoff::Sweep;
use heliosplat_pages::tradeoff::page::{Making, page};
use heliosplat_pages::tradeoff::points;
use heliosplat_pages::tradeoff::summary::{Summary, summarise};
use heliosplat_pages::tradeoff::{Row, csv};
use heliosplat_raster::write::write_atomically;
use heliosplat_session::Session;
use std::path::PathBuf;

/// `tradeoff`.
#[derive(Debug, Clone, Args)]
pub struct TradeoffArgs {
    /// Scenes, as for `train`; every point runs on each
    #[arg(value_name = "SCENE", required = true)]
    pub scenes: Vec<PathBuf>,
    /// Folder for the runs, tradeoff.csv, tradeoff.json and tradeoff.html; finished runs are kept
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Seeds for the points where differences are small
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=100))]
    pub seeds: u64,
    /// Only points of these names or axes, with their references
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Points of your own instead of the built-in ones, or `ablation`: one component at a time
    #[arg(long, value_name = "FILE.toml|ablation")]
    pub points: Option<PathBuf>,
    /// Print the points and stop
    #[arg(long)]
    pub list: bool,
}

/// Runs the sweep and writes its results.
pub(crate) fn run(args: &TradeoffArgs, threads: Option<usize>, session: &Session) -> Result<Outcome, CliError> {
    let points = points::load(args.points.as_deref(), &args.only)?;
    if args.list {
        let line = |p: &points::Point| format!("{:<20} {:<16} {} ({})", p.name, p.axis, p.why, p.arguments().join(" "));
        return Ok(Outcome {
            text: points.iter().map(line).collect::<Vec<_>>().join("\n"),
            json: serde_json::json!({ "points": points }),
        });
    }
    let sweep = Sweep {
        scenes: args.scenes.clone(),
        points,
        seeds: args.seeds,
        threads,
        out: args.out.clone(),
    };
    let rows = sweep.run(session)?;
    let summary = summarise(&sweep.points, &rows);
    let scenes: Vec<String> = args.scenes.iter().map(|scene| scene.display().to_string()).collect();
    let machine = format!("{} threads", threads.unwrap_or_else(rayon::current_num_threads));
    let making = Making {
        command: &command(args),
        machine: &machine,
        scenes: &scenes,
    };
    let json = serde_json::json!({
        "command": making.command, "threads": machine, "scenes": scenes, "summary": summary, "trainings": rows,
    });
    let write = |name: &str, text: String| write_atomically(&args.out.join(name), text.as_bytes());
    write("tradeoff.csv", csv(&rows))?;
    write("tradeoff.json", format!("{json:#}\n"))?;
    write("tradeoff.html", page(&summary, &rows, &making))?;
    Ok(Outcome {
        text: table(&summary, &rows, args),
        json,
    })
}

/// The command that does this again.
fn command(args: &TradeoffArgs) -> String {
    let mut out = "heliosplat tradeoff".to_owned();
    for scene in &args.scenes {
        out += &format!(" {}", scene.display());
    }
    out += &format!(" --out {} --seeds {}", args.out.display(), args.seeds);
    if !args.only.is_empty() {
        out += &format!(" --only \"{}\"", args.only.join(","));
    }
    if let Some(points) = &args.points {
        out += &format!(" --points {}", points.display());
    }
    out
}

fn table(summary: &Summary, rows: &[Row], args: &TradeoffArgs) -> String {
    let mut out = format!(
        "{:<20} {:>9} {:>8}  {}\n",
        "point",
        "seconds",
        "MiB",
        summary.quality.label()
    );
    for p in &summary.points {
        out += &format!(
            "{:<20} {:>9.1} {:>8.0}  {:.3}{}\n",
            p.point.name,
            p.seconds.mean,
            p.peak_bytes.mean / f64::from(1 << 20),
            p.quality.mean,
            if p.on_time_front { "  *" } else { "" }
        );
    }
    out + &format!(
        "* no other point is both quicker and better; {} trainings\npage           {}",
        rows.len(),
        args.out.join("tradeoff.html").display()
    )
}
