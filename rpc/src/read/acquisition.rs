//! Time of acquisition and direction of the sun, from the same text and metadata domains as the camera.
//!
//! Readers leave out values that are absent, placeholders or out of range. Vendors' angles are up to 0.4 degree off
//! (they use the geocentric vertical), so the time takes precedence.

mod domain;
mod names;
mod time;
mod values;

pub use domain::gdal_domain;
pub use names::{from_file_name, tiff_date};
pub use values::Acquisition;

use super::fields::number;
use super::json::json_number;
use super::kind::{TextKind, kind};
use super::statements::{Statement, assignments, colon_lines, without_mark};
use super::xml::{child_text, find, find_all, parse, text as text_of};
use roxmltree::Node;
use serde_json::Value;
use time::{utc, utc_of_date_and_time};

/// Acquisition from text in any format of this module, recognised by content; `None` when it contains no value. The
/// file name is not used.
pub fn from_text(_file_name: &str, text: &str) -> Option<Acquisition> {
    let acquisition = match kind(text) {
        TextKind::Dimap => dimap(text),
        TextKind::MaxarXml => maxar_xml(text),
        TextKind::OtherXml(_) | TextKind::FixedWidth => Acquisition::default(),
        TextKind::Json => satnerf_json(text).merge(stac(text)),
        TextKind::Assignments => imd(text),
        TextKind::Geom => ossim_geom(text),
        TextKind::RpcTxt | TextKind::Other => metadata_txt(text),
    };
    (!acquisition.is_empty()).then_some(acquisition)
}

/// Acquisition from a Maxar `.IMD` (`firstLineTime`, `meanSunAz`, `meanSunEl`), or another list of assignments with
/// these names.
pub fn imd(text: &str) -> Acquisition {
    let statements = assignments(text);
    let value = |names: &[&str]| first_of(&statements, names);
    maxar_values(value)
}

/// Acquisition from a Maxar `.XML` (`isd/IMD`).
pub fn maxar_xml(text: &str) -> Acquisition {
    let Ok(document) = parse("Maxar XML", text) else {
        return Acquisition::default();
    };
    let root = document.root_element();
    let imd = find(root, "IMD").unwrap_or(root);
    maxar_values(|names| names.iter().find_map(|name| text_of(imd, &name.to_ascii_uppercase())))
}

/// Values by the names of an IMD, which are those of the XML in capitals. The first of several images is used.
fn maxar_values<'a>(value: impl Fn(&[&str]) -> Option<&'a str>) -> Acquisition {
    Acquisition::new(
        value(&["firstLineTime"])
            .or_else(|| value(&["TLCTime"]))
            .or_else(|| value(&["firstLineAcquisitionDateTime"]))
            .or_else(|| value(&["earliestAcqTime"]))
            .and_then(utc),
        value(&["meanSunAz", "sunAz"]).and_then(number),
        value(&["meanSunEl", "sunEl"]).and_then(number),
    )
}

fn first_of<'a>(statements: &[Statement<'a>], names: &[&str]) -> Option<&'a str> {
    let of_name = |name: &&str| {
        statements
            .iter()
            .find(|s| s.key.eq_ignore_ascii_case(name))
            .map(|s| s.value)
    };
    names.iter().find_map(of_name)
}

/// Acquisition from a DIMAP v2 `DIM_*.XML` (the scene's centre of `Located_Geometric_Values`) or v1 `METADATA.DIM`
/// (SPOT).
pub fn dimap(text: &str) -> Acquisition {
    let Ok(document) = parse("DIMAP", text) else {
        return Acquisition::default();
    };
    let root = document.root_element();
    let located: Vec<Node> = find_all(root, "Located_Geometric_Values").collect();
    let is_centre =
        |node: &&Node| child_text(**node, "LOCATION_TYPE").is_some_and(|t| t.trim().eq_ignore_ascii_case("center"));
    let from_located = |node: &Node| {
        Acquisition::new(
            child_text(*node, "TIME").and_then(utc),
            text_of(*node, "SUN_AZIMUTH").and_then(number),
            text_of(*node, "SUN_ELEVATION").and_then(number),
        )
    };
    let from_source = |node: Node| {
        Acquisition::new(
            child_text(node, "IMAGING_DATE")
                .zip(child_text(node, "IMAGING_TIME"))
                .and_then(utc_of_date_and_time),
            child_text(node, "SUN_AZIMUTH").and_then(number),
            child_text(node, "SUN_ELEVATION").and_then(number),
        )
    };
    let centre = located.iter().find(is_centre).map(from_located).unwrap_or_default();
    let sources = find_all(root, "IMAGING_DATE").filter_map(|date| date.parent());
    let source = sources
        .map(from_source)
        .find(|found| !found.is_empty())
        .unwrap_or_default();
    let anywhere = located
        .iter()
        .map(from_located)
        .find(|found| !found.is_empty())
        .unwrap_or_default();
    centre.merge(source).merge(anywhere)
}

