//! The state of a training, stored and resumed: the steps that follow are the same, byte for byte.
//!
//! Views, options and the random order follow from the inputs and are not part of it. A state is plain data for serde;
//! its file format is defined elsewhere.

use super::cached_visibility::CachedVisibility;
use super::holdout::HoldoutState;
use super::{Trainer, TrainerOptionsState};
use crate::gaussians::Table;
use crate::loss::smoothness::Neighbours;
use crate::model::Parameters;
use crate::optim::{Adam, DensityStatistics};
use crate::trace::Occluders;
use crate::trace::bvh::Bounds;
use std::borrow::Cow;

/// Version of the layout of [`TrainerState`].
pub const STATE_VERSION: u32 = 7;

/// Reason why a state cannot be restored.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the state is of another training: its {what} do not fit")]
pub struct StateError {
    /// The part of the state that does not match.
    pub what: &'static str,
}

/// A training between two steps.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct TrainerState<'a> {
    options: TrainerOptionsState,
    parameters: Cow<'a, Parameters>,
    gaussians_adam: Cow<'a, Adam>,
    globals_adam: Cow<'a, Adam>,
    statistics: Cow<'a, DensityStatistics>,
    holdout: HoldoutState<'a>,
    cached_visibility: Cow<'a, [Option<CachedVisibility>]>,
    /// Step at which the occluders were made, and the bounds that a hierarchy over them was built on: the places of
    /// Gaussians in it fix the order of products.
    occluders: Option<(usize, Option<Cow<'a, [Bounds]>>)>,
    /// Neighbours as of the last change of the number of Gaussians; the current positions do not determine them.
    neighbours: Option<Cow<'a, Neighbours>>,
    step: usize,
    rejected: usize,
    rejected_in_a_row: usize,
    unseen_in_a_row: usize,
}

impl TrainerState<'_> {
    /// Number of steps done.
    pub fn steps(&self) -> usize {
        self.step
    }
}

/// True if two tables have the same groups, and every group of `table` its full length.
fn same_groups(table: &Table, like: &Table) -> bool {
    let whole = |(group, like): (&crate::gaussians::Group, &crate::gaussians::Group)| {
        group.spec == like.spec && Some(group.values.len()) == group.spec.width.checked_mul(table.count)
    };
    table.groups.len() == like.groups.len() && table.groups.iter().zip(&like.groups).all(whole)
}

fn same_shape(table: &Table, like: &Table) -> bool {
    table.count == like.count && same_groups(table, like)
}

impl Trainer<'_> {
    /// State of this training, borrowed.
    pub fn state(&self) -> TrainerState<'_> {
        TrainerState {
            options: TrainerOptionsState {
                iterations: self.options.iterations,
                density_cap: self.options.density.cap,
            },
            parameters: Cow::Borrowed(&self.parameters),
            gaussians_adam: Cow::Borrowed(&self.gaussians_adam),
            globals_adam: Cow::Borrowed(&self.globals_adam),
            statistics: Cow::Borrowed(&self.statistics),
            holdout: self.holdout.state(),
            cached_visibility: Cow::Borrowed(&self.cached_visibility),
            occluders: self.occluders.as_ref().map(|occluders| {
                let built_on = occluders.hierarchy_built_on().map(Cow::Borrowed);
                (self.occluders_step, built_on)
            }),
            neighbours: self.neighbours.as_ref().map(Cow::Borrowed),
            step: self.step,
            rejected: self.rejected,
            rejected_in_a_row: self.rejected_in_a_row,
            unseen_in_a_row: self.unseen_in_a_row,
        }
    }

    /// Restores the state of a training with the same views, model and options.
    ///
    /// # Errors
    /// [`StateError`] when `state` does not match; the trainer is then unchanged.
    pub fn restore(&mut self, state: TrainerState) -> Result<(), StateError> {
        self.check(&state)?;
        self.options.iterations = state.options.iterations;
        self.options.density.cap = state.options.density_cap;
        self.parameters = state.parameters.into_owned();
        self.gaussians_adam = state.gaussians_adam.into_owned();
        self.globals_adam = state.globals_adam.into_owned();
        self.statistics = state.statistics.into_owned();
        self.holdout.restore(state.holdout);
        self.cached_visibility = state.cached_visibility.into_owned();
        self.gradients = self.parameters.zeros_like();
        self.occluders_step = 0;
        self.occluders = state.occluders.map(|(step, built_on)| {
            self.occluders_step = step;
            let (by, gaussians) = (self.options.sun_visibility, &self.parameters.gaussians);
            match built_on {
                Some(bounds) => Occluders::with_hierarchy_on(by, gaussians, bounds.into_owned()),
                None => Occluders::tracing_by(by, gaussians),
            }
        });
        self.neighbours = state.neighbours.map(Cow::into_owned);
        self.order.clear();
        self.step = state.step;
        self.rejected = state.rejected;
        self.rejected_in_a_row = state.rejected_in_a_row;
        self.unseen_in_a_row = state.unseen_in_a_row;
        Ok(())
    }

    fn check(&self, state: &TrainerState) -> Result<(), StateError> {
        let gaussians = &state.parameters.gaussians;
        let globals = &state.parameters.globals;
        let (of_each, of_all) = (&state.gaussians_adam, &state.globals_adam);
        let best = state.holdout.parameters();
        let light = state.cached_visibility.iter().flatten();
        let bounds = state.occluders.iter().filter_map(|(_, built_on)| built_on.as_ref());
        let checks = [
            (
                "Gaussians",
                same_groups(gaussians, &self.parameters.gaussians) && gaussians.count > 0,
            ),
            ("shared parameters", same_shape(globals, &self.parameters.globals)),
            ("numbers", state.parameters.is_finite()),
            (
                "moments",
                same_shape(&of_each.first, gaussians) && same_shape(&of_each.second, gaussians) && of_each.is_finite(),
            ),
            (
                "moments",
                same_shape(&of_all.first, globals) && same_shape(&of_all.second, globals) && of_all.is_finite(),
            ),
            ("statistics", state.statistics.fits(gaussians.count)),
            (
                "best parameters",
                best.is_none_or(|p| same_groups(&p.gaussians, gaussians) && same_shape(&p.globals, globals)),
            ),
            (
                "views",
                state.cached_visibility.len() == self.views.len() && state.holdout.views() == self.views.len(),
            ),
            ("light", light.into_iter().all(|light| light.is_of(gaussians.count))),
            (
                "occluders",
                bounds.into_iter().all(|bounds| bounds.len() == gaussians.count),
            ),
            (
                "neighbours",
                state
                    .neighbours
                    .iter()
                    .all(|neighbours| neighbours.count() == gaussians.count && neighbours.is_whole()),
            ),
        ];
        match checks.into_iter().find(|(_, fits)| !fits) {
            Some((what, _)) => Err(StateError { what }),
            None => Ok(()),
        }
    }
}
