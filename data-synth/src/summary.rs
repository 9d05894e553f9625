//! Summary of a scene: the request, and the numbers of each image. It is written as the scene's manifest.

use crate::faults::{Haze, Stretch};
use crate::request::{SatelliteRequest, is_default};
use crate::truth_grid::TruthGrid;
use heliosplat_rpc::GeoPoint;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Summary of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Request of the scene.
    pub request: SatelliteRequest,
    /// Centre of the site.
    pub origin: GeoPoint,
    /// Grid of the truth rasters.
    pub grid: TruthGrid,
    /// Lowest and highest altitude of the truth DSM, metres above the ellipsoid.
    pub altitude_range_m: [f64; 2],
    /// Share of the truth's cells in each class, by name.
    pub class_share: BTreeMap<String, f64>,
    /// Share of the truth's cells under sea or snow; absent from the manifest if none.
    #[serde(default, skip_serializing_if = "is_default")]
    pub cover_share: f64,
    /// Share of the truth's cells that are glossy; absent from the manifest without glossy surfaces.
    #[serde(default, skip_serializing_if = "is_default")]
    pub glossy_share: f64,
    /// The images in order of time.
    pub images: Vec<ImageSummary>,
}

/// Summary of one image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ImageSummary {
    /// File name without extension.
    pub name: String,
    /// Acquisition time, UTC.
    pub time: jiff::Timestamp,
    /// Index of the acquisition date, in order of time from 0.
    pub date: usize,
    /// True if the image is listed in `test.txt`.
    pub held_out: bool,
    /// Columns and rows, without the canvas.
    pub size_px: [usize; 2],
    /// Column and row of the canvas at which the image begins; absent from the manifest without a canvas.
    #[serde(default, skip_serializing_if = "is_default")]
    pub canvas_offset_px: Option<[usize; 2]>,
    /// Ground sampling distance, metres.
    pub gsd_m: f64,
    /// Angle of the sun clockwise from north, degrees.
    pub sun_azimuth_deg: f64,
    /// Angle of the sun above the horizon, degrees.
    pub sun_elevation_deg: f64,
    /// Direction in which the satellite stands, clockwise from north, degrees.
    pub satellite_azimuth_deg: f64,
    /// Angle at the satellite between nadir and line of sight, degrees.
    pub off_nadir_deg: f64,
    /// Root mean square residual of the fitted RPC over the vendor's full scene, pixels; 0 for the camera of a real
    /// image.
    pub rpc_rms_px: f64,
    /// Largest residual of the fitted RPC over the vendor's full scene, pixels; 0 for the camera of a real image.
    pub rpc_max_px: f64,
    /// RPC bias: constant (column, row) error put into the RPC, pixels.
    pub pointing_bias_px: [f64; 2],
    /// Share of the image in shadow, 0 to 1.
    pub shadow_share: f64,
    /// Share of the image behind clouds, 0 to 1; absent from the manifest if none.
    #[serde(default, skip_serializing_if = "is_default")]
    pub cloud_share: f64,
    /// Gain of each band of the file relative to the collection's mean; absent from the manifest if bands have no gains
    /// of their own.
    #[serde(default, skip_serializing_if = "is_default")]
    pub band_gains: Vec<f64>,
    /// Haze of the acquisition date; absent from the manifest if there is none.
    #[serde(default, skip_serializing_if = "is_default")]
    pub haze: Option<Haze>,
    /// Stretch of linear counts to display values; absent from the manifest without one.
    #[serde(default, skip_serializing_if = "is_default")]
    pub stretch: Option<Stretch>,
}
