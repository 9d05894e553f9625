//! Reflectance of surfaces: albedo in red, green, blue and near infrared, textured at every scale that a pixel
//! resolves.

use crate::noise::{cell_noise, fractal, noise, smoothstep};
use nalgebra::Vector4;

/// Red, green, blue, near infrared.
pub(crate) type Spectrum = Vector4<f64>;

/// LAS class codes, as in DFC2019.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Class {
    Ground = 2,
    Vegetation = 5,
    Building = 6,
    Water = 9,
    Road = 11,
    Car = 64,
}

impl Class {
    /// Every class with its name, in order of code.
    pub(crate) const NAMES: [(Class, &'static str); 6] = [
        (Class::Ground, "ground"),
        (Class::Vegetation, "vegetation"),
        (Class::Building, "building"),
        (Class::Water, "water"),
        (Class::Road, "road"),
        (Class::Car, "car"),
    ];
}

/// Season of the year, for vegetation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Season {
    /// 1 at the height of summer, 0 in the depth of winter.
    pub(crate) green: f64,
    /// Colouring of leaves, 0 (none) to 1.
    pub(crate) autumn: f64,
    /// Dryness of the grass, 0 to 1.
    pub(crate) dry: f64,
}

impl Season {
    /// Season of the truth rasters.
    pub(crate) const REFERENCE: Season = Season {
        green: 0.8,
        autumn: 0.0,
        dry: 0.25,
    };
}

/// Material of a surface. Colours are mean albedos, 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Material {
    Asphalt(Spectrum),
    Concrete(Spectrum),
    /// Square slabs or paving stones of a side in metres.
    Slabs(Spectrum, f64),
    Tiles(Spectrum),
    /// Bitumen sheets, one metre wide.
    Bitumen(Spectrum),
    Gravel(Spectrum),
    /// Standing-seam metal.
    Metal(Spectrum),
    /// A smooth roof with almost no texture.
    Membrane(Spectrum),
    /// A wall with windows in floors.
    Facade(Spectrum),
    /// Evenly coloured: paint, sheet metal, glass.
    Plain(Spectrum),
    Lawn,
    /// Rough grass, beds and bare earth.
    Garden,
    /// Leaves; `true` for evergreens.
    Leaves(Spectrum, bool),
    Bark,
    Water,
    /// A playing field with its lines, half length and half width in metres.
    Court(Spectrum, [f64; 2]),
    /// Parking bays in rows along u, bay width and row pitch in metres.
    Parking(Spectrum, [f64; 2]),
    /// A street along u with its markings, half length and half width in metres.
    Street(Spectrum, [f64; 2]),
}

/// Grey of the albedo `level`, a little darker in blue and brighter in near infrared.
pub(crate) fn grey(level: f64) -> Spectrum {
    Spectrum::new(level, level, level * 0.98, level * 1.15)
}

const WHITE_PAINT: [f64; 4] = [0.52, 0.52, 0.50, 0.50];

/// Position on a surface, and the random number of the surface.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Spot {
    /// First texture coordinate, metres.
    pub(crate) u: f64,
    /// Second texture coordinate, metres.
    pub(crate) v: f64,
    /// Random number of the surface.
    pub(crate) seed: u32,
}

impl Spot {
    /// Noise of several octaves starting at a wavelength in metres.
    fn fractal(&self, salt: u32, wavelength_m: f64, octaves: u32) -> f64 {
        fractal(self.seed ^ salt, self.u, self.v, wavelength_m, octaves)
    }

    fn speckle(&self, salt: u32, size_m: f64) -> f64 {
        noise(self.seed ^ salt, self.u / size_m, self.v / size_m)
    }
}

impl Material {
    /// Albedo at a spot in a season, each band in 0.005 to 0.95.
    pub(crate) fn albedo(&self, at: Spot, season: &Season) -> Spectrum {
        self.unclamped(at, season).map(|a| a.clamp(0.005, 0.95))
    }

