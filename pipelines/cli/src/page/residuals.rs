//! The residuals as a picture: per image two frames, as delivered and adjusted, with a vector for every sighting.

use crate::page::escaped;
use heliosplat_rpc::adjust::{Adjustment, ResidualVector};
use heliosplat_satellite::ground::Ground;
use std::fmt::Write;

/// Side of a frame, picture units.
const FRAME: f64 = 220.0;
const GAP: f64 = 14.0;
const TITLE: f64 = 34.0;
/// Length of a residual of one pixel, picture units.
const PER_PIXEL: f64 = 12.0;
/// Pairs of frames in a row.
const ACROSS: usize = 2;

/// An SVG of all images' residual vectors; sightings that the adjustment left out are grey.
pub fn svg(names: &[&str], ground: &Ground, adjustment: &Adjustment) -> String {
    let rows = names.len().div_ceil(ACROSS);
    let cell = (2.0 * FRAME + 2.0 * GAP + GAP, FRAME + TITLE + GAP);
    let (width, height) = (ACROSS as f64 * cell.0 + GAP, rows as f64 * cell.1 + 2.0 * TITLE);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
         font-family=\"sans-serif\" font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"{GAP}\" y=\"20\">Residuals as delivered (left) and adjusted (right); the bar is one pixel; grey: left out</text>\n\
         <path d=\"M{GAP} 30h{PER_PIXEL}\" stroke=\"black\" stroke-width=\"3\"/>\n"
    );
    for (image, name) in names.iter().enumerate() {
        let corner = (
            GAP + (image % ACROSS) as f64 * cell.0,
            TITLE + (image / ACROSS) as f64 * cell.1,
        );
        let residuals = &adjustment.images[image];
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "<text x=\"{:.0}\" y=\"{:.0}\">{}: rms {:.2} → {:.2} px, {} of {} ties</text>",
            corner.0,
            corner.1 + 20.0,
            escaped(name),
            residuals.before.rms_px,
            residuals.after.rms_px,
            residuals.good,
            residuals.sightings
        );
        let pixels = &ground.images[image].pixels;
        let scale = FRAME / pixels.width.max(pixels.height).max(1) as f64;
        for side in 0..2 {
            let origin = (corner.0 + side as f64 * (FRAME + GAP), corner.1 + TITLE - 6.0);
            let size = (pixels.width as f64 * scale, pixels.height as f64 * scale);
            open_frame(&mut text, origin, size);
            for good in [false, true] {
                let vectors = adjustment
                    .residuals
                    .iter()
                    .filter(|r| r.image == image && r.good == good);
                draw(&mut text, scale, vectors, (side == 1, good));
            }
            text += "</svg>\n";
        }
    }
    text + "</svg>\n"
}

/// An SVG of its own, which clips what is drawn in it.
fn open_frame(text: &mut String, (x, y): (f64, f64), (width, height): (f64, f64)) {
    let _ = writeln!(
        text,
        "<svg x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\">\
         <rect width=\"100%\" height=\"100%\" fill=\"none\" stroke=\"#999\"/>"
    );
}

fn draw<'a>(
    text: &mut String,
    scale: f64,
    vectors: impl Iterator<Item = &'a ResidualVector>,
    (after, good): (bool, bool),
) {
    let mut path = String::new();
    for residual in vectors {
        let [col, row] = if after { residual.after_px } else { residual.before_px };
        let (x, y) = (residual.at.col * scale, residual.at.row * scale);
        let _ = write!(path, "M{x:.1} {y:.1}l{:.1} {:.1}", col * PER_PIXEL, row * PER_PIXEL);
    }
    let colour = if good { "#1f6fb4" } else { "#ccc" };
    let _ = writeln!(
        text,
        "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"0.8\"/>"
    );
}
