//! Cameras in vendors' text files: RPB, `_RPC.TXT` in its dialects, OSSIM `.geom`, and fixed-width RPC00B.

use super::error::ReadError;
use super::fields::{Dialect, OrderedSource, Source, TextSource, camera, customary, number, numbered_from_one};
use super::statements::{assignments, colon_lines, without_mark};
use crate::rpc::Rpc;
use std::collections::HashMap;

/// Characters of the numbers of an RPC00B record: 66 of ten scalars, and twelve of each of eighty coefficients.
const FIXED_WIDTH: usize = 66 + 80 * 12;
/// Width of an RPC00B in a NITF tagged record, which has SUCCESS, ERR_BIAS and ERR_RAND in front.
const NITF_WIDTH: usize = 15 + FIXED_WIDTH;

/// The camera of a Maxar `.RPB` file; OrbView's `.pvl` names are read as well.
///
/// # Errors
/// When a value is missing or is not a number, or the file states another specification than RPC00B.
pub fn rpb(text: &str) -> Result<Rpc, ReadError> {
    let mut values: HashMap<String, &str> = HashMap::new();
    for statement in assignments(text) {
        values
            .entry(statement.key.to_ascii_lowercase())
            .or_insert(statement.value);
    }
    let dialect = if values.contains_key("pixeloffset") { &PVL } else { &RPB };
    let specification = values.get("specid").copied().unwrap_or("RPC00B");
    let source = TextSource {
        lookup: |name: &str| values.get(&name.to_ascii_lowercase()).copied(),
        numbered: None,
    };
    of_specification(dialect, "SpecId", specification, &source)
}

const RPB: Dialect = Dialect {
    format: "RPB",
    scalars: [
        "lineOffset",
        "sampOffset",
        "latOffset",
        "longOffset",
        "heightOffset",
        "lineScale",
        "sampScale",
        "latScale",
        "longScale",
        "heightScale",
    ],
    polynomials: ["lineNumCoef", "lineDenCoef", "sampNumCoef", "sampDenCoef"],
    errors: ["errBias", "errRand"],
};

const PVL: Dialect = Dialect {
    format: "OrbView PVL",
    scalars: [
        "lineOffset",
        "pixelOffset",
        "latitudeOffset",
        "longitudeOffset",
        "heightOffset",
        "lineScale",
        "pixelScale",
        "latitudeScale",
        "longitudeScale",
        "heightScale",
    ],
    polynomials: [
        "lineNumeratorCoefficients",
        "lineDenominatorCoefficients",
        "pixelNumeratorCoefficients",
        "pixelDenominatorCoefficients",
    ],
    errors: ["errorBias", "errorRand"],
};

/// Index in the order of RPC00A (STDI-0002) of each coefficient of RPC00B; RPC00A has
/// `1 L P H LP LH PH LPH LL PP HH LLL LLP LLH LPP PPP PPH LHH PHH HHH`.
const OF_RPC00A: [usize; 20] = [0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 7, 11, 14, 17, 12, 15, 18, 13, 16, 19];

/// The camera of a file that states RPC00A or RPC00B, the order of its coefficients.
///
/// # Errors
/// When the specification is neither, and those of [`camera`].
pub(super) fn of_specification(
    dialect: &Dialect,
    field: &str,
    specification: &str,
    source: &impl Source,
) -> Result<Rpc, ReadError> {
    let name = specification.trim().trim_matches('"').to_ascii_uppercase();
    let rpc = camera(dialect, source)?;
    let ordered = |of_a: [f64; 20]| OF_RPC00A.map(|place| of_a[place]);
    match name.as_str() {
        "RPC00B" | "B" => Ok(rpc),
        "RPC00A" | "A" => Ok(Rpc {
            line_numerator: ordered(rpc.line_numerator),
            line_denominator: ordered(rpc.line_denominator),
            sample_numerator: ordered(rpc.sample_numerator),
            sample_denominator: ordered(rpc.sample_denominator),
            ..rpc
        }),
        _ => Err(dialect.bad(
            field,
            &name,
            "RPC00A or RPC00B (others order the coefficients otherwise)",
        )),
    }
}

