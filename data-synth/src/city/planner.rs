//! The city under construction: zones, buildings, trees and cars placed so far, one block at a time, in the axes of the
//! block.

use super::building::{Building, Design};
use super::ground::{Outline, Pond, Zone};
use super::streets::{Bend, Block};
use crate::cars::CarSlot;
use crate::cover::Coast;
use crate::materials::{Class, Material};
use crate::noise::{hash2, smoothstep, stream};
use crate::solid::Footprint;
use crate::terrain::Relief;
use crate::vegetation::{Hedge, Tree, TreeKind};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use std::f64::consts::FRAC_PI_2;

/// Depth of carriageways below the pavements, metres.
const KERB_M: f64 = 0.12;

/// Objects of the city so far, and the random numbers of the next ones.
pub(crate) struct Planner {
    /// City coordinates.
    pub(crate) bend: Bend,
    /// Ground before streets and ponds.
    pub(crate) relief: Relief,
    /// Random stream of the plan.
    pub(crate) random: Pcg64Mcg,
    /// Ground cover; later zones lie over earlier ones.
    pub(crate) zones: Vec<Zone>,
    /// Buildings.
    pub(crate) buildings: Vec<Building>,
    /// Trees that have grown.
    pub(crate) trees: Vec<Tree>,
    /// Hedges.
    pub(crate) hedges: Vec<Hedge>,
    /// Bays for cars.
    pub(crate) car_slots: Vec<CarSlot>,
    /// Ponds.
    pub(crate) ponds: Vec<Pond>,
    /// Requested trees: place in city coordinates, radius of the crown in metres, kind.
    pub(crate) wanted_trees: Vec<([f64; 2], f64, TreeKind)>,
    seed: u64,
}

/// A block's interior on its own axes: `a` along its longer side, `b` across, metres from the centre.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plot {
    /// Centre in city coordinates, metres.
    pub(crate) centre: [f64; 2],
    /// Half length and half width, metres.
    pub(crate) half: [f64; 2],
    /// True if `a` runs along u.
    along_u: bool,
}

impl Plot {
    /// Interior of a block, `margin_m` from its edge.
    pub(crate) fn inside(block: &Block, margin_m: f64) -> Self {
        let half = block.half().map(|h| h - margin_m);
        let along_u = half[0] >= half[1];
        Self {
            centre: block.centre(),
            half: if along_u { half } else { [half[1], half[0]] },
            along_u,
        }
    }

    /// City coordinates of the place (`a`, `b`) of the plot, metres.
    pub(crate) fn uv(&self, [a, b]: [f64; 2]) -> [f64; 2] {
        let [u, v] = self.centre;
        if self.along_u { [u + a, v + b] } else { [u - b, v + a] }
    }

    /// Sign of `a` on the side of the plot that faces the origin of the city: -1 or 1.
    pub(crate) fn towards_centre(&self) -> f64 {
        let from_centre = self.centre[usize::from(!self.along_u)];
        if from_centre > 0.0 { -1.0 } else { 1.0 }
    }

    fn turn_rad(&self) -> f64 {
        if self.along_u { 0.0 } else { FRAC_PI_2 }
    }
}

impl Planner {
    /// Planner without objects.
    pub(crate) fn new(seed: u64, bend: Bend, relief: Relief) -> Self {
        Self {
            bend,
            relief,
            random: stream(seed, 0x91A),
            zones: Vec::new(),
            buildings: Vec::new(),
            trees: Vec::new(),
            hedges: Vec::new(),
            car_slots: Vec::new(),
            ponds: Vec::new(),
            wanted_trees: Vec::new(),
            seed,
        }
    }

    /// Seed for the next object.
    pub(crate) fn next_seed(&mut self) -> u64 {
        hash2(self.seed, self.random.random())
    }

    /// Random number, at least `low` and below `high`.
    pub(crate) fn range(&mut self, low: f64, high: f64) -> f64 {
        self.random.random_range(low..high)
    }

