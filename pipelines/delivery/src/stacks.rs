//! Bands of one acquisition in several files, recognised by vendors' names: `…_RGB_…` and `…_NED_…` of Pleiades Neo,
//! `…_red_…`, `…_grn_…`, `…_blu_…` and `…_nir_…` of GeoEye.

use super::Result;
use super::files::Folders;
use super::names::stem;
use super::tiles::{self, ImageFiles};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Parts of file names and the bands of such files, under the names that [`super::bands`] recognises, in band order of
/// the joined image.
const PARTS: [(&str, &[&str]); 8] = [
    ("RGB", &["red", "green", "blue"]),
    ("RED", &["red"]),
    ("GRN", &["green"]),
    ("GREEN", &["green"]),
    ("BLU", &["blue"]),
    ("BLUE", &["blue"]),
    ("NIR", &["near_infrared"]),
    // NED: near infrared, red edge, deep blue.
    ("NED", &["near_infrared", "red_edge", "deep_blue"]),
];

/// Index in `PARTS` of the bands in a file name, and the name with a placeholder for them, equal for all files of one
/// acquisition.
fn part_of(name: &str) -> Option<(usize, String)> {
    let name = name.to_uppercase();
    let mut parts: Vec<&str> = name.split('_').collect();
    // The last part counts: place names contain Red and Blue too.
    let (at, which) = (0..parts.len()).rev().find_map(|at| {
        let which = PARTS.iter().position(|(part, _)| *part == parts[at])?;
        Some((at, which))
    })?;
    parts[at] = "*";
    Some((which, parts.join("_")))
}

/// Groups files into images: the tiles of an image become one image, and so do the files of its bands.
///
/// # Errors
/// Those of [`tiles::joined`].
pub(super) fn images(files: Vec<PathBuf>, folders: &Folders) -> Result<Vec<ImageFiles>> {
    Ok(joined(tiles::joined(files, folders)?))
}

/// Joins images whose names differ in the band part alone: separate files of red, green and blue, or RGB and NED.
fn joined(images: Vec<ImageFiles>) -> Vec<ImageFiles> {
    let mut groups: BTreeMap<(PathBuf, String), BTreeMap<usize, usize>> = BTreeMap::new();
    for (index, image) in images.iter().enumerate() {
        if let Some((which, rest)) = part_of(&stem(&image.path)) {
            let folder = image.path.parent().unwrap_or_else(|| Path::new("")).to_owned();
            groups.entry((folder, rest)).or_default().insert(which, index);
        }
    }
    groups.retain(|_, files| {
        let names: Vec<&str> = files.keys().flat_map(|which| PARTS[*which].1).copied().collect();
        let of = |name: &str| names.iter().filter(|other| **other == name).count();
        let is_colour = ["red", "green", "blue"].iter().all(|name| of(name) == 1);
        files.len() > 1 && is_colour && names.iter().all(|name| of(name) == 1)
    });
    let first_of = |index: usize| {
        let mut files = groups.values();
        files.find(|files| files.values().any(|other| *other == index))
    };
    let mut out = Vec::with_capacity(images.len());
    for (index, image) in images.iter().enumerate() {
        match first_of(index) {
            None => out.push(image.clone()),
            Some(files) if files.values().next() == Some(&index) => {
                let mut named = files.iter().map(|(which, file)| ImageFiles {
                    bands: PARTS[*which].1,
                    ..images[*file].clone()
                });
                if let Some(first) = named.next() {
                    let more = named.collect();
                    out.push(ImageFiles { more, ..first });
                }
            }
            Some(_) => {}
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(files: &[&str]) -> Vec<Vec<String>> {
        let images = joined(files.iter().map(|file| ImageFiles::one(PathBuf::from(file))).collect());
        let of = |image: &ImageFiles| {
            let all = std::iter::once(&image.path).chain(image.more.iter().map(|other| &other.path));
            all.map(|path| path.display().to_string()).collect()
        };
        images.iter().map(of).collect()
    }

    #[test]
    fn files_of_bands_are_one_image() {
        assert_eq!(
            names(&["IMG_1_NED_R1C1.TIF", "IMG_1_RGB_R1C1.TIF", "IMG_2_RGB_R1C1.TIF"]),
            [
                vec!["IMG_1_RGB_R1C1.TIF", "IMG_1_NED_R1C1.TIF"],
                vec!["IMG_2_RGB_R1C1.TIF"]
            ]
        );
        assert_eq!(
            names(&["po_7_blu_0.tif", "po_7_grn_0.tif", "po_7_nir_0.tif", "po_7_red_0.tif"]),
            [vec![
                "po_7_red_0.tif",
                "po_7_grn_0.tif",
                "po_7_blu_0.tif",
                "po_7_nir_0.tif"
            ]]
        );
        assert_eq!(
            names(&["a_RGB.tif", "b_RGB.tif", "Red_Sea_1.tif", "Blue_Sea_1.tif"]).len(),
            4
        );
        assert_eq!(names(&["a_red.tif", "a_nir.tif"]).len(), 2, "no colours");
    }
}
