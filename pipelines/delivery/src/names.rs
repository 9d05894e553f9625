//! Names of the files of a scene: images, truth and masks.

use std::path::Path;

/// Extensions of images, in lower case.
pub(super) const IMAGE_EXTENSIONS: [&str; 6] = ["tif", "tiff", "jp2", "ntf", "nitf", "img"];

/// True if the name of a raster marks it as truth: `*_DSM.tif`, `*_CLS.tif`, `*_DTM.tif` and similar names, or a name
/// that this program writes.
pub(super) fn is_truth(path: &Path) -> bool {
    let name = stem(path).to_lowercase();
    let ends = ["_dsm", "_dtm", "_cls", "_cls_v2", "_agl", "_water"];
    ["dsm", "classes", "albedo", "water"].contains(&name.as_str())
        || name.starts_with("shadow_")
        || name.starts_with("cloud_")
        || ends.iter().any(|end| name.ends_with(end))
}

/// Common part of the names of a mask and its images, in lower case: the name without `_udm`, `_udm2` or `_udm2_clip`
/// (Planet), or without `_mask`, `_cloud` or `_clouds`; `None` for any other file.
pub(super) fn mask_of(path: &Path) -> Option<String> {
    let name = stem(path).to_lowercase();
    let whole = name.strip_suffix("_clip").unwrap_or(&name);
    let ends = ["_udm2", "_udm", "_mask", "_clouds", "_cloud"];
    ends.iter().find_map(|end| whole.strip_suffix(end)).map(str::to_owned)
}

/// The folder of an image; `.` for a bare file name.
pub(super) fn folder_of(image: &Path) -> &Path {
    let folder = image.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or_else(|| Path::new("."))
}

/// File name without its extension.
pub(super) fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// File name as text.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// True if a path has one of the `extensions`, in upper or lower case.
pub(super) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    extensions.contains(&extension.as_str())
}
