//! Whole small scenes with faults, and without: the altitudes that are called known are to be as right as they are said
//! to be.
//!
//! `HELIOSPLAT_TERRAINS_FROM=77` begins the terrains of each angle with another one. The binary `scene_fuzz` tries more
//! scenes with faults.

use heliosplat_tests::scene_fuzz::{FuzzRequest, Outcome, compared};
use heliosplat_tests::terrain::TerrainRequest;
use tempfile::tempdir;

/// Scenes that every run of the tests tries.
const SCENES: u64 = 40;
/// Scenes that once were silently wrong: stated altitudes beside the ground, a street filled to its roofs, exchanged
/// cameras of like views, right cameras that were moved by pixels, and relief upside down.
const ONCE: [u64; 20] = [
    1190, 1919, 3074, 3302, 3571, 1445, 1541, 1796, 2075, 3011, 3398, 42786, 45189, 45453, 48335, 42819, 46234, 48959,
    43571, 48818,
];

#[test]
fn no_scene_is_silently_wrong() {
    let is_silent = |request: &FuzzRequest| {
        let folder = tempdir().expect("a temporary folder");
        match request.outcome(folder.path()) {
            Outcome::Panicked => panic!("{request:?}"),
            outcome => matches!(outcome, Outcome::Silent(_)),
        }
    };
    let of_half = |first: usize| {
        let seeds = (0..SCENES).chain(ONCE).skip(first).step_by(2);
        seeds.map(FuzzRequest::of_seed).filter(is_silent).collect::<Vec<_>>()
    };
    // A warning is heard on the thread of its scene, so that scenes are not jobs of the pool.
    let mut wrong = std::thread::scope(|scope| {
        let odd = scope.spawn(|| of_half(1));
        let mut even = of_half(0);
        even.extend(odd.join().expect("no panic"));
        even
    });
    wrong.sort_by_key(|request| request.seed);
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// Least shares of errors within one, two and four deviations, at any angle; normal errors have 0.68, 0.95 and 1.
const WITHIN: [f64; 3] = [0.6, 0.9, 0.97];
/// Angle below which two images have no base, degrees: its tangent is 0.02.
const NO_BASE_DEG: f64 = 1.1;
/// Terrains of one angle.
const TERRAINS: u64 = 12;

#[test]
fn stated_deviations_hold_for_every_angle_between_the_images() {
    let mut bad = Vec::new();
    let from = std::env::var("HELIOSPLAT_TERRAINS_FROM").ok();
    let first: u64 = from.and_then(|from| from.parse().ok()).unwrap_or(0);
    for degrees in [0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0] {
        let (mut known, mut within) = (0.0f64, [0.0f64; 3]);
        for seed in first..first + TERRAINS {
            let scene = TerrainRequest {
                convergence_deg: Some(degrees),
                ..TerrainRequest::new(seed)
            }
            .scene();
            let folder = tempdir().expect("a temporary folder");
            scene.write(folder.path());
            if let Ok(found) = compared(&scene, folder.path()) {
                let cells = found.cells.len() as f64;
                known += cells;
                for (sum, deviations) in within.iter_mut().zip([1.0, 2.0, 4.0]) {
                    *sum += found.within(deviations) * cells;
                }
            }
        }
        let [one, two, four] = within.map(|sum| sum / known);
        println!("{degrees} degrees: {known} cells, within one {one:.3}, two {two:.3}, four {four:.3}");
        let is_refused = known == 0.0;
        let is_honest = [one, two, four]
            .iter()
            .zip(WITHIN)
            .all(|(share, least)| *share >= least);
        if is_refused != (degrees < NO_BASE_DEG) || !(is_refused || is_honest) {
            bad.push(degrees);
        }
    }
    assert!(bad.is_empty(), "{bad:?}");
}
