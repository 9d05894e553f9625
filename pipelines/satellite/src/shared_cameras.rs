//! Pointing corrections for the images of an area that is trained in tiles: one solution by the ties of patches all
//! over it.
//!
//! Separately corrected tiles have different datums, since the ties of one tile leave some directions open. One
//! solution has one gauge, and an image that a tile shows in a corner is corrected by all of its ground. The correction
//! of an image changes slowly along its rows where the ties show it; a tile takes the one of its own rows.

use crate::adjust::contradictions;
use crate::config::{Align, THRESHOLD_PX};
use crate::patch_ties::PatchTies;
use crate::preprocess::worth_correcting;
use heliosplat_rpc::adjust::{AdjustImage, AdjustOptions, Adjustment, BiasModel, Correction, Track, adjust};
use heliosplat_rpc::{LocalFrame, RpcError};
use heliosplat_scene::Index;
use std::collections::BTreeMap;

/// Pointing corrections of an area.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SharedCameras {
    /// Columns and rows by image name, pixels; images without ties are missing. With a drift, the shift in the middle
    /// of its rows.
    pub shifts_px: BTreeMap<String, [f32; 2]>,
    /// Drifts of the images whose ties show one, by image name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub drifts: BTreeMap<String, Drift>,
    /// Names of the images that are left out: their ties contradict their cameras.
    #[serde(default)]
    pub left_out: Vec<String>,
    /// Number of ties.
    pub ties: usize,
    /// Number of patches with ties.
    pub patches: usize,
    /// Standard deviation of a good sighting along one axis, pixels.
    pub sigma_px: Option<f64>,
}

/// Linear change of an image's correction along its rows.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Drift {
    /// First and last row that ties show, pixels of the file; beyond them the correction stays as at them.
    pub rows: [f64; 2],
    /// Change of columns and rows from the first of these rows to the last, pixels.
    pub change_px: [f32; 2],
}

impl Drift {
    /// Drift of a correction; `None` for a constant one.
    fn of(correction: &Correction) -> Option<Self> {
        let (middle, half) = (correction.centre.row, correction.half_side_px);
        let change_px = correction.slope_px.map(|slope| 2.0 * slope[1] as f32);
        (!correction.is_translation()).then_some(Self {
            rows: [middle - half, middle + half],
            change_px,
        })
    }

    /// Difference of the correction at `row` to the one in the middle, columns and rows, pixels.
    fn at(&self, row: f64) -> [f32; 2] {
        let [first, last] = self.rows;
        let share = ((row - first) / (last - first)).clamp(0.0, 1.0) - 0.5;
        self.change_px.map(|change| change * share as f32)
    }
}

impl SharedCameras {
    /// Corrections that make the images of `index` agree on the ties; none, with a warning, where the ties are too few.
    pub fn of(index: &Index, ties: &[PatchTies], align: Align) -> Self {
        let patches = || ties.iter().flat_map(|ties| &ties.0);
        let tracks: Vec<Track> = patches().flatten().cloned().collect();
        let mut found = Self {
            ties: tracks.len(),
            patches: patches().filter(|ties| !ties.is_empty()).count(),
            ..Self::default()
        };
        let solved = match tracks.first() {
            Some(first) => {
                solve(index, &tracks, &LocalFrame::new(first.near), align).map_err(|error| error.to_string())
            }
            None => Err("no patch has any".to_owned()),
        };
        match solved {
            Ok(solved) => found.take(index, &solved, align),
            Err(error) => {
                tracing::warn!("too few tie points to correct the cameras ({error}); they are used as delivered");
            }
        }
        found
    }

