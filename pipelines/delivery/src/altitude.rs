//! Altitude range of a scene: stated by the user or the files, estimated from tie points, or the validity range of the
//! cameras.

use super::{Result, SceneError};

/// Source of an altitude range.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AltitudeSource {
    /// Stated by the user, by `scene.toml`, or by the JSON files of the images.
    Given,
    /// Estimated from tie points between the images.
    Ties,
    /// Validity range of the RPCs.
    Cameras,
}

/// Altitudes that the surface may have, metres above the ellipsoid.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct AltitudeRange {
    /// Lowest altitude, metres.
    pub low_m: f64,
    /// Highest altitude, metres.
    pub high_m: f64,
    /// Source of the range.
    pub source: AltitudeSource,
    /// Source of the range, in words.
    pub words: String,
}

impl AltitudeRange {
    /// Lowest and highest altitude, metres.
    pub fn limits_m(&self) -> (f64, f64) {
        (self.low_m, self.high_m)
    }
}

/// Altitudes in the files of one image, metres above the ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Stated {
    /// `min_alt` and `max_alt` of a Sat-NeRF JSON, metres.
    pub json_m: Option<(f64, f64)>,
    /// Validity range of the RPC: height offset ± height scale, metres.
    pub rpc_m: (f64, f64),
}

/// Altitude ranges of a whole scene by source, metres above the ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct StatedAltitudes {
    /// Range requested by the user.
    pub(super) option_m: Option<(f64, f64)>,
    /// Range in `scene.toml`.
    pub(super) manifest_m: Option<(f64, f64)>,
    /// Range of the tie points.
    pub(super) ties_m: Option<(f64, f64)>,
}

/// Lowest and highest surfaces on Earth (Dead Sea, Everest), rounded outward, metres.
const EARTH_M: (f64, f64) = (-500.0, 9000.0);

/// Altitude range of a scene, from the first source that exists: the user, `scene.toml`, the union of the JSON files,
/// the tie points, and, with a warning, the common validity range of the RPCs.
pub(super) fn choose(said: StatedAltitudes, stated: &[Stated], warnings: &mut Vec<String>) -> Result<AltitudeRange> {
    let from_json = stated.iter().filter_map(|image| image.json_m);
    let from_json = from_json.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    let sources = [
        (said.option_m, AltitudeSource::Given, "as given"),
        (said.manifest_m, AltitudeSource::Given, "from scene.toml"),
        (
            from_json,
            AltitudeSource::Given,
            "from min_alt and max_alt of the JSON files",
        ),
        (said.ties_m, AltitudeSource::Ties, "from tie points between the images"),
    ];
    for (range, source, words) in sources {
        if let Some(range) = range {
            return checked(range, source, words);
        }
    }
    let words = "from the RPC cameras' height range";
    let range = checked(valid_for_all(stated), AltitudeSource::Cameras, words)?;
    warnings.push(format!(
        "altitudes from {:.0} to {:.0} m are searched, which is all its RPC cameras allow; --altitude MIN,MAX makes it faster and safer",
        range.low_m, range.high_m
    ));
    Ok(range)
}

/// Common validity range of all RPCs, metres; empty (lowest above highest) where the RPCs contradict each other.
pub(super) fn valid_for_all(stated: &[Stated]) -> (f64, f64) {
    let common = |range: (f64, f64), image: &Stated| (range.0.max(image.rpc_m.0), range.1.min(image.rpc_m.1));
    stated.iter().fold(EARTH_M, common)
}

fn checked((low_m, high_m): (f64, f64), source: AltitudeSource, origin: &str) -> Result<AltitudeRange> {
    // NaN fails this test too.
    let words = origin.to_owned();
    match low_m < high_m && low_m >= EARTH_M.0 - 500.0 && high_m <= EARTH_M.1 + 500.0 {
        true => Ok(AltitudeRange {
            low_m,
            high_m,
            source,
            words,
        }),
        false => Err(SceneError::AltitudeRange(low_m, high_m, words)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(json_m: Option<(f64, f64)>, rpc_m: (f64, f64)) -> Stated {
        Stated { json_m, rpc_m }
    }

    #[test]
    fn the_user_wins_then_the_files_then_ties_then_the_cameras() {
        let images = [
            image(Some((10.0, 50.0)), (-50.0, 900.0)),
            image(Some((5.0, 40.0)), (0.0, 950.0)),
        ];
        let bare = [image(None, (-50.0, 900.0)), image(None, (0.0, 950.0))];
        let all = StatedAltitudes {
            option_m: Some((1.0, 2.0)),
            manifest_m: Some((3.0, 4.0)),
            ties_m: Some((6.0, 7.0)),
        };
        let files = StatedAltitudes { option_m: None, ..all };
        let ties = StatedAltitudes {
            manifest_m: None,
            ..files
        };
        let mut warnings = Vec::new();
        let mut range = |said, images: &[Stated]| {
            let range = choose(said, images, &mut warnings).expect("a range");
            (range.limits_m(), range.source)
        };
        assert_eq!(range(all, &images), ((1.0, 2.0), AltitudeSource::Given));
        assert_eq!(range(files, &images), ((3.0, 4.0), AltitudeSource::Given));
        assert_eq!(range(ties, &images), ((5.0, 50.0), AltitudeSource::Given));
        assert_eq!(range(ties, &bare), ((6.0, 7.0), AltitudeSource::Ties));
        assert_eq!(
            range(StatedAltitudes::default(), &bare),
            ((0.0, 900.0), AltitudeSource::Cameras)
        );
        assert_eq!(warnings.len(), 1);
    }

    #[test]
    fn a_range_upside_down_or_off_the_earth_is_an_error() {
        for bad in [(5.0, 5.0), (9.0, 1.0), (f64::NAN, 3.0), (0.0, 1e6)] {
            let said = StatedAltitudes {
                option_m: Some(bad),
                ..StatedAltitudes::default()
            };
            assert!(choose(said, &[], &mut Vec::new()).is_err(), "{bad:?}");
        }
    }
}
