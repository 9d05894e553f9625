//! Altitude range of a scene that states none, from tie points between its images, coarse to fine.
//!
//! Too wide a range costs common ground, precision of the pinhole cameras and time, and lets ground in a single image
//! match anything; too narrow a range cuts the surface off. Only the rational cameras are known at this stage, so pairs
//! of images are matched along their epipolar lines ([`heliosplat_stereo::pointing::ties::epipolar`]): first over all
//! heights that the cameras are valid for, on images averaged down to a few hundred pixels, then around the first
//! result, on finer ones. The range is the span of the matches of all pairs, with a margin; a coarse sweep of all
//! images confirms it, or widens it where its surface lies at a limit.

use super::ground::GroundViews;
use super::limits::CellCounts;
use heliosplat_grid::statistics::quantile;
use heliosplat_rpc::parallax::LEAST_BASE_TO_HEIGHT;
use heliosplat_scene::cameras::SceneCameras;
use heliosplat_scene::{AltitudeSource, Index, IngestOptions, Scene, SceneError};
use heliosplat_stereo::pointing::ties::epipolar::{EpipolarSearch, ReducedView, TiedAltitudes, tied_altitudes};
use heliosplat_stereo::{MatchingParameters, Surface, plane_sweep, weight_of_geometry};

/// Largest number of matched pairs; more pairs do not improve a range.
const MOST_PAIRS: usize = 8;
/// Number of partners of each image.
const PARTNERS: usize = 2;
/// Weight of a pair of two days relative to one of a single day.
const OTHER_DAY: f64 = 0.5;
/// Pixels along each side to which images are averaged down for the first search; they contain a few hundred separate
/// patches.
const COARSE_PX: f64 = 320.0;
/// Largest side of an image in the second search, pixels.
const FINE_PX: f64 = 2048.0;
/// Factor between the resolutions of the first and the second search.
const FINER: usize = 4;
/// Number of corners tried in each pair: in the first and in the second search.
const CORNERS: [usize; 2] = [300, 900];
/// Largest relative pointing error of cameras as delivered, metres on the ground.
const POINTING_M: f64 = 10.0;
/// Least number of agreeing tie points of all pairs together for a result.
const FEWEST_TIES: usize = 8;
/// Least share of matches that agree with their neighbours: by chance, the share is far smaller.
const LEAST_AGREEING: f64 = 0.3;
/// Share of the tie points that is discarded at each end of their altitudes.
const TAIL: f64 = 0.02;
/// Margin around the range of the first search: metres, share of its span, pixels of parallax.
const COARSE_MARGIN: (f64, f64, f64) = (40.0, 0.25, 4.0);
/// Margin below and above the range of the second search, metres: corners lie on roofs and streets, but seldom in a pit
/// or on a spire.
const MARGIN_M: (f64, f64) = (15.0, 40.0);
/// Margin of the range, as a share of its span.
const MARGIN_SHARE: f64 = 0.15;

/// Ratio of ground sampling distances above which two images are brought to one resolution before matching.
const UNLIKE: f64 = 1.5;

/// Width of a cell of the coarse sweep, ground sampling distances.
const COARSE_CELL_GSD: f64 = 4.0;
/// Largest number of times that a range is widened.
pub(super) const ROUNDS: usize = 3;

/// Reads a scene. If neither `options` nor the scene's files state the altitudes, they are estimated from tie points,
/// and widened where the surface of a coarse sweep touches their limits.
///
/// # Errors
/// Those of [`Scene::open`].
pub fn open(index: &Index, options: &IngestOptions) -> Result<Scene, SceneError> {
    let mut options = resolve(index, options)?;
    let mut scene = Scene::of(index, &options)?;
    for _ in 0..ROUNDS {
        if scene.altitude_known_from != AltitudeSource::Ties {
            break;
        }
        let wider =
            coarse_sweep(&scene).and_then(|surface| CellCounts::of(&surface, &scene).wider(scene.altitude_range_m));
        let Some(range_m) = wider else {
            break;
        };
        tracing::debug!(searched_m = ?scene.altitude_range_m, ?range_m, "the coarse sweep extends the range of the tie points");
        options.altitude_from_ties_m = Some(range_m);
        drop(scene);
        scene = Scene::of(index, &options)?;
    }
    Ok(scene)
}

/// Surface of a scene in large cells, with the cameras as given; `None` where too few images show the common ground.
fn coarse_sweep(scene: &Scene) -> Option<Surface> {
    let ground = GroundViews::new(scene, scene.training()).ok()?;
    let cell_m = COARSE_CELL_GSD * scene.gsd_m;
    let matching = MatchingParameters::choose(&ground.matching_facts(cell_m));
    let rasters = ground.rasters();
    let views = ground.sweep_views(&rasters, &vec![[0.0; 2]; rasters.len()]);
    Some(plane_sweep(&views, &ground.request(cell_m, matching), &|_| {}))
}

