//! Every reader on text of its format, made here from one camera; what is missing is named; nothing panics.

mod common;

use common::push_broom::PushBroom;
use heliosplat_rpc::fit::fit_rpc;
use heliosplat_rpc::read::{self, Acquisition, ReadError, acquisition};
use heliosplat_rpc::{ImagePoint, Rpc, write};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::sync::LazyLock;

static CAMERA: LazyLock<Rpc> = LazyLock::new(|| {
    let samples = PushBroom::over(36.9, 37.6).samples(12, &[-100.0, 200.0, 500.0]);
    Rpc {
        error_bias_m: Some(3.25),
        error_random_m: Some(0.5),
        ..fit_rpc(&samples).expect("fits").rpc
    }
});

fn scalars(rpc: &Rpc) -> [f64; 10] {
    std::array::from_fn(|i| write::geotiff_tag(rpc)[2 + i])
}

fn polynomials(rpc: &Rpc) -> [[f64; 20]; 4] {
    [
        rpc.line_numerator,
        rpc.line_denominator,
        rpc.sample_numerator,
        rpc.sample_denominator,
    ]
}

fn rpb_text(rpc: &Rpc) -> String {
    let names = [
        "lineOffset",
        "sampOffset",
        "latOffset",
        "longOffset",
        "heightOffset",
        "lineScale",
        "sampScale",
        "latScale",
        "longScale",
        "heightScale",
    ];
    let mut text = String::from("satId = \"WV03\";\nbandId = \"P\";\nSpecId = \"RPC00B\";\nBEGIN_GROUP = IMAGE\n");
    text += "\terrBias = 3.25;\n\terrRand =   0.5;\n";
    for (name, value) in names.iter().zip(scalars(rpc)) {
        text += &format!("\t{name} =   {value:e};\n");
    }
    for (name, list) in ["lineNumCoef", "lineDenCoef", "sampNumCoef", "sampDenCoef"]
        .iter()
        .zip(polynomials(rpc))
    {
        let values: Vec<String> = list.iter().map(|v| format!("\t\t\t{v:+.16E}")).collect();
        text += &format!("\t{name} = (\n{});\n", values.join(",\n"));
    }
    text + "END_GROUP = IMAGE\nEND;\n"
}

fn dimap_text(rpc: &Rpc, profile: &str, model: &str, direct: &str) -> String {
    let names = ["LINE_NUM_COEFF", "LINE_DEN_COEFF", "SAMP_NUM_COEFF", "SAMP_DEN_COEFF"];
    let coefficients = |scale: f64| -> String {
        let numbered = |(name, list): (&&str, [f64; 20])| -> String {
            (0..20)
                .map(|i| format!("<{name}_{0}>{1:e}</{name}_{0}>\n", i + 1, list[i] * scale))
                .collect()
        };
        names.iter().zip(polynomials(rpc)).map(numbered).collect()
    };
    let keys = [
        "LINE_OFF",
        "SAMP_OFF",
        "LAT_OFF",
        "LONG_OFF",
        "HEIGHT_OFF",
        "LINE_SCALE",
        "SAMP_SCALE",
        "LAT_SCALE",
        "LONG_SCALE",
        "HEIGHT_SCALE",
    ];
    let validity: String = keys
        .iter()
        .zip(scalars(rpc))
        .map(|(key, value)| format!("<{key}>{value:e}</{key}>\n"))
        .collect();
    // The direct model stands first, with the same tags and other numbers: it must not be taken.
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<Dimap_Document>\n<Metadata_Identification>\n\
         <METADATA_PROFILE>{profile}</METADATA_PROFILE></Metadata_Identification>\n<Rational_Function_Model>\n\
         <Global_RFM>\n<{direct}>\n{}</{direct}>\n<{model}>\n{}</{model}>\n<RFM_Validity>\n<{model}_Validity_Domain>\n\
         <LINE_OFF>1</LINE_OFF></{model}_Validity_Domain>\n{validity}</RFM_Validity>\n</Global_RFM>\n\
         </Rational_Function_Model>\n</Dimap_Document>\n",
        coefficients(7.0),
        coefficients(1.0)
    )
}

