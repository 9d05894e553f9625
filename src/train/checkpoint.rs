//! The state of a training, stored and resumed: the steps that follow are the same, byte for byte.
//!
//! Views, options and the random order follow from the inputs and are not part of it. A state is plain data for serde;
//! its file format is defined elsewhere.

use super::cpu::Cpu;
use super::holdout::HoldoutState;
use super::{StepState, Trainer};
use crate::gaussians::Table;
use crate::optim::Adam;
use crate::trace::Occluders;
use crate::trace::bvh::Bounds;
use std::borrow::Cow;

/// Version of the layout of [`TrainerState`].
pub const STATE_VERSION: u32 = 9;

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
    /// Options that may change while a training runs.
    iterations: usize,
    density_cap: usize,
    now: Cow<'a, StepState>,
    holdout: Cow<'a, HoldoutState>,
    /// Step at which the occluders were made, and the bounds that a hierarchy over them was built on: the places of
    /// Gaussians in it fix the order of products.
    occluders: Option<(usize, Option<Cow<'a, [Bounds]>>)>,
}

impl TrainerState<'_> {
    /// Number of steps done.
    pub fn steps(&self) -> usize {
        self.now.step
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
            iterations: self.options.iterations,
            density_cap: self.options.density.cap,
            now: Cow::Borrowed(&self.now),
            holdout: Cow::Borrowed(&self.holdout.now),
            occluders: self.cpu.occluders.as_ref().map(|occluders| {
                let built_on = occluders.hierarchy_built_on().map(Cow::Borrowed);
                (self.cpu.occluders_step, built_on)
            }),
        }
    }

    /// Restores the state of a training with the same views, model and options.
    ///
    /// # Errors
    /// [`StateError`] when `state` does not match; the trainer is then unchanged.
    pub fn restore(&mut self, state: TrainerState) -> Result<(), StateError> {
        self.check(&state)?;
        self.options.iterations = state.iterations;
        self.options.density.cap = state.density_cap;
        self.now = state.now.into_owned();
        self.holdout.now = state.holdout.into_owned();
        self.moved = true;
        self.cpu = Cpu::new(&self.now.tables.parameters);
        self.cpu.occluders = state.occluders.map(|(step, built_on)| {
            self.cpu.occluders_step = step;
            let (by, gaussians) = (self.options.sun_visibility, &self.now.tables.parameters.gaussians);
            match built_on {
                Some(bounds) => Occluders::with_hierarchy_on(by, gaussians, bounds.into_owned()),
                None => Occluders::tracing_by(by, gaussians),
            }
        });
        self.order.clear();
        (0..self.views.len()).for_each(|view| self.place_camera(view));
        Ok(())
    }

    fn check(&self, state: &TrainerState) -> Result<(), StateError> {
        let (now, like) = (&state.now.tables, &self.now.tables.parameters);
        let (gaussians, globals) = (&now.parameters.gaussians, &now.parameters.globals);
        let moments = |adam: &Adam, like: &Table| {
            same_shape(&adam.first, like) && same_shape(&adam.second, like) && adam.is_finite()
        };
        let best = state.holdout.best.as_ref().map(|(_, _, parameters)| parameters);
        let turns = state.now.turns.as_ref();
        let light = now.cached_visibility.iter().flatten();
        let bounds = state.occluders.iter().filter_map(|(_, built_on)| built_on.as_ref());
        let checks = [
            (
                "Gaussians",
                same_groups(gaussians, &like.gaussians) && gaussians.count > 0,
            ),
            ("shared parameters", same_shape(globals, &like.globals)),
            (
                "numbers",
                now.parameters.is_finite() && turns.is_none_or(|turns| turns.iter().all(|turn| turn.is_finite())),
            ),
            (
                "moments",
                moments(&now.gaussians_adam, gaussians) && moments(&now.globals_adam, globals),
            ),
            ("statistics", now.statistics.fits(gaussians.count)),
            (
                "best parameters",
                best.is_none_or(|p| same_groups(&p.gaussians, gaussians) && same_shape(&p.globals, globals)),
            ),
            (
                "views",
                [now.cached_visibility.len(), state.holdout.losses.len()] == [self.views.len(); 2],
            ),
            ("cameras", turns.is_none_or(|turns| turns.len() == self.views.len())),
            ("light", light.into_iter().all(|light| light.is_of(gaussians.count))),
            (
                "occluders",
                bounds.into_iter().all(|bounds| bounds.len() == gaussians.count),
            ),
            (
                "neighbours",
                now.neighbours
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
