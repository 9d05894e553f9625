//! Coordinate reference systems: choice for a scene, and transformations by PROJ through GDAL.

use super::{RasterError, Result, messages};
use gdal::spatial_ref::{AxisMappingStrategy, CoordTransform, SpatialRef};
use heliosplat_rpc::GeoPoint;
use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

/// A coordinate reference system that GDAL and its PROJ support.
#[derive(Debug, Clone, PartialEq)]
pub struct Crs {
    definition: String,
    wkt: String,
    name: String,
    vertical: bool,
    geographic: bool,
    metres_per_unit: f64,
    metres_per_height: Option<f64>,
}

/// Length of a degree of longitude on the WGS 84 equator, metres.
const METRES_PER_DEGREE: f64 = 111_319.490_793;

impl Crs {
    /// System of a definition: `EPSG:N` (`EPSG:N+M` with a vertical one) or a code of ESRI, IGNF, OGC or IAU, WKT, or a
    /// PROJ string. Other text is refused, because GDAL would fetch addresses and open files.
    ///
    /// # Errors
    /// [`RasterError::UnknownCrs`] for another form or an unknown system, `RasterError::ProjDatabase` without PROJ's
    /// database.
    pub fn from_definition(definition: &str) -> Result<Self> {
        if let Some(known) = READ.with_borrow(|read| read.get(definition).cloned()) {
            return Ok(known);
        }
        let crs = Self::parse(definition)?;
        READ.with_borrow_mut(|read| read.insert(definition.to_owned(), crs.clone()));
        Ok(crs)
    }

    fn parse(definition: &str) -> Result<Self> {
        let unknown = |reason: String| match reason.contains("proj_create_from_database: Cannot find")
            || reason.contains("SQLite")
        {
            true => RasterError::ProjDatabase(reason),
            false => RasterError::UnknownCrs(shortened(definition), reason),
        };
        let Some(parse) = parser(definition) else {
            return Err(unknown("it is no EPSG:N, no WKT and no PROJ string".to_owned()));
        };
        let read = || {
            let reference = parse(definition)?;
            Ok((reference.to_wkt()?, reference))
        };
        let (wkt, reference) = messages::collect(read).map_err(unknown)?;
        let authority = || messages::collect(|| reference.authority()).ok();
        let authority = (!reference.is_compound()).then(authority).flatten();
        let degrees = reference.is_geographic().then_some(METRES_PER_DEGREE);
        Ok(Self {
            definition: authority.unwrap_or_else(|| wkt.clone()),
            name: reference.name().unwrap_or_else(|| shortened(definition)),
            geographic: reference.is_geographic(),
            vertical: (reference.is_compound() || reference.is_vertical()) && !is_above_ellipsoid(&wkt),
            metres_per_unit: degrees.unwrap_or_else(|| reference.linear_units()),
            metres_per_height: metres_per_height(&reference),
            wkt,
        })
    }

    /// System of a definition without a vertical datum: heights are above the ellipsoid.
    ///
    /// # Errors
    /// Those of [`Crs::from_definition`]; [`RasterError::UnknownCrs`] also for a system with a vertical datum.
    pub fn horizontal(definition: &str) -> Result<Self> {
        let crs = Self::from_definition(definition)?;
        let reason = "heights are above the ellipsoid here".to_owned();
        match crs.vertical {
            true => Err(RasterError::UnknownCrs(crs.name, reason)),
            false => Ok(crs),
        }
    }

    /// System of an EPSG code.
    ///
    /// # Errors
    /// [`RasterError::UnknownCrs`] for an unknown code, `RasterError::ProjDatabase` without PROJ's database.
    pub fn from_epsg(code: u32) -> Result<Self> {
        Self::from_definition(&format!("EPSG:{code}"))
    }

    /// The WGS 84 / UTM zone of a place; polar stereographic (UPS) beyond 84° N and 80° S.
    ///
    /// # Errors
    /// [`RasterError::UnknownCrs`], or `RasterError::ProjDatabase` when PROJ's database is missing.
    pub fn utm(at: GeoPoint) -> Result<Self> {
        Self::from_epsg(utm_epsg(at.lon_deg, at.lat_deg))
    }

