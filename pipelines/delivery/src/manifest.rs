//! `scene.toml`: a list of a scene's images, with optional metadata.

use super::{BandKind, Result, SceneError, Split};
use heliosplat_rpc::sun::SunPosition;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Content of a `scene.toml`. Paths are relative to the file.
#[derive(Debug, Clone, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Manifest {
    /// Lowest and highest altitude, metres above the ellipsoid.
    pub(super) altitude_range_m: Option<[f64; 2]>,
    /// Kinds of the bands of every file, in file order.
    pub(super) bands: Option<Vec<BandKind>>,
    /// Values proportional to radiance, or encoded for display (sRGB); `None` where each file decides.
    pub(super) counts: Option<Counts>,
    /// The images.
    #[serde(default)]
    pub(super) images: Vec<ManifestImage>,
    /// Truth files.
    pub(super) truth: Option<ManifestTruth>,
}

/// Meaning of pixel values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Counts {
    /// Values proportional to radiance, with an unknown gain.
    Linear,
    /// sRGB-encoded display values.
    Display,
}

/// An image in a `scene.toml`.
#[derive(Debug, Clone, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ManifestImage {
    /// Image file.
    pub(super) path: PathBuf,
    /// Train or test; training where absent.
    pub(super) split: Option<Split>,
    /// File with the rational camera.
    pub(super) rpc: Option<PathBuf>,
    /// Text file with time or sun angles.
    pub(super) metadata: Option<PathBuf>,
    /// Acquisition time.
    #[serde(default, deserialize_with = "time")]
    pub(super) time: Option<jiff::Timestamp>,
    /// Azimuth of the sun, degrees clockwise from north.
    pub(super) sun_azimuth_deg: Option<f64>,
    /// Elevation of the sun, degrees above the horizon.
    pub(super) sun_elevation_deg: Option<f64>,
}

/// A time as text or as a TOML date; both need a time zone.
fn time<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Option<jiff::Timestamp>, D::Error> {
    let value: toml::Value = serde::Deserialize::deserialize(deserializer)?;
    let text = match value {
        toml::Value::Datetime(time) => time.to_string(),
        toml::Value::String(text) => text,
        other => other.to_string(),
    };
    let remedy = "write time = \"2016-04-23T08:34:00Z\" (UTC)";
    let wrong = |_| serde::de::Error::custom(format!("{text:?} is no time with a zone; {remedy}"));
    text.trim().parse().map(Some).map_err(wrong)
}

/// Truth files in a `scene.toml`.
#[derive(Debug, Clone, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ManifestTruth {
    /// Raster of altitudes, metres.
    pub(super) dsm: Option<PathBuf>,
    /// Raster of classes, LAS codes.
    pub(super) classes: Option<PathBuf>,
    /// Raster of each image's shadows (1 = in cast shadow), by image name.
    #[serde(default)]
    pub(super) shadows: BTreeMap<String, PathBuf>,
}

impl Manifest {
    /// Parses the text, without resolving its paths.
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        let manifest: Self = toml::from_str(text).map_err(|error| toml_fault(&error, text))?;
        if manifest.images.is_empty() {
            return Err("it lists no images; add [[images]] tables with a path each".to_owned());
        }
        Ok(manifest)
    }

    /// Reads and checks a `scene.toml`; paths are resolved against its folder.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let fault = |reason: String| SceneError::Manifest(path.to_owned(), reason);
        let text = heliosplat_raster::bounded::read_text(path)
            .map_err(|error| SceneError::Unreadable(path.to_owned(), error.to_string()))?;
        let mut manifest = Self::parse(&text).map_err(fault)?;
        let folder = path.parent().unwrap_or_else(|| Path::new("."));
        for image in &mut manifest.images {
            let angles = [image.sun_azimuth_deg, image.sun_elevation_deg].map(Option::unwrap_or_default);
            SunPosition::stated(angles[0], angles[1])
                .map_err(|reason| fault(format!("{}: {reason}", image.path.display())))?;
            resolve(folder, &mut image.path)?;
            for path in [&mut image.rpc, &mut image.metadata].into_iter().flatten() {
                resolve(folder, path)?;
            }
        }
        if let Some(truth) = &mut manifest.truth {
            let named = [&mut truth.dsm, &mut truth.classes].into_iter().flatten();
            for path in named.chain(truth.shadows.values_mut()) {
                resolve(folder, path)?;
            }
        }
        Ok(manifest)
    }
}

fn resolve(folder: &Path, path: &mut PathBuf) -> Result<()> {
    reject_address(path)?;
    *path = folder.join(&*path);
    match path.exists() {
        true => Ok(()),
        false => Err(SceneError::Missing(path.clone())),
    }
}

/// Refuses web addresses and GDAL's virtual file systems: a scene is read from the user's disk.
pub(super) fn reject_address(path: &Path) -> Result<()> {
    let text = path.to_string_lossy();
    if text.contains("://") || text.starts_with("/vsi") {
        return Err(SceneError::Address(text.into_owned()));
    }
    Ok(())
}

/// Fault of a TOML text in one line, with its place.
pub fn toml_fault(error: &toml::de::Error, text: &str) -> String {
    let span = error.span();
    let line = span.map_or(1, |span| text[..span.start].matches('\n').count() + 1);
    let words: Vec<&str> = error.message().split_whitespace().collect();
    format!("line {line}: {}", words.join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_may_be_text_or_dates_of_toml() {
        let read = |time: &str| Manifest::parse(&format!("[[images]]\npath = \"a.tif\"\ntime = {time}\n"));
        for time in [
            "2016-04-23T08:34:00Z",
            "2016-04-23 08:34:00Z",
            "\"2016-04-23T08:34:00Z\"",
            "2016-04-23T18:34:00+10:00",
        ] {
            let found = read(time).expect(time).images[0].time.expect("a time");
            assert_eq!(found.to_string(), "2016-04-23T08:34:00Z", "{time}");
        }
        for time in ["2016-04-23T08:34:00", "\"2016-04-23T08:34:00\"", "2016-04-23", "7"] {
            let said = read(time).expect_err("no zone");
            assert!(said.contains("line 3") && said.contains("write time = "), "{said}");
        }
    }
}
