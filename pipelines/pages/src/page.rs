//! Shared parts of all HTML pages and SVG pictures: the document, one stylesheet, inline pictures, charts.
//!
//! A page is one file that loads nothing from the network, readable on a phone, in light and dark mode. Text goes
//! through [`maud`], which escapes it by type; only the stylesheet is inserted as it is.

pub mod calibration;
pub mod chart;
pub mod residuals;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::FilterType;
use image::{DynamicImage, ImageReader, Limits, RgbImage};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use std::path::Path;

/// Bytes of a mebibyte.
pub const MIB: f64 = 1_048_576.0;

/// Name of the file with the metrics of a mosaic; a folder that holds it is a mosaic's.
pub const MOSAIC_FILE: &str = "mosaic.json";

/// Longest side of a picture that is read, pixels, and most memory for it, bytes.
const SIDE_MAX: u32 = 60_000;
const BYTES_MAX: u64 = 400 << 20;

const STYLE: &str = include_str!("page/style.css");

/// HTML document with this title, which is also its heading.
pub fn document(title: &str, body: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width,initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (title) }
                (body)
            }
        }
    };
    without_control_characters(page.into_string() + "\n")
}

/// Section with its heading; empty if its body is empty.
pub fn section(heading: &str, body: Markup) -> Markup {
    if body.0.is_empty() {
        return body;
    }
    html! { h2 { (heading) } (body) }
}

/// Formats a number with `digits` digits after the point; empty for an unknown number.
pub fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(String::new, |value| format!("{value:.digits$}"))
}

/// Quotes a text as a cell of CSV. Spreadsheets evaluate a cell that begins with `=`, `+`, `-`, `@` or a tab as a
/// formula; such a text gets a leading apostrophe.
pub fn csv_text(text: &str) -> String {
    let is_formula = text.starts_with(['=', '+', '-', '@', '\t']);
    let mark = if is_formula { "'" } else { "" };
    format!("\"{mark}{}\"", text.replace('"', "\"\""))
}

/// Replaces control characters, which may come from a file name. HTML and XML allow only line breaks and tabs.
pub(crate) fn without_control_characters(text: String) -> String {
    heliosplat_session::log::printable(&text)
}

/// Reads a picture; `None` if it is absent, damaged or too large.
pub fn picture_of(path: &Path) -> Option<RgbImage> {
    if !path.is_file() {
        return None;
    }
    let mut reader = ImageReader::open(path).ok()?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(SIDE_MAX);
    limits.max_image_height = Some(SIDE_MAX);
    limits.max_alloc = Some(BYTES_MAX);
    reader.limits(limits);
    reader.decode().ok().map(|picture| picture.to_rgb8())
}

/// Encodes a picture as a JPEG of at most `width` pixels width in a `data:` address; `None` if encoding fails.
pub fn inline_picture(picture: RgbImage, width: u32) -> Option<String> {
    const QUALITY: u8 = 82;
    let mut picture = DynamicImage::ImageRgb8(picture);
    if picture.width() > width {
        picture = picture.resize(width, u32::MAX, FilterType::Triangle);
    }
    jpeg_address(&picture.into_rgb8(), QUALITY)
}

/// Encodes a picture as a JPEG in a `data:` address; `None` if encoding fails.
pub(crate) fn jpeg_address(picture: &RgbImage, quality: u8) -> Option<String> {
    let mut bytes = Vec::new();
    let encoder = JpegEncoder::new_with_quality(&mut bytes, quality);
    picture.write_with_encoder(encoder).ok()?;
    Some(format!("data:image/jpeg;base64,{}", STANDARD.encode(bytes)))
}

/// Formats a number with three significant digits, or all digits before the point, without trailing zeros.
pub fn plain(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let digits = (2.0 - value.abs().log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{value:.digits$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_title_from_outside_stays_text() {
        let page = document(
            "<script>alert(1)</script>\u{0}&\"",
            &html! { p title="\"'<" { "a\u{7}<b>" } },
        );
        assert!(page.contains("&lt;script&gt;") && page.contains("a\u{fffd}&lt;b&gt;"));
        assert!(!page.contains("<script") && !page.contains("\"\"") && !page.contains('\u{0}'));
    }

    #[test]
    fn numbers_have_no_needless_digits() {
        assert_eq!(plain(0.25), "0.25");
        assert_eq!(plain(1200.0), "1200");
        assert_eq!((number(Some(0.25), 1), number(None, 1)), ("0.2".into(), String::new()));
    }

    #[test]
    fn pictures_are_made_no_wider_than_asked() {
        let address = inline_picture(RgbImage::new(400, 100), 100).expect("encodable");
        let bytes = STANDARD
            .decode(address.strip_prefix("data:image/jpeg;base64,").expect("an address"))
            .expect("base64");
        let picture = image::load_from_memory(&bytes).expect("a JPEG");
        assert_eq!((picture.width(), picture.height()), (100, 25));
    }
}
