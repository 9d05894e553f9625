//! STAC 1.1 metadata of products: an Item for the products of a run, a Collection for several, with the extensions
//! projection, raster and view (stacspec.org, stac-extensions.github.io).

use super::style::located;
use heliosplat::Raster;
use heliosplat_raster::{CrsTransform, GridSpec, RasterError, Result};
use heliosplat_rpc::sun::SunPosition;
use jiff::Timestamp;
use serde_json::{Map, Value, json};
use std::path::Path;

/// Version of the core specification.
const VERSION: &str = "1.1.0";
const PROJECTION: &str = "https://stac-extensions.github.io/projection/v2.0.0/schema.json";
const RASTER: &str = "https://stac-extensions.github.io/raster/v2.0.0/schema.json";
const VIEW: &str = "https://stac-extensions.github.io/view/v1.0.0/schema.json";
const COG: &str = "image/tiff; application=geotiff; profile=cloud-optimized";
const LAZ: &str = "application/vnd.laszip";

/// Band of an asset.
#[derive(Debug, Clone)]
pub struct Band<'a> {
    /// Name of the band.
    pub name: &'a str,
    /// Unit of the band; empty where it has none.
    pub unit: &'a str,
}

/// Encoding of the values of a raster in a file.
#[derive(Debug, Clone, Copy)]
pub enum Numbers {
    /// Unconverted values; nodata -9999.
    Float,
    /// Values rounded to whole numbers, with this nodata.
    Byte(u8),
    /// Days since 1970 as dates, YYYYMMDD; nodata 0.
    Dates,
}

/// File of an item.
#[derive(Debug, Clone)]
pub struct Asset {
    /// Key of the asset in the item.
    pub key: String,
    /// Name of the file in the item's folder.
    pub file: String,
    value: Value,
}

impl Asset {
    /// Asset of a raster: key, file and title, its bands, the encoding of their values in the file, the ground sampling
    /// distance, metres, and the sun of the values, if any.
    pub fn raster(
        names: (&str, &str, &str),
        raster: &Raster,
        bands: &[Band],
        numbers: Numbers,
        gsd_m: f64,
        sun: Option<&SunPosition>,
    ) -> Self {
        let described = |(index, band)| describe(raster.plane(index), band, numbers, gsd_m);
        let mut asset = Self::other(names, COG, "data");
        asset.value["bands"] = bands.iter().enumerate().map(described).collect();
        if let Some(sun) = sun {
            insert_sun(&mut asset.value, sun);
        }
        asset
    }

    /// Asset of a file other than a raster: key, file and title, media type and role.
    pub fn other((key, file, title): (&str, &str, &str), media_type: &str, role: &str) -> Self {
        Self {
            key: key.into(),
            file: file.into(),
            value: json!({"href": located(file), "title": title, "type": media_type, "roles": [role]}),
        }
    }

    /// Asset of a point cloud of `count` points.
    pub fn points(file: &str, count: usize) -> Self {
        let mut asset = Self::other(("points", file, "Point cloud"), LAZ, "data");
        asset.value["description"] = format!("{count} points: opaque Gaussians, coloured by their albedo").into();
        asset
    }
}

fn insert_sun(into: &mut Value, sun: &SunPosition) {
    let [azimuth, elevation] = sun.degrees();
    into["view:sun_azimuth"] = json!(azimuth);
    into["view:sun_elevation"] = json!(elevation);
}

