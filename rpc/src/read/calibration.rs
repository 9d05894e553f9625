//! Radiometric calibration: gains from counts to radiance or reflectance, from the texts that vendors deliver with an
//! image.
//!
//! Values are at the top of the atmosphere. Gains that are absent, placeholders or zero are left out.

mod maxar;

pub use maxar::gdal_domain;

use super::fields::number;
use super::kind::{TextKind, kind};
use super::statements::{grouped, without_mark};
use super::xml::{child_text, find, find_all, parse, text as text_of};
use roxmltree::Node;
use serde_json::Value;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Airbus delivers reflectance in ten thousandths.
const DIMAP_REFLECTANCE_PER_COUNT: f64 = 1e-4;

/// Radiometry of an image as stated in a text.
#[derive(Debug, Clone, PartialEq)]
pub enum Radiometry {
    /// Gains of the bands.
    Calibrated(Calibration),
    /// A display curve was applied: values are for viewing and are no measure of light.
    Display,
}

/// Quantity of calibrated values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Spectral radiance at the sensor, W m⁻² sr⁻¹ µm⁻¹; in Planet's files W m⁻² sr⁻¹.
    Radiance,
    /// Reflectance, 0 to 1.
    Reflectance,
}

/// A band as named in metadata.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum CalibratedBand {
    /// Panchromatic.
    Pan,
    /// Blue.
    Blue,
    /// Green.
    Green,
    /// Red.
    Red,
    /// Near infrared, the first where there are two.
    NearInfrared,
    /// The band with this index in the file, counted from zero.
    Place(usize),
}

impl CalibratedBand {
    /// Band of a DIMAP's `BAND_ID`; `None` for a band that is neither panchromatic, red, green, blue nor near infrared.
    pub fn from_dimap_id(id: &str) -> Option<Self> {
        Some(match id.trim().to_ascii_uppercase().as_str() {
            "P" | "PAN" => Self::Pan,
            "B0" | "B" => Self::Blue,
            "B1" | "G" => Self::Green,
            "B2" | "R" => Self::Red,
            "B3" | "NIR" => Self::NearInfrared,
            _ => return None,
        })
    }
}

/// Conversion of one band's counts to radiance or reflectance: `scale · count + offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gain {
    /// Radiance or reflectance per count.
    pub scale: f64,
    /// Radiance or reflectance of a count of zero.
    pub offset: f64,
    /// Solar irradiance in the band at one astronomical unit, W m⁻² µm⁻¹, where it is known.
    pub irradiance_w_m2_um: Option<f64>,
}

impl Gain {
    fn new(scale: f64, offset: f64) -> Option<Self> {
        (scale.is_finite() && scale > 0.0 && offset.is_finite()).then_some(Self {
            scale,
            offset,
            irradiance_w_m2_um: None,
        })
    }

    fn under(self, irradiance_w_m2_um: Option<f64>) -> Self {
        Self {
            irradiance_w_m2_um: irradiance_w_m2_um.filter(|value| value.is_finite() && *value > 0.0),
            ..self
        }
    }

    /// Gain to reflectance from a gain to radiance `L`: `π d² L / (E sin h)` with solar irradiance `E`, and the sun at
    /// elevation `h` (radians) and distance `d` (astronomical units); `None` where the irradiance is unknown or the sun
    /// is below the horizon.
    pub fn to_reflectance(self, elevation_rad: f64, distance_au: f64) -> Option<Self> {
        let arriving = self.irradiance_w_m2_um? * elevation_rad.sin() / (distance_au * distance_au);
        let per_radiance = PI / arriving;
        (arriving > 0.0).then_some(Self {
            scale: self.scale * per_radiance,
            offset: self.offset * per_radiance,
            ..self
        })
    }
}

/// The gains of an image's bands.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Quantity of the calibrated values.
    pub quantity: Quantity,
    /// Gain of each band that has one.
    pub gains: BTreeMap<CalibratedBand, Gain>,
}

impl Calibration {
    /// Radiometry from gains; `None` without gains.
    fn radiometry(quantity: Quantity, gains: impl IntoIterator<Item = (CalibratedBand, Gain)>) -> Option<Radiometry> {
        let gains: BTreeMap<_, _> = gains.into_iter().collect();
        (!gains.is_empty()).then_some(Radiometry::Calibrated(Self { quantity, gains }))
    }

    /// Radiometry from scale, offset and unit of each band of a file; `None` unless all bands have a scale and their
    /// units state one quantity. An absent offset is 0.
    pub fn of_bands(bands: &[(Option<f64>, Option<f64>, &str)]) -> Option<Radiometry> {
        let quantity = |unit: &str| {
            let unit = unit.to_lowercase();
            if unit.contains("reflectance") {
                return Some(Quantity::Reflectance);
            }
            (unit.contains("radiance") || (unit.starts_with('w') && unit.contains("sr"))).then_some(Quantity::Radiance)
        };
        let first = quantity(bands.first()?.2)?;
        let gain = |(place, (scale, offset, unit)): (usize, &(Option<f64>, Option<f64>, &str))| {
            let same = quantity(unit) == Some(first);
            let gain = Gain::new((*scale)?, offset.unwrap_or(0.0)).filter(|_| same)?;
            Some((CalibratedBand::Place(place), gain))
        };
        let gains: Option<Vec<_>> = bands.iter().enumerate().map(gain).collect();
        Self::radiometry(first, gains?)
    }
}

/// Radiometry from text in any format of this module, recognised by content; `None` without a calibration.
pub fn from_text(text: &str) -> Option<Radiometry> {
    match kind(text) {
        TextKind::Dimap => dimap(text),
        TextKind::MaxarXml => maxar_xml(text),
        TextKind::OtherXml(root) if root == "EarthObservation" => planet_xml(text),
        TextKind::Json => planet_json(text),
        TextKind::Assignments => imd(text),
        _ => None,
    }
}

