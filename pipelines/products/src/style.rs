//! QGIS styles of products: a style file (`.qml`) beside each raster, which QGIS applies when the raster is opened, and
//! a layer file (`.qlr`) that opens all rasters of a folder as one group.
//!
//! The renderers are templates in `style/`, in the format of QGIS 3.22, which later versions read; ranges are filled in
//! from the values.

use heliosplat::Raster;
use heliosplat_grid::statistics::quantile;
use heliosplat_raster::virtual_raster::escaped;
use heliosplat_raster::{Crs, Result, write_atomically};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

/// Most values from which a range is computed.
const SAMPLES: usize = 200_000;
/// Share of the values cut off below, and above, the range that is stretched.
const CUT: f64 = 0.02;
/// Gamma from counts of light to display values.
const DISPLAY_GAMMA: f32 = 2.2;

/// Colours of altitudes, from low to high ground.
pub const GROUND: [&str; 5] = ["#2c5e4a", "#8fae6b", "#e8dca5", "#b8855a", "#f7f4ef"];
/// Colours of amounts, such as hours of sun, from little to much.
pub const SUN: [&str; 5] = ["#1b1b4d", "#5e3c8b", "#c0527f", "#f28e55", "#fdf3b0"];

/// Colours of height differences, from lowered to raised ground.
pub const FELL_AND_ROSE: [&str; 5] = ["#2166ac", "#92c5de", "#f7f7f7", "#f4a582", "#b2182b"];

/// Colour (red, green, blue) at a share of the way through `colours`, 0 to 1; each of these is `#rrggbb`.
pub fn colour(colours: &[&str], share: f32) -> [u8; 3] {
    let last = colours.len().saturating_sub(1);
    let at = share.clamp(0.0, 1.0) * last as f32;
    let channel = |place: usize, channel: usize| {
        let text = colours.get(place.min(last));
        let digits = text.and_then(|text| text.get(2 * channel + 1..2 * channel + 3));
        let value = digits.and_then(|digits| u8::from_str_radix(digits, 16).ok());
        f32::from(value.unwrap_or(0))
    };
    let place = at as usize;
    [0, 1, 2].map(|c| (channel(place, c) + at.fract() * (channel(place + 1, c) - channel(place, c))).round() as u8)
}

/// Style of a raster layer, with the range of its values.
#[derive(Debug, Clone, PartialEq)]
pub enum Style {
    /// Altitudes by colour.
    Heights([f32; 2]),
    /// Amounts by colour, such as hours of sun.
    Amounts([f32; 2]),
    /// Positive and negative differences by colour, from minus to plus this value.
    Differences(f32),
    /// Grey between two values.
    Shades([f32; 2]),
    /// Red, green and blue from the bands with these numbers, from 1, between two values.
    Colours([usize; 3], [f32; 2]),
    /// Mask: label and colour of the marked cells; the others show the layers below.
    Mask(&'static str, &'static str),
}

impl Style {
    /// Style of altitudes, with the range of `values`.
    pub fn heights(values: &[f32]) -> Self {
        Self::Heights(range(values))
    }

    /// Style of amounts, from zero to the end of the range of `values`.
    pub fn amounts(values: &[f32]) -> Self {
        let [_, most] = range(values);
        Self::Amounts([0.0, most])
    }

    /// Writes the style file of a raster beside it.
    ///
    /// # Errors
    /// When the style file cannot be written.
    pub fn write(&self, raster: &Path) -> Result<()> {
        write_atomically(&raster.with_extension("qml"), self.qml().as_bytes())
    }

    /// Style of an image whose bands have these names: red, green and blue where all three exist, otherwise the first
    /// band in grey.
    pub fn colours(raster: &Raster, names: &[&str]) -> Self {
        let of = |name| names.iter().position(|&n| n == name);
        match (of("red"), of("green"), of("blue")) {
            (Some(red), Some(green), Some(blue)) => Self::Colours(
                [red + 1, green + 1, blue + 1],
                joined([red, green, blue].map(|band| range(raster.plane(band)))),
            ),
            _ => Self::Shades(range(raster.plane(0))),
        }
    }