fn describe(plane: &[f32], band: &Band, numbers: Numbers, gsd_m: f64) -> Value {
    let float_nodata = f64::from(heliosplat_raster::write::NODATA);
    let (data_type, nodata) = match numbers {
        Numbers::Float => ("float32", float_nodata),
        Numbers::Byte(nodata) => ("uint8", nodata.into()),
        Numbers::Dates => ("int32", 0.0),
    };
    let stored = |&value: &f32| match numbers {
        Numbers::Float => value.into(),
        Numbers::Byte(_) => value.round().into(),
        Numbers::Dates => crate::change::as_date(value as i32).into(),
    };
    let is_known = |value: &&f32| value.is_finite() && !(matches!(numbers, Numbers::Dates) && **value == 0.0);
    let known: Vec<f64> = plane.iter().filter(is_known).map(stored).collect();
    let mut out = json!({
        "name": band.name,
        "data_type": data_type,
        "nodata": nodata,
        "raster:sampling": "area",
        "raster:spatial_resolution": gsd_m,
    });
    if !band.unit.is_empty() {
        out["unit"] = json!(band.unit);
    }
    if !known.is_empty() {
        let count = known.len() as f64;
        let mean = known.iter().sum::<f64>() / count;
        let variance = known.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count;
        out["statistics"] = json!({
            "minimum": known.iter().copied().fold(f64::INFINITY, f64::min),
            "maximum": known.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            "mean": mean,
            "stddev": variance.sqrt(),
            "valid_percent": 100.0 * count / plane.len() as f64,
        });
    }
    out
}

/// Assets of an earlier item on the same grid whose files still exist and are not written anew.
pub(crate) fn kept(earlier: &Value, item: &Value, folder: &Path) -> Map<String, Value> {
    let mut keys = ["proj:code", "proj:shape", "proj:transform", "heliosplat:vertical_datum"].iter();
    let same = keys.all(|key| earlier["properties"][*key] == item["properties"][*key]);
    let assets = earlier["assets"].as_object().filter(|_| same);
    let is_kept = |(key, asset): &(&String, &Value)| {
        let file = asset["href"].as_str().map(|href| folder.join(href));
        item["assets"].get(key.as_str()).is_none() && file.is_some_and(|file| file.is_file())
    };
    let kept = assets.into_iter().flatten().filter(is_kept);
    kept.map(|(key, asset)| (key.clone(), asset.clone())).collect()
}

/// Metadata of an item besides its grid and its assets.
#[derive(Debug, Clone)]
pub struct ItemMetadata<'a> {
    /// Name of the item.
    pub id: &'a str,
    /// Acquisition times of the images, in any order; not empty.
    pub times: &'a [Timestamp],
    /// Sun of all products; `None` where there is not exactly one.
    pub sun: Option<&'a SunPosition>,
    /// Name of the collection of the item and its location relative to the item, if any.
    pub collection: Option<(&'a str, &'a str)>,
}

/// Grid of all rasters of an item, the size of its cells in metres, and the name of the vertical datum of heights.
type Place<'a> = (&'a GridSpec, f64, &'a str);

/// STAC Item of some assets, as JSON.
///
/// # Errors
/// When a corner of the grid lies outside of its coordinate system.
pub fn item(about: &ItemMetadata, place: Place, assets: &[Asset]) -> Result<Value> {
    let corners = corners(place.0)?;
    let assets = assets.iter().map(|asset| (asset.key.clone(), asset.value.clone()));
    let assets: Map<String, Value> = assets.collect();
    let links = match about.collection {
        Some((_, href)) => ["root", "parent", "collection"]
            .map(|rel| json!({"rel": rel, "href": href, "type": "application/json"}))
            .to_vec(),
        None => Vec::new(),
    };
    let mut item = json!({
        "type": "Feature",
        "stac_version": VERSION,
        "stac_extensions": [PROJECTION, RASTER, VIEW],
        "id": about.id,
        "geometry": geometry(&corners),
        "bbox": bounds(&[west_east(&corners)]),
        "properties": properties(about, place),
        "links": links,
        "assets": assets,
    });
    if let Some((name, _)) = about.collection {
        item["collection"] = json!(name);
    }
    Ok(item)
}

