//! Kinds of the bands of a file: from descriptions, metadata, the sensor or the colour interpretation, and from the
//! number of bands if all of these are missing.

use super::files::Folders;
use super::names::{has_extension, stem};
use super::sidecars::belonging_texts;
use super::{BandKind, Result, SceneError};
use heliosplat_raster::{BandInfo, Colour, RasterFile};
use heliosplat_rpc::read::calibration::CalibratedBand;
use serde::Serialize;

/// Bands of a file that are read.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BandPlan {
    /// Indices of the bands in the file, from 0; in the order red, green, blue, near infrared where these are known.
    pub file_bands: Vec<usize>,
    /// Kind of each of these bands.
    pub kinds: Vec<BandKind>,
    /// Index of the opacity band in the file, if there is one.
    pub alpha: Option<usize>,
    /// Assumption about the bands, for a warning; `None` where the file or its metadata name them.
    #[serde(skip)]
    pub(super) assumption: Option<String>,
}

/// Kinds of the bands of a file. `declared`, one kind per file band, takes precedence over the file and its metadata.
pub(super) fn plan(file: &RasterFile, declared: Option<&[BandKind]>, folders: &Folders) -> Result<BandPlan> {
    if file.bands.iter().any(|band| band.colour == Colour::Palette) {
        return Err(SceneError::Palette(file.path().to_owned()));
    }
    if let Some(declared) = declared {
        let (own, stated) = (file.bands.len(), declared.len());
        if own != stated {
            let reason = format!("it has {own} bands, but scene.toml declares {stated}; correct `bands` there");
            return Err(SceneError::Manifest(file.path().to_owned(), reason));
        }
        return Ok(ordered(declared, &(0..declared.len()).collect::<Vec<_>>(), None, None));
    }
    let order = match dimap_order(file, folders)? {
        Some(order) => Some(order),
        None => sensor_of(file).and_then(|sensor| sensor.order(file.bands.len())),
    };
    Ok(from_infos(&file.bands, order.as_deref()))
}

/// Sensors whose files do not name their bands, but whose vendors document the order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sensor {
    /// WorldView, GeoEye, QuickBird: blue, green, red, near infrared; eight bands of WorldView-2 and -3.
    Maxar,
    /// PlanetScope: blue, green, red, near infrared; eight bands of SuperDove.
    PlanetScope,
    /// SkySat, GaoFen PMS, SuperView: blue, green, red, near infrared.
    BlueFirst,
}

impl Sensor {
    /// Band kinds of the sensor's files with this number of bands; `None` where the order is unknown.
    fn order(self, bands: usize) -> Option<Vec<BandKind>> {
        use BandKind::{Blue, Green, NearInfrared, Other, Red};
        match (self, bands) {
            (_, 4) => Some(vec![Blue, Green, Red, NearInfrared]),
            // Coastal, blue, green, yellow, red, red edge, near infrared 1 and 2.
            (Self::Maxar, 8) => Some(vec![Other, Blue, Green, Other, Red, Other, NearInfrared, Other]),
            // Coastal blue, blue, green I, green, yellow, red, red edge, near infrared.
            (Self::PlanetScope, 8) => Some(vec![Other, Blue, Other, Green, Other, Red, Other, NearInfrared]),
            _ => None,
        }
    }
}

/// The sensor of a file: from metadata read by GDAL, else from the file's name.
fn sensor_of(file: &RasterFile) -> Option<Sensor> {
    let maxar_reader = file.domain("").get("METADATATYPE").is_some_and(|kind| kind == "DG");
    let satellite = file.domain("IMAGERY").get("SATELLITEID").cloned().unwrap_or_default();
    let satellite = satellite.trim_matches('"');
    if maxar_reader || ["WV", "QB", "GE01"].iter().any(|name| satellite.starts_with(name)) {
        return Some(Sensor::Maxar);
    }
    sensor_by_name(&stem(file.path()))
}

