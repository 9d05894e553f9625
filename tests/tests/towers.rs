//! Tall towers and the ground around them, end to end on a synthetic block with a tower of nearly thirty metres.

use heliosplat_raster::GeoRaster;
use heliosplat_tests::program::json;
use std::path::Path;

/// Height above low ground, the quantile 0.3 of the truth, from which a cell is a tower, metres.
const TOWER_M: f32 = 18.0;
/// Cells around a level one whose altitudes differ by less than [`LEVEL_M`]: edges are another matter.
const REACH: isize = 2;
const LEVEL_M: f32 = 0.6;
/// Distance from a tower within which the ground is measured, cells.
const AROUND: isize = 40;
/// Errors beyond this are blunders, metres.
const BLUNDER_M: f32 = 3.0;

/// Altitudes of two surfaces on the grid of the first, metres; NaN where a cell is unknown.
fn altitudes(truth: &Path, surface: &Path) -> (usize, Vec<f32>, Vec<f32>) {
    let [truth, surface] = [truth, surface].map(|path| GeoRaster::read(path).expect("a surface model"));
    let (width, height) = (truth.raster.width, truth.raster.height);
    let at = |cell: usize| {
        let (col, row) = ((cell % width) as f64 + 0.5, (cell / width) as f64 + 0.5);
        let [x, y] = truth.transform.map_from_pixel(col, row);
        let [col, row] = surface.transform.pixel_from_map(x, y).map(f64::floor);
        let inside = col >= 0.0 && row >= 0.0;
        let (col, row) = (col as usize, row as usize);
        let known = inside && col < surface.raster.width && row < surface.raster.height;
        if known {
            surface.raster.plane(0)[row * surface.raster.width + col]
        } else {
            f32::NAN
        }
    };
    let altitudes = (0..width * height).map(at).collect();
    (width, truth.raster.plane(0).to_vec(), altitudes)
}

/// Least and greatest of the truth in the square of `reach` cells around a cell, metres; `None` at the rim.
fn range(width: usize, truth: &[f32], cell: usize, reach: isize) -> Option<(f32, f32)> {
    let (col, row) = ((cell % width) as isize, (cell / width) as isize);
    let height = (truth.len() / width) as isize;
    let inside = |at: isize, size: isize| at >= reach && at + reach < size;
    (inside(col, width as isize) && inside(row, height)).then(|| {
        let mut range = (f32::INFINITY, f32::NEG_INFINITY);
        for row in row - reach..=row + reach {
            let cells = &truth[row as usize * width..][(col - reach) as usize..=(col + reach) as usize];
            range = cells.iter().fold(range, |(low, high), &z| (low.min(z), high.max(z)));
        }
        range
    })
}

/// Shares: of known cells, and among these of those right to a metre, and of blunders.
fn shares(cells: &[(f32, f32)]) -> (f64, f64, f64) {
    let errors: Vec<f32> = cells.iter().map(|(truth, found)| (found - truth).abs()).collect();
    let known = errors.iter().filter(|error| error.is_finite()).count() as f64;
    let count = |within: &dyn Fn(f32) -> bool| errors.iter().filter(|error| within(**error)).count() as f64;
    let (right, wrong) = (count(&|error| error < 1.0), count(&|error| error > BLUNDER_M));
    (known / errors.len() as f64, right / known, wrong / known)
}

#[test]
fn a_tall_tower_has_a_whole_roof_and_the_ground_around_it_is_ground() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (scene, dsm) = (folder.path().join("scene"), folder.path().join("dsm.tif"));
    let text = |path: &Path| path.to_str().expect("an UTF-8 path").to_owned();
    let words = "synth satellite --site block --seed 21 --out";
    json(&words.split(' ').chain([text(&scene).as_str()]).collect::<Vec<_>>());
    json(&["dsm", &text(&scene), "--from", "sweep", "--out", &text(&dsm)]);
    let (width, truth, found) = altitudes(&scene.join("truth/dsm.tif"), &dsm);
    let mut sorted = truth.clone();
    sorted.sort_by(f32::total_cmp);
    let ground_m = sorted[3 * sorted.len() / 10];
    let (mut roofs, mut ground) = (Vec::new(), Vec::new());
    for (cell, pair) in truth.iter().copied().zip(found.iter().copied()).enumerate() {
        let Some((low, high)) = range(width, &truth, cell, REACH) else {
            continue;
        };
        if high - low > LEVEL_M {
            continue;
        }
        if pair.0 > ground_m + TOWER_M {
            roofs.push(pair);
        } else if pair.0 < ground_m + 2.5
            && range(width, &truth, cell, AROUND).is_some_and(|(_, high)| high > ground_m + TOWER_M)
        {
            ground.push(pair);
        }
    }
    assert!(
        roofs.len() > 300 && ground.len() > 3000,
        "{} and {}",
        roofs.len(),
        ground.len()
    );
    let (known, right, wrong) = shares(&roofs);
    assert!(
        known > 0.99 && right > 0.95 && wrong < 0.01,
        "roofs: {known} {right} {wrong}"
    );
    // 3.1 % blunders were measured, among them a bridged alley between the tower and a lower house (docs/lab/start.md).
    let (known, right, wrong) = shares(&ground);
    assert!(
        known > 0.98 && right > 0.94 && wrong < 0.05,
        "ground: {known} {right} {wrong}"
    );
}
