//! Ground cover: zones in city coordinates, later ones over earlier ones, and their effect on the terrain.

use super::streets::Bend;
use crate::cover::Covered;
use crate::materials::{Class, Material, Season, Spectrum, Spot, grey};
use crate::noise::noise;
use crate::raytrace::Hit;
use std::collections::HashMap;

/// Mean albedo of the sea; images have their own, with waves.
const SEA: [f64; 4] = [0.028, 0.046, 0.050, 0.006];
/// Side of the squares by which zones are found, metres.
const LOOKUP_M: f64 = 6.0;

/// The outline of a zone.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Outline {
    /// A rectangle with corners rounded to a radius in metres.
    Rounded(f64),
    /// An ellipse with a wavering shore.
    Blob,
}

/// A piece of ground in city coordinates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Zone {
    /// Centre in city coordinates, metres.
    pub(crate) centre: [f64; 2],
    /// Half size along the zone's own axes, metres.
    pub(crate) half: [f64; 2],
    /// Sine and cosine of the angle from the u axis of the city to the zone's own first axis.
    pub(crate) turn: [f64; 2],
    /// Shape of the outline.
    pub(crate) outline: Outline,
    /// Class of the ground.
    pub(crate) class: Class,
    /// Material of the ground.
    pub(crate) material: Material,
    /// Random number of texture and outline.
    pub(crate) seed: u32,
}

impl Zone {
    /// A rectangle of plain ground around `centre`, with the half size `half` along u and v, or along v and back
    /// along u.
    pub(crate) fn rectangle(centre: [f64; 2], half: [f64; 2], along_u: bool, material: Material, seed: u32) -> Self {
        let turn_rad = if along_u { 0.0 } else { std::f64::consts::FRAC_PI_2 };
        Self {
            centre,
            half,
            turn: turn_rad.sin_cos().into(),
            outline: Outline::Rounded(0.0),
            class: Class::Ground,
            material,
            seed,
        }
    }

    fn local(&self, uv: [f64; 2]) -> [f64; 2] {
        let [sin, cos] = self.turn;
        let (du, dv) = (uv[0] - self.centre[0], uv[1] - self.centre[1]);
        [du * cos + dv * sin, dv * cos - du * sin]
    }

    /// Distance of a place in city coordinates from the outline, negative inside, metres; approximate for blobs.
    pub(crate) fn distance_m(&self, uv: [f64; 2]) -> f64 {
        let [a, b] = self.local(uv);
        let [l, w] = self.half;
        match self.outline {
            Outline::Rounded(radius) => {
                let (da, db) = (a.abs() - l + radius, b.abs() - w + radius);
                da.max(0.0).hypot(db.max(0.0)) + da.max(db).min(0.0) - radius
            }
            Outline::Blob => {
                let angle = (b / w).atan2(a / l);
                let waver = |speed: f64| noise(self.seed, speed * angle.cos() + 9.0, speed * angle.sin() + 9.0);
                let waver = 1.0 + 0.16 * waver(1.3) + 0.06 * waver(3.5);
                ((a / l).hypot(b / w) / waver - 1.0) * l.min(w)
            }
        }
    }

    fn reach_m(&self) -> f64 {
        1.25 * self.half[0].hypot(self.half[1])
    }
}

/// A sheet of still water.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pond {
    /// Outline of the water.
    pub(crate) zone: Zone,
    /// Altitude of the water, metres of the scene's frame.
    pub(crate) level_m: f64,
}

impl Pond {
    /// True if a place in city coordinates is certainly farther than `distance_m` from the shore; cheap.
    pub(crate) fn is_farther_than(&self, uv: [f64; 2], distance_m: f64) -> bool {
        /// More than the largest factor by which a shore wavers.
        const WAVER: f64 = 1.23;
        let [l, w] = self.zone.half;
        let least_m = WAVER * l.max(w) * (1.0 + distance_m / l.min(w));
        (0..2).any(|k| (uv[k] - self.zone.centre[k]).abs() > least_m)
    }
}

