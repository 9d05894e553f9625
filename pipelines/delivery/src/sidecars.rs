//! The text files beside an image, found by their names.

use super::entry::ImageEntry;
use super::files::Folders;
use super::names::{file_name, folder_of, stem};
use super::{Result, dimap, tiles};
use heliosplat_raster::is_virtual;
use std::path::{Path, PathBuf};

/// All texts that describe an image, by precedence: the metadata file in `scene.toml`, the JSON that names the image,
/// and the texts beside the image.
pub(super) fn describing_texts(entry: &ImageEntry, image: &Path, folders: &Folders) -> Result<Vec<PathBuf>> {
    let said = entry.said.as_ref().and_then(|said| said.metadata.clone());
    let mut texts: Vec<PathBuf> = said.into_iter().chain(entry.json.clone()).collect();
    texts.extend(belonging_texts(image, folders)?);
    Ok(texts)
}

/// Text files beside an image that belong to it by their name: `X.RPB`, `X_RPC.TXT`, `X.XML`, `RPC_X.XML`, `DIM_X.XML`
/// … for an image `X.TIF` or `IMG_X_R1C1.TIF`.
pub(super) fn belonging_texts(image: &Path, folders: &Folders) -> Result<Vec<PathBuf>> {
    if is_virtual(image) {
        return Ok(Vec::new());
    }
    let name = stem(image).to_lowercase();
    // The texts of a product apply to its tiles.
    let whole = tiles::product_name(&name);
    let product = whole.as_deref().unwrap_or(&name);
    let product = product.strip_prefix("img_").unwrap_or(product);
    let mut wanted: Vec<String> = Vec::new();
    for end in [
        ".rpb",
        "_rpc.txt",
        ".rpc",
        "_rpc.xml",
        ".imd",
        ".xml",
        ".json",
        ".txt",
        ".pvl",
        "_metadata.txt",
        "_metadata.xml",
        "_dim.xml",
        "_stac.json",
    ] {
        wanted.push(format!("{name}{end}"));
        wanted.extend(whole.as_ref().map(|whole| format!("{whole}{end}")));
    }
    for start in ["rpc_", "dim_"] {
        wanted.push(format!("{start}{product}.xml"));
    }
    let by_name = folders.by_name(folder_of(image))?;
    let named = |want: &String| by_name.get(want).cloned();
    let mut found: Vec<PathBuf> = wanted.iter().filter_map(named).collect();
    // A DIMAP lists its images, whatever their names.
    if let Some(dimap) = folders.dimaps(folder_of(image))?.of_image(image) {
        let rest = file_name(dimap).to_lowercase();
        let camera = rest.strip_prefix(dimap::PREFIX).map(|rest| format!("rpc_{rest}"));
        for path in camera.as_ref().and_then(named).into_iter().chain([dimap.clone()]) {
            if !found.contains(&path) {
                found.push(path);
            }
        }
    }
    Ok(found)
}
