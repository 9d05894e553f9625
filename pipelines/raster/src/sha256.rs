//! SHA-256 sums of files and values, hexadecimal.

use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{Read, Result};
use std::path::Path;

/// SHA-256 of bytes.
pub fn of_bytes(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

/// SHA-256 of the content of a file.
///
/// # Errors
/// When the file cannot be read.
pub fn of_file(path: &Path) -> Result<String> {
    of_start(path, u64::MAX)
}

/// SHA-256 of the first `bytes` of a file.
///
/// # Errors
/// When the file cannot be read.
pub fn of_start(path: &Path, bytes: u64) -> Result<String> {
    let mut hasher = Sha256::new();
    std::io::copy(&mut File::open(path)?.take(bytes), &mut hasher)?;
    Ok(hex::encode(hasher.finalize()))
}

/// SHA-256 of the little-endian bytes of numbers.
pub fn of_values(values: &[f32]) -> String {
    let mut hasher = Sha256::new();
    values.iter().for_each(|value| hasher.update(value.to_le_bytes()));
    hex::encode(hasher.finalize())
}
