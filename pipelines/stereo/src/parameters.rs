//! The matching parameters of a plane sweep, with every choice that depends on the scene.
//!
//! [`MatchingFacts`] is the input: it follows from the cameras, dates and suns alone, so it is available before any
//! pixel is read. [`MatchingParameters::choose`] makes the choice, and the search only uses the values.
//!
//! Three facts determine the parameters:
//! - the number of views of a piece of ground: [`MANY_VIEWS`] views seldom agree by chance, so false matches need less
//!   protection; between [`FEW_VIEWS`] and as many the parameters change in proportion;
//! - the combined base-to-height ratio: noise in height grows with its inverse, and so does the window that averages it
//!   out; few views get a window at any ratio, because one to six comparisons of single cells find too many heights by
//!   chance;
//! - index planes (a vegetation index), which are compared along with brightness if every view has one.
//!
//! Constants without a source were chosen by experiment; docs/lab/plane-sweep.md has the tables.

use super::pairs;

use super::seen::pixel_of;
use super::views::ViewGeometry;
use super::volume::SearchVolume;
use heliosplat_rpc::parallax::LEAST_BASE_TO_HEIGHT;

/// Views of a piece of ground up to which the parameters for few views are used.
pub const FEW_VIEWS: f32 = 4.0;
/// Mean number of views from which on the parameters for many views are used.
pub const MANY_VIEWS: f32 = 8.0;

/// Height step of the hypotheses, as the relative shift in cells of the pair of views with the widest base: half a
/// cell, the resolution of matching before the sub-step refinement.
pub(super) const STEP_CELLS: f32 = 0.5;
/// Reduction of the summed cost of the floor below an uncertain surface, with many views (docs/lab/edges.md); with few
/// views costs are too noisy for a certain floor, and with costs averaged over windows no single cell can place a wall.
const FLOOR_BONUS: u16 = 150;
/// Rounds at full resolution in which views that the surface hides are left out; docs/lab/plane-sweep.md: a second one
/// gains nothing.
const VISIBILITY_ROUNDS: usize = 1;
/// Cost of a change by one height step between neighbours (P1 of Hirschmüller 2008), in units of a full mismatch / 255.
const ONE_STEP_PENALTY: u16 = 30;
/// Cost of a larger change (P2 of Hirschmüller 2008) with few views, in units of a full mismatch / 255.
const JUMP_PENALTY_FEW: u16 = 90;
/// Penalty of a jump with many views, which show roofs and trees well enough for steeper edges.
const JUMP_PENALTY_MANY: u16 = 60;
/// Difference of the guide image between neighbours, in its typical differences, that halves the cost of a jump there.
const GUIDE_EDGE: f32 = 30.0;
/// Smallest difference that the census compares at the shortest base, where views differ mostly by noise, in median
/// differences between the neighbours around.
const NOISE_FLOOR: f32 = 0.16;
/// No-match weight with few views, as a share of the weights of all comparisons between the views of a cell: heights
/// that few of these see must not win by chance.
const NO_MATCH_FEW: f32 = 0.08;
/// No-match weight with many views, as a share of the weights of all comparisons between the views of a cell.
const NO_MATCH_MANY: f32 = 0.03;
/// Weight of a comparison of index planes relative to one of brightness.
const INDEX_WEIGHT: f32 = 0.5;
/// Candidate tolerances with few views, in summed cost.
const TOLERANCE_FEW: CandidateTolerance = CandidateTolerance {
    full_resolution: 80,
    half_resolution: 80,
    coarser: 80,
};

/// Tolerance with many views. Finer levels have fewer decisions left: wider tolerances take time and find nothing more.
const TOLERANCE_MANY: CandidateTolerance = CandidateTolerance {
    full_resolution: 80,
    half_resolution: 120,
    coarser: 200,
};

/// Combined base-to-height ratio above which costs of single cells resolve heights; below it the radius of the window
/// is the quotient.
const SINGLE_CELL_BASE_TO_HEIGHT: f32 = 0.8;
/// Summed cost by which a height is e times less probable than another of one minimum: with it, and the spread of
/// altitudes around a cell, about 68 % of the errors on `block` and `tiny`, seed 1, lie within one deviation
/// (docs/lab/known.md).
pub(super) const COST_PER_E_FOLD: f32 = 30.0;
/// Least radius of the aggregation window, cells, up to [`FEW_VIEWS`] views; with more views single cells are better
/// (docs/lab/plane-sweep.md).
const FEW_VIEWS_RADIUS: usize = 2;
/// Largest radius of the aggregation window, cells; reached at a combined base-to-height ratio of 0.133.
const LARGEST_RADIUS: usize = 6;
/// Radius of the aggregation window, cells, per unit of the smoothness scale: with a very short base, single mismatches
/// are as tall as houses, and jumps cost twice as much at the largest window.
const RADIUS_PER_SMOOTHNESS: usize = 3;

