//! Light: sun, sky, interreflection, and the effect of the air on the way to the satellite.
//!
//! Radiance of a Lambertian surface is `albedo / π · (E_sun cos(i) V + E_sky A + E_around (1 - A))`: `V` is the exact
//! visibility of the sun (a point; no penumbra), `A` the share of the cosine-weighted hemisphere that is open sky, and
//! `E_around` the light of an average neighbourhood that fills the rest. Irradiances are relative to the sun's above
//! the air in each band. Water adds the mirror image of the sky and the glitter of the sun (C. Cox and W. Munk,
//! "Measurement of the roughness of the sea surface from photographs of the sun's glitter", JOSA 44, 1954). Clouds dim
//! the sun's beam on its way down and the light on its way up; skylight is not changed by them.
//!
//! On request (`Fault`): haze over the scene, a lobe of glossy surfaces, and instead of `E_around` the light reflected
//! by visible surfaces, for one bounce: their own `albedo (E_sun cos(i) V + E_sky or E_around)`.

use crate::city::GroundCover;
use crate::clouds::CloudField;
use crate::cover::{SeaSurface, Waves};
use crate::faults::Haze;
use crate::gloss::{self, Lobe};
use crate::materials::{Class, Season, Spectrum};
use crate::noise::{hash2, noise, unit};
use crate::ray::Ray;
use crate::raytrace::{GROUND, Hit, Tracer};
use crate::solid::{Face, Solids};
use crate::terrain::HeightField;
use heliosplat_rpc::sun::SunPosition;
use nalgebra::Vector3;
use std::f64::consts::PI;

/// Offset of the start of shadow and sky rays from their surface, metres.
pub(crate) const SURFACE_BIAS_M: f64 = 1e-4;
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
/// Share of the light scattered out of the sun's beam by haze that reaches the ground: droplets scatter forwards.
const HAZE_FORWARDS: f64 = 0.65;
/// Directions sampled for interreflection, along each of the two axes of the hemisphere.
const BOUNCE_STRATA: u64 = 2;
/// Albedo of an average neighbourhood, half of which lies in shadow.
const AROUND: [f64; 4] = [0.15, 0.14, 0.12, 0.24];

/// The season, the air, the exposure and the water of one date.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Weather {
    /// Season, for vegetation.
    pub(crate) season: Season,
    /// Aerosol optical depth in red.
    pub(crate) aerosol: f64,
    /// Gain of the date relative to the mean of the collection.
    pub(crate) exposure: f64,
    /// Mean square slope of ripples on water.
    pub(crate) water_slope_variance: f64,
    /// Brightness of particles in the water, relative to the mean.
    pub(crate) water_turbidity: f64,
    /// Seed of the ripples.
    pub(crate) seed: u64,
}

/// Light of one image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Illumination {
    /// Unit vector to the sun (east, north, up).
    pub(crate) to_sun: Vector3<f64>,
    /// Irradiance of the sun on a surface that faces it, relative to that above the air.
    pub(crate) sun: Spectrum,
    /// Irradiance of an open sky on level ground, relative to that of the sun above the air.
    pub(crate) sky: Spectrum,
    around: Spectrum,
    /// Share of the light that reaches the satellite.
    transmittance: Spectrum,
    /// Radiance of the air between ground and satellite.
    haze: Spectrum,
    weather: Weather,
    /// The clouds, if there are any.
    pub(crate) clouds: Option<CloudField>,
    /// True if surfaces receive light that others reflect.
    pub(crate) bounce: bool,
    /// True if glossy surfaces are rendered with their gloss.
    pub(crate) glossy: bool,
    /// The waves of the sea, where there is one.
    pub(crate) waves: Option<Waves>,
}

/// Scene that rays meet: solids, their surfaces, and ground cover.
pub(crate) struct LitScene<'a> {
    /// Geometry of terrain and solids.
    pub(crate) tracer: Tracer<'a>,
    /// Surfaces of the solids, indexed by the surface of a hit.
    surfaces: Vec<Face>,
    /// Cover of the terrain.
    pub(crate) ground: &'a GroundCover,
}

impl<'a> LitScene<'a> {
    /// Scene of solids on a terrain and its cover.
    pub(crate) fn new(terrain: &'a HeightField, solids: Solids, ground: &'a GroundCover) -> Self {
        Self {
            tracer: Tracer::new(terrain, solids.primitives),
            surfaces: solids.surfaces,
            ground,
        }
    }
}

