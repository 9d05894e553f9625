//! Time of acquisition and direction of the sun, from every source.

mod common;

use common::texts::{CAMERA, maxar_text};
use heliosplat_rpc::read::{Acquisition, acquisition};
use std::collections::BTreeMap;

#[test]
fn acquisitions_come_from_every_source() {
    let utc = |text: &str| -> Option<jiff::Timestamp> { Some(text.parse().expect("RFC 3339")) };
    let expected = |time, azimuth, elevation| Acquisition {
        time: utc(time),
        sun_azimuth_deg: Some(azimuth),
        sun_elevation_deg: Some(elevation),
    };
    let imd = "BEGIN_GROUP = IMAGE_1\n\tfirstLineTime = 2015-09-30T10:56:56.973685Z;\n\tTLCTime = 2015-09-30T10:00:00Z;\n\
               \tmeanSunAz = 162.1;\n\tmeanSunEl =  40.3;\nEND_GROUP = IMAGE_1\nEND;\n";
    let located = |place: &str, az: f64| {
        format!(
            "<Located_Geometric_Values><LOCATION_TYPE>{place}</LOCATION_TYPE><TIME>2015-09-30T10:56:56.973685Z</TIME>\
             <Solar_Incidences><SUN_AZIMUTH unit=\"deg\">{az}</SUN_AZIMUTH><SUN_ELEVATION unit=\"deg\">40.3\
             </SUN_ELEVATION></Solar_Incidences></Located_Geometric_Values>"
        )
    };
    let dimap = format!(
        "<Dimap_Document><Dataset_Sources><Source_Identification><Strip_Source><IMAGING_DATE>2015-09-30</IMAGING_DATE>\
         <IMAGING_TIME>09:00:00</IMAGING_TIME></Strip_Source></Source_Identification></Dataset_Sources>{}{}\
         </Dimap_Document>",
        located("Top Left", 1.0),
        located("Center", 162.1)
    );
    let stac = r#"{"type": "Feature", "stac_version": "1.0.0", "properties": {"datetime": "2015-09-30T10:56:56.973685Z",
        "view:sun_azimuth": 162.1, "view:sun_elevation": 40.3}}"#;
    let geoeye = "Source Image ID: 1\nAcquisition Date/Time: 2015-09-30 10:56 GMT\nSun Angle Azimuth: 162.1 degrees\n\
                  Sun Angle Elevation: 40.3 degrees\n";
    let exact = expected("2015-09-30T10:56:56.973685Z", 162.1, 40.3);
    for (name, text, expected) in [
        ("IMD", imd.to_owned(), exact),
        ("Maxar XML", maxar_text(&CAMERA), exact),
        ("DIMAP", dimap, exact),
        ("STAC", stac.to_owned(), exact),
        (
            "Sat-NeRF",
            r#"{"acquisition_date": "20150930105656", "sun_azimuth": "162.1", "sun_elevation": "+40.3"}"#.into(),
            expected("2015-09-30T10:56:56Z", 162.1, 40.3),
        ),
        (
            "own JSON",
            r#"{"acquisition_utc": "2015-09-30T10:56:56.973685Z", "sun_azimuth": -197.9, "sun_elevation": 40.3}"#
                .into(),
            exact,
        ),
        ("GeoEye", geoeye.into(), expected("2015-09-30T10:56:00Z", 162.1, 40.3)),
    ] {
        let found = acquisition::from_text("a file", &text).unwrap_or_else(|| panic!("{name}: nothing"));
        assert_eq!(
            (found.time, found.sun_elevation_deg),
            (expected.time, expected.sun_elevation_deg),
            "{name}"
        );
        let (a, b) = (
            found.sun_azimuth_deg.expect("there"),
            expected.sun_azimuth_deg.expect("there"),
        );
        assert!((a - b).abs() < 1e-9, "{name}: {a}");
    }
    for text in [
        "",
        "hello",
        "{}",
        "<a/>",
        "<Dimap_Document/>",
        "a = 3;",
        "{\"acquisition_date\": \"20150930\"}",
    ] {
        assert_eq!(acquisition::from_text("a file", text), None, "{text}");
    }
}