/// Input of the choice of the matching parameters.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct MatchingFacts {
    /// Mean number of views of a piece of ground.
    pub views: f32,
    /// Combined base-to-height ratio, metres per metre: the root of the sum of its squares over the pairs of views that
    /// are compared.
    pub combined_base_to_height: f32,
    /// True if every view has an index plane.
    pub has_index: bool,
}

impl MatchingFacts {
    /// The facts of views of the ground in `volume` (in the frame of the cameras); `has_index` is true if each of them
    /// has an index plane.
    ///
    /// Neither a crop to the volume nor a shift of the image (a pointing correction) changes a viewing direction, so
    /// the facts are independent of both, up to rounding in f32, and of the pyramid's resolution.
    pub fn new(views: &[ViewGeometry], volume: &SearchVolume, has_index: bool) -> Self {
        Self {
            views: views_of_ground(views, volume),
            combined_base_to_height: pairs::combined_base_to_height(&pairs::choose(views, volume.centre())),
            has_index,
        }
    }
}

/// Places along each side of the ground at which views are counted.
const PLACES: usize = 32;

/// Mean number of views of the places visible in at least two of them, at the volume's middle altitude; the number of
/// all views where there is no such place.
fn views_of_ground(views: &[ViewGeometry], volume: &SearchVolume) -> f32 {
    let along = |low: f32, high: f32, i: usize| low + (high - low) * (i as f32 + 0.5) / PLACES as f32;
    let at_place = |i: usize| {
        let mut place = volume.centre();
        place.x = along(volume.west_m, volume.east_m, i % PLACES);
        place.y = along(volume.south_m, volume.north_m, i / PLACES);
        views
            .iter()
            .filter(|view| pixel_of(&view.camera, place).is_some())
            .count()
    };
    let shown: Vec<usize> = (0..PLACES * PLACES).map(at_place).filter(|&count| count >= 2).collect();
    match shown.is_empty() {
        true => views.len() as f32,
        false => shown.iter().sum::<usize>() as f32 / shown.len() as f32,
    }
}

/// Share of the parameters for many views: 0 up to [`FEW_VIEWS`], 1 from [`MANY_VIEWS`] on.
fn many_views_share(views: f32) -> f32 {
    ((views - FEW_VIEWS) / (MANY_VIEWS - FEW_VIEWS)).clamp(0.0, 1.0)
}

/// Weight of the no-match (occlusion) cost of a cell visible in `views` views, as a share of the weights of all
/// comparisons between them.
pub fn no_match_weight(views: f32) -> f32 {
    NO_MATCH_FEW + (NO_MATCH_MANY - NO_MATCH_FEW) * many_views_share(views)
}

/// Summed cost above the least within which another height remains a candidate at the next, finer search; in units of a
/// full mismatch / 255, summed over the eight paths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct CandidateTolerance {
    /// Tolerance on the level with cells of the requested size.
    pub full_resolution: u16,
    /// Tolerance on the level with cells of twice that size.
    pub half_resolution: u16,
    /// Tolerance on the levels with larger cells.
    pub coarser: u16,
}

impl CandidateTolerance {
    /// The tolerance on the level whose cells are `factor` times as wide as requested.
    pub(super) fn at(&self, factor: usize) -> u16 {
        match factor {
            1 => self.full_resolution,
            2 => self.half_resolution,
            _ => self.coarser,
        }
    }
}

