//! Initial colours: per-image gain and offset, the path radiance of the reference image, and the albedo of each
//! Gaussian, from the pixels of the start surface in the sun and in the shade.

use super::linear::ALBEDO_RANGE;
use super::path_radiance::{self, Pair};

use heliosplat::gaussians::{OPACITY, Table, logit};
use heliosplat::light::Light;
use heliosplat::model::Parameters;
use heliosplat::model::shadow_gs::{ALBEDO, COLOUR, OFFSET, ShadowGs};
use heliosplat::model::{SceneModel, View};
use heliosplat::render::{PassOptions, render};
use heliosplat::splat::Maps;
use heliosplat::trace::{Occluders, transmittance};
use heliosplat_grid::statistics::{upper_median, upper_quantile};
use rayon::prelude::*;

/// Depth behind the visible surface within which a Gaussian still counts as visible, metres.
const VISIBLE_M: f32 = 1.0;
/// Transmittance above which a Gaussian counts as lit.
const LIT: f32 = 0.7;
/// Transmittance below which it counts as shaded.
const SHADED: f32 = 0.1;
/// Alpha below which a pixel is not covered by the start surface.
const COVERED: f32 = 0.9;
/// Opacity at which coverage is measured.
const SOLID: f32 = 0.99;
/// Most brightness of a place in shadow relative to sunlit; brighter places were not in the shadow.
const SHADE_MAX: f32 = 0.6;
/// Share of the pairs of an image that its shade is estimated from: the narrowest range with so many.
const SHADE_SHARE: f64 = 0.3;
/// Fewest pairs for the shade of an image.
const FEWEST_SHADED: usize = 50;
/// Pixels next to uncovered ones that do not count either.
const EDGE_PX: usize = 3;

/// A view's sample of a Gaussian: its pixel, where it is visible, and its light. At the edge of a shadow it is neither
/// lit nor shaded.
struct GaussianSample {
    pixel: Option<u32>,
    lit: bool,
    shaded: bool,
}

fn samples(
    gaussians: &Table,
    occluders: &Occluders,
    view: &View,
    maps: &Maps,
    present: Option<&[bool]>,
) -> Vec<GaussianSample> {
    let all: Vec<u32> = (0..gaussians.count as u32).collect();
    let lit: Vec<f32> = match &view.light {
        Some(light @ Light::Directional(_)) => transmittance(occluders, &all, light).values,
        _ => vec![1.0; all.len()],
    };
    all.par_iter()
        .with_min_len(1024)
        .map(|&g| {
            let position = gaussians.position(g as usize);
            let (col, row, _) = view.camera.project(position);
            let (c, r) = (col.round(), row.round());
            let inside = c >= 0.0 && r >= 0.0 && c < maps.width as f32 && r < maps.height as f32;
            let pixel = if inside {
                Some((r as usize * maps.width + c as usize) as u32)
            } else {
                None
            };
            let here = present.is_none_or(|present| present[g as usize]);
            let visible = pixel.filter(|_| here).filter(|&p| {
                let depth = maps.median_depth[p as usize];
                view.weight[p as usize] > 0.0 && view.camera.depth(position) < depth + VISIBLE_M
            });
            GaussianSample {
                pixel: visible,
                lit: lit[g as usize] > LIT,
                shaded: lit[g as usize] < SHADED,
            }
        })
        .collect()
}

/// 20th and 80th percentile; `None` for too few values.
fn spread(values: &mut [f32]) -> Option<(f32, f32)> {
    if values.len() < 50 {
        return None;
    }
    Some((upper_quantile(values, 0.2)?, upper_quantile(values, 0.8)?))
}

/// The colour of an image by Gaussians that it and the reference image see lit.
fn colour(reference: &[GaussianSample], truth: &[f32], own: &[GaussianSample], values: &[f32]) -> Colour {
    let both: Vec<(f32, f32)> = reference
        .iter()
        .zip(own)
        .filter(|(a, b)| a.lit && b.lit)
        .filter_map(|(a, b)| Some((truth[a.pixel? as usize], values[b.pixel? as usize])))
        .collect();
    let mut from: Vec<f32> = both.iter().map(|p| p.0).collect();
    let mut to: Vec<f32> = both.iter().map(|p| p.1).collect();
    match (spread(&mut from), spread(&mut to)) {
        (Some((a, b)), Some((c, d))) if b - a > 1e-3 => {
            let gain = ((d - c) / (b - a)).clamp(0.2, 5.0);
            Colour {
                gain,
                offset: 0.5 * (c + d) - gain * 0.5 * (a + b),
            }
        }
        _ => Colour { gain: 1.0, offset: 0.0 },
    }
}