fn maxar_text(rpc: &Rpc) -> String {
    let names = [
        "LINEOFFSET",
        "SAMPOFFSET",
        "LATOFFSET",
        "LONGOFFSET",
        "HEIGHTOFFSET",
        "LINESCALE",
        "SAMPSCALE",
        "LATSCALE",
        "LONGSCALE",
        "HEIGHTSCALE",
    ];
    let mut image: String = names
        .iter()
        .zip(scalars(rpc))
        .map(|(name, value)| format!("<{name}>{value:e}</{name}>\n"))
        .collect();
    for (name, list) in ["LINENUMCOEF", "LINEDENCOEF", "SAMPNUMCOEF", "SAMPDENCOEF"]
        .iter()
        .zip(polynomials(rpc))
    {
        let values: Vec<String> = list.iter().map(|v| format!("{v:.16e}")).collect();
        image += &format!("<{name}List>\n<{name}>{} </{name}>\n</{name}List>\n", values.join(" "));
    }
    format!(
        "<?xml version=\"1.0\"?>\n<!-- a comment -->\n<isd><IMD><IMAGE><SATID>WV02</SATID>\
         <FIRSTLINETIME>2015-09-30T10:56:56.973685Z</FIRSTLINETIME><MEANSUNAZ>1.621e+02</MEANSUNAZ>\
         <MEANSUNEL>4.03e+01</MEANSUNEL></IMAGE></IMD>\n<RPB><SATID>WV02</SATID><SPECID>RPC00B</SPECID>\n<IMAGE>\n\
         <ERRBIAS>3.25</ERRBIAS><ERRRAND>0.5</ERRRAND>{image}</IMAGE></RPB></isd>"
    )
}

fn geom_text(rpc: &Rpc) -> String {
    let names = [
        "line_off",
        "samp_off",
        "lat_off",
        "long_off",
        "height_off",
        "line_scale",
        "samp_scale",
        "lat_scale",
        "long_scale",
        "height_scale",
    ];
    let mut text = String::from("polynomial_format:  B\nbias_error:  3.25\n");
    for (name, value) in names.iter().zip(scalars(rpc)) {
        text += &format!("{name}:  {value:e}\n");
    }
    for (name, list) in ["line_num_coeff", "line_den_coeff", "samp_num_coeff", "samp_den_coeff"]
        .iter()
        .zip(polynomials(rpc))
    {
        for (i, value) in list.iter().enumerate() {
            text += &format!("{name}_{i:02}:  {value:e}\n");
        }
    }
    text + "support_data.tlc_date:  2015-09-30T10:56:56Z\ntype:  ossimRpcModel\n"
}

/// Sign, one digit, point, six digits, `E`, sign and one digit: what twelve characters hold.
fn fixed_width_text(rpc: &Rpc) -> (String, Rpc) {
    let short = |v: f64| {
        let text = format!("{v:+.6E}");
        let (mantissa, exponent) = text.split_once('E').expect("an exponent");
        let exponent: i32 = exponent.parse().expect("a number");
        if exponent < -9 {
            "+0.000000E+0".to_owned()
        } else {
            format!("{mantissa}E{exponent:+}")
        }
    };
    let s = scalars(rpc);
    let mut text = format!(
        "{:06.0}{:05.0}{:+08.4}{:+09.4}{:+05.0}{:06.0}{:05.0}{:+08.4}{:+09.4}{:+05.0}",
        s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9]
    );
    let lists = polynomials(rpc).map(|list| list.map(short));
    let [line_numerator, line_denominator, sample_numerator, sample_denominator] =
        lists.clone().map(|list| list.map(|v| v.parse().expect("a number")));
    for value in lists.iter().flatten() {
        assert_eq!(value.len(), 12, "{value}");
        text += value;
    }
    let rounded = |v: f64, digits: i32| (v * 10_f64.powi(digits)).round() / 10_f64.powi(digits);
    let expected = Rpc {
        line_offset: rounded(s[0], 0),
        sample_offset: rounded(s[1], 0),
        latitude_offset_deg: rounded(s[2], 4),
        longitude_offset_deg: rounded(s[3], 4),
        height_offset_m: rounded(s[4], 0),
        line_scale: rounded(s[5], 0),
        sample_scale: rounded(s[6], 0),
        latitude_scale_deg: rounded(s[7], 4),
        longitude_scale_deg: rounded(s[8], 4),
        height_scale_m: rounded(s[9], 0),
        line_numerator,
        line_denominator,
        sample_numerator,
        sample_denominator,
        error_bias_m: None,
        error_random_m: None,
    };
    (text, expected)
}

