//! A capture: images of an object from around it, with cameras and, where known, lights and points.

use super::error::CaptureError;
use super::frame_spec::{FrameSpec, PointLight};
use super::pinhole::{Pinhole, common_centre};
use super::pixels::{self, Encoding, Picture};
use super::points::{self, Point};
use super::transforms;
use super::{camera_table, colmap};
use glam::DVec3;
use heliosplat_grid::statistics::upper_median;
use heliosplat_raster::bounded;
use heliosplat_scene::Split;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Default limit of the memory for images, bytes.
pub const IMAGE_BYTES: u64 = 8 << 30;
/// Interval of held-out images if no file lists them: every eighth image, as in NeRF and its successors.
const HOLD_EVERY: usize = 8;
/// Files of a capture and the use of their images. Images for validation are ignored where there are images for
/// testing.
const FILES: [(&str, Split); 4] = [
    ("transforms_train.json", Split::Train),
    ("transforms_test.json", Split::Test),
    ("transforms_val.json", Split::Test),
    ("transforms_valid.json", Split::Test),
];

/// File of a capture that lists all images together.
const SINGLE: &str = "transforms.json";
/// Largest point cloud that is read, bytes.
const CLOUD_MAX: u64 = 2 << 30;

/// One image of a capture with its camera and light.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Name: the path as written in the list, without extension.
    pub name: String,
    /// Path of the image file.
    pub path: PathBuf,
    /// Use of the image: training or testing.
    pub split: Split,
    /// Camera in the capture's own frame and units.
    pub camera: Pinhole,
    /// Light, if known.
    pub light: Option<PointLight>,
    /// Colours and coverage of the pixels.
    pub picture: Picture,
}

/// The images of an object, with the centre and scale of its views.
#[derive(Debug, Clone)]
pub struct Capture {
    /// Folder of the capture, or its `transforms` file.
    pub source: PathBuf,
    /// The images, in the order of their lists.
    pub frames: Vec<Frame>,
    /// Points of the reconstruction, in the frame of the cameras; empty where the files have none.
    pub points: Vec<Point>,
    /// Point nearest to the optical axes, in the frame of the cameras: the origin of the model's frame.
    pub centre: DVec3,
    /// Half side of the cube that the cameras see (median over the images), in the capture's units.
    pub half_size: f64,
    /// Width of a pixel at the centre (median over the images), in the capture's units.
    pub pixel_size: f64,
    /// Suspicious findings that do not stop the run.
    pub warnings: Vec<String>,
}

/// True if `path` is a capture: a `transforms` file or a table of cameras, a folder with one, or one with a model of
/// COLMAP.
pub fn is_capture(path: &Path) -> bool {
    if path.is_file() {
        let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
        return (name.starts_with("transforms") && name.ends_with(".json")) || name == camera_table::NAME;
    }
    let files = FILES.iter().map(|(name, _)| *name).chain([SINGLE, camera_table::NAME]);
    files.into_iter().any(|name| path.join(name).is_file()) || colmap::folder(path).is_some()
}

impl Capture {
    /// True unit normals of a frame, encoded as `(n + 1) / 2`, and the number of the object's part at each pixel;
    /// `None` where the capture has no truth.
    pub fn true_parts(&self, frame: &Frame) -> Option<(image::RgbImage, image::GrayImage)> {
        let folder = match self.source.is_dir() {
            true => self.source.as_path(),
            false => self.source.parent()?,
        };
        let name = frame.name.trim_start_matches("./");
        let file = |kind: &str| image::open(folder.join(format!("truth/{name}_{kind}.png"))).ok();
        Some((file("normal")?.to_rgb8(), file("part")?.to_luma8()))
    }

    /// Opens the capture at `path`, a folder or one list of cameras, and reads its images into at most `image_bytes`
    /// bytes.
    ///
    /// # Errors
    /// [`CaptureError`] with the file at fault, also where the images need more memory or no camera looks at a common
    /// point.
    pub fn open(path: &Path, image_bytes: u64) -> Result<Self, CaptureError> {
        let listing = list(path)?;
        let sizes = listing.specs.par_iter().map(|(spec, _)| pixels::size_px(&spec.path));
        let sizes: Vec<[usize; 2]> = sizes.collect::<Result<_, _>>()?;
        let needed: u64 = sizes.iter().map(|[cols, rows]| 4 * 4 * (cols * rows) as u64).sum();
        if needed > image_bytes {
            let gib = |bytes: u64| bytes as f64 / f64::from(1 << 30);
            return Err(CaptureError(format!(
                "{}: its images take {:.1} GiB and at most {:.1} GiB are used; give fewer or smaller ones, or more with --memory",
                path.display(),
                gib(needed),
                gib(image_bytes)
            )));
        }
        let frames: Vec<Frame> = (listing.specs.into_par_iter())
            .zip(sizes)
            .map(|((spec, split), size_px)| frame(spec, split, size_px))
            .collect::<Result<_, _>>()?;
        let mut capture = Self::of_frames(path, frames)?;
        capture.points = listing.points;
        capture.warnings.extend(listing.warnings);
        Ok(capture)
    }

