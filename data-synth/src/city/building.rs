//! Buildings: walls, a roof of one of four kinds, and structures on the roof.

use crate::materials::{Class, Material, Spectrum, grey};
use crate::noise::{hash2, stream};
use crate::solid::{Finish, Footprint, Solids};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

/// The shape of a roof. Rises are metres above the eaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Roof {
    /// Flat behind a parapet of `parapet_m` (none at 0), with machines and stair houses on large roofs.
    Flat { parapet_m: f64 },
    /// Two slopes; the ridge runs along the length.
    Gabled { rise_m: f64 },
    /// Four slopes; a pyramid if the plan is square.
    Hipped { rise_m: f64 },
    /// `tiers` storeys above the eaves, each `tier_m` high and set back from the one below.
    Stepped { tier_m: f64, tiers: u32 },
}

/// Size and materials of a building without a place.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Design {
    /// Height of the eaves or of the flat roof above the floor, metres.
    pub(crate) eaves_m: f64,
    /// Shape of the roof.
    pub(crate) roof: Roof,
    /// Material of the walls.
    pub(crate) wall: Material,
    /// Material of the roof.
    pub(crate) cover: Material,
}

impl Design {
    /// Eaves at `eaves_m` above the floor under a roof of the material `cover`.
    pub(crate) fn new(eaves_m: f64, wall: Material, (roof, cover): (Roof, Material)) -> Self {
        Self {
            eaves_m,
            roof,
            wall,
            cover,
        }
    }
}

/// One building.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Building {
    /// Outline of the walls.
    pub(crate) footprint: Footprint,
    /// Altitude of the ground floor, metres of the scene's frame; walls extend below it, into the ground.
    pub(crate) floor_z: f64,
    /// Size and materials.
    pub(crate) design: Design,
    /// Seed of the structures on the roof and of the textures.
    pub(crate) seed: u64,
}

/// Depth of walls below the floor, metres: more than any slope drops across a building.
const FOUNDATION_M: f64 = 8.0;

impl Building {
    fn finish(&self, material: Material, part: u32) -> Finish {
        Finish::new(Class::Building, material, hash2(self.seed, u64::from(part)) as u32)
    }

    /// Adds the building to the solids of a scene.
    pub(crate) fn build(&self, solids: &mut Solids) {
        let eaves_z = self.floor_z + self.design.eaves_m;
        let walls = self.finish(self.design.wall, 1);
        let cover = self.finish(self.design.cover, 2);
        solids.walls(&self.footprint, self.floor_z - FOUNDATION_M, eaves_z, walls);
        match self.design.roof {
            Roof::Flat { parapet_m } => {
                solids.polygon(&self.footprint.corners(eaves_z), cover);
                self.parapet(solids, &self.footprint, eaves_z, parapet_m);
                self.clutter(solids, &self.footprint, eaves_z);
            }
            Roof::Gabled { rise_m } => {
                let gable = self.finish(Material::Plain(self.wall_colour()), 1);
                self.slopes(solids, eaves_z, (self.footprint.half[0], rise_m), [cover, gable]);
                self.chimney(solids, eaves_z, rise_m);
            }
            Roof::Hipped { rise_m } => {
                let [l, w] = self.footprint.half;
                self.slopes(solids, eaves_z, ((l - w).max(0.05), rise_m), [cover, cover]);
                self.chimney(solids, eaves_z, rise_m);
            }
            Roof::Stepped { tier_m, tiers } => self.steps(solids, eaves_z, tier_m, tiers),
        }
    }

    fn parapet(&self, solids: &mut Solids, plan: &Footprint, roof_z: f64, height_m: f64) {
        const THICKNESS_M: f64 = 0.3;
        if height_m <= 0.0 {
            return;
        }
        let [l, w] = plan.half;
        let half = 0.5 * THICKNESS_M;
        let coping = self.finish(Material::Concrete(grey(0.36)), 3);
        let sides = self.finish(self.design.wall, 1);
        for (a, b, size) in [
            (0.0, w - half, [l, half]),
            (0.0, half - w, [l, half]),
            (l - half, 0.0, [half, w - THICKNESS_M]),
            (half - l, 0.0, [half, w - THICKNESS_M]),
        ] {
            solids.block(&plan.part(a, b, size), roof_z, roof_z + height_m, sides, coping);
        }
    }

