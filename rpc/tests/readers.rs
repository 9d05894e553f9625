//! Every reader on text of its format, written here from one camera: errors name missing values, and no input panics.

mod common;

use common::texts::{CAMERA, dimap_text, fixed_width_text, geom_text, maxar_text, rpb_text};
use heliosplat_rpc::read::{self, ReadError, acquisition};
use heliosplat_rpc::{ImagePoint, Rpc, write};
use proptest::prelude::*;

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
    let other = rpb_text(&CAMERA).replace("RPC00B", "RPC00X");
    assert!(
        read::rpb(&other)
            .expect_err("other order")
            .to_string()
            .contains("RPC00X")
    );
    let other = geom_text(&CAMERA).replace("polynomial_format:  B", "polynomial_format:  X");
    assert!(
        read::rpc_from_text("x.geom", &other)
            .expect_err("other order")
            .to_string()
            .contains("polynomial_format")
    );
    let other = maxar_text(&CAMERA).replace("RPC00B", "RPC00X");
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

/// The order of RPC00A as STDI-0002 prints it, by name.
#[test]
fn rpc00a_is_put_into_the_order_of_rpc00b() {
    let b = "1 L P H LP LH PH LL PP HH LPH LLL LPP LHH LLP PPP PHH LLH PPH HHH";
    let a = "1 L P H LP LH PH LPH LL PP HH LLL LLP LLH LPP PPP PPH LHH PHH HHH";
    let b: Vec<&str> = b.split(' ').collect();
    let in_a = |of_b: [f64; 20]| {
        let place = |name: &str| b.iter().position(|other| *other == name).expect("a term of both");
        let mut ordered = a.split(' ').map(|name| of_b[place(name)]);
        std::array::from_fn(|_| ordered.next().expect("twenty terms"))
    };
    let mut moved = CAMERA.clone();
    for polynomial in [
        &mut moved.line_numerator,
        &mut moved.line_denominator,
        &mut moved.sample_numerator,
        &mut moved.sample_denominator,
    ] {
        *polynomial = in_a(*polynomial);
    }
    assert_ne!(moved, *CAMERA);
    let text = rpb_text(&moved).replace("RPC00B", "RPC00A");
    assert_eq!(
        read::rpb(&text).expect("RPC00A"),
        read::rpb(&rpb_text(&CAMERA)).expect("RPC00B")
    );
}

#[test]
fn decimal_commas_are_points_where_a_text_has_no_point() {
    let whole = rpb_text(&CAMERA);
    let commas = whole.replace('.', ",");
    assert_eq!(
        read::rpc_from_text("x.rpb", &commas).expect("decimal commas"),
        read::rpb(&whole).expect("decimal points")
    );
    let (before, offset) = whole.split_once("lineOffset").expect("written");
    let both = format!("{before}lineOffset{}", offset.replacen('.', ",", 1));
    assert!(
        read::rpc_from_text("x.rpb", &both).is_err(),
        "a comma among points may mean thousands"
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
