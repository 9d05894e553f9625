//! Results of a batch in its folder: tables, the page, and the STAC collection of its mosaics.

use super::plan::{Plan, Unit};
use super::row;
use super::stamp::finished;
use heliosplat_pages::summary::{Row, State, csv, json, page};
use heliosplat_products::stac;
use heliosplat_raster::RasterError;
use heliosplat_raster::virtual_files::deliver;
use heliosplat_raster::write_atomically;
use serde_json::Value;
use std::path::Path;

/// Identifier of the STAC collection of all mosaics.
pub(super) const COLLECTION: &str = "batch";

/// Rows of all units of a plan, read from the stamps in `out`; units without a valid stamp are pending.
pub fn of_stamps(plan: &Plan, out: &Path) -> Vec<Row> {
    let row = |unit: &Unit| {
        let mut row = row::pending(unit, out);
        if let Some(stamp) = finished(out, unit) {
            row::finish(&mut row, State::Done, &stamp);
        }
        row
    };
    plan.units.iter().map(row).collect()
}

/// Writes `summary.csv`, `summary.json` and `summary.html`. If mosaics have products, `collection.json` is written and
/// delivered with them.
///
/// # Errors
/// When one cannot be written or delivered.
pub fn write(rows: &[Row], plan: &Plan, out: &Path) -> Result<(), RasterError> {
    let write = |name: &str, text: String| write_atomically(&out.join(name), text.as_bytes());
    let items = items(rows, out);
    if !items.is_empty() {
        let collection = stac::collection(COLLECTION, &items);
        write("collection.json", format!("{collection:#}\n"))?;
        if let Some(to) = plan.units.iter().find_map(|unit| unit.deliver.as_ref()) {
            let target = format!("{to}/collection.json");
            deliver(&out.join("collection.json"), Path::new(&target))?;
        }
    }
    write("summary.csv", csv(rows))?;
    write("summary.json", format!("{:#}\n", json(rows)))?;
    write("summary.html", page(rows))
}

/// Folders and STAC items of the finished mosaics.
fn items(rows: &[Row], out: &Path) -> Vec<(String, Value)> {
    let has_item = |row: &&Row| row.state.is_done() && row.metrics.get("products").is_some();
    let item = |row: &Row| {
        let text = heliosplat_raster::bounded::read_text(&out.join(&row.unit).join("item.json")).ok()?;
        Some((row.unit.clone(), serde_json::from_str(&text).ok()?))
    };
    rows.iter().filter(has_item).filter_map(item).collect()
}
