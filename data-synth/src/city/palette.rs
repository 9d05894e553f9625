//! The colours of a city, with their frequencies.

use super::planner::Planner;
use crate::materials::{Material, Spectrum, grey};
use crate::vegetation::TreeKind;

fn tinted(planner: &mut Planner, mean: [f64; 4], spread: f64) -> Spectrum {
    let tone = 1.0 + planner.range(-spread, spread);
    let warm = planner.range(-0.04, 0.04);
    Spectrum::new(mean[0] * (1.0 + warm), mean[1], mean[2] * (1.0 - warm), mean[3]) * tone
}

/// Material of a wall with windows.
pub(crate) fn facade(planner: &mut Planner) -> Material {
    let mean = planner.pick(&[
        [0.52, 0.49, 0.43, 0.55],
        [0.44, 0.38, 0.29, 0.48],
        [0.46, 0.36, 0.24, 0.48],
        [0.27, 0.15, 0.11, 0.34],
        [0.34, 0.34, 0.34, 0.38],
        [0.24, 0.22, 0.20, 0.30],
    ]);
    Material::Facade(tinted(planner, mean, 0.12))
}

/// Material of a pitched roof.
pub(crate) fn pitched_cover(planner: &mut Planner) -> Material {
    let mean = planner.pick(&[
        [0.27, 0.135, 0.085, 0.34],
        [0.31, 0.16, 0.10, 0.37],
        [0.22, 0.12, 0.085, 0.30],
        [0.17, 0.125, 0.10, 0.24],
        [0.135, 0.135, 0.14, 0.16],
        [0.19, 0.18, 0.17, 0.21],
    ]);
    let colour = tinted(planner, mean, 0.15);
    if planner.chance(0.1) {
        Material::Metal(colour * 1.2)
    } else {
        Material::Tiles(colour)
    }
}

/// Material of a flat roof; one in seven is a membrane with almost no texture.
pub(crate) fn flat_cover(planner: &mut Planner) -> Material {
    match planner.pick(&[0, 0, 1, 1, 2, 3, 4]) {
        0 => Material::Gravel(tinted(planner, [0.25, 0.24, 0.22, 0.27], 0.2)),
        1 => Material::Bitumen(tinted(planner, [0.115, 0.115, 0.12, 0.13], 0.3)),
        2 => {
            let colour = tinted(planner, [0.32, 0.31, 0.28, 0.35], 0.15);
            Material::Slabs(colour, planner.pick(&[1.2, 2.4]))
        }
        3 => Material::Membrane(tinted(planner, [0.56, 0.56, 0.54, 0.54], 0.12)),
        _ => Material::Concrete(tinted(planner, [0.30, 0.29, 0.27, 0.33], 0.2)),
    }
}

/// Material of the roof of a hall.
pub(crate) fn hall_cover(planner: &mut Planner) -> Material {
    match planner.pick(&[0, 1, 1, 2]) {
        0 => Material::Membrane(tinted(planner, [0.50, 0.51, 0.50, 0.50], 0.15)),
        1 => Material::Metal(tinted(planner, [0.38, 0.40, 0.42, 0.40], 0.2)),
        _ => flat_cover(planner),
    }
}

/// Material of paved yards and squares.
pub(crate) fn paving(planner: &mut Planner) -> Material {
    let colour = planner.pick(&[
        [0.28, 0.26, 0.23, 0.32],
        [0.22, 0.21, 0.20, 0.25],
        [0.30, 0.23, 0.18, 0.34],
    ]);
    let side = planner.pick(&[0.8, 1.5, 3.0]);
    Material::Slabs(tinted(planner, colour, 0.12), side)
}

/// Albedo of the asphalt of a street or yard, from new and dark to old and pale.
pub(crate) fn asphalt(planner: &mut Planner) -> Spectrum {
    grey(planner.range(0.075, 0.135))
}

/// Mean colour of a tree's leaves in summer.
pub(crate) fn leaf(planner: &mut Planner, kind: TreeKind) -> Spectrum {
    let mean = match kind {
        TreeKind::Broadleaf => planner.pick(&[
            [0.045, 0.080, 0.030, 0.46],
            [0.060, 0.092, 0.034, 0.44],
            [0.040, 0.066, 0.028, 0.42],
        ]),
        TreeKind::Evergreen => [0.042, 0.064, 0.033, 0.37],
        TreeKind::Conifer => [0.030, 0.050, 0.028, 0.30],
    };
    tinted(planner, mean, 0.18)
}
