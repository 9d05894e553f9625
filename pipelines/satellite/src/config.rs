//! The configuration of a satellite run: data, not code. Presets are files, `--set a.b=c` changes one value, and the
//! resolved configuration is written with every result.

use heliosplat::shade::sh::MAX_DEGREE;
use heliosplat::train::{TrainError, TrainOptions};
use heliosplat_fitting::settings::{ConfigError, Preset, resolve};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Least and largest width of a cell, ground sampling distances: images resolve nothing finer than the least, and cells
/// of the largest show no building.
const CELL_GSD: std::ops::RangeInclusive<f64> = 0.25..=100.0;

/// Initial Gaussians on the swept surface. Lengths in cells, which are one ground sampling distance wide.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StartOptions {
    /// Width of a cell, ground sampling distances: one Gaussian per cell. 2 where memory or time is limited, 1.5 in the
    /// ablation.
    pub cell_gsd: f64,
}

impl Default for StartOptions {
    fn default() -> Self {
        Self { cell_gsd: 1.0 }
    }
}

/// Correction of the images' relative pointing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Align {
    /// Estimate; correct when an image is off by more than a tenth of a pixel.
    Auto,
    /// Estimate and correct.
    On,
    /// Believe the cameras.
    Off,
}

/// Shift, pixels, above which [`Align::Auto`] corrects. The precision of shifts from ties is 0.03 px; below a tenth
/// they may be noise, and accurate cameras are better left unchanged.
pub(super) const THRESHOLD_PX: f32 = 0.1;

/// Correction of the cameras.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraOptions {
    /// Relative pointing, from tie points and a robust adjustment. `off` where cameras were adjusted already, `on` to
    /// correct even less than a tenth of a pixel.
    pub align: Align,
    /// Corrections that were found before, columns and rows by image name, pixels; where there are any, none are looked for.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub shifts_px: BTreeMap<String, [f32; 2]>,
    /// Names of images that ties found before to contradict their cameras, and that are left out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<String>,
}

impl Default for CameraOptions {
    fn default() -> Self {
        Self {
            align: Align::Auto,
            shifts_px: BTreeMap::new(),
            left_out: Vec::new(),
        }
    }
}

/// The satellite model's components. The plan decides those that are not set.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelOptions {
    /// Per-image affine colour: on for images of more than one date, off for those of one.
    pub image_colour: Option<bool>,
    /// Detection of clouds, which are left out of training: on from five views on; off for images that are known to be
    /// clear.
    pub clouds: Option<bool>,
    /// Search for changed ground (built or torn down): on if every image has a date and a day divides them with two or
    /// more on either side; off for ground that is known to be unchanged.
    pub change: Option<bool>,
    /// Use of clipped values as lower bounds: on if some values are clipped.
    pub saturation: Option<bool>,
    /// Near-surface light in shadows, per Gaussian: off, because no scene measured was better with it
    /// (docs/lab/planner.md).
    pub near_light: bool,
    /// Largest degree of the spherical harmonics of albedo (and near-surface light) in the viewing direction: 0,
    /// isotropic, for matt ground, up to 3 for glossy ground.
    pub sh_degree: usize,
    /// Guidance of training by shadows detected as dark places: on with fewer than eight images, off with more.
    pub shadow_prior: Option<bool>,
    /// Folder of the user's masks of light (1) and shadow (0), `NAME.tif` for the image `NAME`, in place of the
    /// detected ones.
    pub shadow_masks: Option<PathBuf>,
}

/// Configuration of a satellite run.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SatelliteConfig {
    /// Training.
    pub train: TrainOptions,
    /// The start.
    pub start: StartOptions,
    /// Cameras.
    pub cameras: CameraOptions,
    /// The model.
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
    /// The defaults, then the preset's file, then the `--set` pairs in their order.
    ///
    /// # Errors
    /// [`ConfigError::Set`] for a key that does not exist or a value of another kind, [`ConfigError::Value`] for one
    /// that means nothing.
    pub fn resolve(preset: Preset, set: &[(String, String)], seed: u64) -> Result<Self, ConfigError> {
        let mut config: Self = resolve(preset.name(), preset_text(preset), set)?;
        config.train.seed = seed;
        config.check()?;
        Ok(config)
    }

    /// Checks that every value is valid.
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
