//! Named points of the comparison, each a preset and some changes to it.

use heliosplat_fitting::settings::Preset;
use heliosplat_satellite::config::SatelliteConfig;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The points that are tried unless the user brings others.
const STANDARD: &str = include_str!("tradeoff.toml");
/// Points that measure the contribution of each component of the method.
const ABLATION: &str = include_str!("ablation.toml");

/// Why a list of points cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PointsError {
    /// A file that cannot be read.
    #[error("{path}: {reason}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        reason: std::io::Error,
    },
    /// A file that is not a list of points.
    #[error("{path}: {reason}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// Description of the fault.
        reason: String,
    },
    /// `--only` leaves nothing.
    #[error("--only {0}: no point has that name or axis; there are {1}")]
    Nothing(String, String),
}

/// Seeds that a point runs with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Seeds {
    /// The first one.
    #[default]
    First,
    /// All.
    All,
}

/// One way to train.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Point {
    /// Its name: letters, digits and hyphens.
    pub name: String,
    /// Axis of the comparison that the point belongs to.
    pub axis: String,
    /// The preset it begins with.
    pub preset: String,
    /// The point it is compared with.
    #[serde(default)]
    pub base: Option<String>,
    /// Seeds of its runs.
    #[serde(default)]
    pub seeds: Seeds,
    /// Changes to the preset, as in `--set`.
    #[serde(default)]
    pub set: BTreeMap<String, toml::Value>,
    /// Purpose of the point, in a few words.
    pub why: String,
}

impl Point {
    /// The arguments of `train` that make it what it is.
    pub fn arguments(&self) -> Vec<String> {
        let mut out = vec!["--preset".to_owned(), self.preset.clone()];
        for (key, value) in &self.set {
            let value = match value {
                toml::Value::String(text) => text.clone(),
                other => other.to_string(),
            };
            out.extend(["--set".to_owned(), format!("{key}={value}")]);
        }
        out
    }
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    point: Vec<Point>,
}

/// The points of `file`, of the built-in list `ablation`, or the standard ones; with `only`, those of these names or axes and what they are compared with.
///
/// # Errors
/// [`PointsError`] for a file that is none, a point that cannot be trained, or a choice that leaves nothing.
pub fn load(file: Option<&Path>, only: &[String]) -> Result<Vec<Point>, PointsError> {
    let path = file.map_or_else(|| PathBuf::from("tradeoff.toml"), Path::to_owned);
    let text = match file {
        Some(name) if name == Path::new("ablation") => ABLATION.to_owned(),
        Some(file) => heliosplat_raster::bounded::read_text(file).map_err(|reason| PointsError::Io {
            path: path.clone(),
            reason,
        })?,
        None => STANDARD.to_owned(),
    };
    let fault = |reason: String| PointsError::Parse {
        path: path.clone(),
        reason,
    };
    let first_line = |error: &dyn std::fmt::Display| error.to_string().replace('\n', " ");
    let file: File = toml::from_str(&text).map_err(|error| fault(first_line(&error)))?;
    check(&file.point).map_err(fault)?;
    choose(file.point, only)
}

fn check(points: &[Point]) -> Result<(), String> {
    let mut names = BTreeSet::new();
    for point in points {
        let name = &point.name;
        let plain = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-');
        if !plain || name.starts_with('-') {
            return Err(format!("point '{name}': a name is letters, digits and hyphens"));
        }
        if !names.insert(name) {
            return Err(format!("point '{name}' is there twice"));
        }
        let pairs: Vec<(String, String)> = point
            .arguments()
            .iter()
            .filter_map(|argument| argument.split_once('='))
            .map(|(key, value)| (key.to_owned(), value.to_owned()))
            .collect();
        let preset = point.preset.parse();
        preset
            .and_then(|preset: Preset| SatelliteConfig::resolve(preset, &pairs, 1))
            .map_err(|error| format!("point '{name}': {error}"))?;
    }
    let missing = points
        .iter()
        .find(|p| p.base.as_ref().is_some_and(|base| !names.contains(base)));
    match missing {
        Some(point) => Err(format!("point '{}': its base is not in the list", point.name)),
        None => Ok(()),
    }
}

fn choose(points: Vec<Point>, only: &[String]) -> Result<Vec<Point>, PointsError> {
    if only.is_empty() {
        return Ok(points);
    }
    let wanted = |point: &Point| only.contains(&point.name) || only.contains(&point.axis);
    for word in only {
        if !points.iter().any(|p| p.name == *word || p.axis == *word) {
            let names: Vec<&str> = points.iter().map(|p| p.name.as_str()).collect();
            return Err(PointsError::Nothing(word.clone(), names.join(", ")));
        }
    }
    let bases: BTreeSet<String> = points
        .iter()
        .filter(|p| wanted(p))
        .filter_map(|p| p.base.clone())
        .collect();
    Ok(points
        .into_iter()
        .filter(|point| wanted(point) || bases.contains(&point.name))
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_standard_points_can_all_be_trained() {
        let points = load(None, &[]).expect("the built-in list");
        assert!(
            Preset::ALL
                .iter()
                .all(|preset| points.iter().any(|p| p.name == preset.name()))
        );
    }

    #[test]
    fn the_ablation_takes_one_component_after_another_away() {
        let points = load(Some(Path::new("ablation")), &[]).expect("the built-in list");
        assert!(points.iter().filter(|p| p.base.is_some()).count() >= 8);
        let axes: BTreeSet<&str> = points.iter().map(|p| p.axis.as_str()).collect();
        for axis in [
            "cameras",
            "start",
            "shadow physics",
            "shadow consistency",
            "shadow prior",
            "colour",
            "surface",
            "early stop",
        ] {
            assert!(axes.contains(axis), "{axis}");
        }
    }

    #[test]
    fn a_choice_brings_what_it_is_compared_with() {
        let points = load(None, &["no-image-colour".to_owned()]).expect("a known point");
        let names: Vec<&str> = points.iter().map(|p| p.name.as_str()).collect();
        assert_eq!(names, ["fast", "no-image-colour"]);
        assert!(matches!(
            load(None, &["nothing".to_owned()]),
            Err(PointsError::Nothing(..))
        ));
    }

    #[test]
    fn points_that_cannot_be_trained_are_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("points.toml");
        let fault = |text: &str| {
            std::fs::write(&file, text).expect("written");
            load(Some(&file), &[]).expect_err("a fault").to_string()
        };
        let point = "[[point]]\nname = \"a\"\naxis = \"x\"\npreset = \"fast\"\nwhy = \"w\"\n";
        assert!(fault(&format!("{point}set = {{ \"train.iteration\" = 3 }}\n")).contains("train.iteration"));
        assert!(fault(&format!("{point}{point}")).contains("twice"));
        assert!(fault(&format!("{point}base = \"b\"\n")).contains("base"));
        assert!(fault(&point.replace("\"a\"", "\"../a\"")).contains("letters"));
    }
}
