//! Albedo and near-surface light that depend on the viewing direction: spherical harmonics of degree 1 and more, added
//! to the value seen from straight above.

use super::{ALBEDO_RATE, ShadowGsOptions};
use crate::camera::ProjectiveCamera;
use crate::gaussians::{FEATURES, Table};
use crate::model::view_direction::{ViewDirection, rate_of_degree};
use crate::model::{Context, Parameters, Seen};
use crate::optim::ParameterGroup;
use crate::shade::sh::{self, MAX_FUNCTIONS};
use glam::Vec3;

/// Beginnings of the names of the groups with harmonics. Near-surface light has them only where it is on.
const PARTS: [&str; 2] = ["albedo_sh_", "near_light_sh_"];

/// Learning rate of the harmonics, relative to that of the albedo (Kerbl et al. 2023).
const RATE_OF_HARMONICS: f32 = 0.05;

/// Number of [`PARTS`] in a model.
fn parts(options: &ShadowGsOptions) -> usize {
    if options.near_light { 2 } else { 1 }
}

/// The groups of a model's harmonics, which follow its other ones: part by part, degree by degree.
pub(super) fn groups(options: &ShadowGsOptions) -> impl Iterator<Item = ParameterGroup> + use<> {
    let &ShadowGsOptions { bands, degree, .. } = options;
    let group = move |part: &str, l: usize| {
        let width = (2 * l + 1) * bands;
        ParameterGroup::new(
            &format!("{part}{l}"),
            width,
            rate_of_degree(ALBEDO_RATE * RATE_OF_HARMONICS, l),
        )
    };
    PARTS
        .into_iter()
        .take(parts(options))
        .flat_map(move |part| (1..=degree).map(move |l| group(part, l)))
}

/// Indices of the groups of the albedo's harmonics, whose coefficients lie function by function.
pub(super) fn albedo_harmonics(options: &ShadowGsOptions) -> std::ops::Range<usize> {
    let first = FEATURES + parts(options);
    first..first + options.degree
}

/// The harmonics of a model, seen from one camera.
pub(super) struct Harmonics<'a> {
    gaussians: &'a Table,
    camera: &'a ProjectiveCamera,
    eye: Option<Vec3>,
    /// The functions straight down.
    down: [f32; MAX_FUNCTIONS],
    degree: usize,
    bands: usize,
    /// First channel of each part.
    channels: [usize; PARTS.len()],
    parts: usize,
}

impl<'a> Harmonics<'a> {
    /// Harmonics for the view of `context`; `None` if the options have degree 0.
    pub(super) fn new(options: &ShadowGsOptions, context: &Context<'a>) -> Option<Self> {
        let &ShadowGsOptions { bands, degree, .. } = options;
        (degree > 0).then(|| Self {
            gaussians: &context.parameters.gaussians,
            camera: context.camera,
            eye: context.camera.eye(),
            down: sh::basis(Vec3::NEG_Z),
            degree,
            bands,
            // Between the two lies the visibility.
            channels: [0, bands + 1],
            parts: parts(options),
        })
    }

    /// The functions in the direction in which Gaussian `g` is seen, less those straight down.
    #[inline]
    fn functions(&self, g: usize) -> [f32; MAX_FUNCTIONS] {
        let seen_along = ViewDirection::new(self.eye, self.camera, self.gaussians.position(g));
        let seen = sh::basis(seen_along.direction);
        std::array::from_fn(|f| seen[f] - self.down[f])
    }

    /// Group index, first channel and degree of each group of harmonics.
    fn groups(&self) -> impl Iterator<Item = (usize, usize, usize)> + use<> {
        let (first, degree, channels) = (FEATURES + self.parts, self.degree, self.channels);
        (0..self.parts)
            .flat_map(move |part| (1..=degree).map(move |l| (first + part * degree + l - 1, channels[part], l)))
    }

    /// Adds the harmonics to the channels of Gaussian `g`, which hold the values seen from straight above.
    pub(super) fn add(&self, g: usize, feature: &mut [f32]) {
        let (functions, bands) = (self.functions(g), self.bands);
        for (group, channel, degree) in self.groups() {
            let width = (2 * degree + 1) * bands;
            let coefficients = &self.gaussians.group(group)[g * width..(g + 1) * width];
            let values = &mut feature[channel..channel + bands];
            for (coefficients, y) in coefficients.chunks(bands).zip(&functions[degree * degree..]) {
                values
                    .iter_mut()
                    .zip(coefficients)
                    .for_each(|(value, c)| *value += y * c);
            }
        }
    }

