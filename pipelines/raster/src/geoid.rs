//! Heights of geoids above the WGS 84 ellipsoid, from PROJ's grids. Nothing is downloaded: a missing grid is an error
//! that names it.

use super::{Crs, CrsTransform, GridSpec, RasterError, Result, messages};
use gdal::spatial_ref::{AxisMappingStrategy, CoordTransform, CoordTransformOptions, SpatialRef};

/// A model of mean sea level.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Geoid {
    /// EGM96, on a grid of 15 minutes.
    Egm96,
    /// EGM2008, on a grid of 2.5 minutes.
    Egm2008,
}

impl Geoid {
    /// Name, such as `EGM96`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Egm96 => "EGM96",
            Self::Egm2008 => "EGM2008",
        }
    }

    /// EPSG code of the vertical system of heights above it.
    pub fn epsg(self) -> u32 {
        match self {
            Self::Egm96 => 5773,
            Self::Egm2008 => 3855,
        }
    }

    /// PROJ's files of its grid, the preferred one first.
    fn grids(self) -> &'static [&'static str] {
        match self {
            Self::Egm96 => &["us_nga_egm96_15.tif", "egm96_15.gtx"],
            Self::Egm2008 => &["us_nga_egm08_25.tif", "egm08_25.gtx"],
        }
    }

    /// The horizontal system of a definition, and the geoid of its vertical part, if it has one.
    ///
    /// # Errors
    /// The errors of `Crs::from_definition`, and [`RasterError::UnknownCrs`] for a vertical part other than EGM96 and
    /// EGM2008.
    pub fn of_definition(definition: &str) -> Result<(Crs, Option<Self>)> {
        let whole = Crs::from_definition(definition)?;
        if !whole.has_vertical_datum() {
            return Ok((whole, None));
        }
        let parts = definition.split_once('+');
        let parts = parts.filter(|(horizontal, _)| horizontal.contains(':'));
        let geoid = parts.and_then(|(_, vertical)| match vertical.parse() {
            Ok(5773) => Some(Self::Egm96),
            Ok(3855) => Some(Self::Egm2008),
            _ => None,
        });
        let reason = "heights are written above the ellipsoid, or in metres above EGM96 as EPSG:N+5773 or EGM2008 as EPSG:N+3855";
        match parts.zip(geoid) {
            Some(((horizontal, _), geoid)) => Ok((Crs::from_definition(horizontal)?, Some(geoid))),
            None => Err(RasterError::UnknownCrs(whole.name().to_owned(), reason.to_owned())),
        }
    }

    /// `crs` with heights above this geoid, metres.
    ///
    /// # Errors
    /// [`RasterError::UnknownCrs`] when `crs` has heights of its own or no EPSG code.
    pub fn compound(self, crs: &Crs) -> Result<Crs> {
        let refused = |reason: &str| RasterError::UnknownCrs(crs.name().to_owned(), reason.to_owned());
        if crs.has_vertical_datum() {
            return Err(refused("it has a vertical datum of its own beside --geoid"));
        }
        if !crs.definition().starts_with("EPSG:") {
            return Err(refused("--geoid needs a coordinate system with an EPSG code"));
        }
        Crs::from_definition(&format!("{}+{}", crs.definition(), self.epsg()))
    }
}

/// The heights of a geoid above the WGS 84 ellipsoid.
pub struct Undulation {
    transform: CoordTransform,
    geoid: Geoid,
}

impl Undulation {
    /// Finds the grid of `geoid`.
    ///
    /// # Errors
    /// [`RasterError::MissingGrid`] when PROJ has none.
    pub fn new(geoid: Geoid) -> Result<Self> {
        for grid in geoid.grids() {
            // PROJ makes a pipeline without its grid: only a transformed height proves that the grid is installed.
            if let Ok(transform) = messages::collect_strictly(|| transform(grid)) {
                let found = Self { transform, geoid };
                if found.at(0.0, 0.0).is_ok() {
                    return Ok(found);
                }
            }
        }
        let (name, grids, first) = (geoid.name(), geoid.grids().join(", "), geoid.grids()[0]);
        Err(RasterError::MissingGrid { name, grids, first })
    }

