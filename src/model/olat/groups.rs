//! The parameter groups of the model: selection by the options, places in the tables, widths and learning rates.
//!
//! A group that the options leave out has no place, so the indices behind it shift: look them up by group.

use super::networks::{EMBEDDING, SCATTER_INPUTS, SHADOW_INPUTS, network};
use super::options::OlatOptions;
use super::surface::LOBES;
use crate::gaussians::FEATURES;
use crate::model::background::COLOURS;
use crate::model::network::Network;
use crate::optim::{LearningRate, ParameterGroup};

/// Index of the shared group of the lobes' frames, quaternions `x, y, z, w`.
pub(super) const LOBE_FRAME: usize = 0;
/// Index of the shared group of the lobes' two relative widths, before the sigmoid.
pub(super) const LOBE_SCALE: usize = 1;
/// Index of the shared group of the lobes' widths, before the sigmoid.
pub(super) const LOBE_SIGMA: usize = 2;
/// All groups of the lobes, in this order.
pub(super) const LOBE_GROUPS: [usize; 3] = [LOBE_FRAME, LOBE_SCALE, LOBE_SIGMA];
/// Share of training from which on the specular term is trained. SSD-GS has 16 of 100: by then normals have turned to
/// imitate highlights with the diffuse term, and do not recover (docs/lab/objects.md).
const SPECULAR_FROM: f32 = 0.05;
/// Share of training from which on the lobes change their shape (SSD-GS: 22 of 100).
const LOBES_FROM: f32 = 0.08;
/// Share of the surfaces' learning rates that is left at the end of training: without decay the shared lobes keep
/// oscillating.
const RATE_AT_END: f32 = 0.1;
/// Share of training from which on light scatters (SSD-GS: 9 of 100).
const SCATTERING_FROM: f32 = 0.09;
/// Share of training from which on shadows are refined (SSD-GS: 5 of 100).
const REFINED_FROM: f32 = 0.05;

/// The groups of parameters that a Gaussian can have, in the order of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Feature {
    Diffuse,
    Frame,
    Specular,
    LobeWeight,
    F0,
    Embedding,
    Scattered,
}

impl Feature {
    const ALL: [Self; 7] = [
        Self::Diffuse,
        Self::Frame,
        Self::Specular,
        Self::LobeWeight,
        Self::F0,
        Self::Embedding,
        Self::Scattered,
    ];

    fn describe(self) -> ParameterGroup {
        match self {
            Self::Diffuse => ParameterGroup::new("diffuse", COLOURS, surface_rate(0.0, 3e-2)),
            Self::Frame => ParameterGroup::new("frame", 4, surface_rate(0.0, 2e-2)),
            Self::Specular => ParameterGroup::new("specular", COLOURS, surface_rate(SPECULAR_FROM, 0.1)),
            Self::LobeWeight => ParameterGroup::new("lobe_weight", LOBES, surface_rate(SPECULAR_FROM, 3e-2)),
            Self::F0 => ParameterGroup::new("f0", 1, surface_rate(SPECULAR_FROM, 6e-2)),
            Self::Embedding => {
                let rate = LearningRate::constant(5e-3).starting_at(REFINED_FROM);
                ParameterGroup::new("embedding", EMBEDDING, rate)
            }
            Self::Scattered => {
                let rate = LearningRate::constant(1e-2).starting_at(SCATTERING_FROM);
                ParameterGroup::new("scattered", COLOURS, rate)
            }
        }
    }
}

/// The groups of parameters that all Gaussians can share, in the order of their table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shared {
    LobeFrame,
    LobeScale,
    LobeSigma,
    ScatteringNetwork,
    ShadowNetwork,
}

impl Shared {
    const ALL: [Self; 5] = [
        Self::LobeFrame,
        Self::LobeScale,
        Self::LobeSigma,
        Self::ScatteringNetwork,
        Self::ShadowNetwork,
    ];
}

/// Learning rate of material parameters: `rate` from the share `from` of training on, decaying.
fn surface_rate(from: f32, rate: f32) -> LearningRate {
    LearningRate::constant(rate).starting_at(from).decaying_to(RATE_AT_END)
}

impl OlatOptions {
    /// Shape of the scattering network.
    pub(super) fn scattering_network(&self) -> Network {
        network(SCATTER_INPUTS, COLOURS, self.width.max(1), self.hidden.max(1))
    }

