//! Captures of an object with known shape, materials and light, made by a path tracer.
//!
//! Files are in the common format: `transforms_train.json` and `transforms_test.json` with their images. Normals of the
//! held-out views, `(n + 1) / 2` in the frame of the cameras, and the number of the part at each pixel are in `truth/`.

mod material;
mod request;
mod sampler;
mod shape;
mod stage;
mod trace;

pub use request::{Capture, Look, ObjectRequest};

use crate::encoding::srgb;
use crate::error::SynthError;
use crate::ray::Ray;
use crate::write::Staging;
use image::{DynamicImage, ImageBuffer, Luma, Rgb, Rgba};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;
use sampler::PathSampler;
use serde_json::json;
use stage::{LIGHT_STRENGTH, Shot};
use std::path::Path;
use trace::{LightSource, Stage};

/// Horizontal field of view of every camera, radians; that of NeRF-synthetic.
const FIELD_OF_VIEW: f64 = 0.691_111_2;

/// Summary of a written capture.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct ObjectSummary {
    /// Number of images to train with.
    pub train: usize,
    /// Number of images held out.
    pub test: usize,
    /// Number of held-out images whose light is far from all lights of training.
    pub far: usize,
    /// Width and height of every image, pixels.
    pub size_px: usize,
    /// Share of the pixels that show the object, 0 to 1.
    pub coverage: f64,
    /// Lower bound of the PSNR of the held-out images against images without path-tracing noise, decibels, mean over
    /// the images. It is computed from the difference of two halves of the paths. Edges and patterns add to this
    /// difference, so that the noise is somewhat smaller.
    pub noise_floor_db: f64,
}

/// A camera that looks at the centre.
struct LookAtCamera {
    eye: Vector3<f64>,
    right: Vector3<f64>,
    up: Vector3<f64>,
    backward: Vector3<f64>,
    focal_px: f64,
    size_px: usize,
}

impl LookAtCamera {
    fn new(eye: Vector3<f64>, size_px: usize) -> Self {
        let backward = eye.normalize();
        let right = Vector3::z().cross(&backward).normalize();
        Self {
            eye,
            right,
            up: backward.cross(&right),
            backward,
            focal_px: 0.5 * size_px as f64 / (0.5 * FIELD_OF_VIEW).tan(),
            size_px,
        }
    }

    /// Ray through a place in the image; corners of pixels are at integers.
    fn ray(&self, col: f64, row: f64) -> Ray {
        let half = 0.5 * self.size_px as f64;
        let aside = self.right * (col - half) - self.up * (row - half);
        Ray::new(self.eye, (aside - self.backward * self.focal_px).normalize())
    }

