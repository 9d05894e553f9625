//! The configuration of a satellite run: data, not code. Presets are files, `--set a.b=c` changes one value, and the
//! resolved configuration is written beside every result.

use heliosplat::shade::sh::MAX_DEGREE;
use heliosplat::train::{TrainError, TrainOptions};
use std::path::PathBuf;

/// Why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// A preset file that does not parse (a fault of the program, not of the user).
    #[error("preset {name}: {reason}")]
    Preset {
        /// The preset.
        name: String,
        /// What the parser says.
        reason: String,
    },
    /// A value that means nothing.
    #[error("{key} is {value}, expected {expected}")]
    Value {
        /// The key.
        key: String,
        /// The value.
        value: String,
        /// What it may be.
        expected: &'static str,
    },
    /// A `--set` that does not fit.
    #[error("--set {key}={value}: {reason}; the keys are those of run.toml, such as train.iterations=2000")]
    Set {
        /// The key.
        key: String,
        /// The value.
        value: String,
        /// What is wrong.
        reason: String,
    },
}

/// How Gaussians start on the swept surface. Lengths in cells, which are one ground sampling distance wide.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StartOptions {
    /// Width of a cell, ground sampling distances: one Gaussian per cell.
    pub cell_gsd: f64,
    /// Standard deviation in the surface, cells.
    pub spread_cells: f32,
    /// Standard deviation across the surface, cells.
    pub thickness_cells: f32,
    /// Opacity.
    pub opacity: f32,
    /// Opacity of what stands near a step, above ground that is laid beneath it: training decides which of them is there.
    pub step_opacity: f32,
    /// Height of a step from which on it gets a wall, metres.
    pub wall_from_m: f32,
    /// Vertical distance between the discs of a wall, cells.
    pub wall_pitch_cells: f32,
    /// Share of the images that must show a cell for Gaussians to start there; two always must.
    pub coverage: f64,
    /// Whether Gaussians start at tie points that the surface misses.
    pub ties: bool,
    /// Ground added around the area, metres, so that shadows can fall into it.
    pub margin_m: f64,
}

impl Default for StartOptions {
    fn default() -> Self {
        Self {
            cell_gsd: 1.0,
            spread_cells: 0.65,
            thickness_cells: 0.2,
            opacity: 0.99,
            step_opacity: 0.35,
            wall_from_m: 2.0,
            wall_pitch_cells: 2.0,
            coverage: 0.4,
            ties: true,
            margin_m: 4.0,
        }
    }
}

/// When the images' relative pointing is estimated and corrected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Align {
    /// Estimate; correct when an image is off by more than the threshold.
    Auto,
    /// Estimate and correct.
    On,
    /// Believe the cameras.
    Off,
}

/// How the images' relative pointing is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PointingMethod {
    /// Whole images laid on a common surface and correlated.
    Shifts,
    /// Tie points and a robust adjustment, as `heliosplat adjust` does.
    Ties,
}

/// What is done about the cameras.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraOptions {
    /// Relative pointing.
    pub align: Align,
    /// How it is estimated.
    pub method: PointingMethod,
    /// Shift above which `auto` corrects, pixels.
    pub threshold_px: f32,
    /// Whether training moves the images against each other too, until they show the same.
    pub refine: bool,
}

impl Default for CameraOptions {
    fn default() -> Self {
        Self {
            align: Align::Auto,
            method: PointingMethod::Ties,
            threshold_px: 0.1,
            refine: false,
        }
    }
}

/// The satellite model's components.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelOptions {
    /// Per-image affine colour: on when images are of more than one date.
    pub image_colour: Option<bool>,
    /// Whether clouds are found before anything else and left out: with enough views, unless said.
    pub clouds: Option<bool>,
    /// Whether values that images clip count as "at least": where some are clipped, unless said.
    pub saturation: Option<bool>,
    /// Near-surface light in shadows, per Gaussian.
    pub near_light: bool,
    /// Largest degree of the spherical harmonics by which albedo (and near-surface light) changes with the viewing direction, 0 to 3;
    /// 0: the same from everywhere.
    pub sh_degree: usize,
    /// Surfaces are as bright as they face the sun.
    pub facing: bool,
    /// Weight of the shadow opaqueness loss; 0, off, is better on every site measured (docs/lab/components.md).
    pub opaqueness_weight: f32,
    /// Whether shadows that images show as dark places guide training: with few views, unless said.
    pub shadow_prior: Option<bool>,
    /// Weight of that guidance.
    pub prior_weight: f32,
    /// Folder of masks that say what is lit (1) and what in shadow (0), `NAME.tif` for the image `NAME`, in place of those that are
    /// found.
    pub shadow_masks: Option<PathBuf>,
    /// Sky light at the start, as a share of the sun's.
    pub sky: f32,
}