    fn take(&mut self, index: &Index, solved: &Adjustment, align: Align) {
        let pixels: Vec<usize> = index.images.iter().map(|image| image.size.0 * image.size.1).collect();
        for contradiction in contradictions(&pixels, solved) {
            let name = &index.images[contradiction.image].name;
            // Only parts of the images were searched, so the lack of ties is no contradiction.
            if contradiction.sightings > 0 {
                tracing::warn!("{}", contradiction.message(name));
                self.left_out.extend(contradiction.is_out.then(|| name.clone()));
            }
        }
        let corrections = index.images.iter().zip(&solved.corrections);
        self.drifts = corrections
            .filter_map(|(image, correction)| Some((image.name.clone(), Drift::of(correction)?)))
            .collect();
        for (name, Drift { rows, change_px }) in &self.drifts {
            let [col, row] = change_px;
            tracing::info!(
                "{name}: drifts by {col:.2} columns and {row:.2} rows from row {:.0} to {:.0}",
                rows[0],
                rows[1]
            );
        }
        let shifts = solved
            .corrections
            .iter()
            .map(|correction| correction.shift_px.map(|v| v as f32));
        let align = if self.drifts.is_empty() { align } else { Align::On };
        let shifts = worth_correcting(shifts.collect(), align);
        let tied = index.images.iter().zip(&solved.images).zip(shifts);
        let tied = tied.filter(|((_, residuals), _)| residuals.sightings > 0);
        self.shifts_px = tied.map(|((image, _), shift)| (image.name.clone(), shift)).collect();
        self.sigma_px = Some(solved.sigma_px);
    }

    /// Corrections by image name, columns and rows, pixels, where the middle row of an image is that of `rows`.
    pub fn shifts_at(&self, rows: &BTreeMap<&str, f64>) -> BTreeMap<String, [f32; 2]> {
        let mut shifts_px = self.shifts_px.clone();
        for (name, drift) in &self.drifts {
            if let (Some(shift), Some(row)) = (shifts_px.get_mut(name), rows.get(name.as_str())) {
                let [col, row] = drift.at(*row);
                *shift = [shift[0] + col, shift[1] + row];
            }
        }
        shifts_px
    }
}

/// The adjustment: with drifts if one is as large as a correction has to be, else with shifts alone.
fn solve(index: &Index, tracks: &[Track], frame: &LocalFrame, align: Align) -> Result<Adjustment, RpcError> {
    let images = index.images.iter().map(|image| AdjustImage {
        rpc: &image.rpc,
        width: image.size.0,
        height: image.size.1,
    });
    let images: Vec<AdjustImage> = images.collect();
    let of = |model: BiasModel| {
        let options = AdjustOptions {
            model,
            ..AdjustOptions::default()
        };
        adjust(&images, tracks, frame, options)
    };
    let solved = of(BiasModel::Drift)?;
    let changes = solved
        .corrections
        .iter()
        .filter_map(Drift::of)
        .flat_map(|drift| drift.change_px);
    let largest = changes.fold(0.0, |most: f32, change| most.max(change.abs()));
    match solved.model == BiasModel::Drift && align == Align::Auto && largest <= THRESHOLD_PX {
        true => of(BiasModel::Translation),
        false => Ok(solved),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drifting_image_has_the_correction_of_its_rows_and_others_have_one() {
        let drift = Drift {
            rows: [1000.0, 3000.0],
            change_px: [2.0, -1.0],
        };
        let cameras = SharedCameras {
            shifts_px: [("a", [0.5, 0.5]), ("b", [-1.0, 0.25])]
                .map(|(name, px)| (name.into(), px))
                .into(),
            drifts: [("a".into(), drift)].into(),
            ..SharedCameras::default()
        };
        let at = |row: f64| cameras.shifts_at(&["a", "b"].map(|name| (name, row)).into());
        for (row, shift) in [
            (0.0, [-0.5, 1.0]),
            (1000.0, [-0.5, 1.0]),
            (2500.0, [1.0, 0.25]),
            (9e4, [1.5, 0.0]),
        ] {
            assert_eq!(at(row)["a"], shift, "{row}");
            assert_eq!(at(row)["b"], [-1.0, 0.25]);
        }
        // A tile that an image does not show needs none of its corrections.
        assert_eq!(cameras.shifts_at(&BTreeMap::new()), cameras.shifts_px);
    }
}
