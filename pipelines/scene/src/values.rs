//! Meaning of an image's values, and their conversion to reflectance.
//!
//! Pixels stay in counts: training, matching and products depend on ratios within a band, which a gain does not change.
//! Only indices of two bands compare bands with each other, and only they use reflectance.

use super::BandKind;
use super::indices::{ExcessGreen, NormalisedDifference, Term, VegetationIndex};
use heliosplat_delivery::FoundRadiometry;
use heliosplat_rpc::read::calibration::{CalibratedBand, Calibration, Gain, Quantity, Radiometry};
use heliosplat_rpc::sun::{SunPosition, earth_sun_distance_au};
use jiff::Timestamp;
use std::f64::consts::FRAC_PI_2;

/// Quantity of an image's values, or the quantity that its gains convert them to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ValueKind {
    /// Top-of-atmosphere reflectance, through gains.
    Reflectance,
    /// Radiance, through gains; the sun or the bands' solar irradiance is unknown.
    Radiance,
    /// Counts without a known calibration.
    #[default]
    Counts,
    /// Display values: a display curve or a stretch was applied.
    Display,
}

impl ValueKind {
    /// Name of the kind in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Reflectance => "reflectance",
            Self::Radiance => "radiance",
            Self::Counts => "counts",
            Self::Display => "display",
        }
    }
}

/// Conversion of a band's values to reflectance: `scale · value + offset`, with values in the scene's unit.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct BandReflectance {
    /// Reflectance per unit of the value.
    pub scale: f32,
    /// Reflectance of a value of zero.
    pub offset: f32,
}

/// Meaning of an image's values, and its source.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Values {
    /// Kind of the values.
    pub kind: ValueKind,
    /// File that states the meaning; `None` where no file does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Conversion of each band's values to reflectance; `None` for a band without gain, empty where no band has one.
    /// For radiance under an unknown sun, reflectance is known up to one factor for all bands.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub reflectance: Vec<Option<BandReflectance>>,
}

impl Values {
    /// Normalised difference vegetation index for bands of these kinds; `None` without red and near infrared, and for
    /// display values.
    pub fn ndvi(&self, bands: &[BandKind]) -> Option<NormalisedDifference> {
        self.difference(bands, [BandKind::NearInfrared, BandKind::Red])
    }

    /// Water index for bands of these kinds; `None` without green and near infrared, and for display values.
    pub fn water_index(&self, bands: &[BandKind]) -> Option<NormalisedDifference> {
        self.difference(bands, [BandKind::Green, BandKind::NearInfrared])
    }

    /// Index of leaves for bands of these kinds: the vegetation index, else excess green; `None` for display values and
    /// without the bands of either.
    pub fn vegetation_index(&self, bands: &[BandKind]) -> Option<VegetationIndex> {
        if self.kind == ValueKind::Display {
            return None;
        }
        let green = || ExcessGreen::new(bands).map(VegetationIndex::Green);
        self.ndvi(bands).map(VegetationIndex::Infrared).or_else(green)
    }

    /// True for the default values, without any information.
    pub fn is_unknown(&self) -> bool {
        *self == Self::default()
    }

    fn difference(&self, bands: &[BandKind], of: [BandKind; 2]) -> Option<NormalisedDifference> {
        if self.kind == ValueKind::Display {
            return None;
        }
        let place = |kind: BandKind| bands.iter().position(|&band| band == kind);
        let places = [place(of[0])?, place(of[1])?];
        let gain = |band: usize| self.reflectance.get(band).copied().flatten();
        // Reflectance of one band is not comparable with counts of the other.
        let gains = gain(places[0]).zip(gain(places[1]));
        let terms = gains.map_or([(1.0, 0.0); 2], |(a, b)| [(a.scale, a.offset), (b.scale, b.offset)]);
        let term = |i: usize| Term {
            band: places[i],
            scale: terms[i].0,
            offset: terms[i].1,
        };
        Some(NormalisedDifference::new(term(0), term(1)))
    }

    /// Display values, as stated in `source`; `None` where the values themselves show it.
    pub(super) fn for_display(source: Option<&str>) -> Self {
        Self {
            kind: ValueKind::Display,
            source: source.map(str::to_owned),
            reflectance: Vec::new(),
        }
    }