/// The sensor of a file name such as `20200814_162132_ssc4_u0001_analytic`, `20160831_180302_0e26_3B_AnalyticMS_8b`,
/// `GF2_PMS1_…-MSS1`, `SV1-01_…-MUX` or `16SEP18160424-M1BS-…`.
fn sensor_by_name(name: &str) -> Option<Sensor> {
    let name = name.to_uppercase();
    let parts: Vec<&str> = name.split(['_', '-']).collect();
    let is_numbered = |part: &&str, start: &str| {
        let number = part.strip_prefix(start);
        number.is_some_and(|number| number.starts_with(|c: char| c.is_ascii_digit()))
    };
    let begins = |start: &str| parts.first().is_some_and(|part| is_numbered(part, start));
    let numbered = |start: &str| parts.iter().any(|part| is_numbered(part, start));
    // Product parts such as M1BS, M2AS and M3DS.
    let is_maxar = |part: &&str| {
        let bytes = part.as_bytes();
        bytes.len() == 4 && bytes[0] == b'M' && bytes[1].is_ascii_digit() && bytes[3] == b'S'
    };
    if parts.iter().any(is_maxar) {
        Some(Sensor::Maxar)
    } else if parts.contains(&"ANALYTICMS") {
        Some(Sensor::PlanetScope)
    } else if begins("GF") || begins("SV") || (numbered("SSC") && parts.contains(&"ANALYTIC")) {
        Some(Sensor::BlueFirst)
    } else {
        None
    }
}

/// Band kinds of a file from the DIMAP beside it (`Raster_Index_List`): Pleiades, SPOT and Pleiades Neo.
fn dimap_order(file: &RasterFile, folders: &Folders) -> Result<Option<Vec<BandKind>>> {
    for path in belonging_texts(file.path(), folders)? {
        if has_extension(&path, &["xml"])
            && let Some(order) = order_in_dimap(&folders.text(&path)?)
            && order.len() == file.bands.len()
        {
            return Ok(Some(order));
        }
    }
    Ok(None)
}

fn order_in_dimap(text: &str) -> Option<Vec<BandKind>> {
    let inside = |text: &str, name: &str| -> Option<String> {
        let (_, rest) = text.split_once(&format!("<{name}>"))?;
        Some(rest.split_once("</")?.0.trim().to_uppercase())
    };
    let (_, rest) = text.split_once("<Raster_Index_List>")?;
    let (list, _) = rest.split_once("</Raster_Index_List>")?;
    let mut places = Vec::new();
    for entry in list.split("<Raster_Index>").skip(1) {
        let place: usize = inside(entry, "BAND_INDEX")?.parse().ok()?;
        let known = CalibratedBand::from_dimap_id(&inside(entry, "BAND_ID")?);
        places.push((place, known.map_or(BandKind::Other, BandKind::of_metadata)));
    }
    places.sort_by_key(|(place, _)| *place);
    let in_order = places.iter().enumerate().all(|(index, (place, _))| *place == index + 1);
    let known = places.iter().any(|(_, kind)| *kind != BandKind::Other);
    (in_order && known).then(|| places.into_iter().map(|(_, kind)| kind).collect())
}

