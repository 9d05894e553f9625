//! Writes the account of the project's numbers to `docs/numerics.md`, or to the file named as the only argument.

use heliosplat_tests::account;
use std::path::{Path, PathBuf};

/// The text before the table.
const BEFORE: &str = "# Numerics

Accuracy of each formula at its limits. `cargo run --release -p heliosplat-tests --bin stability` measures and writes this page; all
columns but the cost are the same in every run. `cargo test -p heliosplat-tests --test account` holds each row to a bound.

- **Value, gradient**: largest error of the code's f32 against the same formula in f64 over the domain, and its place.
- **Naive**: the same for the textbook form in f32.
- **Cost**: time of the robust form over that of the naive form, on one core. Formulas without a cost are not in an inner loop.

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