    /// Style of a mask by the name of its band, which is also its label.
    pub fn mask(name: &'static str) -> Self {
        Self::Mask(name, if name == "vegetation" { "#2e8b3a" } else { "#14143c" })
    }

    /// Style in the style file `qml` of this module; `None` for a mask, which has no range.
    fn read(qml: &str) -> Option<Self> {
        let between = |before: &str, after: &str| Some(qml.split_once(before)?.1.split_once(after)?.0);
        let number = |before, after| between(before, after)?.parse::<f32>().ok();
        let band = |name: &str| between(&format!("{name}Band=\""), "\"")?.parse().ok();
        if let (Some(low), Some(high)) = (number("minimumValue=\"", "\""), number("maximumValue=\"", "\"")) {
            let has = |colours: [&str; 5]| qml.contains(colours[1]);
            return Some(match (has(GROUND), has(FELL_AND_ROSE)) {
                (true, _) => Self::Heights([low, high]),
                (_, true) => Self::Differences(high),
                _ => Self::Amounts([low, high]),
            });
        }
        let range = [number("<minValue>", "<")?, number("<maxValue>", "<")?];
        match (band("red"), band("green"), band("blue")) {
            (Some(red), Some(green), Some(blue)) => Some(Self::Colours([red, green, blue], range)),
            _ => Some(Self::Shades(range)),
        }
    }

    /// Style of a raster that is joined from rasters with these style files: that of the first, with the widest range.
    pub fn of_joined(qmls: &[String]) -> Option<Self> {
        let mut styles = qmls.iter().filter_map(|qml| Self::read(qml));
        let first = styles.next()?;
        Some(styles.fold(first, |whole, part| match (whole, part) {
            (Self::Heights(a), Self::Heights(b)) => Self::Heights(wider(a, b)),
            (Self::Amounts(a), Self::Amounts(b)) => Self::Amounts(wider(a, b)),
            (Self::Differences(a), Self::Differences(b)) => Self::Differences(a.max(b)),
            (Self::Shades(a), Self::Shades(b)) => Self::Shades(wider(a, b)),
            (Self::Colours(bands, a), Self::Colours(_, b)) => Self::Colours(bands, wider(a, b)),
            (whole, _) => whole,
        }))
    }

    /// True if the layer is visible when its group is opened.
    fn is_shown(&self) -> bool {
        matches!(self, Self::Heights(_) | Self::Shades(_))
    }

    /// Renderer of the style and its display settings, as XML.
    fn pipe(&self) -> String {
        const RAMP: &str = include_str!("style/heights.xml");
        let (template, [low, high], colours): (_, _, &[&str]) = match self {
            Self::Heights(range) => (RAMP, *range, &GROUND),
            Self::Amounts(range) => (RAMP, *range, &SUN),
            Self::Differences(most) => (RAMP, [-most, *most], &FELL_AND_ROSE),
            Self::Shades(range) => (include_str!("style/shades.xml"), *range, &[]),
            Self::Colours(_, range) => (include_str!("style/colours.xml"), *range, &[]),
            Self::Mask(..) => (include_str!("style/mask.xml"), [0.0, 1.0], &[]),
        };
        let text = template.replace("{low}", &low.to_string());
        let text = text.replace("{high}", &high.to_string());
        let mut text = text.replace("{items}", &items(colours, [low, high]));
        match self {
            Self::Colours(bands, _) => {
                for (name, band) in ["{red}", "{green}", "{blue}"].into_iter().zip(bands) {
                    text = text.replace(name, &band.to_string());
                }
            }
            Self::Mask(label, colour) => text = text.replace("{label}", label).replace("{colour}", colour),
            _ => (),
        }
        let gamma = match self {
            Self::Colours(..) => DISPLAY_GAMMA,
            _ => 1.0,
        };
        format!(" <pipe>\n{text}  <brightnesscontrast brightness=\"0\" contrast=\"0\" gamma=\"{gamma}\"/>\n </pipe>\n")
    }

