//! Truth on the ground: altitude, class and albedo, straight down the ellipsoid's normal through each cell's centre.

use crate::encoding::bands_of;
use crate::materials::Season;
use crate::nadir::NadirSensor;
use crate::radiometry::LitScene;
use crate::raytrace::Hit;
use crate::request::BandSet;

/// Cells nearer to sea or snow than this are not counted as bare, metres: windows of a matcher reach over the edge.
const BESIDE_COVER_M: f64 = 4.0;
/// Albedo samples along each side of a cell.
const FINE: usize = 3;

/// The truth rasters, row by row from the north-west.
pub(crate) struct Truth {
    /// Ellipsoidal altitude of the highest surface at each cell's centre, metres; NaN where there is none.
    pub(crate) altitude_m: Vec<f32>,
    /// Ellipsoidal altitude of the bare ground at each cell's centre, metres; [`survey`] leaves it empty.
    pub(crate) ground_m: Vec<f32>,
    /// LAS code of the highest surface at each cell's centre; 0 where there is none.
    pub(crate) class: Vec<u8>,
    /// Mean albedo of each cell, 0 to 1, bands interleaved.
    pub(crate) albedo: Vec<f32>,
    /// 1 where sea or snow covers the cell's centre.
    pub(crate) cover: Vec<u8>,
    /// One flag for each cell, true if its centre lies more than 4 m outside of sea and snow.
    pub(crate) bare: Vec<bool>,
    /// 1 where the highest surface at the cell's centre has a glossy lobe.
    pub(crate) glossy: Vec<u8>,
}

impl Truth {
    /// Lowest and highest altitude, metres.
    pub(crate) fn altitude_range_m(&self) -> [f64; 2] {
        let fold = |start: f32, pick: fn(f32, f32) -> f32| f64::from(self.altitude_m.iter().copied().fold(start, pick));
        [fold(f32::INFINITY, f32::min), fold(f32::NEG_INFINITY, f32::max)]
    }
}

/// Ellipsoidal altitudes of the highest surface at the centre of each cell of the grid, metres, row by row; NaN where
/// there is none.
pub(crate) fn altitudes(scene: &LitScene, nadir: &NadirSensor) -> Vec<f32> {
    nadir.of_cells(|centre| altitude_m(nadir, look_down(scene, nadir, centre)))
}

fn altitude_m(nadir: &NadirSensor, hit: Option<Hit>) -> f32 {
    hit.map_or(f32::NAN, |hit| nadir.frame.geo_from_enu(hit.point).height_m as f32)
}

/// Surveys the scene from straight above: the rasters of the grid, except for [`Truth::ground_m`].
pub(crate) fn survey(scene: &LitScene, nadir: &NadirSensor, bands: BandSet) -> Truth {
    let cells = nadir.of_cells(|centre| Cell::new(scene, nadir, bands, centre));
    Truth {
        altitude_m: cells.iter().map(|cell| cell.altitude_m).collect(),
        ground_m: Vec::new(),
        class: cells.iter().map(|cell| cell.class).collect(),
        albedo: (cells
            .iter()
            .flat_map(|cell| &cell.albedo[..bands.names().len()])
            .copied())
        .collect(),
        cover: cells.iter().map(|cell| u8::from(cell.inside_cover_m > 0.0)).collect(),
        bare: cells.iter().map(|cell| cell.inside_cover_m < -BESIDE_COVER_M).collect(),
        glossy: cells.iter().map(|cell| u8::from(cell.glossy)).collect(),
    }
}

/// The truth of one cell, as in [`Truth`].
struct Cell {
    altitude_m: f32,
    class: u8,
    /// Distance of the centre from the edge of sea or snow, positive where it is covered, metres.
    inside_cover_m: f64,
    glossy: bool,
    albedo: [f32; 4],
}

impl Cell {
    fn new(scene: &LitScene, nadir: &NadirSensor, bands: BandSet, centre: [f64; 2]) -> Self {
        let hit = look_down(scene, nadir, centre);
        let mut albedo = [0f32; 4];
        for k in 0..FINE * FINE {
            let fine = [k % FINE, k / FINE].map(|fine| (fine as f64 + 0.5) / FINE as f64);
            let at = [0, 1].map(|axis| centre[axis] - 0.5 + fine[axis]);
            if let Some(hit) = look_down(scene, nadir, at) {
                let (values, _) = bands_of(&scene.albedo(&hit, &Season::REFERENCE).1, bands);
                for (total, value) in albedo.iter_mut().zip(values) {
                    *total += value / (FINE * FINE) as f32;
                }
            }
        }
        Self {
            altitude_m: altitude_m(nadir, hit),
            class: hit.map_or(0, |hit| scene.class(&hit) as u8),
            inside_cover_m: hit.map_or(0.0, |hit| scene.ground.inside_cover_m(hit.point.x, hit.point.y)),
            glossy: hit.is_some_and(|hit| scene.lobe(&hit).is_some()),
            albedo,
        }
    }
}