    /// Shape of the shadow network.
    pub(super) fn shadow_network(&self) -> Network {
        network(SHADOW_INPUTS, 1, self.width.max(1), self.hidden.max(1))
    }

    /// True if a network that reads the material embedding is on.
    fn has_embedding(&self) -> bool {
        self.scattering || self.refined
    }

    fn has_feature(&self, feature: Feature) -> bool {
        match feature {
            Feature::Diffuse | Feature::Frame => true,
            Feature::Specular | Feature::LobeWeight | Feature::F0 => self.specular,
            Feature::Embedding => self.has_embedding(),
            Feature::Scattered => self.scattering,
        }
    }

    fn has_shared(&self, shared: Shared) -> bool {
        match shared {
            Shared::LobeFrame | Shared::LobeScale | Shared::LobeSigma => self.specular,
            Shared::ScatteringNetwork => self.scattering,
            Shared::ShadowNetwork => self.refined,
        }
    }

    /// Index in the table of Gaussians; `None` where the options leave the group out.
    pub(super) fn feature_index(&self, feature: Feature) -> Option<usize> {
        let mut present = Feature::ALL.into_iter().filter(|&other| self.has_feature(other));
        present.position(|other| other == feature).map(|at| FEATURES + at)
    }

    /// Index in the table of shared parameters; `None` where the options leave the group out.
    pub(super) fn shared_index(&self, shared: Shared) -> Option<usize> {
        let mut present = Shared::ALL.into_iter().filter(|&other| self.has_shared(other));
        present.position(|other| other == shared)
    }

    fn describe_shared(&self, shared: Shared) -> ParameterGroup {
        let lobes = surface_rate(LOBES_FROM, 2e-2);
        let network = |from: f32| LearningRate::constant(2e-3).starting_at(from);
        match shared {
            Shared::LobeFrame => ParameterGroup::new("lobe_frame", LOBES * 4, lobes),
            Shared::LobeScale => ParameterGroup::new("lobe_scale", LOBES * 2, lobes),
            Shared::LobeSigma => ParameterGroup::new("lobe_sigma", LOBES, lobes),
            Shared::ScatteringNetwork => ParameterGroup::new(
                "scattering_network",
                self.scattering_network().weights(),
                network(SCATTERING_FROM),
            ),
            Shared::ShadowNetwork => {
                ParameterGroup::new("shadow_network", self.shadow_network().weights(), network(REFINED_FROM))
            }
        }
    }

    /// The groups of a Gaussian that the options include.
    pub(super) fn feature_parameters(&self) -> Vec<ParameterGroup> {
        let present = Feature::ALL.into_iter().filter(|&feature| self.has_feature(feature));
        present.map(Feature::describe).collect()
    }

    /// The shared groups that the options include.
    pub(super) fn shared_parameters(&self) -> Vec<ParameterGroup> {
        let present = Shared::ALL.into_iter().filter(|&shared| self.has_shared(shared));
        present.map(|shared| self.describe_shared(shared)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DIFFUSE, F0, FRAME, SPECULAR, WEIGHT};
    use super::*;

    #[test]
    fn groups_have_the_places_that_constants_name_and_those_left_out_have_none() {
        let all = OlatOptions {
            scattering: true,
            refined: true,
            ..OlatOptions::default()
        };
        let places = [
            Feature::Diffuse,
            Feature::Frame,
            Feature::Specular,
            Feature::LobeWeight,
            Feature::F0,
        ];
        assert_eq!(
            places.map(|f| all.feature_index(f)),
            [DIFFUSE, FRAME, SPECULAR, WEIGHT, F0].map(Some)
        );
        let lobes = [Shared::LobeFrame, Shared::LobeScale, Shared::LobeSigma];
        assert_eq!(
            lobes.map(|s| all.shared_index(s)),
            [LOBE_FRAME, LOBE_SCALE, LOBE_SIGMA].map(Some)
        );
        let matte = OlatOptions { specular: false, ..all };
        assert_eq!(matte.feature_index(Feature::F0), None);
        assert_eq!(matte.feature_index(Feature::Embedding), Some(SPECULAR));
        assert_eq!(matte.shared_index(Shared::ShadowNetwork), Some(1));
    }
}
