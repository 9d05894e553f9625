//! The matching parameters of a plane sweep: every decision that depends on the scene, made in one place.
//!
//! [`MatchingFacts`] is what the decisions need; it follows from the cameras, dates and suns alone, so a planner has it before any pixel
//! is read. [`MatchingParameters::choose`] decides, and the search consumes the values without deciding anything itself.
//!
//! Three facts decide:
//! - the number of views: what [`MANY_VIEWS`] views agree on is seldom chance, so false matches need less protection;
//! - the combined base-to-height ratio: noise in height grows with its inverse, and so does the window that averages it out;
//! - whether every view has an index plane (a vegetation index): then it is compared beside brightness.
//!
//! Constants without a source were chosen by experiment; docs/lab/plane-sweep.md has the tables.

use super::pairs::{self, LEAST_BASE_TO_HEIGHT};
use super::views::ViewGeometry;
use glam::Vec3;

/// Number of views from which on the parameters for many views are used.
pub const MANY_VIEWS: usize = 8;

/// Height step of the hypotheses, as the relative shift in cells of the pair of views with the widest base: half a cell is what matching
/// resolves before the sub-step refinement.
pub(super) const STEP_CELLS: f32 = 0.5;
/// Rounds at full resolution in which views that the surface hides are left out; docs/lab/plane-sweep.md: a second one gains nothing.
const VISIBILITY_ROUNDS: usize = 1;
/// Cost of a change by one height step between neighbours (P1 of Hirschmüller 2008), in units of a full mismatch / 255.
const ONE_STEP_PENALTY: u16 = 30;
/// Cost of a larger change (P2) with few views, in the same units.
const JUMP_PENALTY_FEW: u16 = 90;
/// The same with many views, which see roofs and trees well enough to be allowed steeper edges.
const JUMP_PENALTY_MANY: u16 = 60;
/// Difference of the guide image between neighbours, in its typical differences, that halves the cost of a jump there.
const GUIDE_EDGE: f32 = 30.0;
/// Smallest difference that the census compares at the shortest base, where noise is most of what two views differ by, in median
/// differences between the neighbours around.
const NOISE_FLOOR: f32 = 0.16;
/// No-match weight with few views, as a share of the weights of all comparisons: heights that few views see must not win by chance.
const NO_MATCH_FEW: f32 = 0.08;
/// The same with many views.
const NO_MATCH_MANY: f32 = 0.03;
/// Weight of a comparison of index planes beside one of brightness.
const INDEX_WEIGHT: f32 = 0.5;
/// Candidate tolerances with few views, in summed cost.
const TOLERANCE_FEW: CandidateTolerance = CandidateTolerance {
    full_resolution: 80,
    half_resolution: 80,
    coarser: 80,
};
/// The same with many views. Finer levels have less left to decide: wider tolerances take time there and find nothing more.
const TOLERANCE_MANY: CandidateTolerance = CandidateTolerance {
    full_resolution: 80,
    half_resolution: 120,
    coarser: 200,
};
/// Combined base-to-height ratio above which costs of single cells tell heights apart; below it the radius of the window is the quotient.
const SINGLE_CELL_BASE_TO_HEIGHT: f32 = 0.8;
/// Largest radius of the aggregation window, cells; reached at a combined base-to-height ratio of 0.133.
const LARGEST_RADIUS: f32 = 6.0;
/// Radius of the aggregation window, cells, per unit of the smoothness scale: with a very short base, single mismatches are as tall as
/// houses, and jumps cost twice as much at the largest window.
const RADIUS_PER_SMOOTHNESS: usize = 3;

/// What the choice of the matching parameters depends on.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct MatchingFacts {
    /// Number of views.
    pub views: usize,
    /// Combined base-to-height ratio, metres per metre: the root of the sum of its squares over the pairs of views that are compared.
    pub combined_base_to_height: f32,
    /// Whether every view has an index plane.
    pub has_index: bool,
}

