//! Configuration of a run on a capture: options, presets, and the optional parts of models.

use heliosplat::optim::DensityOptions;
use heliosplat::train::TrainOptions;
use heliosplat_fitting::settings::{ConfigError, Preset, resolve};

/// Options of the initial Gaussians.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StartOptions {
    /// Approximate number of Gaussians: fewer for small images or little memory, more for large ones.
    pub gaussians: usize,
}

impl Default for StartOptions {
    fn default() -> Self {
        Self { gaussians: 8000 }
    }
}

/// Colour behind the object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Background {
    /// White for PNG with coverage, as is common, and black for EXR with coverage. Without coverage the colour of the
    /// images' borders, or black where they have several colours.
    Auto,
    /// White.
    White,
    /// Black.
    Black,
}

/// Kind of model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelKind {
    /// `olat` where every image has a light and the lights are in different places; else `reflective` where short fits
    /// find gloss, and `radiance` elsewhere.
    Auto,
    /// View-dependent colours under the light of the photographs.
    Radiance,
    /// Surfaces lit by one light at a time.
    Olat,
    /// Glossy surfaces in constant surroundings.
    Reflective,
}

/// Options of the model.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelOptions {
    /// Kind of model; [`ModelKind::Auto`] leaves the choice to the images.
    pub kind: ModelKind,
    /// True if surfaces may be glossy. Short fits decide ([`super::plan`]) where `kind` is `auto` or `olat`; with
    /// `reflective` they are glossy.
    pub specular: bool,
    /// True if light may scatter under surfaces, in `olat`; short fits decide.
    pub scattering: bool,
    /// True if a network refines shadows, in `olat`. Off: it gains −0.1 to 0.4 dB in a quarter more time, see
    /// docs/lab/objects.md. Short fits do not measure it.
    pub refined_shadow: bool,
    /// True if the light that reaches surfaces is traced, in `olat`. It is off in the comparison of
    /// docs/lab/objects.md, which takes a sixth of the time.
    pub shadow: bool,
    /// Radius of the lights, in `olat`, in the capture's units: 0 for points, larger for lamps that are near.
    pub light_radius: f32,
    /// Largest degree of the spherical harmonics: 3, or 0 for objects with the same colour from all directions.
    pub sh_degree: usize,
    /// Units of each hidden layer of all networks, 1 to 256. The papers have 64 in `reflective` (no better) and 256 in
    /// `olat` (14 times the time), see docs/lab/objects.md.
    pub network_width: usize,
    /// Hidden layers of all networks, 1 to 8; 3 and 6 in the papers.
    pub network_layers: usize,
    /// Steps of the short fits that select the parts (see [`super::plan`]); with 0 the parts are those of the
    /// configuration.
    pub pilot_steps: usize,
    /// Background of the object, needed where the images have no coverage.
    pub background: Background,
}

impl Default for ModelOptions {
    fn default() -> Self {
        Self {
            kind: ModelKind::Auto,
            specular: true,
            scattering: true,
            refined_shadow: false,
            shadow: true,
            light_radius: 0.0,
            sh_degree: 3,
            network_width: 32,
            network_layers: 2,
            pilot_steps: 1200,
            background: Background::Auto,
        }
    }
}

impl ModelOptions {
    /// Checks that networks have 1 to 256 units in each of 1 to 8 layers.
    fn checked(&self) -> Result<(), ConfigError> {
        let sizes = [
            ("model.network_width", self.network_width, 256, "1 to 256"),
            ("model.network_layers", self.network_layers, 8, "1 to 8"),
        ];
        ConfigError::check(&sizes.map(|(key, size, most, expected)| {
            let fits = (1..=most).contains(&size);
            (key, size as f64, fits, expected)
        }))
    }
}

/// Configuration of a run on a capture.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObjectConfig {
    /// Options of the training.
    pub train: TrainOptions,
    /// Options of the initial Gaussians.
    pub start: StartOptions,
    /// Options of the model.
    pub model: ModelOptions,
}

/// Configurations of a run by kind of model: a step under constant light takes a fraction of the time of one that traces
/// lamps, so it has more Gaussians, and in `fast` and `balanced` more steps.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectConfigs {
    /// Configuration for `radiance` and `reflective`.
    pub constant: ObjectConfig,
    /// Configuration for `olat`, and for the short fits that choose a model.
    pub lamps: ObjectConfig,
}

