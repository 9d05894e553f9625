//! The make-up of a town: a dense centre, suburbs, works on one side, a hill of houses, and a large park opposite the
//! hill.

use super::Use::{self, Apartments, Commerce, Houses, Park, Tower};
use super::streets::{Bend, Block};
use crate::noise::stream;
use crate::terrain::Hill;
use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_pcg::Pcg64Mcg;

/// Radius of the centre, metres.
const CENTRE_M: f64 = 170.0;
/// Radius of the dense quarters around the centre, metres.
const INNER_M: f64 = 330.0;
/// Half the angle of the sector of works, seen from the centre, radians.
const WORKS_RAD: f64 = 0.5;
/// Distance of the park from the centre, metres.
const PARK_M: f64 = 270.0;
/// Uses and their weights in the centre, around it, and outside.
const CENTRE: [(Use, u32); 4] = [(Tower, 7), (Apartments, 8), (Commerce, 3), (Park, 2)];
const INNER: [(Use, u32); 5] = [(Apartments, 9), (Houses, 5), (Commerce, 3), (Tower, 2), (Park, 1)];
const OUTER: [(Use, u32); 4] = [(Houses, 14), (Apartments, 3), (Commerce, 2), (Park, 1)];
const WORKS: [(Use, u32); 3] = [(Commerce, 8), (Apartments, 1), (Houses, 1)];

/// Places of the parts of a town.
pub(super) struct Town {
    /// The hill on one side.
    pub(super) hill: Hill,
    /// A place in the park, metres east and north of the centre.
    pub(super) park: [f64; 2],
    /// Direction of the works from the centre, radians from east.
    works_rad: f64,
    random: Pcg64Mcg,
}

impl Town {
    /// Random town of a seed.
    pub(super) fn new(seed: u64) -> Self {
        let mut random = stream(seed, 0x70A7);
        let direction: f64 = random.random_range(0.0..std::f64::consts::TAU);
        let (sin, cos) = direction.sin_cos();
        let side = if random.random_bool(0.5) { 1.0 } else { -1.0 };
        Self {
            hill: Hill {
                towards: [cos, sin],
                foot_m: random.random_range(150.0..200.0),
                length_m: random.random_range(260.0..340.0),
                rise_m: random.random_range(15.0..20.0),
            },
            park: [-PARK_M * cos, -PARK_M * sin],
            works_rad: direction + side * std::f64::consts::FRAC_PI_2,
            random,
        }
    }

    /// The use of a block.
    pub(super) fn purpose(&mut self, bend: &Bend, block: &Block) -> Use {
        if block.contains(bend.uv_from_xy(self.park)) {
            return Park;
        }
        let [x, y] = bend.xy_from_uv(block.centre());
        let from_centre_m = x.hypot(y);
        let aside_rad = (y.atan2(x) - self.works_rad).sin().abs();
        let ahead = x * self.works_rad.cos() + y * self.works_rad.sin() > 0.0;
        let uses: &[(Use, u32)] = if from_centre_m < CENTRE_M {
            &CENTRE
        } else if self.hill.height_m(x, y) > 0.0 {
            &OUTER
        } else if ahead && aside_rad < WORKS_RAD.sin() {
            &WORKS
        } else if from_centre_m < INNER_M {
            &INNER
        } else {
            &OUTER
        };
        // The weights are positive constants.
        uses.choose_weighted(&mut self.random, |(_, weight)| *weight)
            .map_or(Houses, |(purpose, _)| *purpose)
    }
}
