//! Map grid of the truth rasters.

use crate::utm::UtmZone;
use heliosplat_rpc::GeoPoint;
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