/// Sets the weight of all pixels to zero that the start surface does not cover, or within a few pixels of its edge.
fn cover(view: &mut View, maps: &Maps) {
    let (width, height) = (maps.width, maps.height);
    let covered: Vec<bool> = maps.alpha.iter().map(|&a| a > COVERED).collect();
    let rows = view.weight.par_chunks_mut(width).enumerate();
    rows.for_each(|(row, weights)| {
        let rows = row.saturating_sub(EDGE_PX)..(row + EDGE_PX + 1).min(height);
        for (col, weight) in weights.iter_mut().enumerate() {
            let columns = col.saturating_sub(EDGE_PX)..(col + EDGE_PX + 1).min(width);
            let whole = |r: usize| covered[r * width..][columns.clone()].iter().all(|&c| c);
            if !rows.clone().all(whole) {
                *weight = 0.0;
            }
        }
    });
}

/// Brightness in shadow relative to the same ground in the sun, 0 to 1, `[view][band]`; `None` where the view has too
/// few pairs.
pub type Shades = Vec<Vec<Option<f64>>>;

/// Sets albedo and per-image colour of `parameters` from `views`, and restricts the views' weights to the surface.
/// `sky` is the sky's share of the light on level ground, 0 to 1. Returns the shades.
pub fn initialise(model: &ShadowGs, parameters: &mut Parameters, views: &mut [View], sky: f32) -> Shades {
    let bands = model.options.bands;
    let mut occluders = Occluders::new(&parameters.gaussians);
    let mut shown = Vec::new();
    // Everything that training may make opaque counts as covered.
    let mut solid = parameters.clone();
    solid.gaussians.group_mut(OPACITY).fill(logit(SOLID));
    for view in views.iter_mut() {
        let appearance = Some(view.appearance);
        cover(
            view,
            &render(model, &solid, &view.camera, None, appearance, PassOptions::default()).maps,
        );
        let maps = render(
            model,
            parameters,
            &view.camera,
            None,
            appearance,
            PassOptions::default(),
        )
        .maps;
        let present = model.present(parameters, appearance);
        if let Some(present) = &present {
            occluders.renew(&parameters.gaussians);
            occluders.hide(present);
        }
        let of_view = samples(&parameters.gaussians, &occluders, view, &maps, present.as_deref());
        shown.push(of_view);
    }
    let mut shown = Shown {
        colours: colours(model, &shown, views),
        samples: shown,
        views,
        lit: Vec::new(),
    };
    shown.lit = (0..bands).map(|k| shown.lit(k)).collect();
    let path_radiance: Vec<f32> = match model.options.image_colour {
        true => (0..bands).into_par_iter().map(|k| shown.path_radiance(k)).collect(),
        false => vec![0.0; bands],
    };
    tracing::debug!("path radiance of the reference image, per band: {path_radiance:.3?}");
    if model.options.image_colour {
        for (view, colours) in shown.views.iter().zip(&shown.colours) {
            for (k, colour) in colours.iter().enumerate() {
                let at = view.appearance;
                parameters.globals.group_mut(COLOUR)[at * bands * bands + k * bands + k] = colour.gain;
                parameters.globals.group_mut(OFFSET)[at * bands + k] = colour.offset + colour.gain * path_radiance[k];
            }
        }
    }
    let albedo: Vec<f32> = (0..parameters.gaussians.count)
        .into_par_iter()
        .with_min_len(1024)
        .flat_map_iter(|g| {
            let (shown, path_radiance) = (&shown, &path_radiance);
            (0..bands).map(move |k| {
                let mut seen: Vec<f32> = (0..shown.views.len())
                    .filter_map(|v| {
                        let light = sky + (1.0 - sky) * f32::from(u8::from(shown.samples[v][g].lit));
                        Some((shown.value(v, g, k)? - path_radiance[k]) / light)
                    })
                    .collect();
                upper_median(&mut seen)
                    .unwrap_or(0.3)
                    .clamp(ALBEDO_RANGE.0, ALBEDO_RANGE.1)
            })
        })
        .collect();
    parameters.gaussians.group_mut(ALBEDO).copy_from_slice(&albedo);
    let shades = |v: usize| (0..bands).map(|k| shown.shade(v, k, path_radiance[k])).collect();
    (0..shown.views.len()).into_par_iter().map(shades).collect()
}

/// The middle of the narrowest range that holds [`SHADE_SHARE`] of the values; `None` for too few.
fn densest(mut values: Vec<f32>) -> Option<f64> {
    if values.len() < FEWEST_SHADED {
        return None;
    }
    values.sort_by(f32::total_cmp);
    let held = (values.len() as f64 * SHADE_SHARE) as usize;
    let width = |window: &[f32]| window[held - 1] - window[0];
    let narrowest = values.windows(held).min_by(|a, b| width(a).total_cmp(&width(b)))?;
    Some(f64::from(0.5 * (narrowest[0] + narrowest[held - 1])))
}

