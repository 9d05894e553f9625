//! Faults of a training step or a whole training, and their messages.

use crate::gaussians::{GroupSpec, Table, core_groups};
use crate::model::{NamedLoss, Parameters, View};
use crate::optim::ParameterGroup;
use rayon::prelude::*;

/// Gradients from here on count as infinite: Adam squares them, and the sum of squares must stay finite.
pub const GRADIENT_MAX: f32 = 1e18;

/// The part of a step that is not finite.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// The named loss.
    #[error("the loss '{0}' is not finite")]
    Loss(&'static str),
    /// The gradient to the named group of parameters.
    #[error("the gradient to '{0}' is not finite")]
    Gradient(String),
}

/// Reason why training cannot begin or continue.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TrainError {
    /// Too many steps in a row had numbers that are not finite.
    #[error(
        "{rejected} steps in a row gave numbers that are not finite ({fault}, last in view {view}); the last good state is kept"
    )]
    NotFinite {
        /// Number of steps rejected in a row.
        rejected: usize,
        /// The non-finite part of the last rejected step.
        fault: Fault,
        /// Name of the view of the last rejected step.
        view: String,
    },
    /// No Gaussians are left.
    #[error("no Gaussians are left; the images may not overlap or the altitude range may miss the ground")]
    Empty,
    /// The device failed, or has too little room. Field: the reason and the device.
    #[error("{0}; --device cpu trains without it")]
    Device(String),
    /// There are no views.
    #[error("a model needs at least one view")]
    NoViews,
    /// No pixel of any view has a positive weight and a value.
    #[error(
        "no pixel of any view counts: the images are missing values where the model has a surface, or show nothing of it"
    )]
    NoPixels,
    /// Too many steps in a row saw no Gaussian.
    #[error(
        "{steps} steps in a row saw no Gaussian: the cameras do not look at the model; check cameras and altitude range"
    )]
    NothingSeen {
        /// Number of steps in a row that saw no Gaussian.
        steps: usize,
    },
    /// The start has numbers that are not finite.
    #[error("the start has numbers in '{group}' that are not finite; check the options of the start")]
    Start {
        /// Name of the group that contains them.
        group: String,
    },
    /// The start does not have the model's groups of parameters.
    #[error("the start has other groups of parameters than the model '{model}' of these options")]
    Groups {
        /// Name of the model.
        model: &'static str,
    },
    /// An option is out of its range.
    #[error("train.{option} is {value}, expected {expected}")]
    Option {
        /// Name of the option.
        option: &'static str,
        /// Value of the option.
        value: String,
        /// Description of the allowed values.
        expected: &'static str,
    },
}

/// Name of the first group of a table with a value for which `sound` is false.
fn unsound(table: &Table, sound: impl Fn(f32) -> bool + Sync) -> Option<&str> {
    let is_sound = |values: &[f32]| {
        values
            .par_chunks(1 << 16)
            .all(|chunk| chunk.iter().all(|&value| sound(value)))
    };
    let group = table.groups.iter().find(|group| !is_sound(&group.values))?;
    Some(&group.spec.name)
}

/// The first fault of a step's losses and gradients.
pub(super) fn of_step(losses: &[NamedLoss], gradients: &Parameters) -> Option<Fault> {
    if let Some((name, _)) = losses.iter().find(|(_, value)| !value.is_finite()) {
        return Some(Fault::Loss(name));
    }
    // The comparison is false for NaN.
    let sound = |value: f32| value.abs() < GRADIENT_MAX;
    unsound(&gradients.gaussians, sound)
        .or_else(|| unsound(&gradients.globals, sound))
        .map(|group| Fault::Gradient(group.to_owned()))
}

/// Checks that all numbers of the start are finite.
///
/// # Errors
/// [`TrainError::Start`] names the first group with a number that is not finite.
pub(super) fn check_start(parameters: &Parameters) -> Result<(), TrainError> {
    match unsound(&parameters.gaussians, f32::is_finite).or_else(|| unsound(&parameters.globals, f32::is_finite)) {
        None => Ok(()),
        Some(group) => Err(TrainError::Start {
            group: group.to_owned(),
        }),
    }
}

/// Checks that the groups of `parameters` are those of the model, in its order: learning rates are matched by that
/// order.
///
/// # Errors
/// [`TrainError::Groups`] when they differ.
pub(super) fn check_groups(
    model: &'static str,
    parameters: &Parameters,
    features: &[ParameterGroup],
    globals: &[ParameterGroup],
) -> Result<(), TrainError> {
    let same = |table: &Table, core: Vec<GroupSpec>, own: &[ParameterGroup]| {
        let expected = core.iter().chain(own.iter().map(|group| &group.spec));
        table.groups.iter().map(|group| &group.spec).eq(expected)
    };
    if same(&parameters.gaussians, core_groups(), features) && same(&parameters.globals, Vec::new(), globals) {
        Ok(())
    } else {
        Err(TrainError::Groups { model })
    }
}

/// Checks that some pixel of some view has a positive weight and a value.
///
/// # Errors
/// [`TrainError::NoPixels`] when none has.
pub(super) fn check_pixels(views: &[View]) -> Result<(), TrainError> {
    let counts = |view: &View| {
        (0..view.image.plane_len())
            .any(|i| view.weight[i] > 0.0 && (0..view.image.bands).any(|band| view.image.plane(band)[i].is_finite()))
    };
    if views.iter().any(counts) {
        Ok(())
    } else {
        Err(TrainError::NoPixels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::OPACITY;
    use crate::optim::LearningRate;

    fn gradients() -> Parameters {
        Parameters {
            gaussians: Table::zeros(core_groups(), 3),
            globals: Table::zeros(vec![GroupSpec::new("sky", 2)], 1),
        }
    }

    #[test]
    fn a_start_with_other_groups_than_the_model_is_refused() {
        let group = |name: &str, width: usize| ParameterGroup::new(name, width, LearningRate::FROZEN);
        let check = |features: &[ParameterGroup], globals: &[ParameterGroup]| {
            check_groups("a", &gradients(), features, globals).is_ok()
        };
        assert!(check(&[], &[group("sky", 2)]));
        assert!(
            !check(&[], &[group("sky", 3)]) && !check(&[], &[]) && !check(&[group("albedo", 3)], &[group("sky", 2)])
        );
    }

    #[test]
    fn the_fault_of_a_step_is_named() {
        assert_eq!(of_step(&[("photometric", 1.0)], &gradients()), None);
        assert_eq!(
            of_step(&[("photometric", f64::NAN)], &gradients()),
            Some(Fault::Loss("photometric"))
        );
        for value in [f32::NAN, f32::INFINITY, -1e19] {
            let mut wrong = gradients();
            wrong.gaussians.group_mut(OPACITY)[1] = value;
            assert_eq!(of_step(&[], &wrong), Some(Fault::Gradient("opacity".into())), "{value}");
            let mut wrong = gradients();
            wrong.globals.group_mut(0)[1] = value;
            assert_eq!(of_step(&[], &wrong), Some(Fault::Gradient("sky".into())), "{value}");
        }
    }
}
