//! A city quarter from a seed: streets, blocks with their buildings and plants, and ground cover.

mod building;
mod changes;
mod ground;
mod homes;
mod palette;
mod planner;
mod streets;
mod town;
mod trees;
mod works;

pub(crate) use changes::Changes;
pub(crate) use ground::GroundCover;

use crate::cover::{Coast, Covered, Shore};
use crate::materials::{Class, Material, grey};
use crate::noise::{hash2, stream};
use crate::request::Cover;
use crate::solid::Solids;
use crate::terrain::{HeightField, Relief};
use Use::{Apartments, Commerce, Houses, Park, Tower};
use building::Building;
use ground::{Outline, Zone};
use planner::{Planner, Plot};
use rand::RngExt;
use rand::seq::SliceRandom;
use streets::{Bend, Block, Street, StreetPlan};
use town::Town;

/// Width of the pavement between kerb and building line, metres.
const PAVEMENT_M: f64 = 2.4;
/// Least distance of objects from the sea, metres.
const QUAY_M: f64 = 1.0;
/// Side of a terrain cell, metres.
const TERRAIN_CELL_M: f64 = 1.0;

/// Size and detail of a city.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CityPlan {
    /// Half the side of the square that is built, metres.
    pub(crate) half_extent_m: f64,
    /// Longest side of a block, metres.
    pub(crate) longest_block_m: f64,
    /// True for the make-up of a whole town: centre, suburbs, works, a hill and a large park.
    pub(crate) town: bool,
    /// Cover of one half of the city, if any.
    pub(crate) cover: Option<Cover>,
}

/// A city and the ground it stands on.
pub(crate) struct City {
    /// Ground as a height field.
    pub(crate) terrain: HeightField,
    /// Class and material of the ground.
    pub(crate) ground: GroundCover,
    /// Buildings, plants and bays for cars.
    planned: Planner,
    /// Buildings that exist on some dates only.
    changes: Changes,
}

/// The use of a block.
#[derive(Debug, Clone, Copy)]
enum Use {
    Houses,
    Apartments,
    Commerce,
    Tower,
    Park,
}

impl City {
    /// Plans a city from a seed.
    pub(crate) fn new(seed: u64, plan: CityPlan) -> Self {
        let bend = Bend::new(seed);
        let town = plan.town.then(|| Town::new(seed));
        let relief = Relief::new(seed, town.as_ref().map(|town| town.hill));
        let park = town.as_ref().map(|town| bend.uv_from_xy(town.park));
        // A turned square must still reach into the corners of the terrain.
        let streets = StreetPlan::new(seed, 1.5 * plan.half_extent_m, plan.longest_block_m, park);
        let mut planner = Planner::new(seed, bend, relief);
        let kept = near_blocks(&bend, &streets.blocks, plan.half_extent_m);
        for street in &streets.streets {
            lay_street(&mut planner, street);
        }
        let pavements: Vec<Zone> = kept.iter().map(|block| lay_pavement(&mut planner, block)).collect();
        let purposes = match town {
            Some(mut town) => kept.iter().map(|block| town.purpose(&bend, block)).collect(),
            None => purposes(seed, kept.len()),
        };
        for (block, purpose) in kept.iter().zip(purposes) {
            fill(&mut planner, block, purpose);
        }
        for block in &kept {
            trees::along_pavement(&mut planner, block);
        }
        planner.grow();
        for street in &streets.streets {
            parked_cars(&mut planner, street);
        }
        let (coast, covered) = match plan.cover {
            Some(Cover::Sea | Cover::Nodata) => {
                let coast = Coast::new(seed, &relief);
                (Some(coast), Some(Covered::Sea(coast)))
            }
            Some(Cover::Snow) => (None, Some(Covered::Snow(Shore::new(seed)))),
            None => (None, None),
        };
        if let Some(coast) = &coast {
            planner.clear(|[x, y], reach_m| coast.shore.inside_m(x, y) + reach_m > -QUAY_M);
        }
        let height_m = |x: f64, y: f64| planner.height_m(&pavements, coast.as_ref(), [x, y]);
        let terrain = HeightField::sample(plan.half_extent_m, TERRAIN_CELL_M, height_m);
        let zones = std::mem::take(&mut planner.zones);
        Self {
            terrain,
            ground: GroundCover::new(bend, zones, covered, hash2(seed, 0x60) as u32),
            planned: planner,
            changes: Changes::default(),
        }
    }

    /// Lets `share` (0 to 1) of the larger buildings be built or torn down, each on one of the dates `on`.
    pub(crate) fn changing(mut self, seed: u64, share: f64, on: &[usize]) -> Self {
        self.changes = Changes::new(seed, &self.planned.buildings, share, on);
        self
    }

    /// Date of the last change of the buildings at a place (metres east and north of the site's centre), if there was
    /// one.
    pub(crate) fn changed_at(&self, x: f64, y: f64) -> Option<usize> {
        let here = |(index, building): (usize, &Building)| {
            let date = self.changes.date(index)?;
            (building.footprint.distance_m(x, y) <= 0.0).then_some(date)
        };
        self.planned.buildings.iter().enumerate().filter_map(here).max()
    }

