//! Reading of untrusted files: regular files of bounded size alone. A pipe would block, and a device would never end.

use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// Largest text that is read, bytes. Cameras, metadata, manifests and `model.json` of thousands of images are far
/// smaller.
pub const TEXT_MAX: u64 = 64 << 20;

/// Largest model that is read, bytes: a hundred million Gaussians.
pub const MODEL_MAX: u64 = 16 << 30;

/// The bytes of a file of at most `limit` bytes.
///
/// # Errors
/// Errors of the operating system; `InvalidData` if the path is no regular file, or the file is larger.
pub fn read_bytes(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let refused = |text: String| Error::new(ErrorKind::InvalidData, text);
    // Checked before opening, because opening a pipe blocks.
    let known = std::fs::metadata(path)?;
    if known.is_dir() {
        return Err(refused("it is a folder, not a file".into()));
    }
    if !known.is_file() {
        return Err(refused("it is no regular file but a device or a pipe".into()));
    }
    if known.len() > limit {
        let bytes = known.len();
        let text = format!("it has {bytes} bytes, more than the {limit} that such a file may have");
        return Err(refused(text));
    }
    let mut bytes = Vec::new();
    // The read is limited too: files of /proc report a size of zero, and a file may grow meanwhile.
    File::open(path)?.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        return Err(refused(format!("it has more than {limit} bytes")));
    }
    Ok(bytes)
}

/// The text of a file of at most [`TEXT_MAX`] bytes.
///
/// # Errors
/// Those of [`read_bytes`]; `InvalidData` also where the text is not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    String::from_utf8(read_bytes(path, TEXT_MAX)?)
        .map_err(|_| Error::new(ErrorKind::InvalidData, "it is not UTF-8 text"))
}

/// The text of a file of at most [`TEXT_MAX`] bytes, with invalid UTF-8 replaced by U+FFFD. A text with a byte order
/// mark of UTF-16, as some editors write it, is decoded as UTF-16.
///
/// # Errors
/// Those of [`read_bytes`]: errors of the operating system, no regular file, or a larger file.
pub fn read_text_lossy(path: &Path) -> Result<String> {
    let bytes = read_bytes(path, TEXT_MAX)?;
    let unit = match bytes.get(..2) {
        Some([0xff, 0xfe]) => u16::from_le_bytes,
        Some([0xfe, 0xff]) => u16::from_be_bytes,
        _ => return Ok(String::from_utf8_lossy(&bytes).into_owned()),
    };
    let units: Vec<u16> = bytes[2..].as_chunks().0.iter().map(|pair| unit(*pair)).collect();
    Ok(String::from_utf16_lossy(&units))
}

/// At most the first `count` bytes of a regular file; empty where it cannot be read.
pub fn read_start(path: &Path, count: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    if path.is_file()
        && let Ok(file) = File::open(path)
        && file.take(count).read_to_end(&mut bytes).is_err()
    {
        bytes.clear();
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_of_bounded_size_are_read() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("a");
        std::fs::write(&file, b"12345").expect("written");
        assert_eq!(read_bytes(&file, 5).expect("small enough"), b"12345");
        assert!(read_bytes(&file, 4).is_err());
        for bytes in [&b"\xff\xfea\0=\0"[..], b"\xfe\xff\0a\0="] {
            std::fs::write(&file, bytes).expect("written");
            assert_eq!(read_text_lossy(&file).expect("text"), "a=");
        }
        assert!(read_bytes(folder.path(), 5).is_err());
        if Path::new("/dev/zero").exists() {
            let error = read_bytes(Path::new("/dev/zero"), 5).expect_err("endless");
            assert!(error.to_string().contains("device"), "{error}");
        }
    }
}