/// All parameters of matching in the plane sweep. Costs are in units of a full mismatch / 255.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct MatchingParameters {
    /// Height step of the hypotheses: the relative shift, cells, of the pair of views with the widest base.
    pub step_cells: f32,
    /// Radius of the square window over which matching costs are averaged, cells; 0 for costs of single cells.
    pub aggregation_radius: usize,
    /// Smallest difference from the centre that the census compares, in median differences between the pixels around; 0
    /// compares all.
    pub noise_floor: f32,
    /// Weight of a comparison of the brightness of views of one date relative to one by the census: under the same sun
    /// values agree, and a single pixel does not reach over edges as a window does. `None` compares them by the census
    /// alone.
    pub same_date_weight: Option<f32>,
    /// Weight of a comparison of index planes relative to one of brightness; `None` compares brightness alone.
    pub index_weight: Option<f32>,
    /// Cost of a change by one height step between neighbours (P1 of Hirschmüller 2008).
    pub one_step_penalty: u16,
    /// Cost of a larger change between neighbours (P2), where the guide image has no edge.
    pub jump_penalty: u16,
    /// Difference of the guide image between neighbours, in its typical differences, that halves the cost of a jump
    /// there.
    pub guide_edge: f32,
    /// Summed cost by which a height of another minimum is e times less probable than the chosen one. It grows with the
    /// width of the window, because cells along a path of the aggregation share the comparisons of their windows.
    pub alternative_cost: f32,
    /// Summed cost above the least within which a height remains a candidate for the next search.
    pub candidate_tolerance: CandidateTolerance,
    /// Reduction of the summed cost of the floor below an uncertain surface; 0 for none.
    pub floor_bonus: u16,
    /// Rounds at full resolution in which views hidden by the surface found so far are left out.
    pub visibility_rounds: usize,
    /// Radius of the window whose plane gives each cell its height, cells; 0 leaves heights as they were matched.
    pub plane_radius: usize,
    /// Least radius, cells, of the adaptive plane smoothing that follows; `None` for none.
    pub adaptive_plane_radius: Option<usize>,
}

impl MatchingParameters {
    /// Chooses all parameters from the facts.
    pub fn choose(facts: &MatchingFacts) -> Self {
        let radius = match facts.views <= FEW_VIEWS {
            true => radius_of_base(facts).max(FEW_VIEWS_RADIUS),
            false => radius_of_base(facts),
        };
        Self::with_radius(facts, radius)
    }

    /// The parameters of a surface that is a hypothesis: other evidence rejects the heights that few views find by
    /// chance, so only a short base asks for windows, which lose objects of a few cells (docs/lab/change.md).
    pub(super) fn of_hypothesis(facts: &MatchingFacts) -> Self {
        Self::with_radius(facts, radius_of_base(facts))
    }

    fn with_radius(facts: &MatchingFacts, radius: usize) -> Self {
        let many = many_views_share(facts.views);
        let between = |few: u16, all: u16| (f32::from(few) + (f32::from(all) - f32::from(few)) * many).round() as u16;
        let very_short_base = radius >= LARGEST_RADIUS;
        let jump_penalty = between(JUMP_PENALTY_FEW, JUMP_PENALTY_MANY);
        Self {
            step_cells: STEP_CELLS,
            aggregation_radius: radius,
            noise_floor: if very_short_base { NOISE_FLOOR } else { 0.0 },
            same_date_weight: (many > 0.0).then_some(many),
            index_weight: facts.has_index.then_some(INDEX_WEIGHT),
            one_step_penalty: ONE_STEP_PENALTY,
            jump_penalty: jump_penalty * smoothness_scale(radius),
            guide_edge: GUIDE_EDGE,
            alternative_cost: COST_PER_E_FOLD * (2 * radius + 1) as f32,
            candidate_tolerance: CandidateTolerance {
                full_resolution: between(TOLERANCE_FEW.full_resolution, TOLERANCE_MANY.full_resolution),
                half_resolution: between(TOLERANCE_FEW.half_resolution, TOLERANCE_MANY.half_resolution),
                coarser: between(TOLERANCE_FEW.coarser, TOLERANCE_MANY.coarser),
            },
            floor_bonus: if radius == 0 { between(0, FLOOR_BONUS) } else { 0 },
            visibility_rounds: VISIBILITY_ROUNDS,
            plane_radius: if radius > 0 { radius + 1 } else { 0 },
            adaptive_plane_radius: very_short_base.then_some(radius),
        }
    }
}

/// Radius of the aggregation window, cells: noise in height grows with the inverse of the base-to-height ratio.
fn radius_of_base(facts: &MatchingFacts) -> usize {
    let radius = SINGLE_CELL_BASE_TO_HEIGHT / facts.combined_base_to_height.max(LEAST_BASE_TO_HEIGHT as f32);
    radius.min(LARGEST_RADIUS as f32) as usize
}

