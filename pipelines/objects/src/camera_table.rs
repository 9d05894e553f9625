//! Cameras in a table: `cameras.csv`, one line for each image.
//!
//! Columns, in any order: `name`, `fx`, `fy`, `cx`, `cy`, `width`, `height`, `r11` to `r33` (row by row), `t1` to `t3`.
//! `x_camera = R x_world + t` in OpenCV's axes; pixel corners at integers.

use super::colmap::pose;
use super::error::CaptureError;
use super::frame_spec::{FrameSpec, Intrinsics, Lens, find_image, plain_name, sound_size};
use glam::{DMat3, DVec3};
use heliosplat_raster::bounded;
use std::path::Path;

/// Name of the file in the folder of a capture.
pub const NAME: &str = "cameras.csv";
/// Columns of numbers.
const COLUMNS: [&str; 18] = [
    "fx", "fy", "cx", "cy", "width", "height", "r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33", "t1",
    "t2", "t3",
];

/// Reads a table of cameras; images are searched beside it and in `images/`.
///
/// # Errors
/// [`CaptureError`] with the line at fault.
pub fn read(path: &Path) -> Result<Vec<FrameSpec>, CaptureError> {
    let text = bounded::read_text(path).map_err(CaptureError::io(path))?;
    let folder = path.parent().unwrap_or(Path::new("."));
    parse(folder, &text).map_err(|what| CaptureError::file(path, what, "correct the table"))
}

/// The cameras of a table whose images are in `folder` or its `images/`.
///
/// # Errors
/// A sentence with the line at fault.
pub fn parse(folder: &Path, text: &str) -> Result<Vec<FrameSpec>, String> {
    let mut lines = (1..).zip(text.trim_start_matches('\u{feff}').lines());
    let header: Vec<String> = match lines.next() {
        Some((_, line)) => line.split(',').map(|name| name.trim().to_ascii_lowercase()).collect(),
        None => return Err("it is empty".into()),
    };
    let place = |name: &str| {
        let place = header.iter().position(|column| column == name);
        place.ok_or(format!("it has no column {name}"))
    };
    let name = place("name")?;
    let mut places = [0; COLUMNS.len()];
    for (slot, column) in places.iter_mut().zip(COLUMNS) {
        *slot = place(column)?;
    }
    let frame = |line: &str| {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        if cells.len() != header.len() {
            return Err(format!("{} columns and not {}", cells.len(), header.len()));
        }
        let mut numbers = [0.0; COLUMNS.len()];
        for (k, &place) in places.iter().enumerate() {
            let cell = cells[place];
            numbers[k] = cell.parse().map_err(|_| format!("{} is {cell:?}", COLUMNS[k]))?;
        }
        let [fx, fy, cx, cy, width, height, rest @ ..] = numbers;
        let [r11, r12, r13, r21, r22, r23, r31, r32, r33, t1, t2, t3] = rest;
        // The rows of world to camera are the columns of camera to world.
        let axes = [r11, r12, r13, r21, r22, r23, r31, r32, r33];
        let pose = pose(DMat3::from_cols_array(&axes), DVec3::new(t1, t2, t3));
        let written = cells[name];
        let images = folder.join("images");
        Ok(FrameSpec {
            name: plain_name(written),
            path: find_image(folder, written, None)
                .or_else(|fault| find_image(&images, written, None).map_err(|_| fault))?,
            light: None,
            pose: pose.ok_or("r11 to r33 and t1 to t3 are no pose")?,
            intrinsics: Intrinsics::given([fx, fy], Some([cx, cy]))?,
            declared_size: Some(sound_size([width, height])?),
            lens: Lens::default(),
        })
    };
    let rows = lines.filter(|(_, line)| !line.trim().is_empty());
    let frames: Vec<FrameSpec> = rows
        .map(|(number, line)| frame(line).map_err(|what| format!("line {number}: {what}")))
        .collect::<Result<_, String>>()?;
    match frames.is_empty() {
        true => Err("it lists no image".into()),
        false => Ok(frames),
    }
}