    /// Values from metadata, for bands of these kinds and places in their file, under a light, in a scene of
    /// `counts_per_unit`.
    pub(super) fn of_metadata(
        found: &FoundRadiometry,
        bands: &FileBands,
        light: &Illumination,
        counts_per_unit: f64,
    ) -> Self {
        let source = Some(found.source.clone());
        let calibration = match &found.radiometry {
            Radiometry::Display => return Self::for_display(source.as_deref()),
            Radiometry::Calibrated(calibration) => calibration,
        };
        let gains: Vec<Option<Gain>> = bands.of(calibration);
        if gains.iter().all(Option::is_none) {
            return Self::default();
        }
        let elevation_rad = light.sun.map(|sun| sun.elevation_rad);
        let reflectance = |gain: &Option<Gain>| {
            let gain = (*gain)?;
            let gain = match calibration.quantity {
                Quantity::Reflectance => gain,
                // All bands of an image have one sun: without it, reflectance is known up to one factor, which cancels
                // in every index.
                Quantity::Radiance => gain.to_reflectance(elevation_rad.unwrap_or(FRAC_PI_2), light.distance_au())?,
            };
            let (scale, offset) = ((gain.scale * counts_per_unit) as f32, gain.offset as f32);
            Some(BandReflectance { scale, offset })
        };
        let mut reflectance: Vec<_> = gains.iter().map(reflectance).collect();
        let mut pairs = gains.iter().zip(&reflectance);
        let complete = pairs.all(|(gain, to)| gain.is_none() || to.is_some());
        if reflectance.iter().all(Option::is_none) {
            reflectance.clear();
        }
        let is_reflectance = calibration.quantity == Quantity::Reflectance || (elevation_rad.is_some() && complete);
        let kind = match is_reflectance {
            true => ValueKind::Reflectance,
            false => ValueKind::Radiance,
        };
        Self {
            kind,
            source,
            reflectance,
        }
    }
}

/// Light under which an image was taken.
pub(super) struct Illumination {
    /// Position of the sun; `None` if unknown.
    pub(super) sun: Option<SunPosition>,
    /// Acquisition time; `None` if unknown.
    pub(super) time: Option<Timestamp>,
}

impl Illumination {
    /// Distance between Earth and sun, astronomical units; without a time the mean, at most 1.7 % off.
    fn distance_au(&self) -> f64 {
        self.time.map_or(1.0, earth_sun_distance_au)
    }
}

/// Bands of a file that are read.
pub(super) struct FileBands<'a> {
    /// Kind of each band.
    pub(super) kinds: &'a [BandKind],
    /// Places of the bands in the file, from 0.
    pub(super) places: &'a [usize],
}

impl FileBands<'_> {
    /// Gain of each band; `None` for a band without one.
    fn of(&self, calibration: &Calibration) -> Vec<Option<Gain>> {
        let by_kind = |kind: BandKind| {
            let mut gains = calibration.gains.iter();
            let found = gains.find(|(band, _)| kind != BandKind::Other && BandKind::of_metadata(**band) == kind);
            found.map(|(_, gain)| *gain)
        };
        let by_place = |place: usize| calibration.gains.get(&CalibratedBand::Place(place)).copied();
        let bands = self.kinds.iter().zip(self.places);
        let found = bands.map(|(&kind, &place)| by_kind(kind).or_else(|| by_place(place)));
        found.collect()
    }
}