    /// Height of the geoid above the ellipsoid, metres, at a longitude and latitude in degrees.
    ///
    /// # Errors
    /// [`RasterError::Transform`] where the grid has no value.
    pub fn at(&self, lon_deg: f64, lat_deg: f64) -> Result<f64> {
        let (mut x, mut y, mut z) = ([lon_deg], [lat_deg], [0.0]);
        let done = messages::collect_strictly(|| self.transform.transform_coords(&mut x, &mut y, &mut z));
        let failed = |reason: String| RasterError::Transform(format!("heights above {}", self.geoid.name()), reason);
        done.map_err(failed)?;
        let known = Some(z[0]).filter(|z| z.is_finite());
        known.ok_or_else(|| failed("its grid has no value there".into()))
    }
}

/// From longitude, latitude (degrees) and 0 to longitude, latitude and the geoid's height, which PROJ's `vgridshift`
/// adds.
fn transform(grid: &str) -> gdal::errors::Result<CoordTransform> {
    // Not EPSG:4979, whose axes are latitude and longitude: an explicit operation gets coordinates in the order of the
    // system's axes.
    let mut wgs84 = SpatialRef::from_proj4("+proj=longlat +datum=WGS84 +no_defs")?;
    wgs84.set_axis_mapping_strategy(AxisMappingStrategy::TraditionalGisOrder);
    let mut options = CoordTransformOptions::new()?;
    options.set_coordinate_operation(
        &format!(
            "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad \
             +step +proj=vgridshift +grids={grid} +multiplier=1 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
        ),
        false,
    )?;
    CoordTransform::new_with_options(&wgs84, &wgs84, &options)
}

/// The heights of a geoid over a map grid: exact at nodes 16 pixels apart, bilinear between them, as the geoid's own
/// grid is.
pub struct GeoidGrid {
    columns: usize,
    nodes: Vec<f64>,
}

/// Pixels between two nodes.
const SPACING_PX: usize = 16;

impl GeoidGrid {
    /// Tabulates `geoid` over `grid`.
    ///
    /// # Errors
    /// [`RasterError::MissingGrid`], and [`RasterError::Transform`] where a node lies outside of the geoid's grid or of
    /// the coordinate system; `RasterError::UnknownCrs` for a system that PROJ cannot transform.
    pub fn new(geoid: Geoid, grid: &GridSpec) -> Result<Self> {
        let undulation = Undulation::new(geoid)?;
        let to_lon_lat = CrsTransform::to_lon_lat(&grid.crs)?;
        let nodes_for = |pixels: usize| pixels.div_ceil(SPACING_PX) + 1;
        let (columns, rows) = (nodes_for(grid.width), nodes_for(grid.height));
        let mut nodes = Vec::with_capacity(columns * rows);
        for node in 0..columns * rows {
            let (col, row) = (node % columns * SPACING_PX, node / columns * SPACING_PX);
            let [x, y] = grid.transform.map_from_pixel(col as f64, row as f64);
            let (lon, lat) = to_lon_lat.apply(x, y)?;
            nodes.push(undulation.at(lon, lat)?);
        }
        Ok(Self { columns, nodes })
    }

    /// Converts heights (metres) above the ellipsoid to heights above the geoid: whole rows of `width` pixels from
    /// `first_row` on.
    pub fn subtract(&self, first_row: usize, width: usize, heights_m: &mut [f32]) {
        for (i, height) in heights_m.iter_mut().enumerate() {
            *height = (f64::from(*height) - self.at(i % width, first_row + i / width)) as f32;
        }
    }

