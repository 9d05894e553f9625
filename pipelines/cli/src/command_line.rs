//! Command line of the program: arguments, dispatch to the verbs, output and exit codes.
//!
//! Every verb returns an [`Outcome`], printed on stdout as text, or as one JSON object with `--json`; logs and progress
//! go to stderr. Exit codes: 0 done; 1 failed; 2 bad usage or bad input, with one line about fault, place and remedy;
//! 130 interrupted after saving.

use crate::outcome::{CliError, Outcome};
use crate::verbs::*;
use clap::{CommandFactory, Parser, Subcommand};
use heliosplat_fitting::program::build;
use heliosplat_raster::library_versions;
use heliosplat_session::{Session, log};
use std::io::{ErrorKind, Write};
use std::process::ExitCode;
use std::sync::LazyLock;

/// Text of `--version`. It contains the build only if requested: finding it reads the whole executable.
static VERSION: LazyLock<String> = LazyLock::new(|| {
    let (gdal, proj) = library_versions();
    let is_asked = std::env::args_os().any(|argument| argument == "--version" || argument == "-V");
    let build = match (is_asked, option_env!("HELIOSPLAT_SOURCE")) {
        (true, Some(commit)) => format!("build {}, commit {commit}, ", build()),
        (true, None) => format!("build {}, ", build()),
        (false, _) => String::new(),
    };
    format!("{} ({build}GDAL {gdal}, PROJ {proj})", env!("CARGO_PKG_VERSION"))
});

/// Heading of the options of every verb.
const GENERAL: &str = "General options";

/// Surface models and relit images from satellite images of several dates
#[derive(Debug, Parser)]
#[command(name = "heliosplat", version = VERSION.as_str(), max_term_width = 110, subcommand_required = true)]
#[command(after_help = "Example: heliosplat demo --out demo")]
pub struct Cli {
    /// Print one JSON object on stdout instead of text
    #[arg(long, global = true, help_heading = GENERAL)]
    pub json: bool,
    /// Print warnings and errors only, no progress
    #[arg(short, long, global = true, conflicts_with = "verbose", help_heading = GENERAL)]
    pub quiet: bool,
    /// Print more on stderr (twice: everything)
    #[arg(short, long, global = true, action = clap::ArgAction::Count, help_heading = GENERAL)]
    pub verbose: u8,
    /// Threads to use [default: all cores]
    #[arg(long, global = true, value_name = "N", help_heading = GENERAL)]
    pub threads: Option<usize>,
    /// Verb to run
    #[command(subcommand)]
    pub command: Command,
}