/// Acquisition from a Sat-NeRF or VisSat image JSON: `acquisition_utc` or `acquisition_date`, `sun_azimuth`,
/// `sun_elevation`; `capTime`, `sunAzim`, `sunElev`.
pub fn satnerf_json(text: &str) -> Acquisition {
    let document = serde_json::from_str(without_mark(text)).unwrap_or(Value::Null);
    json_values(
        &document,
        &["acquisition_utc", "acquisition_date", "capTime"],
        [&["sun_azimuth", "sunAzim"], &["sun_elevation", "sunElev"]],
    )
}

/// Acquisition from a STAC item (`datetime`, `view:sun_azimuth`, `view:sun_elevation`) or a Planet item (`acquired`,
/// `sun_azimuth`, `sun_elevation`).
pub fn stac(text: &str) -> Acquisition {
    let document: Value = serde_json::from_str(without_mark(text)).unwrap_or(Value::Null);
    json_values(
        document.get("properties").unwrap_or(&Value::Null),
        &["datetime", "start_datetime", "acquired"],
        [
            &["view:sun_azimuth", "sun_azimuth"],
            &["view:sun_elevation", "sun_elevation"],
        ],
    )
}

fn json_values(object: &Value, times: &[&str], [azimuths, elevations]: [&[&str]; 2]) -> Acquisition {
    let time = times.iter().find_map(|key| utc(object.get(key)?.as_str()?));
    let angle = |keys: &[&str]| keys.iter().find_map(|key| json_number(object.get(key)?));
    Acquisition::new(time, angle(azimuths), angle(elevations))
}

/// Acquisition from a GeoEye / IKONOS `_metadata.txt` (`Acquisition Date/Time`, `Sun Angle Azimuth`,
/// `Sun Angle Elevation`) or a KOMPSAT `.txt` (`AUX_STRIP_ACQ_DATE_UT`, `AUX_STRIP_ACQ_START_UT`); of several images
/// the first.
pub fn metadata_txt(text: &str) -> Acquisition {
    let lines: Vec<Statement> = colon_lines(text).collect();
    let value = |name: &str| first_of(&lines, &[name]);
    let geoeye = Acquisition::new(
        value("Acquisition Date/Time").and_then(utc),
        value("Sun Angle Azimuth").and_then(number),
        value("Sun Angle Elevation").and_then(number),
    );
    let column = |name: &str| {
        text.lines().find_map(|line| {
            let (key, value) = line.split_once(char::is_whitespace)?;
            (key == name).then(|| value.trim())
        })
    };
    let kompsat = column("AUX_STRIP_ACQ_DATE_UT")
        .zip(column("AUX_STRIP_ACQ_START_UT"))
        .and_then(|(date, time)| utc(&format!("{date}{time}")));
    geoeye.merge(Acquisition::new(kompsat, None, None))
}

/// Time from an OSSIM `.geom` keyword list; its angles are not read, because their order varies.
fn ossim_geom(text: &str) -> Acquisition {
    let time = ["time_range_start", "tlc_date", "date"].iter().find_map(|name| {
        let is_named = |line: &Statement| line.key.rsplit('.').next() == Some(name);
        utc(colon_lines(text).find(is_named)?.value)
    });
    Acquisition::new(time, None, None)
}
