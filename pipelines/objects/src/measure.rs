//! Scores of a model on held-out images.

use super::capture::{Capture, Frame};
use super::model::{Kind, ObjectFile, ObjectModel};
use super::pixels::Encoding;
use super::views::Preparation;
use glam::Vec3;
use heliosplat::Raster;
use heliosplat::model::Parameters;
use heliosplat::shade::display;
use heliosplat_evaluate::image::{ImageScore, psnr_db, score_image};
use heliosplat_fitting::curve::Accuracy;
use heliosplat_fitting::training::Probe;
use heliosplat_raster::RasterError;
use heliosplat_raster::preview::{side_by_side, write_png};
use heliosplat_scene::Split;
use image::{Rgb, RgbImage};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// Angle from the nearest training light beyond which a light is far, radians (8.6 degrees).
const FAR_RAD: f64 = 0.15;

/// Most held-out images that are scored during training.
const PROBED: usize = 3;
/// Most training images that are scored afterwards; all held-out images are.
const SCORED: usize = 25;

/// A frame and its rendering, of one size.
pub struct Compared {
    /// The image, in front of the model's background.
    pub truth: Raster,
    /// Rendering for the frame's camera and light.
    pub rendered: Raster,
    /// PSNR and SSIM of the rendering; `None` where no pixel is known in both.
    pub score: Option<ImageScore>,
}

/// Compares a frame with its rendering. Display values of the rendering are clamped to 0..1. `None` when the model lies
/// behind the camera.
pub fn compare(model: &ObjectModel, frame: &Frame) -> Option<Compared> {
    let preparation = Preparation {
        coverage: false,
        ..model.file.preparation
    };
    let truth = preparation.image(&frame.picture);
    let mut rendered = model.render(&model.image_of(frame))?;
    if !is_linear(model) {
        rendered.values.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    }
    Some(Compared {
        score: score_image(&rendered, &truth, None),
        truth,
        rendered,
    })
}

/// True if the values of a model's renderings are proportional to light, false if they are display values.
pub fn is_linear(model: &ObjectModel) -> bool {
    model.file.encoding == Encoding::Linear || model.file.preparation.linear
}

/// Probe of a training: mean PSNR on at most three held-out images; `file` describes the model. `None` without held-out
/// images.
pub(super) fn psnr_probe(capture: &Capture, file: ObjectFile) -> Option<Box<Probe<'_>>> {
    let frames = at_most(PROBED, capture.of(Split::Test).collect());
    if frames.is_empty() {
        return None;
    }
    Some(Box::new(move |parameters: &Parameters| {
        let model = ObjectModel::new(file.clone(), parameters.clone());
        let scores = frames.iter().filter_map(|frame| compare(&model, frame)?.score);
        let psnrs: Vec<f64> = scores.map(|score| score.psnr).collect();
        (!psnrs.is_empty()).then(|| Accuracy {
            height_mae_m: None,
            psnr_db: Some(psnrs.iter().sum::<f64>() / psnrs.len() as f64),
        })
    }))
}

/// At most `count` of these images, evenly spread.
fn at_most(count: usize, frames: Vec<&Frame>) -> Vec<&Frame> {
    let step = frames.len().div_ceil(count).max(1);
    frames.into_iter().step_by(step).collect()
}

/// Mean scores of images; with `folder`, each image and its rendering are written there.
fn scores(model: &ObjectModel, frames: &[&Frame], folder: Option<&Path>) -> Result<Option<ImageScore>, RasterError> {
    let mut all = Vec::new();
    for frame in frames {
        let Some(compared) = compare(model, frame) else {
            continue;
        };
        if let Some(folder) = folder {
            let pair = side_by_side(&[picture(&compared.truth, model), picture(&compared.rendered, model)]);
            write_png(&folder.join(format!("{}.png", file_name(&frame.name))), &pair)?;
        }
        all.extend(compared.score);
    }
    let mean = |pick: fn(&ImageScore) -> f64| all.iter().map(pick).sum::<f64>() / all.len() as f64;
    Ok((!all.is_empty()).then(|| ImageScore {
        psnr: mean(|s| s.psnr),
        psnr_rgb: None,
        ssim: mean(|s| s.ssim),
    }))
}