#[test]
fn gdal_domains_bring_acquisitions_under_many_names() {
    let read = |pairs: &[(&str, &str)]| {
        let items: BTreeMap<String, String> = pairs.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
        acquisition::gdal_domain(&items)
    };
    let time = |text: &str| -> Option<jiff::Timestamp> { Some(text.parse().expect("RFC 3339")) };
    let found = read(&[
        ("NITF_IDATIM", "20150901135603"),
        ("NITF_STDIDC_ACQUISITION_DATE", "20150901135604"),
        ("NITF_USE00A_SUN_EL", "+39.0"),
        ("NITF_USE00A_SUN_AZ", "039.5"),
    ]);
    assert_eq!(found.time, time("2015-09-01T13:56:04Z"));
    assert_eq!(
        (found.sun_azimuth_deg, found.sun_elevation_deg),
        (Some(39.5), Some(39.0))
    );
    // 999.9 means unknown; both angles then come from the other record, never one angle of each.
    let found = read(&[
        ("NITF_USE00A_SUN_EL", "+39.0"),
        ("NITF_USE00A_SUN_AZ", "999.9"),
        ("NITF_CSEXRA_SUN_AZIMUTH", "041.0"),
        ("NITF_CSEXRA_SUN_ELEVATION", "+38.0"),
    ]);
    assert_eq!(
        (found.sun_azimuth_deg, found.sun_elevation_deg),
        (Some(41.0), Some(38.0))
    );
    assert!(read(&[("NITF_USE00A_SUN_EL", "999.9"), ("NITF_USE00A_SUN_AZ", "999.9")]).is_empty());
    assert!(
        read(&[
            ("NITF_IDATIM", "--------------"),
            ("TIFFTAG_DATETIME", "2015:09:01 13:56:03")
        ])
        .is_empty()
    );
    let found = read(&[
        ("IMAGE_1.firstLineTime", "2010-04-01T12:00:00.000000Z"),
        ("IMAGE_1.meanSunAz", "150.0"),
        ("IMAGE_1.meanSunEl", "50.0"),
        ("ACQUISITIONDATETIME", "2010-04-01 12:00:09"),
    ]);
    assert_eq!(found.time, time("2010-04-01T12:00:00Z"));
    assert_eq!(
        (found.sun_azimuth_deg, found.sun_elevation_deg),
        (Some(150.0), Some(50.0))
    );
    let found = read(&[
        ("IMAGING_DATE", "2017-04-12"),
        ("IMAGING_TIME", "11:06:01.9"),
        ("SUN_AZIMUTH", "165.7"),
    ]);
    assert_eq!(found.time, time("2017-04-12T11:06:01.9Z"));
    assert_eq!(
        read(&[("ACQUISITIONDATETIME", "2007-05-01 07:00:00")]).time,
        time("2007-05-01T07:00:00Z")
    );
    assert_eq!(
        read(&[("ACQUISITIONDATETIME", "2010-07-01 00:00:00")]).time,
        None,
        "a date alone"
    );
    assert_eq!(
        read(&[("NITF_IDATIM", "01135603ZSEP98")]).time,
        time("1998-09-01T13:56:03Z")
    );
}

#[test]
fn merging_keeps_what_is_there_and_pairs_of_angles() {
    let time: Option<jiff::Timestamp> = Some("2015-09-30T10:56:56Z".parse().expect("RFC 3339"));
    let angles = Acquisition {
        time: None,
        sun_azimuth_deg: Some(10.0),
        sun_elevation_deg: Some(20.0),
    };
    let half = Acquisition {
        time,
        sun_azimuth_deg: Some(99.0),
        sun_elevation_deg: None,
    };
    assert_eq!(half.merge(angles), Acquisition { time, ..angles });
    assert_eq!(angles.merge(half), Acquisition { time, ..angles });
    assert_eq!(Acquisition::default().merge(half), half);
    assert!(half.stated_sun().is_none());
    assert!(
        half.sun_disagreement_deg(heliosplat_rpc::GeoPoint {
            lon_deg: 0.0,
            lat_deg: 0.0,
            height_m: 0.0
        })
        .is_none()
    );
}