fn without_errors(rpc: &Rpc) -> Rpc {
    Rpc {
        error_bias_m: None,
        error_random_m: None,
        ..rpc.clone()
    }
}

#[test]
fn what_is_written_reads_back_bit_for_bit() {
    let rpc = &*CAMERA;
    assert_eq!(&read::geotiff_tag(&write::geotiff_tag(rpc)).expect("reads"), rpc);
    assert_eq!(&read::rpc_txt(&write::rpc_txt(rpc)).expect("reads"), rpc);
    assert_eq!(&read::gdal_domain(&write::gdal_domain(rpc)).expect("reads"), rpc);
    let json = serde_json::json!({ "img": "a.tif", "rpc": write::satnerf_json_rpc(rpc) }).to_string();
    assert_eq!(read::satnerf_json(&json).expect("reads"), without_errors(rpc));
    let alone = write::satnerf_json_rpc(rpc).to_string();
    assert_eq!(read::satnerf_json(&alone).expect("reads"), without_errors(rpc));
    // Unknown errors stay unknown.
    let unknown = without_errors(rpc);
    assert_eq!(write::geotiff_tag(&unknown)[..2], [-1.0, -1.0]);
    assert_eq!(
        read::geotiff_tag(&write::geotiff_tag(&unknown)).expect("reads"),
        unknown
    );
    assert_eq!(read::rpc_txt(&write::rpc_txt(&unknown)).expect("reads"), unknown);
}

proptest! {
    #[test]
    fn any_finite_number_survives_writing(value in prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL) {
        let rpc = Rpc { line_offset: value, latitude_scale_deg: value, ..CAMERA.clone() };
        prop_assert_eq!(&read::rpc_txt(&write::rpc_txt(&rpc)).expect("reads"), &rpc);
        prop_assert_eq!(&read::gdal_domain(&write::gdal_domain(&rpc)).expect("reads"), &rpc);
    }
}

#[test]
fn every_format_is_recognised_by_its_content() {
    let rpc = &*CAMERA;
    let shifted = Rpc {
        line_offset: rpc.line_offset - 1.0,
        sample_offset: rpc.sample_offset - 1.0,
        ..without_errors(rpc)
    };
    let phr = |profile| dimap_text(rpc, profile, "Inverse_Model", "Direct_Model");
    let neo = dimap_text(rpc, "PNEO_SENSOR", "GroundtoImage_Values", "ImagetoGround_Values");
    for (name, text, expected) in [
        ("RPB", rpb_text(rpc), rpc.clone()),
        ("RPC.TXT", write::rpc_txt(rpc), rpc.clone()),
        ("PHR", phr("PHR_SENSOR"), shifted.clone()),
        ("S6", phr("S6_SENSOR"), shifted.clone()),
        ("S7", phr("S7_SENSOR"), shifted.clone()),
        ("unknown DIMAP with an inverse model", phr("NEW_SENSOR"), shifted),
        ("PNEO", neo, without_errors(rpc)),
        ("Maxar", maxar_text(rpc), rpc.clone()),
        (
            "JSON",
            serde_json::json!({ "rpc": write::satnerf_json_rpc(rpc) }).to_string(),
            without_errors(rpc),
        ),
        ("geom", geom_text(rpc), without_errors(rpc)),
    ] {
        let found = read::rpc_from_text("a file", &text).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(found, expected, "{name}");
        // Carriage returns and a byte order mark change nothing.
        let dos = format!("\u{feff}{}", text.replace('\n', "\r\n"));
        assert_eq!(
            read::rpc_from_text("a file", &dos).unwrap_or_else(|e| panic!("{name}: {e}")),
            expected
        );
    }
    let (text, expected) = fixed_width_text(rpc);
    assert_eq!(read::rpc_from_text("RPC-x.txt", &text).expect("reads"), expected);
    let nitf = format!("10003.250000.50{text}");
    let found = read::fixed_width(&nitf).expect("reads");
    assert_eq!((found.error_bias_m, found.error_random_m), (Some(3.25), Some(0.5)));
    assert_eq!(without_errors(&found), expected);
}

