//! Section of a report about relighting: figures, and truth beside relit images.

use super::Folder;
use super::parts::{figure, panels};
use crate::page::{number, section};
use heliosplat_satellite::relit::PICTURES;
use maud::{Markup, html};
use serde_json::Value;

/// Largest width of pictures, pixels.
const PICTURE_PX: u32 = 320;
/// Most suns with pictures on a page, which keeps it small enough for mail.
const PICTURES_MAX: usize = 12;
/// Panels of a picture, from left to right.
const PANELS: [&str; 3] = [
    "truth",
    "relit, one gain for all suns",
    "shadow errors: blue missed, red false",
];

/// Figures and pictures of each sun; empty for a run without truth under other suns.
pub(super) fn relit(run: &Folder) -> Markup {
    let suns = run.list("/relit/suns");
    if suns.is_empty() {
        return html! {};
    }
    let mean = &run.metrics["relit"]["mean"];
    let body = html! {
        p.faint {
            "Against images from above under suns that no image had. PSNR with one gain and offset per band for all suns, and with one \
             for each; brightness is the mean relative to the truth after the one gain; shadows are traced."
        }
        div.wide { table {
            tr { th { "sun: azimuth, elevation" } th { "PSNR one gain, dB" } th { "PSNR a gain each, dB" } th { "brightness" } th { "shadow BER, %" } th { "shadow IoU" } }
            @for sun in suns { (row(&angles(sun), sun)) }
            (row("mean", mean))
        } }
        @for (place, sun) in suns.iter().enumerate().take(PICTURES_MAX) {
            @let picture = run.picture(&format!("{PICTURES}/sun_{place}.png"));
            @if let Some(picture) = picture {
                h3 { (angles(sun)) }
                div.four {
                    @for (panel, caption) in panels(&picture, picture.width() / PANELS.len() as u32).into_iter().zip(PANELS) {
                        (figure(Some(panel), PICTURE_PX, caption))
                    }
                }
            }
        }
    };
    section("Under suns of no image", body)
}

fn angles(sun: &Value) -> String {
    let angle = |key: &str| number(sun[key].as_f64(), 1);
    format!("{}°, {}°", angle("sun_azimuth_deg"), angle("sun_elevation_deg"))
}

fn row(name: &str, score: &Value) -> Markup {
    html! {
        tr {
            td { (name) }
            td { (number(score["psnr_one_gain_db"].as_f64(), 2)) }
            td { (number(score["psnr_own_gain_db"].as_f64(), 2)) }
            td { (number(score["brightness_ratio"].as_f64(), 3)) }
            td { (number(score["ber"].as_f64().map(|share| 100.0 * share), 1)) }
            td { (number(score["iou"].as_f64(), 3)) }
        }
    }
}