    /// Adds the gradients of the coefficients to `grads`, from those of the features, `d_features`.
    ///
    /// Positions get none: a metre turns the view of a satellite 600 km away by 2·10⁻⁶ rad, so the gradient through the
    /// viewing direction is as much smaller than that through the place in the image.
    pub(super) fn backward(&self, seen: &Seen, d_features: &[f32], grads: &mut Parameters) {
        let (bands, stride) = (self.bands, seen.stride);
        let indices = &seen.projected.gaussian;
        for (group, channel, degree) in self.groups() {
            grads.gaussians.add_to_group(group, indices, |s, slots| {
                // Recomputed for every group, which is cheaper than storing them.
                let functions = self.functions(indices[s] as usize);
                let d = &d_features[s * stride + channel..s * stride + channel + bands];
                for (slots, y) in slots.chunks_mut(bands).zip(&functions[degree * degree..]) {
                    slots.iter_mut().zip(d).for_each(|(slot, d)| *slot += y * d);
                }
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::core_groups;
    use crate::model::SceneModel;
    use crate::model::shadow_gs::ShadowGs;
    use glam::DVec3;

    fn model(degree: usize, near_light: bool) -> ShadowGs {
        ShadowGs::new(ShadowGsOptions {
            degree,
            near_light,
            ..ShadowGsOptions::default()
        })
    }

    fn names(model: &ShadowGs) -> Vec<String> {
        model.feature_groups().into_iter().map(|group| group.name).collect()
    }

    #[test]
    fn groups_follow_those_that_were_there() {
        assert_eq!(names(&model(0, true)), ["albedo", "near_light"]);
        assert_eq!(names(&model(2, false)), ["albedo", "albedo_sh_1", "albedo_sh_2"]);
        assert_eq!(
            names(&model(1, true)),
            ["albedo", "near_light", "albedo_sh_1", "near_light_sh_1"]
        );
        assert_eq!(names(&model(9, false)), names(&model(3, false)));
        let widths: Vec<usize> = model(3, false).feature_groups().iter().map(|g| g.width).collect();
        assert_eq!(widths, [3, 9, 15, 21]);
    }

    #[test]
    fn degrees_join_one_after_another() {
        let model = model(3, true);
        let learning = |progress: f32| -> Vec<bool> {
            let groups = model.feature_parameters();
            groups.iter().map(|group| group.rate.at(progress) > 0.0).collect()
        };
        assert_eq!(learning(0.0), [true, true, false, false, false, false, false, false]);
        assert_eq!(learning(0.25), [true, true, true, true, false, true, true, false]);
        assert_eq!(learning(1.0), [true; 8]);
        let rates: Vec<f32> = model
            .feature_parameters()
            .iter()
            .map(|group| group.rate.at(1.0))
            .collect();
        assert!(rates[2] < rates[0], "albedo_sh_1 learns slower than albedo: {rates:?}");
    }

    /// Channels of one Gaussian below the scene's centre, seen by a camera without an eye that looks along `axis`.
    fn seen_along(model: &ShadowGs, axis: DVec3) -> Vec<f32> {
        let mut groups = core_groups();
        groups.extend(model.feature_groups());
        let mut gaussians = Table::zeros(groups, 1);
        for group in &mut gaussians.groups[FEATURES..] {
            group.values.fill(0.3);
        }
        let right = axis.any_orthonormal_vector();
        let down = axis.cross(right);
        let (u, v) = ([right.x, right.y, right.z, 0.0], [down.x, down.y, down.z, 0.0]);
        let camera = ProjectiveCamera::new(u, v, [0.0; 3], (1, 1), axis);
        let parameters = Parameters {
            gaussians,
            globals: Table::default(),
        };
        let context = Context {
            parameters: &parameters,
            camera: &camera,
            light: None,
            appearance: None,
        };
        let mut feature = vec![0.3; model.channels()];
        let harmonics = Harmonics::new(&model.options, &context).expect("a degree above zero");
        harmonics.add(0, &mut feature);
        feature
    }

    #[test]
    fn from_straight_above_the_constant_is_seen() {
        for degree in 1..=3 {
            let model = model(degree, true);
            let above = seen_along(&model, DVec3::NEG_Z);
            assert!(above.iter().all(|&value| value == 0.3), "{above:?}");
            let aslant = seen_along(&model, DVec3::new(0.3, -0.1, -0.9).normalize());
            let visibility = model.visibility_channel();
            for (channel, value) in aslant.into_iter().enumerate() {
                assert_eq!(value == 0.3, channel == visibility, "{channel}: {value}");
            }
        }
    }
}