#[test]
fn values_with_units_are_numbers() {
    let mut text = String::new();
    for line in write::rpc_txt(&CAMERA).lines() {
        let (key, value) = line.split_once(": ").expect("a pair");
        let value: f64 = value.parse().expect("a number");
        let mantissa_exponent = format!("{value:+.16e}").replace("e-", "e-00").replace('e', "E");
        let unit = if key.contains("COEFF") { "" } else { " pixels" };
        text += &format!("{key}:\t {mantissa_exponent}{unit}\r\n");
    }
    assert_eq!(read::rpc_txt(&text).expect("reads"), *CAMERA);
    let mut domain = write::gdal_domain(&CAMERA);
    domain.insert("LINE_OFF".into(), "+013741.00 pixels".into());
    domain.insert("MIN_LONG".into(), "36".into());
    assert_eq!(read::gdal_domain(&domain).expect("reads").line_offset, 13_741.0);
}

#[test]
fn whatever_is_missing_is_named() {
    let txt = write::rpc_txt(&CAMERA);
    for key in [
        "LINE_OFF",
        "LONG_SCALE",
        "HEIGHT_OFF",
        "LINE_NUM_COEFF_1",
        "SAMP_DEN_COEFF_20",
    ] {
        let without: String = txt
            .lines()
            .filter(|line| !line.starts_with(&format!("{key}:")))
            .map(|line| format!("{line}\n"))
            .collect();
        let error = read::rpc_txt(&without).expect_err(key);
        assert!(
            matches!(&error, ReadError::Missing { field, .. } if field == key),
            "{key}: {error}"
        );
    }
    for key in write::gdal_domain(&CAMERA).keys().filter(|key| !key.starts_with("ERR")) {
        let mut domain = write::gdal_domain(&CAMERA);
        domain.remove(key);
        let error = read::gdal_domain(&domain).expect_err(key);
        assert_eq!(error.to_string(), format!("GDAL RPC domain: {key} is missing"));
    }
    let json = write::satnerf_json_rpc(&CAMERA);
    for key in json.as_object().expect("object").keys() {
        let mut without = json.clone();
        without.as_object_mut().expect("object").remove(key);
        let error = read::satnerf_json(&without.to_string()).expect_err(key);
        assert_eq!(error.to_string(), format!("Sat-NeRF JSON: {key} is missing"));
    }
    for text in ["{}", "{\"rpc\": 3}", "{\"rpc\": {}}", "[1, 2]"] {
        assert!(
            read::satnerf_json(text)
                .expect_err(text)
                .to_string()
                .contains("is missing")
        );
    }
    assert!(read::satnerf_json("{").expect_err("cut").to_string().contains("EOF"));
}