    fn unclamped(&self, at: Spot, season: &Season) -> Spectrum {
        match *self {
            Material::Asphalt(mean) => asphalt(mean, at),
            Material::Street(mean, half_size) => street(mean, half_size, at),
            Material::Parking(mean, pitch) => parking(mean, pitch, at),
            Material::Concrete(mean) => mean * (1.0 + 0.10 * at.fractal(1, 5.0, 3) + 0.07 * at.speckle(2, 0.5)),
            Material::Slabs(mean, side) => slabs(mean, side, at),
            Material::Tiles(mean) => tiles(mean, at),
            Material::Bitumen(mean) => bitumen(mean, at),
            Material::Gravel(mean) => mean * (1.0 + 0.12 * at.fractal(1, 6.0, 3) + 0.16 * at.speckle(2, 0.45)),
            Material::Metal(mean) => metal(mean, at),
            Material::Membrane(mean) => mean * (1.0 + 0.025 * at.fractal(1, 9.0, 2)),
            Material::Facade(mean) => facade(mean, at),
            Material::Plain(mean) => mean,
            Material::Lawn => lawn(at, season, 0.0),
            Material::Garden => garden(at, season),
            Material::Leaves(mean, evergreen) => leaves(mean, evergreen, at, season),
            Material::Bark => Spectrum::new(0.12, 0.09, 0.06, 0.22) * (1.0 + 0.2 * at.speckle(1, 0.3)),
            Material::Water => Spectrum::new(0.030, 0.046, 0.042, 0.012) * (1.0 + 0.15 * at.fractal(1, 12.0, 3)),
            Material::Court(mean, half_size) => court(mean, half_size, at),
        }
    }
}

fn asphalt(mean: Spectrum, at: Spot) -> Spectrum {
    let wear = 0.16 * at.fractal(1, 14.0, 3) + 0.10 * at.speckle(2, 0.7) + 0.06 * at.speckle(3, 0.35);
    // Repairs: darker rectangles here and there.
    let repair = cell_noise(at.seed ^ 4, at.u / 6.5, at.v / 2.7);
    let patch = if repair > 0.82 { -0.28 } else { 0.0 };
    let crack = if at.fractal(5, 5.0, 3).abs() < 0.02 { -0.2 } else { 0.0 };
    mean * (1.0 + wear + patch + crack)
}

fn painted(surface: Spectrum, at: Spot) -> Spectrum {
    // Paint is worn: the surface shows through in places.
    let cover = 0.75 + 0.25 * at.speckle(9, 0.6);
    surface * (1.0 - cover) + Spectrum::from(WHITE_PAINT) * cover
}

fn street(mean: Spectrum, [half_length, half_width]: [f64; 2], at: Spot) -> Spectrum {
    let (along, across) = (at.u.abs(), at.v.abs());
    let mut surface = asphalt(mean, at);
    // Two darker wheel tracks in each lane, and a paler gutter.
    let lane = (across / half_width * 2.0).fract();
    surface *= 1.0 - 0.10 * (-((lane - 0.5) / 0.16).powi(2)).exp();
    surface *= 1.0 + 0.25 * smoothstep(half_width - 0.5, half_width - 0.15, across);
    let from_end = half_length - along;
    // Some ends of streets have a crossing.
    let crossing = cell_noise(at.seed ^ 21, at.u.signum() + 0.5, 0.5) > 0.1;
    let zebra = crossing && (2.0..5.0).contains(&from_end) && (at.v * 2.0 * std::f64::consts::PI).sin() > 0.0;
    let stop = (5.8..6.3).contains(&from_end) && at.v * at.u > 0.0;
    let centre = from_end > 7.0 && across < 0.10 && (at.u / 6.0).rem_euclid(1.0) < 0.5;
    let parking_edge = half_width > 5.0 && (across - (half_width - 2.2)).abs() < 0.07 && from_end > 8.0;
    if zebra || stop || centre || parking_edge {
        return painted(surface, at);
    }
    surface
}

fn parking(mean: Spectrum, [bay, pitch]: [f64; 2], at: Spot) -> Spectrum {
    let surface = asphalt(mean, at);
    // Bays on both sides of an aisle: 5 m deep, the middle of the pitch is the aisle.
    let row = at.v.rem_euclid(pitch);
    let in_bay = row < 5.0 || row > pitch - 5.0;
    let line = (at.u.rem_euclid(bay) - 0.5 * bay).abs() > 0.5 * bay - 0.07;
    let back = row < 0.1 || row > pitch - 0.1;
    if (in_bay && line) || back {
        painted(surface, at)
    } else {
        surface
    }
}