/// Radiometry from a Maxar `.IMD`; `None` without a calibration.
pub fn imd(text: &str) -> Option<Radiometry> {
    let items = grouped(text)
        .into_iter()
        .map(|(group, statement)| (format!("{group}.{}", statement.key), statement.value.to_owned()));
    gdal_domain(&items.collect())
}

/// Radiometry from a Maxar `.XML` (`isd/IMD`); `None` without a calibration.
pub fn maxar_xml(text: &str) -> Option<Radiometry> {
    let document = parse("Maxar XML", text).ok()?;
    let imd = find(document.root_element(), "IMD")?;
    let mut items = BTreeMap::new();
    for node in imd.descendants().filter(Node::is_element) {
        let group = node.parent().map_or("", |parent| parent.tag_name().name());
        if let Some(value) = node.text() {
            // The first of several images is used.
            items
                .entry(format!("{group}.{}", node.tag_name().name()))
                .or_insert_with(|| value.to_owned());
        }
    }
    gdal_domain(&items)
}

/// Radiometry from a DIMAP v2 `DIM_*.XML` (`Band_Radiance`, `Band_Solar_Irradiance`, `RADIOMETRIC_PROCESSING`) or v1
/// `METADATA.DIM` (`PHYSICAL_GAIN`, `PHYSICAL_BIAS`, `SOLAR_IRRADIANCE_VALUE`).
pub fn dimap(text: &str) -> Option<Radiometry> {
    let document = parse("DIMAP", text).ok()?;
    let root = document.root_element();
    let processing = text_of(root, "RADIOMETRIC_PROCESSING")
        .unwrap_or("")
        .trim()
        .to_uppercase();
    let value = |node: Node, name: &str| child_text(node, name).and_then(number);
    let gain_of = |node: Node, [gain, bias]: [&str; 2]| {
        let scale = value(node, gain).filter(|gain| *gain > 0.0)?.recip();
        Gain::new(scale, value(node, bias).unwrap_or(0.0))
    };
    let of_id = |node: Node| CalibratedBand::from_dimap_id(child_text(node, "BAND_ID")?);
    let of_index = |node: Node| {
        Some(CalibratedBand::Place(
            (value(node, "BAND_INDEX")? as usize).checked_sub(1)?,
        ))
    };
    match processing.as_str() {
        "LINEAR_STRETCH" | "DISPLAY" | "SEAMLESS" => return Some(Radiometry::Display),
        "REFLECTANCE" => {
            let ids = find_all(root, "BAND_ID").filter_map(|id| CalibratedBand::from_dimap_id(id.text()?));
            let gain = Gain::new(DIMAP_REFLECTANCE_PER_COUNT, 0.0)?;
            return Calibration::radiometry(Quantity::Reflectance, ids.map(|band| (band, gain)));
        }
        _ => {}
    }
    let irradiance = |of: CalibratedBand| {
        find_all(root, "Band_Solar_Irradiance").find_map(|node| {
            let is_it = of_id(node) == Some(of) || of_index(node) == Some(of);
            let value = value(node, "VALUE").or_else(|| value(node, "SOLAR_IRRADIANCE_VALUE"));
            value.filter(|_| is_it)
        })
    };
    let second =
        find_all(root, "Band_Radiance").filter_map(|node| Some((of_id(node)?, gain_of(node, ["GAIN", "BIAS"])?)));
    let first = find_all(root, "Spectral_Band_Info")
        .filter_map(|node| Some((of_index(node)?, gain_of(node, ["PHYSICAL_GAIN", "PHYSICAL_BIAS"])?)));
    let gains = second
        .chain(first)
        .map(|(band, gain)| (band, gain.under(irradiance(band))));
    Calibration::radiometry(Quantity::Radiance, gains)
}

/// Radiometry from PlanetScope's `…_metadata.xml`: `reflectanceCoefficient` of each band, else
/// `radiometricScaleFactor`.
pub fn planet_xml(text: &str) -> Option<Radiometry> {
    let document = parse("Planet XML", text).ok()?;
    let bands: Vec<Node> = find_all(document.root_element(), "bandSpecificMetadata").collect();
    let gains = |name: &str| -> Option<Vec<_>> {
        let gain = |node: &Node| {
            let place = (child_text(*node, "bandNumber").and_then(number)? as usize).checked_sub(1)?;
            let gain = Gain::new(child_text(*node, name).and_then(number)?, 0.0)?;
            Some((CalibratedBand::Place(place), gain))
        };
        bands.iter().map(gain).collect()
    };
    if let Some(gains) = gains("reflectanceCoefficient") {
        return Calibration::radiometry(Quantity::Reflectance, gains);
    }
    Calibration::radiometry(Quantity::Radiance, gains("radiometricScaleFactor")?)
}

/// Radiometry from the JSON that SkySat images have in the description tag of their TIFF:
/// `properties.reflectance_coefficients`.
fn planet_json(text: &str) -> Option<Radiometry> {
    let document: Value = serde_json::from_str(without_mark(text)).ok()?;
    let coefficients = document
        .get("properties")?
        .get("reflectance_coefficients")?
        .as_array()?;
    let gain = |(place, value): (usize, &Value)| Some((CalibratedBand::Place(place), Gain::new(value.as_f64()?, 0.0)?));
    let gains: Option<Vec<_>> = coefficients.iter().enumerate().map(gain).collect();
    Calibration::radiometry(Quantity::Reflectance, gains?)
}

#[cfg(test)]
mod tests;
