//! The page: one table for each arena, with notes on its columns, commands, versions and dates.

use super::arena::{Arena, Column, NOTES, Record};
use super::request::PRESETS;
use std::fmt::Write as _;

/// The text before the tables.
const HEAD: &str = "# Results

Errors, times and memory of the presets. `cargo run --release -p heliosplat-tests --bin results` measures and writes this page.

- **Scenes for tuning.** Constants and presets were chosen on `block` and `city` of seeds 1 to 3, on the independent city and on
  JAX_068, some also on `block` of seed 11. The synthetic scenes below have seeds 11 to 13.
- **Times** are wall times of the whole command, on a machine that may do other work. **Memory** is the peak of the process.
- **`sweep`** is the surface before training. [Protocols](guide/evaluate.md#protocols) are defined in the guide; the reasons for the
  presets are in the [lab](lab/presets.md).
";

/// Text of the page, in Markdown, from the records of one program.
pub fn page(records: &[Record]) -> String {
    let mut text = HEAD.to_owned();
    for arena in Arena::ALL {
        let of_arena: Vec<&Record> = records.iter().filter(|r| r.arena == arena).collect();
        if !of_arena.is_empty() {
            text.push('\n');
            text += &section(arena, &of_arena);
        }
    }
    text
}

fn section(arena: Arena, records: &[&Record]) -> String {
    let [title, setting, commands] = arena.head();
    let mut text = format!("## {title}\n\n{setting}\n\n");
    // Writing to a String cannot fail.
    let measured: Vec<&Record> = records.iter().copied().filter(|r| r.not_run.is_none()).collect();
    if measured.is_empty() {
        let reason = records.iter().rev().find_map(|r| r.not_run.as_deref());
        let _ = writeln!(text, "Not run: {}", reason.unwrap_or_default());
        return text;
    }
    let columns: Vec<&Column> = arena
        .columns()
        .iter()
        .filter(|column| measured.iter().any(|r| r.numbers.contains_key(column.key)))
        .collect();
    let heads: Vec<&str> = columns.iter().map(|column| column.head).collect();
    let _ = writeln!(text, "| preset | seed | {} |", heads.join(" | "));
    let _ = writeln!(text, "|---|---|{}", "---|".repeat(columns.len()));
    for preset in PRESETS {
        let mut rows: Vec<&Record> = measured.iter().copied().filter(|r| r.preset == preset).collect();
        rows.sort_by_key(|r| r.seed);
        for row in &rows {
            let cells = columns
                .iter()
                .map(|column| cell(column, row.numbers.get(column.key).copied()));
            let _ = writeln!(
                text,
                "| {preset} | {} | {} |",
                row.seed,
                cells.collect::<Vec<_>>().join(" | ")
            );
        }
        if rows.len() > 1 {
            let cells = columns.iter().map(|column| cell(column, mean(&rows, column.key)));
            let _ = writeln!(
                text,
                "| **{preset}** | mean | {} |",
                cells.collect::<Vec<_>>().join(" | ")
            );
        }
    }
    text.push('\n');
    for (_, note) in NOTES
        .iter()
        .filter(|(key, _)| columns.iter().any(|column| column.key == *key))
    {
        let _ = writeln!(text, "- {note}");
    }
    let all = |pick: fn(&Record) -> String| {
        let mut values: Vec<String> = measured.iter().map(|r| pick(r)).collect();
        values.sort();
        values.dedup();
        values.join("; ")
    };
    let mut seeds: Vec<u64> = measured.iter().map(|r| r.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    let seeds: Vec<String> = seeds.iter().map(u64::to_string).collect();
    let _ = writeln!(
        text,
        "- Commands: {commands}.\n- Version: {}. Seeds: {}. Date: {}. Machine: {}.",
        all(|r| r.version.clone()),
        seeds.join(", "),
        all(|r| r.date.clone()),
        all(|r| r.machine.clone()),
    );
    text
}

fn cell(column: &Column, value: Option<f64>) -> String {
    value.map_or_else(
        || "–".to_owned(),
        |value| format!("{:.*}", column.decimals, value * column.factor),
    )
}

/// The mean of a number over records that all have it.
fn mean(records: &[&Record], key: &str) -> Option<f64> {
    let values: Option<Vec<f64>> = records.iter().map(|r| r.numbers.get(key).copied()).collect();
    values.map(|values| values.iter().sum::<f64>() / values.len() as f64)
}
#[cfg(test)]
mod tests {
    use super::super::arena::{PEAK_BYTES, SECONDS};
    use super::super::bench::refusal;
    use super::super::request::Request;
    use super::*;
    use std::collections::BTreeMap;
    use std::path::Path;

    fn record(seed: u64, mae_m: f64) -> Record {
        let numbers = [
            ("/dsm/mae_m", mae_m),
            ("/dsm/within_1m", 0.95),
            (SECONDS, 61.4),
            (PEAK_BYTES, 300.0 * 1_048_576.0),
        ];
        Record {
            arena: Arena::Block,
            preset: "fast".to_owned(),
            seed,
            version: "heliosplat 1.2.3".to_owned(),
            program: "0123456789abcdef".to_owned(),
            date: "2026-02-03".to_owned(),
            machine: "2 cores".to_owned(),
            numbers: numbers.map(|(key, value)| (key.to_owned(), value)).into(),
            not_run: None,
        }
    }

    #[test]
    fn a_table_has_a_row_for_each_record_and_their_mean() {
        let page = page(&[record(12, 0.5), record(11, 0.4)]);
        let table: Vec<&str> = page.lines().filter(|line| line.starts_with('|')).collect();
        assert_eq!(
            table,
            [
                "| preset | seed | MAE m | within 1 m % | time s | peak memory MiB |",
                "|---|---|---|---|---|---|",
                "| fast | 11 | 0.400 | 95.0 | 61 | 300 |",
                "| fast | 12 | 0.500 | 95.0 | 61 | 300 |",
                "| **fast** | mean | 0.450 | 95.0 | 61 | 300 |",
            ]
        );
        let foot = "Version: heliosplat 1.2.3. Seeds: 11, 12. Date: 2026-02-03. Machine: 2 cores.";
        assert!(page.lines().last().is_some_and(|line| line.ends_with(foot)), "{page}");
    }

    #[test]
    fn a_refused_scene_states_its_reason() {
        let refused = Record {
            arena: Arena::Jax068,
            numbers: BTreeMap::new(),
            not_run: Some(refusal(
                "x\nerror: /data/jax068: holds several scenes",
                Path::new("/data/jax068"),
            )),
            ..record(11, 0.0)
        };
        assert!(page(&[refused]).ends_with("Not run: jax068: holds several scenes\n"));
    }

    #[test]
    fn options_that_do_not_exist_are_named() {
        let parse = |text: &str| Request::parse(&text.split(' ').map(str::to_owned).collect::<Vec<_>>());
        let request = parse("--arenas block,olat --seeds 21 --presets fast --out page.md").expect("sound options");
        assert_eq!(request.arenas, [Arena::Block, Arena::Olat]);
        assert_eq!((request.seeds, request.presets), (vec![21], vec!["fast".to_owned()]));
        for text in [
            "--arenas nowhere",
            "--seeds x",
            "--presets quick",
            "--colour red",
            "--out",
        ] {
            let fault = parse(text).expect_err(text);
            assert!(text.split(' ').any(|word| fault.contains(word)), "{fault}");
        }
    }
}