impl Default for ModelOptions {
    fn default() -> Self {
        Self {
            image_colour: None,
            clouds: None,
            saturation: None,
            near_light: false,
            sh_degree: 0,
            facing: true,
            opaqueness_weight: 0.0,
            shadow_prior: None,
            prior_weight: 1.0,
            shadow_masks: None,
            sky: 0.3,
        }
    }
}

/// Everything that decides a satellite run besides its scene.
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

fn preset_text(name: &str) -> &'static str {
    match name {
        "fast" => include_str!("../../presets/fast.toml"),
        "accurate" => include_str!("../../presets/accurate.toml"),
        _ => include_str!("../../presets/balanced.toml"),
    }
}

impl SatelliteConfig {
    /// The defaults, then the preset's file, then the `--set` pairs in their order.
    ///
    /// # Errors
    /// [`ConfigError::Set`] for a key that does not exist or a value of another kind, [`ConfigError::Value`] for one that means
    /// nothing.
    pub fn resolve(preset: &str, set: &[(String, String)], seed: u64) -> Result<Self, ConfigError> {
        let mut config: Self = resolve(preset, preset_text(preset), set)?;
        config.train.seed = seed;
        config.check()?;
        Ok(config)
    }

    /// Whether every value means something.
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
        let (s, m) = (&self.start, &self.model);
        let above_zero = |v: f64| v > 0.0 && v.is_finite();
        let not_negative = |v: f64| v >= 0.0 && v.is_finite();
        let inside = |v: f32| v > 0.0 && v < 1.0;
        const ABOVE_ZERO: &str = "a finite number above zero";
        const NOT_NEGATIVE: &str = "a finite number that is not negative";
        const INSIDE: &str = "a number between 0 and 1, neither of them";
        for (key, value, fits, expected) in [
            ("start.cell_gsd", s.cell_gsd, above_zero(s.cell_gsd), ABOVE_ZERO),
            (
                "start.spread_cells",
                s.spread_cells.into(),
                above_zero(s.spread_cells.into()),
                ABOVE_ZERO,
            ),
            (
                "start.thickness_cells",
                s.thickness_cells.into(),
                above_zero(s.thickness_cells.into()),
                ABOVE_ZERO,
            ),
            (
                "start.wall_pitch_cells",
                s.wall_pitch_cells.into(),
                above_zero(s.wall_pitch_cells.into()),
                ABOVE_ZERO,
            ),
            (
                "start.wall_from_m",
                s.wall_from_m.into(),
                not_negative(s.wall_from_m.into()),
                NOT_NEGATIVE,
            ),
            ("start.margin_m", s.margin_m, not_negative(s.margin_m), NOT_NEGATIVE),
            ("start.opacity", s.opacity.into(), inside(s.opacity), INSIDE),
            (
                "start.step_opacity",
                s.step_opacity.into(),
                inside(s.step_opacity),
                INSIDE,
            ),
            (
                "start.coverage",
                s.coverage,
                (0.0..=1.0).contains(&s.coverage),
                "a number from 0 to 1",
            ),
            ("model.sky", m.sky.into(), above_zero(m.sky.into()), ABOVE_ZERO),
            (
                "model.sh_degree",
                m.sh_degree as f64,
                m.sh_degree <= MAX_DEGREE,
                "a whole number from 0 to 3",
            ),
            (
                "model.prior_weight",
                m.prior_weight.into(),
                not_negative(m.prior_weight.into()),
                NOT_NEGATIVE,
            ),
            (
                "model.opaqueness_weight",
                m.opaqueness_weight.into(),
                not_negative(m.opaqueness_weight.into()),
                NOT_NEGATIVE,
            ),
        ] {
            if !fits {
                return Err(ConfigError::Value {
                    key: key.into(),
                    value: value.to_string(),
                    expected,
                });
            }
        }
        Ok(())
    }
}

