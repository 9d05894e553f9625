//! Path radiance and skylight for images that all have one light.
//!
//! The same ground appears in the sun and in the shade where suns differ, which determines its albedo, the path
//! radiance and the sky. Under one light hardly any ground does, and a shadow may as well be dark ground: the initial
//! sky and path radiance stay, and their errors become albedo, which shows the old shadow under every other sun. But
//! ground continues across the border of a shadow. So the sky is that of clear air, and the path radiance that under
//! which level ground in shadows is as bright as the ground next to it:
//!
//! ```text
//! shaded = p + F L_shaded    sunlit = p + F L_sunlit    p = (shaded - r sunlit) / (1 - r)    r = L_shaded / L_sunlit
//! ```
//!
//! for each shaded place and the sunlit ground around it, with `L = s + (1 - s) S` of the sky `s` and the traced share
//! `S` of the sun. The choice of the sky has little effect on the mean brightness of shaded ground, because the path
//! radiance compensates it. The gain is in docs/lab/shadows.md.

use super::daylight::CLEAR;
use super::linear::ALBEDO_RANGE;
use heliosplat::gaussians::Table;
use heliosplat::light::Light;
use heliosplat::model::shadow_gs::{ALBEDO, Air, ShadowGs};
use heliosplat::model::{Parameters, SceneModel};
use heliosplat::render::{PassOptions, render};
use heliosplat::trace::{Occluders, transmittance};
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_grid::statistics::upper_quantile;
use heliosplat_scene::{ImageSun, crop};
use rayon::prelude::*;

/// Suns closer than this are one light, degrees of arc: the shadow of a house of 10 m moves by less than the ground
/// that is left out along its border.
const ONE_LIGHT_DEG: f64 = 10.0;
/// Fewest images whose surface has shadows in the right places. With two images of a real city the shadows of towers
/// became black (docs/lab/shadows.md).
const FEWEST_IMAGES: usize = 8;
/// Largest share of the sun on shaded ground, and least on sunlit ground. The actual share enters the equations.
const SHADED: f32 = 0.5;
const SUNLIT: f32 = 0.5;
/// Ground left out along the border of a shadow, metres.
const MARGIN_M: f64 = 1.0;
/// Largest distance between shaded ground and the sunlit ground it is compared with, metres.
const REACH_M: f64 = 6.0;
/// Steepest level ground, metres of altitude for each metre.
const LEVEL: f32 = 0.35;
/// Greatest difference of altitude between ground that is compared, metres.
const SAME_GROUND_M: f32 = 0.5;
/// Fewest sunlit places around a shaded one.
const FEWEST_SUNLIT: usize = 10;
/// Fewest shaded places for an estimate.
const FEWEST_PLACES: usize = 200;
/// Share of the places that is used: those whose path radiances are closest together. Where the surface is wrong,
/// shaded places are not shaded.
const COUNTED: f64 = 0.5;
/// Share of the pixels below the darkest value that is used.
const DARKEST: f64 = 0.005;
/// Most albedo of Gaussians in a shadow or at its border, as this quantile of those in the full sun.
const BRIGHTEST: f64 = 0.99;
/// Least share of the sun on Gaussians in the full sun.
const FULL_SUN: f32 = 0.9;

/// Common light of all images.
pub struct OneLight {
    /// The light of each image, in the order of their colours.
    lights: Vec<Light>,
    reference: usize,
    elevation_rad: f64,
}

impl OneLight {
    /// Common light of images with these `suns`; `reference` is the index of the reference image. `None` where an image
    /// has no sun, suns differ by more than `ONE_LIGHT_DEG`, or there are fewer than `FEWEST_IMAGES`.
    pub fn of(suns: &[ImageSun], reference: usize) -> Option<Self> {
        let directions: Option<Vec<_>> = suns.iter().map(crop::direction).collect();
        let directions = directions?;
        let is_one = directions.iter().enumerate().all(|(i, a)| {
            let others = directions[..i].iter();
            others
                .into_iter()
                .all(|b| f64::from(a.dot(*b)) > ONE_LIGHT_DEG.to_radians().cos())
        });
        let elevation_rad = suns.get(reference)?.position?.elevation_rad;
        (is_one && suns.len() >= FEWEST_IMAGES).then(|| Self {
            lights: directions.into_iter().map(Light::Directional).collect(),
            reference,
            elevation_rad,
        })
    }

