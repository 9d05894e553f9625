//! Albedo and colours of images by least squares: with the surface and the light fixed, images are linear in either.
//! Both are solved before training, and the albedo once more after it.
//!
//! Colours: the affine map from the rendering without colours to the image, by normal equations with a ridge toward the
//! current colours. Albedo: one round of simultaneous iterative reconstruction (Gilbert 1972): a pixel's residual,
//! divided by the pixel's value for albedo one, is distributed over its Gaussians, and each takes the weighted mean of
//! its shares. Weights are those of the rasteriser under the traced light, so that each view contributes most where it
//! sees best.

use heliosplat::Raster;
use heliosplat::gaussians::Table;
use heliosplat::model::shadow_gs::{ALBEDO, COLOUR, OFFSET, ShadowGs};
use heliosplat::model::{Context, Parameters, SceneModel, View};
use heliosplat::render::{Lit, Pass, PassOptions};
use heliosplat::splat::Maps;
use heliosplat::trace::{OccluderGradients, Occluders};
use nalgebra::DMatrix;
use rayon::prelude::*;

/// Least and greatest albedo.
pub const ALBEDO_RANGE: (f32, f32) = (0.005, 3.0);
/// Largest residual that is used, in the images' units: larger ones are clipped, since they are errors of the surface
/// and not of its colour.
const RESIDUAL_MAX: f32 = 0.15;
/// Least value of a pixel for albedo one; darker pixels are left out.
const LEAST_RESPONSE: f32 = 0.05;
/// Weight of a Gaussian's earlier albedo, pixels in the sun.
const PRIOR_PIXELS: f32 = 0.3;
/// Weight of an image's earlier colours, share of its pixels.
const PRIOR_COLOUR: f64 = 1e-3;
/// Time of a view of the round after training, in steps of the training (0.8 to 1.2 were measured).
const FINISH_STEPS_PER_VIEW: f64 = 1.0;
/// Pixels per parallel job; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 1 << 14;

/// Time of a round, which determines the weighting of residuals.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Round {
    /// Before training, when the surface causes most residuals. A pixel is weighted by the light on it.
    Before,
    /// After training, when the albedo causes most residuals. A pixel is weighted by the square of the light, as in
    /// least squares.
    After,
}

impl Round {
    /// Factor on the mean of corrections; simultaneous reconstruction converges below 2 (Gregor and Benson 2008).
    fn relaxation(self) -> f32 {
        match self {
            Self::Before => 1.0,
            Self::After => 1.8,
        }
    }
}

/// Before training: improves the albedo of every Gaussian from all `views` together, and the colours of each image but
/// the reference.
pub fn begin(model: &ShadowGs, parameters: &mut Parameters, views: &[View]) {
    improve(model, parameters, views, Round::Before);
}

/// After training: improves the albedo of every Gaussian from all `views` together, because training leaves errors of
/// its level over a few metres (docs/lab/shadows.md). Colours do not change.
pub fn finish(model: &ShadowGs, parameters: &mut Parameters, views: &[View]) {
    improve(model, parameters, views, Round::After);
}

/// Time of [`finish`] with `views` views, in training steps.
pub fn finish_steps(views: usize) -> f64 {
    FINISH_STEPS_PER_VIEW * views as f64
}

