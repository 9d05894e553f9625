//! The configuration of a run on a capture: data, not code, as for satellite scenes.

use heliosplat::train::TrainOptions;
use heliosplat_fitting::settings::{ConfigError, Preset, resolve};

/// How Gaussians start.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StartOptions {
    /// About as many Gaussians.
    pub gaussians: usize,
    /// Opacity.
    pub opacity: f32,
}

impl Default for StartOptions {
    fn default() -> Self {
        Self {
            gaussians: 8000,
            opacity: 0.5,
        }
    }
}

/// What is behind the object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Background {
    /// White for PNG with coverage, as is common; black for EXR with coverage; else the colour of the images' borders.
    Auto,
    /// White.
    White,
    /// Black.
    Black,
}

/// Which model explains the images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelKind {
    /// `olat` where every image has a light and they are in different places; else `reflective` where short fits show that gloss is
    /// needed, and `radiance` where not.
    Auto,
    /// Colours as seen from anywhere, under the light of the photographs.
    Radiance,
    /// What surfaces reflect of one light at a time.
    Olat,
    /// Glossy surfaces in surroundings that stay.
    Reflective,
}

/// The model.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelOptions {
    /// Which one.
    pub kind: ModelKind,
    /// Whether surfaces may be glossy: they are where that is needed, see [`super::plan`], or where `kind` says the model.
    pub specular: bool,
    /// Whether light may scatter under surfaces, in `olat`; as for gloss.
    pub scattering: bool,
    /// Whether a network refines shadows, in `olat`.
    pub refined_shadow: bool,
    /// Units of the hidden layers of the networks of `olat`.
    pub network_width: usize,
    /// Their hidden layers.
    pub network_layers: usize,
    /// Whether the light that reaches surfaces is traced, in `olat`.
    pub shadow: bool,
    /// Radius of the lights, in `olat`, in the capture's units.
    pub light_radius: f32,
    /// Largest degree of the spherical harmonics, 0 to 3.
    pub sh_degree: usize,
    /// Units of the hidden layers of the network that says what glossy surfaces mirror, in `reflective`.
    pub decoder_width: usize,
    /// Its hidden layers.
    pub decoder_layers: usize,
    /// How much the normals of surfaces agree with those of the depth, in `olat` (0.3 unless said) and `reflective` (0.05).
    pub normal_weight: Option<f32>,
    /// Decibels on images kept aside by which a part must help in a short fit to be taken; see [`super::plan`].
    pub least_gain_db: f64,
    /// Steps of such a fit; 0 leaves parts as the configuration says.
    pub pilot_steps: usize,
    /// What is behind the object.
    pub background: Background,
}

impl Default for ModelOptions {
    fn default() -> Self {
        Self {
            kind: ModelKind::Auto,
            specular: true,
            scattering: true,
            refined_shadow: false,
            network_width: 32,
            network_layers: 2,
            shadow: true,
            light_radius: 0.0,
            sh_degree: 3,
            decoder_width: 32,
            decoder_layers: 2,
            normal_weight: None,
            least_gain_db: 0.3,
            pilot_steps: 300,
            background: Background::Auto,
        }
    }
}

/// Everything that decides a run besides its capture.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObjectConfig {
    /// Training.
    pub train: TrainOptions,
    /// The start.
    pub start: StartOptions,
    /// The model.
    pub model: ModelOptions,
}

impl ObjectConfig {
    /// The defaults, then the preset's file, then the `--set` pairs in their order.
    ///
    /// # Errors
    /// [`ConfigError::Set`] for a key that does not exist or a value of another kind.
    pub fn resolve(preset: Preset, set: &[(String, String)], seed: u64) -> Result<Self, ConfigError> {
        let text = match preset {
            Preset::Fast => include_str!("../presets/fast.toml"),
            Preset::Balanced => include_str!("../presets/balanced.toml"),
            Preset::Accurate => include_str!("../presets/accurate.toml"),
        };
        let mut config: Self = resolve(preset.name(), text, set)?;
        config.train.seed = seed;
        Ok(config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_parses_and_asks_no_ground_of_an_object() {
        for preset in Preset::ALL {
            let config = ObjectConfig::resolve(preset, &[], 3).expect("a sound preset");
            assert_eq!((config.train.seed, config.train.consistency_weight), (3, 0.0));
        }
        let set = [("model.sh_degree".to_owned(), "1".to_owned())];
        assert_eq!(
            ObjectConfig::resolve(Preset::Fast, &set, 1)
                .expect("a known key")
                .model
                .sh_degree,
            1
        );
    }
}
