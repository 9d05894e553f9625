//! Framing of binary PLY files of named float columns, one row for each Gaussian. The columns are defined by the
//! callers.

use std::fmt::Write;

/// Longest header; a file with more rows than its bytes hold is refused before any allocation.
const HEADER_LIMIT: usize = 64 * 1024;
const FORMAT: &str = "ply\nformat binary_little_endian 1.0\n";
const END: &[u8] = b"end_header\n";

/// Header of a file of `count` rows with these comments and columns; the rows follow it as little-endian 32-bit floats.
/// Comments are single lines: line breaks in them become spaces.
pub fn header<'a>(comments: &[String], count: usize, columns: impl Iterator<Item = &'a str>) -> Vec<u8> {
    let mut text = format!("{FORMAT}comment heliosplat\n");
    for comment in comments {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "comment {}", comment.replace(['\n', '\r'], " "));
    }
    let _ = writeln!(text, "element vertex {count}");
    for column in columns {
        let _ = writeln!(text, "property float {column}");
    }
    let mut bytes = text.into_bytes();
    bytes.extend_from_slice(END);
    bytes
}

/// Splits a file into its header, a text, and the bytes after it, whatever ends the lines.
///
/// # Errors
/// A sentence on the fault of the file.
pub fn split(bytes: &[u8]) -> Result<(&str, &[u8]), String> {
    const END: &[u8] = b"end_header";
    let head = &bytes[..bytes.len().min(HEADER_LIMIT)];
    let mut windows = head.windows(END.len());
    let end = windows.position(|w| w == END).ok_or("it has no PLY header")?;
    let header = std::str::from_utf8(&head[..end]).map_err(|_| "its header is not text")?;
    let body = &bytes[end + END.len()..];
    let body = body.strip_prefix(b"\r").unwrap_or(body);
    let body = body.strip_prefix(b"\n").ok_or("its header has no end")?;
    Ok((header, body))
}

/// Columns and rows of a file.
pub struct Rows<'a> {
    /// Number of rows.
    pub count: usize,
    /// Names of the columns, in their order.
    pub columns: Vec<&'a str>,
    values: &'a [u8],
}

impl<'a> Rows<'a> {
    /// Reads the header of a file and checks that its rows are complete.
    ///
    /// # Errors
    /// A sentence on the fault of the file.
    pub fn open(bytes: &'a [u8]) -> Result<Self, String> {
        let (header, values) = split(bytes)?;
        if !header.starts_with(FORMAT) {
            return Err("it is not a binary little-endian PLY".into());
        }
        let count = header.lines().find_map(|line| line.strip_prefix("element vertex "));
        let count = count.and_then(|count| count.trim().parse::<usize>().ok());
        let count = count.ok_or("it does not state its number of Gaussians")?;
        let properties = header.lines().filter_map(|line| line.strip_prefix("property "));
        let columns = properties.map(|property| property.strip_prefix("float ").map(str::trim));
        let columns: Option<Vec<_>> = columns.collect();
        let columns = columns.ok_or("it has properties that are not floats")?;
        let bytes = values.len();
        if count.checked_mul(columns.len() * size_of::<f32>()) != Some(bytes) {
            return Err(format!("it claims {count} Gaussians but holds {bytes} bytes of them"));
        }
        Ok(Self { count, columns, values })
    }

    /// Value at a row and a column, both of which must exist.
    pub fn value(&self, row: usize, column: usize) -> f32 {
        let at = (row * self.columns.len() + column) * size_of::<f32>();
        let mut value = [0; size_of::<f32>()];
        value.copy_from_slice(&self.values[at..at + size_of::<f32>()]);
        f32::from_le_bytes(value)
    }
}
