//! Panchromatic and multispectral images of one acquisition: pairing, and joining both into one image.
//!
//! Vendors deliver such bundles in two files of the same ground and second. They are recognised by their names
//! (`pair_names.rs`) or by their times; their cameras must agree.

use super::bands;
use super::draft::Draft;
use super::entry::ImageEntry;
use super::files::Folders;
use super::tiles::ImageFiles;
use super::{BandKind, Result, RpcPreference, SceneError, acquisition, calibration, camera, satnerf};
use heliosplat_raster::{GridRelation, RasterFile};
use heliosplat_rpc::{ImagePoint, Rpc, RpcError};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Largest distance between the cameras of one acquisition, multispectral pixels.
const AGREE_PX: f64 = 1.0;
/// Allowed number of panchromatic pixels along the side of a multispectral pixel: four for most satellites of today,
/// five for KOMPSAT's and some others.
const RATIOS: std::ops::RangeInclusive<f64> = 1.8..=6.5;
/// Largest time between the two halves of a bundle, milliseconds; the images of a stereo pair in one pass lie tens of
/// seconds apart.
const SAME_TIME_MS: i64 = 2_500;
/// Least share of the panchromatic image that the multispectral image must show.
const LEAST_SHOWN: f64 = 0.5;

/// Joins a panchromatic image with its multispectral half, for pansharpening.
pub(super) fn with_colours(
    draft: Draft,
    multispectral: &ImageFiles,
    declared: Option<&[BandKind]>,
    folders: &Folders,
) -> Result<Draft> {
    let pan = &draft.file;
    let pan_path = pan.path().to_owned();
    let not_a_pair = |reason| SceneError::NotAPair(pan_path.clone(), multispectral.path.clone(), reason);
    let colours = multispectral.open(folders)?;
    if pan.bands.len() != 1 || colours.bands.len() < 3 {
        let (one, other) = (pan.bands.len(), colours.bands.len());
        return Err(not_a_pair(format!("they have {one} and {other} bands")));
    }
    let entry = ImageEntry {
        json: satnerf::json_of(&multispectral.path, folders),
        ..ImageEntry::of(multispectral.clone())
    };
    let mut ignored = Vec::new();
    let camera = camera::find(&colours, &entry, RpcPreference::Image, folders, &mut ignored)?;
    // An adjusted camera is not comparable: only the vendor's two cameras agree with each other.
    let own = camera::of_vendor(pan, folders)?.unwrap_or_else(|| draft.rpc.clone());
    let found = relation(&own, pan.size(), &camera.used.rpc, colours.size())
        .map_err(|source| not_a_pair(format!("their cameras cannot be compared ({source})")))?;
    if let Some(reason) = found.fault() {
        return Err(not_a_pair(reason));
    }
    Ok(Draft {
        plan: bands::plan(&colours, declared, folders)?,
        acquisition: draft.acquisition.merge(acquisition::find(&colours, &entry, folders)?),
        // Pansharpening keeps the ratios between bands, so the calibration of the multispectral file applies.
        radiometry: calibration::find(&colours, &entry, folders)?,
        file: RasterFile::pansharpened(draft.file, colours, &found.relation),
        multispectral: Some(multispectral.path.clone()),
        ..draft
    })
}

/// Relation between the pixel grids of a panchromatic and a multispectral image.
struct Found {
    relation: GridRelation,
    /// Largest residual of the relation, multispectral pixels.
    residual_px: f64,
    /// Share of the panchromatic image inside the multispectral one, 0..1.
    shown: f64,
}

impl Found {
    /// Reason against a common acquisition; `None` where there is none.
    fn fault(&self) -> Option<String> {
        let [across, down] = self.relation.scale.map(|scale| 1.0 / scale);
        if !RATIOS.contains(&across) || !RATIOS.contains(&down) {
            let text = format!("a multispectral pixel is {across:.2} x {down:.2} panchromatic ones");
            return Some(text);
        }
        if self.residual_px > AGREE_PX {
            let off_px = self.residual_px;
            return Some(format!("their cameras disagree by {off_px:.1} multispectral pixels"));
        }
        let shown = 100.0 * self.shown;
        (self.shown < LEAST_SHOWN).then(|| format!("they share only {shown:.0} % of the ground"))
    }
}

/// Number of compared places along each axis of an image.
const PLACES: usize = 5;

/// Scale and offset of each axis by least squares, from ground points at the height offset of the panchromatic camera.
/// Sizes are columns and rows.
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
    let (scale, offset) = ([cols.0, rows.0], [cols.1, rows.1]);
    let relation = GridRelation { scale, offset };
    let mut residual_px: f64 = 0.0;
    for (own, other) in &pairs {
        let off = |axis: usize| relation.scale[axis] * own[axis] + relation.offset[axis] - other[axis];
        residual_px = residual_px.max(off(0).hypot(off(1)));
    }
    let shown = |axis: usize, own: usize, other: usize| {
        let at = |own: f64| (relation.scale[axis] * own + relation.offset[axis]).clamp(-0.5, other as f64 - 0.5);
        (at(own as f64 - 0.5) - at(-0.5)) / (relation.scale[axis] * own as f64)
    };
    // NaN counts as disagreement.
    let known_px = Some(residual_px).filter(|residual_px| !residual_px.is_nan());
    let residual_px = known_px.unwrap_or(f64::INFINITY);
    let shown = shown(0, width, size.0) * shown(1, height, size.1);
    Ok(Found {
        relation,
        residual_px,
        shown,
    })
}

/// Joins drafts of one acquisition time, in scenes with both panchromatic and colour images. Names do not confirm these
/// pairs, so their cameras must agree.
pub(super) fn by_time(drafts: Vec<Draft>, declared: Option<&[BandKind]>, folders: &Folders) -> Result<Vec<Draft>> {
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
        // Without matching names, the cameras must confirm the pair.
        let others = others.filter(|(_, other)| {
            let found = relation(&pan.rpc, pan.file.size(), &other.rpc, other.file.size());
            found.is_ok_and(|found| found.fault().is_none())
        });
        let at_once = others.filter(|(_, other)| apart_ms(pan, other).is_some_and(|apart| apart <= SAME_TIME_MS));
        near.extend(at_once.map(|(place, _)| [index, place]));
    }
    // A time that more than two images share, such as a date alone, does not identify a pair.
    let alone = |pair: &&[usize; 2]| {
        let shared = near.iter().filter(|other| (0..2).any(|k| other[k] == pair[k]));
        shared.count() == 1
    };
    let lone = near.iter().filter(alone);
    let colours: BTreeMap<usize, ImageFiles> = lone
        .map(|&[index, place]| (index, drafts[place].entry.tiles.clone()))
        .collect();
    let taken: Vec<PathBuf> = colours.values().map(|files| files.path.clone()).collect();
    let mut joined = Vec::with_capacity(drafts.len());
    for (index, draft) in drafts.into_iter().enumerate() {
        if taken.contains(&draft.entry.path) {
            continue;
        }
        joined.push(match colours.get(&index) {
            Some(files) => with_colours(draft, files, declared, folders)?,
            None => draft,
        });
    }
    Ok(joined)
}

/// Warning that lists the joined images; `None` where there are none.
pub(super) fn joined_pairs(drafts: &[Draft]) -> Option<String> {
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
