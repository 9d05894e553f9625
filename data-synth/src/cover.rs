//! Half of a site under the sea or under snow, and the surface of the sea: waves that differ in every image.

use crate::materials::{Class, Spectrum};
use crate::noise::{fractal, hash2, noise, smoothstep, stream};
use crate::raytrace::Hit;
use crate::terrain::Relief;
use nalgebra::Vector3;
use rand::RngExt;

/// Amplitude of the shore's deviation from a straight line, metres, and the longest wave of it.
const WAVER_M: f64 = 3.0;
const WAVER_LENGTH_M: f64 = 40.0;
/// Distance of the shore beyond the middle, metres: the covered half is a little more than half.
const BEYOND_MIDDLE_M: f64 = 1.0;
/// The sea lies this far below the lowest land near the site's middle, metres.
const BELOW_LAND_M: f64 = 1.0;
/// Land rises at least so far above the sea, metres.
const LEAST_BANK_M: f64 = 0.5;
/// The land falls to the sea within this distance from the shore, metres.
const BANK_M: f64 = 8.0;
/// Half the side of the square whose lowest place the sea lies below, metres.
const LEVEL_REACH_M: f64 = 64.0;

/// The line between the two halves: straight through the middle of the site, a little wavering.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Shore {
    /// Unit vector (east, north) from the open to the covered half.
    towards: [f64; 2],
    seed: u32,
}

impl Shore {
    /// Random shore of a seed.
    pub(crate) fn new(seed: u64) -> Self {
        let direction: f64 = stream(seed, 0x5EA).random_range(0.0..std::f64::consts::TAU);
        Self {
            towards: [direction.cos(), direction.sin()],
            seed: hash2(seed, 0x5EB) as u32,
        }
    }

    /// Distance of a place from the shore, positive in the covered half, metres. It is accurate to about a tenth.
    pub(crate) fn inside_m(&self, x: f64, y: f64) -> f64 {
        let [east, north] = self.towards;
        let along = x * north - y * east;
        let waver = fractal(self.seed, along, 0.5, WAVER_LENGTH_M, 3);
        x * east + y * north + BEYOND_MIDDLE_M + WAVER_M * waver
    }
}

/// The sea of a site.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Coast {
    /// Line between sea and land.
    pub(crate) shore: Shore,
    /// Altitude of the sea, metres of the scene's frame.
    pub(crate) level_m: f64,
}

impl Coast {
    /// Coast of a seed. The sea lies 1 m below the lowest place of `relief` within 64 m of the middle.
    pub(crate) fn new(seed: u64, relief: &Relief) -> Self {
        let steps = 33;
        let place = |k: usize| (2.0 * k as f64 / (steps - 1) as f64 - 1.0) * LEVEL_REACH_M;
        let lowest_m = (0..steps * steps)
            .map(|k| relief.height_m(place(k % steps), place(k / steps)))
            .fold(f64::INFINITY, f64::min);
        Self {
            shore: Shore::new(seed),
            level_m: lowest_m - BELOW_LAND_M,
        }
    }

    /// Altitude of the ground, metres, at a place where the relief alone has the altitude `land_m`.
    pub(crate) fn height_m(&self, land_m: f64, x: f64, y: f64) -> f64 {
        // On large sites land far away may lie lower than the middle: it stays dry.
        let land_m = land_m.max(self.level_m + LEAST_BANK_M);
        // Level for 2 m on the land's side too, so that no cell under the water is tilted.
        let inland_m = -self.shore.inside_m(x, y);
        self.level_m + (land_m - self.level_m) * smoothstep(2.0, BANK_M, inland_m)
    }
}

/// The cover of one half of a city.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Covered {
    /// Sea beyond a coast.
    Sea(Coast),
    /// Snow beyond a line.
    Snow(Shore),
}

/// Albedo of clean old snow.
const SNOW: [f64; 4] = [0.88, 0.88, 0.87, 0.78];
/// Snow does not stay on surfaces steeper than this (cosine of the slope).
const SNOW_STAYS: f64 = 0.5;

impl Covered {
    /// Distance of a place from the edge, positive where it is covered, metres.
    pub(crate) fn inside_m(&self, x: f64, y: f64) -> f64 {
        match self {
            Self::Sea(coast) => coast.shore.inside_m(x, y),
            Self::Snow(shore) => shore.inside_m(x, y),
        }
    }

    /// Albedo of snow if it covers the hit surface of a class. It lies on ground, roads and buildings, on slopes below
    /// 60 degrees.
    pub(crate) fn snow_on(&self, hit: &Hit, class: Class) -> Option<Spectrum> {
        let holds = matches!(class, Class::Ground | Class::Road | Class::Building);
        let Self::Snow(shore) = self else { return None };
        if !holds || hit.normal.z < SNOW_STAYS || shore.inside_m(hit.point.x, hit.point.y) < 0.0 {
            return None;
        }
        // Drifts change the albedo by a hundredth.
        let drifts = fractal(shore.seed ^ 0x510, hit.point.x, hit.point.y, 9.0, 3);
        Some(Spectrum::from(SNOW) * (1.0 + 0.01 * drifts))
    }
}

/// The waves of the sea in one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Waves {
    seed: u32,
    /// Cosine and sine of the wind's direction.
    wind: [f64; 2],
    /// Mean square slope of all waves together.
    slope_variance: f64,
    /// Threshold of whitecaps in their noise.
    calm: f64,
}