    fn of_frames(source: &Path, mut frames: Vec<Frame>) -> Result<Self, CaptureError> {
        let cameras: Vec<Pinhole> = frames.iter().map(|f| f.camera).collect();
        let centre = common_centre(&cameras);
        let mut warnings = Vec::new();
        let before = frames.len();
        frames.retain(|frame| frame.camera.depth(centre) > 1e-6 * (centre - frame.camera.eye).length());
        if frames.len() < before {
            let away = before - frames.len();
            warnings.push(format!(
                "{away} of {before} cameras look away from where the others look: left out"
            ));
        }
        if !frames.iter().any(|f| f.split == Split::Train) {
            let remedy = "check the direction and the axes of the poses (docs/guide/objects.md)";
            return Err(CaptureError::file(source, "no camera looks at a common point", remedy));
        }
        let encodings: Vec<Encoding> = frames.iter().map(|f| f.picture.encoding).collect();
        if encodings.iter().any(|&e| e != encodings[0]) {
            warnings.push("some images are EXR and some are not: their brightness will not agree".into());
        }
        let half = |f: &Frame| {
            let c = &f.camera;
            let [across, down] = [0, 1].map(|k| 0.5 * c.size_px[k] as f64 / c.focal_px[k]);
            c.depth(centre) * across.min(down)
        };
        let pixel = |f: &Frame| f.camera.depth(centre) / f.camera.focal_px[0].max(f.camera.focal_px[1]);
        let median = |of: &dyn Fn(&Frame) -> f64| {
            let mut values: Vec<f64> = frames.iter().map(of).collect();
            upper_median(&mut values).unwrap_or(1.0)
        };
        Ok(Self {
            source: source.to_owned(),
            half_size: median(&half),
            pixel_size: median(&pixel),
            points: Vec::new(),
            centre,
            frames,
            warnings,
        })
    }

    /// Iterates over the images for training or for testing, in the order of their lists.
    pub fn of(&self, split: Split) -> impl Iterator<Item = &Frame> {
        self.frames.iter().filter(move |f| f.split == split)
    }

    /// Area of the object's surface in pixels of the images: four times the mean silhouette, as for every convex body
    /// (Cauchy 1841). An image without coverage counts as a whole.
    pub(super) fn surface_px(&self) -> usize {
        let silhouette = |frame: &Frame| match &frame.picture.coverage {
            Some(coverage) => coverage.iter().sum::<f32>(),
            None => frame.picture.colour.plane_len() as f32,
        };
        let total: f32 = self.frames.iter().map(silhouette).sum();
        (4.0 * total / self.frames.len().max(1) as f32) as usize
    }

    /// True if all images have coverage.
    pub fn has_coverage(&self) -> bool {
        self.frames.iter().all(|f| f.picture.coverage.is_some())
    }
}

fn frame(spec: FrameSpec, split: Split, size_px: [usize; 2]) -> Result<Frame, CaptureError> {
    let camera = (spec.camera(size_px)).map_err(|(what, remedy)| CaptureError::file(&spec.path, what, remedy))?;
    Ok(Frame {
        picture: pixels::read(&spec.path)?,
        name: spec.name,
        path: spec.path,
        split,
        camera,
        light: spec.light,
    })
}

/// The images that a capture lists with the use of each, and the points of its reconstruction.
struct Listing {
    specs: Vec<(FrameSpec, Split)>,
    points: Vec<Point>,
    warnings: Vec<String>,
}

