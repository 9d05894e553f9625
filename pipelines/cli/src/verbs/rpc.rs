//! `heliosplat rpc project` and `heliosplat rpc localise`: lines of numbers in, lines of numbers out.

use crate::outcome::{CliError, Outcome};
use clap::{Args, Subcommand};
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc};
use heliosplat_scene::{RpcPreference, camera_of};
use std::io::{BufRead, Read};
use std::path::PathBuf;

/// Direction of the projection.
#[derive(Debug, Args)]
pub struct RpcArgs {
    #[command(subcommand)]
    direction: Direction,
}

/// From the ground to the image, or back.
#[derive(Debug, Subcommand)]
enum Direction {
    /// Lines "lon lat alt" on stdin become lines "col row" on stdout; 0 0 is the centre of the first pixel
    #[command(after_help = "Example: echo '36.91 37.58 700' | heliosplat rpc project image.tif")]
    Project(CameraArgs),
    /// Lines "col row alt" on stdin become lines "lon lat" on stdout; 0 0 is the centre of the first pixel
    #[command(after_help = "Example: echo '500 500 700' | heliosplat rpc localise image.RPB")]
    Localise(CameraArgs),
}

/// Camera to use.
#[derive(Debug, Args)]
struct CameraArgs {
    /// An image with an RPC, or an RPC file (.RPB, _RPC.TXT, RPC_*.XML, Maxar .XML, Sat-NeRF .json)
    #[arg(value_name = "IMAGE|RPCFILE")]
    camera: PathBuf,
    /// Preferred source of the camera if an image's own RPC and a Sat-NeRF JSON differ
    #[arg(long, value_name = "SOURCE", default_value = "json")]
    rpc: RpcPreference,
}

/// Size from which a line is refused, bytes.
const LINE_MAX: u64 = 4096;

/// Transforms the points on stdin, one per line.
///
/// # Errors
/// When the camera cannot be read, or a line is no point or cannot be transformed.
pub(crate) fn run(args: &RpcArgs) -> Result<Outcome, CliError> {
    let (Direction::Project(camera) | Direction::Localise(camera)) = &args.direction;
    let rpc = camera_of(&camera.camera, camera.rpc)?;
    let transform = match args.direction {
        Direction::Project(_) => project,
        Direction::Localise(_) => localise,
    };
    let (mut points, mut lines, mut strange) = (Vec::new(), Vec::new(), Vec::new());
    let mut stdin = std::io::stdin().lock();
    for number in 1.. {
        let mut line = String::new();
        let read = stdin.by_ref().take(LINE_MAX).read_line(&mut line);
        let length = read.map_err(|error| CliError::Input(format!("stdin line {number} cannot be read: {error}")))?;
        let fault = |reason: String| CliError::Input(format!("stdin line {number}: {reason}"));
        if length == 0 {
            break;
        }
        if length as u64 == LINE_MAX {
            let reason = format!("it has {LINE_MAX} bytes or more; give three numbers a line");
            return Err(fault(reason));
        }
        if line.trim().is_empty() {
            continue;
        }
        let given = three_numbers(&line).map_err(fault)?;
        if matches!(args.direction, Direction::Project(_)) && is_far(&rpc, given) {
            strange.push(number);
        }
        let point = transform(&rpc, given).map_err(fault)?;
        lines.push(format!("{} {}", digits17(point[0]), digits17(point[1])));
        points.push(point);
    }
    if let Some(first) = strange.first() {
        let others = match strange.len() {
            1 => String::new(),
            count => format!(" and {} more", count - 1),
        };
        tracing::warn!(
            "stdin line {first}{others}: far from the ground that the camera describes; lines are lon lat alt"
        );
    }
    Ok(Outcome::new(lines.join("\n"), serde_json::json!({ "points": points })))
}

/// Half widths of a camera's validity range beyond which its polynomials mean nothing.
const FAR: f64 = 2.0;

/// True for a point far outside of the ground that a camera describes, such as one with exchanged coordinates.
fn is_far(rpc: &Rpc, [lon_deg, lat_deg, _]: [f64; 3]) -> bool {
    let east_deg = (lon_deg - rpc.longitude_offset_deg + 180.0).rem_euclid(360.0) - 180.0;
    let north_deg = lat_deg - rpc.latitude_offset_deg;
    (east_deg / rpc.longitude_scale_deg).abs() > FAR || (north_deg / rpc.latitude_scale_deg).abs() > FAR
}

fn project(rpc: &Rpc, [lon_deg, lat_deg, height_m]: [f64; 3]) -> Result<[f64; 2], String> {
    let point = rpc.project(GeoPoint::new(lon_deg, lat_deg, height_m));
    match point.col.is_finite() && point.row.is_finite() {
        true => Ok([point.col, point.row]),
        false => Err("this point has no place in the image; give lon lat alt near the image".to_owned()),
    }
}

fn localise(rpc: &Rpc, [col, row, height_m]: [f64; 3]) -> Result<[f64; 2], String> {
    let ground = rpc.localise(ImagePoint { col, row }, height_m);
    let ground = ground.map_err(|error| error.to_string())?;
    Ok([ground.lon_deg, ground.lat_deg])
}

fn three_numbers(line: &str) -> Result<[f64; 3], String> {
    let words = line.split(|character: char| character.is_whitespace() || character == ',');
    let numbers: Result<Vec<f64>, _> = words.filter(|word| !word.is_empty()).map(str::parse::<f64>).collect();
    match numbers.as_deref() {
        Ok(&[a, b, c]) if a.is_finite() && b.is_finite() && c.is_finite() => Ok([a, b, c]),
        _ => Err(format!("expected three numbers, found '{}'", line.trim())),
    }
}

/// Decimal notation with 17 significant digits, which identify a double exactly; at most 30 digits after the point.
fn digits17(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let magnitude = value.abs().log10().floor() as i32;
    let decimals = (16 - magnitude).clamp(0, 30) as usize;
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seventeen_digits_read_back_as_the_same_number() {
        for value in [
            36.909_441_225_382_15,
            -0.000_123_456_789_012_345_67,
            12_345_678.901_234_567,
            1.0,
            -5e-17,
        ] {
            let text = digits17(value);
            assert_eq!(text.parse::<f64>(), Ok(value), "{text}");
        }
    }

    #[test]
    fn lines_take_spaces_tabs_and_commas_and_nothing_else() {
        assert_eq!(three_numbers("1, 2\t3 "), Ok([1.0, 2.0, 3.0]));
        for bad in ["1 2", "1 2 3 4", "a b c", "1 2 nan"] {
            assert!(three_numbers(bad).is_err(), "{bad}");
        }
    }
}
