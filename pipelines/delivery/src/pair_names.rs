//! Panchromatic and multispectral files of one acquisition recognised by vendors' names: `-P1BS-` and `-M1BS-` of
//! Maxar, `_P_` and `_MS_` of Airbus, `PAN` and `MSS` or `MUX` of GaoFen and SuperView.

use super::names::stem;
use super::tiles::ImageFiles;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Half of a bundle, from the file name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Half {
    Panchromatic,
    Multispectral,
}

/// Half of a bundle in a file's name, and the name with a placeholder for it, equal for both halves.
fn half_of(name: &str) -> Option<(Half, String)> {
    let mut half = None;
    let name = name.to_uppercase();
    // Pleiades Neo: `MS-FS` and `RGB` in one half, `PAN` and `P` in the other.
    let is_neo = name.contains("PNEO");
    let rest: Vec<String> = name
        .split(['-', '_', '.'])
        .filter(|part| !(is_neo && ["FS", "RGB", "P"].contains(part)))
        .map(|part| match (half, half_of_part(part)) {
            (None, Some(found)) => {
                half = Some(found.0);
                found.1
            }
            _ => part.to_owned(),
        })
        .collect();
    Some((half?, rest.join("_")))
}

/// Half of a bundle in one part of a name, and the placeholder, equal for both halves.
fn half_of_part(part: &str) -> Option<(Half, String)> {
    use Half::{Multispectral, Panchromatic};
    let both = |half: Half, rest: &str| Some((half, format!("*{rest}")));
    match part {
        "P" | "PAN" => return both(Panchromatic, ""),
        "MS" | "MSS" | "MUL" | "MUX" | "XS" => return both(Multispectral, ""),
        "PAN1" | "PAN2" => return both(Panchromatic, &part[3..]),
        "MSS1" | "MSS2" => return both(Multispectral, &part[3..]),
        _ => {}
    }
    // Maxar: P1BS, M2AS, P3DS …
    let mut letters = part.chars();
    let (first, level, rest) = (letters.next()?, letters.next()?, letters.as_str());
    let is_level = level.is_ascii_digit() && rest.len() == 2 && rest.chars().all(|c| c.is_ascii_uppercase());
    match (first, is_level) {
        ('P', true) => both(Panchromatic, &part[1..]),
        ('M', true) => both(Multispectral, &part[1..]),
        _ => None,
    }
}

/// Separates the multispectral halves from a list of images; returns the other images, and the multispectral half for
/// each panchromatic image that has one by its name.
pub(super) fn by_name(images: Vec<ImageFiles>) -> (Vec<ImageFiles>, BTreeMap<PathBuf, ImageFiles>) {
    let mut halves: BTreeMap<String, [Vec<ImageFiles>; 2]> = BTreeMap::new();
    for image in &images {
        if let Some((half, rest)) = half_of(&stem(&image.path)) {
            halves.entry(rest).or_default()[half as usize].push(image.clone());
        }
    }
    let of_two = halves.into_values();
    let of_two = of_two.filter(|[pan, colours]| pan.len() == 1 && colours.len() == 1);
    let of_two = of_two.filter_map(|[mut pan, mut colours]| Some((pan.pop()?.path, colours.pop()?)));
    let partners: BTreeMap<PathBuf, ImageFiles> = of_two.collect();
    let taken: Vec<&ImageFiles> = partners.values().collect();
    let left = images.iter().filter(|image| !taken.contains(image)).cloned().collect();
    (left, partners)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn paired(names: &[&str]) -> (Vec<String>, Vec<(String, String)>) {
        let files = super::super::stacks::images(
            names.iter().map(PathBuf::from).collect(),
            &super::super::files::Folders::default(),
        )
        .expect("no DIMAP");
        let (left, partners) = by_name(files);
        let text = |path: &Path| path.display().to_string();
        let pairs = partners.iter().map(|(pan, colours)| (text(pan), text(&colours.path)));
        (left.iter().map(|image| text(&image.path)).collect(), pairs.collect())
    }

    #[test]
    fn names_of_vendors_tell_which_files_belong_together() {
        for [pan, colours] in [
            [
                "16SEP18160424-P1BS-055_01_P001.TIF",
                "16SEP18160424-M1BS-055_01_P001.TIF",
            ],
            [
                "IMG_PHR1A_P_201604230834_SEN_R1C1.TIF",
                "IMG_PHR1A_MS_201604230834_SEN_R1C1.TIF",
            ],
            [
                "IMG_PNEO3_202207110043428_PAN_SEN_PWOI_000028290_1_1_F_1_P_R1C1.TIF",
                "IMG_PNEO3_202207110043428_MS-FS_SEN_PWOI_000028290_1_1_F_1_RGB_R1C1.TIF",
            ],
            ["GF2_PMS1_E113_L1A-PAN1.tiff", "GF2_PMS1_E113_L1A-MSS1.tiff"],
            ["SV1-01_2019_L1B-PAN.tiff", "SV1-01_2019_L1B-MUX.tiff"],
        ] {
            let (left, pairs) = paired(&[colours, pan]);
            assert_eq!(left, [pan]);
            assert_eq!(pairs, [(pan.to_owned(), colours.to_owned())]);
        }
    }

    #[test]
    fn other_names_stay_alone() {
        for names in [
            ["JAX_068_001_RGB.tif", "JAX_068_002_RGB.tif"],
            ["a-P1BS-1.tif", "a-M1BS-2.tif"],
            ["a-P1BS-1.tif", "a-P1BS-2.tif"],
            ["a_MS.tif", "b_P.tif"],
        ] {
            let (left, pairs) = paired(&names);
            assert_eq!((left.len(), pairs.len()), (2, 0), "{names:?}");
        }
    }
}
