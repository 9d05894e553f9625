//! Checks of an image and of the files beside it before GDAL opens them: GDAL blocks on pipes, and reads texts of any
//! length whole.

use crate::{RasterError, Result};
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// The longest text beside an image that GDAL may read, bytes. Its XML parser takes some twelve times as much memory.
const TEXT_MAX: u64 = 16 << 20;
/// Ends of the names of texts that GDAL reads whole.
const TEXTS: [&str; 17] = [
    ".xml", ".imd", ".rpb", ".rpc", ".dim", ".til", ".pvl", ".att", ".eph", ".geo", ".pass", ".hdr", ".prj", ".clr",
    ".stx", ".tab", ".man",
];
/// Parts of the names of other texts.
const TEXT_NAMES: [&str; 5] = ["rpc", "metadata", "mtl", "summary", "hdr"];
/// Largest number of nodes of an HFA file that are checked.
const NODES_MAX: usize = 100_000;

/// Names of the files in an image's folder, for GDAL, which otherwise lists the folder itself; `None` where it cannot
/// be listed. Refuses an image that is no regular file or has a file beside it that must not be opened.
pub(super) fn check(path: &Path) -> Result<Option<Vec<String>>> {
    let Ok(known) = fs::metadata(path) else {
        return Err(RasterError::Missing(path.to_owned()));
    };
    // Opening a pipe would block for ever.
    if !known.is_file() {
        let reason = "it is a folder, a device or a pipe".to_owned();
        return Err(RasterError::NotAnImage(path.to_owned(), reason));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let Ok(entries) = fs::read_dir(folder.unwrap_or_else(|| Path::new("."))) else {
        return Ok(None);
    };
    let mut names = Vec::new();
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
    for entry in entries.flatten() {
        names.extend(entry.file_name().into_string());
        let name = entry.file_name().to_string_lossy().to_lowercase();
        let is_text = TEXTS.iter().any(|end| name.ends_with(end))
            || name.ends_with(".txt") && (name.starts_with(&stem) || TEXT_NAMES.iter().any(|part| name.contains(part)));
        if !is_text && !name.starts_with(&stem) {
            continue;
        }
        // Links are followed, as GDAL follows them; one that leads nowhere is not read.
        let Ok(known) = fs::metadata(entry.path()) else {
            continue;
        };
        if !known.is_dir() && !known.is_file() {
            let reason = "it is a device or a pipe; move it away from the images";
            return Err(unreadable(&entry.path(), reason.to_owned()));
        }
        let opened = || File::open(entry.path()).ok();
        if name.ends_with(".msk") && known.is_file() && opened().and_then(hfa_leads_away).unwrap_or(false) {
            let reason = "the pixels of this mask are in another folder; make a GeoTIFF of it with gdal_translate";
            return Err(unreadable(&entry.path(), reason.to_owned()));
        }
        if is_text && known.is_file() && known.len() > TEXT_MAX {
            let bytes = known.len();
            let reason = format!("it has {bytes} bytes, more than the {TEXT_MAX} of a text beside an image");
            return Err(unreadable(&entry.path(), reason));
        }
    }
    Ok(Some(names))
}

fn unreadable(path: &Path, reason: String) -> RasterError {
    RasterError::Unreadable(path.to_owned(), reason)
}

/// Refuses a file that cannot be read, and an HFA file whose pixels are in another folder.
pub(super) fn check_pixels(path: &Path) -> Result<()> {
    let file = File::open(path).map_err(|error| unreadable(path, format!("{error}; check its permissions")))?;
    match hfa_leads_away(file) {
        Some(true) => {
            let reason = "its pixels are in another folder; make a GeoTIFF of it with gdal_translate";
            Err(unreadable(path, reason.to_owned()))
        }
        _ => Ok(()),
    }
}

/// True if the pixels of an HFA file (Erdas Imagine) are in a file of another folder: the node `ExternalRasterDMS`
/// names it. `None` where the file is of another format or ends early.
fn hfa_leads_away(mut file: File) -> Option<bool> {
    let mut at = |place: u32, length: usize| -> Option<Vec<u8>> {
        let mut bytes = vec![0; length];
        file.seek(SeekFrom::Start(place.into())).ok()?;
        file.read_exact(&mut bytes).ok()?;
        Some(bytes)
    };
    if at(0, 15)? != b"EHFA_HEADER_TAG" {
        return None;
    }
    let number = |bytes: &[u8], index: usize| -> Option<u32> {
        let bytes = bytes.get(4 * index..4 * index + 4)?;
        Some(u32::from_le_bytes(bytes.try_into().ok()?))
    };
    // The tag is followed by the offset of the header: version, free list, root. Fields of a node: next, previous,
    // parent, first child, data, their length, name.
    let header = number(&at(16, 4)?, 0)?;
    let mut places = vec![number(&at(header, 12)?, 2)?];
    for _ in 0..NODES_MAX {
        let Some(place) = places.pop() else {
            return Some(false);
        };
        let Some(node) = (place != 0).then(|| at(place, 88)).flatten() else {
            continue;
        };
        let name = node[24..].split(|&byte| byte == 0).next()?;
        if name.eq_ignore_ascii_case(b"ExternalRasterDMS") {
            let data = at(number(&node, 4)?, number(&node, 5)?.min(1 << 16) as usize)?;
            if data.iter().any(|byte| b"/\\:".contains(byte)) {
                return Some(true);
            }
        }
        places.extend([number(&node, 0)?, number(&node, 3)?]);
    }
    Some(true)
}
