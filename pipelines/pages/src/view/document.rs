//! HTML document of the page: data as JSON, controls as HTML, and scripts, in one file without network access.

use super::ViewError;
use super::exhibit::{Exhibit, TracedDate};
use super::layer::{Layer, Ramp};
use super::pack::{self, GAMMA};
use super::place::GridLocation;
use crate::page::without_control_characters;
use heliosplat_products::surface_shadow::CASTER;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use rayon::prelude::*;
use serde_json::{Value, json};

/// Content security policy: the page may run its own script and show its own pictures, without any network access.
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:";
/// Largest size of the data of a page, bytes; its sources add some seventy thousand.
const BYTES_MAX: usize = 3_900_000;
const STYLE: &str = include_str!("page/style.css");
/// Sources of the page, in the order in which they are joined. The first four run without a browser.
const SCRIPTS: [&str; 19] = [
    include_str!("page/sun.js"),
    include_str!("page/sweep.js"),
    include_str!("page/light.js"),
    include_str!("page/field.js"),
    include_str!("page/layers.js"),
    include_str!("page/plan.js"),
    include_str!("page/oblique.js"),
    include_str!("page/dome.js"),
    include_str!("page/profile.js"),
    include_str!("page/hours.js"),
    include_str!("page/report.js"),
    include_str!("page/state.js"),
    include_str!("page/choice.js"),
    include_str!("page/controls.js"),
    include_str!("page/pointers.js"),
    include_str!("page/keys.js"),
    include_str!("page/picture.js"),
    include_str!("page/address.js"),
    include_str!("page/main.js"),
];

/// HTML text of the page of an exhibit. If its data exceed [`BYTES_MAX`], the last images are left out, then maps, then
/// shadow masks.
///
/// # Errors
/// When no height is known, or the grid lies outside its coordinate reference system.
pub(super) fn page(exhibit: &Exhibit) -> Result<String, ViewError> {
    let mut data = data(exhibit)?;
    while data.to_string().len() > BYTES_MAX && drop_one(&mut data) {}
    Ok(document(exhibit, &data))
}

/// Removes the least important layer or mask; returns false if none is left.
fn drop_one(data: &mut Value) -> bool {
    if let Some(layers) = data["layers"].as_array_mut() {
        let picture = layers.iter().rposition(|layer| layer.get("picture").is_some());
        if let Some(place) = picture.or(layers.len().checked_sub(1)) {
            layers.remove(place);
            return true;
        }
    }
    let mut dates = data["dates"].as_array_mut().into_iter().flatten();
    let last = dates.rfind(|date| !date["mask"].is_null());
    last.map(|date| date["mask"] = Value::Null).is_some()
}

fn document(exhibit: &Exhibit, data: &Value) -> String {
    // A name may contain `</script>`.
    let data = data.to_string().replace('<', "\\u003c");
    let script = format!("(() => {{\n\"use strict\";\n{}\n}})();", SCRIPTS.join("\n"));
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width,initial-scale=1,viewport-fit=cover";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="color-scheme" content="light dark";
                title { (exhibit.title) " under the sun" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                (stage(exhibit))
                (panel(exhibit))
                pre id="report" hidden {}
                script id="scene" type="application/json" { (PreEscaped(data)) }
                script { (PreEscaped(script)) }
            }
        }
    };
    without_control_characters(page.into_string() + "\n")
}

/// Data of the scripts.
fn data(exhibit: &Exhibit) -> Result<Value, ViewError> {
    let altitude = &exhibit.altitude;
    let nothing = || ViewError::Nothing {
        what: exhibit.title.clone(),
    };
    let darkest = exhibit.light.shade.iter().flatten().copied().fold(1.0, f32::min);
    let albedo = || pack::albedo(exhibit.albedo.as_ref()?, darkest);
    let dates = || exhibit.dates.par_iter().map(date).collect::<Vec<_>>();
    let layers = || exhibit.layers.par_iter().filter_map(layer).collect::<Vec<_>>();
    let ((heights, albedo), (dates, layers)) = rayon::join(
        || rayon::join(|| pack::heights(altitude), albedo),
        || rayon::join(dates, layers),
    );
    let heights = heights.ok_or_else(nothing)?;
    let place = GridLocation::of(&exhibit.grid, f64::from(heights.low_m))?;
    let crs = &exhibit.grid.crs;
    Ok(json!({
        "version": env!("CARGO_PKG_VERSION"),
        "title": exhibit.title,
        "width": altitude.width,
        "height": altitude.height,
        "cell_m": exhibit.gsd_m,
        "crs": if crs.definition().len() <= 32 { crs.definition() } else { crs.name() },
        "crs_name": crs.name(),
        "geographic": crs.is_geographic(),
        "vertical_datum": exhibit.vertical_datum,
        "transform": exhibit.grid.transform.to_gdal(),
        "place": place,
        "heights": heights,
        "albedo": albedo,
        "gamma": GAMMA,
        "light": exhibit.light,
        "old_shadows": exhibit.old_shadows,
        "caster": CASTER,
        "dates": dates,
        "layers": layers,
    }))
}