/// Highest surface at a place of the grid (columns and rows of cells), along the ellipsoid's normal; `None` outside of
/// the terrain.
pub(crate) fn look_down(scene: &LitScene, nadir: &NadirSensor, at: [f64; 2]) -> Option<Hit> {
    let limits_m = [scene.tracer.bottom_m - 1.0, scene.tracer.top_m + 1.0];
    scene.tracer.trace(&nadir.plumb_line(at, limits_m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth_grid::TruthGrid;
    use heliosplat_rpc::{GeoPoint, LocalFrame};

    #[test]
    fn grid_is_snapped_and_centred_and_its_cells_are_areas() {
        let centre = GeoPoint::new(-3.70, 40.42, 700.0);
        let grid = TruthGrid::around(centre, 48.0, 0.5);
        assert_eq!(grid.size, 96);
        assert_eq!((grid.west_m / 0.5).fract(), 0.0);
        let [lon_deg, lat_deg] = grid.lon_lat(48.0, 48.0);
        let [east, north] = grid.zone.project(lon_deg, lat_deg);
        let [east_0, north_0] = grid.zone.project(centre.lon_deg, centre.lat_deg);
        assert!((east - east_0).abs() <= 0.26 && (north - north_0).abs() <= 0.26);
        // The first cell's centre lies half a cell inside its corner.
        let [lon_deg, lat_deg] = grid.lon_lat(0.5, 0.5);
        let [east, north] = grid.zone.project(lon_deg, lat_deg);
        assert!((east - grid.west_m - 0.25).abs() < 1e-6 && (grid.north_m - north - 0.25).abs() < 1e-6);
    }

    #[test]
    fn a_roof_raises_exactly_the_cells_whose_centres_it_covers_to_exactly_its_altitude() {
        use crate::city::GroundCover;
        use crate::materials::{Class, Material, grey};
        use crate::solid::{Finish, Solids};
        use crate::terrain::HeightField;
        let origin = GeoPoint::new(150.93, -33.82, 61.5);
        let frame = LocalFrame::new(origin);
        let grid = TruthGrid::around(origin, 24.0, 0.5);
        // A flat roof whose corners are given in the grid: columns 10.25 to 20.75, rows 5.25 to 14.75.
        let corner = |col: f64, row: f64| {
            let [lon_deg, lat_deg] = grid.lon_lat(col, row);
            frame.enu_from_geo(GeoPoint::new(lon_deg, lat_deg, 73.25))
        };
        let corners = [
            corner(10.25, 5.25),
            corner(10.25, 14.75),
            corner(20.75, 14.75),
            corner(20.75, 5.25),
        ];
        let mut solids = Solids::default();
        let finish = Finish::new(Class::Building, Material::Plain(grey(0.4)), 0);
        solids.polygon(&corners, finish);
        let terrain = HeightField::sample(30.0, 1.0, |_, _| 0.0);
        let ground = GroundCover::plain(Material::Plain(grey(0.1)));
        let scene = LitScene::new(&terrain, solids, &ground);
        let truth = survey(&scene, &NadirSensor { frame, grid }, BandSet::Rgb);
        for (index, (&altitude_m, &class)) in truth.altitude_m.iter().zip(&truth.class).enumerate() {
            let (col, row) = (index % grid.size, index / grid.size);
            let covered = (10..=20).contains(&col) && (5..=14).contains(&row);
            let expected_m = if covered { 73.25 } else { 61.5 };
            assert!((altitude_m - expected_m).abs() < 1e-4, "({col}, {row}): {altitude_m}");
            assert_eq!(class, if covered { 6 } else { 2 });
        }
        // The roof covers two thirds of cell 10 and all of cell 12, in steps of a third.
        let albedo = |col: usize| truth.albedo[(8 * grid.size + col) * 3];
        assert!((albedo(12) - 0.4).abs() < 1e-6 && (albedo(10) - 0.3).abs() < 1e-6 && (albedo(9) - 0.1).abs() < 1e-6);
    }
}
