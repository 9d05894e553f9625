use super::*;
use crate::sun::earth_sun_distance_au;

fn calibrated(found: Option<Radiometry>) -> Calibration {
    match found {
        Some(Radiometry::Calibrated(calibration)) => calibration,
        other => panic!("{other:?}"),
    }
}

fn near(found: f64, expected: f64) {
    assert!(
        (found - expected).abs() <= 1e-9 * expected.abs().max(1.0),
        "{found} for {expected}"
    );
}

/// An IMD of a multispectral image with factors of red and near infrared.
fn imd_text(satellite: &str, level: &str) -> String {
    let band = |name: &str, factor: &str, width: &str| {
        format!(
            "BEGIN_GROUP = BAND_{name}\n\tULLon =  36.9;\n\tabsCalFactor = {factor};\n\teffectiveBandwidth = {width};\n\tTDILevel = 13;\n\
             END_GROUP = BAND_{name}\n"
        )
    };
    format!(
        "version = \"28.3\";\nbandId = \"BGRN\";\nradiometricLevel = \"{level}\";\nradiometricEnhancement = \"Off\";\nbitsPerPixel = 16;\n\
         {}{}BEGIN_GROUP = IMAGE_1\n\tsatId = \"{satellite}\";\n\tmeanSunEl =  60.0;\nEND_GROUP = IMAGE_1\nEND;\n",
        band("R", "1.100000000000000e-02", "5.500000000000000e-02"),
        band("N", "1.000000000000000e-02", "1.000000000000000e-01"),
    )
}

#[test]
fn an_imd_gives_radiance_with_the_corrections_of_its_satellite() {
    for (satellite, gain, offset, irradiance) in [("WV03", 0.964, -3.021, 1535.33), ("QB02", 1.060, -2.954, 1553.78)] {
        let calibration = calibrated(from_text(&imd_text(satellite, "Corrected")));
        assert_eq!(calibration.quantity, Quantity::Radiance);
        let red = calibration.gains[&CalibratedBand::Red];
        near(red.scale, gain * 0.2);
        near(red.offset, offset);
        assert_eq!(red.irradiance_w_m2_um, Some(irradiance));
        assert_eq!(calibration.gains.len(), 2);
    }
}

#[test]
fn a_satellite_without_published_irradiance_gives_radiance_as_delivered() {
    let red = calibrated(from_text(&imd_text("WV04", "Corrected"))).gains[&CalibratedBand::Red];
    near(red.scale, 0.2);
    assert_eq!((red.offset, red.irradiance_w_m2_um), (0.0, None));
    assert_eq!(red.to_reflectance(1.0, 1.0), None);
}

#[test]
fn an_adjusted_dynamic_range_is_for_display_and_has_no_gains() {
    assert_eq!(
        from_text(&imd_text("WV02", "Corrected (DRA)")),
        Some(Radiometry::Display)
    );
    let compensated = imd_text("WV02", "Corrected").replace("\"Off\"", "\"ACOMP\"");
    assert_eq!(from_text(&compensated), None);
}

#[test]
fn gains_in_xml_are_those_of_the_imd() {
    let band = |name: &str, factor: f64, width: f64| {
        format!(
            "<BAND_{name}><ULLON>36.9</ULLON><ABSCALFACTOR>{factor}</ABSCALFACTOR><EFFECTIVEBANDWIDTH>{width}</EFFECTIVEBANDWIDTH></BAND_{name}>"
        )
    };
    let xml = format!(
        "<?xml version=\"1.0\"?><isd><IMD><RADIOMETRICLEVEL>Corrected</RADIOMETRICLEVEL>{}{}<IMAGE><SATID>WV03</SATID></IMAGE></IMD></isd>",
        band("R", 0.011, 0.055),
        band("N", 0.01, 0.1),
    );
    assert_eq!(from_text(&xml), from_text(&imd_text("WV03", "Corrected")));
}

/// A DIMAP of Pleiades with red and near infrared.
fn dimap_text(processing: &str) -> String {
    let radiance = |id: &str, gain: &str| {
        format!(
            "<Band_Radiance><BAND_ID>{id}</BAND_ID><MEASURE_DESC>L=DN/GAIN+BIAS</MEASURE_DESC><GAIN>{gain}</GAIN><BIAS>0.5</BIAS></Band_Radiance>"
        )
    };
    let irradiance = |id: &str, value: f64| {
        format!("<Band_Solar_Irradiance><BAND_ID>{id}</BAND_ID><VALUE>{value}</VALUE></Band_Solar_Irradiance>")
    };
    format!(
        "<?xml version=\"1.0\"?><Dimap_Document><RADIOMETRIC_PROCESSING>{processing}</RADIOMETRIC_PROCESSING><Band_Measurement_List>\
         {}{}{}{}{}</Band_Measurement_List></Dimap_Document>",
        radiance("B2", "10.0"),
        radiance("B3", "16.0"),
        radiance("B0", "GAIN"),
        irradiance("B2", 1546.0),
        irradiance("B3", 1078.0),
    )
}