fn improve(model: &ShadowGs, parameters: &mut Parameters, views: &[View], round: Round) {
    let colours = round == Round::Before && model.options.image_colour;
    let plain = colours.then(|| without_colours(model, parameters));
    let mut globals = parameters.globals.clone();
    // Required by the backward pass; the gradients are not used.
    let mut unused = Parameters {
        gaussians: Table::zeros(Vec::new(), 0),
        globals: parameters.globals.zeros_like(),
    };
    let mut occluders = Occluders::new(&parameters.gaussians);
    let zeros = || vec![0.0f32; parameters.gaussians.group(ALBEDO).len()];
    let (mut wanted, mut weights) = (zeros(), zeros());
    for view in views {
        if let Some(present) = model.present(parameters, Some(view.appearance)) {
            occluders.renew(&parameters.gaussians);
            occluders.hide(&present);
        }
        let context = Context {
            parameters,
            camera: &view.camera,
            light: view.light,
            appearance: Some(view.appearance),
        };
        let options = PassOptions {
            occluder_gradients: OccluderGradients::None,
            ..PassOptions::default()
        };
        let pass = Pass::new(model, context, Lit::Traced(&occluders), options);
        let plain = plain.as_ref().filter(|_| view.appearance != model.options.reference);
        if let Some(plain) = plain {
            let shown = Context {
                parameters: plain,
                ..context
            };
            let colour = Colour::of(model, parameters, view.appearance);
            let found = colour.fitted(&model.compose(&shown, &pass.maps), &pass.image(), view);
            found.unwrap_or(colour).write(&mut globals, view.appearance);
        }
        let (corrections, told) = corrections(model, &context, &pass, view, round);
        let bands = model.options.bands;
        let to_albedo = |image: &Raster| {
            let mut d_maps = pass.zero_gradients();
            model.compose_backward(&context, &pass.maps, image, &mut d_maps, &mut unused);
            d_maps.channels.truncate(bands);
            d_maps.channels
        };
        let planes: Vec<Vec<f32>> = [corrections, told].iter().flat_map(to_albedo).collect();
        let spread = pass.spread(&planes);
        let mut splats: Vec<Option<&[f32]>> = vec![None; parameters.gaussians.count];
        for (&gaussian, spread) in pass.projected.gaussian.iter().zip(spread.chunks_exact(2 * bands)) {
            splats[gaussian as usize] = Some(spread);
        }
        let sums = wanted.par_chunks_mut(bands).zip(weights.par_chunks_mut(bands));
        sums.zip(&splats)
            .with_min_len(1024)
            .for_each(|((wanted, weights), splat)| {
                let Some(splat) = splat else { return };
                let (corrections, told) = splat.split_at(bands);
                wanted
                    .iter_mut()
                    .zip(corrections)
                    .for_each(|(wanted, by)| *wanted += by);
                weights.iter_mut().zip(told).for_each(|(weight, by)| *weight += by);
            });
    }
    parameters.globals = globals;
    let sums = wanted.par_iter().zip(&weights);
    let albedo = parameters.gaussians.group_mut(ALBEDO).par_iter_mut();
    albedo.zip(sums).for_each(|(albedo, (wanted, weight))| {
        let correction = round.relaxation() * wanted / (weight + PRIOR_PIXELS);
        *albedo = (*albedo + correction).clamp(ALBEDO_RANGE.0, ALBEDO_RANGE.1);
    });
}

/// The parameters with every image in the model's own colours.
fn without_colours(model: &ShadowGs, parameters: &Parameters) -> Parameters {
    let mut plain = parameters.clone();
    if model.options.image_colour {
        let bands = model.options.bands;
        plain.globals.group_mut(OFFSET).fill(0.0);
        for (i, value) in plain.globals.group_mut(COLOUR).iter_mut().enumerate() {
            *value = f32::from(u8::from((i % (bands * bands)).is_multiple_of(bands + 1)));
        }
    }
    plain
}

/// The affine colours of an image: a row for each band of the model and one for the offset, a column for each band of
/// the image.
struct Colour(DMatrix<f64>);

impl Colour {
    fn of(model: &ShadowGs, parameters: &Parameters, image: usize) -> Self {
        let bands = model.options.bands;
        let (matrix, offset) = model.colour(parameters, image);
        let value = |row: usize, column: usize| match row < bands {
            true => matrix[column * bands + row],
            false => offset[column],
        };
        Self(DMatrix::from_fn(bands + 1, bands, |row, column| {
            f64::from(value(row, column))
        }))
    }

    fn write(&self, globals: &mut Table, image: usize) {
        let bands = self.0.ncols();
        for band in 0..bands {
            for of in 0..bands {
                globals.group_mut(COLOUR)[(image * bands + band) * bands + of] = self.0[(of, band)] as f32;
            }
            globals.group_mut(OFFSET)[image * bands + band] = self.0[(bands, band)] as f32;
        }
    }

