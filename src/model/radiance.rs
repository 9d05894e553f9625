//! Plain radiance: view-dependent colour per Gaussian under the light of the photographs (Kerbl et al. 2023). Nothing
//! is relit.
//!
//! Channels: red, green, blue, `max(0, ½ + Σ c_lm Y_lm(v))` with `v` from the camera to the centre. Per pixel
//!
//! ```text
//! C = Σ w_i c_i + (1 - Σ w_i) background
//! ```
//!
//! and, where the images come with their coverage, `Σ w_i` as a fourth band, so that it is learnt like a colour. The
//! degrees of the harmonics join one after another: until its turn, a degree is frozen.

use super::background::COLOURS;
use super::view_direction::{ViewDirection, rate_of_degree};
use super::{Background, Context, Parameters, SceneModel, Seen};
use crate::gaussians::{FEATURES, POSITION, Table};
use crate::optim::ParameterGroup;
use crate::shade::sh::{self, MAX_FUNCTIONS};
use glam::Vec3;
use rayon::prelude::*;

/// Learning rate of all coefficients. With a twentieth of it above degree 0, as Kerbl et al. (2023) have for 30,000
/// steps, held-out views of `nerf_mic` lose 2 dB (docs/lab/objects.md).
const RATE: f32 = 5e-3;

/// Options of the radiance model.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RadianceOptions {
    /// Largest degree of the spherical harmonics, 0 to 3.
    pub degree: usize,
    /// Colour behind everything.
    pub background: [f32; 3],
    /// True if images have coverage as a fourth band.
    pub coverage: bool,
}

impl Default for RadianceOptions {
    fn default() -> Self {
        Self {
            degree: 3,
            background: [1.0; 3],
            coverage: false,
        }
    }
}

/// The model of plain radiance.
#[derive(Debug, Clone)]
pub struct Radiance {
    /// Options of the model.
    pub options: RadianceOptions,
}

impl Radiance {
    /// A model of these options; degrees above 3 are 3.
    pub fn new(options: RadianceOptions) -> Self {
        let degree = options.degree.min(sh::MAX_DEGREE);
        Self {
            options: RadianceOptions { degree, ..options },
        }
    }

    /// Coefficients of Gaussian `g`, `[function][colour]`; zero beyond the model's degree.
    fn coefficients(&self, gaussians: &Table, g: usize) -> [[f32; COLOURS]; MAX_FUNCTIONS] {
        let mut all = [[0.0; COLOURS]; MAX_FUNCTIONS];
        for degree in 0..=self.options.degree {
            let count = 2 * degree + 1;
            let values = &gaussians.group(FEATURES + degree)[g * count * COLOURS..(g + 1) * count * COLOURS];
            for (slot, value) in all[degree * degree..].iter_mut().zip(values.chunks(COLOURS)) {
                slot.copy_from_slice(value);
            }
        }
        all
    }

    /// Sets the colour of Gaussian `g` (red, green, blue), equal in all viewing directions.
    pub fn paint(gaussians: &mut Table, g: usize, colour: [f32; 3]) {
        for (k, value) in colour.into_iter().enumerate() {
            gaussians.group_mut(FEATURES)[g * COLOURS + k] = (value - 0.5) / sh::C0;
        }
    }
}

