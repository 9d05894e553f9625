//! Residuals before and after the adjustment: per image, per pair of images (across the epipolar lines), and one by
//! one.

use super::linear::Linear;
use super::robust;
use super::tracks::Track;
use crate::rpc::ImagePoint;
use heliosplat_grid::statistics::upper_median;
use nalgebra::{Matrix3, Vector4};
use std::collections::BTreeMap;

/// Least relative length of the normal to the stacked slopes; pairs below it have parallel rays and no epipolar lines.
const LEAST_NORMAL: f64 = 1e-4;

/// Size of a set of residuals, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct ResidualSize {
    /// Root mean square length.
    pub rms_px: f64,
    /// Median length.
    pub median_px: f64,
}

/// Residuals of an image's good sightings: distance from the corrected projection of the ground point that fits all
/// views of the track.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ImageResiduals {
    /// Number of sightings.
    pub sightings: usize,
    /// Number of good sightings: those within three standard deviations.
    pub good: usize,
    /// Size of the residuals with the cameras as delivered.
    pub before: ResidualSize,
    /// Size of the residuals with the corrections.
    pub after: ResidualSize,
}

/// Residuals of good sightings across the epipolar lines of two images: the distance between corresponding rays,
/// pixels. The component along the lines is altitude and independent of the cameras.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PairResiduals {
    /// Indices of the two images, the lower first.
    pub images: [usize; 2],
    /// Number of tracks with good sightings in both images.
    pub ties: usize,
    /// Size of the residuals with the cameras as delivered.
    pub before: ResidualSize,
    /// Size of the residuals with the corrections.
    pub after: ResidualSize,
}

/// Residual of one sighting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResidualVector {
    /// Index of the track.
    pub track: usize,
    /// Index of the image.
    pub image: usize,
    /// Measured position, pixels.
    pub at: ImagePoint,
    /// Seen minus projected with the cameras as delivered, columns and rows, pixels.
    pub before_px: [f64; 2],
    /// Seen minus projected with the corrections, columns and rows, pixels.
    pub after_px: [f64; 2],
    /// True if the residual is within three standard deviations.
    pub good: bool,
}

/// Residuals before and after the adjustment, by track and sighting.
pub(super) struct Sides {
    /// Sightings with the cameras as delivered.
    pub(super) before: Vec<Vec<Linear>>,
    /// Sightings with the corrections.
    pub(super) after: Vec<Vec<Linear>>,
    /// Standard deviation of a good sighting, pixels.
    pub(super) sigma_px: f64,
}

impl Sides {
    /// Marks the good sightings of a track.
    fn good(&self, after: &[Linear]) -> Vec<bool> {
        let lengths_px = robust::lengths_px(after).into_iter();
        lengths_px
            .map(|length_px| robust::is_good(length_px, self.sigma_px))
            .collect()
    }
}

impl ResidualSize {
    fn of(mut lengths: Vec<f64>) -> Self {
        let square = lengths.iter().map(|l| l * l).sum::<f64>() / lengths.len() as f64;
        upper_median(&mut lengths).map_or_else(Self::default, |median_px| Self {
            rms_px: square.sqrt(),
            median_px,
        })
    }
}

/// Track, residual before, residual after and a flag of good sightings, one item for each sighting.
fn lines(sides: &Sides) -> impl Iterator<Item = (usize, &Linear, &Linear, bool)> {
    let tracks = sides.before.iter().zip(&sides.after);
    tracks.enumerate().flat_map(move |(track, (before, after))| {
        let sightings = before.iter().zip(after).zip(sides.good(after));
        sightings.map(move |((before, after), good)| (track, before, after, good))
    })
}

/// Residuals of each of `images` images.
pub(super) fn of_images(sides: &Sides, images: usize) -> Vec<ImageResiduals> {
    let mut lengths = vec![(0, Vec::new(), Vec::new()); images];
    for (_, before, after, good) in lines(sides) {
        let (sightings, befores, afters) = &mut lengths[before.image];
        *sightings += 1;
        if good {
            befores.push(before.residual.norm());
            afters.push(after.residual.norm());
        }
    }
    let one = |(sightings, before, after): (usize, Vec<f64>, Vec<f64>)| ImageResiduals {
        sightings,
        good: before.len(),
        before: ResidualSize::of(before),
        after: ResidualSize::of(after),
    };
    lengths.into_iter().map(one).collect()
}

/// Residual of each sighting, in the order of the tracks.
pub(super) fn vectors(sides: &Sides, tracks: &[&Track]) -> Vec<ResidualVector> {
    let places = tracks.iter().flat_map(|track| &track.sightings);
    lines(sides)
        .zip(places)
        .map(|((track, before, after, good), sighting)| ResidualVector {
            track,
            image: before.image,
            at: sighting.at,
            before_px: before.residual.into(),
            after_px: after.residual.into(),
            good,
        })
        .collect()
}

/// Residuals of each pair of images with common tracks, by index.
pub(super) fn of_pairs(sides: &Sides) -> Vec<PairResiduals> {
    let mut lengths: BTreeMap<[usize; 2], (Vec<f64>, Vec<f64>)> = BTreeMap::new();
    for (before, after) in sides.before.iter().zip(&sides.after) {
        let good = sides.good(after);
        for second in 0..before.len() {
            for first in 0..second {
                if !(good[first] && good[second]) {
                    continue;
                }
                let passes = [before, after].map(|lines| passing_px(&lines[first], &lines[second]));
                if let [Some(before_px), Some(after_px)] = passes {
                    let (a, b) = (before[first].image, before[second].image);
                    let (befores, afters) = lengths.entry([a.min(b), a.max(b)]).or_default();
                    befores.push(before_px);
                    afters.push(after_px);
                }
            }
        }
    }
    lengths
        .into_iter()
        .map(|(images, (before, after))| PairResiduals {
            images,
            ties: before.len(),
            before: ResidualSize::of(before),
            after: ResidualSize::of(after),
        })
        .collect()
}

/// Distance between the rays of two sightings, pixels: their four residuals along the one direction that no ground
/// point can change.
fn passing_px(a: &Linear, b: &Linear) -> Option<f64> {
    let rows = [0, 1, 2, 3].map(|row| {
        if row < 2 {
            a.slope.row(row)
        } else {
            b.slope.row(row - 2)
        }
    });
    // The vector perpendicular to the three columns of the stacked slopes, by cofactors.
    let cofactor = |left_out: usize| {
        let kept: Vec<_> = (0..4).filter(|&row| row != left_out).map(|row| rows[row]).collect();
        let sign = if left_out.is_multiple_of(2) { 1.0 } else { -1.0 };
        sign * Matrix3::from_rows(&[kept[0], kept[1], kept[2]]).determinant()
    };
    let normal = Vector4::new(cofactor(0), cofactor(1), cofactor(2), cofactor(3));
    let scale = (a.slope.norm() * b.slope.norm()).powf(1.5);
    if normal.norm() < LEAST_NORMAL * scale {
        return None;
    }
    let residual = Vector4::new(a.residual.x, a.residual.y, b.residual.x, b.residual.y);
    // A mismatch all in one image has half of the squared length in this direction: both images' lines count alike.
    Some((normal.normalize().dot(&residual) * std::f64::consts::SQRT_2).abs())
}
