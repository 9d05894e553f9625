//! Writes the account of the project's numbers to `docs/numerics.md`, or to the file named as the only argument.

use heliosplat_tests::account;
use std::path::{Path, PathBuf};

/// The text before the table.
const BEFORE: &str = "# Numbers that hold at the extremes

Written by `cargo run --release -p heliosplat-tests --bin stability`; all but the last column of the first table is the same every
time. Errors are those of the code's f32 against the same formula in f64, the largest over the domain, and where it is. The naive
form is the one that a textbook writes, in f32, over the same domain. Cost is the time of the robust form over that of the naive one
(or of the standard library's, where the form is there for speed), both on the same numbers in the same run, one core; formulas
without one are not in an inner loop. `cargo test -p heliosplat-tests --test account` holds every row to a limit.

| formula in the code | domain, kind of error | value | gradient | naive: value | naive: gradient | cost |
|---|---|---|---|---|---|---|
";

fn main() -> std::io::Result<()> {
    let out = std::env::args_os().nth(1).map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/numerics.md"),
        PathBuf::from,
    );
    let mut text = String::from(BEFORE);
    for row in account::rows(true) {
        text += &row.markdown();
        text.push('\n');
        if let Some(fault) = row.fault() {
            eprintln!("beyond its limit: {fault}");
        }
    }
    text.push('\n');
    text += include_str!("../../numerics_after.md");
    std::fs::write(&out, text)?;
    println!("{}", out.display());
    Ok(())
}