/// Factor on the jump penalty for windows of this radius.
fn smoothness_scale(radius: usize) -> u16 {
    (radius / RADIUS_PER_SMOOTHNESS).max(1) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec3, Vec3};
    use heliosplat::ProjectiveCamera;

    fn chosen(views: u8, combined_base_to_height: f32) -> MatchingParameters {
        MatchingParameters::choose(&MatchingFacts {
            views: views.into(),
            combined_base_to_height,
            has_index: false,
        })
    }

    #[test]
    fn parameters_change_little_by_little_with_the_number_of_views() {
        let of = |views| chosen(views, 2.0);
        assert_eq!(
            [2, 4, 6, 8, 12].map(|views| of(views).jump_penalty),
            [90, 90, 75, 60, 60]
        );
        assert_eq!(
            [4, 6, 8].map(|views| of(views).candidate_tolerance.coarser),
            [80, 140, 200]
        );
        assert_eq!(
            [4, 6, 8].map(|views| of(views).same_date_weight),
            [None, Some(0.5), Some(1.0)]
        );
        let steps: Vec<f32> = (4..8)
            .map(|v| no_match_weight(v as f32) - no_match_weight(v as f32 + 1.0))
            .collect();
        assert!(steps.iter().all(|step| (step - 0.0125).abs() < 1e-6), "{steps:?}");
    }

    /// Views of the western half of a ground, and views of all of it.
    #[test]
    fn views_are_counted_where_there_is_ground_to_see() {
        let volume = SearchVolume {
            west_m: -64.0,
            south_m: -32.0,
            east_m: 64.0,
            north_m: 32.0,
            cell_m: 0.5,
            altitude_min_m: -10.0,
            altitude_max_m: 10.0,
        };
        let looking = |west_m: f64, width: usize| ViewGeometry {
            camera: ProjectiveCamera::new(
                [1.0, 0.0, 0.0, -west_m],
                [0.0, -1.0, 0.0, 32.0],
                [0.0; 3],
                (width, 64),
                DVec3::NEG_Z,
            ),
            date_group: 0,
            sun: None,
        };
        let counted = |views: &[ViewGeometry]| MatchingFacts::new(views, &volume, false).views;
        let (all, western) = (looking(-64.0, 129), looking(-64.0, 64));
        assert_eq!(counted(&[all, all, all]), 3.0);
        assert!((counted(&[all, all, western, western]) - 3.0).abs() < 0.05);
        // One view alone is no ground to match.
        assert_eq!(counted(&[western, western, all]), 3.0);
    }

    #[test]
    fn windows_widen_and_jumps_cost_more_as_the_base_shrinks() {
        let radius = |ratio| chosen(9, ratio).aggregation_radius;
        assert_eq!([0.08, 0.2, 0.3, 0.5, 2.0].map(radius), [6, 4, 2, 1, 0]);
        assert!(radius(0.0) <= LARGEST_RADIUS);
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
    fn few_views_are_compared_by_windows_whatever_their_base() {
        let radius = |views| chosen(views, 2.0).aggregation_radius;
        assert_eq!([2, 3, 4, 5, 9].map(radius), [2, 2, 2, 0, 0]);
        assert_eq!(chosen(2, 0.2).aggregation_radius, 4);
    }

    #[test]
    fn a_hypothesis_of_few_views_keeps_objects_of_a_few_cells() {
        let radius = |ratio| {
            let facts = MatchingFacts {
                views: 2.0,
                combined_base_to_height: ratio,
                has_index: false,
            };
            MatchingParameters::of_hypothesis(&facts).aggregation_radius
        };
        assert_eq!([0.2, 2.0].map(radius), [4, 0], "a short base alone asks for windows");
    }

    #[test]
    fn surfaces_are_smoothed_only_where_costs_are_averaged_and_adaptively_at_the_shortest_base() {
        let smoothing = |ratio| (chosen(9, ratio).plane_radius, chosen(9, ratio).adaptive_plane_radius);
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
        let volume = SearchVolume {
            west_m: centre.x - 50.0,
            south_m: centre.y - 50.0,
            east_m: centre.x + 50.0,
            north_m: centre.y + 50.0,
            cell_m: 0.5,
            altitude_min_m: centre.z - 10.0,
            altitude_max_m: centre.z + 10.0,
        };
        let ratio = |views: &[ViewGeometry]| MatchingFacts::new(views, &volume, false).combined_base_to_height;
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
