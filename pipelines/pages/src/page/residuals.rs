//! Picture of a camera adjustment: for each image two frames, as delivered and adjusted, with a vector for every
//! observation.

use super::chart::{FILE, svg_file};
use heliosplat_satellite::adjust::ImageVectors;
use maud::{Markup, html};
use std::fmt::Write;

/// Longer side of a frame, picture units.
const FRAME: f64 = 220.0;
const GAP: f64 = 14.0;
const TITLE: f64 = 34.0;
/// Length of a residual of one pixel, picture units.
const PER_PIXEL: f64 = 12.0;
/// Images in a row.
const ACROSS: usize = 2;

/// Draws the residual vectors of all images as an SVG file; outliers, which the adjustment left out, are grey.
pub fn picture(images: &[ImageVectors]) -> String {
    let rows = images.len().div_ceil(ACROSS);
    let cell = (2.0 * FRAME + 3.0 * GAP, FRAME + TITLE + GAP);
    let size = (ACROSS as f64 * cell.0 + GAP, rows as f64 * cell.1 + 2.0 * TITLE);
    let body = html! {
        g font-family="system-ui,sans-serif" font-size="11" fill=(FILE.text) {
            text x=(GAP) y="20" { "Residuals as delivered (left) and adjusted (right); the bar is one pixel; grey: outliers" }
            path d=(format_args!("M{GAP} 30h{PER_PIXEL}")) stroke=(FILE.text) stroke-width="3" {}
            @for (place, image) in images.iter().enumerate() {
                (both_frames(image, (GAP + (place % ACROSS) as f64 * cell.0, TITLE + (place / ACROSS) as f64 * cell.1)))
            }
        }
    };
    svg_file(size, &body)
}

/// Two frames of an image, under its name.
fn both_frames(image: &ImageVectors, (left, top): (f64, f64)) -> Markup {
    let scale = FRAME / image.width.max(image.height).max(1) as f64;
    let (width, height) = (image.width as f64 * scale, image.height as f64 * scale);
    let residuals = &image.residuals;
    html! {
        text x=(left) y=(top + 20.0) {
            (image.name) ": rms " (format_args!("{:.2} → {:.2}", residuals.before.rms_px, residuals.after.rms_px))
            " px, " (residuals.good) " of " (residuals.sightings) " ties"
        }
        @for (place, after) in [false, true].into_iter().enumerate() {
            // A nested SVG clips the vectors at the frame.
            svg x=(left + place as f64 * (FRAME + GAP)) y=(top + TITLE - 6.0) width=(format_args!("{width:.1}")) height=(format_args!("{height:.1}")) {
                rect width="100%" height="100%" fill="none" stroke=(FILE.faint) {}
                // Inliers over outliers.
                @for (good, colour) in [(false, "#ccc"), (true, FILE.series[1])] {
                    path d=(vectors(image, scale, after, good)) fill="none" stroke=(colour) stroke-width="0.8" {}
                }
            }
        }
    }
}

/// Vectors of one frame as an SVG path.
fn vectors(image: &ImageVectors, scale: f64, after: bool, good: bool) -> String {
    let mut path = String::new();
    for vector in image.vectors.iter().filter(|vector| vector.good == good) {
        let [col, row] = if after { vector.after_px } else { vector.before_px };
        let (x, y) = (vector.at.col * scale, vector.at.row * scale);
        // Writing to a String cannot fail.
        let _ = write!(path, "M{x:.1} {y:.1}l{:.1} {:.1}", col * PER_PIXEL, row * PER_PIXEL);
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat_rpc::ImagePoint;
    use heliosplat_rpc::adjust::{ImageResiduals, ResidualSize, ResidualVector};

    #[test]
    fn every_image_has_two_frames_with_its_vectors_and_its_name_stays_text() {
        let spread = |rms_px: f64| ResidualSize {
            rms_px,
            median_px: rms_px,
        };
        let vector = |good: bool| ResidualVector {
            track: 0,
            image: 0,
            at: ImagePoint { col: 100.0, row: 50.0 },
            before_px: [1.0, 2.0],
            after_px: [0.5, 0.0],
            good,
        };
        let image = ImageVectors {
            name: "<script>\u{1}".into(),
            width: 220,
            height: 110,
            residuals: ImageResiduals {
                sightings: 3,
                good: 2,
                before: spread(2.2),
                after: spread(0.5),
            },
            vectors: vec![vector(true), vector(false), vector(true)],
        };
        let drawn = picture(&[image.clone(), image]);
        assert!(
            drawn.contains("&lt;script&gt;\u{fffd}: rms 2.20 → 0.50 px, 2 of 3 ties") && !drawn.contains("<script")
        );
        // The picture itself, and two frames each.
        assert_eq!(drawn.matches("<svg").count(), 5);
        assert_eq!(drawn.matches("M100.0 50.0l12.0 24.0").count(), 6);
        assert_eq!(drawn.matches("M100.0 50.0l6.0 0.0").count(), 6);
    }
}