    /// Sets the air of `model` in `parameters` from level ground in the view of `nadir`, a camera straight above with
    /// pixels of `gsd_m` metres, and limits the albedo of Gaussians outside the full sun. Nothing changes without
    /// enough shaded ground. `darkest` is an upper bound of the path radiance, per band; it is given before training,
    /// when many shadows are in wrong places.
    pub fn estimate_air(
        &self,
        model: &ShadowGs,
        parameters: &mut Parameters,
        nadir: &ProjectiveCamera,
        gsd_m: f64,
        darkest: Option<&[f32]>,
    ) {
        let (light, image) = (self.lights[self.reference], self.reference);
        let rendering = render(
            model,
            parameters,
            nadir,
            Some(light),
            Some(image),
            PassOptions::default(),
        );
        let ground = GroundMap {
            sunlit: model.sunlit(&rendering.maps),
            depth: rendering.maps.median_depth,
            image: rendering.image,
            gsd_m,
        };
        let places = ground.places();
        if places.len() < FEWEST_PLACES {
            tracing::warn!(
                "all images have one light, and {} shaded places are too few to separate shadows from dark ground: relit images will show the old shadows",
                places.len()
            );
            return;
        }
        let sky = CLEAR.shade(self.elevation_rad) as f32;
        let path_radiance: Vec<f32> = (0..model.options.bands)
            .map(|k| path_radiance(&places, k, sky).min(darkest.map_or(f32::INFINITY, |darkest| darkest[k])))
            .collect();
        tracing::debug!(
            "one light: path radiance of the reference image, per band: {path_radiance:.3?}, sky {sky:.3}, by {} places in shadows",
            places.len()
        );
        let air = Air {
            sky: vec![sky; path_radiance.len()],
            path_radiance,
        };
        let visibility = self.visibility(model, parameters);
        model.set_air(parameters, &visibility, &air);
        bound(&mut parameters.gaussians, &visibility, model.options.bands);
    }

    /// Share of the sun that reaches each Gaussian, in the mean of all images.
    fn visibility(&self, model: &ShadowGs, parameters: &Parameters) -> Vec<f32> {
        let all: Vec<u32> = (0..parameters.gaussians.count as u32).collect();
        let mut occluders = Occluders::new(&parameters.gaussians);
        let mut mean = vec![0.0; all.len()];
        for (image, light) in self.lights.iter().enumerate() {
            if let Some(present) = model.present(parameters, Some(image)) {
                occluders.renew(&parameters.gaussians);
                occluders.hide(&present);
            }
            let seen = transmittance(&occluders, &all, light).values;
            mean.iter_mut()
                .zip(seen)
                .for_each(|(mean, seen)| *mean += seen / self.lights.len() as f32);
        }
        mean
    }
}

/// Darkest values of the reference image, per band, at least 0: an upper bound of the path radiance (the dark-object
/// subtraction of Chavez 1988).
pub fn darkest(image: &Raster) -> Vec<f32> {
    let of_band = |k: usize| {
        let mut known: Vec<f32> = image.plane(k).iter().copied().filter(|v| v.is_finite()).collect();
        upper_quantile(&mut known, DARKEST).map_or(0.0, |value| value.max(0.0))
    };
    (0..image.bands).into_par_iter().map(of_band).collect()
}

/// Limits Gaussians outside the full sun to the brightest in it: brighter ones are errors of the shadow, and would
/// leave a white spot.
fn bound(gaussians: &mut Table, visibility: &[f32], bands: usize) {
    let albedo = gaussians.group(ALBEDO);
    let brightest: Vec<f32> = (0..bands)
        .into_par_iter()
        .map(|k| {
            let sunlit = albedo.iter().skip(k).step_by(bands).zip(visibility);
            let mut sunlit: Vec<f32> = sunlit
                .filter(|(_, v)| **v > FULL_SUN)
                .map(|(albedo, _)| *albedo)
                .collect();
            upper_quantile(&mut sunlit, BRIGHTEST).unwrap_or(ALBEDO_RANGE.1)
        })
        .collect();
    let albedo = gaussians.group_mut(ALBEDO).par_chunks_mut(bands);
    albedo.zip(visibility).for_each(|(albedo, visibility)| {
        for (albedo, brightest) in albedo.iter_mut().zip(&brightest) {
            let most = if *visibility < FULL_SUN {
                *brightest
            } else {
                ALBEDO_RANGE.1
            };
            *albedo = albedo.clamp(ALBEDO_RANGE.0, most.max(ALBEDO_RANGE.0));
        }
    });
}

/// The ground from straight above.
struct GroundMap {
    image: Raster,
    /// Share of the sun that reaches the ground, 0 to 1; NaN where there is no ground.
    sunlit: Vec<f32>,
    /// Metres below the camera.
    depth: Vec<f32>,
    gsd_m: f64,
}

