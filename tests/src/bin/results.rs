//! Measures the program on the arenas and writes the page of results.

use heliosplat_tests::results::{self, Request};
use std::process::ExitCode;

/// The text of `--help`.
const HELP: &str = "Measures the program on the arenas and writes the page of results

Usage: results [--out FILE] [--program FILE] [--arenas A,B] [--seeds N,N] [--presets P,P] [--work DIR] [--page-only]

  --out FILE       the page to write [default: docs/results.md]
  --program FILE   the program to measure [default: target/release/heliosplat]
  --arenas A,B     block, city, cityb, jax068, olat, reflective [default: all]
  --seeds N,N      seeds of the scenes, and of training where the scene is fixed [default: 11,12,13]
  --presets P,P    sweep, fast, balanced, accurate [default: all]; objects are trained with fast only
  --work DIR       scenes, runs and the records of what was measured [default: target/results]
  --page-only      measure nothing, write the page from the records there are

Every measurement is kept in the work folder as one line of JSON. A call with the same program measures only what has no
record yet, so arenas can be measured one after another. The page holds all records of this program.";

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    if words.iter().any(|word| word == "--help" || word == "-h") {
        println!("{HELP}");
        return ExitCode::SUCCESS;
    }
    let request = match Request::parse(&words) {
        Ok(request) => request,
        Err(fault) => {
            eprintln!("error: {fault}; --help lists the options");
            return ExitCode::from(2);
        }
    };
    match results::write(&request) {
        Ok(()) => {
            println!("{}", request.out.display());
            ExitCode::SUCCESS
        }
        Err(fault) => {
            eprintln!("error: {fault}");
            ExitCode::FAILURE
        }
    }
}
