//! Section of a report about buildings built or torn down between the images.

use super::Contents;
use super::parts::figure;
use crate::page::{number, section};
use heliosplat_products::change::as_date;
use maud::{Markup, html};

/// Largest width of the picture, pixels.
const PICTURE_PX: u32 = 640;
/// Most segments that are listed.
const LISTED: usize = 40;

/// Changed segments, largest first; empty for a run without change detection.
pub(super) fn changes(run: &Contents) -> Markup {
    let Some(changes) = &run.model.changes else {
        return html! {};
    };
    let mut segments: Vec<_> = changes.segments.iter().collect();
    segments.sort_by(|a, b| b.area_m2.total_cmp(&a.area_m2));
    let score = &run.folder.metrics["change"]["truth"];
    let share = |key: &str| number(score[key].as_f64().map(|share| 100.0 * share), 0);
    let body = html! {
        @if segments.is_empty() {
            p { "Nothing changed between the images, as far as at least two of them before and two after a day can tell." }
        } @else {
            p.faint { "The surface and all other products are those of the last image." }
            div.wide { table {
                tr { th { "first image of the new state" } th { "ground, m²" } th { "height, m" } th { "confidence" } }
                @for segment in segments.iter().take(LISTED) {
                    tr {
                        td { (dated(segment.day)) }
                        td { (number(Some(f64::from(segment.area_m2)), 0)) }
                        td { (number(Some(f64::from(segment.difference_m)), 1)) }
                        td { (number(Some(f64::from(segment.confidence)), 2)) }
                    }
                }
            } }
            (figure(run.folder.picture("change.png"), PICTURE_PX, "Change of heights from the first image to the last: blue lower, red higher"))
        }
        @if score.is_object() {
            p { "Against truth: precision " (share("precision")) " %, recall " (share("recall")) " % of the changed area." }
        }
    };
    section("What changed", body)
}

fn dated(day: i32) -> String {
    let date = as_date(day);
    format!("{:04}-{:02}-{:02}", date / 10_000, date / 100 % 100, date % 100)
}