    /// Colours that map `plain`, the rendering without colours, to the image of `view`, with a ridge toward the current
    /// ones, which give `image`; `None` where the equations have no solution.
    fn fitted(&self, plain: &Raster, image: &Raster, view: &View) -> Option<Self> {
        let truth = view.truth(image);
        let (bands, plane) = (image.bands, image.plane_len());
        let sums_of = |chunk: usize| {
            let mut normal = DMatrix::zeros(bands + 1, bands + 1);
            let mut right = DMatrix::zeros(bands + 1, bands);
            for pixel in chunk * CHUNK..((chunk + 1) * CHUNK).min(plane) {
                let residual = |band: usize| truth.values[band * plane + pixel] - image.values[band * plane + pixel];
                // Written so that NaN is refused.
                let counts = view.weight[pixel] > 0.0 && (0..bands).all(|band| residual(band).abs() < RESIDUAL_MAX);
                if !counts {
                    continue;
                }
                let shown = |row: usize| match row < bands {
                    true => f64::from(plain.values[row * plane + pixel]),
                    false => 1.0,
                };
                for row in 0..=bands {
                    (0..=bands).for_each(|column| normal[(row, column)] += shown(row) * shown(column));
                    (0..bands).for_each(|band| {
                        right[(row, band)] += shown(row) * f64::from(truth.values[band * plane + pixel]);
                    });
                }
            }
            (normal, right)
        };
        let chunks: Vec<_> = (0..plane.div_ceil(CHUNK)).into_par_iter().map(sums_of).collect();
        let ridge = PRIOR_COLOUR * plane as f64;
        let start = (
            DMatrix::from_diagonal_element(bands + 1, bands + 1, ridge),
            &self.0 * ridge,
        );
        let (normal, right) = chunks.into_iter().fold(start, |a, b| (a.0 + b.0, a.1 + b.1));
        Some(Self(normal.cholesky()?.solve(&right)))
    }
}

/// Weighted albedo corrections of each pixel and band, and their weights.
fn corrections(model: &ShadowGs, context: &Context, pass: &Pass, view: &View, round: Round) -> (Raster, Raster) {
    let image = pass.image();
    let truth = view.truth(&image);
    let mut maps = pass.maps.clone();
    let [bright, dark] = [true, false].map(|one| with_albedo(model, context, &mut maps, one));
    let plane = image.plane_len();
    let (mut corrections, mut told) = (image.clone(), image);
    let pixels = corrections.values.par_iter_mut().zip(&mut told.values).enumerate();
    pixels.for_each(|(i, (correction, told))| {
        let (residual, response) = (truth.values[i] - *correction, bright.values[i] - dark.values[i]);
        let tells = view.weight[i % plane] > 0.0 && residual.is_finite() && response > LEAST_RESPONSE;
        let residual = residual.clamp(-RESIDUAL_MAX, RESIDUAL_MAX);
        (*correction, *told) = match (tells, round) {
            (true, Round::Before) => (residual / response, 1.0),
            (true, Round::After) => (residual, response),
            (false, _) => (0.0, 0.0),
        };
    });
    (corrections, told)
}

