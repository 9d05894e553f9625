//! Acquisitions from GDAL's metadata domains.

use super::time::{utc, utc_of_date_and_time};
use super::values::Acquisition;
use crate::read::fields::number;
use jiff::Timestamp;
use std::collections::BTreeMap;

/// Acquisition from the items of GDAL's default, `IMD` and `IMAGERY` domains (together or apart): Maxar's IMD names
/// with any prefix, DIMAP's, GeoEye's, NITF's (`NITF_USE00A_SUN_AZ`, `NITF_CSEXRA_SUN_AZIMUTH`,
/// `NITF_STDIDC_ACQUISITION_DATE`, `NITF_IDATIM`), and `ACQUISITIONDATETIME`. `TIFFTAG_DATETIME` is the time of writing
/// and is not read.
pub fn gdal_domain(items: &BTreeMap<String, String>) -> Acquisition {
    let items = Items::of(items);
    let angle = |names: &[&str]| names.iter().find_map(|name| number(items.get(name)?));
    // Angles are read in pairs: an azimuth of one record does not belong to an elevation of another.
    let pairs: [[&[&str]; 2]; 4] = [
        [&["meansunaz", "sunaz"], &["meansunel", "sunel"]],
        [
            &["sun_azimuth", "sun angle azimuth"],
            &["sun_elevation", "sun angle elevation"],
        ],
        [&["nitf_use00a_sun_az"], &["nitf_use00a_sun_el"]],
        [&["nitf_csexra_sun_azimuth"], &["nitf_csexra_sun_elevation"]],
    ];
    let angles = pairs.map(|[azimuth, elevation]| Acquisition::new(None, angle(azimuth), angle(elevation)));
    let complete = angles.iter().copied().find(|found| found.stated_sun().is_some());
    Acquisition::new(items.time(), None, None).merge(complete.unwrap_or_default())
}

/// The constant that GDAL writes into every NITF without a date, so that files are reproducible.
const OF_GDAL: &str = "20021216151629";

/// Items by the last part of their names, lower case (`IMAGE_1.meanSunAz` is `meansunaz`).
struct Items<'a>(BTreeMap<String, &'a str>);

impl<'a> Items<'a> {
    fn of(items: &'a BTreeMap<String, String>) -> Self {
        let mut by_name = BTreeMap::new();
        for (key, value) in items {
            let name = key.rsplit('.').next().unwrap_or(key).to_ascii_lowercase();
            by_name.entry(name).or_insert(value.as_str());
        }
        Self(by_name)
    }

    fn get(&self, name: &str) -> Option<&'a str> {
        self.0.get(name).copied()
    }

    fn time(&self) -> Option<Timestamp> {
        const EXACT: [&str; 8] = [
            "firstlinetime",
            "tlctime",
            "firstlineacquisitiondatetime",
            "acquisition_utc",
            "acquisition date/time",
            "nitf_stdidc_acquisition_date",
            "nitf_idatim",
            "earliestacqtime",
        ];
        let imaging = || {
            self.get("imaging_date")
                .zip(self.get("imaging_time"))
                .and_then(utc_of_date_and_time)
        };
        let kompsat = || {
            let (date, time) = self
                .get("aux_strip_acq_date_ut")
                .zip(self.get("aux_strip_acq_start_ut"))?;
            utc(&format!("{date}{time}"))
        };
        // GDAL writes midnight where the product gives the date alone.
        let imagery = || {
            let text = self
                .get("acquisitiondatetime")
                .filter(|text| !text.trim_end().ends_with(" 00:00:00"))?;
            utc(text)
        };
        let exact = EXACT
            .iter()
            .find_map(|name| utc(self.get(name).filter(|text| !text.starts_with(OF_GDAL))?));
        exact.or_else(imaging).or_else(kompsat).or_else(imagery)
    }
}
