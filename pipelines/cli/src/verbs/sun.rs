//! `heliosplat sun`: computes the position of the sun.

use crate::outcome::{CliError, Outcome};
use crate::parse;
use clap::Args;
use heliosplat_rpc::GeoPoint;
use heliosplat_rpc::sun::sun_position;

/// Time and place.
#[derive(Debug, Args)]
pub struct SunArgs {
    /// Moment, RFC 3339
    #[arg(long, value_parser = parse::time, value_name = "RFC3339")]
    time: jiff::Timestamp,
    /// Degrees north, degrees east, metres above the ellipsoid
    #[arg(long, alias = "at", value_parser = place, allow_hyphen_values = true, value_name = "LAT,LON[,ALT]")]
    place: GeoPoint,
}

fn place(text: &str) -> Result<GeoPoint, String> {
    let numbers = parse::numbers(text)?;
    let (lat_deg, lon_deg, height_m) = match numbers[..] {
        [lat, lon] => (lat, lon, 0.0),
        [lat, lon, height] => (lat, lon, height),
        _ => return Err("expected LAT,LON or LAT,LON,ALT".to_owned()),
    };
    if lat_deg.abs() > 90.0 || lon_deg.abs() > 360.0 {
        return Err("latitude comes first: it lies between -90 and 90".to_owned());
    }
    Ok(GeoPoint::new(lon_deg, lat_deg, height_m))
}

/// Computes azimuth and geometric elevation of the sun, degrees; never fails.
pub(crate) fn run(args: &SunArgs) -> Result<Outcome, CliError> {
    let sun = sun_position(args.time, args.place);
    let (azimuth_deg, elevation_deg) = (sun.azimuth_rad.to_degrees(), sun.elevation_rad.to_degrees());
    let text = format!("{azimuth_deg:.9} {elevation_deg:.9}");
    let json = serde_json::json!({ "azimuth_deg": azimuth_deg, "elevation_deg": elevation_deg });
    Ok(Outcome::new(text, json))
}