    /// Content of the style file.
    pub fn qml(&self) -> String {
        format!(
            "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n<qgis version=\"3.22.0\" styleCategories=\"Symbology\">\n{}\
             <blendMode>{}</blendMode>\n</qgis>\n",
            self.pipe(),
            self.blend_mode()
        )
    }

    /// QGIS number of a layer's blend mode: 6 multiplies by the layers below, for the hillshade.
    fn blend_mode(&self) -> u8 {
        if matches!(self, Self::Shades([1.0, _])) { 6 } else { 0 }
    }
}

/// Raster in a layer file, as that file's XML.
#[derive(Debug, Clone)]
pub struct Layer {
    /// File of the raster, relative to the folder of the layer file.
    pub file: String,
    tree: String,
    map: String,
}

impl Layer {
    /// Layer of a raster file with a title, a style and a coordinate system.
    pub fn new(file: &str, title: &str, style: &Style, crs: &Crs) -> Self {
        let is_code = |text: &&str| text.starts_with("EPSG:") && !text.contains('+');
        let (wkt, code) = (escaped(crs.wkt()), Some(crs.definition()).filter(is_code));
        let srs = format!("<wkt>{wkt}</wkt><authid>{}</authid>", escaped(code.unwrap_or_default()));
        let (name, title) = (escaped(&located(file)), escaped(title));
        let id = format!("heliosplat_{}", file.replace(|c: char| !c.is_ascii_alphanumeric(), "_"));
        let checked = match style.is_shown() {
            true => "Qt::Checked",
            false => "Qt::Unchecked",
        };
        Self {
            file: file.to_owned(),
            tree: format!(
                "  <layer-tree-layer id=\"{id}\" name=\"{title}\" source=\"{name}\" providerKey=\"gdal\" checked=\"{checked}\" expanded=\"0\"/>\n"
            ),
            map: format!(
                "  <maplayer type=\"raster\">\n <id>{id}</id>\n <datasource>{name}</datasource>\n <layername>{title}</layername>\n \
                 <provider>gdal</provider>\n <srs><spatialrefsys>{srs}</spatialrefsys></srs>\n{} <blendMode>{}</blendMode>\n  </maplayer>\n",
                style.pipe(),
                style.blend_mode()
            ),
        }
    }

    /// Layer of the raster `file` in `layers`, the content of an earlier layer file; `None` where it is not there.
    pub fn earlier(layers: &str, file: &str) -> Option<Self> {
        let name = escaped(&located(file));
        let source = format!("source=\"{name}\"");
        let tree = layers.split_inclusive('\n').find(|line| line.contains(&source))?;
        let mut maps = layers.split("  <maplayer ").skip(1);
        let map = maps.find(|map| map.contains(&format!("<datasource>{name}</datasource>")))?;
        let (map, _) = map.split_once("</maplayer>")?;
        Some(Self {
            file: file.to_owned(),
            tree: tree.to_owned(),
            map: format!("  <maplayer {map}</maplayer>\n"),
        })
    }

    /// Layers of the virtual rasters (`.vrt`) over the rasters in `layers`, the layer files of their parts, with the
    /// styles of the virtual rasters. Rasters that the first part lacks come after those that precede them in another.
    pub fn of_virtual(layers: &[String], styles: &BTreeMap<String, Option<Style>>) -> Vec<Self> {
        let mut order: Vec<(&String, &String)> = Vec::new();
        for text in layers {
            let at = |file: &str| text.find(&format!("source=\"{}\"", escaped(&located(file))));
            let mut files: Vec<_> = styles.keys().filter_map(|file| Some((at(file)?, file))).collect();
            files.sort();
            let mut next = 0;
            for (_, file) in files {
                let known = order.iter().position(|(known, _)| *known == file);
                if known.is_none() {
                    order.insert(next, (file, text));
                }
                next = known.unwrap_or(next) + 1;
            }
        }
        let layer = |(file, text): (&String, &String)| {
            let Self { tree, map, .. } = Self::earlier(text, file)?;
            let style = styles.get(file).and_then(Option::as_ref);
            let map = match (style, map.split_once(" <pipe>"), map.split_once("</pipe>\n")) {
                (Some(style), Some((before, _)), Some((_, after))) => format!("{before}{}{after}", style.pipe()),
                _ => map,
            };
            let [file, tree, map] = [file, &tree, &map].map(|text| text.replace(".tif", ".vrt"));
            Some(Self { file, tree, map })
        };
        order.into_iter().filter_map(layer).collect()
    }
}

