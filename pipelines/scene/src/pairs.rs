//! Panchromatic and multispectral images of one acquisition: which belong together, and one image of both.
//!
//! Vendors deliver such bundles in two files of the same ground and second. They are told by their names (`-P1BS-` and `-M1BS-` of Maxar,
//! `_P_` and `_MS_` of Airbus, `PAN` and `MSS` or `MUX` of GaoFen and SuperView), or by their times; their cameras must agree.

use super::bands::{self, BandPlan};
use super::draft::Draft;
use super::files::stem;
use super::layout::ImageEntry;
use super::tiles::ImageFiles;
use super::{BandKind, RpcPreference, SceneError, Split, acquisition, camera, satnerf};
use heliosplat_raster::{GridRelation, RasterFile};
use heliosplat_rpc::read::acquisition::Acquisition;
use heliosplat_rpc::{ImagePoint, Rpc, RpcError};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Which half of a bundle a name says a file is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Half {
    Panchromatic,
    Multispectral,
}

/// Cameras of one acquisition must agree to this, multispectral pixels.
const AGREE_PX: f64 = 1.0;
/// Panchromatic pixels along the side of a multispectral one: four for all satellites of today, five for KOMPSAT's and some others.
const RATIOS: std::ops::RangeInclusive<f64> = 1.8..=6.5;
/// Both halves are taken within this time; the images of a stereo pair in one pass lie tens of seconds apart, milliseconds.
const SAME_TIME_MS: i64 = 2_500;
/// Share of the panchromatic image that the other must show.
const LEAST_SHOWN: f64 = 0.5;