    /// All static solids of a date: the scene of the truth rasters.
    pub(crate) fn solids(&self, date: usize) -> Solids {
        let mut solids = Solids::default();
        let height_at = |x: f64, y: f64| self.terrain.height_m(x, y);
        for (index, building) in self.planned.buildings.iter().enumerate() {
            if self.changes.stands(index, date) {
                building.build(&mut solids);
            }
        }
        for tree in &self.planned.trees {
            tree.build(&mut solids, height_at(tree.x, tree.y));
        }
        for hedge in &self.planned.hedges {
            hedge.build(&mut solids, height_at);
        }
        solids
    }

    /// All solids of a date: the static ones, and cars in `occupancy` (0 to 1) of the bays.
    pub(crate) fn solids_with_cars(&self, date: usize, occupancy: f64) -> Solids {
        let mut solids = self.solids(date);
        for slot in &self.planned.car_slots {
            slot.build(&mut solids, date as u64, occupancy, |x, y| self.terrain.height_m(x, y));
        }
        solids
    }
}

/// Blocks that touch the built square, nearest to its centre first.
fn near_blocks(bend: &Bend, blocks: &[Block], half_extent_m: f64) -> Vec<Block> {
    let far_m = |block: &Block| {
        let [x, y] = bend.xy_from_uv(block.centre());
        x.abs().max(y.abs())
    };
    let reach_m = |block: &Block| block.half()[0].hypot(block.half()[1]);
    let touching = blocks
        .iter()
        .filter(|block| far_m(block) - reach_m(block) < half_extent_m);
    let mut kept: Vec<Block> = touching.copied().collect();
    kept.sort_by(|a, b| far_m(a).total_cmp(&far_m(b)));
    kept
}

/// One use for each block, dealt from shuffled hands so that every neighbourhood has some of each.
fn purposes(seed: u64, count: usize) -> Vec<Use> {
    let mut random = stream(seed, 0xDEA1);
    // The blocks nearest the centre are in every site: one of each kind.
    let work = if random.random_bool(0.5) { Commerce } else { Tower };
    let mut dealt = vec![Houses, Apartments, Park, work];
    dealt.shuffle(&mut random);
    while dealt.len() < count {
        let mut hand = [Houses, Apartments, Houses, Commerce, Tower, Apartments, Park];
        hand.shuffle(&mut random);
        dealt.extend(hand);
    }
    dealt.truncate(count);
    dealt
}

fn fill(planner: &mut Planner, block: &Block, purpose: Use) {
    let build = match purpose {
        Houses => homes::houses,
        Apartments => homes::apartments,
        Commerce => works::commerce,
        Tower => works::tower,
        Park => works::park,
    };
    build(planner, &Plot::inside(block, PAVEMENT_M));
}

fn lay_street(planner: &mut Planner, street: &Street) {
    let asphalt = palette::asphalt(planner);
    let seed = planner.next_seed() as u32;
    let half = [street.half_length, street.half_width];
    let material = Material::Street(asphalt, half);
    planner.zones.push(Zone {
        class: Class::Road,
        ..Zone::rectangle(street.centre, half, street.along_u, material, seed)
    });
}

/// Adds the zones of a block: a kerb stone around a pavement. Returns the outer outline.
fn lay_pavement(planner: &mut Planner, block: &Block) -> Zone {
    let (stone, seed) = (Material::Concrete(grey(0.40)), planner.next_seed() as u32);
    let kerb = Zone {
        outline: Outline::Rounded(3.0),
        ..Zone::rectangle(block.centre(), block.half(), true, stone, seed)
    };
    let pavement = Zone {
        half: block.half().map(|h| h - 0.3),
        material: palette::paving(planner),
        seed: planner.next_seed() as u32,
        ..kerb
    };
    planner.zones.extend([kerb, pavement]);
    kerb
}

/// Bays along the kerbs of streets wide enough for them.
fn parked_cars(planner: &mut Planner, street: &Street) {
    if street.half_width < 4.4 {
        return;
    }
    let mut half = [street.half_length, street.half_width];
    if !street.along_u {
        half.swap(0, 1);
    }
    let carriageway = Block {
        low: [0, 1].map(|axis| street.centre[axis] - half[axis]),
        high: [0, 1].map(|axis| street.centre[axis] + half[axis]),
    };
    let plot = Plot::inside(&carriageway, 0.0);
    for side in [-1.0, 1.0] {
        let mut a = 9.0 - street.half_length;
        while a < street.half_length - 9.0 {
            if planner.chance(0.6) {
                planner.park(&plot, [a, side * (street.half_width - 1.1)], false);
            }
            a += 6.0;
        }
    }
    // Traffic.
    let mut a = 12.0 - street.half_length;
    while a < street.half_length - 12.0 {
        let side = planner.pick(&[-1.0, 1.0]);
        let lane = 0.25 * street.half_width + 0.3;
        planner.park(&plot, [a, side * lane], false);
        a += planner.range(22.0, 60.0);
    }
}