fn slabs(mean: Spectrum, side: f64, at: Spot) -> Spectrum {
    let tone = 0.10 * cell_noise(at.seed ^ 1, at.u / side, at.v / side);
    let joint = (at.u / side).rem_euclid(1.0).min((at.v / side).rem_euclid(1.0)) * side < 0.06;
    let dirt = 0.12 * at.fractal(2, 7.0, 3) + 0.05 * at.speckle(3, 0.4);
    mean * (1.0 + tone + dirt - if joint { 0.25 } else { 0.0 })
}

fn tiles(mean: Spectrum, at: Spot) -> Spectrum {
    // u runs along the eaves, v up the slope: rows, batches of tiles, lichen, streaks of rain.
    let row = 0.07 * (at.v / 0.33 * std::f64::consts::TAU).sin();
    let batch = 0.10 * cell_noise(at.seed ^ 1, at.u / 0.9, at.v / 0.66);
    let streak = 0.10 * noise(at.seed ^ 2, at.u / 0.8, at.v / 7.0);
    let lichen = 0.18 * at.fractal(3, 4.5, 4);
    mean * (1.0 + row + batch + streak + lichen)
}

fn bitumen(mean: Spectrum, at: Spot) -> Spectrum {
    let sheet = 0.10 * cell_noise(at.seed ^ 1, at.u / 1.0, at.v / 8.0);
    let seam = if at.u.rem_euclid(1.0) < 0.09 { -0.2 } else { 0.0 };
    let puddle = 0.30 * smoothstep(0.25, 0.5, at.fractal(2, 7.0, 3));
    mean * (1.0 + sheet + seam + puddle + 0.15 * at.fractal(3, 3.0, 3) + 0.07 * at.speckle(4, 0.4))
}

fn metal(mean: Spectrum, at: Spot) -> Spectrum {
    let seam = if at.u.rem_euclid(0.6) < 0.06 { -0.16 } else { 0.0 };
    let sheet = 0.05 * cell_noise(at.seed ^ 1, at.u / 0.6, at.v / 6.0);
    let rust = smoothstep(0.5, 0.75, at.fractal(2, 4.0, 4));
    let surface = mean * (1.0 + seam + sheet + 0.04 * noise(at.seed ^ 3, at.u / 0.5, at.v / 5.0));
    surface * (1.0 - 0.4 * rust) + Spectrum::new(0.20, 0.14, 0.10, 0.24) * (0.4 * rust)
}

fn facade(mean: Spectrum, at: Spot) -> Spectrum {
    const FLOOR_M: f64 = 3.0;
    const BAY_M: f64 = 2.6;
    let (floor, bay) = (at.v / FLOOR_M, at.u / BAY_M);
    let (in_floor, in_bay) = (floor.rem_euclid(1.0) * FLOOR_M, bay.rem_euclid(1.0) * BAY_M);
    let window = (0.9..2.4).contains(&in_floor) && (0.6..2.0).contains(&in_bay);
    if window {
        let blind = cell_noise(at.seed ^ 1, bay, floor);
        return if blind > 0.55 {
            grey(0.35)
        } else {
            Spectrum::new(0.05, 0.06, 0.07, 0.05) * (1.2 + 0.6 * blind)
        };
    }
    let slab = if in_floor < 0.25 { -0.12 } else { 0.0 };
    let streak = 0.10 * noise(at.seed ^ 2, at.u / 0.7, at.v / 6.0);
    mean * (1.0 + slab + streak + 0.08 * at.fractal(3, 6.0, 3))
}

fn court(mean: Spectrum, [half_u, half_v]: [f64; 2], at: Spot) -> Spectrum {
    let (u, v) = (at.u.abs(), at.v.abs());
    let (line_u, line_v) = (half_u - 1.5, half_v - 1.2);
    let inside = u < line_u && v < line_v;
    let edge = |value: f64, line: f64| (value - line).abs() < 0.08;
    let lines = (edge(u, line_u) && v < line_v) || (edge(v, line_v) && u < line_u) || (inside && u < 0.08);
    let circle = (u.hypot(v) - 0.25 * half_v).abs() < 0.08;
    let apron = if inside { 1.0 } else { 0.65 };
    let surface = mean * apron * (1.0 + 0.06 * at.fractal(1, 5.0, 3) + 0.04 * at.speckle(2, 0.5));
    if lines || circle { painted(surface, at) } else { surface }
}

