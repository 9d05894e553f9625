//! Solar panels, lying in the plane of some roofs: arrays of dark modules with pale frames.

use crate::materials::{Material, Spectrum, Spot};
use crate::noise::hash2;

/// One roof in this many carries solar panels.
const ROOFS_PER_PANELS: u64 = 3;
/// Least distance from the roof's first corner along and up the roof, metres.
const MARGIN_M: [f64; 2] = [0.8, 0.6];
/// A module's width and length, and the frame around its cells, metres.
const MODULE_M: [f64; 2] = [1.0, 1.65];
const FRAME_M: f64 = 0.04;
/// Period of the arrays along and up the roof, and the part of it that modules fill, metres: the rest is walkways.
const ARRAY_M: [f64; 2] = [9.6, 6.0];
const FILLED_M: [f64; 2] = [8.0, 4.95];
/// Albedo of the cells in red, green, blue and near infrared.
const CELLS: [f64; 4] = [0.030, 0.034, 0.055, 0.045];
/// Albedo of the frames in all bands.
const FRAME: f64 = 0.35;

/// True if a roof of this material carries panels; `seed` is the roof's own random number.
pub(crate) fn carried_by(material: &Material, seed: u32) -> bool {
    let sound = matches!(
        material,
        Material::Tiles(_) | Material::Gravel(_) | Material::Bitumen(_)
    );
    sound && hash2(u64::from(seed), 0x501A).is_multiple_of(ROOFS_PER_PANELS)
}

/// True if a module lies at a spot of a roof that carries panels.
pub(crate) fn on_module(at: Spot) -> bool {
    let place = inner(at);
    (0..2).all(|axis| place[axis] > 0.0 && place[axis].rem_euclid(ARRAY_M[axis]) < FILLED_M[axis])
}

/// Albedo of the module at a spot, 0 to 1 in each band; `None` between modules.
pub(crate) fn albedo(at: Spot) -> Option<Spectrum> {
    if !on_module(at) {
        return None;
    }
    let place = inner(at);
    let frame = (0..2).any(|axis| {
        let within = place[axis].rem_euclid(ARRAY_M[axis]).rem_euclid(MODULE_M[axis]);
        within < FRAME_M || within > MODULE_M[axis] - FRAME_M
    });
    Some(Spectrum::from(if frame { [FRAME; 4] } else { CELLS }))
}

fn inner(at: Spot) -> [f64; 2] {
    [at.u - MARGIN_M[0], at.v - MARGIN_M[1]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::materials::grey;

    #[test]
    fn arrays_of_dark_modules_leave_paths_and_some_roofs_free() {
        let spot = |k: i32| Spot {
            u: f64::from(k % 200) * 0.1,
            v: f64::from(k / 200) * 0.1,
            seed: 1,
        };
        let covered = (0..40_000).filter_map(|k| albedo(spot(k))).collect::<Vec<_>>();
        let share = covered.len() as f64 / 40_000.0;
        assert!((0.5..0.8).contains(&share), "{share}");
        let mean = covered.iter().map(|albedo| albedo.x).sum::<f64>() / covered.len() as f64;
        assert!((0.03..0.10).contains(&mean), "{mean}");
        assert!(albedo(spot(0)).is_none());
        let roofs = (0..300)
            .filter(|&seed| carried_by(&Material::Tiles(grey(0.2)), seed))
            .count();
        assert!((70..130).contains(&roofs), "{roofs}");
        assert!((0..300).all(|seed| !carried_by(&Material::Metal(grey(0.2)), seed)));
    }
}
