//! Cars: in some bays on some dates, never in the truth DSM.

use crate::materials::{Class, Material, Spectrum};
use crate::noise::{hash2, unit};
use crate::solid::{Finish, Footprint, Solids};

/// A place where a car may stand.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CarSlot {
    /// The bay; a car's length lies along its length.
    pub(crate) bay: Footprint,
    /// Seed of the cars that stand here.
    pub(crate) seed: u64,
}

/// Paint: red, green, blue, near infrared.
const PAINTS: [[f64; 4]; 12] = [
    [0.58, 0.58, 0.56, 0.55],
    [0.55, 0.55, 0.55, 0.52],
    [0.34, 0.35, 0.36, 0.35],
    [0.15, 0.15, 0.16, 0.16],
    [0.035, 0.035, 0.04, 0.05],
    [0.05, 0.05, 0.055, 0.06],
    [0.22, 0.22, 0.22, 0.23],
    [0.42, 0.42, 0.41, 0.41],
    [0.20, 0.17, 0.13, 0.22],
    [0.09, 0.11, 0.10, 0.12],
    [0.26, 0.045, 0.04, 0.30],
    [0.05, 0.08, 0.17, 0.16],
];

impl CarSlot {
    /// Adds the car that stands here on a date, with the probability `occupancy` (0 to 1). `height_at(x, y)` is the
    /// altitude of the ground, metres.
    pub(crate) fn build(&self, solids: &mut Solids, date: u64, occupancy: f64, height_at: impl Fn(f64, f64) -> f64) {
        let draw = |salt: u64| unit(hash2(hash2(self.seed, date), salt));
        if draw(1) > occupancy {
            return;
        }
        let long = draw(2);
        let plan = Footprint {
            x: self.bay.x + 0.3 * (draw(3) - 0.5),
            y: self.bay.y + 0.3 * (draw(4) - 0.5),
            angle_rad: self.bay.angle_rad + if draw(5) > 0.5 { std::f64::consts::PI } else { 0.0 },
            half: [2.0 + 0.4 * long, 0.86 + 0.08 * long],
        };
        let paint = PAINTS[(draw(6) * PAINTS.len() as f64) as usize % PAINTS.len()];
        let finish = |colour: Spectrum| Finish::new(Class::Car, Material::Plain(colour), 0);
        let body = finish(Spectrum::from(paint));
        let glass = finish(Spectrum::new(0.045, 0.05, 0.055, 0.05));
        let ground_z = height_at(plan.x, plan.y);
        let tall_m = if draw(7) > 0.9 { 2.1 } else { 1.45 };
        solids.block(&plan, ground_z - 0.1, ground_z + 0.85, body, body);
        let cabin = plan.part(-0.25, 0.0, [0.55 * plan.half[0], plan.half[1] - 0.12]);
        solids.block(&cabin, ground_z + 0.85, ground_z + tall_m, glass, body);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bay_is_full_on_some_dates_only() {
        let bay = Footprint {
            x: 0.0,
            y: 0.0,
            angle_rad: 0.0,
            half: [2.5, 1.1],
        };
        let slots: Vec<CarSlot> = (0..200).map(|seed| CarSlot { bay, seed }).collect();
        let parked = |date: u64| -> Vec<bool> {
            let stands = |slot: &CarSlot| {
                let mut solids = Solids::default();
                slot.build(&mut solids, date, 0.5, |_, _| 0.0);
                !solids.surfaces.is_empty()
            };
            slots.iter().map(stands).collect()
        };
        let (first, second) = (parked(1), parked(2));
        let full = first.iter().filter(|&&stands| stands).count();
        assert!((70..130).contains(&full), "{full}");
        assert!(first.iter().zip(&second).filter(|(a, b)| a != b).count() > 50);
        assert_eq!(first, parked(1));
    }
}
