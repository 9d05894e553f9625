//! Arguments that several verbs share.

use crate::names::RpcName;
use crate::parse;
use clap::Args;
use heliosplat_scene::{AreaRequest, IngestOptions};

/// What a user may say about a scene that its files do not.
#[derive(Debug, Clone, Args)]
pub struct IngestArgs {
    /// Lowest and highest altitude of the surface, metres above the ellipsoid
    #[arg(long, value_name = "MIN,MAX", value_parser = parse::pair, allow_hyphen_values = true)]
    pub altitude: Option<[f64; 2]>,
    /// Only this piece of ground: longitudes and latitudes, or with EPSG:N at the end coordinates of that system
    #[arg(long, value_name = "WEST,SOUTH,EAST,NORTH[,EPSG:N]", value_parser = parse::area, allow_hyphen_values = true)]
    pub area: Option<AreaRequest>,
    /// Which camera of an image comes first
    #[arg(long, value_name = "SOURCE", default_value = "json")]
    pub rpc: RpcName,
}

impl IngestArgs {
    /// As the scene reader takes it.
    pub fn options(&self) -> IngestOptions {
        IngestOptions {
            altitude_range_m: self.altitude.map(|[low, high]| (low, high)),
            altitude_from_ties_m: None,
            rpc: self.rpc.into(),
            area: self.area.clone(),
        }
    }
}

/// Latitude and longitude with their letters, as in `22.890968 S 47.027328 W`.
pub fn place_in_words(place: heliosplat_rpc::GeoPoint) -> String {
    let (north, east) = (place.lat_deg >= 0.0, place.lon_deg >= 0.0);
    format!(
        "{:.6} {} {:.6} {}",
        place.lat_deg.abs(),
        if north { 'N' } else { 'S' },
        place.lon_deg.abs(),
        if east { 'E' } else { 'W' }
    )
}