/// Reference to a file in the folder or in another one, as in layer files and items.
pub(crate) fn located(file: &str) -> String {
    match file.starts_with("../") {
        true => file.to_owned(),
        false => format!("./{file}"),
    }
}

/// Content of the layer file of a group, the topmost layer first.
pub fn layer_file(group: &str, layers: &[Layer]) -> String {
    let tree: String = layers.iter().map(|layer| layer.tree.as_str()).collect();
    let maps: String = layers.iter().map(|layer| layer.map.as_str()).collect();
    // QGIS drops the outer group and takes its contents.
    format!(
        "<!DOCTYPE qgis-layer-definition>\n<qlr>\n <layer-tree-group name=\"\" checked=\"Qt::Checked\" expanded=\"1\">\n \
         <layer-tree-group name=\"{}\" checked=\"Qt::Checked\" expanded=\"1\">\n{tree} </layer-tree-group>\n </layer-tree-group>\n \
         <maplayers>\n{maps} </maplayers>\n</qlr>\n",
        escaped(group)
    )
}

/// Items of a colour ramp from low to high, as XML.
fn items(colours: &[&str], [low, high]: [f32; 2]) -> String {
    let last = colours.len().saturating_sub(1).max(1) as f32;
    let mut text = String::new();
    for (place, colour) in colours.iter().enumerate() {
        let value = low + (high - low) * place as f32 / last;
        let item = format!("value=\"{value}\" label=\"{value:.1}\" color=\"{colour}\" alpha=\"255\"");
        let _ = writeln!(text, "     <item {item}/>");
    }
    text
}

/// Range of the known values between their two cuts, never empty.
fn range(plane: &[f32]) -> [f32; 2] {
    let step = (plane.len() / SAMPLES).max(1);
    let mut known: Vec<f32> = plane.iter().copied().step_by(step).filter(|v| v.is_finite()).collect();
    let low = quantile(&mut known, CUT).unwrap_or(0.0);
    let high = quantile(&mut known, 1.0 - CUT).unwrap_or(1.0);
    [low, if high > low { high } else { low + 1.0 }]
}

fn joined(ranges: [[f32; 2]; 3]) -> [f32; 2] {
    ranges.into_iter().fold([f32::INFINITY, f32::NEG_INFINITY], wider)
}

