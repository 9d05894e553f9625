//! Models of COLMAP: `cameras`, `images` and `points3D`, as text or binary (colmap.github.io/format.html).
//!
//! Poses are world to camera in OpenCV's axes, pixel corners at integers. Cameras without distortion are read; others
//! are refused, because COLMAP undistorts images itself.

use super::error::CaptureError;
use super::frame_spec::{FrameSpec, Intrinsics, Lens, UNDISTORT, find_image, plain_name, sound_size};
use super::pinhole::Pinhole;
use super::points::Point;
use glam::{DMat3, DQuat, DVec3};
use heliosplat_raster::bounded;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Largest file of a model that is read, bytes.
const FILE_MAX: u64 = 2 << 30;
/// Folders of a model in a capture, in the order in which they are tried.
const FOLDERS: [&str; 4] = ["sparse/0", "sparse", "colmap/sparse/0", ""];
/// Camera models by their number in binary files, with their number of parameters.
const MODELS: [(&str, usize); 12] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
];

/// Intrinsics and size of a camera.
pub type Camera = (Intrinsics, [f64; 2]);

/// A posed image.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    name: String,
    camera: u32,
    pose: Pinhole,
}

/// Folder of the model in a capture at `path`, if there is one.
pub fn folder(path: &Path) -> Option<PathBuf> {
    let folders = FOLDERS.map(|folder| path.join(folder));
    folders
        .into_iter()
        .find(|folder| file(folder, "cameras").is_some() && file(folder, "images").is_some())
}

/// A part of a model, and true if it is binary, which is preferred, as in COLMAP.
fn file(folder: &Path, part: &str) -> Option<(PathBuf, bool)> {
    let files =
        [("bin", true), ("txt", false)].map(|(ending, binary)| (folder.join(format!("{part}.{ending}")), binary));
    files.into_iter().find(|(path, _)| path.is_file())
}

/// Reads the model in `folder`, whose images are in `images/` of the capture at `path`, or in the capture itself.
/// Frames are in the order of their names.
///
/// # Errors
/// [`CaptureError`] with the file at fault.
pub fn read(path: &Path, folder: &Path) -> Result<(Vec<FrameSpec>, Vec<Point>), CaptureError> {
    let cameras = part(folder, "cameras", cameras_binary, cameras_text)?;
    let images = part(folder, "images", images_binary, images_text)?;
    let points = part(folder, "points3D", points_binary, points_text)?;
    let beside = path.join("images");
    let frames = frames(&cameras, &images, if beside.is_dir() { &beside } else { path });
    let frames = frames.map_err(|what| CaptureError::file(folder, what, "give the images of this model"))?;
    Ok((frames, points))
}

/// Reads one part of a model; a missing one is empty.
fn part<T: Default>(
    folder: &Path,
    name: &str,
    binary: fn(&[u8]) -> Result<T, String>,
    text: fn(&str) -> Result<T, String>,
) -> Result<T, CaptureError> {
    let Some((path, is_binary)) = file(folder, name) else {
        return Ok(T::default());
    };
    let bytes = bounded::read_bytes(&path, FILE_MAX).map_err(CaptureError::io(&path))?;
    let read = match is_binary {
        true => binary(&bytes),
        false => std::str::from_utf8(&bytes)
            .map_err(|_| "it is not UTF-8 text".to_owned())
            .and_then(text),
    };
    read.map_err(|what| {
        let remedy = match what.contains(DISTORTED) {
            true => UNDISTORT,
            false => "write the model anew with `colmap model_converter`",
        };
        CaptureError::file(&path, what, remedy)
    })
}

/// Images with the cameras that took them, by name; their files are in `folder`.
fn frames(cameras: &BTreeMap<u32, Camera>, images: &[Image], folder: &Path) -> Result<Vec<FrameSpec>, String> {
    let frame = |image: &Image| {
        let Image { name, camera, pose } = image;
        let of = cameras.get(camera);
        let (intrinsics, size) = of.ok_or(format!("image {name} has the camera {camera}, which is not there"))?;
        Ok(FrameSpec {
            name: plain_name(name),
            path: find_image(folder, name, None)?,
            light: None,
            pose: *pose,
            intrinsics: *intrinsics,
            declared_size: Some(*size),
            lens: Lens::default(),
        })
    };
    let mut frames: Vec<FrameSpec> = images.iter().map(frame).collect::<Result<_, String>>()?;
    if frames.is_empty() {
        return Err("it has no image".into());
    }
    frames.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(frames)
}