    /// True with the given probability, 0 to 1.
    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        self.random.random_bool(probability)
    }

    /// One of the options, at random. `options` must not be empty.
    pub(crate) fn pick<T: Copy>(&mut self, options: &[T]) -> T {
        options[self.random.random_range(0..options.len())]
    }

    /// Covers a rectangle of a plot around `at`, with half length and half width `half`, metres.
    pub(crate) fn cover(&mut self, plot: &Plot, at: [f64; 2], half: [f64; 2], material: Material) {
        let seed = self.next_seed() as u32;
        let zone = Zone::rectangle(plot.uv(at), half, plot.along_u, material, seed);
        self.zones.push(zone);
    }

    /// Footprint around the place `at` of a plot, turned as the plot is.
    pub(crate) fn footprint(&self, plot: &Plot, at: [f64; 2], half: [f64; 2]) -> Footprint {
        let uv = plot.uv(at);
        let [x, y] = self.bend.xy_from_uv(uv);
        Footprint {
            x,
            y,
            angle_rad: self.bend.direction_rad(uv) + plot.turn_rad(),
            half,
        }
    }

    /// Adds a building. The floor lies 0.15 m above the highest ground at its corners.
    pub(crate) fn erect(&mut self, plot: &Plot, at: [f64; 2], half: [f64; 2], design: Design) {
        let footprint = self.footprint(plot, at, half);
        let corners = footprint.corners(0.0);
        let ground = (corners.iter())
            .map(|c| self.relief.height_m(c.x, c.y))
            .fold(f64::NEG_INFINITY, f64::max);
        let seed = self.next_seed();
        self.buildings.push(Building {
            footprint,
            floor_z: ground + 0.15,
            design,
            seed,
        });
    }

    /// Random number in [0, 1).
    pub(crate) fn share(&mut self) -> f64 {
        self.random.random()
    }

    /// Adds a bay for a car, along the length of the plot or across it.
    pub(crate) fn park(&mut self, plot: &Plot, at: [f64; 2], across: bool) {
        let mut bay = self.footprint(plot, at, [2.5, 1.1]);
        if across {
            bay.angle_rad += FRAC_PI_2;
        }
        let seed = self.next_seed();
        self.car_slots.push(CarSlot { bay, seed });
    }

    /// Adds a hedge between two points of a plot.
    pub(crate) fn hedge(&mut self, plot: &Plot, from: [f64; 2], to: [f64; 2]) {
        let ends = [from, to].map(|place| self.bend.xy_from_uv(plot.uv(place)));
        let seed = self.next_seed();
        let height_m = self.range(1.2, 2.0);
        self.hedges.push(Hedge { ends, height_m, seed });
    }

    /// Altitude of the ground at a place (metres east and north of the site's centre), metres of the scene's frame: the
    /// relief, lowered between the `blocks`, level ponds with a bank around them, and the sea beyond a coast.
    pub(crate) fn height_m(&self, blocks: &[Zone], coast: Option<&Coast>, [x, y]: [f64; 2]) -> f64 {
        let uv = self.bend.uv_from_xy([x, y]);
        // Only the edge of the block that the place is in, or next to, matters.
        let near = |block: &&Zone| (0..2).all(|k| (uv[k] - block.centre[k]).abs() < block.half[k] + 1.0);
        let from_blocks = blocks.iter().filter(near).map(|block| block.distance_m(uv));
        let from_block = from_blocks.fold(f64::INFINITY, f64::min);
        let mut height_m = self.relief.height_m(x, y) - KERB_M * smoothstep(-0.2, 0.6, from_block);
        for pond in &self.ponds {
            // Level for 2 m beyond the shore, so that no cell under the water is tilted; then a bank.
            let bank = if pond.is_farther_than(uv, 8.0) {
                1.0
            } else {
                smoothstep(2.0, 8.0, pond.zone.distance_m(uv))
            };
            height_m = pond.level_m + (height_m - pond.level_m) * bank;
        }
        coast.map_or(height_m, |coast| coast.height_m(height_m, x, y))
    }

    /// Removes buildings, plants, cars and ponds where `taken(place, reach in metres)` is true; places are metres east
    /// and north of the site's centre.
    pub(crate) fn clear(&mut self, taken: impl Fn([f64; 2], f64) -> bool) {
        /// Margin of level shore around ponds, metres.
        const SHORE_M: f64 = 10.0;
        self.buildings.retain(|building| {
            let corners = building.footprint.corners(0.0);
            !corners.iter().any(|corner| taken([corner.x, corner.y], 0.0))
        });
        self.trees.retain(|tree| !taken([tree.x, tree.y], tree.radius_m));
        self.hedges
            .retain(|hedge| !hedge.ends.iter().any(|end| taken(*end, 0.0)));
        self.car_slots.retain(|slot| !taken([slot.bay.x, slot.bay.y], 2.5));
        let bend = self.bend;
        let gone = |zone: &Zone| {
            let reach_m = zone.half[0].hypot(zone.half[1]) + SHORE_M;
            taken(bend.xy_from_uv(zone.centre), reach_m)
        };
        self.ponds.retain(|pond| !gone(&pond.zone));
        self.zones.retain(|zone| zone.class != Class::Water || !gone(zone));
    }

    /// Adds a pond: an ellipse with a wavering shore, 0.5 m below the lowest ground at its rim.
    pub(crate) fn pond(&mut self, plot: &Plot, at: [f64; 2], half: [f64; 2]) {
        let seed = self.next_seed() as u32;
        let zone = Zone {
            outline: Outline::Blob,
            class: Class::Water,
            ..Zone::rectangle(plot.uv(at), half, plot.along_u, Material::Water, seed)
        };
        let rim = |k: u32| {
            let (sin, cos) = (f64::from(k) * 0.4).sin_cos();
            let place = [at[0] + 1.2 * half[0] * cos, at[1] + 1.2 * half[1] * sin];
            let [x, y] = self.bend.xy_from_uv(plot.uv(place));
            self.relief.height_m(x, y)
        };
        let level_m = (0..16).map(rim).fold(f64::INFINITY, f64::min) - 0.5;
        self.ponds.push(Pond { zone, level_m });
        self.zones.push(zone);
    }
}