/// The defaults of a configuration, then the text of a preset, then the `--set` pairs in their order.
///
/// # Errors
/// [`ConfigError::Set`] for a key that does not exist or a value of another kind.
pub(crate) fn resolve<T: serde::de::DeserializeOwned>(
    preset: &str,
    text: &str,
    set: &[(String, String)],
) -> Result<T, ConfigError> {
    let fault = |reason: String| ConfigError::Preset {
        name: preset.into(),
        reason,
    };
    let mut table: toml::Table = text.parse().map_err(|e: toml::de::Error| fault(e.to_string()))?;
    let parse = |table: &toml::Table| table.clone().try_into::<T>().map_err(|e| e.to_string());
    parse(&table).map_err(fault)?;
    for (key, value) in set {
        let error = |reason: String| ConfigError::Set {
            key: key.clone(),
            value: value.clone(),
            reason,
        };
        insert(&mut table, key, parse_value(value)).map_err(error)?;
        parse(&table).map_err(|e| error(e.lines().next().unwrap_or("does not fit").to_owned()))?;
    }
    parse(&table).map_err(fault)
}

/// A TOML value where the text is one, a string otherwise.
fn parse_value(text: &str) -> toml::Value {
    format!("v = {text}")
        .parse::<toml::Table>()
        .ok()
        .and_then(|mut t| t.remove("v"))
        .unwrap_or_else(|| toml::Value::String(text.into()))
}

fn insert(table: &mut toml::Table, key: &str, value: toml::Value) -> Result<(), String> {
    match key.split_once('.') {
        None => {
            table.insert(key.into(), value);
            Ok(())
        }
        Some((head, rest)) => {
            let inner = table
                .entry(head)
                .or_insert_with(|| toml::Value::Table(toml::Table::new()));
            let inner = inner.as_table_mut().ok_or_else(|| format!("{head} is not a section"))?;
            insert(inner, rest, value)
        }
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
        for preset in ["fast", "balanced", "accurate"] {
            assert!(SatelliteConfig::resolve(preset, &[], 3).is_ok_and(|c| c.train.seed == 3));
        }
    }

    #[test]
    fn one_value_can_be_set() {
        let config = SatelliteConfig::resolve("fast", &set("train.density.cap", "1000"), 1).expect("a known key");
        assert_eq!(config.train.density.cap, 1000);
        let config = SatelliteConfig::resolve("fast", &set("cameras.align", "off"), 1).expect("a known key");
        assert_eq!(config.cameras.align, Align::Off);
        let config = SatelliteConfig::resolve("fast", &set("cameras.method", "shifts"), 1).expect("a known key");
        assert_eq!(config.cameras.method, PointingMethod::Shifts);
        let config = SatelliteConfig::resolve("fast", &set("model.sh_degree", "3"), 1).expect("a known key");
        assert_eq!(config.model.sh_degree, 3);
    }

    #[test]
    fn a_value_that_means_nothing_is_named() {
        for (key, value) in [
            ("start.cell_gsd", "0.0"),
            ("start.opacity", "1.0"),
            ("model.sky", "-0.1"),
            ("model.sh_degree", "4"),
            ("train.scale_gsd", "[8.0, 0.1]"),
            ("train.lambda_ssim", "nan"),
        ] {
            let error = SatelliteConfig::resolve("fast", &set(key, value), 1).expect_err(key);
            assert!(error.to_string().starts_with(key), "{error}");
        }
    }

    #[test]
    fn an_unknown_key_is_named() {
        let error = SatelliteConfig::resolve("fast", &set("train.iteration", "5"), 1).expect_err("no such key");
        assert!(error.to_string().contains("train.iteration=5"), "{error}");
        let error = SatelliteConfig::resolve("fast", &set("model.sh_degree", "-1"), 1).expect_err("no such degree");
        assert!(error.to_string().contains("model.sh_degree=-1"), "{error}");
    }
}