fn date(date: &TracedDate) -> Value {
    let mask = date
        .shadows
        .as_ref()
        .map(|shadows| pack::mask(shadows.plane(0).iter().map(|&shadow| shadow >= 0.5)));
    let [azimuth_deg, elevation_deg] = date.sun.degrees();
    json!({
        "name": date.name,
        "time": date.time.map(|time| time.to_string()),
        "azimuth_deg": azimuth_deg,
        "elevation_deg": elevation_deg,
        "mask": mask,
    })
}

fn layer(layer: &Layer) -> Option<Value> {
    let mut out = json!({
        "id": layer.id,
        "name": layer.name,
        "unit": layer.unit,
        "ramp": layer.ramp,
        "range": layer.range,
    });
    match layer.ramp {
        Ramp::Picture => {
            out["picture"] = json!(pack::plain_picture(&layer.values)?);
            out["known"] = json!(pack::mask(layer.values.plane(0).iter().map(|value| value.is_finite())));
        }
        Ramp::Diverging | Ramp::Sequential => out["data"] = json!(pack::map(&layer.values, layer.range)),
    }
    Some(out)
}

/// Map view, with the title and the controls over it.
fn stage(exhibit: &Exhibit) -> Markup {
    html! {
        main id="stage" {
            canvas id="view" tabindex="0" aria-label="Map; arrow keys move the sun, plus and minus zoom" {}
            header {
                h1 { (exhibit.title) }
                p id="said" {}
            }
            div id="divider" hidden { span {} }
            div id="labels" hidden { span id="label-left" {} span id="label-right" {} }
            div id="tools" {
                div.segments role="group" aria-label="View" {
                    button id="plan" aria-pressed="true" title="From above (P)" { "Plan" }
                    button id="oblique" aria-pressed="false" title="From the side (O)" { "Oblique" }
                }
                button id="draw" aria-pressed="false" title="Draw a line, see its heights (L)" { "Profile" }
                button id="fit" title="Show all of the map (0)" { "Show all" }
                button id="save" title="Save the view as PNG with a world file (S)" { "Save" }
            }
            div id="profile" hidden {
                button id="profile-close" aria-label="Close the profile" { "×" }
                canvas id="profile-chart" {}
                p id="profile-said" {}
            }
            div id="legend" hidden { canvas id="legend-bar" width="160" height="8" {} div id="legend-text" {} }
            div id="bearings" {
                span id="north" title="True north" { "N" span { "↑" } }
                span id="scale" {}
            }
            output id="readout" {}
        }
    }
}

/// Panel of controls.
fn panel(exhibit: &Exhibit) -> Markup {
    let has_dates = !exhibit.dates.is_empty();
    html! {
        aside id="panel" {
            section id="sky" {
                canvas id="dome" tabindex="0" aria-label="The sky; drag the sun, or use the arrow keys" {}
                div id="numbers" {
                    p { b id="azimuth-said" {} span { "azimuth" } }
                    p { b id="elevation-said" {} span { "elevation" } }
                    p { b id="shadow-said" {} span { "in shadow" } }
                }
            }
            section {
                div.row {
                    label for="date" { "Date" }
                    input id="date" type="date" min="1901-01-01" max="2149-12-31";
                    button id="play" title="Run through the day (space)" aria-label="Run through the day" { "▶" }
                }
                input id="hour" type="range" min="0" max="1439" step="1" aria-label="Time of the day";
                p.clock { span id="utc" {} span id="civil" {} span id="solar" {} }
                div.row {
                    label for="zone" { "Clock of" }
                    select id="zone" {}
                }
                details {
                    summary { "Azimuth and elevation" }
                    div.row {
                        label for="azimuth" { "Azimuth" }
                        input id="azimuth" type="range" min="0" max="360" step="0.5";
                        input id="azimuth-number" type="number" min="0" max="360" step="0.1" aria-label="Azimuth, degrees";
                    }
                    div.row {
                        label for="elevation" { "Elevation" }
                        input id="elevation" type="range" min="0" max="90" step="0.25";
                        input id="elevation-number" type="number" min="-90" max="90" step="0.1" aria-label="Elevation, degrees";
                    }
                }
            }
            @if exhibit.old_shadows {
                section.warning {
                    "No sun of the images was known, so their shadows are still in the colours, beside those drawn here. \
                     Relief shows the drawn ones alone."
                }
            }
            section {
                div.row {
                    label for="layer" { "Show" }
                    select id="layer" {}
                }
                div.row {
                    label for="against" { "Swipe" }
                    select id="against" {}
                }
            }
            @if has_dates {
                section {
                    h2 { "Dates of the images" }
                    div id="dates" {}
                    p.note id="agreement" {}
                }
            }
            section.note id="notes" {}
        }
    }
}
