//! Configuration of a satellite run. Presets are files, `--set a.b=c` changes one value, and the resolved configuration
//! is written with every result.

use heliosplat::shade::sh::MAX_DEGREE;
use heliosplat::train::{TrainError, TrainOptions};
use heliosplat_fitting::settings::{ConfigError, Preset, resolve};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Allowed widths of a cell, ground sampling distances: images resolve nothing finer, and coarser cells show no
/// building.
const CELL_GSD: std::ops::RangeInclusive<f64> = 0.25..=100.0;

/// Options of the initial Gaussians on the swept surface.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StartOptions {
    /// Width of a cell, ground sampling distances; each cell gets one Gaussian. 2 where memory or time is limited, 1.5
    /// in the ablation.
    pub cell_gsd: f64,
}

impl Default for StartOptions {
    fn default() -> Self {
        Self { cell_gsd: 1.0 }
    }
}

/// Correction of the images' relative pointing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Align {
    /// Estimate, and correct if an image is off by more than a tenth of a pixel.
    #[default]
    Auto,
    /// Estimate and correct.
    On,
    /// Use the cameras as delivered.
    Off,
}

/// Shift above which [`Align::Auto`] corrects, pixels. Shifts from ties have a precision of 0.03 px; below a tenth they
/// may be noise, and accurate cameras are better left unchanged.
pub(super) const THRESHOLD_PX: f32 = 0.1;

/// Options of the cameras.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraOptions {
    /// Correction of the relative pointing, from tie points and a robust adjustment: `off` for cameras that were
    /// adjusted already, `on` for corrections of less than a tenth of a pixel too.
    pub align: Align,
    /// Known corrections, columns and rows by image name, pixels; none are estimated where there are any.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub shifts_px: BTreeMap<String, [f32; 2]>,
    /// Names of images that are left out because known ties contradict their cameras.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<String>,
}

/// Components of the satellite model. The plan decides those that are not set.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelOptions {
    /// Affine colour of each image; by default on for images of several dates, off for images of one date.
    pub image_colour: Option<bool>,
    /// Detection of clouds, which are left out of training; by default on for five and more views. Off for images that
    /// are known to be clear.
    pub clouds: Option<bool>,
    /// Search for changed ground (built or torn down); by default on if every image has a date and a day divides them
    /// with two or more on either side. Off for ground that is known to be unchanged.
    pub change: Option<bool>,
    /// Clipped values as lower bounds; by default on if some values are clipped.
    pub saturation: Option<bool>,
    /// Near-surface light in shadows, for each Gaussian; by default off, since no measured scene was better with it
    /// (docs/lab/planner.md).
    pub near_light: bool,
    /// Largest degree of the spherical harmonics of albedo (and near-surface light) in the viewing direction: 0
    /// (isotropic, the default) for matt ground, up to 3 for glossy ground.
    pub sh_degree: usize,
    /// Guidance of training by dark places as hints of shadows; by default on for fewer than eight images.
    pub shadow_prior: Option<bool>,
    /// Folder of the user's masks of light (1) and shadow (0), `NAME.tif` for the image `NAME`, instead of detected
    /// shadows.
    pub shadow_masks: Option<PathBuf>,
}

/// Configuration of a satellite run.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SatelliteConfig {
    /// Options of the training.
    pub train: TrainOptions,
    /// Options of the initial Gaussians.
    pub start: StartOptions,
    /// Options of the cameras.
    pub cameras: CameraOptions,
    /// Components of the model.
    pub model: ModelOptions,
}

fn preset_text(preset: Preset) -> &'static str {
    match preset {
        Preset::Preview => include_str!("../presets/preview.toml"),
        Preset::Fast => include_str!("../presets/fast.toml"),
        Preset::Balanced => include_str!("../presets/balanced.toml"),
        Preset::Accurate => include_str!("../presets/accurate.toml"),
        Preset::Best => include_str!("../presets/best.toml"),
    }
}

impl SatelliteConfig {
    /// Configuration from the defaults, then the preset's file, then the `--set` pairs in their order.
    ///
    /// # Errors
    /// [`ConfigError::Set`] for an unknown key or a value of another type, [`ConfigError::Value`] for a value outside
    /// of its range.
    pub fn resolve(preset: Preset, set: &[(String, String)], seed: u64) -> Result<Self, ConfigError> {
        let mut config: Self = resolve(preset.name(), preset_text(preset), set)?;
        config.train.seed = seed;
        config.check()?;
        Ok(config)
    }

    /// Checks that every value is in its range.
    fn check(&self) -> Result<(), ConfigError> {
        if let Err(TrainError::Option {
            option,
            value,
            expected,
        }) = self.train.check()
        {
            let key = format!("train.{option}");
            return Err(ConfigError::Value { key, value, expected });
        }
        let (cell_gsd, degree) = (self.start.cell_gsd, self.model.sh_degree);
        let in_range = CELL_GSD.contains(&cell_gsd);
        ConfigError::check(&[
            ("start.cell_gsd", cell_gsd, in_range, "a number from 0.25 to 100"),
            (
                "model.sh_degree",
                degree as f64,
                degree <= MAX_DEGREE,
                "a whole number from 0 to 3",
            ),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(key: &str, value: &str) -> Vec<(String, String)> {
        vec![(key.into(), value.into())]
    }

    #[test]
    fn every_preset_parses() {
        for preset in Preset::ALL {
            assert!(SatelliteConfig::resolve(preset, &[], 3).is_ok_and(|c| c.train.seed == 3));
        }
    }

    #[test]
    fn one_value_can_be_set() {
        let config = SatelliteConfig::resolve(Preset::Fast, &set("train.density.cap", "1000"), 1).expect("a known key");
        assert_eq!(config.train.density.cap, 1000);
        let config = SatelliteConfig::resolve(Preset::Fast, &set("cameras.align", "off"), 1).expect("a known key");
        assert_eq!(config.cameras.align, Align::Off);
        let config = SatelliteConfig::resolve(Preset::Fast, &set("model.sh_degree", "3"), 1).expect("a known key");
        assert_eq!(config.model.sh_degree, 3);
    }

    #[test]
    fn a_value_that_means_nothing_is_named() {
        for (key, value) in [
            ("start.cell_gsd", "1e-3"),
            ("start.cell_gsd", "1e300"),
            ("model.sh_degree", "4"),
            ("train.pyramid_share", "1.5"),
            ("train.position_rate_gsd", "nan"),
        ] {
            let error = SatelliteConfig::resolve(Preset::Fast, &set(key, value), 1).expect_err(key);
            assert!(error.to_string().starts_with(key), "{error}");
        }
    }

    #[test]
    fn an_unknown_key_is_named() {
        let error = SatelliteConfig::resolve(Preset::Fast, &set("train.iteration", "5"), 1).expect_err("no such key");
        assert!(error.to_string().contains("train.iteration=5"), "{error}");
        let error =
            SatelliteConfig::resolve(Preset::Fast, &set("model.sh_degree", "-1"), 1).expect_err("no such degree");
        assert!(error.to_string().contains("model.sh_degree=-1"), "{error}");
    }

    #[test]
    fn what_the_program_decides_is_no_key() {
        for key in ["train.seed", "train.gsd_m", "train.holdout", "train.density.growth"] {
            let error = SatelliteConfig::resolve(Preset::Fast, &set(key, "1"), 1).expect_err(key);
            assert!(error.to_string().contains("unknown field"), "{error}");
        }
    }
}