fn properties(about: &ItemMetadata, (grid, gsd_m, vertical_datum): Place) -> Value {
    let [west, per_col, col_skew, north, row_skew, per_row] = grid.transform.to_gdal();
    let (width, height) = (grid.width as f64, grid.height as f64);
    let (east, south) = (west + per_col * width, north + per_row * height);
    let mut out = json!({
        "gsd": gsd_m,
        "proj:code": grid.crs.definition().starts_with("EPSG:").then(|| grid.crs.definition()),
        "proj:shape": [grid.height, grid.width],
        "proj:bbox": [west, south, east, north],
        "proj:transform": [per_col, col_skew, west, row_skew, per_row, north],
        "view:off_nadir": 0.0,
        "heliosplat:vertical_datum": vertical_datum,
        "heliosplat:version": env!("CARGO_PKG_VERSION"),
    });
    let (first, last) = (about.times.iter().min(), about.times.iter().max());
    if first == last {
        out["datetime"] = json!(first.map(ToString::to_string));
    } else {
        out["datetime"] = Value::Null;
        out["start_datetime"] = json!(first.map(ToString::to_string));
        out["end_datetime"] = json!(last.map(ToString::to_string));
    }
    if let Some(sun) = about.sun {
        insert_sun(&mut out, sun);
    }
    out
}

/// Longitude and latitude of the grid's outer corners, counter-clockwise from the south-west.
fn corners(grid: &GridSpec) -> Result<[[f64; 2]; 4]> {
    let to_lon_lat = CrsTransform::to_lon_lat(&grid.crs)?;
    let (right, bottom) = (grid.width as f64 - 0.5, grid.height as f64 - 0.5);
    let corner = |(col, row): (f64, f64)| {
        let [x, y] = grid.transform.map_from_pixel(col, row);
        Ok::<[f64; 2], RasterError>(to_lon_lat.apply(x, y)?.into())
    };
    let [a, b, c, d] = [(-0.5, bottom), (right, bottom), (right, -0.5), (-0.5, -0.5)].map(corner);
    Ok([a?, b?, c?, d?])
}

/// Longitude that differs from a longitude by whole turns and is nearest to `other`, degrees.
fn around(lon: f64, other: f64) -> f64 {
    other + (lon - other + 180.0).rem_euclid(360.0) - 180.0
}

/// A longitude from -180 up to 180 degrees.
fn wrapped(lon: f64) -> f64 {
    around(lon, 0.0)
}

/// West, south, east, north of points that lie less than half of the Earth apart; east is above 180 degrees where they
/// lie on both sides of the antimeridian.
fn west_east(points: &[[f64; 2]]) -> [f64; 4] {
    let first = points.first().map_or(0.0, |point| point[0]);
    let mut found = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for &[lon, lat] in points {
        let lon = around(lon, first);
        found = [
            found[0].min(lon),
            found[1].min(lat),
            found[2].max(lon),
            found[3].max(lat),
        ];
    }
    match found[0] < -180.0 {
        true => [found[0] + 360.0, found[1], found[2] + 360.0, found[3]],
        false => found,
    }
}

/// Bounding box of boxes whose east is not below their west: as in GeoJSON, with the west above the east where it
/// crosses the antimeridian (RFC 7946, 5.2). It is the narrowest one: all longitudes but the widest gap between the
/// boxes.
fn bounds(boxes: &[[f64; 4]]) -> [f64; 4] {
    let (mut south, mut north) = (f64::INFINITY, f64::NEG_INFINITY);
    let mut spans = Vec::with_capacity(boxes.len());
    for &[west, low, east, high] in boxes {
        (south, north) = (south.min(low), north.max(high));
        spans.push((west, east));
    }
    spans.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some(&(first, _)) = spans.first() else {
        return [-180.0, -90.0, 180.0, 90.0];
    };
    // Once around from the first: the end of the longitudes covered so far, and the widest gap between boxes.
    let (mut end, mut widest) = (f64::NEG_INFINITY, (f64::NEG_INFINITY, first, first));
    for (west, east) in spans.iter().copied().chain([(first + 360.0, first + 360.0)]) {
        if end.is_finite() && west - end > widest.0 {
            widest = (west - end, end, west);
        }
        end = end.max(east);
    }
    let (gap, east, west) = widest;
    if gap <= 0.0 {
        return [-180.0, south, 180.0, north];
    }
    // A box that ends or begins on the antimeridian does so on its own side of it.
    let wrapped_west = wrapped(west);
    let east_of_west = around(east, wrapped_west + 180.0);
    let turn = if east_of_west > 180.0 { 360.0 } else { 0.0 };
    let east = east_of_west - turn;
    [wrapped_west, south, east, north]
}

