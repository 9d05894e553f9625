//! Cameras from what vendors deliver: text and tags in, [`Rpc`] out. No files, no GDAL.
//!
//! Coordinates come out in one convention whatever the file's own: pixel centres at integers, the upper-left one (0, 0).
//! Input is taken to be hostile: nothing here panics, recurses without bound or allocates more than a few times the
//! text it was given, and errors name what is missing.

pub mod acquisition;
mod domain;
mod fields;
mod json;
mod statements;
mod text;
mod vendor_xml;
mod xml;

pub use acquisition::Acquisition;
pub use domain::{gdal_domain, geotiff_tag};
pub use json::satnerf_json;
pub use text::{fixed_width, ossim_geom, rpb, rpc_txt};
pub use vendor_xml::{dimap, maxar_xml};

use crate::Rpc;

/// What can be wrong with a file that should hold a camera.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReadError {
    /// A value that must be there is not.
    #[error("{format}: {field} is missing")]
    Missing {
        /// The format read.
        format: &'static str,
        /// Its name for the value.
        field: String,
    },
    /// A value that is not a number, not finite, or not allowed.
    #[error("{format}: {field} is {value:?}, expected {expected}")]
    BadValue {
        /// The format read.
        format: &'static str,
        /// Its name for the value.
        field: String,
        /// What stands there, shortened.
        value: String,
        /// What should.
        expected: &'static str,
    },
    /// Text that is not of the format at all.
    #[error("{format}: {reason}")]
    Malformed {
        /// The format read.
        format: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// Text that is no known format.
    #[error(
        "{file}: no camera recognised in {found}; known are RPB, _RPC.TXT, DIMAP RPC_*.XML, Maxar XML, Sat-NeRF and \
         VisSat JSON, ALOS RPC text and OSSIM .geom"
    )]
    Unrecognised {
        /// The name given to the text.
        file: String,
        /// What it is, as far as can be told.
        found: String,
    },
}

/// The kinds of text that hold cameras or acquisitions, told by content.
#[derive(Debug, Clone, PartialEq, Eq)]
enum TextKind {
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

/// The camera in `text`, its format recognised by content; `file_name` is for the error only.
///
/// # Errors
/// [`ReadError::Unrecognised`] when it is no known format, else the error of the format's own reader.
pub fn rpc_from_text(file_name: &str, text: &str) -> Result<Rpc, ReadError> {
    let unrecognised = |found: &str| ReadError::Unrecognised {
        file: file_name.to_owned(),
        found: found.to_owned(),
    };
    match kind(text) {
        TextKind::Dimap => dimap(text),
        TextKind::MaxarXml => maxar_xml(text),
        TextKind::OtherXml(root) => Err(unrecognised(&format!("XML with the root element <{root}>"))),
        TextKind::Json => satnerf_json(text),
        TextKind::Assignments if has_rpc_assignments(text) => rpb(text),
        TextKind::Assignments => Err(unrecognised("a list of assignments")),
        TextKind::Geom => ossim_geom(text),
        TextKind::RpcTxt => rpc_txt(text),
        TextKind::FixedWidth => fixed_width(text),
        TextKind::Other => Err(unrecognised("text")),
    }
}

/// Whether a list of assignments holds a camera and not only image metadata.
fn has_rpc_assignments(text: &str) -> bool {
    ["lineOffset", "lineNumCoef", "lineNumeratorCoefficients"]
        .iter()
        .any(|key| text.contains(key))
}

fn kind(text: &str) -> TextKind {
    let start = statements::without_mark(text).trim_start();
    if start.starts_with('<') {
        return match root_name(start) {
            "Dimap_Document" | "PHR_DIMAP_Document" => TextKind::Dimap,
            "isd" => TextKind::MaxarXml,
            root => TextKind::OtherXml(fields::shortened(root)),
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
    if text::looks_fixed_width(start) {
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