/// Optical surface of the sea at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SeaSurface {
    /// Albedo of water and foam: light that comes out of the water, without the mirror image.
    pub(crate) albedo: Spectrum,
    /// Slope of the waves that pixels resolve, towards east and north.
    pub(crate) slope: [f64; 2],
    /// Mean square slope of the waves that pixels do not resolve.
    pub(crate) fine_variance: f64,
}

impl Waves {
    /// Random waves of an image; `slope_variance` is the mean square slope of all waves on its date.
    pub(crate) fn of_image(seed: u64, slope_variance: f64) -> Self {
        let mut random = stream(seed, 0x3A7E);
        let direction: f64 = random.random_range(0.0..std::f64::consts::TAU);
        Self {
            seed: hash2(seed, 0x3A7F) as u32,
            wind: [direction.cos(), direction.sin()],
            slope_variance,
            calm: random.random_range(0.45..0.70),
        }
    }

    /// Surface of the sea at a place (metres east and north of the site's centre).
    pub(crate) fn at(&self, x: f64, y: f64) -> SeaSurface {
        let [cos, sin] = self.wind;
        // Crests lie across the wind: waves are long across it and short along it.
        let (along, across) = (x * cos + y * sin, y * cos - x * sin);
        let field = |salt: u32, length_m: f64| noise(self.seed ^ salt, along / length_m, 0.4 * across / length_m);
        let slope = |salt: u32| field(salt, 11.0) + 0.9 * field(salt ^ 0x11, 4.0) + 0.7 * field(salt ^ 0x22, 1.6);
        // Half of the variance is in waves that pixels resolve, most of it along the wind; a wave of the noise has a
        // mean square of about 1/5.
        let scale = (0.5 * self.slope_variance / (0.2 * (1.0 + 0.81 + 0.49))).sqrt();
        let (down, side) = (0.8f64.sqrt() * scale * slope(1), 0.2f64.sqrt() * scale * slope(2));
        let muddy = 1.0 + 0.3 * fractal(self.seed ^ 3, x, y, 50.0, 3);
        let whitecaps = fractal(self.seed ^ 4, along, 0.5 * across, 3.0, 3);
        let foam = 0.5 * smoothstep(self.calm, self.calm + 0.25, whitecaps);
        let water = Spectrum::new(0.028, 0.046, 0.050, 0.006) * muddy;
        SeaSurface {
            albedo: water * (1.0 - foam) + Spectrum::new(0.5, 0.5, 0.5, 0.4) * foam,
            slope: [down * cos - side * sin, down * sin + side * cos],
            fine_variance: 0.5 * self.slope_variance,
        }
    }
}

impl SeaSurface {
    /// Unit normal of the waves that pixels resolve.
    pub(crate) fn normal(&self) -> Vector3<f64> {
        Vector3::new(-self.slope[0], -self.slope[1], 1.0).normalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_a_site_or_a_little_more_is_covered() {
        for seed in 0..40 {
            let shore = Shore::new(seed);
            for extent_m in [48.0, 128.0, 256.0] {
                let place = |k: usize| ((k as f64 + 0.5) / 64.0 - 0.5) * extent_m;
                let covered = (0..64 * 64).filter(|k| shore.inside_m(place(k % 64), place(k / 64)) > 0.0);
                let share = covered.count() as f64 / 4096.0;
                assert!((0.45..0.60).contains(&share), "{seed}, {extent_m} m: {share}");
            }
        }
    }

    #[test]
    fn the_sea_is_level_and_the_land_falls_to_it() {
        for seed in 0..20 {
            let relief = Relief::new(seed, None);
            let coast = Coast::new(seed, &relief);
            assert!(coast.level_m > -9.5, "{seed}: {}", coast.level_m);
            for k in 0..2500 {
                let (x, y) = (f64::from(k % 50) * 3.0 - 75.0, f64::from(k / 50) * 3.0 - 75.0);
                let land_m = relief.height_m(x, y);
                let height_m = coast.height_m(land_m, x, y);
                let inside_m = coast.shore.inside_m(x, y);
                if inside_m > 0.0 {
                    assert_eq!(height_m, coast.level_m);
                } else {
                    assert!(height_m >= coast.level_m && height_m <= land_m.max(coast.level_m + LEAST_BANK_M) + 1e-9);
                    assert!(inside_m > -BANK_M || height_m >= land_m - 1e-9);
                }
            }
        }
    }

    #[test]
    fn waves_of_two_images_have_nothing_in_common() {
        let (a, b) = (Waves::of_image(1, 0.02), Waves::of_image(2, 0.02));
        let field = |waves: &Waves| -> Vec<f64> {
            (0..10_000)
                .map(|k| waves.at(f64::from(k % 100), f64::from(k / 100)).slope[0])
                .collect()
        };
        let (a, b) = (field(&a), field(&b));
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let (mean_a, mean_b) = (mean(&a), mean(&b));
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| (x - mean_a) * (y - mean_b)).sum::<f64>();
        let squares = |values: &[f64], mean: f64| values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        let correlation = product(&a, &b) / (squares(&a, mean_a) * squares(&b, mean_b)).sqrt();
        assert!(correlation.abs() < 0.1, "{correlation}");
        let variance = squares(&a, mean_a) / a.len() as f64;
        assert!((0.0005..0.02).contains(&variance), "{variance}");
    }
}
