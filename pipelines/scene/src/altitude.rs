//! The altitudes a scene's surface may have: said by the user, by its files, or by the cameras' validity.

use super::SceneError;

/// What one image's files say about altitude, metres above the ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stated {
    /// `min_alt` and `max_alt` of a Sat-NeRF JSON.
    pub(super) json_m: Option<(f64, f64)>,
    /// The range of heights its RPC is made for.
    pub(super) rpc_m: (f64, f64),
}

/// Surfaces on Earth lie between the Dead Sea and Everest, metres.
const EARTH_M: (f64, f64) = (-500.0, 9000.0);

/// The range to use and where it comes from: the option, `scene.toml`, the JSONs together, or what all RPCs are valid for.
pub(super) fn choose(
    option_m: Option<(f64, f64)>,
    manifest_m: Option<(f64, f64)>,
    stated: &[Stated],
    warnings: &mut Vec<String>,
) -> Result<((f64, f64), String), SceneError> {
    if let Some(range) = option_m {
        return checked(range, "as given");
    }
    if let Some(range) = manifest_m {
        return checked(range, "from scene.toml");
    }
    let from_json = stated
        .iter()
        .filter_map(|image| image.json_m)
        .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    if let Some(range) = from_json {
        return checked(range, "from min_alt and max_alt of the JSON files");
    }
    let valid = stated.iter().fold(EARTH_M, |range, image| {
        (range.0.max(image.rpc_m.0), range.1.min(image.rpc_m.1))
    });
    let (range, source) = checked(valid, "from the RPC cameras' height range")?;
    warnings.push(format!(
        "altitudes from {:.0} to {:.0} m are searched, which is all its RPC cameras allow; --altitude MIN,MAX makes it faster and safer",
        range.0, range.1
    ));
    Ok((range, source))
}

fn checked((low_m, high_m): (f64, f64), origin: &str) -> Result<((f64, f64), String), SceneError> {
    // Written so that values that are no numbers fail too.
    if low_m < high_m && low_m >= EARTH_M.0 - 500.0 && high_m <= EARTH_M.1 + 500.0 {
        Ok(((low_m, high_m), origin.to_owned()))
    } else {
        Err(SceneError::AltitudeRange {
            low_m,
            high_m,
            origin: origin.to_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(json_m: Option<(f64, f64)>, rpc_m: (f64, f64)) -> Stated {
        Stated { json_m, rpc_m }
    }

    #[test]
    fn the_user_wins_then_the_files_then_the_cameras() {
        let images = [
            image(Some((10.0, 50.0)), (-50.0, 900.0)),
            image(Some((5.0, 40.0)), (0.0, 950.0)),
        ];
        let mut warnings = Vec::new();
        let mut range =
            |option, manifest, images: &[Stated]| choose(option, manifest, images, &mut warnings).expect("a range").0;
        assert_eq!(range(Some((1.0, 2.0)), Some((3.0, 4.0)), &images), (1.0, 2.0));
        assert_eq!(range(None, Some((3.0, 4.0)), &images), (3.0, 4.0));
        assert_eq!(range(None, None, &images), (5.0, 50.0));
        let bare = [image(None, (-50.0, 900.0)), image(None, (0.0, 950.0))];
        assert_eq!(range(None, None, &bare), (0.0, 900.0));
        assert_eq!(warnings.len(), 1);
    }

    #[test]
    fn a_range_upside_down_or_off_the_earth_is_an_error() {
        for bad in [(5.0, 5.0), (9.0, 1.0), (f64::NAN, 3.0), (0.0, 1e6)] {
            assert!(choose(Some(bad), None, &[], &mut Vec::new()).is_err(), "{bad:?}");
        }
    }
}