/// Outline of corners in counter-clockwise order, in two parts where it crosses the antimeridian (RFC 7946, 3.1.9).
fn geometry(corners: &[[f64; 2]; 4]) -> Value {
    let closed = |mut ring: Vec<[f64; 2]>| {
        ring.extend(ring.first().copied());
        ring
    };
    let [west, _, east, _] = west_east(corners);
    if east <= 180.0 {
        return json!({"type": "Polygon", "coordinates": [closed(corners.to_vec())]});
    }
    let middle = 0.5 * (west + east);
    let ring: Vec<[f64; 2]> = corners.iter().map(|&[lon, lat]| [around(lon, middle), lat]).collect();
    let (before, after) = (side(&ring, 1.0), side(&ring, -1.0));
    let after = after.into_iter().map(|[lon, lat]| [lon - 360.0, lat]).collect();
    json!({"type": "MultiPolygon", "coordinates": [[closed(before)], [closed(after)]]})
}

/// Part of a ring west (`sign` 1) or east (-1) of 180 degrees; points are longitude and latitude, degrees.
fn side(ring: &[[f64; 2]], sign: f64) -> Vec<[f64; 2]> {
    let beyond = |point: &[f64; 2]| sign * (point[0] - 180.0);
    let mut out = Vec::with_capacity(ring.len() + 2);
    for (index, a) in ring.iter().enumerate() {
        let b = &ring[(index + 1) % ring.len()];
        if beyond(a) <= 0.0 {
            out.push(*a);
        }
        if beyond(a) * beyond(b) < 0.0 {
            let t = (180.0 - a[0]) / (b[0] - a[0]);
            out.push([180.0, a[1] + t * (b[1] - a[1])]);
        }
    }
    out
}

