//! What the bands of a file show: read from descriptions and colour interpretation, guessed from their number last.

use super::{BandKind, SceneError};
use heliosplat_raster::{BandInfo, Colour, RasterFile};

/// Vegetation index above which a pixel is taken for vegetation.
pub const VEGETATION_INDEX: f32 = 0.3;

/// Less light than this says nothing of colour.
const DARKEST: f32 = 1e-3;

/// Places of red and near infrared among the bands, if both are there.
pub fn vegetation_bands(bands: &[BandKind]) -> Option<(usize, usize)> {
    let place = |kind: BandKind| bands.iter().position(|&band| band == kind);
    Some((place(BandKind::Red)?, place(BandKind::NearInfrared)?))
}

/// `(n - r) / (n + r)`: the normalised difference vegetation index (Rouse et al. 1974).
pub fn vegetation_index(red: f32, near_infrared: f32) -> f32 {
    normalised_difference(near_infrared, red)
}

/// `(a - b) / (a + b)` of two bands, near zero where both are dark.
pub fn normalised_difference(a: f32, b: f32) -> f32 {
    (a - b) / (a + b).max(DARKEST)
}

/// Which bands of a file become which bands of the scene.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BandPlan {
    /// 0-based bands of the file, in the order red, green, blue, near infrared where those are known.
    pub(super) file_bands: Vec<usize>,
    /// What they are.
    pub(super) kinds: Vec<BandKind>,
    /// A band of opacity.
    pub(super) alpha: Option<usize>,
    /// What had to be assumed.
    pub(super) assumption: Option<String>,
}

/// Finds out what a file's bands are; `declared` (one per file band) wins over what the file says.
pub(super) fn plan(file: &RasterFile, declared: Option<&[BandKind]>) -> Result<BandPlan, SceneError> {
    if file.bands.iter().any(|band| band.colour == Colour::Palette) {
        return Err(SceneError::Palette(file.path().to_owned()));
    }
    if let Some(declared) = declared {
        if declared.len() != file.bands.len() {
            return Err(SceneError::Manifest {
                path: file.path().to_owned(),
                reason: format!(
                    "it has {} bands, but scene.toml declares {}; correct `bands` there",
                    file.bands.len(),
                    declared.len()
                ),
            });
        }
        return Ok(ordered(declared, &(0..declared.len()).collect::<Vec<_>>(), None, None));
    }
    Ok(from_infos(&file.bands, is_maxar(file)))
}

/// Maxar delivers four bands as blue, green, red, near infrared; Pleiades, SPOT and most others as red, green, blue, NIR.
fn is_maxar(file: &RasterFile) -> bool {
    let maxar_reader = file.domain("").get("METADATATYPE").is_some_and(|kind| kind == "DG");
    let satellite = file.domain("IMAGERY").get("SATELLITEID").cloned().unwrap_or_default();
    let satellite = satellite.trim_matches('"');
    maxar_reader || ["WV", "QB", "GE01"].iter().any(|name| satellite.starts_with(name))
}

fn from_infos(bands: &[BandInfo], maxar: bool) -> BandPlan {
    use BandKind::{Blue, Green, NearInfrared, Other, Pan, Red};
    let alpha = bands.iter().position(|band| band.colour == Colour::Alpha);
    let data: Vec<usize> = (0..bands.len()).filter(|&index| Some(index) != alpha).collect();
    let described: Vec<BandKind> = data
        .iter()
        .map(|&index| from_description(&bands[index].description))
        .collect();
    if described.iter().any(|&kind| kind != Other) {
        return ordered(&described, &data, alpha, None);
    }
    let coloured: Vec<BandKind> = data.iter().map(|&index| from_colour(bands[index].colour)).collect();
    let has_rgb = [Red, Green, Blue].iter().all(|kind| coloured.contains(kind));
    // Red, green, blue and one band of unknown colour: near infrared, as every satellite has it.
    if has_rgb && data.len() <= 4 {
        let kinds: Vec<BandKind> = coloured
            .iter()
            .map(|&kind| if kind == Other { NearInfrared } else { kind })
            .collect();
        return ordered(&kinds, &data, alpha, None);
    }
    let assumed = |what: &str| Some(format!("its bands have no names; assumed to be {what}"));
    match data.len() {
        1 => ordered(&[Pan], &data, alpha, None),
        3 => ordered(&[Red, Green, Blue], &data, alpha, assumed("red, green, blue")),
        4 if maxar => ordered(
            &[Blue, Green, Red, NearInfrared],
            &data,
            alpha,
            assumed("blue, green, red, near infrared (Maxar order)"),
        ),
        4 => ordered(
            &[Red, Green, Blue, NearInfrared],
            &data,
            alpha,
            assumed("red, green, blue, near infrared"),
        ),
        8 => ordered(
            &[Other, Blue, Green, Other, Red, Other, NearInfrared, Other],
            &data,
            alpha,
            assumed(
                "the eight bands of WorldView-2 and -3, of which red, green, blue and the first near infrared are used",
            ),
        ),
        count => ordered(&vec![Other; count], &data, alpha, assumed("just different")),
    }
}

