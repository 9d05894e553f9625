//! Cameras in vendors' XML: DIMAP (Pleiades, SPOT 6/7, Pleiades Neo) and Maxar.

use super::error::ReadError;
use super::fields::{Dialect, TextSource, camera, customary, numbered_from_one};
use super::text::of_specification;
use super::xml::{child_text, find, parse, text as text_of};
use crate::rpc::Rpc;
use roxmltree::Node;

/// The camera of a DIMAP `RPC_*.XML`.
///
/// Only the ground-to-image model is read; the image-to-ground model is a separate fit and not its inverse. Pleiades
/// and SPOT 6/7 count rows and columns from 1, Pleiades Neo from 0: the returned offsets count from 0.
///
/// # Errors
/// When the text is not XML, holds no ground-to-image model, or a value is missing or is not a number.
pub fn dimap(text: &str) -> Result<Rpc, ReadError> {
    let dialect = customary("DIMAP RPC");
    let document = parse(dialect.format, text)?;
    let root = document.root_element();
    let global = find(root, "Global_RFM").ok_or_else(|| dialect.missing("Global_RFM (a DIMAP RPC_*.XML has it)"))?;
    let (model, is_neo) = match (find(global, "Inverse_Model"), find(global, "GroundtoImage_Values")) {
        (Some(model), _) => (model, false),
        (None, Some(model)) => (model, true),
        (None, None) => return Err(dialect.missing("Inverse_Model or GroundtoImage_Values")),
    };
    let validity = find(global, "RFM_Validity").ok_or_else(|| dialect.missing("RFM_Validity"))?;
    let source = TextSource {
        lookup: |name: &str| child_text(model, name).or_else(|| child_text(validity, name)),
        numbered: Some(numbered_from_one),
    };
    let rpc = camera(&dialect, &source)?;
    let counts_from_one = match text_of(root, "METADATA_PROFILE").map(str::trim) {
        Some(profile) if profile.starts_with("PNEO") => false,
        Some(profile) if ["PHR", "S6", "S7"].iter().any(|known| profile.starts_with(known)) => true,
        _ => !is_neo,
    };
    Ok(if counts_from_one { rpc.cropped(1.0, 1.0) } else { rpc })
}

/// The camera of a Maxar (DigitalGlobe) product `.XML` (`isd/RPB/IMAGE`).
///
/// # Errors
/// When the text is not XML, holds no `RPB`, is not RPC00B, or a value is missing or is not a number.
pub fn maxar_xml(text: &str) -> Result<Rpc, ReadError> {
    let document = parse(MAXAR.format, text)?;
    let rpb = find(document.root_element(), "RPB").ok_or_else(|| MAXAR.missing("RPB"))?;
    let specification = child_text(rpb, "SPECID").unwrap_or("RPC00B");
    let image = find(rpb, "IMAGE").ok_or_else(|| MAXAR.missing("RPB/IMAGE"))?;
    let source = TextSource {
        lookup: |name: &str| value_or_list(image, name),
        numbered: None,
    };
    of_specification(&MAXAR, "SPECID", specification, &source)
}

/// `<NAME>value</NAME>`, or `<NAMEList><NAME>values</NAME></NAMEList>`.
fn value_or_list<'a>(image: Node<'a, '_>, name: &str) -> Option<&'a str> {
    child_text(image, name).or_else(|| text_of(image, name))
}

const MAXAR: Dialect = Dialect {
    format: "Maxar XML",
    scalars: [
        "LINEOFFSET",
        "SAMPOFFSET",
        "LATOFFSET",
        "LONGOFFSET",
        "HEIGHTOFFSET",
        "LINESCALE",
        "SAMPSCALE",
        "LATSCALE",
        "LONGSCALE",
        "HEIGHTSCALE",
    ],
    polynomials: ["LINENUMCOEF", "LINEDENCOEF", "SAMPNUMCOEF", "SAMPDENCOEF"],
    errors: ["ERRBIAS", "ERRRAND"],
};