impl SceneModel for Radiance {
    fn name(&self) -> &'static str {
        "radiance"
    }

    fn feature_parameters(&self) -> Vec<ParameterGroup> {
        (0..=self.options.degree)
            .map(|degree| {
                let width = (2 * degree + 1) * COLOURS;
                ParameterGroup::new(&format!("sh_{degree}"), width, rate_of_degree(RATE, degree))
            })
            .collect()
    }

    fn global_parameters(&self) -> Vec<ParameterGroup> {
        Vec::new()
    }

    fn channels(&self) -> usize {
        COLOURS
    }

    fn needs_transmittance(&self) -> bool {
        false
    }

    fn features(&self, context: &Context, seen: &Seen, out: &mut [f32]) {
        let (gaussians, eye) = (&context.parameters.gaussians, context.camera.eye());
        let functions = sh::functions(self.options.degree);
        out.par_chunks_mut(seen.stride)
            .with_min_len(1024)
            .enumerate()
            .for_each(|(s, feature)| {
                let g = seen.projected.gaussian[s] as usize;
                let view = ViewDirection::new(eye, context.camera, gaussians.position(g));
                let (basis, coefficients) = (sh::basis(view.direction), self.coefficients(gaussians, g));
                for k in 0..COLOURS {
                    let sum: f32 = (0..functions).map(|f| basis[f] * coefficients[f][k]).sum();
                    feature[k] = (0.5 + sum).max(0.0);
                }
            });
    }

    fn features_backward(
        &self,
        context: &Context,
        seen: &Seen,
        d_features: &[f32],
        grads: &mut Parameters,
        _d_transmittance: &mut [f32],
    ) {
        let (gaussians, eye) = (&context.parameters.gaussians, context.camera.eye());
        let functions = sh::functions(self.options.degree);
        // Per splat: gradient to the unclamped colours, the functions, gradient to the position.
        let parts: Vec<([f32; COLOURS], [f32; MAX_FUNCTIONS], Vec3)> = d_features
            .par_chunks(seen.stride)
            .with_min_len(1024)
            .enumerate()
            .map(|(s, d)| {
                let g = seen.projected.gaussian[s] as usize;
                let view = ViewDirection::new(eye, context.camera, gaussians.position(g));
                let (basis, coefficients) = (sh::basis(view.direction), self.coefficients(gaussians, g));
                let d_colour: [f32; COLOURS] = std::array::from_fn(|k| {
                    let sum: f32 = (0..functions).map(|f| basis[f] * coefficients[f][k]).sum();
                    // Below black only gradients that brighten pass: a clamped colour must be able to recover.
                    if 0.5 + sum > 0.0 { d[k] } else { d[k].min(0.0) }
                });
                let mut d_direction = Vec3::ZERO;
                for (f, gradient) in sh::basis_gradients(view.direction)
                    .iter()
                    .enumerate()
                    .take(functions)
                    .skip(1)
                {
                    let weight: f32 = (0..COLOURS).map(|k| d_colour[k] * coefficients[f][k]).sum();
                    d_direction += *gradient * weight;
                }
                let along = view.direction.dot(d_direction);
                (
                    d_colour,
                    basis,
                    (d_direction - view.direction * along) * view.inverse_distance,
                )
            })
            .collect();
        let indices = &seen.projected.gaussian;
        grads.gaussians.add_to_group(POSITION, indices, |s, slots| {
            slots
                .iter_mut()
                .zip(parts[s].2.to_array())
                .for_each(|(slot, d)| *slot += d);
        });
        for degree in 0..=self.options.degree {
            grads.gaussians.add_to_group(FEATURES + degree, indices, |s, slots| {
                let (d_colour, basis, _) = &parts[s];
                for (slots, y) in slots.chunks_mut(COLOURS).zip(&basis[degree * degree..]) {
                    slots.iter_mut().zip(d_colour).for_each(|(slot, d)| *slot += y * d);
                }
            });
        }
    }

    fn background(&self) -> Background {
        (self.options.background, self.options.coverage)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degrees_join_one_after_another() {
        let model = Radiance::new(RadianceOptions::default());
        let learning = |progress: f32| -> Vec<bool> {
            let groups = model.feature_parameters();
            groups.iter().map(|group| group.rate.at(progress) > 0.0).collect()
        };
        assert_eq!(learning(0.0), [true, false, false, false]);
        assert_eq!(learning(0.25), [true, true, true, false]);
        assert_eq!(learning(1.0), [true; 4]);
    }
}
