//! Table of consistency checks on a delivery. Each row compares two statements of an image, its sidecars or the other
//! images, and has a bound for their difference and a remedy.

use super::camera::{self, Cameras, FoundCamera};
use super::draft::Draft;
use super::{RpcPreference, acquisition};
use heliosplat_raster::CrsTransform;
use heliosplat_rpc::{GeoPoint, ImagePoint};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Consequence of a finding for the result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// The result may be worse.
    Warning,
    /// The result would be wrong.
    Error,
}

/// A check that failed, with the images that it failed for.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Code of the check, such as `map-projected`.
    pub code: &'static str,
    /// Severity: warning or error.
    pub severity: Severity,
    /// Names of the images concerned.
    pub images: Vec<String>,
    /// Files of these images.
    pub files: Vec<PathBuf>,
    /// Largest value found, in the unit of the message; `None` for a check without a number, or where the value is
    /// infinite.
    pub value: Option<f64>,
    /// Bound above which the check fails, in the unit of the message; `None` for a check without a number.
    pub bound: Option<f64>,
    /// One line: file, difference, remedy.
    pub message: String,
}

/// Failure of a check for one image.
pub(super) struct Found {
    value: Option<f64>,
    bound: Option<f64>,
    /// Predicate of the message; its subject is the path of the image.
    what: String,
}

impl Found {
    fn plain(what: String) -> Self {
        let (value, bound) = (None, None);
        Self { value, bound, what }
    }

    fn above(value: f64, bound: f64, what: String) -> Option<Self> {
        // NaN fails the check.
        let holds = value > bound || value.is_nan();
        let (value, bound) = (value.is_finite().then_some(value), Some(bound));
        holds.then_some(Self { value, bound, what })
    }
}

/// A check: code, severity, function, and remedy.
struct Check {
    code: &'static str,
    severity: Severity,
    find: fn(&Draft, RpcPreference) -> Option<Found>,
    remedy: &'static str,
}

const CHECKS: [Check; 6] = [
    Check {
        code: "map-projected",
        severity: Severity::Error,
        find: map_projected,
        remedy: "give the original image with its RPC; remove the geotransform where the RPC is the right one",
    },
    Check {
        code: "cameras-of-other-ground",
        severity: Severity::Error,
        find: other_ground,
        remedy: "remove the wrong one, or choose with --rpc json|sidecar|tag",
    },
    Check {
        code: "two-cameras",
        severity: Severity::Warning,
        find: two_cameras,
        remedy: "--rpc json|sidecar|tag chooses",
    },
    Check {
        code: "camera-file-unread",
        severity: Severity::Warning,
        find: unread,
        remedy: "replace that file or delete it",
    },
    Check {
        code: "rpc-of-another-size",
        severity: Severity::Warning,
        find: another_size,
        remedy: "where the image was reduced or turned, give the original, or an RPC that was changed alike",
    },
    Check {
        code: "sun-below-horizon",
        severity: Severity::Warning,
        find: sun_below_horizon,
        remedy: "correct the time (UTC) or remove it",
    },
];

/// All failed checks, in the order of the table; equal findings of several images are merged into one.
pub(super) fn all(drafts: &[Draft], preference: RpcPreference) -> Vec<Finding> {
    let of_row = |check: &Check| {
        let find = |draft| Some((draft, (check.find)(draft, preference)?));
        let mut found: Vec<(&Draft, Found)> = drafts.iter().filter_map(find).collect();
        // The image with the largest value comes first; the sort is stable and keeps the order of the images.
        found.sort_by(|(_, a), (_, b)| b.value.unwrap_or(0.0).total_cmp(&a.value.unwrap_or(0.0)));
        let (first, worst) = found.first()?;
        let path = first.entry.path.display();
        let more = match found.len() {
            1 => String::new(),
            count => format!(" (and {} more images alike)", count - 1),
        };
        Some(Finding {
            code: check.code,
            severity: check.severity,
            images: found.iter().map(|(draft, _)| draft.entry.name.clone()).collect(),
            files: found.iter().map(|(draft, _)| draft.entry.path.clone()).collect(),
            value: worst.value,
            bound: worst.bound,
            message: format!("{path}: {}{more}; {}", worst.what, check.remedy),
        })
    };
    CHECKS.iter().filter_map(of_row).collect()
}