impl MatchingFacts {
    /// The facts of views that look at `centre` (metres in the frame of the cameras); `has_index` says whether each of them has an
    /// index plane.
    ///
    /// Neither a crop nor a shift of the image (a pointing correction) changes a viewing direction, so both leave the facts as they are
    /// but for rounding in f32; the pyramid's resolution does not enter.
    pub fn new(views: &[ViewGeometry], centre: Vec3, has_index: bool) -> Self {
        Self {
            views: views.len(),
            combined_base_to_height: pairs::combined_base_to_height(&pairs::choose(views, centre)),
            has_index,
        }
    }
}

/// Summed cost above the least within which another height remains a candidate at the next, finer search; in units of a full mismatch /
/// 255, summed over the eight paths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct CandidateTolerance {
    /// In cells of the requested size.
    pub full_resolution: u16,
    /// In cells of twice that size.
    pub half_resolution: u16,
    /// In larger cells.
    pub coarser: u16,
}

impl CandidateTolerance {
    /// The tolerance in cells `factor` times as wide as requested.
    pub(super) fn at(&self, factor: usize) -> u16 {
        match factor {
            1 => self.full_resolution,
            2 => self.half_resolution,
            _ => self.coarser,
        }
    }
}

/// Everything the plane sweep is told about how to match. Costs are in units of a full mismatch / 255.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct MatchingParameters {
    /// Height step of the hypotheses: the relative shift, cells, of the pair of views with the widest base.
    pub step_cells: f32,
    /// Radius of the square window over which matching costs are averaged, cells; 0 for costs of single cells.
    pub aggregation_radius: usize,
    /// Smallest difference from the centre that the census compares, in median differences between the pixels around; 0 compares all.
    pub noise_floor: f32,
    /// Weight of the no-match (occlusion) cost, as a share of the weights of all comparisons.
    pub no_match_weight: f32,
    /// Whether the brightness itself of views of one date is compared too: the same sun makes them alike, and a single pixel does not
    /// reach over edges as a window does.
    pub same_date_values: bool,
    /// Weight of a comparison of index planes beside one of brightness; `None` compares brightness alone.
    pub index_weight: Option<f32>,
    /// Cost of a change by one height step between neighbours (P1).
    pub one_step_penalty: u16,
    /// Cost of a larger change between neighbours (P2).
    pub jump_penalty: u16,
    /// Difference of the guide image between neighbours, in its typical differences, that halves the cost of a jump there.
    pub guide_edge: f32,
    /// Which heights remain candidates from one search to the next.
    pub candidate_tolerance: CandidateTolerance,
    /// Rounds at full resolution in which views hidden by the surface found so far are left out.
    pub visibility_rounds: usize,
    /// Radius of the window whose plane gives each cell its height, cells; 0 leaves heights as they were matched.
    pub plane_radius: usize,
    /// Least radius, cells, of the adaptive plane smoothing that follows; `None` for none.
    pub adaptive_plane_radius: Option<usize>,
}

impl MatchingParameters {
    /// Decides all parameters from the facts.
    pub fn choose(facts: &MatchingFacts) -> Self {
        let many = facts.views >= MANY_VIEWS;
        let radius = aggregation_radius(facts.combined_base_to_height);
        let very_short_base = radius >= LARGEST_RADIUS as usize;
        let jump_penalty = if many { JUMP_PENALTY_MANY } else { JUMP_PENALTY_FEW };
        Self {
            step_cells: STEP_CELLS,
            aggregation_radius: radius,
            noise_floor: if very_short_base { NOISE_FLOOR } else { 0.0 },
            no_match_weight: if many { NO_MATCH_MANY } else { NO_MATCH_FEW },
            same_date_values: many,
            index_weight: facts.has_index.then_some(INDEX_WEIGHT),
            one_step_penalty: ONE_STEP_PENALTY,
            jump_penalty: jump_penalty * smoothness_scale(radius),
            guide_edge: GUIDE_EDGE,
            candidate_tolerance: if many { TOLERANCE_MANY } else { TOLERANCE_FEW },
            visibility_rounds: VISIBILITY_ROUNDS,
            plane_radius: if radius > 0 { radius + 1 } else { 0 },
            adaptive_plane_radius: very_short_base.then_some(radius),
        }
    }
}

