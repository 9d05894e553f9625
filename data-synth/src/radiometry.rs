//! Light: sun, sky, what surfaces send on, and what the air does on the way to the satellite.
//!
//! Radiance of a Lambertian surface is `albedo / π · (E_sun cos(i) V + E_sky A + E_around (1 - A))`: `V` is the exact
//! visibility of the sun (a point; no penumbra), `A` the share of the cosine-weighted hemisphere that is open sky, and
//! `E_around` the light of an average neighbourhood that fills the rest. Irradiances are relative to the sun's above
//! the air in each band. Water adds the mirror image of the sky and the glitter of the sun (C. Cox and W. Munk,
//! "Measurement of the roughness of the sea surface from photographs of the sun's glitter", JOSA 44, 1954). Clouds take their share of the sun's beam on its way down and of the light on its way up; the
//! light of the sky stays as it is without them.

use crate::clouds::CloudField;
use crate::materials::{Class, Season, Spectrum};
use crate::noise::{hash2, noise, unit};
use crate::ray::Ray;
use crate::raytrace::{GROUND, Hit, Tracer};
use crate::request::BandSet;
use crate::solid::Surface;
use heliosplat_rpc::sun::SunPosition;
use nalgebra::Vector3;
use std::f64::consts::PI;

/// How far shadow and sky rays start from their surface, metres.
const SURFACE_BIAS_M: f64 = 1e-4;
/// Sky beyond this distance counts as open, metres.
const SKY_REACH_M: f64 = 80.0;
/// Clear air's optical depth in red, green, blue and near infrared (Rayleigh and ozone, sea level).
const CLEAR_AIR: [f64; 4] = [0.075, 0.125, 0.200, 0.030];
/// Aerosol's optical depth in each band relative to red.
const AEROSOL: [f64; 4] = [1.0, 1.15, 1.35, 0.75];
/// Share of the light lost from the sun's beam that reaches the ground as sky light.
const SKY_SHARE: f64 = 0.4;
/// Path radiance per optical depth, relative to the sun above the air.
const HAZE_PER_DEPTH: f64 = 0.042;
/// Albedo of an average neighbourhood, half of which lies in shadow.
const AROUND: [f64; 4] = [0.15, 0.14, 0.12, 0.24];
/// Weights of red, green, blue and near infrared in a panchromatic band (450 to 800 nm).
const PAN: [f64; 4] = [0.30, 0.27, 0.22, 0.21];

/// The air, the exposure and the water of one date.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Weather {
    /// Aerosol optical depth in red.
    pub(crate) aerosol: f64,
    /// The vendor's gain relative to the mean of the collection.
    pub(crate) exposure: f64,
    /// Mean square slope of ripples.
    pub(crate) water_slope_variance: f64,
    /// Brightness of what floats in the water, relative to the mean.
    pub(crate) water_turbidity: f64,
    pub(crate) seed: u64,
}

/// Light of one image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Light {
    pub(crate) to_sun: Vector3<f64>,
    /// Irradiance of the sun on a surface that faces it.
    pub(crate) sun: Spectrum,
    /// Irradiance of an open sky on level ground.
    pub(crate) sky: Spectrum,
    around: Spectrum,
    /// Share of the light that reaches the satellite.
    transmittance: Spectrum,
    /// Radiance of the air between ground and satellite.
    haze: Spectrum,
    season: Season,
    weather: Weather,
    clouds: Option<CloudField>,
}

/// Everything a ray may meet.
pub(crate) struct LitScene<'a> {
    pub(crate) tracer: &'a Tracer<'a>,
    pub(crate) surfaces: &'a [Surface],
    pub(crate) ground: &'a crate::city::Ground,
}

/// What one ray of the sensor brings back.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    /// Radiance at the satellite.
    pub(crate) radiance: Spectrum,
    /// Whether more than half of the sun's beam reaches the surface that is seen, or would be but for a cloud before it.
    pub(crate) lit: bool,
    /// Share of the surface's light that a cloud takes on the way to the satellite.
    pub(crate) clouded: f64,
}

impl Light {
    /// The light of a date under a sun, seen at an angle from the zenith.
    pub(crate) fn new(sun: &SunPosition, weather: Weather, season: Season, view_zenith_rad: f64) -> Self {
        let height = sun.elevation_rad.sin();
        let depth = Spectrum::from_fn(|band, _| CLEAR_AIR[band] + weather.aerosol * AEROSOL[band]);
        let beam = depth.map(|d| (-d / height).exp());
        let sky = beam.map(|b| (1.0 - b) * height * SKY_SHARE);
        let level = beam * (0.5 * height) + sky;
        Self {
            to_sun: sun.direction_enu(),
            sun: beam,
            sky,
            around: level.component_mul(&Spectrum::from(AROUND)),
            // Most scattered light goes on forwards: the loss is about half the depth.
            transmittance: depth.map(|d| (-0.5 * d / view_zenith_rad.cos()).exp()),
            haze: depth * (HAZE_PER_DEPTH / view_zenith_rad.cos().sqrt()),
            season,
            weather,
            clouds: None,
        }
    }