    /// Machines, a stair house and roof lights, as many as the roof has room for.
    fn clutter(&self, solids: &mut Solids, plan: &Footprint, roof_z: f64) {
        let mut random = stream(self.seed, 0xC1);
        let [l, w] = plan.half;
        let area_m2 = 4.0 * l * w;
        if area_m2 < 60.0 || w < 3.0 {
            return;
        }
        let mut taken: Vec<Footprint> = Vec::new();
        if self.design.eaves_m > 7.0 && w > 4.5 {
            let plan = Self::free_spot(&mut random, plan, [2.2, 1.6], &mut taken);
            let height_m = random.random_range(2.2..3.0);
            let top = self.finish(Material::Bitumen(grey(0.12)), 5);
            let sides = self.finish(Material::Plain(grey(0.42)), 4);
            solids.block(&plan, roof_z, roof_z + height_m, sides, top);
        }
        let machines = (area_m2 / 90.0 * random.random_range(0.5..1.4)) as u32;
        for part in 0..machines.min(12) {
            let half = [random.random_range(0.5..1.5), random.random_range(0.5..1.1)];
            let plan = Self::free_spot(&mut random, plan, half, &mut taken);
            let height_m = random.random_range(0.8..2.0);
            let metal = self.finish(Material::Metal(grey(random.random_range(0.3..0.55))), 10 + part);
            solids.block(&plan, roof_z, roof_z + height_m, metal, metal);
        }
        for part in 0..random.random_range(0..4) {
            let half = [random.random_range(0.6..1.6), 0.6];
            let plan = Self::free_spot(&mut random, plan, half, &mut taken);
            let glass = self.finish(Material::Plain(Spectrum::new(0.10, 0.13, 0.15, 0.10)), 30 + part);
            solids.block(&plan, roof_z, roof_z + 0.35, glass, glass);
        }
    }

    /// A place on the roof away from its edge and, if one is found, from structures already there.
    fn free_spot(random: &mut Pcg64Mcg, plan: &Footprint, half: [f64; 2], taken: &mut Vec<Footprint>) -> Footprint {
        let room = [0, 1].map(|axis| (plan.half[axis] - half[axis] - 0.8).max(0.01));
        let mut spot = plan.part(0.0, 0.0, half);
        for _ in 0..12 {
            let [a, b] = room.map(|reach| random.random_range(-reach..reach));
            spot = plan.part(a, b, half);
            let reach = half[0].hypot(half[1]) + 0.4;
            if taken.iter().all(|other| other.distance_m(spot.x, spot.y) > reach) {
                break;
            }
        }
        taken.push(spot);
        spot
    }

    /// A roof with a ridge of half a length of `half_ridge` and a height of `rise_m` along the building; `sides` are the
    /// finishes of the two long faces and of the two at the ends.
    fn slopes(&self, solids: &mut Solids, eaves_z: f64, (half_ridge, rise_m): (f64, f64), sides: [Finish; 2]) {
        let c = self.footprint.corners(eaves_z);
        let ridge = [-half_ridge, half_ridge].map(|a| self.footprint.point(a, 0.0, eaves_z + rise_m));
        solids.polygon(&[c[0], c[1], ridge[1], ridge[0]], sides[0]);
        solids.polygon(&[c[2], c[3], ridge[0], ridge[1]], sides[0]);
        solids.polygon(&[c[1], c[2], ridge[1]], sides[1]);
        solids.polygon(&[c[3], c[0], ridge[0]], sides[1]);
    }

    fn steps(&self, solids: &mut Solids, eaves_z: f64, tier_m: f64, tiers: u32) {
        let mut random = stream(self.seed, 0xC2);
        let mut plan = self.footprint;
        let mut roof_z = eaves_z;
        for tier in 0..tiers {
            let [l, w] = plan.half;
            solids.polygon(&plan.corners(roof_z), self.finish(self.design.cover, 40 + tier));
            self.parapet(solids, &plan, roof_z, 0.7);
            // Each storey keeps to one end or one side, as terraces do.
            let back = [l, w].map(|half| random.random_range(0.10..0.22) * half);
            let lean = back.map(|back| random.random_range(-1.0..1.0) * back);
            let next = plan.part(lean[0], lean[1], [l - back[0] - 0.4, w - back[1] - 0.4]);
            solids.walls(&next, roof_z, roof_z + tier_m, self.finish(self.design.wall, 1));
            plan = next;
            roof_z += tier_m;
        }
        solids.polygon(&plan.corners(roof_z), self.finish(self.design.cover, 2));
        self.parapet(solids, &plan, roof_z, 0.8);
        self.clutter(solids, &plan, roof_z);
    }