/// Map from the reference image's values to those of an image.
#[derive(Clone, Copy)]
struct Colour {
    gain: f32,
    offset: f32,
}

/// The colours of each view and band.
fn colours(model: &ShadowGs, shown: &[Vec<GaussianSample>], views: &[View]) -> Vec<Vec<Colour>> {
    let reference = views
        .iter()
        .position(|v| v.appearance == model.options.reference)
        .unwrap_or(0);
    let of_band = |v: usize, k: usize| {
        if v == reference || !model.options.image_colour {
            return Colour { gain: 1.0, offset: 0.0 };
        }
        let (truth, values) = (views[reference].image.plane(k), views[v].image.plane(k));
        colour(&shown[reference], truth, &shown[v], values)
    };
    (0..views.len())
        .into_par_iter()
        .map(|v| (0..model.options.bands).map(|k| of_band(v, k)).collect())
        .collect()
}

/// Samples of the Gaussians in all views.
struct Shown<'a> {
    views: &'a [View],
    samples: Vec<Vec<GaussianSample>>,
    colours: Vec<Vec<Colour>>,
    /// Medians of two halves of the views that show a Gaussian in the sun, by band and Gaussian.
    lit: Vec<Vec<Option<[f32; 2]>>>,
}

impl Shown<'_> {
    /// Value of Gaussian `g` in view `v` and band `k`, in the counts of the reference image.
    fn value(&self, v: usize, g: usize, k: usize) -> Option<f32> {
        let value = self.views[v].image.plane(k)[self.samples[v][g].pixel? as usize];
        let Colour { gain, offset } = self.colours[v][k];
        value.is_finite().then(|| (value - offset) / gain)
    }

    /// The path radiance of the reference image in band `k`.
    fn path_radiance(&self, k: usize) -> f32 {
        let pairs = |v: usize| {
            let gaussians = (0..self.samples[v].len()).into_par_iter().with_min_len(1024);
            gaussians.filter_map(|g| self.pair(v, g, k)).collect()
        };
        path_radiance::of_band((0..self.views.len()).map(pairs).collect())
    }

    /// Brightness of shaded ground in view `v` and band `k` relative to the same ground in the sun. Where the surface
    /// is wrong, lit ground counts as shaded; so this is the middle of the narrowest range with many pairs, not their
    /// median.
    fn shade(&self, v: usize, k: usize, path_radiance: f32) -> Option<f64> {
        let gaussians = (0..self.samples[v].len()).into_par_iter().with_min_len(1024);
        let ratio = |g: usize| {
            let Pair { lit, shaded } = self.pair(v, g, k)?;
            let lit = 0.5 * (lit[0] + lit[1]) - path_radiance;
            let ratio = (shaded - path_radiance) / lit;
            (lit > 0.0 && (0.0..SHADE_MAX).contains(&ratio)).then_some(ratio)
        };
        densest(gaussians.filter_map(ratio).collect())
    }

    /// Gaussian `g` in the shade of view `v` and in the sun of others.
    fn pair(&self, v: usize, g: usize, k: usize) -> Option<Pair> {
        if !self.samples[v][g].shaded {
            return None;
        }
        let shaded = self.value(v, g, k)?;
        let lit = self.lit[k][g]?;
        Some(Pair { lit, shaded })
    }

    /// Sunlit value of each Gaussian in band `k`; `None` where fewer than two views show it lit.
    fn lit(&self, k: usize) -> Vec<Option<[f32; 2]>> {
        let count = self.samples.first().map_or(0, Vec::len);
        let medians = |g: usize| {
            let mut lit = [Vec::new(), Vec::new()];
            // The larger half alternates.
            let mut half = g % 2;
            for view in (0..self.views.len()).filter(|&view| self.samples[view][g].lit) {
                if let Some(value) = self.value(view, g, k) {
                    lit[half].push(value);
                    half = 1 - half;
                }
            }
            let [a, b] = &mut lit;
            Some([upper_median(a)?, upper_median(b)?])
        };
        (0..count).into_par_iter().with_min_len(1024).map(medians).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shade_is_where_most_pairs_are_and_errors_of_the_surface_do_not_move_it() {
        let shaded = (0..400).map(|i| 0.12 + 0.04 * (i as f32 / 400.0));
        let wrong = (0..600).map(|i| 0.2 + 0.4 * (i as f32 / 600.0));
        let found = densest(shaded.chain(wrong).collect()).expect("a shade");
        assert!((0.12..0.16).contains(&found), "{found}");
        assert_eq!(densest(vec![0.1; FEWEST_SHADED - 1]), None);
        assert!(densest(vec![0.1; FEWEST_SHADED]).is_some());
    }
}
