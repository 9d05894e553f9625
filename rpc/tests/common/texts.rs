//! Texts of every format, made from one camera.

use super::push_broom::PushBroom;
use heliosplat_rpc::fit::fit_rpc;
use heliosplat_rpc::{Rpc, write};
use std::sync::LazyLock;

pub static CAMERA: LazyLock<Rpc> = LazyLock::new(|| {
    let samples = PushBroom::over(36.9, 37.6).samples(12, &[-100.0, 200.0, 500.0]);
    Rpc {
        error_bias_m: Some(3.25),
        error_random_m: Some(0.5),
        ..fit_rpc(&samples).expect("fits").rpc
    }
});

pub fn scalars(rpc: &Rpc) -> [f64; 10] {
    std::array::from_fn(|i| write::geotiff_tag(rpc)[2 + i])
}

pub fn polynomials(rpc: &Rpc) -> [[f64; 20]; 4] {
    [
        rpc.line_numerator,
        rpc.line_denominator,
        rpc.sample_numerator,
        rpc.sample_denominator,
    ]
}

pub fn rpb_text(rpc: &Rpc) -> String {
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

pub fn dimap_text(rpc: &Rpc, profile: &str, model: &str, direct: &str) -> String {
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
    // The direct model is first, with the same tags and other numbers: it must not be read.
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

pub fn maxar_text(rpc: &Rpc) -> String {
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

pub fn geom_text(rpc: &Rpc) -> String {
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

/// Format of a number in twelve characters: sign, one digit, point, six digits, `E`, sign and one digit.
pub fn fixed_width_text(rpc: &Rpc) -> (String, Rpc) {
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