    /// A short name, such as `WGS 84 / UTM zone 37N`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// `EPSG:N` where known, else the whole WKT.
    pub fn definition(&self) -> &str {
        &self.definition
    }

    /// The system as WKT.
    pub fn wkt(&self) -> &str {
        &self.wkt
    }

    /// True if the system has a vertical datum; heights are ellipsoidal otherwise.
    pub fn has_vertical_datum(&self) -> bool {
        self.vertical
    }

    /// True if its coordinates are longitude and latitude in degrees.
    pub fn is_geographic(&self) -> bool {
        self.geographic
    }

    /// Metres per unit of its heights; `None` where it has no vertical part.
    pub fn metres_per_height(&self) -> Option<f64> {
        self.metres_per_height
    }

    /// Metres per unit of its coordinates; for degrees, along the equator.
    pub fn metres_per_unit(&self) -> f64 {
        self.metres_per_unit
    }
}

/// Parser of a definition; `None` if it is of no known kind or names files.
fn parser(definition: &str) -> Option<fn(&str) -> gdal::errors::Result<SpatialRef>> {
    let is_word =
        |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
    let first_word = |grids: &str| grids.split([' ', '"']).next().unwrap_or_default().to_owned();
    let names_a_file = |grids: &str| first_word(grids).contains(['/', '\\']);
    if definition.contains("init=") || definition.split("grids=").skip(1).any(names_a_file) {
        return None;
    }
    if definition.starts_with('+') {
        return Some(SpatialRef::from_proj4);
    }
    let keyword = definition.split_once(['[', '(']).map(|(keyword, _)| keyword.trim());
    if keyword.is_some_and(is_word) {
        return Some(SpatialRef::from_wkt);
    }
    let (authority, code) = definition.split_once(':')?;
    let known = ["EPSG", "ESRI", "IGNF", "OGC", "IAU_2015"].contains(&authority.to_uppercase().as_str());
    (known && code.split('+').all(is_word)).then_some(SpatialRef::from_definition)
}

/// Metres per unit of the vertical part.
fn metres_per_height(reference: &SpatialRef) -> Option<f64> {
    let unit = reference.get_attr_value("VERT_CS|UNIT", 1).ok().flatten()?;
    let metres: Option<f64> = unit.parse().ok();
    metres.filter(|metres| metres.is_finite() && *metres > 0.0)
}

/// True if the vertical part of a WKT is the height above the ellipsoid, by its name: EPSG has no code for ellipsoidal
/// heights alone, and programs that state them (CARS) write a name.
fn is_above_ellipsoid(wkt: &str) -> bool {
    let name_of = |keyword: &str| wkt.split_once(keyword)?.1.split('"').next();
    let name = name_of("VERT_CS[\"").or_else(|| name_of("VERTCRS[\""));
    name.is_some_and(|name| name.to_lowercase().contains("ellipsoid"))
}

fn shortened(definition: &str) -> String {
    const LONGEST: usize = 60;
    match definition.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}...", &definition[..end]),
        None => definition.to_owned(),
    }
}

/// EPSG code of the UTM zone (UPS near the poles) of a longitude and latitude in degrees, with the exceptions of
/// south-west Norway and Svalbard (DMA TM 8358.2, §2-1).
pub fn utm_epsg(lon_deg: f64, lat_deg: f64) -> u32 {
    if lat_deg >= 84.0 {
        return 32661;
    }
    if lat_deg < -80.0 {
        return 32761;
    }
    let lon = (lon_deg + 180.0).rem_euclid(360.0) - 180.0;
    let regular = (((lon + 180.0) / 6.0).floor() as u32).min(59) + 1;
    let zone = if (56.0..64.0).contains(&lat_deg) && (3.0..12.0).contains(&lon) {
        32
    } else if lat_deg >= 72.0 && (0.0..42.0).contains(&lon) {
        match lon {
            x if x < 9.0 => 31,
            x if x < 21.0 => 33,
            x if x < 33.0 => 35,
            _ => 37,
        }
    } else {
        regular
    };
    if lat_deg >= 0.0 { 32600 + zone } else { 32700 + zone }
}

