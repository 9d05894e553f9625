//! What products are, for catalogues: a STAC 1.1 Item for the products of a run, a Collection for several, with the extensions
//! projection, raster and view (stacspec.org, stac-extensions.github.io).

use heliosplat::Raster;
use heliosplat_raster::{CrsTransform, GridSpec, RasterError};
use heliosplat_rpc::sun::SunPosition;
use jiff::Timestamp;
use serde_json::{Map, Value, json};

/// Version of the core specification.
const VERSION: &str = "1.1.0";
const PROJECTION: &str = "https://stac-extensions.github.io/projection/v2.0.0/schema.json";
const RASTER: &str = "https://stac-extensions.github.io/raster/v1.1.0/schema.json";
const VIEW: &str = "https://stac-extensions.github.io/view/v1.0.0/schema.json";
const COG: &str = "image/tiff; application=geotiff; profile=cloud-optimized";
const LAZ: &str = "application/vnd.laszip";

/// One band of an asset.
#[derive(Debug, Clone)]
pub struct Band<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its unit, empty where it has none.
    pub unit: &'a str,
}

/// One file.
#[derive(Debug, Clone)]
pub struct Asset {
    /// Its key in the item.
    pub key: String,
    /// Its name in the item's folder.
    pub file: String,
    value: Value,
}

impl Asset {
    /// A raster: its bands, `float32` with nodata -9999 or `uint8` with the nodata given, and the sun it stands for, if any.
    pub fn raster(
        (key, file, title): (&str, &str, &str),
        raster: &Raster,
        bands: &[Band],
        byte_nodata: Option<u8>,
        gsd_m: f64,
        sun: Option<&SunPosition>,
    ) -> Self {
        let described: Vec<Value> = bands
            .iter()
            .enumerate()
            .map(|(index, band)| describe(raster.plane(index), band, byte_nodata, gsd_m))
            .collect();
        let names: Vec<Value> = bands.iter().map(|band| json!({"name": band.name})).collect();
        let mut value = json!({
            "href": format!("./{file}"), "title": title, "type": COG, "roles": ["data"],
            "bands": names, "raster:bands": described,
        });
        if let Some(sun) = sun {
            insert_sun(&mut value, sun);
        }
        Self {
            key: key.into(),
            file: file.into(),
            value,
        }
    }

    /// A point cloud of `count` points.
    pub fn points(file: &str, count: usize) -> Self {
        Self {
            key: "points".into(),
            file: file.into(),
            value: json!({
                "href": format!("./{file}"), "title": "Point cloud", "type": LAZ, "roles": ["data"],
                "description": format!("{count} points: opaque Gaussians, coloured by their albedo"),
            }),
        }
    }
}

fn insert_sun(into: &mut Value, sun: &SunPosition) {
    into["view:sun_azimuth"] = json!(sun.azimuth_rad.to_degrees().rem_euclid(360.0));
    into["view:sun_elevation"] = json!(sun.elevation_rad.to_degrees());
}

fn describe(plane: &[f32], band: &Band, byte_nodata: Option<u8>, gsd_m: f64) -> Value {
    let mut out = json!({
        "data_type": if byte_nodata.is_some() { "uint8" } else { "float32" },
        "nodata": byte_nodata.map_or(f64::from(heliosplat_raster::write::NODATA), f64::from),
        "sampling": "area",
        "spatial_resolution": gsd_m,
    });
    if !band.unit.is_empty() {
        out["unit"] = json!(band.unit);
    }
    if let Some(statistics) = statistics(plane) {
        out["statistics"] = statistics;
    }
    out
}

/// Minimum, maximum, mean and deviation of what is known; `None` where nothing is.
fn statistics(plane: &[f32]) -> Option<Value> {
    let known = || plane.iter().filter(|v| v.is_finite()).map(|&v| f64::from(v));
    let count = known().count();
    if count == 0 {
        return None;
    }
    let mean = known().sum::<f64>() / count as f64;
    let variance = known().map(|v| (v - mean).powi(2)).sum::<f64>() / count as f64;
    Some(json!({
        "minimum": known().fold(f64::INFINITY, f64::min),
        "maximum": known().fold(f64::NEG_INFINITY, f64::max),
        "mean": mean,
        "stddev": variance.sqrt(),
        "valid_percent": 100.0 * count as f64 / plane.len() as f64,
    }))
}