/// Values of a shaded place and of the sunlit ground around it, band by band, and their shares of the sun.
struct ShadedPlace {
    shaded: Vec<f32>,
    sunlit: Vec<f32>,
    /// Share of the sun at the shaded place, and the mean over the sunlit ground.
    visibility: [f32; 2],
}

impl GroundMap {
    /// True if all pixels within `reach` of a pixel, corners included, satisfy `test`.
    fn all_around(&self, at: usize, reach: usize, test: impl Fn(usize) -> bool) -> bool {
        let (width, height) = (self.image.width, self.image.height);
        let (col, row) = (at % width, at / width);
        if col < reach || row < reach || col + reach >= width || row + reach >= height {
            return false;
        }
        (row - reach..=row + reach).all(|r| (col - reach..=col + reach).all(|c| test(r * width + c)))
    }

    /// Mask of level ground on which the light, also that of the pixels around, satisfies `lit`.
    fn level(&self, lit: impl Fn(f32) -> bool + Sync) -> Vec<bool> {
        let margin = (MARGIN_M / self.gsd_m).round().max(1.0) as usize;
        let step_m = LEVEL * 2.0 * self.gsd_m as f32;
        (0..self.sunlit.len())
            .into_par_iter()
            .map(|at| {
                let level = |other: usize| (self.depth[at] - self.depth[other]).abs() < step_m;
                self.all_around(at, margin, |other| lit(self.sunlit[other])) && self.all_around(at, 1, level)
            })
            .collect()
    }

    fn places(&self) -> Vec<ShadedPlace> {
        let (width, height, bands) = (self.image.width, self.image.height, self.image.bands);
        let shaded = self.level(|sunlit| sunlit < SHADED);
        let sunlit = self.level(|sunlit| sunlit > SUNLIT);
        let reach = (REACH_M / self.gsd_m).round().max(1.0) as usize;
        let place = |at: usize| {
            let (col, row) = (at % width, at / width);
            let (mut sum, mut visible, mut count) = (vec![0.0f64; bands], 0.0, 0);
            for r in row.saturating_sub(reach)..(row + reach + 1).min(height) {
                for c in col.saturating_sub(reach)..(col + reach + 1).min(width) {
                    let other = r * width + c;
                    let near = r.abs_diff(row).pow(2) + c.abs_diff(col).pow(2) <= reach * reach;
                    let same = (self.depth[at] - self.depth[other]).abs() < SAME_GROUND_M;
                    if near && same && sunlit[other] {
                        count += 1;
                        visible += f64::from(self.sunlit[other]);
                        let values = sum.iter_mut().enumerate();
                        values.for_each(|(k, sum)| *sum += f64::from(self.image.plane(k)[other]));
                    }
                }
            }
            (count >= FEWEST_SUNLIT).then(|| ShadedPlace {
                shaded: (0..bands).map(|k| self.image.plane(k)[at]).collect(),
                sunlit: sum.iter().map(|sum| (sum / f64::from(count as u32)) as f32).collect(),
                visibility: [self.sunlit[at], (visible / f64::from(count as u32)) as f32],
            })
        };
        let all = (0..shaded.len()).into_par_iter();
        all.filter(|&at| shaded[at]).filter_map(place).collect()
    }
}