thread_local! {
    /// Systems parsed by this thread, by definition.
    static READ: RefCell<HashMap<String, Crs>> = RefCell::default();
    /// Transformations made by this thread, by source and target; a process needs few.
    static MADE: RefCell<HashMap<[String; 2], Rc<CoordTransform>>> = RefCell::default();
}

/// GDAL's object for a definition that was accepted before, with x to the east.
fn reference(definition: &str) -> gdal::errors::Result<SpatialRef> {
    let mut reference =
        parser(definition).map_or_else(|| SpatialRef::from_wkt(definition), |parse| parse(definition))?;
    reference.set_axis_mapping_strategy(AxisMappingStrategy::TraditionalGisOrder);
    Ok(reference)
}

/// A transformation between two coordinate systems; x is east (or longitude), y north (or latitude), always.
///
/// Transformations belong to one thread and cost milliseconds to make: each thread keeps those it made.
pub struct CrsTransform {
    transform: Rc<CoordTransform>,
    target: String,
}

impl CrsTransform {
    /// Transformation from WGS 84 longitude and latitude in degrees to `target`.
    ///
    /// # Errors
    /// [`RasterError::UnknownCrs`] when PROJ has no transformation between the two systems.
    pub fn from_lon_lat(target: &Crs) -> Result<Self> {
        Self::between("EPSG:4326", target.definition(), target.name())
    }

    /// Transformation from `source` to WGS 84 longitude and latitude in degrees.
    ///
    /// # Errors
    /// [`RasterError::UnknownCrs`] when PROJ has no transformation between the two systems.
    pub fn to_lon_lat(source: &Crs) -> Result<Self> {
        Self::between(source.definition(), "EPSG:4326", "WGS 84")
    }

    /// Transformation from one system to another.
    ///
    /// # Errors
    /// [`RasterError::UnknownCrs`] when PROJ has no transformation between the two systems.
    pub fn new(source: &Crs, target: &Crs) -> Result<Self> {
        Self::between(source.definition(), target.definition(), target.name())
    }

    fn between(source: &str, target: &str, name: &str) -> Result<Self> {
        let key = [source, target].map(str::to_owned);
        let known = MADE.with_borrow(|made| made.get(&key).cloned());
        let transform = match known {
            Some(transform) => transform,
            None => {
                let made = messages::collect(|| {
                    let [source, target] = [source, target].map(reference);
                    CoordTransform::new(&source?, &target?)
                });
                let made = Rc::new(made.map_err(|reason| RasterError::UnknownCrs(name.to_owned(), reason))?);
                MADE.with_borrow_mut(|all| all.insert(key, Rc::clone(&made)));
                made
            }
        };
        let target = name.to_owned();
        Ok(Self { transform, target })
    }