/// Bands to read; `order` is the kinds from metadata beside the file or from its sensor. A guess never contains near
/// infrared: an index of guessed bands would be meaningless.
fn from_infos(bands: &[BandInfo], order: Option<&[BandKind]>) -> BandPlan {
    use BandKind::{Blue, Green, NearInfrared, Other, Pan, Red};
    let alpha = bands.iter().position(|band| band.colour == Colour::Alpha);
    let data: Vec<usize> = (0..bands.len()).filter(|&index| Some(index) != alpha).collect();
    let described = data.iter().map(|&index| from_description(&bands[index].description));
    let described: Vec<BandKind> = described.collect();
    if described.iter().any(|&kind| kind != Other) {
        return ordered(&described, &data, alpha, None);
    }
    if let Some(order) = order.filter(|order| order.len() == bands.len()) {
        let kinds: Vec<BandKind> = data.iter().map(|&index| order[index]).collect();
        return ordered(&kinds, &data, alpha, None);
    }
    let coloured: Vec<BandKind> = data.iter().map(|&index| from_colour(bands[index].colour)).collect();
    let has_rgb = [Red, Green, Blue].iter().all(|kind| coloured.contains(kind));
    // Red, green, blue and one band of unknown colour: the fourth band of all satellites is near infrared.
    if has_rgb && data.len() <= 4 {
        let coloured = coloured.iter();
        let kinds = coloured.map(|&kind| if kind == Other { NearInfrared } else { kind });
        let kinds: Vec<BandKind> = kinds.collect();
        return ordered(&kinds, &data, alpha, None);
    }
    let assumed = |what: &str| Some(format!("its bands have no names; assumed to be {what}"));
    let without_index = "and one that takes no part in vegetation or water indices";
    match data.len() {
        1 => ordered(&[Pan], &data, alpha, None),
        3 => ordered(&[Red, Green, Blue], &data, alpha, assumed("red, green, blue")),
        4 => BandPlan {
            file_bands: data,
            kinds: vec![Red, Green, Blue, Other],
            alpha,
            assumption: assumed(&format!("red, green, blue {without_index}")),
        },
        8 => ordered(
            &[Other, Blue, Green, Other, Red, Other, Other, Other],
            &data,
            alpha,
            assumed("the eight bands of WorldView-2 and -3, of which red, green and blue are used"),
        ),
        count => ordered(&vec![Other; count], &data, alpha, assumed("just different")),
    }
}