/// What an item is about.
#[derive(Debug, Clone)]
pub struct About<'a> {
    /// Its name.
    pub id: &'a str,
    /// The grid that all rasters share.
    pub grid: &'a GridSpec,
    /// Ground sampling distance, metres.
    pub gsd_m: f64,
    /// What heights are above.
    pub vertical_datum: &'a str,
    /// When the images were taken, in any order; not empty.
    pub times: &'a [Timestamp],
    /// The sun of all products, where there is but one.
    pub sun: Option<&'a SunPosition>,
    /// Name of the collection it belongs to and where that is, seen from the item, if any.
    pub collection: Option<(&'a str, &'a str)>,
}

/// The item of some assets.
///
/// # Errors
/// When a corner of the grid lies outside of its coordinate system.
pub fn item(about: &About, assets: &[Asset]) -> Result<Value, RasterError> {
    let corners = corners(about.grid)?;
    let mut ring: Vec<[f64; 2]> = corners.to_vec();
    ring.push(corners[0]);
    let assets: Map<String, Value> = assets
        .iter()
        .map(|asset| (asset.key.clone(), asset.value.clone()))
        .collect();
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
        "geometry": {"type": "Polygon", "coordinates": [ring]},
        "bbox": bounds(&corners),
        "properties": properties(about),
        "links": links,
        "assets": assets,
    });
    if let Some((name, _)) = about.collection {
        item["collection"] = json!(name);
    }
    Ok(item)
}

fn properties(about: &About) -> Value {
    let grid = about.grid;
    let [west, per_col, col_skew, north, row_skew, per_row] = grid.transform.to_gdal();
    let (width, height) = (grid.width as f64, grid.height as f64);
    let (east, south) = (west + per_col * width, north + per_row * height);
    let mut out = json!({
        "gsd": about.gsd_m,
        "proj:code": grid.crs.definition().starts_with("EPSG:").then(|| grid.crs.definition()),
        "proj:shape": [grid.height, grid.width],
        "proj:bbox": [west, south, east, north],
        "proj:transform": [per_col, col_skew, west, row_skew, per_row, north],
        "view:off_nadir": 0.0,
        "heliosplat:vertical_datum": about.vertical_datum,
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
fn corners(grid: &GridSpec) -> Result<[[f64; 2]; 4], RasterError> {
    let to_lon_lat = CrsTransform::to_lon_lat(&grid.crs)?;
    let (right, bottom) = (grid.width as f64 - 0.5, grid.height as f64 - 0.5);
    let mut out = [[0.0; 2]; 4];
    for (corner, (col, row)) in out
        .iter_mut()
        .zip([(-0.5, bottom), (right, bottom), (right, -0.5), (-0.5, -0.5)])
    {
        let [x, y] = grid.transform.map_from_pixel(col, row);
        let (lon, lat) = to_lon_lat.apply(x, y)?;
        *corner = [lon, lat];
    }
    Ok(out)
}

fn bounds(points: &[[f64; 2]]) -> [f64; 4] {
    let fold = |axis: usize, start: f64, pick: fn(f64, f64) -> f64| points.iter().map(|p| p[axis]).fold(start, pick);
    let (low, high) = (f64::INFINITY, f64::NEG_INFINITY);
    [
        fold(0, low, f64::min),
        fold(1, low, f64::min),
        fold(0, high, f64::max),
        fold(1, high, f64::max),
    ]
}

/// The collection of some items, each with the folder that its `item.json` is in, seen from the collection.
pub fn collection(id: &str, items: &[(String, Value)]) -> Value {
    let corners: Vec<[f64; 2]> = items
        .iter()
        .filter_map(|(_, item)| serde_json::from_value::<[f64; 4]>(item["bbox"].clone()).ok())
        .flat_map(|[west, south, east, north]| [[west, south], [east, north]])
        .collect();
    let times = |key: &'static str| {
        items.iter().filter_map(move |(_, item)| {
            let text = item["properties"][key]
                .as_str()
                .or(item["properties"]["datetime"].as_str());
            text.map(str::to_owned)
        })
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
            "spatial": {"bbox": [bounds(&corners)]},
            "temporal": {"interval": [[times("start_datetime").min(), times("end_datetime").max()]]},
        },
        "links": links,
    })
}