/// Lists the capture at `path`.
fn list(path: &Path) -> Result<Listing, CaptureError> {
    let file = |name: &str| Some(path.join(name)).filter(|file| file.is_file());
    if path.ends_with(camera_table::NAME) && path.is_file() {
        return table(path);
    }
    if path.is_file() {
        return Ok(together(transforms::read(path)?));
    }
    let (mut specs, mut cloud): (Vec<(FrameSpec, Split)>, _) = (Vec::new(), None);
    let tested = |specs: &[(FrameSpec, Split)]| specs.iter().any(|(_, split)| *split == Split::Test);
    for (name, split) in FILES {
        let Some(file) = file(name) else { continue };
        if !(tested(&specs) && split == Split::Test) {
            let listed = transforms::read(&file)?;
            specs.extend(listed.frames.into_iter().map(|spec| (spec, split)));
            cloud = cloud.or(listed.points);
        }
    }
    if specs.iter().any(|(_, split)| *split == Split::Train) {
        if !tested(&specs) {
            specs = held_out(specs.into_iter().map(|(spec, _)| spec).collect());
        }
        return Ok(with_cloud(specs, cloud));
    }
    if let Some(single) = file(SINGLE) {
        return Ok(together(transforms::read(&single)?));
    }
    if let Some(folder) = colmap::folder(path) {
        let (frames, points) = colmap::read(path, &folder)?;
        let next = folder.with_file_name("1");
        let several = folder.ends_with("0") && next.is_dir();
        return Ok(Listing {
            specs: held_out(frames),
            points,
            warnings: several
                .then(|| format!("COLMAP found several models; {} is used alone", folder.display()))
                .into_iter()
                .collect(),
        });
    }
    if let Some(cameras) = file(camera_table::NAME) {
        return table(&cameras);
    }
    let remedy = "give a folder that holds one";
    let what = "no transforms_train.json, transforms.json, COLMAP model or cameras.csv here";
    Err(CaptureError::file(path, what, remedy))
}

fn table(path: &Path) -> Result<Listing, CaptureError> {
    Ok(with_cloud(held_out(camera_table::read(path)?), None))
}

fn together(listed: transforms::Listed) -> Listing {
    with_cloud(held_out(listed.frames), listed.points)
}

/// A listing with the points of the file `cloud`, which is not needed: its faults are warnings.
fn with_cloud(specs: Vec<(FrameSpec, Split)>, cloud: Option<PathBuf>) -> Listing {
    let read = |path: &PathBuf| {
        let bytes = bounded::read_bytes(path, CLOUD_MAX).map_err(|error| error.to_string());
        let points = bytes.and_then(|bytes| points::read_ply(&bytes));
        points.map_err(|what| format!("{}: {what}; training starts without these points", path.display()))
    };
    let (points, warnings) = match cloud.as_ref().map(read) {
        None => (Vec::new(), Vec::new()),
        Some(Ok(points)) => (points, Vec::new()),
        Some(Err(warning)) => (Vec::new(), vec![warning]),
    };
    Listing {
        specs,
        points,
        warnings,
    }
}