/// STAC Collection of some items, as JSON. Each item comes with its folder, relative to the collection.
pub fn collection(id: &str, items: &[(String, Value)]) -> Value {
    let boxes = items.iter();
    let boxes = boxes.filter_map(|(_, item)| serde_json::from_value::<[f64; 4]>(item["bbox"].clone()).ok());
    let unwrapped =
        |[west, south, east, north]: [f64; 4]| [west, south, if east < west { east + 360.0 } else { east }, north];
    let boxes: Vec<[f64; 4]> = boxes.map(unwrapped).collect();
    let times = |key: &'static str| {
        let all = items.iter().map(|(_, item)| &item["properties"]);
        all.filter_map(move |all| all[key].as_str().or(all["datetime"].as_str()).map(str::to_owned))
    };
    let mut links = vec![json!({"rel": "root", "href": "./collection.json", "type": "application/json"})];
    links.extend(items.iter().map(
        |(folder, _)| json!({"rel": "item", "href": format!("./{folder}/item.json"), "type": "application/geo+json"}),
    ));
    json!({
        "type": "Collection",
        "stac_version": VERSION,
        "id": id,
        "description": format!("{} areas, modelled by heliosplat {}", items.len(), env!("CARGO_PKG_VERSION")),
        "license": "other",
        "extent": {
            "spatial": {"bbox": [bounds(&boxes)]},
            "temporal": {"interval": [[times("start_datetime").min(), times("end_datetime").max()]]},
        },
        "links": links,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat_raster::Crs;
    use heliosplat_rpc::{GeoPoint, LocalFrame};

    fn item_at(lon_deg: f64, lat_deg: f64) -> Value {
        let origin = GeoPoint::new(lon_deg, lat_deg, 0.0);
        let crs = Crs::utm(origin).expect("UTM");
        let rectangle = [-500.0, -500.0, 500.0, 500.0];
        let grid = GridSpec::covering(&LocalFrame::new(origin), rectangle, &crs, 1.0).expect("a grid");
        let about = ItemMetadata {
            id: "place",
            times: &[Timestamp::UNIX_EPOCH],
            sun: None,
            collection: None,
        };
        item(&about, (&grid, 1.0, "WGS84 ellipsoid"), &[]).expect("an item")
    }

    fn bbox(of: &Value) -> [f64; 4] {
        serde_json::from_value(of.clone()).expect("four numbers")
    }

    #[test]
    fn a_file_of_dates_is_described_by_the_dates_it_holds() {
        let day = crate::change::as_day(jiff::civil::date(2023, 2, 7)) as f32;
        let mut raster = Raster::filled(2, 2, 1, day);
        raster.values[0] = 0.0;
        let bands = [Band {
            name: "changed_at",
            unit: "",
        }];
        let asset = Asset::raster(("a", "a.tif", ""), &raster, &bands, Numbers::Dates, 0.5, None);
        let band = &asset.value["bands"][0];
        assert_eq!((&band["data_type"], &band["nodata"]), (&json!("int32"), &json!(0.0)));
        assert_eq!(band["statistics"]["valid_percent"], 75.0);
        for key in ["minimum", "maximum"] {
            assert_eq!(band["statistics"][key], 20_230_207.0, "{band}");
        }
    }

    #[test]
    fn an_item_across_the_antimeridian_has_its_west_above_its_east_and_two_parts() {
        for lon in [180.0, 179.999, -179.999] {
            let item = item_at(lon, -17.0);
            let [west, south, east, north] = bbox(&item["bbox"]);
            assert!(
                west > 179.98 && east < -179.98 && south < -17.0 && north > -17.0,
                "{lon}: {}",
                item["bbox"]
            );
            assert_eq!(item["geometry"]["type"], "MultiPolygon");
            let parts = item["geometry"]["coordinates"].as_array().expect("parts");
            let lons = |part: &Value| -> Vec<f64> {
                let ring = part[0].as_array().expect("a ring");
                assert!(ring.len() >= 4 && ring.first() == ring.last());
                ring.iter().map(|point| point[0].as_f64().expect("a number")).collect()
            };
            assert!(
                lons(&parts[0]).iter().all(|lon| (179.98..=180.0).contains(lon)),
                "{}",
                parts[0]
            );
            assert!(
                lons(&parts[1]).iter().all(|lon| (-180.0..=-179.98).contains(lon)),
                "{}",
                parts[1]
            );
        }
    }

    #[test]
    fn an_item_elsewhere_is_one_polygon() {
        for lon in [0.0, 35.9999, 179.9, -179.9] {
            let item = item_at(lon, 37.0);
            let [west, _, east, _] = bbox(&item["bbox"]);
            assert!(west < lon && lon < east && east - west < 0.013, "{}", item["bbox"]);
            assert_eq!(item["geometry"]["type"], "Polygon");
        }
    }

    #[test]
    fn a_collection_spans_no_more_of_the_earth_than_its_items() {
        let extent = |lons: &[f64]| {
            let items: Vec<_> = lons.iter().map(|lon| (String::new(), item_at(*lon, -17.0))).collect();
            let collection = collection("places", &items);
            bbox(&collection["extent"]["spatial"]["bbox"][0])
        };
        let [west, _, east, _] = extent(&[179.0, -179.0]);
        assert!(
            (west - 178.995).abs() < 0.01 && (east + 178.995).abs() < 0.01,
            "{west} {east}"
        );
        let [west, _, east, _] = extent(&[180.0, 179.0, -178.5]);
        assert!(
            west < 179.0 && west > 178.9 && east > -178.5 && east < -178.4,
            "{west} {east}"
        );
        let [west, _, east, _] = extent(&[10.0, 12.0, 11.0]);
        assert!(west < 10.0 && west > 9.9 && east > 12.0 && east < 12.1, "{west} {east}");
    }
}