    /// The same light with clouds in its way.
    pub(crate) fn through(self, clouds: Option<CloudField>) -> Self {
        Self { clouds, ..self }
    }

    /// What a ray of the sensor sees. `draw` is a random word of its own for each ray.
    pub(crate) fn sample(&self, scene: &LitScene, ray: &Ray, draw: u64) -> Sample {
        let below = self.sample_below(scene, ray, draw);
        let Some(clouds) = &self.clouds else {
            return below;
        };
        let cloud = clouds.seen_along(ray);
        Sample {
            radiance: below.radiance * (1.0 - cloud.opacity) + self.cloud_radiance(cloud.albedo) * cloud.opacity,
            clouded: cloud.opacity,
            ..below
        }
    }

    /// Radiance of a cloud at the satellite. Some of its billows face the sun at any hour, and those are what is bright.
    fn cloud_radiance(&self, albedo: f64) -> Spectrum {
        ((self.sun + self.sky) * (albedo / PI)).component_mul(&self.transmittance) + self.haze
    }

    /// What a ray sees where no cloud is in its own way. `draw` is a random word of its own for each ray.
    fn sample_below(&self, scene: &LitScene, ray: &Ray, draw: u64) -> Sample {
        let Some(hit) = scene.tracer.trace(ray) else {
            return Sample {
                radiance: self.haze,
                lit: true,
                clouded: 0.0,
            };
        };
        let (class, mut albedo) = scene.albedo(&hit, &self.season);
        if class == Class::Water {
            albedo *= self.weather.water_turbidity;
        }
        let start = hit.point + hit.normal * SURFACE_BIAS_M;
        let facing = hit.normal.dot(&self.to_sun);
        let to_sun = Ray {
            origin: start,
            direction: self.to_sun,
        };
        let faces_sun = facing > 0.0 && !scene.tracer.occluded(&to_sun, f64::INFINITY);
        let beam = match &self.clouds {
            _ if !faces_sun => 0.0,
            Some(clouds) => 1.0 - clouds.opacity_along(&to_sun),
            None => 1.0,
        };
        let open = self.sees_sky(scene, start, hit.normal, draw);
        let mut irradiance = if open { self.sky } else { self.around };
        if faces_sun {
            irradiance += self.sun * (facing * beam);
        }
        let mut radiance = albedo.component_mul(&irradiance) / PI;
        if class == Class::Water {
            radiance += self.mirror(&hit, ray, beam);
        }
        Sample {
            radiance: radiance.component_mul(&self.transmittance) + self.haze,
            lit: beam > 0.5,
            clouded: 0.0,
        }
    }

    /// Whether one cosine-weighted direction above a surface is open sky: an unbiased draw of the sky-view factor.
    fn sees_sky(&self, scene: &LitScene, start: Vector3<f64>, normal: Vector3<f64>, draw: u64) -> bool {
        let (u, turn) = (unit(draw), 2.0 * PI * unit(hash2(draw, 0x5C)));
        // A point on the unit sphere around the tip of the normal (Lambert's cosine law).
        let z = 1.0 - 2.0 * u;
        let level = (1.0 - z * z).max(0.0).sqrt();
        let direction = normal + Vector3::new(level * turn.cos(), level * turn.sin(), z);
        let length = direction.norm();
        if length < 1e-9 || direction.z < 0.01 * length {
            return false;
        }
        let ray = Ray {
            origin: start,
            direction: direction / length,
        };
        !scene.tracer.occluded(&ray, SKY_REACH_M)
    }

    /// The sky's mirror image and the sun's glitter on rippled water, which `beam` of the sun's light reaches.
    fn mirror(&self, hit: &Hit, ray: &Ray, beam: f64) -> Spectrum {
        let to_eye = -ray.direction;
        let fresnel = 0.02 + 0.98 * (1.0 - to_eye.z.clamp(0.0, 1.0)).powi(5);
        let ripple = 1.0 + 0.35 * noise(self.weather.seed as u32, hit.point.x / 1.7, hit.point.y / 1.1);
        let sky = self.sky * (fresnel * ripple / PI);
        if beam == 0.0 {
            return sky;
        }
        let half = (to_eye + self.to_sun).normalize();
        let tangent2 = (1.0 - half.z * half.z) / (half.z * half.z);
        let variance = self.weather.water_slope_variance;
        let slopes = (-tangent2 / variance).exp() / (PI * variance);
        sky + self.sun * (beam * (fresnel * ripple * slopes / (4.0 * to_eye.z * half.z.powi(4))))
    }
}

impl LitScene<'_> {
    /// Class and albedo of what was hit.
    pub(crate) fn albedo(&self, hit: &Hit, season: &Season) -> (Class, Spectrum) {
        if hit.surface == GROUND {
            return self.ground.albedo(hit.point.x, hit.point.y, season);
        }
        let surface = &self.surfaces[hit.surface as usize];
        (surface.class, surface.albedo(hit.point, season))
    }

    /// Class of what was hit.
    pub(crate) fn class(&self, hit: &Hit) -> Class {
        if hit.surface == GROUND {
            self.ground.class_at(hit.point.x, hit.point.y)
        } else {
            self.surfaces[hit.surface as usize].class
        }
    }
}

