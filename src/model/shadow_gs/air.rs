//! Path radiance and skylight of a model trained on images of one light, which the images do not determine.

use super::harmonics::albedo_harmonics;
use super::{ALBEDO, COLOUR, NEAR, OFFSET, PATH_RADIANCE, SKY, ShadowGs, softplus_inverse};
use crate::model::Parameters;
use rayon::prelude::*;

/// Least sky and least light: the inverse softplus of the sky and ratios of light stay finite.
const LEAST_SKY: f32 = 1e-3;

/// Path radiance and sky of the reference image, in the units of that image.
#[derive(Debug, Clone, PartialEq)]
pub struct Air {
    /// Path radiance of each band: the light that the air adds to every pixel.
    pub path_radiance: Vec<f32>,
    /// The sky's share of the light on level ground, each band.
    pub sky: Vec<f32>,
}

impl ShadowGs {
    /// Path radiance and sky of the reference image.
    pub fn air(&self, parameters: &Parameters) -> Air {
        let reference = self.options.reference;
        Air {
            path_radiance: self.colour(parameters, reference).1,
            sky: self.sky(parameters, reference),
        }
    }

    /// Sets `air` for the reference image, and changes every Gaussian's albedo so that its appearance there stays.
    /// `visibility` (0 to 1) is the share of the sun's light that reaches each Gaussian:
    ///
    /// ```text
    /// p + F (L_sky + (1 - L_sky) S) = p' + F' (L_sky' + (1 - L_sky') S)
    /// ```
    ///
    /// The other images follow: their skies keep their ratio to that of the reference image, and their colours absorb
    /// the difference of the path radiance. Near-surface light stays. Images do not change where all of them have the
    /// same `S` and each pixel shows one Gaussian.
    pub fn set_air(&self, parameters: &mut Parameters, visibility: &[f32], air: &Air) {
        let bands = self.options.bands;
        let before = self.air(parameters);
        let sky: Vec<f32> = air.sky.iter().map(|&sky| sky.max(LEAST_SKY)).collect();
        let added: Vec<f32> = air
            .path_radiance
            .iter()
            .zip(&before.path_radiance)
            .map(|(now, before)| now - before)
            .collect();
        let near = self
            .options
            .near_light
            .then(|| parameters.gaussians.group(NEAR).to_vec());
        // The light on Gaussian `g` in band `k`, before and after the change.
        let lights = |g: usize, k: usize| {
            let near = near.as_ref().map_or(0.0, |near| near[g * bands + k]);
            [before.sky[k], sky[k]].map(|sky| {
                let shade = sky + near;
                (shade + (1.0 - shade) * visibility[g]).max(LEAST_SKY)
            })
        };
        let albedo = parameters.gaussians.group_mut(ALBEDO).par_chunks_mut(bands);
        albedo.enumerate().for_each(|(g, albedo)| {
            for (k, albedo) in albedo.iter_mut().enumerate() {
                let [before, now] = lights(g, k);
                *albedo = (*albedo * before - added[k]) / now;
            }
        });
        for group in albedo_harmonics(&self.options) {
            let width = parameters.gaussians.groups[group].spec.width;
            let coefficients = parameters.gaussians.group_mut(group).par_chunks_mut(width);
            coefficients.enumerate().for_each(|(g, coefficients)| {
                for (i, coefficient) in coefficients.iter_mut().enumerate() {
                    let [before, now] = lights(g, i % bands);
                    *coefficient *= before / now;
                }
            });
        }
        for image in 0..self.options.images {
            let of_image = self.sky(parameters, image);
            for k in 0..bands {
                let ratio = of_image[k] / before.sky[k].max(LEAST_SKY);
                parameters.globals.group_mut(SKY)[image * bands + k] =
                    softplus_inverse((sky[k] * ratio).max(LEAST_SKY));
            }
        }
        if !self.options.image_colour {
            let kept = parameters.globals.group_mut(PATH_RADIANCE).iter_mut();
            kept.zip(&added).for_each(|(kept, added)| *kept += added);
            return;
        }
        let matrices = parameters.globals.group(COLOUR).to_vec();
        let offsets = parameters.globals.group_mut(OFFSET).iter_mut();
        for (offset, row) in offsets.zip(matrices.chunks(bands)) {
            *offset += row.iter().zip(&added).map(|(a, added)| a * added).sum::<f32>();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::ProjectiveCamera;
    use crate::gaussians::{LOG_SCALE, OPACITY, ROTATION, Table, core_groups};
    use crate::light::Light;
    use crate::model::SceneModel;
    use crate::model::shadow_gs::ShadowGsOptions;
    use crate::raster::Raster;
    use crate::render::{PassOptions, render};

    /// A floor partly under a roof, in two images with colours of their own.
    fn scene(options: ShadowGsOptions) -> (ShadowGs, Parameters) {
        let model = ShadowGs::new(options);
        let mut groups = core_groups();
        groups.extend(model.feature_groups());
        let side = 24;
        let floor = side * side;
        let mut gaussians = Table::zeros(groups, floor + 36);
        for g in 0..gaussians.count {
            let place = match g < floor {
                true => [(g % side) as f32 * 0.5 - 6.0, (g / side) as f32 * 0.5 - 6.0, 0.0],
                false => [((g - floor) % 6) as f32 * 0.5, ((g - floor) / 6) as f32 * 0.5, 5.0],
            };
            gaussians.group_mut(0)[3 * g..3 * g + 3].copy_from_slice(&place);
            gaussians.group_mut(LOG_SCALE)[3 * g..3 * g + 3].copy_from_slice(&[-1.0, -1.0, -4.0]);
            gaussians.group_mut(ROTATION)[4 * g + 3] = 1.0;
        }
        gaussians.group_mut(OPACITY).fill(6.0);
        for group in ALBEDO..gaussians.groups.len() {
            let values = gaussians.group_mut(group).iter_mut().enumerate();
            values.for_each(|(i, value)| *value = 0.2 + 0.1 * ((i % 7) as f32 / 7.0));
        }
        let mut globals = model.initial_globals(0.3);
        globals
            .group_mut(SKY)
            .iter_mut()
            .enumerate()
            .for_each(|(i, sky)| *sky += 0.02 * i as f32);
        if model.options.image_colour {
            globals.group_mut(COLOUR)[9] = 0.8;
            globals.group_mut(OFFSET)[4] = 0.05;
        }
        (model, Parameters { gaussians, globals })
    }

    fn image(model: &ShadowGs, parameters: &Parameters, image: usize) -> Raster {
        let camera = ProjectiveCamera::nadir(-5.0, 5.0, 0.5, (20, 20));
        let sun = Some(Light::Directional(glam::Vec3::new(0.5, 0.0, 0.8).normalize()));
        render(model, parameters, &camera, sun, Some(image), PassOptions::default()).image
    }

    #[test]
    fn images_of_one_light_look_the_same_through_another_air() {
        for (image_colour, near_light, degree) in [
            (true, false, 0),
            (false, false, 0),
            (true, true, 0),
            (true, false, 1),
            (false, true, 2),
        ] {
            let (model, mut parameters) = scene(ShadowGsOptions {
                images: 2,
                image_colour,
                near_light,
                degree,
                ..ShadowGsOptions::default()
            });
            let sun = Light::Directional(glam::Vec3::new(0.5, 0.0, 0.8).normalize());
            let occluders = crate::trace::Occluders::new(&parameters.gaussians);
            let all: Vec<u32> = (0..parameters.gaussians.count as u32).collect();
            let visibility = crate::trace::transmittance(&occluders, &all, &sun).values;
            assert!(visibility.iter().any(|&v| v < 0.1) && visibility.iter().any(|&v| v > 0.9));
            let before = [0, 1].map(|i| image(&model, &parameters, i));
            let air = Air {
                path_radiance: vec![0.05, 0.08, 0.11],
                sky: vec![0.15, 0.2, 0.25],
            };
            model.set_air(&mut parameters, &visibility, &air);
            let now = model.air(&parameters);
            for k in 0..3 {
                assert!((now.path_radiance[k] - air.path_radiance[k]).abs() < 1e-6);
                assert!((now.sky[k] - air.sky[k]).abs() < 1e-6);
            }
            // Pixels at the border of the shadow show Gaussians in the sun and others in the shade.
            for (i, before) in before.iter().enumerate() {
                let after = image(&model, &parameters, i);
                let mut differences: Vec<f32> = before
                    .values
                    .iter()
                    .zip(&after.values)
                    .map(|(a, b)| (a - b).abs())
                    .collect();
                differences.sort_by(f32::total_cmp);
                let (most, inside) = (
                    differences[differences.len() - 1],
                    differences[differences.len() * 8 / 10],
                );
                assert!(inside < 4e-3 && most < 0.08, "image {i}: {inside} {most}");
            }
        }
    }

    #[test]
    fn ground_in_the_shade_gets_the_albedo_of_the_same_ground_in_the_sun() {
        let (model, mut parameters) = scene(ShadowGsOptions {
            bands: 1,
            image_colour: false,
            ..ShadowGsOptions::default()
        });
        // Images of an albedo of 0.4 everywhere, explained with a sky of 0.3 and no path radiance.
        let air = Air {
            path_radiance: vec![0.06],
            sky: vec![0.1],
        };
        let count = parameters.gaussians.count;
        let visibility: Vec<f32> = (0..count).map(|g| (g % 3) as f32 / 2.0).collect();
        for (g, v) in visibility.iter().enumerate() {
            let shown = 0.06 + 0.4 * (0.1 + 0.9 * v);
            parameters.gaussians.group_mut(ALBEDO)[g] = shown / (0.3 + 0.7 * v);
        }
        model.set_air(&mut parameters, &visibility, &air);
        for albedo in parameters.gaussians.group(ALBEDO) {
            assert!((albedo - 0.4).abs() < 1e-5, "{albedo}");
        }
    }
}