/// `options` with the estimated altitudes; unchanged if `options` or the scene's files state altitudes, or the estimate
/// fails.
///
/// # Errors
/// Those of [`Scene::open`].
pub fn resolve(index: &Index, options: &IngestOptions) -> Result<IngestOptions, SceneError> {
    let mut options = options.clone();
    if options.altitude_range_m.is_some() || options.altitude_from_ties_m.is_some() {
        return Ok(options);
    }
    let cameras = SceneCameras::new(index, &options)?;
    if cameras.range.source == AltitudeSource::Cameras {
        options.altitude_from_ties_m = find(&cameras)?;
    }
    Ok(options)
}

/// Altitudes of the surface from tie points, with a margin, metres above the ellipsoid; `None` where there are too few
/// ties.
fn find(cameras: &SceneCameras) -> Result<Option<(f64, f64)>, SceneError> {
    let bound_m = cameras.range.limits_m();
    let mut pairs = pairs(cameras, bound_m)?;
    // Without a result on the coarsest images, finer ones are tried, whose texture may match.
    for finer in [1, 2, 4] {
        let Some(span) = search(cameras, &mut pairs, bound_m, 0, finer)? else {
            continue;
        };
        let (metres, share, px) = COARSE_MARGIN;
        let margin_m = metres.max(share * (span.high_m - span.low_m)).max(px * span.step_m);
        let range_m = clamped((span.low_m - margin_m, span.high_m + margin_m), bound_m);
        let Some(span) = search(cameras, &mut pairs, range_m, 1, finer)? else {
            continue;
        };
        let share_m = MARGIN_SHARE * (span.high_m - span.low_m);
        let range_m = (
            (span.low_m - MARGIN_M.0.max(share_m)).floor(),
            (span.high_m + MARGIN_M.1.max(share_m)).ceil(),
        );
        return Ok(Some(clamped(range_m, bound_m)));
    }
    Ok(None)
}

fn clamped((low_m, high_m): (f64, f64), bound_m: (f64, f64)) -> (f64, f64) {
    (low_m.max(bound_m.0), high_m.min(bound_m.1))
}

/// Two images that may share ground.
#[derive(Debug, Clone, Copy)]
struct Pair {
    images: [usize; 2],
    weight: f64,
    /// Ground sampling distance of the first image, metres.
    gsd_m: f64,
    /// Ground sampling distance of the second image, metres.
    other_gsd_m: f64,
    /// Offset of the second image across the epipolar lines, pixels of the first image.
    across_px: f64,
    /// Pixels averaged into one along each axis in the first search.
    factor: usize,
}

/// Pairs to match, best first.
fn pairs(cameras: &SceneCameras, bound_m: (f64, f64)) -> Result<Vec<Pair>, SceneError> {
    let count = cameras.count();
    let middle_m = 0.5 * (bound_m.0 + bound_m.1);
    let mut parallaxes = Vec::with_capacity(count);
    for image in 0..count {
        parallaxes.push(cameras.parallax(image, bound_m)?);
    }
    let mut all = Vec::new();
    for a in 0..count {
        for b in a + 1..count {
            let [p, q] = [a, b].map(|image| glam::DVec2::from(parallaxes[image]));
            let base = (p - q).length();
            if base < LEAST_BASE_TO_HEIGHT {
                continue;
            }
            let angle = p.extend(1.0).angle_between(q.extend(1.0));
            let day = if cameras.same_day(a, b) { 1.0 } else { OTHER_DAY };
            let weight = f64::from(weight_of_geometry(base as f32, angle as f32)) * day;
            all.push(Pair {
                images: [a, b],
                weight,
                gsd_m: cameras.gsd_m(a, middle_m)?,
                other_gsd_m: cameras.gsd_m(b, middle_m)?,
                across_px: 0.0,
                factor: 1,
            });
        }
    }
    all.sort_by(|a, b| b.weight.total_cmp(&a.weight).then(a.images.cmp(&b.images)));
    let mut partners = vec![0usize; count];
    let mut chosen = Vec::new();
    for pair in all {
        let wanted = pair.images.iter().all(|&image| partners[image] < PARTNERS);
        if chosen.len() < MOST_PAIRS
            && wanted
            && let Some([window, _]) = cameras.shared_windows(pair.images[0], pair.images[1], bound_m)?
        {
            pair.images.iter().for_each(|&image| partners[image] += 1);
            let side = (window.width as f64 * window.height as f64).sqrt();
            let factor = ((side / COARSE_PX).ceil().max(1.0) as usize).next_power_of_two();
            chosen.push(Pair { factor, ..pair });
        }
    }
    Ok(chosen)
}

