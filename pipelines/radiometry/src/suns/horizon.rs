//! A swept surface prepared for rays toward the sun.

use heliosplat_grid::relief::{Relief, Toward};
use heliosplat_stereo::Surface;

/// Heights less than this above a cell do not shade it, metres: the surface is rough.
const LEAST_RISE_M: f32 = 1.0;
/// Offset of a wall toward the cell from the first cell at its height, cells: half of one where the surface is right,
/// and edges of surfaces are ramps. By ablation, docs/lab/suns.md.
const WALL_CELLS: f32 = 0.75;

/// Relief of the cells of a surface that are `covered`; the others are unknown.
pub(super) fn relief_of(surface: &Surface, covered: &[bool]) -> Relief {
    let known = surface.altitude.iter().zip(covered);
    let altitude = known.map(|(&z, &known)| if known { z } else { f32::NAN }).collect();
    Relief::new((surface.width, surface.height), surface.cell_m, altitude)
}

/// Direction over a swept surface toward an azimuth, degrees; elevations below `lowest_deg` do not matter
/// ([`Toward::new`]).
pub(crate) fn toward(azimuth_deg: f64, lowest_deg: f64) -> Toward {
    Toward::new(azimuth_deg, lowest_deg)
        .above(LEAST_RISE_M)
        .nearer(WALL_CELLS)
}

/// Indices of the known cells on a regular subgrid, at most about `most`.
pub(super) fn sample(relief: &Relief, most: usize) -> Vec<usize> {
    let cells = relief.width * relief.height;
    let stride = ((cells as f64 / most as f64).sqrt().ceil() as usize).max(1);
    let rows = (stride / 2..relief.height).step_by(stride);
    rows.flat_map(|row| {
        (stride / 2..relief.width)
            .step_by(stride)
            .map(move |col| row * relief.width + col)
    })
    .filter(|&cell| relief.is_known(cell))
    .collect()
}