/// Range that contains two ranges.
fn wider([low, high]: [f32; 2], by: [f32; 2]) -> [f32; 2] {
    [low.min(by[0]), high.max(by[1])]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_lies_between_its_neighbours() {
        assert_eq!(colour(&["#000000", "#ff8040"], 0.5), [128, 64, 32]);
        assert_eq!(colour(&GROUND, -1.0), [0x2c, 0x5e, 0x4a]);
        assert_eq!(colour(&GROUND, 2.0), [0xf7, 0xf4, 0xef]);
        assert_eq!(colour(&[], 0.5), [0; 3]);
    }

    #[test]
    fn no_place_in_a_template_stays_open_and_names_of_users_stay_text() {
        let styles = [
            Style::Heights([1.0, 2.0]),
            Style::Amounts([0.0, 9.5]),
            Style::Differences(3.0),
            Style::Shades([1.0, 255.0]),
            Style::Colours([3, 2, 1], [0.0, 0.4]),
            Style::mask("shadow"),
        ];
        for style in &styles {
            let qml = style.qml();
            assert!(!qml.contains(['{', '}']), "{qml}");
        }
        let crs = Crs::from_epsg(32_637).expect("UTM");
        let layers = styles.map(|style| Layer::new("a&b.tif", "a <b>", &style, &crs));
        let text = layer_file("\"run\"", &layers);
        assert!(!text.contains(['{', '}']) && text.contains("a&amp;b.tif") && text.contains("a &lt;b&gt;"));
        assert_eq!(text.matches("<maplayer ").count(), 6);
        assert_eq!(text.matches("<authid>EPSG:32637</authid>").count(), 6);
    }

    #[test]
    fn a_joined_raster_has_the_widest_range_of_its_parts() {
        let joined = |styles: &[Style]| Style::of_joined(&styles.iter().map(Style::qml).collect::<Vec<_>>());
        let [low, high] = [[-3.5, 20.0], [8.0, 412.25]];
        for kind in [Style::Heights, Style::Amounts, Style::Shades, |range| {
            Style::Colours([3, 2, 1], range)
        }] {
            assert_eq!(joined(&[kind(low), kind(high)]), Some(kind([-3.5, 412.25])));
        }
        let differences = [Style::Differences(2.0), Style::Differences(1.5)];
        assert_eq!(joined(&differences), Some(Style::Differences(2.0)));
        assert_eq!(joined(&[Style::mask("shadow"), Style::mask("shadow")]), None);
    }

    #[test]
    fn layers_of_virtual_rasters_keep_the_titles_and_order_of_all_their_parts() {
        let crs = Crs::from_epsg(32_637).expect("UTM");
        let part = [
            Layer::new("hillshade.tif", "Relief", &Style::Shades([1.0, 255.0]), &crs),
            Layer::new("dsm.tif", "Heights", &Style::Heights([1.0, 2.0]), &crs),
            Layer::new("shadow.tif", "Shadow", &Style::mask("shadow"), &crs),
        ];
        let whole = Style::Heights([1.0, 77.5]);
        let styles = [
            ("dsm.tif", Some(whole.clone())),
            ("hillshade.tif", None),
            ("rare.tif", None),
            ("shadow.tif", None),
        ];
        let styles = styles.map(|(file, style)| (file.to_owned(), style)).into();
        let rare = Layer::new("rare.tif", "Rare", &Style::mask("shadow"), &crs);
        let other = [part[1].clone(), rare];
        let texts = [layer_file("block", &part), layer_file("other", &other)];
        let layers = Layer::of_virtual(&texts, &styles);
        let files: Vec<&str> = layers.iter().map(|layer| layer.file.as_str()).collect();
        assert_eq!(files, ["hillshade.vrt", "dsm.vrt", "rare.vrt", "shadow.vrt"]);
        assert!(layers[1].tree.contains("name=\"Heights\"") && layers[1].map.contains(&whole.pipe()));
        assert!(!layer_file("whole", &layers).contains(".tif"));
    }

    #[test]
    fn a_layer_of_an_earlier_file_is_kept_as_it_was() {
        let crs = Crs::from_epsg(32_637).expect("UTM");
        let [heights, relit] =
            ["../dsm.tif", "relit.tif"].map(|file| Layer::new(file, file, &Style::mask("shadow"), &crs));
        let text = layer_file("run", &[heights, relit]);
        let kept = ["../dsm.tif", "relit.tif"].map(|file| Layer::earlier(&text, file).expect("a layer"));
        assert_eq!(layer_file("run", &kept), text);
        assert!(Layer::earlier(&text, "dsm.tif").is_none() && Layer::earlier("", "relit.tif").is_none());
    }

    #[test]
    fn colours_come_from_the_bands_of_their_names_and_ranges_leave_outliers_out() {
        let mut image = Raster::filled(100, 1, 4, 0.0);
        for (index, value) in image.values.iter_mut().enumerate() {
            *value = (index % 100) as f32;
        }
        image.values[0] = 1e9;
        image.values[50] = f32::NAN;
        let style = Style::colours(&image, &["blue", "green", "red", "near_infrared"]);
        let Style::Colours(bands, [low, high]) = style else {
            panic!("{style:?}");
        };
        assert_eq!(bands, [3, 2, 1]);
        assert!(low < 4.0 && (95.0..101.0).contains(&high), "{low} {high}");
        assert!(matches!(Style::colours(&image, &["grey"]), Style::Shades(_)));
    }
}