/// The view for albedo one, or zero; changes `maps`, those of the view, accordingly.
fn with_albedo(model: &ShadowGs, context: &Context, maps: &mut Maps, one: bool) -> Raster {
    let Maps { channels, alpha, .. } = &mut *maps;
    let albedo = channels[..model.options.bands].par_iter_mut();
    albedo.for_each(|channel| match one {
        true => channel.copy_from_slice(alpha),
        false => channel.fill(0.0),
    });
    model.compose(context, maps)
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat::ProjectiveCamera;
    use heliosplat::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, core_groups, logit};
    use heliosplat::model::shadow_gs::ShadowGsOptions;
    use heliosplat::render::render;

    const SIDE: usize = 24;

    /// Level ground of discs half a metre apart, chequered in patches of four.
    fn ground(model: &ShadowGs) -> Parameters {
        let mut groups = core_groups();
        groups.extend(model.feature_groups());
        let mut gaussians = Table::zeros(groups, SIDE * SIDE);
        for g in 0..SIDE * SIDE {
            let (column, row) = (g % SIDE, g / SIDE);
            let place = |i: usize| 0.5 * (i as f32 - 0.5 * SIDE as f32);
            gaussians.group_mut(POSITION)[3 * g..3 * g + 2].copy_from_slice(&[place(column), place(row)]);
            gaussians.group_mut(LOG_SCALE)[3 * g..3 * g + 3].copy_from_slice(&[-1.2, -1.2, -4.0]);
            gaussians.group_mut(ROTATION)[4 * g + 3] = 1.0;
            let albedo = if (column / 4 + row / 4) % 2 == 0 { 0.2 } else { 0.5 };
            gaussians.group_mut(ALBEDO)[3 * g..3 * g + 3].fill(albedo);
        }
        gaussians.group_mut(OPACITY).fill(logit(0.9));
        let globals = model.initial_globals(0.3);
        Parameters { gaussians, globals }
    }

    /// The image that these parameters give.
    fn nadir(model: &ShadowGs, parameters: &Parameters, camera: ProjectiveCamera, appearance: usize) -> View {
        let image = render(
            model,
            parameters,
            &camera,
            None,
            Some(appearance),
            PassOptions::default(),
        )
        .image;
        View {
            name: "nadir".into(),
            camera,
            weight: vec![1.0; image.plane_len()],
            image: image.into(),
            light: None,
            appearance,
            visibility_prior: None,
            ceiling: Vec::new(),
        }
    }

    #[test]
    fn a_round_takes_its_share_off_the_error_of_the_albedo_and_keeps_the_right_one() {
        let model = ShadowGs::new(ShadowGsOptions::default());
        let right = ground(&model);
        let half = 0.25 * SIDE as f64;
        let camera = ProjectiveCamera::nadir(-half, half, 0.5, (SIDE, SIDE));
        let view = nadir(&model, &right, camera, 0);
        let error = |parameters: &Parameters| -> f32 {
            let pairs = parameters
                .gaussians
                .group(ALBEDO)
                .iter()
                .zip(right.gaussians.group(ALBEDO));
            pairs.map(|(a, b)| (a - b).abs()).sum::<f32>() / right.gaussians.group(ALBEDO).len() as f32
        };
        let mut wrong = right.clone();
        wrong.gaussians.group_mut(ALBEDO).fill(0.35);
        let before = error(&wrong);
        for (round, left) in [(Round::Before, 0.67), (Round::After, 0.5)] {
            let mut improved = wrong.clone();
            improve(&model, &mut improved, std::slice::from_ref(&view), round);
            assert!(error(&improved) < left * before, "{} of {before}", error(&improved));
            let mut kept = right.clone();
            improve(&model, &mut kept, std::slice::from_ref(&view), round);
            assert!(error(&kept) < 1e-4, "{}", error(&kept));
        }
    }

    #[test]
    fn planes_are_spread_by_the_weights_of_the_rasteriser_however_many_they_are() {
        let model = ShadowGs::new(ShadowGsOptions::default());
        let parameters = ground(&model);
        let half = 0.25 * SIDE as f64;
        let camera = ProjectiveCamera::nadir(-half, half, 0.5, (SIDE, SIDE));
        let context = Context {
            parameters: &parameters,
            camera: &camera,
            light: None,
            appearance: Some(0),
        };
        let pass = Pass::new(&model, context, Lit::Everywhere, PassOptions::default());
        // More than are composited at once; the first is one everywhere.
        let plane = |k: usize| {
            (0..SIDE * SIDE)
                .map(|i| if k == 0 { 1.0 } else { ((i * k) % 7) as f32 })
                .collect()
        };
        let planes: Vec<Vec<f32>> = (0..20).map(plane).collect();
        let all = pass.spread(&planes);
        let alpha: f32 = pass.maps.alpha.iter().sum();
        let of_first: f32 = all.iter().step_by(planes.len()).sum();
        assert!((of_first - alpha).abs() < 1e-3 * alpha, "{of_first} {alpha}");
        for k in [3, 18] {
            let alone = pass.spread(&planes[k..=k]);
            let together: Vec<f32> = all.iter().skip(k).step_by(planes.len()).copied().collect();
            assert_eq!(alone, together, "plane {k}");
        }
    }

    #[test]
    fn the_colours_of_an_image_are_found() {
        let model = ShadowGs::new(ShadowGsOptions {
            images: 2,
            ..ShadowGsOptions::default()
        });
        let mut right = ground(&model);
        // The second image has another gain in each band, and an offset.
        right.globals.group_mut(COLOUR)[9..18].copy_from_slice(&[0.9, 0.0, 0.0, 0.0, 1.1, 0.0, 0.0, 0.0, 1.0]);
        right.globals.group_mut(OFFSET)[3..6].fill(0.02);
        let half = 0.25 * SIDE as f64;
        let camera = ProjectiveCamera::nadir(-half, half, 0.5, (SIDE, SIDE));
        let views = [0, 1].map(|image| nadir(&model, &right, camera, image));
        let mut found = right.clone();
        found.globals = model.initial_globals(0.3);
        begin(&model, &mut found, &views);
        let shown =
            |parameters: &Parameters| render(&model, parameters, &camera, None, Some(1), PassOptions::default()).image;
        let difference = |a: &Raster, b: &Raster| {
            let pairs = a.values.iter().zip(&b.values);
            pairs.map(|(a, b)| (a - b).abs()).sum::<f32>() / a.values.len() as f32
        };
        let mut uncoloured = right.clone();
        uncoloured.globals = model.initial_globals(0.3);
        let before = difference(&shown(&uncoloured), &shown(&right));
        let after = difference(&shown(&found), &shown(&right));
        assert!(after < 0.5 * before, "{after} of {before}");
    }
}