#[test]
fn numbers_that_cannot_be_a_camera_are_refused() {
    let tag = write::geotiff_tag(&CAMERA);
    assert!(
        read::geotiff_tag(&tag[..91])
            .expect_err("short")
            .to_string()
            .contains("91 values, expected 92")
    );
    for (index, value, field) in [
        (2, f64::NAN, "LINE_OFF"),
        (7, 0.0, "LINE_SCALE"),
        (40, f64::INFINITY, "LINE_DEN"),
    ] {
        let mut bad = tag;
        bad[index] = value;
        let error = read::geotiff_tag(&bad).expect_err(field);
        assert!(
            matches!(&error, ReadError::BadValue { .. }) && error.to_string().contains(field),
            "{error}"
        );
    }
    let mut no_denominator = tag;
    no_denominator[32..52].fill(0.0);
    assert!(
        read::geotiff_tag(&no_denominator)
            .expect_err("zero")
            .to_string()
            .contains("LINE_DEN_COEFF")
    );
    let other = rpb_text(&CAMERA).replace("RPC00B", "RPC00A");
    assert!(
        read::rpb(&other)
            .expect_err("other order")
            .to_string()
            .contains("RPC00A")
    );
    let other = geom_text(&CAMERA).replace("polynomial_format:  B", "polynomial_format:  A");
    assert!(
        read::rpc_from_text("x.geom", &other)
            .expect_err("other order")
            .to_string()
            .contains("polynomial_format")
    );
    let other = maxar_text(&CAMERA).replace("RPC00B", "RPC00A");
    assert!(
        read::maxar_xml(&other)
            .expect_err("other order")
            .to_string()
            .contains("SPECID")
    );
    // The direct model alone is no camera.
    let direct = dimap_text(&CAMERA, "PHR_SENSOR", "Direct_Model", "Direct_Model_2");
    assert!(
        read::dimap(&direct)
            .expect_err("no inverse")
            .to_string()
            .contains("Inverse_Model")
    );
}

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
    // 999.9 is unknown; the other record then speaks, and never one angle of each.
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

/// Texts of all formats, whole.
fn texts() -> Vec<String> {
    let rpc = &*CAMERA;
    vec![
        rpb_text(rpc),
        write::rpc_txt(rpc),
        dimap_text(rpc, "PHR_SENSOR", "Inverse_Model", "Direct_Model"),
        maxar_text(rpc),
        serde_json::json!({ "rpc": write::satnerf_json_rpc(rpc) }).to_string(),
        geom_text(rpc),
        fixed_width_text(rpc).0,
    ]
}

/// Everything that takes text takes any text.
fn read_everything(text: &str) {
    if let Ok(rpc) = read::rpc_from_text("a file", text) {
        // A camera read from damaged text is still safe to use.
        let _ = rpc.localise(ImagePoint { col: 10.0, row: 10.0 }, 0.0);
    }
    let _ = acquisition::from_text("a file", text);
    for reader in [
        read::rpb,
        read::rpc_txt,
        read::dimap,
        read::maxar_xml,
        read::satnerf_json,
        read::ossim_geom,
        read::fixed_width,
    ] {
        let _ = reader(text);
    }
    let _ = acquisition::imd(text);
    let _ = acquisition::dimap(text);
    let _ = acquisition::maxar_xml(text);
    let _ = acquisition::satnerf_json(text);
    let _ = acquisition::stac(text);
    let _ = acquisition::metadata_txt(text);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_never_panic(
        which in 0..7_usize, cut in any::<prop::sample::Index>(), at in any::<prop::sample::Index>(), with in ".{0,6}",
    ) {
        let text = &texts()[which];
        let boundary = |index: usize| (0..=index).rev().find(|i| text.is_char_boundary(*i)).unwrap_or(0);
        let (cut, at) = (boundary(cut.index(text.len())), boundary(at.index(text.len())));
        read_everything(&text[..cut]);
        read_everything(&format!("{}{with}{}", &text[..at], &text[at..]));
        read_everything(&format!("{}{with}{}", &text[..at.min(cut)], &text[at.max(cut)..]));
    }

    #[test]
    fn any_text_never_panics(text in "\\PC*") {
        read_everything(&text);
    }
}