/// Every eighth image is held out, the first one first; none of fewer than eight.
fn held_out(specs: Vec<FrameSpec>) -> Vec<(FrameSpec, Split)> {
    let many = specs.len() >= HOLD_EVERY;
    let split = |i: usize| {
        if many && i.is_multiple_of(HOLD_EVERY) {
            Split::Test
        } else {
            Split::Train
        }
    };
    specs
        .into_iter()
        .enumerate()
        .map(|(i, spec)| (spec, split(i)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgba, RgbaImage};
    use serde_json::{Value, json};

    fn picture(tone: u8) -> RgbaImage {
        RgbaImage::from_fn(10, 8, |x, y| {
            Rgba([x as u8 * 20, y as u8 * 30, tone, if x > 2 { 255 } else { 0 }])
        })
    }

    /// A camera on the x axis that looks at the origin, turned around the z axis.
    fn matrix(turn: f64) -> Value {
        let (s, c) = turn.sin_cos();
        json!([
            [-s, 0.0, c, 4.0 * c],
            [c, 0.0, s, 4.0 * s],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 1.0]
        ])
    }

    fn write(folder: &Path, name: &str, value: &Value) {
        std::fs::write(folder.join(name), value.to_string()).expect("written");
    }

    /// The images of a folder as the engine gets them.
    fn views(folder: &Path) -> Vec<(String, Split, Pinhole, Picture, Option<PointLight>)> {
        let capture = Capture::open(folder, IMAGE_BYTES).expect("a sound capture");
        let frames = capture.frames.into_iter();
        frames
            .map(|f| (f.name, f.split, f.camera, f.picture, f.light))
            .collect()
    }

    #[test]
    fn the_same_images_in_any_dialect_are_the_same_views() {
        let angle = 2.0 * (5.0f64 / 12.0).atan();
        let folder = || {
            let folder = tempfile::tempdir().expect("a temporary folder");
            std::fs::create_dir(folder.path().join("train")).expect("a folder");
            for i in 0..3u8 {
                picture(i)
                    .save(folder.path().join(format!("train/r_{i}.png")))
                    .expect("written");
                // A file that must not be read as an image of the capture.
                picture(99)
                    .save(folder.path().join(format!("train/r_{i}_normal.png")))
                    .expect("written");
            }
            folder
        };
        let place = |i: usize| json!([i as f64, 2.0, 3.0]);
        let frames = |frame: &dyn Fn(usize) -> Value| -> Vec<Value> { (0..3).map(frame).collect() };
        let turn = |i: usize| matrix(i as f64);
        let nerf = folder();
        let list = frames(
            &|i| json!({"file_path": format!("./train/r_{i}"), "transform_matrix": turn(i), "pl_pos": place(i)}),
        );
        write(
            nerf.path(),
            "transforms_train.json",
            &json!({"camera_angle_x": angle, "frames": list}),
        );
        let hints = folder();
        let list = frames(&|i| {
            json!({"file_path": format!("train/r_{i}"), "file_ext": ".png", "transform_matrix": turn(i),
                "pl_pos": place(i), "camera_intrinsics": [5.0, 4.0, 12.0, 12.0]})
        });
        write(hints.path(), "transforms_train.json", &json!({"frames": list}));
        let studio = folder();
        let list = frames(
            &|i| json!({"file_path": format!("train/r_{i}.png"), "transform_matrix": turn(i), "light": {"position": place(i)}}),
        );
        let whole = json!({"fl_x": 12.0, "fl_y": 12.0, "cx": 5.0, "cy": 4.0, "w": 10, "h": 8, "frames": list});
        write(studio.path(), "transforms.json", &whole);
        let lists = folder();
        let list = frames(&|i| {
            json!({"file_paths": [format!("train/r_{i}")], "light_positions": [place(i)], "transform_matrix": turn(i),
                "width": 10, "height": 8, "fl_x": 12.0})
        });
        write(lists.path(), "transforms_train.json", &json!({"frames": list}));
        let expected = views(nerf.path());
        assert_eq!(expected.len(), 3);
        for other in [hints, studio, lists] {
            let seen = views(other.path());
            for (a, b) in seen.iter().zip(&expected) {
                assert!((a.2.focal_px[0] - b.2.focal_px[0]).abs() < 1e-9);
                let camera = Pinhole {
                    focal_px: b.2.focal_px,
                    ..a.2
                };
                assert_eq!((&a.0, a.1, camera, &a.3, a.4), (&b.0, b.1, b.2, &b.3, b.4));
            }
            assert_eq!(seen.len(), 3);
        }
    }

    #[test]
    fn images_are_held_out_as_the_files_say_or_every_eighth() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        picture(1).save(folder.path().join("a.png")).expect("written");
        let list = |count: usize| -> Value {
            let frames = (0..count).map(|i| json!({"file_path": "a", "transform_matrix": matrix(i as f64)}));
            json!({"camera_angle_x": 0.7, "frames": frames.collect::<Vec<_>>()})
        };
        let count = |split| {
            let capture = Capture::open(folder.path(), IMAGE_BYTES).expect("a sound capture");
            capture.of(split).count()
        };
        write(folder.path(), "transforms.json", &list(16));
        assert_eq!((count(Split::Train), count(Split::Test)), (14, 2));
        write(folder.path(), "transforms_train.json", &list(9));
        write(folder.path(), "transforms_val.json", &list(3));
        assert_eq!((count(Split::Train), count(Split::Test)), (9, 3));
        // Images for validation are ignored where there are images for testing.
        write(folder.path(), "transforms_test.json", &list(5));
        assert_eq!((count(Split::Train), count(Split::Test)), (9, 5));
    }

    #[test]
    fn images_that_take_too_much_memory_are_refused_before_they_are_read() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        picture(1).save(folder.path().join("a.png")).expect("written");
        let frames: Vec<Value> = (0..50)
            .map(|i| json!({"file_path": "a", "transform_matrix": matrix(f64::from(i))}))
            .collect();
        write(
            folder.path(),
            "transforms.json",
            &json!({"camera_angle_x": 0.7, "frames": frames}),
        );
        let error = Capture::open(folder.path(), 1000).expect_err("too much").to_string();
        assert!(error.contains("--memory"), "{error}");
    }
}