/// Largest distance between geotransform and RPC of a projected image, as a share of the image's diagonal. An RPC
/// fitted to a projected image describes its pixels within this distance at the height of the projection; a raw image
/// is rotated and stretched against the map by more.
const ROUGH_FRAME: f64 = 0.01;
/// Least bound of that distance, pixels: a frame whose corner was rounded to whole pixels is off by this much.
const ROUGH_FRAME_PX: f64 = 2.0;
/// Number of sample places along each side of an image.
const PLACES: usize = 5;

/// Compares the geotransform with the RPC at the altitude of their best agreement: the RPC of an image that was
/// projected to one height describes its pixels at that height.
fn map_projected(draft: &Draft, _: RpcPreference) -> Option<Found> {
    let (transform, crs) = camera::map_frame(&draft.file)?;
    let to_lon_lat = CrsTransform::to_lon_lat(&crs).ok()?;
    let (width, height) = draft.file.size();
    let along = |index: usize, size: usize| index as f64 / (PLACES - 1) as f64 * (size as f64 - 1.0);
    let place = |index: usize| {
        let [col, row] = [along(index % PLACES, width), along(index / PLACES, height)];
        let [x, y] = transform.map_from_pixel(col, row);
        Some(([col, row], to_lon_lat.apply(x, y).ok()?))
    };
    let places: Vec<_> = (0..PLACES * PLACES).map(place).collect::<Option<_>>()?;
    let apart_px = |height_m: f64| {
        let off = places.iter().map(|&([col, row], (lon_deg, lat_deg))| {
            let seen = draft.rpc.project(GeoPoint::new(lon_deg, lat_deg, height_m));
            (seen.col - col).hypot(seen.row - row)
        });
        let larger = |most: f64, off: f64| if off.is_nan() { f64::INFINITY } else { most.max(off) };
        off.fold(0.0, larger)
    };
    let (middle_m, half_m) = (draft.rpc.height_offset_m, draft.rpc.height_scale_m.abs());
    let least = least_of(&apart_px, middle_m - half_m, middle_m + half_m);
    let bound = (ROUGH_FRAME * (width as f64).hypot(height as f64)).max(ROUGH_FRAME_PX);
    let what = format!(
        "is map-projected ({}), and its RPC does not describe its pixels: at every altitude the two place some of them {least:.0} px \
         apart or more",
        crs.name()
    );
    Found::above(least, bound, what)
}

/// Minimum of a function that has one minimum between `low` and `high`, by ternary search.
fn least_of(of: &dyn Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    for _ in 0..60 {
        let third = (high - low) / 3.0;
        if of(low + third) < of(high - third) {
            high -= third;
        } else {
            low += third;
        }
    }
    of((low + high) / 2.0)
}

/// Largest distance between two cameras of one image without a warning, pixels: matching does not resolve less.
const WORTH_A_WARNING_PX: f64 = 0.5;

/// The unused camera farthest from the one in use, with the largest distance between them over the image, pixels;
/// infinite where it cannot be measured.
fn farthest(cameras: &Cameras, size: (usize, usize)) -> Option<(f64, &FoundCamera)> {
    let apart = |other: &FoundCamera| camera::apart_px(&cameras.used.rpc, &other.rpc, size).unwrap_or(f64::INFINITY);
    let all = cameras.others.iter().map(|other| (apart(other), other));
    all.max_by(|(a, _), (b, _)| a.total_cmp(b))
}

/// Warning about differing cameras of a single file; `None` where they agree. `size` is columns and rows.
pub(super) fn of_cameras(cameras: &Cameras, path: &Path, size: (usize, usize)) -> Option<String> {
    let what = differing(cameras, size)?.what;
    Some(format!("{}: {what}; --rpc json|sidecar|tag chooses", path.display()))
}

/// Fails for two cameras of disjoint ground: without a choice by the user, neither is known to be right.
fn other_ground(draft: &Draft, preference: RpcPreference) -> Option<Found> {
    let (apart_px, other) = farthest(&draft.cameras, draft.camera_size)?;
    let (width, height) = draft.camera_size;
    let bound = (width as f64).hypot(height as f64);
    if preference != RpcPreference::Json || other.sees_ground_of(&draft.cameras.used, draft.camera_size) {
        return None;
    }
    let (used, other) = (&draft.cameras.used.source, &other.source);
    let what = format!("its RPC cameras see other ground, {apart_px:.0} px apart: {used} and {other}");
    Found::above(apart_px, bound, what)
}