    fn chimney(&self, solids: &mut Solids, eaves_z: f64, rise_m: f64) {
        let mut random = stream(self.seed, 0xC3);
        let [l, w] = self.footprint.half;
        if w < 2.5 || random.random_bool(0.25) {
            return;
        }
        let a = random.random_range(-0.5..0.5) * (l - w).max(1.0);
        let b = random.random_range(0.15..0.4) * w;
        let plan = self.footprint.part(a, b, [0.45, 0.35]);
        let brick = self.finish(Material::Plain(Spectrum::new(0.22, 0.13, 0.10, 0.26)), 4);
        solids.block(&plan, eaves_z, eaves_z + rise_m + 0.7, brick, brick);
    }

    fn wall_colour(&self) -> Spectrum {
        match self.design.wall {
            Material::Facade(mean) | Material::Plain(mean) => mean,
            _ => grey(0.4),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ray::Ray;
    use crate::raytrace::Tracer;
    use crate::terrain::HeightField;
    use nalgebra::Vector3;

    fn house(roof: Roof) -> Building {
        Building {
            footprint: Footprint {
                x: 1.0,
                y: 2.0,
                angle_rad: 0.7,
                half: [8.0, 4.5],
            },
            floor_z: 0.3,
            design: Design::new(5.0, Material::Plain(grey(0.5)), (roof, Material::Plain(grey(0.2)))),
            // A seed for which no chimney is built.
            seed: (0..).find(|&seed| stream(seed, 0xC3).random_bool(0.25)).unwrap_or(0),
        }
    }

    /// Largest difference between the traced roof and `expected(a, b)` above the eaves.
    fn worst_error_m(building: &Building, expected: impl Fn(f64, f64) -> f64) -> f64 {
        let ground = HeightField::sample(20.0, 1.0, |_, _| 0.0);
        let mut solids = Solids::default();
        building.build(&mut solids);
        let tracer = Tracer::new(&ground, solids.primitives);
        let mut worst = 0.0f64;
        for k in 0..1500 {
            let (a, b) = (f64::from(k % 50) * 0.32 - 7.9, f64::from(k / 50) * 0.3 - 4.4);
            let [x, y] = building.footprint.at(a, b);
            let ray = Ray::new(Vector3::new(x, y, 50.0), -Vector3::z());
            let z = tracer.trace(&ray).map_or(f64::NAN, |hit| hit.point.z);
            worst = worst.max((z - building.floor_z - building.design.eaves_m - expected(a, b)).abs());
            assert!(z.is_finite());
        }
        worst
    }

    #[test]
    fn a_gabled_roof_is_where_its_formula_says() {
        let random_draw = stream(house(Roof::Gabled { rise_m: 3.0 }).seed, 0xC3).random_bool(0.25);
        assert!(random_draw, "the test's house has no chimney");
        let error = worst_error_m(&house(Roof::Gabled { rise_m: 3.0 }), |_, b| 3.0 * (1.0 - b.abs() / 4.5));
        assert!(error < 1e-9, "{error}");
    }

    #[test]
    fn a_hipped_roof_is_where_its_formula_says() {
        let error = worst_error_m(&house(Roof::Hipped { rise_m: 3.0 }), |a, b| {
            3.0 * (1.0 - b.abs() / 4.5).min((8.0 - a.abs()) / 4.5)
        });
        assert!(error < 1e-9, "{error}");
    }

    #[test]
    fn a_stepped_roof_rises_by_its_tiers_and_no_further_than_what_stands_on_top() {
        let stepped = house(Roof::Stepped { tier_m: 3.0, tiers: 2 });
        let ground = HeightField::sample(20.0, 1.0, |_, _| 0.0);
        let mut solids = Solids::default();
        stepped.build(&mut solids);
        let tracer = Tracer::new(&ground, solids.primitives);
        let ray = |a: f64, b: f64| {
            let [x, y] = stepped.footprint.at(a, b);
            let ray = Ray::new(Vector3::new(x, y, 50.0), -Vector3::z());
            tracer.trace(&ray).map_or(f64::NAN, |hit| hit.point.z)
        };
        let eaves_z = stepped.floor_z + stepped.design.eaves_m;
        assert!(
            (ray(7.85, 4.35) - eaves_z - 0.7).abs() < 1e-9,
            "the corner is the lowest parapet"
        );
        assert!(ray(0.0, 0.0) >= eaves_z + 6.0 - 1e-9 && ray(0.0, 0.0) < eaves_z + 9.1);
    }
}