/// Removes the gains of all images unless every image has gains, since indices are compared between images. Returns the
/// corresponding warning.
pub(super) fn same_for_all(values: &mut [(String, Values)]) -> Option<String> {
    let with = |values: &Values| !values.reflectance.is_empty();
    let known = values.iter().filter(|(_, values)| with(values)).count();
    let without = values.iter().find(|(_, values)| !with(values))?;
    if known == 0 {
        return None;
    }
    let line = format!(
        "{}: has no gains, though {known} of {} images have; the vegetation and water indices of all are those of counts; put its \
         metadata (.IMD, DIM_*.XML) beside it",
        without.0,
        values.len()
    );
    values.iter_mut().for_each(|(_, values)| values.reflectance.clear());
    Some(line)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    const KINDS: [BandKind; 4] = [BandKind::Red, BandKind::Green, BandKind::Blue, BandKind::NearInfrared];

    fn found(quantity: Quantity, gains: &[(CalibratedBand, f64, f64, Option<f64>)]) -> FoundRadiometry {
        let gain = |&(band, scale, offset, irradiance_w_m2_um): &(CalibratedBand, f64, f64, Option<f64>)| {
            let gain = Gain {
                scale,
                offset,
                irradiance_w_m2_um,
            };
            (band, gain)
        };
        FoundRadiometry {
            radiometry: Radiometry::Calibrated(Calibration {
                quantity,
                gains: gains.iter().map(gain).collect::<BTreeMap<_, _>>(),
            }),
            source: "a.IMD".into(),
        }
    }

    fn values(found: &FoundRadiometry, sun: Option<SunPosition>) -> Values {
        let bands = FileBands {
            kinds: &KINDS,
            places: &[2, 1, 0, 3],
        };
        Values::of_metadata(found, &bands, &Illumination { sun, time: None }, 1000.0)
    }

    const NOON: Option<SunPosition> = Some(SunPosition {
        azimuth_rad: 3.0,
        elevation_rad: FRAC_PI_2,
    });

    #[test]
    fn an_index_is_of_reflectance_where_gains_are_given_and_else_of_values() {
        let grey = |kind: usize| if kind == 0 { 0.2 } else { 0.4 };
        let of = |values: &Values| values.ndvi(&KINDS).expect("both bands").of(grey);
        assert!((of(&Values::default()) - 1.0 / 3.0).abs() < 1e-6);
        // Near infrared has twice the gain: both bands have equal reflectance.
        let red = (CalibratedBand::Red, 0.2, 0.0, Some(1500.0));
        let infrared = (CalibratedBand::NearInfrared, 0.1, 0.0, Some(1500.0));
        let calibrated = values(&found(Quantity::Radiance, &[red, infrared]), NOON);
        assert_eq!(
            (calibrated.kind, calibrated.source.as_deref()),
            (ValueKind::Reflectance, Some("a.IMD"))
        );
        assert!(of(&calibrated).abs() < 1e-6);
        // The offset lowers the reflectance of red.
        let offset = values(
            &found(Quantity::Radiance, &[(red.0, 0.2, -20.0, red.3), infrared]),
            NOON,
        );
        assert!(of(&offset) > 0.3);
    }

    #[test]
    fn without_a_sun_values_are_radiance_and_indices_are_the_same() {
        let gains = [
            (CalibratedBand::Red, 0.2, -3.0, Some(1535.0)),
            (CalibratedBand::NearInfrared, 0.1, -5.5, Some(1056.0)),
        ];
        let low = SunPosition::from_degrees(120.0, 35.0);
        let [lit, unlit] = [Some(low), None].map(|sun| values(&found(Quantity::Radiance, &gains), sun));
        assert_eq!((lit.kind, unlit.kind), (ValueKind::Reflectance, ValueKind::Radiance));
        let [lit, unlit] = [lit, unlit].map(|values| {
            values
                .ndvi(&KINDS)
                .expect("both bands")
                .of(|band| 0.3 + 0.2 * band as f32)
        });
        assert!((lit - unlit).abs() < 1e-6, "{lit} {unlit}");
    }

    #[test]
    fn radiance_of_bands_without_irradiance_makes_no_index_of_reflectance() {
        let gains = [
            (CalibratedBand::Red, 0.2, 0.0, None),
            (CalibratedBand::NearInfrared, 0.1, 0.0, None),
        ];
        let radiance = values(&found(Quantity::Radiance, &gains), NOON);
        assert_eq!((radiance.kind, radiance.reflectance.len()), (ValueKind::Radiance, 0));
        assert_eq!(radiance.ndvi(&KINDS), Values::default().ndvi(&KINDS));
    }

    #[test]
    fn gains_by_place_are_those_of_the_bands_in_the_file() {
        let gains = [
            (CalibratedBand::Place(2), 2e-5, 0.0, None),
            (CalibratedBand::Place(3), 4e-5, 0.0, None),
        ];
        let planet = values(&found(Quantity::Reflectance, &gains), None);
        let scales: Vec<_> = planet
            .reflectance
            .iter()
            .map(|band| band.map(|band| band.scale))
            .collect();
        assert_eq!(scales, [Some(0.02), None, None, Some(0.04)]);
        assert_eq!(planet.kind, ValueKind::Reflectance);
        // The green band has no gain.
        assert_eq!(planet.water_index(&KINDS), Values::default().water_index(&KINDS));
    }

    #[test]
    fn values_for_display_have_no_index() {
        let display = Values::for_display(None);
        assert_eq!((display.ndvi(&KINDS), display.water_index(&KINDS)), (None, None));
        let colours = [BandKind::Red, BandKind::Green, BandKind::Blue];
        assert_eq!(display.vegetation_index(&colours), None);
        assert!(matches!(
            Values::default().vegetation_index(&colours),
            Some(VegetationIndex::Green(_))
        ));
        assert!(matches!(
            Values::default().vegetation_index(&KINDS),
            Some(VegetationIndex::Infrared(_))
        ));
    }

    #[test]
    fn one_image_without_gains_leaves_all_with_counts() {
        let gains = [(CalibratedBand::Red, 2e-5, 0.0, None)];
        let planet = values(&found(Quantity::Reflectance, &gains), None);
        let mut all = vec![
            ("a.tif".to_owned(), planet.clone()),
            ("b.tif".to_owned(), Values::default()),
        ];
        let line = same_for_all(&mut all).expect("a warning");
        assert!(line.contains("b.tif") && line.contains("1 of 2"), "{line}");
        assert!(all.iter().all(|(_, values)| values.reflectance.is_empty()));
        assert_eq!(all[0].1.kind, ValueKind::Reflectance);
        assert_eq!(same_for_all(&mut [("a.tif".to_owned(), planet)]), None);
        assert_eq!(same_for_all(&mut all), None);
    }
}