/// What a file's name says of a bundle: its half, and the rest of the name, which both halves have in common.
fn half_of(name: &str) -> Option<(Half, String)> {
    let mut half = None;
    let rest: Vec<String> = name
        .to_uppercase()
        .split(['-', '_', '.'])
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

/// What one part of a name says, and what stands for it in both halves.
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

/// Takes the multispectral halves out of a list of images; what is left comes with the multispectral half of each panchromatic image,
/// as far as names tell.
pub(super) fn by_name(images: Vec<ImageFiles>) -> (Vec<ImageFiles>, BTreeMap<PathBuf, ImageFiles>) {
    let mut halves: BTreeMap<String, [Vec<ImageFiles>; 2]> = BTreeMap::new();
    for image in &images {
        if let Some((half, rest)) = half_of(&stem(&image.path)) {
            halves.entry(rest).or_default()[half as usize].push(image.clone());
        }
    }
    let of_two = halves.into_values().filter_map(|[mut pan, mut colours]| {
        let both = pan.len() == 1 && colours.len() == 1;
        if !both {
            return None;
        }
        Some((pan.pop()?.path, colours.pop()?))
    });
    let partners: BTreeMap<PathBuf, ImageFiles> = of_two.collect();
    let taken: Vec<&ImageFiles> = partners.values().collect();
    let left = images.iter().filter(|image| !taken.contains(image)).cloned().collect();
    (left, partners)
}

/// Both halves as one image.
pub(super) struct Sharpened {
    pub(super) file: RasterFile,
    pub(super) plan: BandPlan,
    /// What the multispectral half says of time and sun.
    pub(super) acquisition: Acquisition,
}

/// The pansharpened image of a panchromatic one, whose camera is `rpc`, and its multispectral half.
pub(super) fn sharpened(
    pan: RasterFile,
    rpc: &Rpc,
    multispectral: &ImageFiles,
    declared: Option<&[BandKind]>,
) -> Result<Sharpened, SceneError> {
    let pan_path = pan.path().to_owned();
    let not_a_pair = |reason: String| SceneError::NotAPair {
        pan: pan_path.clone(),
        multispectral: multispectral.path.clone(),
        reason,
    };
    let colours = multispectral.open()?;
    if pan.bands.len() != 1 || colours.bands.len() < 3 {
        let (one, other) = (pan.bands.len(), colours.bands.len());
        return Err(not_a_pair(format!("they have {one} and {other} bands")));
    }
    let entry = ImageEntry {
        name: stem(&multispectral.path),
        path: multispectral.path.clone(),
        split: Split::Train,
        json: satnerf::beside(&multispectral.path),
        said: None,
        tiles: multispectral.clone(),
        multispectral: None,
    };
    let mut ignored = Vec::new();
    let camera = camera::find(&colours, &entry, RpcPreference::Image, &mut ignored)?;
    // A camera that somebody adjusted is none of the vendor's, whose two cameras belong together.
    let own = camera::from_gdal(&pan, &mut ignored)?;
    let own = own.map_or_else(|| rpc.clone(), |found| found.rpc);
    let found = relation(&own, pan.size(), &camera.rpc, colours.size())
        .map_err(|source| not_a_pair(format!("their cameras cannot be compared ({source})")))?;
    if let Some(reason) = found.fault() {
        return Err(not_a_pair(reason));
    }
    Ok(Sharpened {
        plan: bands::plan(&colours, declared)?,
        acquisition: acquisition::find(&colours, &entry)?,
        file: RasterFile::pansharpened(pan, colours, &found.relation)?,
    })
}

/// Where the pixels of a panchromatic image lie in the multispectral one.
struct Found {
    relation: GridRelation,
    /// Largest distance from it, multispectral pixels.
    residual_px: f64,
    /// Share of the panchromatic image inside the other.
    shown: f64,
}

impl Found {
    /// What speaks against one acquisition, if anything does.
    fn fault(&self) -> Option<String> {
        let [across, down] = self.relation.scale.map(|scale| 1.0 / scale);
        if !RATIOS.contains(&across) || !RATIOS.contains(&down) {
            return Some(format!(
                "a multispectral pixel is {across:.2} x {down:.2} panchromatic ones"
            ));
        }
        if self.residual_px > AGREE_PX {
            let off_px = self.residual_px;
            return Some(format!("their cameras disagree by {off_px:.1} multispectral pixels"));
        }
        let shown = 100.0 * self.shown;
        (self.shown < LEAST_SHOWN).then(|| format!("they share only {shown:.0} % of the ground"))
    }
}

/// Places over an image that are compared, along each axis.
const PLACES: usize = 5;

/// Scale and offset by least squares over places of the ground at the height the panchromatic camera is made for.
fn relation(
    pan: &Rpc,
    (width, height): (usize, usize),
    colours: &Rpc,
    size: (usize, usize),
) -> Result<Found, RpcError> {
    let mut pairs = Vec::with_capacity(PLACES * PLACES);
    for place in 0..PLACES * PLACES {
        let along = |index: usize, size: usize| index as f64 / (PLACES - 1) as f64 * (size as f64 - 1.0);
        let [col, row] = [along(place % PLACES, width), along(place / PLACES, height)];
        let seen = colours.project(pan.localise(ImagePoint { col, row }, pan.height_offset_m)?);
        pairs.push(([col, row], [seen.col, seen.row]));
    }
    let line = |axis: usize| -> (f64, f64) {
        let count = pairs.len() as f64;
        let own = pairs.iter().map(|pair| pair.0[axis]).sum::<f64>() / count;
        let other = pairs.iter().map(|pair| pair.1[axis]).sum::<f64>() / count;
        let both = pairs.iter().map(|pair| (pair.0[axis] - own) * (pair.1[axis] - other));
        let alone = pairs.iter().map(|pair| (pair.0[axis] - own).powi(2));
        let scale = both.sum::<f64>() / alone.sum::<f64>();
        (scale, other - scale * own)
    };
    let [cols, rows] = [line(0), line(1)];
    let relation = GridRelation {
        scale: [cols.0, rows.0],
        offset: [cols.1, rows.1],
    };
    let mut residual_px: f64 = 0.0;
    for (own, other) in &pairs {
        let off = |axis: usize| relation.scale[axis] * own[axis] + relation.offset[axis] - other[axis];
        residual_px = residual_px.max(off(0).hypot(off(1)));
    }
    let shown = |axis: usize, own: usize, other: usize| {
        let at = |own: f64| (relation.scale[axis] * own + relation.offset[axis]).clamp(-0.5, other as f64 - 0.5);
        (at(own as f64 - 0.5) - at(-0.5)) / (relation.scale[axis] * own as f64)
    };
    Ok(Found {
        relation,
        // What is no number disagrees.
        residual_px: if residual_px.is_nan() {
            f64::INFINITY
        } else {
            residual_px
        },
        shown: shown(0, width, size.0) * shown(1, height, size.1),
    })
}

/// Joins drafts that were taken at one time, where some images are panchromatic and others have colours.
pub(super) fn by_time(drafts: Vec<Draft>, declared: Option<&[BandKind]>) -> Result<Vec<Draft>, SceneError> {
    let is_pan = |draft: &Draft| draft.file.bands.len() == 1;
    if drafts.iter().all(is_pan) || !drafts.iter().any(is_pan) {
        return Ok(drafts);
    }
    let apart_ms = |a: &Draft, b: &Draft| {
        let (a, b) = (a.acquisition.time?, b.acquisition.time?);
        Some((a.as_millisecond() - b.as_millisecond()).abs())
    };
    let has_colours = |draft: &Draft| draft.file.bands.len() >= 3 && draft.multispectral.is_none();
    let mut near: Vec<[usize; 2]> = Vec::new();
    for (index, pan) in drafts.iter().enumerate().filter(|(_, draft)| is_pan(draft)) {
        let others = drafts.iter().enumerate().filter(|(_, draft)| has_colours(draft));
        // Without a name that says so, a pair is what cameras say too.
        let others = others.filter(|(_, other)| {
            relation(&pan.rpc, pan.file.size(), &other.rpc, other.file.size())
                .is_ok_and(|found| found.fault().is_none())
        });
        let at_once = others.filter(|(_, other)| apart_ms(pan, other).is_some_and(|apart| apart <= SAME_TIME_MS));
        near.extend(at_once.map(|(place, _)| [index, place]));
    }
    // Times that more than two images share, such as a date alone, tell nothing.
    let alone = |pair: &&[usize; 2]| {
        let shared = near.iter().filter(|other| (0..2).any(|k| other[k] == pair[k]));
        shared.count() == 1
    };
    let colours: BTreeMap<usize, ImageFiles> = near
        .iter()
        .filter(alone)
        .map(|&[index, place]| (index, drafts[place].entry.tiles.clone()))
        .collect();
    let taken: Vec<PathBuf> = colours.values().map(|files| files.path.clone()).collect();
    let mut joined = Vec::with_capacity(drafts.len());
    for (index, draft) in drafts.into_iter().enumerate() {
        if taken.contains(&draft.entry.path) {
            continue;
        }
        joined.push(match colours.get(&index) {
            Some(files) => draft.sharpened_with(files, declared)?,
            None => draft,
        });
    }
    Ok(joined)
}

/// The line that says which images were joined.
pub(super) fn told(drafts: &[Draft]) -> Option<String> {
    let joined: Vec<&Draft> = drafts.iter().filter(|draft| draft.multispectral.is_some()).collect();
    let first = joined.first()?;
    let colours = first.multispectral.as_deref().unwrap_or_else(|| Path::new(""));
    Some(format!(
        "{}: pansharpened with {} of the same acquisition ({} such pair{})",
        first.file.path().display(),
        colours.display(),
        joined.len(),
        if joined.len() == 1 { "" } else { "s" }
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paired(names: &[&str]) -> (Vec<String>, Vec<(String, String)>) {
        let files = super::super::tiles::joined(names.iter().map(PathBuf::from).collect());
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
