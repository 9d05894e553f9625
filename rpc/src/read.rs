//! Cameras from vendors' files: text and tags in, [`Rpc`] out. No files, no GDAL.
//!
//! All readers return one convention: pixel centres at integers, the upper-left one (0, 0). Input is untrusted: nothing
//! here panics, recurses without bound or allocates more than a few times the size of the text. Errors name the missing
//! values.

pub mod acquisition;
pub mod calibration;
mod data_files;
mod domain;
mod error;
mod fields;
mod json;
mod kind;
mod statements;
mod text;
mod vendor_xml;
mod xml;

pub(crate) use fields::{Dialect, customary};
pub(crate) use json::SATNERF;

pub use acquisition::Acquisition;
pub use data_files::{DataFile, DataFiles, data_files};
pub use domain::{gdal_domain, geotiff_tag};
pub use error::ReadError;
pub use json::satnerf_json;
pub use text::{fixed_width, ossim_geom, rpb, rpc_txt};
pub use vendor_xml::{dimap, maxar_xml};

use crate::rpc::Rpc;
use kind::{TextKind, kind};

/// The camera in `text`, its format recognised by content; `file_name` appears in the error only. A text without any
/// decimal point is read with decimal commas too.
///
/// # Errors
/// [`ReadError::Unrecognised`] when it is no known format, else the error of the format's own reader.
pub fn rpc_from_text(file_name: &str, text: &str) -> Result<Rpc, ReadError> {
    let found = with_points(file_name, text);
    match decimal_points(text).filter(|_| found.is_err()) {
        Some(text) => with_points(file_name, &text).or(found),
        None => found,
    }
}

/// `text` with its decimal commas replaced by points; `None` where it has decimal points too, or no comma between
/// digits.
fn decimal_points(text: &str) -> Option<String> {
    let is_between_digits = |at: usize| {
        let digit = |at: Option<usize>| {
            at.and_then(|at| text.as_bytes().get(at))
                .is_some_and(u8::is_ascii_digit)
        };
        digit(at.checked_sub(1)) && digit(at.checked_add(1))
    };
    if text.match_indices('.').any(|(at, _)| is_between_digits(at)) {
        return None;
    }
    let mut changed = text.to_owned();
    for (at, comma) in text.match_indices(',').filter(|(at, _)| is_between_digits(*at)) {
        changed.replace_range(at..at + comma.len(), ".");
    }
    (changed != text).then_some(changed)
}

fn with_points(file_name: &str, text: &str) -> Result<Rpc, ReadError> {
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

/// True if a list of assignments contains a camera, and not image metadata alone.
fn has_rpc_assignments(text: &str) -> bool {
    ["lineOffset", "lineNumCoef", "lineNumeratorCoefficients"]
        .iter()
        .any(|key| text.contains(key))
}