/// File name, without extension, for the picture of an image: slashes become underscores.
pub fn file_name(name: &str) -> String {
    name.replace(['/', '\\'], "_")
}

/// Display picture of 8 bits of a rendering by `model` or of its reference.
pub fn picture(raster: &Raster, model: &ObjectModel) -> RgbImage {
    picture_of(raster, is_linear(model))
}

/// Display picture of 8 bits of linear or display values, clamped to 0..1; missing values are black.
pub fn picture_of(raster: &Raster, linear: bool) -> RgbImage {
    let byte = |value: f32| {
        let x = if value.is_finite() { value.clamp(0.0, 1.0) } else { 0.0 };
        let shown = if linear { display::encode(x).0 } else { x };
        (shown * 255.0).round() as u8
    };
    RgbImage::from_fn(raster.width as u32, raster.height as u32, |col, row| {
        Rgb([0, 1, 2].map(|k| byte(raster.at(k, col as usize, row as usize))))
    })
}

/// A picture of unit normals, `(n + 1) / 2`; black where there is none.
pub fn normal_picture(normals: &Raster) -> RgbImage {
    RgbImage::from_fn(normals.width as u32, normals.height as u32, |col, row| {
        let n = [0, 1, 2].map(|k| normals.at(k, col as usize, row as usize));
        let byte = |x: f32| (127.5 * (x + 1.0)).round() as u8;
        Rgb(if n == [0.0; 3] { [0; 3] } else { n.map(byte) })
    })
}

/// Sums over the pixels of one part of an object.
#[derive(Default)]
struct PartSums {
    pixels: usize,
    square: f64,
    angle_deg: f64,
    angles: usize,
}

/// By part and over all: the angles between a model's normals and the true ones, degrees, and the PSNR of its pixels.
/// `None` without true parts, which only synthetic captures have.
fn by_part(model: &ObjectModel, capture: &Capture, frames: &[&Frame]) -> Option<Value> {
    let mut sums: BTreeMap<u8, PartSums> = BTreeMap::new();
    for frame in frames {
        let (truth, parts) = capture.true_parts(frame)?;
        let (found, compared) = (model.normals(&model.image_of(frame))?, compare(model, frame)?);
        let size = (found.width as u32, found.height as u32);
        if truth.dimensions() != size || parts.dimensions() != size {
            return None;
        }
        for (col, row, pixel) in truth.enumerate_pixels() {
            let (x, y) = (col as usize, row as usize);
            let part = parts.get_pixel(col, row).0[0];
            if part == 0 {
                continue;
            }
            let sum = sums.entry(part).or_default();
            let apart = |k: usize| f64::from(compared.rendered.at(k, x, y) - compared.truth.at(k, x, y)).powi(2);
            sum.pixels += 1;
            sum.square += (0..3).map(apart).sum::<f64>() / 3.0;
            let exact = Vec3::from(pixel.0.map(|v| f32::from(v) / 127.5 - 1.0));
            let own = Vec3::from([0, 1, 2].map(|k| found.at(k, x, y)));
            if own != Vec3::ZERO && pixel.0 != [0; 3] {
                sum.angle_deg += f64::from(exact.angle_between(own).to_degrees());
                sum.angles += 1;
            }
        }
    }
    let (angle, angles) = sums
        .values()
        .fold((0.0, 0), |(s, c), p| (s + p.angle_deg, c + p.angles));
    let parts: Vec<Value> = sums
        .iter()
        .map(|(part, sum)| {
            json!({
                "part": part, "pixels": sum.pixels, "psnr": psnr_db((sum.square / sum.pixels as f64).max(1e-12), 1.0),
                "normals_deg": sum.angle_deg / sum.angles.max(1) as f64,
            })
        })
        .collect();
    (angles > 0).then(|| json!({"mean_deg": angle / angles as f64, "parts": parts}))
}