/// Words in the error of a camera with distortion.
const DISTORTED: &str = "with distortion";

fn camera(id: u32, model: &str, size: [f64; 2], numbers: &[f64]) -> Result<Camera, String> {
    let (focal, principal) = match (model, numbers) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => ([f, f], [cx, cy]),
        ("PINHOLE", &[fx, fy, cx, cy]) => ([fx, fy], [cx, cy]),
        ("SIMPLE_PINHOLE" | "PINHOLE", _) => return Err(format!("camera {id} has {} parameters", numbers.len())),
        _ => return Err(format!("camera {id} has the model {model}, a lens {DISTORTED}")),
    };
    let intrinsics = Intrinsics::given(focal, Some(principal));
    let found = intrinsics.and_then(|intrinsics| Ok((intrinsics, sound_size(size)?)));
    found.map_err(|what| format!("camera {id}: {what}"))
}

/// Image with the rotation `q` (scalar first) and translation `t` from world to camera.
fn image(name: &str, camera: u32, q: [f64; 4], t: [f64; 3]) -> Result<Image, String> {
    let bad = || format!("image {name} has a pose that is none: {q:?}, {t:?}");
    let rotation = DQuat::from_xyzw(q[1], q[2], q[3], q[0]);
    let length = rotation.length();
    if !(length > 1e-6 && length.is_finite()) {
        return Err(bad());
    }
    let world_from_camera = DMat3::from_quat(rotation.normalize().inverse());
    let pose = pose(world_from_camera, DVec3::from(t)).ok_or_else(bad)?;
    Ok(Image {
        name: name.to_owned(),
        camera,
        pose,
    })
}

/// Pose of a camera in OpenCV's axes with the translation `t` from world to camera.
pub(super) fn pose(world_from_camera: DMat3, t: DVec3) -> Option<Pinhole> {
    let DMat3 { x_axis, y_axis, z_axis } = world_from_camera;
    Pinhole::from_opengl(DMat3::from_cols(x_axis, -y_axis, -z_axis), -(world_from_camera * t))
}

fn point(position: [f64; 3], colour: [f64; 3]) -> Result<Point, String> {
    Point::new(position, colour).ok_or_else(|| format!("a point is at {position:?}"))
}

/// Rest of a binary file, little-endian.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn next<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (next, rest) = self.0.split_first_chunk().ok_or("it ends early")?;
        self.0 = rest;
        Ok(*next)
    }

    fn skip(&mut self, count: u64, size: u64) -> Result<(), String> {
        let bytes = count.checked_mul(size).and_then(|n| usize::try_from(n).ok());
        let rest = bytes.and_then(|n| self.0.get(n..)).ok_or("it ends early")?;
        self.0 = rest;
        Ok(())
    }

    fn u32(&mut self) -> Result<u32, String> {
        self.next().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, String> {
        self.next().map(u64::from_le_bytes)
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N], String> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = f64::from_le_bytes(self.next()?);
        }
        Ok(numbers)
    }

    /// A text up to a zero.
    fn text(&mut self) -> Result<String, String> {
        let end = self.0.iter().position(|&b| b == 0).ok_or("it ends early")?;
        let text = String::from_utf8_lossy(&self.0[..end]).into_owned();
        self.0 = &self.0[end + 1..];
        Ok(text)
    }
}

/// Cameras of `cameras.bin`.
///
/// # Errors
/// A sentence on the fault.
pub fn cameras_binary(bytes: &[u8]) -> Result<BTreeMap<u32, Camera>, String> {
    let mut bytes = Bytes(bytes);
    let mut cameras = BTreeMap::new();
    for _ in 0..bytes.u64()? {
        let (id, model) = (bytes.u32()?, bytes.u32()?);
        let size = [bytes.u64()? as f64, bytes.u64()? as f64];
        let known = MODELS.get(model as usize);
        let &(name, count) = known.ok_or(format!("camera {id} has the unknown model {model}"))?;
        let numbers: Vec<f64> = (0..count)
            .map(|_| Ok(bytes.numbers::<1>()?[0]))
            .collect::<Result<_, String>>()?;
        cameras.insert(id, camera(id, name, size, &numbers)?);
    }
    Ok(cameras)
}