    fn matrix(&self) -> Vec<[f64; 4]> {
        let row = |k: usize| [self.right[k], self.up[k], self.backward[k], self.eye[k]];
        vec![row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
    }
}

/// One pixel: colour times coverage, coverage, mean normal.
#[derive(Clone, Copy, Default)]
struct Pixel {
    colour: Vector3<f64>,
    coverage: f64,
    normal: Vector3<f64>,
    /// Half of the difference between two halves of the paths: its square is the variance of the colour.
    doubt: Vector3<f64>,
    /// Number of the part that most paths met first; `None` where most paths met none.
    part: Option<usize>,
}

impl Pixel {
    /// Variance of the written value, mean over the colours.
    fn variance(&self, linear: bool) -> f64 {
        let slope = |value: f64| (f64::from(display(value + 1e-3)) - f64::from(display(value - 1e-3))) / 255.0 / 2e-3;
        let slope_at = |k: usize| match linear {
            true => 1.0,
            false => slope(self.colour[k] / self.coverage.max(1e-9)),
        };
        (0..3).map(|k| (slope_at(k) * self.doubt[k]).powi(2)).sum::<f64>() / 3.0
    }
}

/// Writes a capture into `out_dir`. `progress` receives the number of images done and of all images. The same request
/// gives the same bytes, for any number of threads.
///
/// # Errors
/// [`SynthError::BadRequest`] for a request that cannot be met, [`SynthError::Failed`] when a
/// file cannot be written; `out_dir` then holds nothing new.
pub fn write_object(
    request: &ObjectRequest,
    out_dir: &Path,
    progress: &dyn Fn(usize, usize),
) -> Result<ObjectSummary, SynthError> {
    request.check()?;
    let staging = Staging::new(out_dir)?;
    let (stage, shots) = (stage::stage(request), stage::shots(request));
    let total = shots.train.len() + shots.near.len() + shots.far.len();
    let (mut done, mut covered, mut floors) = (0, 0.0, Vec::new());
    let linear = request.capture == Capture::Olat;
    let mut frames_of = |split: &str, name: &str, shots: &[Shot]| -> Result<Vec<serde_json::Value>, SynthError> {
        let mut frames = Vec::new();
        for (number, shot) in shots.iter().enumerate() {
            let name = format!("{split}/{name}_{number:03}");
            let camera = LookAtCamera::new(shot.eye, request.size_px);
            let pixels = photograph(request, &stage, shot, &camera, done as u64);
            covered += pixels.iter().map(|p| p.coverage).sum::<f64>() / (pixels.len() * total) as f64;
            write_image(linear, &staging, &name, &pixels)?;
            if split == "test" {
                write_truth(&staging, &name, &pixels)?;
                let variance = pixels.iter().map(|p| p.variance(linear)).sum::<f64>() / pixels.len() as f64;
                floors.push(-10.0 * variance.max(1e-12).log10());
            }
            let mut frame = json!({"file_path": format!("./{name}"), "transform_matrix": camera.matrix()});
            if let Some(light) = shot.light {
                frame["pl_pos"] = json!([light.x, light.y, light.z]);
                frame["pl_intensity"] = json!([LIGHT_STRENGTH, LIGHT_STRENGTH, LIGHT_STRENGTH]);
            }
            frames.push(frame);
            done += 1;
            progress(done, total);
        }
        Ok(frames)
    };
    let train = frames_of("train", "r", &shots.train)?;
    let mut test = frames_of("test", if shots.far.is_empty() { "r" } else { "near" }, &shots.near)?;
    test.extend(frames_of("test", "far", &shots.far)?);
    for (name, frames) in [("transforms_train.json", train), ("transforms_test.json", test)] {
        let file = json!({"camera_angle_x": FIELD_OF_VIEW, "frames": frames});
        staging.text(name, &format!("{file:#}\n"))?;
    }
    staging.finish()?;
    Ok(ObjectSummary {
        train: shots.train.len(),
        test: shots.near.len() + shots.far.len(),
        far: shots.far.len(),
        size_px: request.size_px,
        coverage: covered,
        noise_floor_db: floors.iter().sum::<f64>() / floors.len().max(1) as f64,
    })
}

/// Sign of a path in the difference of two halves of the paths: 1 for the first half, -1 for the second. Either half is
/// a sequence of its own. The last of an odd number of paths has 0; a single path has -1.
fn half_of(path: u32, paths: u32) -> f64 {
    if path < paths / 2 {
        1.0
    } else if path < paths / 2 * 2 || paths == 1 {
        -1.0
    } else {
        0.0
    }
}

/// Follows the paths of all pixels of an image.
fn photograph(request: &ObjectRequest, stage: &Stage, shot: &Shot, camera: &LookAtCamera, number: u64) -> Vec<Pixel> {
    let mut stage = stage.clone();
    stage.lights.extend(shot.light.map(|position| LightSource::Point {
        position,
        strength: Vector3::repeat(LIGHT_STRENGTH),
    }));
    let size = request.size_px;
    let paths = request.paths as u32;
    (0..size * size)
        .into_par_iter()
        .with_min_len(64)
        .map(|i| {
            let seed = (request.seed << 48) ^ (number << 32) ^ i as u64;
            let mut pixel = Pixel::default();
            let mut met = vec![0usize; stage.parts.len()];
            for path in 0..paths {
                let mut sampler = PathSampler::new(seed, path);
                let place = sampler.within_pixel() + Vector2::new((i % size) as f64, (i / size) as f64);
                if let Some(seen) = stage.look(&camera.ray(place.x, place.y), &mut sampler) {
                    pixel.colour += seen.radiance;
                    pixel.doubt += seen.radiance * half_of(path, paths);
                    met[seen.part] += 1;
                    pixel.coverage += 1.0;
                    pixel.normal += seen.normal;
                }
            }
            let count = f64::from(paths);
            pixel.colour /= count;
            pixel.coverage /= count;
            pixel.doubt /= count;
            let most = (0..met.len()).max_by_key(|&part| met[part]);
            pixel.part = most.filter(|_| pixel.coverage > 0.5);
            pixel
        })
        .collect()
}

/// Transfer curve of sRGB (IEC 61966-2-1) to 8 bits.
fn display(linear: f64) -> u8 {
    (srgb(linear.clamp(0.0, 1.0)) * 255.0).round() as u8
}

/// Writes a square picture of the pixels in the format of the name's ending.
fn save<P: image::Pixel>(
    staging: &Staging,
    relative: &str,
    pixels: &[Pixel],
    of: impl Fn(&Pixel) -> P,
) -> Result<(), SynthError>
where
    DynamicImage: From<ImageBuffer<P, Vec<P::Subpixel>>>,
{
    let size = pixels.len().isqrt() as u32;
    let picture = ImageBuffer::from_fn(size, size, |x, y| of(&pixels[(y * size + x) as usize]));
    let path = staging.path(relative)?;
    (DynamicImage::from(picture).save(&path)).map_err(SynthError::unwritable(&path))
}

/// Writes captures under one light as linear EXR, and others as PNG for a display.
fn write_image(linear: bool, staging: &Staging, name: &str, pixels: &[Pixel]) -> Result<(), SynthError> {
    if linear {
        let pixel = |p: &Pixel| {
            let [r, g, b] = [0, 1, 2].map(|k| p.colour[k] as f32);
            Rgba([r, g, b, p.coverage as f32])
        };
        return save(staging, &format!("{name}.exr"), pixels, pixel);
    }
    let pixel = |p: &Pixel| {
        let [r, g, b] = [0, 1, 2].map(|k| display(p.colour[k] / p.coverage.max(1e-9)));
        Rgba([r, g, b, (p.coverage * 255.0).round() as u8])
    };
    save(staging, &format!("{name}.png"), pixels, pixel)
}

/// Writes the normals, black where most of the pixel shows nothing, and the number of each pixel's part, counted from
/// 1; 0 where there is none.
fn write_truth(staging: &Staging, name: &str, pixels: &[Pixel]) -> Result<(), SynthError> {
    let normal = |p: &Pixel| {
        let known = p.coverage > 0.5 && p.normal.norm() > 0.0;
        let n = if known {
            p.normal.normalize()
        } else {
            Vector3::repeat(-1.0)
        };
        Rgb([0, 1, 2].map(|k| (127.5 * (n[k] + 1.0)).round() as u8))
    };
    let part = |p: &Pixel| Luma([p.part.map_or(0, |part| part as u8 + 1)]);
    save(staging, &format!("truth/{name}_normal.png"), pixels, normal)?;
    save(staging, &format!("truth/{name}_part.png"), pixels, part)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(capture: Capture, look: Look) -> ObjectRequest {
        ObjectRequest {
            capture,
            look,
            seed: 2,
            views: Some(3),
            held_out: Some(2),
            size_px: 24,
            paths: 4,
        }
    }

    #[test]
    fn a_capture_is_the_same_bytes_for_any_number_of_threads() {
        let made = |threads: usize| {
            let folder = tempfile::tempdir().expect("a temporary folder");
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("threads");
            let summary = pool.install(|| {
                write_object(&request(Capture::Olat, Look::Glossy), folder.path(), &|_, _| {}).expect("made")
            });
            let read = |name: &str| std::fs::read(folder.path().join(name)).expect(name);
            assert_eq!((summary.train, summary.test, summary.far), (3, 2, 1));
            (
                read("train/r_002.exr"),
                read("test/far_000.exr"),
                read("transforms_test.json"),
            )
        };
        assert!(made(1) == made(3));
    }

    #[test]
    fn every_look_gives_images_with_an_object_in_their_middle() {
        for (capture, look) in [
            (Capture::Object, Look::Matte),
            (Capture::Reflective, Look::Brushed),
            (Capture::Reflective, Look::Glossy),
        ] {
            let folder = tempfile::tempdir().expect("a temporary folder");
            let summary = write_object(&request(capture, look), folder.path(), &|_, _| {}).expect("made");
            assert!((0.1..0.7).contains(&summary.coverage), "{}", summary.coverage);
            let picture = image::open(folder.path().join("test/r_001.png"))
                .expect("a picture")
                .to_rgba8();
            assert_eq!(picture.get_pixel(0, 0).0[3], 0);
            assert!((0..24).flat_map(|x| (0..24).map(move |y| (x, y))).any(|(x, y)| {
                let p = picture.get_pixel(x, y).0;
                p[3] == 255 && p[0].max(p[1]).max(p[2]) > 60
            }));
            assert!(folder.path().join("truth/test/r_001_normal.png").is_file());
        }
    }

    #[test]
    fn requests_that_cannot_be_met_are_refused_and_leave_nothing() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let request = ObjectRequest {
            size_px: 1 << 20,
            ..ObjectRequest::default()
        };
        let error = write_object(&request, folder.path(), &|_, _| {}).expect_err("too large");
        assert!(error.to_string().contains("16 to 2048"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).expect("readable").count(), 0);
    }
}