/// Grass between the green of summer, the grey-green of winter and the straw of drought.
fn grass_colour(season: &Season, extra_dry: f64) -> Spectrum {
    let summer = Spectrum::new(0.060, 0.105, 0.040, 0.42);
    let winter = Spectrum::new(0.105, 0.110, 0.060, 0.28);
    let straw = Spectrum::new(0.21, 0.18, 0.11, 0.34);
    let living = winter + (summer - winter) * season.green;
    living + (straw - living) * (season.dry + extra_dry).clamp(0.0, 1.0)
}

fn lawn(at: Spot, season: &Season, extra_dry: f64) -> Spectrum {
    let patch = at.fractal(1, 9.0, 4);
    let mown = 0.05 * (at.u / 1.6 * std::f64::consts::PI).sin();
    let tufts = 0.12 * at.fractal(2, 2.0, 3) + 0.12 * at.speckle(3, 0.45);
    grass_colour(season, extra_dry + 0.35 * patch) * (1.0 + mown + tufts)
}

fn garden(at: Spot, season: &Season) -> Spectrum {
    let kind = at.fractal(11, 5.0, 3);
    let grass = lawn(at, season, 0.2);
    let earth = Spectrum::new(0.21, 0.16, 0.11, 0.30) * (1.0 + 0.2 * at.speckle(12, 0.5));
    let share = smoothstep(0.15, 0.35, kind);
    let shrubs = smoothstep(0.30, 0.45, -kind);
    let ground = grass * (1.0 - share) + earth * share;
    ground * (1.0 - 0.45 * shrubs)
}

fn leaves(mean: Spectrum, evergreen: bool, at: Spot, season: &Season) -> Spectrum {
    let winter = Spectrum::new(0.105, 0.090, 0.065, 0.26);
    let coloured = Spectrum::new(0.165, 0.105, 0.035, 0.36);
    let mut colour = mean;
    if !evergreen {
        colour = winter + (mean - winter) * (0.25 + 0.75 * season.green);
        // Not every tree turns at the same time.
        let turned = season.autumn * (0.65 + 0.35 * cell_noise(at.seed, 0.5, 0.5));
        colour += (coloured - colour) * turned.clamp(0.0, 1.0);
    }
    colour * (1.0 + 0.20 * at.fractal(1, 1.6, 3) + 0.20 * at.speckle(2, 0.4))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaves_change_colour_with_the_season_and_keep_reflecting_infrared() {
        let leaves = Material::Leaves(Spectrum::new(0.045, 0.08, 0.03, 0.45), false);
        let at = Spot {
            u: 1.0,
            v: 2.0,
            seed: 9,
        };
        let bare = Season {
            green: 0.0,
            ..Season::REFERENCE
        };
        let (summer, winter) = (leaves.albedo(at, &Season::REFERENCE), leaves.albedo(at, &bare));
        assert!(summer.y > summer.x && winter.x > winter.y);
        assert!(summer.w > 3.0 * summer.x && winter.w > 1.5 * winter.x);
    }

    #[test]
    fn every_material_is_textured_except_the_plain_ones() {
        let spread = |material: Material| {
            let values: Vec<f64> = (0..400)
                .map(|k| {
                    let at = Spot {
                        u: f64::from(k % 20) * 0.5,
                        v: f64::from(k / 20) * 0.5,
                        seed: 5,
                    };
                    material.albedo(at, &Season::REFERENCE).x
                })
                .collect();
            let mean = values.iter().sum::<f64>() / 400.0;
            (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 400.0).sqrt() / mean
        };
        for material in [
            Material::Asphalt(grey(0.1)),
            Material::Slabs(grey(0.3), 0.6),
            Material::Tiles(grey(0.3)),
            Material::Bitumen(grey(0.1)),
            Material::Gravel(grey(0.3)),
            Material::Lawn,
            Material::Garden,
        ] {
            assert!(spread(material) > 0.05, "{material:?}");
        }
        assert!(spread(Material::Membrane(grey(0.6))) < 0.03);
        assert!(spread(Material::Plain(grey(0.6))) < 1e-12);
    }
}