/// Radius of the aggregation window, cells: noise in height grows with the inverse of the base-to-height ratio.
fn aggregation_radius(combined_base_to_height: f32) -> usize {
    (SINGLE_CELL_BASE_TO_HEIGHT / combined_base_to_height.max(LEAST_BASE_TO_HEIGHT)).min(LARGEST_RADIUS) as usize
}

/// Factor on the jump penalty for windows of this radius.
fn smoothness_scale(radius: usize) -> u16 {
    (radius / RADIUS_PER_SMOOTHNESS).max(1) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use heliosplat::ProjectiveCamera;

    fn chosen(views: usize, combined_base_to_height: f32) -> MatchingParameters {
        MatchingParameters::choose(&MatchingFacts {
            views,
            combined_base_to_height,
            has_index: false,
        })
    }

    #[test]
    fn windows_widen_and_jumps_cost_more_as_the_base_shrinks() {
        let radius = |ratio| chosen(3, ratio).aggregation_radius;
        assert_eq!([0.08, 0.2, 0.3, 0.5, 2.0].map(radius), [6, 4, 2, 1, 0]);
        assert!(radius(0.0) <= LARGEST_RADIUS as usize);
        assert_eq!(
            [0.08, 0.2, 2.0].map(|ratio| chosen(3, ratio).jump_penalty),
            [180, 90, 90]
        );
        assert_eq!(
            [0.08, 0.2, 2.0].map(|ratio| chosen(9, ratio).jump_penalty),
            [120, 60, 60]
        );
    }

    #[test]
    fn surfaces_are_smoothed_only_where_costs_are_averaged_and_adaptively_at_the_shortest_base() {
        let smoothing = |ratio| (chosen(3, ratio).plane_radius, chosen(3, ratio).adaptive_plane_radius);
        assert_eq!([0.08, 0.2, 2.0].map(smoothing), [(7, Some(6)), (5, None), (0, None)]);
    }

    /// A camera 600 km away whose rays move `lean` metres east per metre of altitude.
    fn geometry(lean: f64, crop: (f64, f64)) -> ViewGeometry {
        let axis = DVec3::new(lean, 0.02, -1.0).normalize();
        let right = axis.cross(DVec3::Y).normalize();
        let (down, w) = (axis.cross(right), axis / 600e3);
        let (u, v) = (right * 2.0 + w * (700.0 - crop.0), down * 2.0 + w * (500.0 - crop.1));
        ViewGeometry {
            camera: ProjectiveCamera::new(
                [u.x, u.y, u.z, 700.0 - crop.0],
                [v.x, v.y, v.z, 500.0 - crop.1],
                w.into(),
                (256, 256),
                axis,
            ),
            date_group: 0,
            sun: Some(Vec3::Z),
        }
    }

    #[test]
    fn neither_crops_nor_pointing_corrections_change_the_facts() {
        let leans = [-0.2, 0.05, 0.31];
        let centre = Vec3::new(20.0, -30.0, 5.0);
        let whole = leans.map(|lean| geometry(lean, (0.0, 0.0)));
        let cropped = leans.map(|lean| geometry(lean, (590.0, 380.0)));
        let shifted = whole.map(|view| ViewGeometry {
            camera: view.camera.shifted(4.25, -7.5),
            ..view
        });
        let ratio = |views: &[ViewGeometry]| MatchingFacts::new(views, centre, false).combined_base_to_height;
        for other in [ratio(&cropped), ratio(&shifted)] {
            assert!(
                (other / ratio(&whole) - 1.0).abs() < 1e-5,
                "{other} for {}",
                ratio(&whole)
            );
        }
        let expected = (0.25f32.powi(2) + 0.51f32.powi(2) + 0.26f32.powi(2)).sqrt();
        assert!(
            (ratio(&whole) / expected - 1.0).abs() < 1e-3,
            "{} for {expected}",
            ratio(&whole)
        );
    }
}
