//! Sweeps whole small scenes with random faults, and lists those whose surfaces are wrong.
//!
//! `scene_fuzz [--from SEED] [--count N] [--only FAULT] [--keep DIR] [--cells]`: `--only` leaves one fault of each scene
//! and skips those without it (`None`: those without any), `--keep` writes each silently wrong scene into a folder,
//! `--cells` lists their wrong cells.

use heliosplat_tests::scene_fuzz::delivery::Truth;
use heliosplat_tests::scene_fuzz::faults::Fault;
use heliosplat_tests::scene_fuzz::{Compared, FuzzRequest, Outcome};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// A scene that takes longer hangs: a busy machine has one in a minute.
const LONGEST: Duration = Duration::from_secs(600);

/// Arguments.
#[derive(Default)]
struct Args {
    from: u64,
    count: u64,
    only: Option<String>,
    keep: Option<PathBuf>,
    cells: bool,
}

fn args() -> Option<Args> {
    let mut found = Args {
        count: 100,
        ..Args::default()
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--from" => found.from = words.next()?.parse().ok()?,
            "--count" => found.count = words.next()?.parse().ok()?,
            "--only" => found.only = Some(words.next()?),
            "--keep" => found.keep = Some(words.next()?.into()),
            "--cells" => found.cells = true,
            _ => return None,
        }
    }
    Some(found)
}

/// Numbers of scenes: all, refused, without known ground, right, wrong beside steps only, wrong with a warning, silently
/// wrong, panicked.
type Counts = [usize; 8];

const KINDS: [&str; 8] = [
    "scenes", "refused", "unknown", "right", "steps", "warned", "silent", "panicked",
];

fn kind(outcome: &Outcome) -> usize {
    match outcome {
        Outcome::Refused(_) => 1,
        Outcome::Empty => 2,
        Outcome::Right(_) => 3,
        Outcome::Steps(_) => 4,
        Outcome::Warned(_) => 5,
        Outcome::Silent(_) => 6,
        Outcome::Panicked => 7,
    }
}

fn figures(found: &Compared) -> String {
    let [one, two, four] = [1.0, 2.0, 4.0].map(|deviations| 100.0 * found.within(deviations));
    format!(
        "{:.0} % known, within 1, 2, 4 deviations {one:.0}, {two:.0}, {four:.1} %, MAE {:.2} m, median {:+.2} m",
        100.0 * found.known,
        found.mae_m(),
        found.median_m()
    )
}

fn list_wrong(found: &Compared, truth: &Truth) {
    for cell in &found.cells {
        let [height, deviation] = cell.height_m;
        if cell.error_m.abs() > 4.0 * deviation {
            let [longitude, latitude] = cell.place_deg;
            println!(
                "  {longitude:.6} {latitude:.6}: {height:.1} m is off by {:+.1}, deviation {deviation:.2}, probability {:.2}, {} views; {}",
                cell.error_m,
                cell.probability,
                cell.views,
                truth.describe(longitude, latitude)
            );
        }
    }
}

/// Ends the process when one scene takes too long; the number counts the scenes done.
fn watch(done: &'static AtomicU64, from: u64) {
    std::thread::spawn(move || {
        let mut last = u64::MAX;
        loop {
            let now = done.load(Ordering::Relaxed);
            if now == last {
                eprintln!("scene {} takes more than {LONGEST:?}", from + now);
                std::process::exit(1);
            }
            last = now;
            std::thread::sleep(LONGEST);
        }
    });
}

fn main() {
    static DONE: AtomicU64 = AtomicU64::new(0);
    let Some(args) = args() else {
        eprintln!("usage: scene_fuzz [--from SEED] [--count N] [--only FAULT] [--keep DIR] [--cells]");
        std::process::exit(2);
    };
    watch(&DONE, args.from);
    let mut table: BTreeMap<String, Counts> = BTreeMap::new();
    for seed in args.from..args.from + args.count {
        let mut request = FuzzRequest::of_seed(seed);
        if let Some(only) = &args.only {
            let had_none = request.faults.is_empty();
            request.faults.retain(|fault| format!("{fault:?}") == *only);
            if request.faults.is_empty() && !(only == "None" && had_none) {
                DONE.fetch_add(1, Ordering::Relaxed);
                continue;
            }
        }
        let home = tempfile::tempdir().expect("a temporary folder");
        let outcome = request.outcome(home.path());
        DONE.fetch_add(1, Ordering::Relaxed);
        let faults = &request.faults;
        match &outcome {
            Outcome::Silent(found) => {
                let scene = request.scene();
                let stated = scene.stated_m.map(|(low, high)| format!(" --altitude={low},{high}"));
                let stated = stated.unwrap_or_default();
                println!("SILENT {seed} {faults:?}: {}{stated}", figures(found));
                if args.cells {
                    list_wrong(found, &scene.truth);
                }
                if let Some(keep) = &args.keep {
                    let folder = keep.join(seed.to_string());
                    std::fs::create_dir_all(&folder).expect("a folder");
                    scene.write(&folder);
                }
            }
            Outcome::Steps(found) => println!("steps {seed} {faults:?}: {}", figures(found)),
            Outcome::Warned(found) => println!("warned {seed} {faults:?}: {}; {:?}", figures(found), found.warnings),
            Outcome::Refused(reason) => println!("refused {seed} {faults:?}: {reason}"),
            Outcome::Panicked => println!("PANICKED {seed} {faults:?}"),
            Outcome::Right(found) => println!("right {seed} {faults:?}: {}; {:?}", figures(found), found.warnings),
            Outcome::Empty => println!("unknown {seed} {faults:?}"),
        }
        let mut names: Vec<String> = faults.iter().map(|fault: &Fault| format!("{fault:?}")).collect();
        if names.is_empty() {
            names.push("none".into());
        }
        names.push("all".into());
        for name in names {
            let counts = table.entry(name).or_default();
            counts[0] += 1;
            counts[kind(&outcome)] += 1;
        }
    }
    println!(
        "\n| fault | {} |\n|---|{}",
        KINDS.join(" | "),
        "---|".repeat(KINDS.len())
    );
    for (name, counts) in table {
        println!("| {name} | {} |", counts.map(|count| count.to_string()).join(" | "));
    }
}
