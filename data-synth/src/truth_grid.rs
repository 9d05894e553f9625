//! Map grid of the truth rasters, and the vertical rays through its cells.

use crate::ray::Ray;
use crate::utm::UtmZone;
use heliosplat_rpc::{GeoPoint, LocalFrame};
use serde::{Deserialize, Serialize};

/// A north-up grid of square cells in a UTM zone.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TruthGrid {
    /// UTM zone of the coordinates.
    pub zone: UtmZone,
    /// Easting of the upper-left cell's upper-left corner, metres.
    pub west_m: f64,
    /// Northing of the upper-left cell's upper-left corner, metres.
    pub north_m: f64,
    /// Side of a cell, metres.
    pub cell_m: f64,
    /// Number of cells along each side.
    pub size: usize,
}

impl TruthGrid {
    /// A square grid around a place, with a side of about `extent_m` and cells of `cell_m`, metres. Its corners lie on
    /// multiples of the cell's side.
    pub(crate) fn around(centre: GeoPoint, extent_m: f64, cell_m: f64) -> Self {
        let zone = UtmZone::of(centre.lon_deg, centre.lat_deg);
        let [east_m, north_m] = zone.project(centre.lon_deg, centre.lat_deg);
        let size = (extent_m / cell_m).round().max(1.0) as usize;
        let half_m = 0.5 * size as f64 * cell_m;
        let snapped = |value: f64| (value / cell_m).round() * cell_m;
        Self {
            zone,
            west_m: snapped(east_m - half_m),
            north_m: snapped(north_m + half_m),
            cell_m,
            size,
        }
    }

    /// Longitude and latitude, degrees, of a place given in columns and rows of cells: (0.5, 0.5) is the centre of the
    /// upper-left cell.
    pub(crate) fn lon_lat(&self, col: f64, row: f64) -> [f64; 2] {
        self.zone
            .unproject(self.west_m + col * self.cell_m, self.north_m - row * self.cell_m)
    }
}

/// The ray down the ellipsoid's normal through a place of the grid (columns and rows of cells), from the higher of two
/// altitudes (metres above the frame's origin) toward the lower.
pub(crate) fn plumb_line(frame: &LocalFrame, grid: &TruthGrid, [col, row]: [f64; 2], [low_m, high_m]: [f64; 2]) -> Ray {
    let [lon_deg, lat_deg] = grid.lon_lat(col, row);
    let at = |height_m: f64| frame.enu_from_geo(GeoPoint::new(lon_deg, lat_deg, frame.origin.height_m + height_m));
    let (top, bottom) = (at(high_m), at(low_m));
    Ray::new(top, (bottom - top).normalize())
}
