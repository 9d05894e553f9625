//! Formats recognised by content, since vendors, archives and users rename files.

use super::fields::shortened;
use super::statements::without_mark;
use super::text::looks_fixed_width;

/// The kinds of text that contain cameras or acquisitions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum TextKind {
    Dimap,
    MaxarXml,
    OtherXml(String),
    Json,
    Assignments,
    Geom,
    RpcTxt,
    FixedWidth,
    Other,
}

/// Kind of a text, from its beginning and the names it contains.
pub(super) fn kind(text: &str) -> TextKind {
    let start = without_mark(text).trim_start();
    if start.starts_with('<') {
        return match root_name(start) {
            "Dimap_Document" | "PHR_DIMAP_Document" => TextKind::Dimap,
            "isd" => TextKind::MaxarXml,
            root => TextKind::OtherXml(shortened(root)),
        };
    }
    if start.starts_with(['{', '[']) {
        return TextKind::Json;
    }
    if start.contains("LINE_NUM_COEFF") || start.contains("LINE_OFF") {
        return TextKind::RpcTxt;
    }
    if start.contains("line_num_coeff_") || start.contains("polynomial_format:") {
        return TextKind::Geom;
    }
    if looks_fixed_width(start) {
        return TextKind::FixedWidth;
    }
    if start.contains('=') && start.contains(';') {
        return TextKind::Assignments;
    }
    TextKind::Other
}

/// The root element's local name, without parsing the document.
fn root_name(start: &str) -> &str {
    let mut rest = start;
    while let Some(open) = rest.find('<') {
        let after = &rest[open + 1..];
        let (skipped, close) = match after {
            _ if after.starts_with('?') => (true, "?>"),
            _ if after.starts_with("!--") => (true, "-->"),
            _ if after.starts_with('!') => (true, ">"),
            _ => (false, ""),
        };
        if !skipped {
            let end = after
                .find(|c: char| c.is_whitespace() || c == '>' || c == '/')
                .unwrap_or(after.len());
            let name = &after[..end];
            return name.rsplit(':').next().unwrap_or(name);
        }
        let Some(end) = after.find(close) else {
            break;
        };
        rest = &after[end + close.len()..];
    }
    ""
}