fn two_cameras(draft: &Draft, _: RpcPreference) -> Option<Found> {
    differing(&draft.cameras, draft.camera_size)
}

fn differing(cameras: &Cameras, size: (usize, usize)) -> Option<Found> {
    let (apart_px, other) = farthest(cameras, size)?;
    let (used, other) = (&cameras.used.source, &other.source);
    let by = match apart_px.is_finite() {
        true => format!("by {apart_px:.1} px"),
        false => "by more than can be measured".to_owned(),
    };
    let what = format!("two RPC cameras differ {by}; used: {used}, ignored: {other}");
    Found::above(apart_px, WORTH_A_WARNING_PX, what)
}

fn unread(draft: &Draft, _: RpcPreference) -> Option<Found> {
    let (path, reason) = draft.cameras.unread.first()?;
    let used = &draft.cameras.used.source;
    let path = path.display();
    let text = format!("the RPC in {path} cannot be read ({reason}); used: {used}");
    Some(Found::plain(text))
}

/// Largest relative difference between an RPC's scale and half the size of its image, for the two to count as equal.
const LIKE: f64 = 0.02;

/// Compares the size of the image with the range of rows and columns of its RPC. A crop may lie anywhere in that range;
/// a reduced image starts at its beginning and covers the same fraction of rows and columns.
fn another_size(draft: &Draft, _: RpcPreference) -> Option<Found> {
    let rpc = &draft.rpc;
    let (width, height) = draft.camera_size;
    let made_for = [2.0 * rpc.sample_scale.abs(), 2.0 * rpc.line_scale.abs()];
    let first = [rpc.sample_offset, rpc.line_offset];
    let begins = (0..2).all(|axis| (first[axis] + 0.5 - made_for[axis] / 2.0).abs() < LIKE * made_for[axis]);
    let [wide, high] = [made_for[0] / width as f64, made_for[1] / height as f64];
    let is_like = |a: f64, b: f64| (a / b - 1.0).abs() < LIKE;
    let factor = wide.round();
    let reduced = factor >= 2.0 && is_like(wide, factor) && is_like(high, factor);
    let turned = is_like(made_for[0], height as f64) && is_like(made_for[1], width as f64) && !is_like(wide, 1.0);
    (begins && (reduced || turned)).then(|| Found {
        value: Some(wide),
        bound: Some(1.0),
        what: format!(
            "has {width} x {height} pixels, and its RPC is made for {:.0} x {:.0}",
            made_for[0], made_for[1]
        ),
    })
}

/// Compares the acquisition time, and the sun angles in the metadata, with day and night.
fn sun_below_horizon(draft: &Draft, _: RpcPreference) -> Option<Found> {
    let (origin, elevation_deg) = acquisition::night(&draft.acquisition, draft.middle()?)?;
    Some(Found {
        value: Some(elevation_deg),
        bound: Some(0.0),
        what: format!(
            "the sun is below the horizon or beyond the zenith (elevation {elevation_deg:.1} degrees, {origin}) and is taken as unknown"
        ),
    })
}

impl FoundCamera {
    /// True if the ground point at the image centre of `other` projects near the domain of this camera: within twice
    /// its half width, or twice the image size, of its centre.
    fn sees_ground_of(&self, other: &Self, (width, height): (usize, usize)) -> bool {
        let (col, row) = (width as f64 / 2.0, height as f64 / 2.0);
        let Ok(ground) = other.rpc.localise(ImagePoint { col, row }, other.rpc.height_offset_m) else {
            return false;
        };
        let seen = self.rpc.project(ground);
        let within =
            |at: f64, offset: f64, scale: f64, size: usize| (at - offset).abs() < 2.0 * scale.abs().max(size as f64);
        within(seen.col, self.rpc.sample_offset, self.rpc.sample_scale, width)
            && within(seen.row, self.rpc.line_offset, self.rpc.line_scale, height)
    }
}