#[test]
fn a_dimap_divides_by_gains_and_leaves_placeholders_out() {
    let calibration = calibrated(from_text(&dimap_text("BASIC")));
    assert_eq!(calibration.gains.len(), 2);
    let infrared = calibration.gains[&CalibratedBand::NearInfrared];
    near(infrared.scale, 1.0 / 16.0);
    near(infrared.offset, 0.5);
    assert_eq!(infrared.irradiance_w_m2_um, Some(1078.0));
}

#[test]
fn a_dimap_says_what_its_counts_are_already() {
    let calibration = calibrated(from_text(&dimap_text("REFLECTANCE")));
    assert_eq!(calibration.quantity, Quantity::Reflectance);
    near(calibration.gains[&CalibratedBand::Red].scale, 1e-4);
    assert_eq!(from_text(&dimap_text("LINEAR_STRETCH")), Some(Radiometry::Display));
}

#[test]
fn the_first_dimap_counts_its_bands() {
    let text = "<Dimap_Document><Image_Interpretation><Spectral_Band_Info><BAND_INDEX>1</BAND_INDEX><PHYSICAL_BIAS>0</PHYSICAL_BIAS>\
        <PHYSICAL_GAIN>2.5</PHYSICAL_GAIN></Spectral_Band_Info></Image_Interpretation><Solar_Irradiance><Band_Solar_Irradiance>\
        <BAND_INDEX>1</BAND_INDEX><SOLAR_IRRADIANCE_VALUE>1858</SOLAR_IRRADIANCE_VALUE></Band_Solar_Irradiance></Solar_Irradiance></Dimap_Document>";
    let first = calibrated(from_text(text)).gains[&CalibratedBand::Place(0)];
    near(first.scale, 0.4);
    assert_eq!(first.irradiance_w_m2_um, Some(1858.0));
}

#[test]
fn planet_says_reflectance_per_count() {
    let band = |number: usize, rest: &str| {
        format!(
            "<ps:bandSpecificMetadata><ps:bandNumber>{number}</ps:bandNumber><ps:radiometricScaleFactor>0.01</ps:radiometricScaleFactor>{rest}\
             </ps:bandSpecificMetadata>"
        )
    };
    let text = |rest: &str| {
        format!(
            "<?xml version=\"1.0\"?><ps:EarthObservation xmlns:ps=\"http://schemas.planet.com/ps/v1\">{}{}</ps:EarthObservation>",
            band(1, rest),
            band(2, rest)
        )
    };
    let coefficient = "<ps:reflectanceCoefficient>2.2e-05</ps:reflectanceCoefficient>";
    let calibration = calibrated(from_text(&text(coefficient)));
    assert_eq!(calibration.quantity, Quantity::Reflectance);
    near(calibration.gains[&CalibratedBand::Place(1)].scale, 2.2e-5);
    assert_eq!(calibrated(from_text(&text(""))).quantity, Quantity::Radiance);
    let description =
        "{\"properties\": {\"radiometric_scale_factor\": 0.01, \"reflectance_coefficients\": [0.0021, 0.0025]}}";
    near(
        calibrated(from_text(description)).gains[&CalibratedBand::Place(1)].scale,
        0.0025,
    );
}

#[test]
fn scales_of_bands_count_where_a_unit_says_what_they_lead_to() {
    let bands = |unit| [(Some(1e-4), Some(-0.1), unit), (Some(1e-4), None, unit)];
    let reflectance = calibrated(Calibration::of_bands(&bands("Reflectance")));
    assert_eq!(reflectance.gains[&CalibratedBand::Place(0)].offset, -0.1);
    let radiance = calibrated(Calibration::of_bands(&bands("W/(m2 sr um)")));
    assert_eq!(radiance.quantity, Quantity::Radiance);
    for nothing in [
        Calibration::of_bands(&bands("")),
        Calibration::of_bands(&[(None, None, "reflectance")]),
        Calibration::of_bands(&[]),
    ] {
        assert_eq!(nothing, None);
    }
}

#[test]
fn reflectance_follows_from_sun_and_distance() {
    let white = Gain {
        scale: 0.5,
        offset: 0.0,
        irradiance_w_m2_um: Some(1500.0),
    };
    // A white level plane under a sun at 30 degrees sends back half of the irradiance, over pi.
    let counts = 1500.0 * 0.5 / PI / 0.5;
    let gain = white.to_reflectance(30f64.to_radians(), 1.0).expect("a sun");
    near(gain.scale * counts, 1.0);
    assert_eq!(white.to_reflectance(-0.1, 1.0), None);
    let distance = |date: &str| earth_sun_distance_au(date.parse().expect("a time"));
    // Perihelion and aphelion of 2020 by the Astronomical Almanac.
    assert!((distance("2020-01-05T08:00:00Z") - 0.983_244).abs() < 1e-4);
    assert!((distance("2020-07-04T12:00:00Z") - 1.016_694).abs() < 1e-4);
}

#[test]
fn damaged_texts_say_nothing() {
    let texts = [imd_text("WV03", "Corrected"), dimap_text("BASIC")];
    for text in &texts {
        for end in (0..text.len()).step_by(7) {
            let _ = from_text(&text[..end]);
        }
    }
    let zero = texts[0]
        .replace("5.500000000000000e-02", "0")
        .replace("1.000000000000000e-01", "nan");
    assert_eq!(from_text(&zero), None);
    assert_eq!(from_text(""), None);
}