    /// Height of the geoid above the ellipsoid at a pixel, metres.
    pub fn at(&self, col: usize, row: usize) -> f64 {
        let (c, r) = (col / SPACING_PX, row / SPACING_PX);
        let part = |pixel: usize| (pixel % SPACING_PX) as f64 / SPACING_PX as f64;
        let node = |dc: usize, dr: usize| self.nodes[(r + dr) * self.columns + c + dc];
        let mix = |a: f64, b: f64, t: f64| a + t * (b - a);
        let [top, bottom] = [0, 1].map(|dr| mix(node(0, dr), node(1, dr), part(col)));
        mix(top, bottom, part(row))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GeoTransform;

    /// EGM96 where its published table has nodes: NGA's WW15MGH.GRD, and the pole.
    #[test]
    fn egm96_is_what_its_table_says() {
        let Ok(egm96) = Undulation::new(Geoid::Egm96) else {
            println!("skipped: PROJ has no grid of EGM96 here");
            return;
        };
        for (lon, lat, metres) in [(0.0, 0.0, 17.16), (0.0, 90.0, 13.61), (0.0, -90.0, -29.53)] {
            let found = egm96.at(lon, lat).expect("a value");
            assert!((found - metres).abs() < 0.02, "{lon} {lat}: {found}");
        }
    }

    #[test]
    fn a_geoid_over_a_grid_is_that_of_its_pixels() {
        let Ok(egm96) = Undulation::new(Geoid::Egm96) else {
            println!("skipped: PROJ has no grid of EGM96 here");
            return;
        };
        let grid = GridSpec {
            width: 75,
            height: 50,
            transform: GeoTransform::north_up(312_000.0, 4_160_500.0, 0.5),
            crs: Crs::from_epsg(32637).expect("UTM 37N"),
        };
        let table = GeoidGrid::new(Geoid::Egm96, &grid).expect("a table");
        let to_lon_lat = CrsTransform::to_lon_lat(&grid.crs).expect("PROJ");
        for (col, row) in [(0, 0), (74, 49), (33, 17)] {
            let [x, y] = grid.transform.map_from_pixel(col as f64, row as f64);
            let (lon, lat) = to_lon_lat.apply(x, y).expect("inside");
            let exact = egm96.at(lon, lat).expect("a value");
            assert!((table.at(col, row) - exact).abs() < 1e-5, "{col} {row}");
        }
    }

    #[test]
    fn a_missing_grid_is_named_with_its_remedy() {
        let Err(error) = Undulation::new(Geoid::Egm2008) else {
            println!("skipped: PROJ has the grid of EGM2008 here");
            return;
        };
        let text = error.to_string();
        assert!(
            text.contains("EGM2008") && text.contains("us_nga_egm08_25.tif") && text.contains("projsync"),
            "{text}"
        );
        assert!(error.is_input_fault());
    }

    #[test]
    fn a_vertical_part_is_a_geoid_or_refused() {
        for (definition, horizontal, geoid) in [
            ("EPSG:32756", "EPSG:32756", None),
            ("EPSG:32756+5773", "EPSG:32756", Some(Geoid::Egm96)),
            ("epsg:4326+3855", "EPSG:4326", Some(Geoid::Egm2008)),
        ] {
            let (crs, found) = Geoid::of_definition(definition).expect("known");
            assert_eq!((crs.definition(), found), (horizontal, geoid), "{definition}");
        }
        // Feet above NAVD 88, the same in WKT, and a system without a horizontal part.
        let compound = Crs::from_definition("EPSG:32756+6360").expect("known");
        for definition in ["EPSG:32756+6360", compound.wkt(), "EPSG:5773"] {
            let error = Geoid::of_definition(definition).expect_err("refused").to_string();
            assert!(error.contains("+5773"), "{error}");
        }
    }

    #[test]
    fn a_compound_system_has_heights_of_its_own() {
        let utm = Crs::from_epsg(32637).expect("UTM 37N");
        let compound = Geoid::Egm96.compound(&utm).expect("known");
        assert!(compound.has_vertical_datum() && compound.name().contains("EGM96"));
        assert!(Geoid::Egm96.compound(&compound).is_err());
    }
}
