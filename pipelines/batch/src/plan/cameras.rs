//! Units that correct the pointing of an area's images: ties of patches all over it, and one adjustment by all ties.

use super::{AdjustWork, Combination, LEAST_BYTES, TiesWork, Unit, Work};
use crate::tiles::{self, Tiling};
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_satellite::estimate::sweep_estimate;
use heliosplat_satellite::patch_ties::MOST_TIES;
use heliosplat_scene::survey::Survey;
use heliosplat_scene::{AreaRequest, IngestOptions};

/// Seconds per pixel of the windows of a search for ties on one core.
const TIES_S_PER_PIXEL: f64 = 5e-6;
/// Seconds of a search for ties on one core, below which patches share a unit: so much exceeds the start of a process.
const TIES_LEAST_S: f64 = 20.0;
/// Memory and seconds of the adjustment for each sighting of a tie.
const BYTES_PER_SIGHTING: f64 = 500.0;
const S_PER_SIGHTING: f64 = 2e-5;

/// Expense of the search for ties in a patch.
struct PatchCost {
    bytes: f64,
    seconds: f64,
    images: usize,
}

impl PatchCost {
    /// Cost of a patch; that of the start alone where too few images show it.
    fn of(patch: &AreaRequest, survey: &Survey, config: &SatelliteConfig) -> Self {
        let tile = survey.tile(patch).ok().flatten();
        Self {
            bytes: (tile.as_ref()).map_or(0.0, |tile| sweep_estimate(survey, tile, config).peak_bytes),
            seconds: TIES_S_PER_PIXEL * tile.as_ref().map_or(0.0, |tile| tile.pixels),
            images: tile.map_or(0, |tile| tile.training),
        }
    }
}

impl Combination<'_> {
    /// Name of the unit that corrects the pointing for all tiles of all presets.
    pub(super) fn adjust_id(&self) -> String {
        format!("{}/{}/adjust", self.area.name, self.images.name)
    }

    /// Units that search ties, and the one that corrects the pointing by them.
    pub(super) fn cameras(&self, tiling: &Tiling, survey: &Survey, config: &SatelliteConfig) -> (Vec<Unit>, Unit) {
        let patches = tiles::patches(tiling, survey.gsd_m);
        let cost = |patch| PatchCost::of(patch, survey, config);
        let costs: Vec<PatchCost> = patches.iter().map(cost).collect();
        let each = patches_of_unit(&costs);
        let groups = patches.chunks(each).zip(costs.chunks(each)).enumerate();
        let ties = groups.map(|(number, (patches, costs))| self.ties(number, patches, costs));
        let ties: Vec<Unit> = ties.collect();
        let sightings: f64 = costs.iter().map(|cost| (MOST_TIES * cost.images) as f64).sum();
        let adjust = self.adjust(&ties, sightings);
        (ties, adjust)
    }

    fn ties(&self, number: usize, patches: &[AreaRequest], costs: &[PatchCost]) -> Unit {
        let work = TiesWork {
            scene: self.images.scene.clone(),
            ingest: IngestOptions {
                area: None,
                ..self.ingest.clone()
            },
            patches: patches.to_vec(),
            preset: self.preset.clone(),
        };
        let identity = format!("ties {:?} {:?}", work.patches, work.ingest);
        let bytes = costs.iter().map(|cost| cost.bytes).fold(0.0, f64::max);
        let seconds = costs.iter().map(|cost| cost.seconds).sum();
        let id = format!("{}/{}/ties-{number}", self.area.name, self.images.name);
        self.unit(id, &[], (bytes, seconds), &identity, Work::Ties(work))
    }

    fn adjust(&self, ties: &[Unit], sightings: f64) -> Unit {
        let cost = (LEAST_BYTES + BYTES_PER_SIGHTING * sightings, S_PER_SIGHTING * sightings);
        let work = Work::Adjust(AdjustWork {
            scene: self.images.scene.clone(),
            rpc: self.ingest.rpc,
            ties: ties.iter().map(|unit| unit.id.clone()).collect(),
            preset: self.preset.clone(),
        });
        let after: Vec<&Unit> = ties.iter().collect();
        self.unit(self.adjust_id(), &after, cost, "adjust", work)
    }
}

/// Number of patches of a unit: as many as keep it busy for [`TIES_LEAST_S`].
fn patches_of_unit(costs: &[PatchCost]) -> usize {
    let seconds: f64 = costs.iter().map(|cost| cost.seconds).sum();
    let units = (seconds / TIES_LEAST_S).clamp(1.0, costs.len().max(1) as f64);
    costs.len().div_ceil(units as usize).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_patches_share_a_unit_and_large_ones_do_not() {
        let each = |count: usize, seconds: f64| {
            let cost = || PatchCost {
                bytes: 0.0,
                seconds,
                images: 8,
            };
            patches_of_unit(&(0..count).map(|_| cost()).collect::<Vec<_>>())
        };
        assert_eq!(each(25, 2.0 * TIES_LEAST_S), 1);
        assert_eq!(each(25, 0.25 * TIES_LEAST_S), 5);
        assert_eq!(each(4, 0.01 * TIES_LEAST_S), 4);
        assert_eq!(each(1, 0.0), 1);
    }
}