/// The camera of an `_RPC.TXT` / `.rpc` file: `LINE_OFF: +013741.00 pixels`, ..., `LINE_NUM_COEFF_1: ...`, in the
/// dialects of IKONOS, GeoEye, OrbView, Planet, KOMPSAT, EROS and the Ames Stereo Pipeline.
///
/// # Errors
/// When a value is missing or is not a number.
pub fn rpc_txt(text: &str) -> Result<Rpc, ReadError> {
    let mut values: HashMap<String, &str> = HashMap::new();
    for line in without_mark(text).lines() {
        let line = line.trim();
        let end = line
            .find(|c: char| c == ':' || c == '=' || c.is_whitespace())
            .unwrap_or(line.len());
        let value = line[end..].trim_start_matches(|c: char| c == ':' || c == '=' || c.is_whitespace());
        values.entry(line[..end].to_ascii_uppercase()).or_insert(value);
    }
    let source = TextSource {
        lookup: |name: &str| values.get(name).copied(),
        numbered: Some(numbered_from_one),
    };
    camera(&customary("_RPC.TXT"), &source)
}

/// The camera of an OSSIM / Orfeo Toolbox `.geom` keyword list (`line_off`, ..., `line_num_coeff_00`, ...), with any
/// prefix before the keys.
///
/// # Errors
/// When a value is missing or is not a number, or `polynomial_format` is not `B`.
pub fn ossim_geom(text: &str) -> Result<Rpc, ReadError> {
    const FORMAT: &str = "OSSIM .geom";
    let mut values: HashMap<&str, &str> = HashMap::new();
    for line in colon_lines(text) {
        let key = line.key.rsplit('.').next().unwrap_or(line.key);
        values.entry(key).or_insert(line.value);
    }
    let specification = values.get("polynomial_format").copied().unwrap_or("B");
    let lower = |name: &str| name.to_ascii_lowercase();
    let source = TextSource {
        lookup: |name: &str| values.get(lower(name).as_str()).copied(),
        numbered: Some(|name, index| format!("{name}_{index:02}")),
    };
    of_specification(&customary(FORMAT), "polynomial_format", specification, &source)
}

/// The camera of RPC00B's fixed-width text: ALOS `RPC-*.txt`, or the value of a NITF RPC00B record.
///
/// # Errors
/// When the text is too short, or a field is not a number.
pub fn fixed_width(text: &str) -> Result<Rpc, ReadError> {
    let dialect = customary("fixed-width RPC00B");
    let text = without_mark(text).trim_end();
    let is_nitf = text.len() == NITF_WIDTH;
    let start = if is_nitf { 15 } else { 0 };
    if text.len() < start + FIXED_WIDTH || !text.is_ascii() {
        return Err(ReadError::Malformed {
            format: dialect.format,
            reason: format!("{} characters, expected at least {FIXED_WIDTH} of ASCII", text.len()),
        });
    }
    let mut values = [-1.0; 92];
    if is_nitf {
        values[0] = dialect.number_in("ERR_BIAS", &text[1..8])?;
        values[1] = dialect.number_in("ERR_RAND", &text[8..15])?;
    }
    let widths = [6, 5, 8, 9, 5, 6, 5, 8, 9, 5]
        .into_iter()
        .chain(std::iter::repeat_n(12, 80));
    let mut at = start;
    for (index, width) in widths.enumerate() {
        let field = &text[at..at + width];
        let name = dialect.scalars.get(index).copied().unwrap_or("a coefficient");
        values[2 + index] = dialect.number_in(name, field)?;
        at += width;
    }
    camera(&dialect, &OrderedSource { values: &values })
}

/// True if a text looks like [`fixed_width`]: numbers without separators, and nothing else.
pub(super) fn looks_fixed_width(text: &str) -> bool {
    let text = text.trim_end();
    let first = text.get(..6).and_then(number);
    text.len() >= FIXED_WIDTH
        && first.is_some()
        && text
            .bytes()
            .all(|b| b.is_ascii_digit() || matches!(b, b'+' | b'-' | b'.' | b'E' | b'e' | b'\n' | b'\r'))
}