/// Content of `metrics.json`: scores on some training images and on all held-out ones. Held-out images and their
/// renderings are written into the folder `pictures`, if given.
///
/// # Errors
/// When a picture cannot be written.
pub fn metrics(model: &ObjectModel, capture: &Capture, pictures: Option<&Path>) -> Result<Value, RasterError> {
    let (train, test): (Vec<&Frame>, Vec<&Frame>) =
        (capture.of(Split::Train).collect(), capture.of(Split::Test).collect());
    let score = |frames: &[&Frame], folder| -> Result<Option<Value>, RasterError> {
        let found = scores(model, frames, folder)?;
        Ok(found.map(|s| json!({"psnr": s.psnr, "ssim": s.ssim, "images": frames.len()})))
    };
    let mut metrics = json!({
        "model": model.model.name(),
        "gaussians": model.parameters.gaussians.count,
        "parts": model.file.kind.parts(),
        "values": if is_linear(model) { Encoding::Linear } else { Encoding::Display },
        "background": model.file.preparation.background,
    });
    let mut add = |at: &str, key: &str, found: Option<Value>| {
        if let (Some(found), Some(place)) = (found, metrics.pointer_mut(at)) {
            place[key] = found;
        }
    };
    add("", "train", score(&at_most(SCORED, train.clone()), None)?);
    add("", "test", score(&test, pictures)?);
    add("/test", "normals", by_part(model, capture, &test));
    if matches!(model.file.kind, Kind::Olat(_)) {
        let is_far = |frame: &&Frame| nearest_light_rad(frame, &train, capture).is_some_and(|angle| angle > FAR_RAD);
        let (far, near): (Vec<&Frame>, Vec<&Frame>) = test.iter().copied().partition(is_far);
        add("/test", "near", score(&near, None)?);
        add("/test", "far", score(&far, None)?);
    }
    Ok(metrics)
}

/// Angle between the light of a frame and the nearest light of others, as the capture's centre sees them, radians.
fn nearest_light_rad(frame: &Frame, others: &[&Frame], capture: &Capture) -> Option<f64> {
    let toward = |frame: &Frame| Some((frame.light?.position - capture.centre).normalize());
    let own = toward(frame)?;
    let angles = others
        .iter()
        .filter_map(|other| Some(own.angle_between(toward(other)?)));
    angles.min_by(f64::total_cmp)
}

/// Summary of `metrics.json` as lines of text.
pub fn summary(metrics: &Value) -> String {
    let number = |path: &str| metrics.pointer(path).and_then(Value::as_f64);
    let values = metrics.get("values").and_then(Value::as_str).unwrap_or("display");
    let mut lines = Vec::new();
    if let Some(count) = number("/gaussians") {
        lines.push(format!("Gaussians      {count}"));
    }
    if let Some(seconds) = number("/seconds") {
        lines.push(format!("seconds        {seconds:.1}"));
    }
    if let Some(psnr) = number("/train/psnr") {
        lines.push(format!("training views PSNR {psnr:.2} dB"));
    }
    if let (Some(psnr), Some(ssim)) = (number("/test/psnr"), number("/test/ssim")) {
        lines.push(format!(
            "held out       PSNR {psnr:.2} dB, SSIM {ssim:.4} ({values} values, whole images)"
        ));
    }
    if let Some(degrees) = number("/test/normals/mean_deg") {
        lines.push(format!(
            "    normals                  {degrees:.1} degrees off in the mean"
        ));
    }
    for (name, at) in [
        ("near lights of training", "/test/near"),
        ("far from them", "/test/far"),
    ] {
        if let (Some(psnr), Some(images)) = (number(&format!("{at}/psnr")), number(&format!("{at}/images"))) {
            lines.push(format!("    {name:<24} PSNR {psnr:.2} dB, {images} images"));
        }
    }
    lines.join("\n")
}