/// Orders bands as red, green, blue, near infrared and drops the others; without red, green and blue all bands are kept
/// in file order.
fn ordered(kinds: &[BandKind], files: &[usize], alpha: Option<usize>, assumption: Option<String>) -> BandPlan {
    use BandKind::{Blue, Green, NearInfrared, Red};
    let find = |wanted: BandKind| kinds.iter().position(|&kind| kind == wanted);
    let has_rgb = [Red, Green, Blue].into_iter().all(|kind| find(kind).is_some());
    let picked: Vec<usize> = match has_rgb {
        true => [Red, Green, Blue, NearInfrared].into_iter().filter_map(find).collect(),
        false => (0..kinds.len()).collect(),
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
    // The second near-infrared band of WorldView covers other wavelengths than the near infrared of other satellites.
    use BandKind::{Blue, Green, NearInfrared, Other, Pan, Red};
    let letters = [("r", Red), ("g", Green), ("b", Blue), ("n", NearInfrared), ("p", Pan)];
    if let Some((_, kind)) = letters.iter().find(|(letter, _)| *letter == text) {
        return *kind;
    }
    let mut unlike = ["nir2", "rededge", "coastal", "yellow", "deepblue", "swir"].into_iter();
    if unlike.any(has) {
        return Other;
    }
    let parts = [
        ("nir", NearInfrared),
        ("infrared", NearInfrared),
        ("pan", Pan),
        ("red", Red),
        ("green", Green),
        ("blue", Blue),
    ];
    let part = parts.iter().find(|(part, _)| has(part));
    part.map_or(Other, |(_, kind)| *kind)
}

fn from_colour(colour: Colour) -> BandKind {
    match colour {
        Colour::Red => BandKind::Red,
        Colour::Green => BandKind::Green,
        Colour::Blue => BandKind::Blue,
        _ => BandKind::Other,
    }
}

/// Bands in words, such as `3 bands (red, green, blue)`.
pub fn in_words(kinds: &[BandKind]) -> String {
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
            scale: None,
            offset: None,
        }
    }

    #[test]
    fn one_grey_band_is_panchromatic() {
        let plan = from_infos(&[band("", Colour::Grey)], None);
        assert_eq!((plan.kinds, plan.assumption), (vec![Pan], None));
    }

    #[test]
    fn descriptions_win_over_order() {
        let names = ["Blue", "Green", "Red", "NIR"];
        let bands: Vec<_> = names.iter().map(|name| band(name, Colour::Undefined)).collect();
        let plan = from_infos(&bands, None);
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
        assert_eq!(from_infos(&bands, None).kinds, vec![Red, Green, Blue, NearInfrared]);
        bands[3].colour = Colour::Alpha;
        let plan = from_infos(&bands, None);
        assert_eq!((plan.kinds, plan.alpha), (vec![Red, Green, Blue], Some(3)));
    }

    #[test]
    fn bands_of_a_known_sensor_have_its_order() {
        let plan = |sensor: Sensor, count: usize| {
            let bands: Vec<_> = (0..count).map(|_| band("", Colour::Undefined)).collect();
            from_infos(&bands, sensor.order(count).as_deref())
        };
        for (sensor, count, places) in [
            (Sensor::Maxar, 4, vec![2, 1, 0, 3]),
            (Sensor::Maxar, 8, vec![4, 2, 1, 6]),
            (Sensor::PlanetScope, 4, vec![2, 1, 0, 3]),
            (Sensor::PlanetScope, 8, vec![5, 3, 1, 7]),
            (Sensor::BlueFirst, 4, vec![2, 1, 0, 3]),
        ] {
            let plan = plan(sensor, count);
            assert_eq!(plan.file_bands, places, "{sensor:?} {count}");
            assert_eq!(plan.kinds, [Red, Green, Blue, NearInfrared]);
            assert_eq!(plan.assumption, None);
        }
    }

    #[test]
    fn names_of_vendors_tell_the_sensor() {
        for (name, sensor) in [
            ("20160831_180302_0e26_3B_AnalyticMS", Some(Sensor::PlanetScope)),
            ("20210228_185120_64_2495_3B_AnalyticMS_8b", Some(Sensor::PlanetScope)),
            ("20200814_162132_ssc4_u0001_analytic", Some(Sensor::BlueFirst)),
            ("GF2_PMS1_E113.5_N34.3_20190101_L1A0003-MSS1", Some(Sensor::BlueFirst)),
            ("SV1-01_20190101_L1B-MUX", Some(Sensor::BlueFirst)),
            ("16SEP18160424-M1BS-055675_01_P001", Some(Sensor::Maxar)),
            ("JAX_068_001_RGB", None),
            ("gf_site_1", None),
        ] {
            assert_eq!(sensor_by_name(name), sensor, "{name}");
        }
    }

    #[test]
    fn a_dimap_lists_its_bands() {
        let entry = |id: &str, index: usize| {
            format!("<Raster_Index><BAND_ID>{id}</BAND_ID><BAND_INDEX>{index}</BAND_INDEX></Raster_Index>")
        };
        let list = |ids: &[&str]| {
            let entries: String = ids.iter().enumerate().map(|(index, id)| entry(id, index + 1)).collect();
            format!("<Raster_Display><Raster_Index_List>\n{entries}</Raster_Index_List>")
        };
        assert_eq!(
            order_in_dimap(&list(&["B2", "B1", "B0", "B3"])),
            Some(vec![Red, Green, Blue, NearInfrared])
        );
        let neo = ["R", "G", "B", "NIR", "RE", "DB"];
        let other = BandKind::Other;
        assert_eq!(
            order_in_dimap(&list(&neo)),
            Some(vec![Red, Green, Blue, NearInfrared, other, other])
        );
        assert_eq!(order_in_dimap("<Raster_Index_List></Raster_Index_List>"), None);
        assert_eq!(order_in_dimap("no DIMAP"), None);
    }

    #[test]
    fn a_guess_gives_no_index() {
        for count in [4, 8] {
            let bands: Vec<_> = (0..count).map(|_| band("", Colour::Undefined)).collect();
            let plan = from_infos(&bands, None);
            assert!(plan.assumption.is_some());
            assert_eq!(plan.kinds[..3], [Red, Green, Blue]);
            assert!(!plan.kinds.contains(&NearInfrared), "{count}");
        }
    }

    #[test]
    fn the_red_edge_is_not_red() {
        let names = ["coastal", "blue", "green", "yellow", "red", "red edge", "nir1", "nir2"];
        let bands: Vec<_> = names.iter().map(|name| band(name, Colour::Undefined)).collect();
        assert_eq!(from_infos(&bands, None).file_bands, vec![4, 2, 1, 6]);
    }
}