/// The path radiance of a band under a sky of this share, not below zero: the mean of the half of all places that lie
/// closest together, or the median of all if that is less. Too little leaves shaded ground too bright; too much leaves
/// it without any albedo.
fn path_radiance(places: &[ShadedPlace], band: usize, sky: f32) -> f32 {
    let of_place = |place: &ShadedPlace| {
        let [shaded, sunlit] = place.visibility.map(|visibility| sky + (1.0 - sky) * visibility);
        let ratio = shaded / sunlit;
        (place.shaded[band] - ratio * place.sunlit[band]) / (1.0 - ratio)
    };
    let mut values: Vec<f32> = places.iter().map(of_place).filter(|value| value.is_finite()).collect();
    values.sort_by(f32::total_cmp);
    let counted = ((values.len() as f64 * COUNTED) as usize).max(1);
    let width = |window: &[f32]| window[counted - 1] - window[0];
    let closest = values
        .windows(counted)
        .min_by(|a, b| width(a).total_cmp(&width(b)))
        .unwrap_or_default();
    let sum: f64 = closest.iter().copied().map(f64::from).sum();
    let closest = (sum / closest.len().max(1) as f64) as f32;
    let middle = upper_quantile(&mut values, 0.5).unwrap_or(0.0);
    closest.min(middle).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat_rpc::sun::SunPosition;
    use heliosplat_scene::ImageSun;

    fn sun(azimuth_deg: f64, elevation_deg: f64) -> ImageSun {
        ImageSun::from_shadows(SunPosition::from_degrees(azimuth_deg, elevation_deg), 1.0)
    }

    #[test]
    fn suns_of_one_pass_are_one_light_and_those_of_two_seasons_are_not() {
        let pass = |last: ImageSun| {
            let mut suns = vec![sun(120.0, 40.0); FEWEST_IMAGES - 1];
            suns.push(last);
            suns
        };
        assert!(OneLight::of(&pass(sun(126.0, 43.0)), 0).is_some());
        assert!(OneLight::of(&pass(sun(150.0, 43.0)), 0).is_none());
        let unknown = ImageSun {
            position: None,
            ..sun(120.0, 40.0)
        };
        assert!(OneLight::of(&pass(unknown), 0).is_none());
        assert!(OneLight::of(&pass(sun(126.0, 43.0))[1..], 0).is_none());
        assert!(OneLight::of(&[], 0).is_none());
    }

    /// Level ground of two materials in bands of 8 m, its eastern half in the shade; `wrong` of the shaded pixels are
    /// in the sun.
    fn ground(path_radiance: f32, sky: f32, wrong: usize) -> GroundMap {
        let side = 80;
        let shaded = |at: usize| at % side >= side / 2;
        let albedo = |at: usize| if (at / side / 16).is_multiple_of(2) { 0.15 } else { 0.4 };
        let noise = |at: usize| ((at * 7919) % 1009) as f32 / 1009.0 * 0.02 - 0.01;
        let light = |at: usize| match shaded(at) && (at * 31) % 100 >= wrong {
            true => sky,
            false => 1.0,
        };
        let value = |at: usize| path_radiance + albedo(at) * light(at) + noise(at);
        GroundMap {
            image: Raster {
                width: side,
                height: side,
                bands: 1,
                values: (0..side * side).map(value).collect(),
            },
            sunlit: (0..side * side).map(|at| if shaded(at) { 0.0 } else { 1.0 }).collect(),
            depth: vec![-10.0; side * side],
            gsd_m: 0.5,
        }
    }

    #[test]
    fn ground_beside_shadows_tells_the_path_radiance_though_some_shadows_are_wrong() {
        for (truth, wrong) in [(0.0, 0), (0.08, 0), (0.2, 20)] {
            let places = ground(truth, 0.12, wrong).places();
            assert!(places.len() > FEWEST_PLACES, "{}", places.len());
            let found = path_radiance(&places, 0, 0.12);
            assert!((found - truth).abs() < 0.012, "{found} for {truth}");
        }
    }

    #[test]
    fn a_sky_that_is_wrong_is_made_up_for() {
        let (truth, sky, believed) = (0.08, 0.08, 0.14);
        let places = ground(truth, sky, 0).places();
        let found = path_radiance(&places, 0, believed);
        let albedo = |shown: f32, light: f32| (shown - found) / light;
        let shaded: f32 = places.iter().map(|place| albedo(place.shaded[0], believed)).sum();
        let sunlit: f32 = places.iter().map(|place| albedo(place.sunlit[0], 1.0)).sum();
        assert!((shaded / sunlit - 1.0).abs() < 0.1, "{}", shaded / sunlit);
    }

    #[test]
    fn no_pixel_is_darker_than_the_air_but_some_noise_may_be() {
        let mut image = ground(0.1, 0.1, 0).image;
        let at = image.values.len() - 1;
        image.values[at] = f32::NAN;
        let clean = darkest(&image)[0];
        assert!((clean - 0.11).abs() < 0.01, "{clean}");
        image.values[..20].fill(-1.0);
        assert!((darkest(&image)[0] - clean).abs() < 0.005);
    }

    #[test]
    fn steep_ground_and_ground_of_another_altitude_tell_nothing() {
        let mut steep = ground(0.1, 0.1, 0);
        let width = steep.image.width;
        steep
            .depth
            .iter_mut()
            .enumerate()
            .for_each(|(at, depth)| *depth = (at % width) as f32);
        assert!(steep.places().is_empty());
        let mut terrace = ground(0.1, 0.1, 0);
        let depth = terrace.depth.iter_mut().enumerate();
        depth
            .filter(|(at, _)| at % width >= width / 2)
            .for_each(|(_, depth)| *depth -= 3.0);
        assert!(terrace.places().is_empty());
    }
}
