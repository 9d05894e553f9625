//! What pages for people share: one HTML file that needs nothing else, readable on a phone, in the light and in the dark.

pub mod chart;
pub mod residuals;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::FilterType;
use image::{DynamicImage, RgbImage};

/// How pages look. Lines and grids of charts take their colours from the variables.
pub const STYLE: &str = ":root{color-scheme:light dark;--text:#1b1b1b;--paper:#fff;--faint:#666;--line:#ddd;--panel:#f4f4f4;--warm:#b5561c;--cool:#2a6f97}\
@media(prefers-color-scheme:dark){:root{--text:#e6e6e6;--paper:#16181b;--faint:#a0a0a0;--line:#3a3d42;--panel:#212429;--warm:#e58a4e;--cool:#6fb3d9}}\
body{font:15px/1.5 system-ui,sans-serif;max-width:64rem;margin:2rem auto;padding:0 1rem;color:var(--text);background:var(--paper)}\
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}th,td{text-align:right;padding:.25rem .5rem;border-bottom:1px solid var(--line)}\
th:first-child,td:first-child,td.words,th.words{text-align:left}td.words{color:var(--faint)}\
pre{background:var(--panel);padding:.6rem;overflow-x:auto}.wide{overflow-x:auto}\
svg{width:100%;height:auto}svg text{font:12px system-ui,sans-serif;fill:var(--text)}.front{font-weight:600}.faint{color:var(--faint)}\
@media(max-width:34rem){th,td{padding:.2rem .3rem;font-size:.85em}td:first-child{overflow-wrap:anywhere;min-width:5.5rem}}";

/// `text` as HTML shows it: whatever it holds, it stays text.
pub fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // Other control characters have no place in HTML.
            c if c.is_control() && c != '\n' && c != '\t' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// A picture as a `data:` address, JPEG, at most `width` pixels wide; `None` where it cannot be encoded.
pub fn inline_picture(picture: RgbImage, width: u32) -> Option<String> {
    const QUALITY: u8 = 82;
    let picture = DynamicImage::ImageRgb8(picture);
    let small = if picture.width() > width {
        picture.resize(width, u32::MAX, FilterType::Triangle)
    } else {
        picture
    };
    let mut bytes = Vec::new();
    small
        .write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, QUALITY))
        .ok()?;
    Some(format!("data:image/jpeg;base64,{}", STANDARD.encode(bytes)))
}

/// Round numbers within a range, seven at most.
pub fn ticks(low: f64, high: f64) -> Vec<f64> {
    let span = high - low;
    let power = 10f64.powf((span / 5.0).log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * power);
    let step = steps.into_iter().find(|step| span / step <= 7.0).unwrap_or(steps[3]);
    if !(step.is_finite() && step > 0.0) {
        return Vec::new();
    }
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    (first..=last).map(|n| n as f64 * step).collect()
}

/// A number without needless digits.
pub fn plain(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let digits = (2.0 - value.abs().log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_from_outside_stays_text() {
        let text = escaped("<script>alert('x')</script>\u{0}&\"");
        assert!(!text.contains('<') && !text.contains('"') && !text.contains('\'') && !text.contains('\u{0}'));
    }

    #[test]
    fn ticks_are_round_few_and_within() {
        assert_eq!(ticks(0.0, 1.0), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        assert!(ticks(1.0, 1.0).is_empty() && ticks(f64::NAN, 1.0).is_empty());
        assert_eq!(plain(0.25), "0.25");
        assert_eq!(plain(1200.0), "1200");
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