/// The bands of an image from the four of the renderer.
pub(crate) fn bands_of(spectrum: &Spectrum, bands: BandSet) -> ([f32; 4], usize) {
    match bands {
        BandSet::Pan => ([spectrum.dot(&Spectrum::from(PAN)) as f32, 0.0, 0.0, 0.0], 1),
        BandSet::Rgb => ([spectrum.x as f32, spectrum.y as f32, spectrum.z as f32, 0.0], 3),
        BandSet::RgbNir => (spectrum.map(|value| value as f32).into(), 4),
    }
}

/// How radiance becomes the numbers in a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Encoding {
    /// Counts per unit of radiance.
    pub(crate) gain: f64,
    /// 1 is a good sensor's noise.
    pub(crate) noise: f64,
    /// 8 or 16.
    pub(crate) bits: u8,
}

/// Largest count of an 11-bit sensor.
pub(crate) const FULL_COUNT: f64 = 2047.0;
/// Counts per unit of radiance at the mean exposure: a sunlit white roof stays below the largest count.
pub(crate) const MEAN_GAIN: f64 = 9500.0;
/// The count that is white in an 8-bit display image.
const DISPLAY_WHITE: f64 = 1500.0;

impl Encoding {
    /// The number in the file for a radiance; `draw` is a standard normal. 0 is kept for "no data".
    pub(crate) fn count(&self, radiance: f64, draw: f64) -> u16 {
        let clean = self.gain * radiance;
        // Read noise of 2 counts, and shot noise that grows with the square root of the signal.
        let sigma = self.noise * (4.0 + 0.05 * clean.max(0.0)).sqrt();
        let count = clean + sigma * draw;
        if self.bits == 8 {
            let display = srgb((count / DISPLAY_WHITE).clamp(0.0, 1.0));
            return (255.0 * display).round().clamp(1.0, 255.0) as u16;
        }
        count.round().clamp(1.0, FULL_COUNT) as u16
    }
}

/// The transfer curve of sRGB (IEC 61966-2-1).
fn srgb(linear: f64) -> f64 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light(elevation_deg: f64, aerosol: f64) -> Light {
        let weather = Weather {
            aerosol,
            exposure: 1.0,
            water_slope_variance: 0.02,
            water_turbidity: 1.0,
            seed: 1,
        };
        Light::new(
            &SunPosition::from_degrees(140.0, elevation_deg),
            weather,
            Season::REFERENCE,
            0.3,
        )
    }

    #[test]
    fn sky_is_a_tenth_to_a_third_of_the_light_on_level_ground_and_bluer_than_the_sun() {
        for elevation_deg in [22.0, 35.0, 50.0, 70.0] {
            for aerosol in [0.03, 0.16] {
                let light = light(elevation_deg, aerosol);
                let height = elevation_deg.to_radians().sin();
                let share = light.sky.zip_map(&light.sun, |sky, sun| sky / (sky + sun * height));
                let mean = (share.x + share.y + share.z) / 3.0;
                assert!((0.05..0.36).contains(&mean), "{elevation_deg} {aerosol}: {mean}");
                assert!(share.z > share.y && share.y > share.x && share.x > share.w);
            }
        }
    }

    #[test]
    fn haze_grows_with_aerosol_and_is_blue() {
        let (clear, hazy) = (light(45.0, 0.03), light(45.0, 0.22));
        assert!(hazy.haze.x > 1.5 * clear.haze.x);
        assert!(clear.haze.z > 1.5 * clear.haze.x);
    }

    #[test]
    fn a_white_roof_in_the_sun_is_not_saturated_and_dark_asphalt_is_well_above_noise() {
        let light = light(60.0, 0.1);
        let encoding = Encoding {
            gain: MEAN_GAIN,
            noise: 1.0,
            bits: 16,
        };
        let count = |albedo: f64| {
            let level = light.sun * 60f64.to_radians().sin() + light.sky;
            encoding.count(
                (level * (albedo / PI)).component_mul(&light.transmittance).x + light.haze.x,
                0.0,
            )
        };
        assert!((1200..2000).contains(&count(0.6)), "{}", count(0.6));
        assert!((200..500).contains(&count(0.1)), "{}", count(0.1));
    }

    #[test]
    fn display_images_are_srgb_of_the_linear_counts() {
        let linear = Encoding {
            gain: MEAN_GAIN,
            noise: 0.0,
            bits: 16,
        };
        let display = Encoding { bits: 8, ..linear };
        let radiance = 0.5 * DISPLAY_WHITE / MEAN_GAIN;
        assert_eq!(linear.count(radiance, 0.0), 750);
        // sRGB of one half is 0.7354.
        assert_eq!(display.count(radiance, 0.0), 188);
        assert_eq!(display.count(10.0, 0.0), 255);
    }
}