/// The verbs.
#[derive(Debug, Subcommand)]
pub enum Command {
    #[cfg(feature = "synth")]
    /// Synthesise a site, train on it, write the DSM, its picture and its error against truth
    #[command(after_help = "Example: heliosplat demo --out demo")]
    Demo(demo::DemoArgs),
    #[cfg(feature = "synth")]
    /// Make a scene with known truth
    #[command(
        after_help = "Examples: heliosplat synth satellite --out site --site block --seed 1\n          \
                            heliosplat synth satellite --out hazy --faults band-gains,haze,interreflection,glossy\n          \
                            heliosplat synth satellite --out coast --cover sea\n          \
                            heliosplat synth object --out toy --size 200 --views 30"
    )]
    Synth(synth::SynthArgs),
    /// Show the images, cameras, suns, bands, overlap, altitudes and decisions of a scene
    #[command(after_help = "Example: heliosplat inspect my_images --altitude 640,780")]
    Inspect(inspect::InspectArgs),
    /// Correct the cameras of a scene by tie points
    #[command(after_help = "Example: heliosplat adjust my_images --out adjusted --images")]
    Adjust(adjust::AdjustArgs),
    /// Train a model of a scene, and write its surface model and report
    #[command(
        after_help = "Examples: heliosplat train my_images --out run --preset balanced --time-budget 10m\n          \
                            heliosplat train a.tif b.tif c.tif --out run\n          \
                            heliosplat train nerf_synthetic/lego --out run"
    )]
    Train(model_args::TrainArgs),
    /// Write the surface model of a run, or of a scene without training, as a cloud-optimised GeoTIFF
    #[command(
        after_help = "Examples: heliosplat dsm run --out dsm.tif --gsd 0.5 --crs EPSG:32637\n          \
                            heliosplat dsm my_images --from sweep --out quick.tif\n          \
                            heliosplat dsm a.tif b.tif --out quick.tif --geoid egm96"
    )]
    Dsm(model_args::DsmArgs),
    /// Write all files for a GIS: cloud-optimised GeoTIFFs, a point cloud, a STAC item
    #[command(after_help = "Examples: heliosplat products run --sun 250,35\n          \
                            heliosplat products run --sun-hours 2026-06-01/2026-08-31\n          \
                            heliosplat products north south --out catalogue --geoid egm96")]
    Products(products::ProductsArgs),
    /// Write the report of a run: images, surface, shadows, errors, decisions, time and memory
    #[command(after_help = "Example: heliosplat report run")]
    Report(report::ReportArgs),
    /// Write the scene under another sun, and its shadow mask
    #[command(
        after_help = "Examples: heliosplat relight run --out evening.tif --sun 270,20\n          \
                            heliosplat relight run --out noon.tif --time 2026-06-21T09:00:00Z\n          \
                            heliosplat relight object_run --out lit.png --light 2,1,3 --view test/near_000"
    )]
    Relight(model_args::RelightArgs),
    /// Write a page with a movable sun over a surface: one file for any browser, without network
    #[command(after_help = "Examples: heliosplat view run\n          \
                            heliosplat view run --out sun.html\n          \
                            heliosplat view --dsm dsm.tif --albedo ortho.tif --out sun.html")]
    View(view::ViewArgs),
    /// Render the images of a run; of a satellite scene with their shadow masks
    #[command(after_help = "Example: heliosplat render run --out rendered --split test")]
    Render(model_args::RenderArgs),
    /// Write splats, meshes and tiles of a run for viewers, editors and globes
    #[command(
        after_help = "Examples: heliosplat export run --tiles tiles --sun 250,35\n          \
                            heliosplat export run --tiles surface --mesh\n          \
                            heliosplat export run --splats site.glb --ply site.ply --time 2026-06-21T09:00:00Z\n          \
                            heliosplat export object_run --ply lit.ply --light 2,-1,3\n          \
                            heliosplat export object_run --mesh figure.glb"
    )]
    Export(export_args::ExportArgs),
    /// Measure a run, or any DSM, against truth
    #[command(after_help = "Examples: heliosplat evaluate run\n          \
                            heliosplat evaluate --dsm dsm.tif --truth lidar.tif --protocol aligned --json")]
    Evaluate(evaluate_args::EvaluateArgs),
    /// Project points into an image, and localise pixels on the ground
    #[command(after_help = "Example: echo '36.91 37.58 700' | heliosplat rpc project image.tif")]
    Rpc(rpc::RpcArgs),
    /// Compute the position of the sun: azimuth and geometric elevation, degrees
    #[command(after_help = "Example: heliosplat sun --time 2016-04-23T08:34:00Z --place 37.58,36.91,700")]
    Sun(sun::SunArgs),
    /// Train many areas in tiles and merge the tiles, as a manifest lists them
    #[command(after_help = "Examples: heliosplat batch city.toml --out city --jobs 2\n          \
                            heliosplat batch city.toml --out city --plan --json\n\n\
                            The same command continues an interrupted batch. The manifest: docs/guide/batch.md.")]
    Batch(batch::BatchArgs),
    /// Measure the speed of this machine: cameras, splats, light, whole steps; under a minute
    #[command(after_help = "Example: heliosplat bench --json")]
    Bench,
    /// Print the completions of a shell
    #[command(
        after_help = "Examples: heliosplat completions bash > ~/.local/share/bash-completion/completions/heliosplat\n          \
                            heliosplat completions fish > ~/.config/fish/completions/heliosplat.fish"
    )]
    Completions(completions::CompletionsArgs),
    /// Write the manual pages, one for each verb
    #[command(after_help = "Example: heliosplat man --out ~/.local/share/man/man1")]
    Man(man::ManArgs),
}