/// Result of one ray of the sensor.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SensorSample {
    /// Radiance at the satellite, relative to the irradiance of the sun above the air.
    pub(crate) radiance: Spectrum,
    /// True if more than half of the sun's beam reaches the visible surface. For a ray that meets a cloud, this is the
    /// surface behind the cloud.
    pub(crate) lit: bool,
    /// Share of the surface's light that a cloud takes on the way to the satellite, 0 to 1, without the veil.
    pub(crate) clouded: f64,
    /// True if the ray ends on the sea.
    pub(crate) sea: bool,
}

impl Illumination {
    /// Light of a date under a clear sky, for a view at an angle from the zenith, radians, of a scene without sea in
    /// which surfaces are matte and light each other only on average.
    pub(crate) fn new(sun: &SunPosition, weather: Weather, view_zenith_rad: f64) -> Self {
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
            weather,
            clouds: None,
            bounce: false,
            glossy: false,
            waves: None,
        }
    }

    /// Adds a layer of haze, for a view at an angle from the zenith, radians; formulas are those of `Haze`.
    pub(crate) fn under_haze(self, haze: Option<&Haze>, view_zenith_rad: f64) -> Self {
        let Some(layer) = haze else { return self };
        let (depth, height) = (layer.depths(), self.to_sun.z);
        let passed = depth.map(|d| (-d / height).exp());
        let sun = self.sun.component_mul(&passed);
        let sky =
            self.sky.component_mul(&depth.map(|d| (-0.5 * d).exp())) + (self.sun - sun) * (height * HAZE_FORWARDS);
        let level = sun * (0.5 * height) + sky;
        let transmittance = depth.map(|d| (-0.5 * d / view_zenith_rad.cos()).exp());
        // Radiance of an infinite layer. The irradiance of the sun above the air is 1 in each band.
        let airlight = height * layer.airlight / PI;
        Self {
            sun,
            sky,
            around: level.component_mul(&Spectrum::from(AROUND)),
            haze: self.haze.component_mul(&transmittance) + transmittance.map(|t| airlight * (1.0 - t)),
            transmittance: self.transmittance.component_mul(&transmittance),
            ..self
        }
    }

    /// Radiance and labels of a ray of the sensor. `draw` is a random word, different for each ray.
    pub(crate) fn sample(&self, scene: &LitScene, ray: &Ray, draw: u64) -> SensorSample {
        let below = self.sample_below(scene, ray, draw);
        let Some(clouds) = &self.clouds else {
            return below;
        };
        let cloud = clouds.seen_along(ray);
        SensorSample {
            radiance: below.radiance * (1.0 - cloud.opacity) + self.cloud_radiance(cloud.albedo) * cloud.opacity,
            clouded: cloud.hides,
            ..below
        }
    }

    /// Radiance of a cloud at the satellite. Some of its billows face the sun at any hour, and these dominate its
    /// brightness.
    fn cloud_radiance(&self, albedo: f64) -> Spectrum {
        ((self.sun + self.sky) * (albedo / PI)).component_mul(&self.transmittance) + self.haze
    }

    /// Sample of a ray below the clouds. `draw` is a random word, different for each ray.
    fn sample_below(&self, scene: &LitScene, ray: &Ray, draw: u64) -> SensorSample {
        let Some(hit) = scene.tracer.trace(ray) else {
            return SensorSample {
                radiance: self.haze,
                lit: true,
                clouded: 0.0,
                sea: false,
            };
        };
        let (class, mut albedo) = scene.albedo(&hit, &self.weather.season);
        let sea = hit.surface == GROUND && scene.ground.is_sea(hit.point.x, hit.point.y);
        let waves = match self.waves {
            Some(waves) if sea => Some(waves.at(hit.point.x, hit.point.y)),
            _ => None,
        };
        if let Some(waves) = &waves {
            albedo = waves.albedo;
        } else if class == Class::Water {
            albedo *= self.weather.water_turbidity;
        }
        let lobe = if self.glossy { scene.lobe(&hit) } else { None };
        if let Some(lobe) = &lobe {
            albedo *= lobe.diffuse;
        }
        let start = hit.point + hit.normal * SURFACE_BIAS_M;
        let facing = hit.normal.dot(&self.to_sun);
        let beam = self.beam(scene, start, facing);
        let mut irradiance = self.ambient(scene, start, hit.normal, draw);
        if beam > 0.0 {
            irradiance += self.sun * (facing * beam);
        }
        let mut radiance = albedo.component_mul(&irradiance) / PI;
        if let Some(waves) = &waves {
            radiance += self.mirror_of_waves(waves, ray, beam);
        } else if class == Class::Water {
            radiance += self.mirror(&hit, ray, beam);
        }
        if let Some(lobe) = &lobe {
            radiance += self.gloss(scene, lobe, start, ray, beam, draw);
        }
        SensorSample {
            radiance: radiance.component_mul(&self.transmittance) + self.haze,
            lit: beam > 0.5,
            clouded: 0.0,
            sea,
        }
    }

    /// Share of the sun's beam that reaches a point whose normal has the cosine `facing` with it.
    fn beam(&self, scene: &LitScene, start: Vector3<f64>, facing: f64) -> f64 {
        let to_sun = Ray::new(start, self.to_sun);
        let faces_sun = facing > 0.0 && !scene.tracer.occluded(&to_sun, f64::INFINITY);
        match &self.clouds {
            _ if !faces_sun => 0.0,
            Some(clouds) => 1.0 - clouds.opacity_along(&to_sun),
            None => 1.0,
        }
    }

    /// Irradiance of everything but the sun: one draw of the hemisphere, or, where surfaces light each other, one in
    /// each stratum.
    fn ambient(&self, scene: &LitScene, start: Vector3<f64>, normal: Vector3<f64>, draw: u64) -> Spectrum {
        if !self.bounce {
            let (u, turn) = (unit(draw), 2.0 * PI * unit(hash2(draw, 0x5C)));
            return self.sky_or_around(scene, start, cosine_weighted(&normal, u, turn));
        }
        let mut sum = Spectrum::zeros();
        for stratum in 0..BOUNCE_STRATA * BOUNCE_STRATA {
            let draw = hash2(draw, 0xB0C0 + stratum);
            let within = |index: u64, draw: u64| (index as f64 + unit(draw)) / BOUNCE_STRATA as f64;
            let u = within(stratum % BOUNCE_STRATA, draw);
            let turn = 2.0 * PI * within(stratum / BOUNCE_STRATA, hash2(draw, 0x5C));
            if let Some(direction) = cosine_weighted(&normal, u, turn) {
                sum += self.arriving(scene, start, direction, draw);
            }
        }
        sum / (BOUNCE_STRATA * BOUNCE_STRATA) as f64
    }

    /// Irradiance of an open sky if there is a direction and it is open, else of the average neighbourhood.
    fn sky_or_around(&self, scene: &LitScene, start: Vector3<f64>, direction: Option<Vector3<f64>>) -> Spectrum {
        let is_open = |direction: Vector3<f64>| {
            direction.z >= 0.01 && !scene.tracer.occluded(&Ray::new(start, direction), SKY_REACH_M)
        };
        if direction.is_some_and(is_open) {
            self.sky
        } else {
            self.around
        }
    }

    /// Irradiance if the whole hemisphere looked like one direction: [`Illumination::sky_or_around`], or with
    /// interreflection the light of the surface in that direction.
    fn arriving(&self, scene: &LitScene, start: Vector3<f64>, direction: Vector3<f64>, draw: u64) -> Spectrum {
        if !self.bounce {
            return self.sky_or_around(scene, start, Some(direction));
        }
        let ray = Ray::new(start, direction);
        let Some(hit) = scene.tracer.trace(&ray) else {
            return if direction.z > 0.0 { self.sky } else { self.around };
        };
        let (_, albedo) = scene.albedo(&hit, &self.weather.season);
        let start = hit.point + hit.normal * SURFACE_BIAS_M;
        let facing = hit.normal.dot(&self.to_sun);
        let (u, turn) = (unit(hash2(draw, 0xB0D0)), 2.0 * PI * unit(hash2(draw, 0xB0D1)));
        let ambient = self.sky_or_around(scene, start, cosine_weighted(&hit.normal, u, turn));
        let beam = self.beam(scene, start, facing);
        albedo.component_mul(&(ambient + self.sun * (facing.max(0.0) * beam)))
    }

    /// Sun and surroundings in the lobe of a glossy surface, which `beam` of the sun's light reaches.
    fn gloss(&self, scene: &LitScene, lobe: &Lobe, start: Vector3<f64>, ray: &Ray, beam: f64, draw: u64) -> Spectrum {
        let to_eye = -ray.direction;
        let sun = self.sun.component_mul(&lobe.of_light(&to_eye, &self.to_sun)) * beam;
        let around = lobe.draw(&to_eye, draw).map(|(direction, share)| {
            let arriving = self.arriving(scene, start, direction, hash2(draw, 0x6105));
            arriving.component_mul(&share) / PI
        });
        sun + around.unwrap_or_else(Spectrum::zeros)
    }

    /// The sky's mirror image on the waves of the sea, and the sun's glitter on the finer ones.
    fn mirror_of_waves(&self, sea: &SeaSurface, ray: &Ray, beam: f64) -> Spectrum {
        let to_eye = -ray.direction;
        let normal = sea.normal();
        let cosine = normal.dot(&to_eye).clamp(0.0, 1.0);
        let fresnel = |cosine: f64| 0.02 + 0.98 * (1.0 - cosine).powi(5);
        // The sky is brighter towards the horizon.
        let mirrored = normal * (2.0 * cosine) - to_eye;
        let sky = self.sky * (fresnel(cosine) * (0.7 + 0.9 * (1.0 - mirrored.z.clamp(0.0, 1.0))) / PI);
        if beam == 0.0 {
            return sky;
        }
        let half = (to_eye + self.to_sun).normalize();
        let beyond = [-half.x / half.z - sea.slope[0], -half.y / half.z - sea.slope[1]];
        let variance = sea.fine_variance;
        let slopes = (-(beyond[0] * beyond[0] + beyond[1] * beyond[1]) / variance).exp() / (PI * variance);
        sky + self.sun * (beam * (fresnel(half.dot(&to_eye)) * slopes / (4.0 * to_eye.z * half.z.powi(4))))
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

/// A direction above a surface, distributed by Lambert's cosine law: a point on the unit sphere around the tip of the
/// normal. `None` for the one draw that has no direction.
fn cosine_weighted(normal: &Vector3<f64>, u: f64, turn: f64) -> Option<Vector3<f64>> {
    let z = 1.0 - 2.0 * u;
    let level = (1.0 - z * z).max(0.0).sqrt();
    let direction = normal + Vector3::new(level * turn.cos(), level * turn.sin(), z);
    let length = direction.norm();
    (length >= 1e-9).then(|| direction / length)
}

impl LitScene<'_> {
    /// Class and albedo of the hit surface; under snow, the class is that of the surface below it.
    pub(crate) fn albedo(&self, hit: &Hit, season: &Season) -> (Class, Spectrum) {
        let (class, albedo) = match self.face(hit) {
            Some(face) => (face.finish.class, face.albedo(hit.point, season)),
            None => self.ground.albedo(hit.point.x, hit.point.y, season),
        };
        (class, self.ground.snow_on(hit, class).unwrap_or(albedo))
    }

    /// The glossy lobe of the hit surface, if it has one and no snow covers it.
    pub(crate) fn lobe(&self, hit: &Hit) -> Option<Lobe> {
        let face = self.face(hit)?;
        let bare = self.ground.snow_on(hit, face.finish.class).is_none();
        if bare { gloss::lobe_of(face, hit) } else { None }
    }

    /// Class of the hit surface.
    pub(crate) fn class(&self, hit: &Hit) -> Class {
        self.face(hit).map_or_else(
            || self.ground.class_at(hit.point.x, hit.point.y),
            |face| face.finish.class,
        )
    }

    /// The hit surface of a solid; `None` for the terrain.
    fn face(&self, hit: &Hit) -> Option<&Face> {
        self.surfaces.get(hit.surface as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encoding::{Encoding, MEAN_GAIN};
    use crate::materials::Material;
    use crate::solid::{Finish, Footprint};

    fn light(elevation_deg: f64, aerosol: f64) -> Illumination {
        let weather = Weather {
            season: Season::REFERENCE,
            aerosol,
            exposure: 1.0,
            water_slope_variance: 0.02,
            water_turbidity: 1.0,
            seed: 1,
        };
        Illumination::new(&SunPosition::from_degrees(140.0, elevation_deg), weather, 0.3)
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

    /// Flat ground and a wide sunlit wall that stands `distance_m` east of the origin, of a material.
    fn beside_a_wall(distance_m: f64, material: Material, look: impl Fn(&LitScene)) {
        let terrain = HeightField::sample(150.0, 2.0, |_, _| 0.0);
        let finish = Finish::new(Class::Building, material, 1);
        let mut solids = Solids::default();
        let wall = Footprint {
            x: distance_m + 1.0,
            y: 0.0,
            angle_rad: 0.0,
            half: [1.0, 140.0],
        };
        solids.block(&wall, -1.0, 10.0, finish, finish);
        let ground = GroundCover::plain(Material::Plain(crate::materials::grey(0.2)));
        look(&LitScene::new(&terrain, solids, &ground));
    }

    #[test]
    fn ground_beside_a_sunlit_wall_gets_the_light_that_its_share_of_the_view_sends() {
        // The wall faces west, and so does the sun.
        let sun = SunPosition::from_degrees(270.0, 35.0);
        let weather = light(35.0, 0.1).weather;
        let light = Illumination {
            bounce: true,
            ..Illumination::new(&sun, weather, 0.3)
        };
        let (distance_m, height_m) = (4.0, 10.0f64);
        let wall = Material::Plain(Spectrum::repeat(0.6));
        beside_a_wall(distance_m, wall, |scene| {
            let draws = 6000;
            let sum: Spectrum = (0..draws)
                .map(|k| light.ambient(scene, Vector3::new(0.0, 0.0, SURFACE_BIAS_M), Vector3::z(), hash2(7, k)))
                .sum();
            let got = sum / draws as f64;
            // The share of the view of a level place that a long wall fills, and the wall's own light.
            let share = 0.5 * (1.0 - distance_m / distance_m.hypot(height_m));
            let on_wall = light.sun * light.to_sun.x.abs() + (light.sky + light.around) * 0.5;
            let expected = on_wall * (0.6 * share) + light.sky * (1.0 - share);
            for band in 0..4 {
                let error = (got[band] - expected[band]).abs() / expected[band];
                assert!(error < 0.03, "band {band}: {} {}", got[band], expected[band]);
            }
            let without = Illumination::new(&sun, weather, 0.3);
            let dimmer = light.sky * (1.0 - share) + without.around * share;
            assert!(got.x > 1.2 * dimmer.x, "more than from an average neighbourhood");
        });
    }

    #[test]
    fn metal_looks_brighter_towards_the_sun_s_mirror_image_and_lambertian_ground_does_not() {
        let light = Illumination {
            glossy: true,
            ..light(55.0, 0.1)
        };
        beside_a_wall(2.0, Material::Metal(crate::materials::grey(0.4)), |scene| {
            let seen = |point: Vector3<f64>, direction: Vector3<f64>| {
                let ray = Ray::new(point - direction * 40.0, direction);
                let mean: f64 = (0..400)
                    .map(|k| light.sample(scene, &ray, hash2(3, k)).radiance.x)
                    .sum();
                mean / 400.0
            };
            let mirror = Vector3::new(light.to_sun.x, light.to_sun.y, -light.to_sun.z);
            let other = Vector3::new(-0.3, 0.3, -1.0).normalize();
            let (roof, ground) = (Vector3::new(3.0, 20.0, 10.0), Vector3::new(-60.0, 20.0, 0.0));
            assert!(seen(roof, mirror) > 2.0 * seen(roof, other));
            let (a, b) = (seen(ground, mirror), seen(ground, other));
            assert!((a - b).abs() < 0.02 * a, "{a} {b}");
        });
    }

    #[test]
    fn haze_is_seen_as_transmitted_light_plus_airlight_and_dims_the_beam() {
        let clear = light(45.0, 0.1);
        let layer = Haze {
            depth: 0.4,
            airlight: 0.4,
        };
        let hazy = clear.under_haze(Some(&layer), 0.3);
        let share = layer.depths().map(|d| (-0.5 * d / 0.3f64.cos()).exp());
        let airlight = clear.to_sun.z * 0.4 / PI;
        for band in 0..4 {
            let radiance = 0.1;
            let seen = |light: &Illumination| radiance * light.transmittance[band] + light.haze[band];
            let expected = seen(&clear) * share[band] + airlight * (1.0 - share[band]);
            assert!((seen(&hazy) - expected).abs() < 1e-12);
            assert!(hazy.sun[band] < clear.sun[band] && hazy.sky[band] > clear.sky[band]);
        }
        assert!(hazy.haze.z - clear.haze.z > 1.2 * (hazy.haze.x - clear.haze.x));
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
}