    /// Transforms one point, in map units or degrees.
    ///
    /// # Errors
    /// [`RasterError::Transform`] for a point outside of the target system.
    pub fn apply(&self, x: f64, y: f64) -> Result<(f64, f64)> {
        let failed = |reason: String| RasterError::Transform(self.target.clone(), reason);
        let (mut x, mut y) = ([x], [y]);
        messages::collect(|| self.transform.transform_coords(&mut x, &mut y, &mut [])).map_err(failed)?;
        match x[0].is_finite() && y[0].is_finite() {
            true => Ok((x[0], y[0])),
            false => Err(failed("the point lies outside of it".to_owned())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn utm_zones_follow_the_grid_and_its_exceptions() {
        let cases = [
            (36.91, 37.58, 32637),
            (-81.66, 30.35, 32617),
            (5.0, 60.0, 32632),
            (8.9, 78.0, 32631),
            (9.1, 78.0, 32633),
            (180.0, 10.0, 32601),
            (-180.0, -10.0, 32701),
            (179.999, -10.0, 32760),
            (10.0, 85.0, 32661),
            (10.0, -81.0, 32761),
        ];
        for (lon, lat, epsg) in cases {
            assert_eq!(utm_epsg(lon, lat), epsg, "{lon} {lat}");
        }
    }

    /// Longitude, latitude, EPSG, easting, northing: from PROJ 9.1.1.
    const FROM_PROJ: [(f64, f64, u32, f64, f64); 4] = [
        (2.35, 48.85, 32631, 452_314.891_233_666, 5_410_984.887_604_44),
        (-81.66, 30.35, 32617, 436_568.395_077_271, 3_357_753.826_763_99),
        (150.9, -33.8, 32756, 305_599.516_395_902, 6_258_036.886_805_46),
        (-58.4, -34.6, 32721, 371_624.544_190_303, 6_170_423.240_398_88),
    ];

    #[test]
    fn east_comes_first_in_every_system() {
        for (lon, lat, epsg, easting, northing) in FROM_PROJ {
            let crs = Crs::from_epsg(epsg).expect("a UTM zone");
            let (east, north) = CrsTransform::from_lon_lat(&crs)
                .and_then(|to| to.apply(lon, lat))
                .expect("inside the zone");
            assert!(
                (east - easting).hypot(north - northing) < 1e-5,
                "{epsg}: {east} {north}"
            );
            let back = CrsTransform::to_lon_lat(&crs).and_then(|to| to.apply(east, north));
            let (lon_back, lat_back) = back.expect("inside the zone");
            assert!((lon_back - lon).hypot(lat_back - lat) < 1e-10);
        }
        // EPSG names northing and latitude first in these.
        for (epsg, east_most) in [(31468, 4e6), (4258, 1e1)] {
            let crs = Crs::from_epsg(epsg).expect("a German and a European system");
            let to = CrsTransform::from_lon_lat(&crs).expect("a transformation");
            let (east, _) = to.apply(12.0, 48.0).expect("inside");
            assert!(east > east_most && east < 1.2 * east_most + 1e5, "{epsg}: {east}");
        }
    }

    #[test]
    fn a_place_outside_of_a_system_is_an_error() {
        let crs = Crs::from_epsg(32631).expect("a UTM zone");
        let to = CrsTransform::to_lon_lat(&crs).expect("a transformation");
        assert!(matches!(to.apply(1e30, 1e30), Err(RasterError::Transform(..))));
        let mercator = Crs::from_epsg(3395).expect("World Mercator");
        let to = CrsTransform::from_lon_lat(&mercator).expect("a transformation");
        assert!(matches!(to.apply(0.0, f64::NAN), Err(RasterError::Transform(..))));
    }

    #[test]
    fn an_unknown_code_is_an_error_that_names_it() {
        let error = Crs::from_definition("EPSG:999999").expect_err("there is no such code");
        assert!(error.to_string().contains("EPSG:999999"), "{error}");
    }

    #[test]
    fn definitions_name_no_files_and_no_addresses() {
        for definition in [
            "EPSG:32637",
            "epsg:32637+5773",
            "+proj=utm +zone=37 +datum=WGS84",
            "ESRI:54009",
        ] {
            let crs = Crs::from_definition(definition).expect("of a known kind");
            Crs::from_definition(crs.definition()).expect("its own definition");
            Crs::from_definition(crs.wkt()).expect("its own WKT");
        }
        for definition in [
            "http://127.0.0.1:9/a.wkt",
            "/vsicurl_streaming/http://127.0.0.1:9/a.wkt",
            "/etc/passwd",
            "scene.prj",
            "urn:ogc:def:crs:EPSG::32637",
            "{\"type\": \"ProjectedCRS\"}",
            "+init=/etc/passwd:a",
            "+proj=longlat +nadgrids=/dev/zero",
            "EPSG:",
            "EPSG:32637/../a",
            "WGS84",
            "",
        ] {
            assert!(Crs::from_definition(definition).is_err(), "{definition}");
        }
    }

    #[test]
    fn heights_above_the_ellipsoid_are_no_vertical_datum_whatever_program_names_them() {
        let of = |vertical: &str| {
            let utm = Crs::from_epsg(32617).expect("a UTM zone");
            let wkt = format!(
                r#"COMPD_CS["both",{},VERT_CS["{vertical}",VERT_DATUM["unknown",2005],UNIT["metre",1],AXIS["Up",UP]]]"#,
                utm.wkt()
            );
            Crs::from_definition(&wkt)
                .expect("a compound system")
                .has_vertical_datum()
        };
        assert!(!of("WGS 84 ellipsoidal height"));
        assert!(of("EGM96 height"));
    }
}