/// Images of `images.bin`.
///
/// # Errors
/// A sentence on the fault.
pub fn images_binary(bytes: &[u8]) -> Result<Vec<Image>, String> {
    let mut bytes = Bytes(bytes);
    let mut images = Vec::new();
    for _ in 0..bytes.u64()? {
        bytes.u32()?;
        let (q, t, camera, name) = (bytes.numbers()?, bytes.numbers()?, bytes.u32()?, bytes.text()?);
        let observations = bytes.u64()?;
        bytes.skip(observations, 24)?;
        images.push(image(&name, camera, q, t)?);
    }
    Ok(images)
}

/// Points of `points3D.bin`.
///
/// # Errors
/// A sentence on the fault.
pub fn points_binary(bytes: &[u8]) -> Result<Vec<Point>, String> {
    let mut bytes = Bytes(bytes);
    let mut points = Vec::new();
    for _ in 0..bytes.u64()? {
        bytes.u64()?;
        let (position, colour) = (bytes.numbers()?, bytes.next::<3>()?);
        bytes.numbers::<1>()?;
        let observations = bytes.u64()?;
        bytes.skip(observations, 8)?;
        points.push(point(position, colour.map(f64::from))?);
    }
    Ok(points)
}

/// A line of a text as words.
struct Words<'a> {
    line: &'a str,
    words: std::str::SplitAsciiWhitespace<'a>,
}

impl<'a> Words<'a> {
    fn new(line: &'a str) -> Self {
        Self {
            line,
            words: line.split_ascii_whitespace(),
        }
    }

    fn next<T: std::str::FromStr>(&mut self) -> Result<T, String> {
        let found = self.words.next().and_then(|word| word.parse().ok());
        found.ok_or_else(|| {
            let start: String = self.line.chars().take(60).collect();
            format!("the line {start:?} is not as COLMAP writes it")
        })
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N], String> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.next()?;
        }
        Ok(numbers)
    }
}

/// Lines that are neither empty nor comments.
fn is_content(line: &str) -> bool {
    let line = line.trim_start();
    !line.is_empty() && !line.starts_with('#')
}

/// Cameras of `cameras.txt`.
///
/// # Errors
/// A sentence on the fault.
pub fn cameras_text(text: &str) -> Result<BTreeMap<u32, Camera>, String> {
    let read = |line| {
        let mut words = Words::new(line);
        let (id, model, size) = (words.next()?, words.next::<String>()?, words.numbers()?);
        let count = words.words.clone().count();
        let numbers: Vec<f64> = (0..count).map(|_| words.next()).collect::<Result<_, String>>()?;
        Ok((id, camera(id, &model, size, &numbers)?))
    };
    text.lines().filter(|line| is_content(line)).map(read).collect()
}

/// Images of `images.txt`: two lines each, of which the second, the observations, may be empty.
///
/// # Errors
/// A sentence on the fault.
pub fn images_text(text: &str) -> Result<Vec<Image>, String> {
    let (mut images, mut lines) = (Vec::new(), text.lines());
    while let Some(line) = lines.next() {
        if !is_content(line) {
            continue;
        }
        let mut words = Words::new(line);
        words.next::<u32>()?;
        let (q, t, camera) = (words.numbers()?, words.numbers()?, words.next()?);
        let name: Vec<&str> = words.words.collect();
        images.push(image(&name.join(" "), camera, q, t)?);
        lines.next();
    }
    Ok(images)
}

/// Points of `points3D.txt`.
///
/// # Errors
/// A sentence on the fault.
pub fn points_text(text: &str) -> Result<Vec<Point>, String> {
    let read = |line| {
        let mut words = Words::new(line);
        words.next::<u64>()?;
        point(words.numbers()?, words.numbers()?)
    };
    text.lines().filter(|line| is_content(line)).map(read).collect()
}
