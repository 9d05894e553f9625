//! What short fits on pieces of the scene decide, in the plan.

use super::Decisions;
use crate::config::ModelOptions;
use crate::trial::{Component, Trial, Trials};

/// What short fits with and without a component said.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PlanTrial {
    /// Squared error on pixels kept aside without it over that with it, decibels; above zero it helps.
    pub gain_db: f64,
    /// Standard error of this, decibels.
    pub standard_error_db: f64,
    /// Pieces of ground compared.
    pub pieces: usize,
    /// Numbers that it adds to each Gaussian.
    pub numbers_per_gaussian: usize,
}

/// The components that nothing is said about by hand.
pub(super) fn open(model: &ModelOptions) -> Vec<Component> {
    let unset = |component: &Component| match component {
        Component::NearLight => model.near_light.is_none(),
        Component::Harmonics => model.sh_degree.is_none(),
    };
    Component::ALL.into_iter().filter(unset).collect()
}

impl Decisions {
    /// The same after short fits; nothing is open afterwards.
    pub(crate) fn after_trials(&self, trials: &Trials) -> Self {
        let mut decisions = self.clone();
        for component in std::mem::take(&mut decisions.open) {
            let trial = trials.trials.iter().find(|trial| trial.component == component);
            if let Some(trial) = trial {
                match component {
                    Component::NearLight => decisions.near_light = trial.on,
                    Component::Harmonics => decisions.sh_degree = usize::from(trial.on),
                }
            }
            let item = decisions
                .items
                .iter_mut()
                .find(|item| item.component == component.key());
            let Some(item) = item else { continue };
            match (trial, &trials.untried) {
                (Some(trial), _) => {
                    item.reason = in_words(trial, item.on, &item.reason);
                    item.on = trial.on;
                    item.trial = trial.gain.map(|gain| PlanTrial {
                        gain_db: gain.gain_db,
                        standard_error_db: gain.standard_error_db,
                        pieces: gain.pieces,
                        numbers_per_gaussian: trial.numbers_per_gaussian,
                    });
                }
                (None, Some(why)) => item.reason = format!("{}; not measured: {why}", item.reason),
                (None, None) => {}
            }
        }
        decisions
    }
}

/// What was measured of a component that was `on` before, for the `reason` that the plan had.
fn in_words(trial: &Trial, was_on: bool, reason: &str) -> String {
    let Some(gain) = trial.gain else {
        return format!("short fits do not tell; {reason}");
    };
    let said = format!(
        "short fits: {} on {} pieces of ground kept aside",
        gain.in_words(),
        gain.pieces
    );
    match (trial.on == was_on, trial.decided, trial.on) {
        (true, false, _) => format!("{said}, which decides nothing: {reason}"),
        (_, _, true) => format!("{said}: taken"),
        (_, _, false) => format!("{said}: left out"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::PlanItem;
    use super::*;
    use crate::config::SatelliteConfig;
    use crate::plan::tests::facts;
    use heliosplat_fitting::paired::Gain;

    fn trial(component: Component, gain_db: f64, on: bool, decided: bool) -> Trial {
        Trial {
            component,
            gain: Some(Gain {
                gain_db,
                standard_error_db: 0.02,
                pieces: 32,
            }),
            step_time_ratio: 1.1,
            numbers_per_gaussian: 4,
            on,
            decided,
        }
    }

    fn item<'a>(decisions: &'a Decisions, component: &str) -> &'a PlanItem {
        let found = decisions.items.iter().find(|item| item.component == component);
        found.expect("part of the plan")
    }

    #[test]
    fn what_short_fits_find_is_decided_with_its_evidence_and_the_rest_stays() {
        let before = Decisions::from_facts(&facts(12, 6), &SatelliteConfig::default());
        assert_eq!(before.open, Component::ALL);
        let trials = Trials {
            trials: vec![
                trial(Component::NearLight, 0.21, true, true),
                trial(Component::Harmonics, 0.01, false, false),
            ],
            ..Trials::default()
        };
        let after = before.after_trials(&trials);
        assert!(after.near_light && !after.shadow_prior && after.sh_degree == 0 && after.open.is_empty());
        let near = item(&after, "model.near_light");
        assert!(
            near.on && near.reason.contains("+0.21 ± 0.02 dB") && near.reason.contains("taken"),
            "{near:?}"
        );
        assert_eq!(near.trial.map(|trial| trial.pieces), Some(32));
        let degree = item(&after, "model.sh_degree");
        assert!(
            degree.reason.contains("decides nothing: one albedo"),
            "{}",
            degree.reason
        );
        assert_eq!(
            item(&after, "model.shadow_prior"),
            item(&before, "model.shadow_prior"),
            "counting decides it"
        );
    }

    #[test]
    fn what_harms_is_left_out_and_says_so() {
        let before = Decisions::from_facts(&facts(12, 6), &SatelliteConfig::default());
        let after = before.after_trials(&Trials {
            trials: vec![trial(Component::Harmonics, -0.3, false, true)],
            ..Trials::default()
        });
        assert!(item(&after, "model.sh_degree").reason.contains("left out"));
    }

    #[test]
    fn what_is_set_by_hand_is_not_tried() {
        let mut config = SatelliteConfig::default();
        config.model.near_light = Some(false);
        let decisions = Decisions::from_facts(&facts(12, 6), &config);
        assert_eq!(decisions.open, [Component::Harmonics]);
        let after = decisions.after_trials(&Trials {
            untried: Some("too few steps".into()),
            ..Trials::default()
        });
        assert!(
            item(&after, "model.sh_degree")
                .reason
                .ends_with("not measured: too few steps")
        );
        assert!(!item(&after, "model.near_light").reason.contains("not measured"));
    }
}
