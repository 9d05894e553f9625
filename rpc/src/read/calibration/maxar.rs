//! Maxar's calibration: factors of each band from the IMD, with corrections and solar irradiances by satellite.

use super::{CalibratedBand, Calibration, Gain, Quantity, Radiometry};
use crate::read::fields::number;
use std::collections::BTreeMap;

/// The vendor's correction of one band, and the solar irradiance in it.
struct Band {
    band: CalibratedBand,
    /// Radiance is `gain · count · absCalFactor / effectiveBandwidth + offset`, W m⁻² sr⁻¹ µm⁻¹.
    gain: f64,
    offset: f64,
    /// W m⁻² µm⁻¹ at one astronomical unit (Thuillier 2003).
    irradiance_w_m2_um: f64,
}

const fn band(band: CalibratedBand, gain: f64, offset: f64, irradiance_w_m2_um: f64) -> Band {
    Band {
        band,
        gain,
        offset,
        irradiance_w_m2_um,
    }
}

use CalibratedBand::{Blue, Green, NearInfrared, Pan, Red};

/// M. Kuester, "Absolute Radiometric Calibration: 2016v0", DigitalGlobe 2017 (release of 6 June 2017), by `satId`.
/// Satellites absent from the note (WorldView-4, Legion) are calibrated to radiance, without correction.
const SATELLITES: [(&str, &[Band]); 5] = [
    ("WV01", &[band(Pan, 1.016, -1.824, 1478.62)]),
    (
        "WV02",
        &[
            band(Pan, 0.942, -2.704, 1571.36),
            band(Blue, 0.988, -5.736, 2007.27),
            band(Green, 0.936, -3.546, 1829.62),
            band(Red, 0.952, -2.512, 1538.85),
            band(NearInfrared, 0.961, -3.300, 1053.21),
        ],
    ),
    (
        "WV03",
        &[
            band(Pan, 0.950, -3.629, 1574.41),
            band(Blue, 0.940, -5.809, 2004.61),
            band(Green, 0.938, -4.996, 1830.18),
            band(Red, 0.964, -3.021, 1535.33),
            band(NearInfrared, 0.961, -5.522, 1055.94),
        ],
    ),
    (
        "GE01",
        &[
            band(Pan, 0.970, -1.926, 1610.73),
            band(Blue, 1.053, -4.537, 1993.18),
            band(Green, 0.994, -4.175, 1828.83),
            band(Red, 0.998, -3.754, 1491.49),
            band(NearInfrared, 0.994, -3.870, 1022.58),
        ],
    ),
    (
        "QB02",
        &[
            band(Pan, 0.870, -1.491, 1370.92),
            band(Blue, 1.105, -2.820, 1949.59),
            band(Green, 1.071, -3.338, 1823.64),
            band(Red, 1.060, -2.954, 1553.78),
            band(NearInfrared, 1.020, -4.722, 1102.85),
        ],
    ),
];

/// Groups of an IMD and the bands they describe.
const GROUPS: [(&str, CalibratedBand); 5] = [
    ("band_p", Pan),
    ("band_b", Blue),
    ("band_g", Green),
    ("band_r", Red),
    ("band_n", NearInfrared),
];

/// Radiometry from the items of an IMD by group and key, as in GDAL's `IMD` domain (`BAND_R.absCalFactor`,
/// `IMAGE_1.satId`). The factors are for unprocessed counts: values after an adjustment of the dynamic range (DRA) are
/// for display, and values after a radiometric enhancement such as a compensation of the atmosphere are no radiance
/// (`None`).
pub fn gdal_domain(items: &BTreeMap<String, String>) -> Option<Radiometry> {
    let items: BTreeMap<String, &str> = items
        .iter()
        .map(|(key, value)| (key.to_ascii_lowercase(), value.trim().trim_matches('"')))
        .collect();
    let anywhere = |name: &str| {
        let of_name = |key: &&String| key.rsplit('.').next() == Some(name);
        items.iter().find(|(key, _)| of_name(key)).map(|(_, value)| *value)
    };
    if anywhere("radiometriclevel").is_some_and(|level| level.to_uppercase().contains("DRA")) {
        return Some(Radiometry::Display);
    }
    if anywhere("radiometricenhancement")
        .is_some_and(|done| !["", "off", "none"].contains(&done.to_lowercase().as_str()))
    {
        return None;
    }
    let satellite = anywhere("satid").unwrap_or_default();
    let known = SATELLITES
        .iter()
        .find(|(id, _)| *id == satellite)
        .map(|(_, bands)| *bands);
    let gain = |(group, of): (&str, CalibratedBand)| {
        let value = |name: &str| items.get(&format!("{group}.{name}")).copied().and_then(number);
        let per_count = value("abscalfactor")? / value("effectivebandwidth")?;
        let known = known.and_then(|bands| bands.iter().find(|band| band.band == of));
        let (gain, offset) = known.map_or((1.0, 0.0), |band| (band.gain, band.offset));
        let gain = Gain::new(gain * per_count, offset)?;
        Some((of, gain.under(known.map(|band| band.irradiance_w_m2_um))))
    };
    Calibration::radiometry(Quantity::Radiance, GROUPS.into_iter().filter_map(gain))
}