/// Parses the arguments of the process, runs the verb, and prints its outcome; returns the exit code.
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(said) => {
            let printed = checked(said.print());
            if said.use_stderr() && std::env::args_os().any(|argument| argument == "--json") {
                let text = said.to_string();
                let line = text.lines().next().unwrap_or_default().trim_start_matches("error: ");
                report_json(line, 2);
            }
            let code = u8::try_from(said.exit_code()).unwrap_or(2);
            return ExitCode::from(printed.err().map_or(code, |error| error.exit_code()));
        }
    };
    log::start(cli.verbose, cli.quiet);
    heliosplat_raster::messages::install();
    let outcome = run(&cli).and_then(|outcome| match cli.json {
        true => print_line(&outcome.json.to_string()),
        false => print_line(&log::printable(outcome.text.trim_end())),
    });
    if let Err(error) = &outcome {
        report(error, cli.json);
    }
    ExitCode::from(outcome.err().map_or(0, |error| error.exit_code()))
}

fn run(cli: &Cli) -> Result<Outcome, CliError> {
    if let Some(threads) = cli.threads {
        let most = threads_max();
        if threads == 0 || threads > most {
            let range = format!("give 1 to {most}; more than there are cores make it slower");
            return Err(CliError::Input(format!("--threads {threads}: {range}")));
        }
        let started = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
        started.map_err(|error| CliError::Failed(format!("threads cannot be started: {error}")))?;
    }
    let session = Session::start()?.quietly(cli.quiet);
    match &cli.command {
        #[cfg(feature = "synth")]
        Command::Demo(args) => demo::demo(args, &session),
        #[cfg(feature = "synth")]
        Command::Synth(args) => synth::run(args, &session),
        Command::Inspect(args) => inspect::run(args),
        Command::Adjust(args) => adjust::run(args, &session),
        Command::Train(args) => model::train(args, &session),
        Command::Dsm(args) => satellite::dsm(args, &session),
        Command::Products(args) => products::run(args, &session),
        Command::Report(args) => report::run(args),
        Command::Relight(args) => model::relight(args),
        Command::View(args) => view::run(args, cli.json),
        Command::Render(args) => model::render(args, &session),
        Command::Export(args) => model::export(args, &session),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Rpc(args) => rpc::run(args),
        Command::Sun(args) => sun::run(args),
        Command::Batch(args) => batch::run(args, cli.threads, &session),
        Command::Bench => bench::run(),
        Command::Completions(args) => completions::run(args, Cli::command()),
        Command::Man(args) => man::run(args, Cli::command()),
    }
}

/// Largest accepted number of threads: four for each core, but at least 256.
fn threads_max() -> usize {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    (4 * cores).max(256)
}

fn report(error: &CliError, json: bool) {
    let line = error.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
    log::line_on_stderr(&format!("error: {line}"));
    if json {
        report_json(&line, error.exit_code());
    }
}

fn report_json(line: &str, exit_code: u8) {
    // The line on stderr is the report if stdout cannot be written.
    let _ = print_line(&serde_json::json!({ "error": line, "exit_code": exit_code }).to_string());
}

/// Prints a text and a line break to stdout; nothing for an empty text.
fn print_line(text: &str) -> Result<(), CliError> {
    if text.is_empty() {
        return Ok(());
    }
    let mut out = std::io::stdout().lock();
    checked(writeln!(out, "{text}").and_then(|()| out.flush()))
}

/// Result of writing to stdout; a closed pipe (`| head`) is no failure.
fn checked(written: std::io::Result<()>) -> Result<(), CliError> {
    let fault = written.err().filter(|error| error.kind() != ErrorKind::BrokenPipe);
    let failed = |error| CliError::Failed(format!("the result cannot be written to stdout ({error})"));
    fault.map_or(Ok(()), |error| Err(failed(error)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent_and_every_verb_shows_an_example() {
        let command = Cli::command();
        command.clone().debug_assert();
        for verb in command.get_subcommands() {
            let help = verb.get_after_help().map(ToString::to_string).unwrap_or_default();
            assert!(help.contains("Example"), "{} has no example", verb.get_name());
        }
    }
}