/// Span of the tie points' altitudes, metres above the ellipsoid.
struct Span {
    low_m: f64,
    high_m: f64,
    /// Altitude per pixel of parallax for the pair with the least parallax, metres.
    step_m: f64,
}

/// Matches all pairs over a range of altitudes, in the first or second search (`time` 0 or 1), `finer` times finer than
/// usual, and stores the relative pointing of each pair.
fn search(
    cameras: &SceneCameras,
    pairs: &mut [Pair],
    range_m: (f64, f64),
    time: usize,
    finer: usize,
) -> Result<Option<Span>, SceneError> {
    let mut found: Vec<TiedAltitudes> = Vec::new();
    for pair in pairs {
        let Some(ties) = match_pair(cameras, pair, range_m, time, finer)? else {
            continue;
        };
        tracing::debug!(
            pair = ?pair.images,
            range_m = ?range_m,
            tried = ties.tried,
            matched = ties.matched,
            agreeing = ties.altitudes_m.len(),
            across_px = ties.across_px,
            step_m = ties.step_m,
            "altitudes of tie points"
        );
        pair.across_px = ties.across_px;
        found.push(ties);
    }
    let matched: usize = found.iter().map(|ties| ties.matched).sum();
    let mut altitudes_m: Vec<f64> = found.iter().flat_map(|ties| ties.altitudes_m.iter().copied()).collect();
    if altitudes_m.len() < FEWEST_TIES || (altitudes_m.len() as f64) < LEAST_AGREEING * matched as f64 {
        return Ok(None);
    }
    let with_ties = found.iter().filter(|ties| !ties.altitudes_m.is_empty());
    let step_m = with_ties.map(|ties| ties.step_m).fold(0.0, f64::max);
    let low_m = quantile(&mut altitudes_m, TAIL);
    let high_m = quantile(&mut altitudes_m, 1.0 - TAIL);
    Ok(low_m.zip(high_m).map(|(low_m, high_m)| Span { low_m, high_m, step_m }))
}

/// Number of pixels averaged into one along each axis, for each of two images: both then have about the resolution of
/// the coarser image after `factor`. Images of like resolution have one factor.
fn factors_alike(factor: usize, gsds_m: [f64; 2]) -> [usize; 2] {
    let coarser_m = gsds_m[0].max(gsds_m[1]);
    let ratio = |gsd_m: f64| coarser_m / gsd_m;
    if ratio(gsds_m[0].min(gsds_m[1])) <= UNLIKE {
        return [factor; 2];
    }
    // `factor` refers to the first image.
    let coarser = ((factor as f64 * gsds_m[0] / coarser_m).round() as usize).max(1);
    gsds_m.map(|gsd_m| (coarser as f64 * ratio(gsd_m)).round() as usize)
}

fn match_pair(
    cameras: &SceneCameras,
    pair: &Pair,
    range_m: (f64, f64),
    time: usize,
    finer: usize,
) -> Result<Option<TiedAltitudes>, SceneError> {
    let Some(windows) = cameras.shared_windows(pair.images[0], pair.images[1], range_m)? else {
        return Ok(None);
    };
    let coarse = (pair.factor / finer).max(1);
    let mut factor = coarse;
    if time > 0 {
        factor = (coarse / FINER).max(1);
        let side = windows.map(|w| (w.width as f64 * w.height as f64).sqrt());
        while side[0].max(side[1]) / factor as f64 > FINE_PX {
            factor *= 2;
        }
    }
    let [a, b] = pair.images;
    let factors = factors_alike(factor, [pair.gsd_m, pair.other_gsd_m]);
    let first = cameras.read_reduced(a, windows[0], factors[0])?;
    let second = cameras.read_reduced(b, windows[1], factors[1])?;
    let view = |image: usize, raster, window: heliosplat_raster::Window, factor| ReducedView {
        rpc: cameras.rpc(image),
        image: raster,
        first_px: [window.col0, window.row0],
        factor,
    };
    let search = EpipolarSearch {
        range_m,
        across_px: pair.across_px,
        reach_px: match time {
            0 => POINTING_M / pair.gsd_m,
            _ => 2.0 * coarse as f64,
        },
        corners: CORNERS[time],
        gsd_m: pair.gsd_m,
    };
    let views = (
        view(a, &first, windows[0], factors[0]),
        view(b, &second, windows[1], factors[1]),
    );
    Ok(Some(tied_altitudes(&views.0, &views.1, &search)))
}