/// The cover of the ground: zones, and the sea or snow over one half.
pub(crate) struct GroundCover {
    bend: Bend,
    zones: Vec<Zone>,
    by_square: HashMap<(i64, i64), Vec<u32>>,
    /// Cover of places outside of all zones: the asphalt of junctions.
    between: Zone,
    /// The cover of one half of the ground.
    covered: Option<Covered>,
}

impl GroundCover {
    /// Sorts the zones for look-up. Later zones lie over earlier ones, and sea or snow over all of them.
    pub(crate) fn new(bend: Bend, zones: Vec<Zone>, covered: Option<Covered>, seed: u32) -> Self {
        let mut by_square: HashMap<(i64, i64), Vec<u32>> = HashMap::new();
        for (index, zone) in zones.iter().enumerate() {
            let reach_m = zone.reach_m();
            let square = |v: f64| (v / LOOKUP_M).floor() as i64;
            for j in square(zone.centre[1] - reach_m)..=square(zone.centre[1] + reach_m) {
                for i in square(zone.centre[0] - reach_m)..=square(zone.centre[0] + reach_m) {
                    let middle = [(i as f64 + 0.5) * LOOKUP_M, (j as f64 + 0.5) * LOOKUP_M];
                    // The distance of a blob is approximate, so blobs are entered in all squares within their reach.
                    if matches!(zone.outline, Outline::Blob) || zone.distance_m(middle) < 0.75 * LOOKUP_M {
                        by_square.entry((i, j)).or_default().push(index as u32);
                    }
                }
            }
        }
        Self {
            bend,
            zones,
            by_square,
            between: Zone {
                class: Class::Road,
                ..Zone::rectangle([0.0; 2], [1.0; 2], true, Material::Asphalt(grey(0.10)), seed)
            },
            covered,
        }
    }

    /// Distance of a place (metres east and north of the site's centre) from the edge of sea or snow, positive where it
    /// is covered, metres; minus infinity if nothing is covered.
    pub(crate) fn inside_cover_m(&self, x: f64, y: f64) -> f64 {
        (self.covered).map_or(f64::NEG_INFINITY, |covered| covered.inside_m(x, y))
    }

    /// True if a place lies in the sea.
    pub(crate) fn is_sea(&self, x: f64, y: f64) -> bool {
        matches!(self.covered, Some(Covered::Sea(_))) && self.inside_cover_m(x, y) > 0.0
    }

    /// Albedo of snow if it covers the hit surface of a class.
    pub(crate) fn snow_on(&self, hit: &Hit, class: Class) -> Option<Spectrum> {
        self.covered?.snow_on(hit, class)
    }

    /// Ground of one material.
    #[cfg(test)]
    pub(crate) fn plain(material: Material) -> Self {
        let mut ground = Self::new(Bend::new(0), Vec::new(), None, 0);
        ground.between.material = material;
        ground.between.class = Class::Ground;
        ground
    }

    /// Topmost zone at a place, and the position of the place in it.
    fn zone_at(&self, x: f64, y: f64) -> (&Zone, Spot) {
        let uv = self.bend.uv_from_xy([x, y]);
        let square = uv.map(|v| (v / LOOKUP_M).floor() as i64);
        let candidates = self.by_square.get(&(square[0], square[1]));
        let zone = (candidates.into_iter().flatten().rev())
            .map(|&index| &self.zones[index as usize])
            .find(|zone| zone.distance_m(uv) <= 0.0)
            .unwrap_or(&self.between);
        let [u, v] = zone.local(uv);
        (zone, Spot { u, v, seed: zone.seed })
    }

    /// Class of the ground at a place.
    pub(crate) fn class_at(&self, x: f64, y: f64) -> Class {
        if self.is_sea(x, y) {
            return Class::Water;
        }
        self.zone_at(x, y).0.class
    }

    /// Class and albedo of the ground at a place in a season.
    pub(crate) fn albedo(&self, x: f64, y: f64, season: &Season) -> (Class, Spectrum) {
        if self.is_sea(x, y) {
            return (Class::Water, Spectrum::from(SEA));
        }
        let (zone, spot) = self.zone_at(x, y);
        (zone.class, zone.material.albedo(spot, season))
    }
}