/// Puts known colours into the order red, green, blue, near infrared and leaves the rest out; without red, green and blue
/// all bands stay as they are.
fn ordered(kinds: &[BandKind], files: &[usize], alpha: Option<usize>, assumption: Option<String>) -> BandPlan {
    use BandKind::{Blue, Green, NearInfrared, Red};
    let find = |wanted: BandKind| kinds.iter().position(|&kind| kind == wanted);
    let has_rgb = [Red, Green, Blue].into_iter().all(|kind| find(kind).is_some());
    let picked: Vec<usize> = if has_rgb {
        [Red, Green, Blue, NearInfrared].into_iter().filter_map(find).collect()
    } else {
        (0..kinds.len()).collect()
    };
    BandPlan {
        file_bands: picked.iter().map(|&index| files[index]).collect(),
        kinds: picked.iter().map(|&index| kinds[index]).collect(),
        alpha,
        assumption,
    }
}

fn from_description(description: &str) -> BandKind {
    let text = description.to_lowercase().replace(['_', '-', ' '], "");
    let has = |part: &str| text.contains(part);
    match text.as_str() {
        "r" => return BandKind::Red,
        "g" => return BandKind::Green,
        "b" => return BandKind::Blue,
        "n" | "p" => {
            return if text == "n" {
                BandKind::NearInfrared
            } else {
                BandKind::Pan
            };
        }
        _ => {}
    }
    // The second near-infrared band of WorldView is not the one whose colours are known from other satellites.
    if has("nir2") || has("rededge") || has("coastal") || has("yellow") || has("deepblue") || has("swir") {
        BandKind::Other
    } else if has("nir") || has("infrared") {
        BandKind::NearInfrared
    } else if has("pan") {
        BandKind::Pan
    } else if has("red") {
        BandKind::Red
    } else if has("green") {
        BandKind::Green
    } else if has("blue") {
        BandKind::Blue
    } else {
        BandKind::Other
    }
}

fn from_colour(colour: Colour) -> BandKind {
    match colour {
        Colour::Red => BandKind::Red,
        Colour::Green => BandKind::Green,
        Colour::Blue => BandKind::Blue,
        _ => BandKind::Other,
    }
}

/// The bands in words, such as `3 bands (red, green, blue)`.
pub(super) fn in_words(kinds: &[BandKind]) -> String {
    let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
    let plural = if kinds.len() == 1 { "" } else { "s" };
    format!("{} band{plural} ({})", kinds.len(), names.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use BandKind::{Blue, Green, NearInfrared, Pan, Red};

    fn band(description: &str, colour: Colour) -> BandInfo {
        BandInfo {
            description: description.to_owned(),
            colour,
            data_type: "UInt16".to_owned(),
            unit: String::new(),
            nodata: None,
        }
    }

    #[test]
    fn one_grey_band_is_panchromatic() {
        let plan = from_infos(&[band("", Colour::Grey)], false);
        assert_eq!((plan.kinds, plan.assumption), (vec![Pan], None));
    }

    #[test]
    fn descriptions_win_over_order() {
        let names = ["Blue", "Green", "Red", "NIR"];
        let bands: Vec<_> = names.iter().map(|name| band(name, Colour::Undefined)).collect();
        let plan = from_infos(&bands, false);
        assert_eq!(plan.file_bands, vec![2, 1, 0, 3]);
        assert_eq!(plan.kinds, vec![Red, Green, Blue, NearInfrared]);
        assert_eq!(plan.assumption, None);
    }

    #[test]
    fn a_fourth_band_beside_red_green_blue_is_near_infrared_unless_it_is_opacity() {
        let mut bands = vec![
            band("", Colour::Red),
            band("", Colour::Green),
            band("", Colour::Blue),
            band("", Colour::Undefined),
        ];
        assert_eq!(from_infos(&bands, false).kinds, vec![Red, Green, Blue, NearInfrared]);
        bands[3].colour = Colour::Alpha;
        let plan = from_infos(&bands, false);
        assert_eq!((plan.kinds, plan.alpha), (vec![Red, Green, Blue], Some(3)));
    }

    #[test]
    fn eight_unnamed_bands_are_worldview() {
        let bands: Vec<_> = (0..8).map(|_| band("", Colour::Undefined)).collect();
        let plan = from_infos(&bands, true);
        assert_eq!(plan.file_bands, vec![4, 2, 1, 6]);
        assert!(plan.assumption.is_some());
    }

    #[test]
    fn four_unnamed_maxar_bands_start_with_blue() {
        let bands: Vec<_> = (0..4).map(|_| band("", Colour::Undefined)).collect();
        assert_eq!(from_infos(&bands, true).file_bands, vec![2, 1, 0, 3]);
        assert_eq!(from_infos(&bands, false).file_bands, vec![0, 1, 2, 3]);
    }

    #[test]
    fn the_red_edge_is_not_red() {
        let names = ["coastal", "blue", "green", "yellow", "red", "red edge", "nir1", "nir2"];
        let bands: Vec<_> = names.iter().map(|name| band(name, Colour::Undefined)).collect();
        assert_eq!(from_infos(&bands, false).file_bands, vec![4, 2, 1, 6]);
    }
}
