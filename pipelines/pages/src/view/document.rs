//! HTML document of the page: data as JSON, controls as HTML, and scripts, in one file without network access.

use super::ViewError;
use super::exhibit::{Exhibit, TracedDate};
use super::layer::{Layer, Ramp};
use super::pack::{self, GAMMA};
use super::place::GridLocation;
use crate::page::without_control_characters;
use heliosplat_products::surface_shadow::CASTER;
use maud::{DOCTYPE, PreEscaped, html};
use rayon::prelude::*;
use serde_json::{Value, json};

/// Content security policy: the page may run its own script and show its own pictures, without any network access.
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:";
/// Largest size of the data of a page, bytes; its sources add some seventy thousand.
const BYTES_MAX: usize = 3_900_000;
const STYLE: &str = include_str!("page/style.css");
const BODY: &str = include_str!("page/body.html");
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
                (PreEscaped(body(exhibit)))
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
    let nothing = || ViewError::Nothing(exhibit.title.clone());
    let darkest = exhibit.light.shade.iter().flatten().copied().fold(1.0, f32::min);
    let albedo = || pack::albedo(exhibit.albedo.as_ref()?, darkest);
    let dates = || exhibit.dates.par_iter().map(date).collect::<Vec<_>>();
    let layers = || exhibit.layers.par_iter().filter_map(layer).collect::<Vec<_>>();
    let ((heights, albedo), (dates, layers)) = rayon::join(
        || rayon::join(|| pack::heights(altitude), albedo),
        || rayon::join(dates, layers),
    );
    let (low_m, heights) = heights.ok_or_else(nothing)?;
    let place = GridLocation::of(&exhibit.grid, f64::from(low_m))?;
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
    let shadows = date.shadows.as_ref();
    let mask = shadows.map(|shadows| pack::mask(shadows.plane(0).iter().map(|&shadow| shadow >= 0.5)));
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

/// The map with the title and the controls over it, and the panel of controls.
fn body(exhibit: &Exhibit) -> String {
    let warning = html! {
        @if exhibit.old_shadows {
            section.warning {
                "No sun of the images was known, so their shadows are still in the colours, beside those drawn here. \
                 Relief shows the drawn ones alone."
            }
        }
    };
    let dates = html! {
        @if !exhibit.dates.is_empty() {
            section {
                h2 { "Dates of the images" }
                div id="dates" {}
                p.note id="agreement" {}
            }
        }
    };
    let body: String = BODY.lines().map(str::trim).collect();
    let body = body.replace("{warning}", &warning.0).replace("{dates}", &dates.0);
    // The title last: a name may hold the other marks.
    body.replace("{title}", &html! { (exhibit.title) }.0)
}
