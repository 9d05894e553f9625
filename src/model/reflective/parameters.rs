//! Conversion of the stored parameters of a Gaussian to its surface, and of the gradients of surfaces to those of the
//! parameters.

use super::surface::{Coefficients, EMBEDDING_WIDTH, ReflectiveSurface, SurfaceGradient};
use super::{ALBEDO, EMBEDDING, ENVIRONMENT, FRAME, LIGHT, MATERIAL, Reflective, WIDTH_MIN};
use crate::gaussians::{POSITION, sigmoid};
use crate::model::background::COLOURS;
use crate::model::{Context, Parameters};
use crate::shade::sh;

impl Reflective {
    /// The surface of Gaussian `g`.
    pub(super) fn surface(&self, parameters: &Parameters, g: usize) -> ReflectiveSurface {
        let gaussians = &parameters.gaussians;
        let values = |group: usize, width: usize| &gaussians.group(group)[g * width..(g + 1) * width];
        let (material, frame) = (values(MATERIAL, 4), values(FRAME, 4));
        let width = |raw: f32| WIDTH_MIN + (1.0 - WIDTH_MIN) * sigmoid(raw);
        let mut light: Coefficients = Default::default();
        let shared = parameters.globals.group(ENVIRONMENT);
        for degree in 0..=self.options.degree {
            let own = values(LIGHT + degree, (2 * degree + 1) * COLOURS);
            for (n, slot) in light[degree * degree..(degree + 1) * (degree + 1)]
                .iter_mut()
                .enumerate()
            {
                for k in 0..COLOURS {
                    slot[k] = own[n * COLOURS + k] + shared[(degree * degree + n) * COLOURS + k];
                }
            }
        }
        ReflectiveSurface {
            position: gaussians.position(g),
            albedo: std::array::from_fn(|k| sigmoid(values(ALBEDO, COLOURS)[k])),
            metallic: sigmoid(material[0]),
            alpha: [width(material[1]), width(material[2])],
            gloss: if self.options.specular {
                sigmoid(material[3])
            } else {
                0.0
            },
            frame: [frame[0], frame[1], frame[2], frame[3]],
            light,
            embedding: std::array::from_fn(|k| values(EMBEDDING, EMBEDDING_WIDTH)[k]),
        }
    }

    /// Backward of [`Self::surface`] for the Gaussians `indices`: adds to the gradients of their parameters and of the
    /// environment.
    pub(super) fn add_gradients(
        &self,
        context: &Context,
        surfaces: &[ReflectiveSurface],
        parts: &[SurfaceGradient],
        indices: &[u32],
        grads: &mut Parameters,
    ) {
        let table = &mut grads.gaussians;
        let add = |slots: &mut [f32], values: &[f32]| slots.iter_mut().zip(values).for_each(|(s, v)| *s += v);
        // Slope of a sigmoid from its value.
        let slope = |p: f32| p * (1.0 - p);
        table.add_to_group(POSITION, indices, |s, slots| add(slots, &parts[s].position.to_array()));
        table.add_to_group(FRAME, indices, |s, slots| add(slots, &parts[s].frame));
        table.add_to_group(ALBEDO, indices, |s, slots| {
            let d: [f32; COLOURS] = std::array::from_fn(|k| parts[s].albedo[k] * slope(surfaces[s].albedo[k]));
            add(slots, &d);
        });
        table.add_to_group(MATERIAL, indices, |s, slots| {
            let (surface, d) = (&surfaces[s], &parts[s]);
            let width = |k: usize| {
                let share = (surface.alpha[k] - WIDTH_MIN) / (1.0 - WIDTH_MIN);
                d.alpha[k] * (1.0 - WIDTH_MIN) * slope(share)
            };
            let metallic = d.metallic * slope(surface.metallic);
            add(slots, &[metallic, width(0), width(1), d.gloss * slope(surface.gloss)]);
        });
        table.add_to_group(EMBEDDING, indices, |s, slots| add(slots, &parts[s].embedding));
        for degree in 0..=self.options.degree {
            table.add_to_group(LIGHT + degree, indices, |s, slots| {
                let values = &parts[s].light[degree * degree..];
                slots
                    .chunks_mut(COLOURS)
                    .zip(values)
                    .for_each(|(slots, d)| add(slots, d));
            });
        }
        let mut shared = [0.0f64; sh::MAX_FUNCTIONS * COLOURS];
        for part in parts {
            for (sum, d) in shared.iter_mut().zip(part.light.iter().flatten()) {
                *sum += f64::from(*d);
            }
        }
        let functions = sh::functions(self.options.degree);
        let slots = grads.globals.group_mut(ENVIRONMENT).iter_mut();
        slots
            .zip(shared)
            .take(functions * COLOURS)
            .for_each(|(slot, d)| *slot += d as f32);
        debug_assert_eq!(context.parameters.globals.groups.len(), grads.globals.groups.len());
    }
}
