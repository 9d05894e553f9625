//! Conversion of composited channels to pixels: the light that reaches a surface, its colour in the image, and the
//! gradients of both.

use super::{CHUNK, ShadowGs};
use crate::model::Context;
use crate::raster::Raster;
use crate::splat::Maps;

/// The light of one view, with the colour transform that turns it into pixels.
pub(super) struct Lighting<'a> {
    maps: &'a Maps,
    bands: usize,
    near: Option<usize>,
    sky: Vec<f32>,
    matrix: Vec<f32>,
    offset: Vec<f32>,
}

/// Gradients of a loss to the parameters of one image, summed over pixels.
pub(super) struct SharedGradients {
    /// Gradient to the sky, per band.
    pub(super) sky: Vec<f64>,
    /// Gradient to the colour matrix, row by row.
    pub(super) matrix: Vec<f64>,
    /// Gradient to the colour offset, per band.
    pub(super) offset: Vec<f64>,
}

impl SharedGradients {
    /// Zero gradients for `bands` bands.
    pub(super) fn new(bands: usize) -> Self {
        Self {
            sky: vec![0.0; bands],
            matrix: vec![0.0; bands * bands],
            offset: vec![0.0; bands],
        }
    }

    /// Adds the gradients of other pixels.
    pub(super) fn add(&mut self, other: &Self) {
        let sum = |a: &mut [f64], b: &[f64]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        sum(&mut self.sky, &other.sky);
        sum(&mut self.matrix, &other.matrix);
        sum(&mut self.offset, &other.offset);
    }
}

/// Gradients of a chunk of pixels: `values[slot * count + pixel]` belongs to `channels[slot]`.
pub(super) struct ChunkGradients {
    /// Channels that get gradients.
    pub(super) channels: Vec<usize>,
    /// Number of pixels.
    pub(super) count: usize,
    /// Gradients to the channels, `[slot][pixel]`.
    pub(super) values: Vec<f32>,
    /// Gradients to the parameters of the image.
    pub(super) shared: SharedGradients,
}

impl<'a> Lighting<'a> {
    /// The light of the view of `context`, to be applied to `maps`.
    pub(super) fn new(model: &ShadowGs, context: &Context, maps: &'a Maps) -> Self {
        let image = model.image(context);
        let (matrix, offset) = model.colour(context.parameters, image);
        Self {
            maps,
            bands: model.options.bands,
            near: model.near_channel(),
            sky: model.sky(context.parameters, image),
            matrix,
            offset,
        }
    }

    /// The light in shadow: skylight and light reflected by the neighbourhood.
    #[inline]
    fn shade(&self, band: usize, pixel: usize) -> f32 {
        self.sky[band] + self.near.map_or(0.0, |at| self.maps.channels[at + band][pixel])
    }

    /// Colours of the pixels of chunk number `chunk`, band by band.
    pub(super) fn chunk(&self, chunk: usize) -> Vec<f32> {
        let (maps, bands) = (self.maps, self.bands);
        let range = chunk * CHUNK..((chunk + 1) * CHUNK).min(maps.alpha.len());
        let mut values = vec![0.0; range.len() * bands];
        let mut colour = vec![0.0; bands];
        for (j, i) in range.clone().enumerate() {
            let sun = maps.channels[bands][i];
            for (k, c) in colour.iter_mut().enumerate() {
                let shade = self.shade(k, i);
                *c = maps.channels[k][i] * (shade + (1.0 - shade) * sun);
            }
            for row in 0..bands {
                let mixed: f32 = (0..bands).map(|k| self.matrix[row * bands + k] * colour[k]).sum();
                values[row * range.len() + j] = mixed + self.offset[row];
            }
        }
        values
    }

    /// Gradients of the pixels of chunk number `chunk`, from the gradient of the image.
    pub(super) fn chunk_backward(&self, chunk: usize, d_image: &Raster) -> ChunkGradients {
        let (maps, bands) = (self.maps, self.bands);
        let pixels = maps.alpha.len();
        let range = chunk * CHUNK..((chunk + 1) * CHUNK).min(pixels);
        let count = range.len();
        let mut channels: Vec<usize> = (0..=bands).collect();
        let near_slot = channels.len();
        channels.extend(self.near.iter().flat_map(|&at| at..at + bands));
        let mut values = vec![0.0; channels.len() * count];
        let mut shared = SharedGradients::new(bands);
        for (j, i) in range.enumerate() {
            let sun = maps.channels[bands][i];
            let mut d_sun = 0.0;
            for k in 0..bands {
                let (albedo, shade) = (maps.channels[k][i], self.shade(k, i));
                let light = shade + (1.0 - shade) * sun;
                let mut d_colour = 0.0;
                for row in 0..bands {
                    let d = d_image.values[row * pixels + i];
                    d_colour += self.matrix[row * bands + k] * d;
                    shared.matrix[row * bands + k] += f64::from(d * albedo * light);
                }
                shared.offset[k] += f64::from(d_image.values[k * pixels + i]);
                values[k * count + j] = d_colour * light;
                let d_light = d_colour * albedo;
                d_sun += d_light * (1.0 - shade);
                let d_shade = d_light * (1.0 - sun);
                shared.sky[k] += f64::from(d_shade);
                if self.near.is_some() {
                    values[(near_slot + k) * count + j] = d_shade;
                }
            }
            values[bands * count + j] = d_sun;
        }
        ChunkGradients {
            channels,
            count,
            values,
            shared,
        }
    }
}