impl ObjectConfigs {
    /// Resolves the configurations: the defaults, then the preset's files, then the `--set` pairs in their order.
    /// `seed` is the seed of training.
    ///
    /// # Errors
    /// [`ConfigError::Set`] for a key that does not exist or a value of another kind, [`ConfigError::Value`] for a
    /// network of a size out of range, or a preset for satellite scenes only.
    pub fn resolve(preset: Preset, set: &[(String, String)], seed: u64) -> Result<Self, ConfigError> {
        let (lamps, constant) = match preset {
            Preset::Fast => (
                include_str!("../presets/fast.toml"),
                include_str!("../presets/fast_constant.toml"),
            ),
            Preset::Balanced => (
                include_str!("../presets/balanced.toml"),
                include_str!("../presets/balanced_constant.toml"),
            ),
            Preset::Accurate => (
                include_str!("../presets/accurate.toml"),
                include_str!("../presets/accurate_constant.toml"),
            ),
            Preset::Preview | Preset::Best => {
                return Err(ConfigError::Value {
                    key: "preset".into(),
                    value: preset.name().into(),
                    expected: "fast, balanced or accurate, for a capture of an object",
                });
            }
        };
        let of = |text| -> Result<ObjectConfig, ConfigError> {
            let mut config: ObjectConfig = resolve(preset.name(), text, set)?;
            config.train = for_objects(config.train, seed);
            config.model.checked()?;
            Ok(config)
        };
        let (lamps, constant) = (of(lamps)?, of(constant)?);
        Ok(Self { constant, lamps })
    }

    /// Limits the Gaussians to `most`, and those of the start to half as many, which leaves room for growth.
    pub(super) fn limit(&mut self, most: usize) {
        for config in [&mut self.constant, &mut self.lamps] {
            config.start.gaussians = config.start.gaussians.min(most / 2);
            config.train.density.cap = config.train.density.cap.min(most);
        }
    }

    /// Configuration for a kind of model.
    pub fn of(&self, kind: ModelKind) -> &ObjectConfig {
        match kind {
            ModelKind::Radiance | ModelKind::Reflective => &self.constant,
            ModelKind::Olat | ModelKind::Auto => &self.lamps,
        }
    }
}

/// Optional parts of a model, selected by short fits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub struct Parts {
    /// True if surfaces are glossy, in kinds with that choice.
    pub specular: bool,
    /// True if light scatters under surfaces.
    pub scattering: bool,
}

impl Parts {
    /// A configuration with these parts and no others.
    pub(super) fn of(self, config: &ObjectConfig) -> ObjectConfig {
        let mut config = config.clone();
        config.model.specular = self.specular;
        config.model.scattering = self.scattering;
        config
    }
}

/// Steps below which opacities, scales and colours have higher rates (docs/lab/objects.md).
const RATE_STEPS: usize = 3200;

/// Weights of the mean scale, in pixels, and of the mean opacity in the loss. Kheradmand et al. (2024) have the second
/// and much less of the first, 0.01 in units of some 250 pixels (docs/lab/objects.md).
const PRIOR: (f32, f32) = (3e-3, 0.01);

/// Settings of trainings on objects that differ from those on ground. Lengths are in pixels at the object's centre.
fn for_objects(train: TrainOptions, seed: u64) -> TrainOptions {
    TrainOptions {
        seed,
        final_rate: 0.02,
        opacity_rate: 0.05,
        // Level parts of an object need few Gaussians.
        scale_gsd: (0.1, 60.0),
        // Held-out tiles would be holes in the object.
        holdout: 0.0,
        density: DensityOptions {
            // A hull is coarser than a swept surface: it first finds its shape, then grows faster.
            from: 300,
            growth: 0.15,
            gradient_threshold: 0.1,
            split_gsd: 2.0,
            prune_gsd: 120.0,
            ..train.density
        },
        own_rate_steps: RATE_STEPS,
        prior_weights: PRIOR,
        turn_cameras: true,
        ..train
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_parses_and_asks_no_ground_of_an_object() {
        for preset in [Preset::Fast, Preset::Balanced, Preset::Accurate] {
            let configs = ObjectConfigs::resolve(preset, &[], 3).expect("a sound preset");
            for config in [configs.of(ModelKind::Radiance), configs.of(ModelKind::Olat)] {
                assert_eq!((config.train.seed, config.train.consistency_weight), (3, 0.0));
            }
        }
        let refused = ObjectConfigs::resolve(Preset::Best, &[], 1).expect_err("of satellite scenes only");
        assert!(refused.to_string().contains("fast, balanced or accurate"), "{refused}");
        let set = [("model.network_layers".to_owned(), "0".to_owned())];
        let refused = ObjectConfigs::resolve(Preset::Fast, &set, 1).expect_err("a network needs a layer");
        assert!(refused.to_string().contains("1 to 8"), "{refused}");
        let set = [("model.sh_degree".to_owned(), "1".to_owned())];
        assert_eq!(
            ObjectConfigs::resolve(Preset::Fast, &set, 1)
                .expect("a known key")
                .constant
                .model
                .sh_degree,
            1
        );
    }
}
