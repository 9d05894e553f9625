//! Accuracy of a run: images, shadows and surface compared with the scene's truth.

use super::clouds;
use super::error::SatelliteError;
use super::fit::Fitted;
use super::relit;
use heliosplat::Raster;
use heliosplat::timeline::{concurrently, stage};
use heliosplat_evaluate::change::evaluate_change;
use heliosplat_evaluate::shadow::ShadowCounts;
use heliosplat_evaluate::{DsmEvaluation, ImageScore, Protocol, error_map, evaluate_dsm};
use heliosplat_fitting::run_folder::{RunError, create_folder, peak_rss_bytes};
use heliosplat_products::change::day_of;
use heliosplat_products::dsm::{Dsm, of_surface};
use heliosplat_products::model::{LoadedModel, ModelImage, START};
use heliosplat_products::nadir::NadirGrid;
use heliosplat_products::seen;
use heliosplat_products::views::{RenderedView, render_view, score};
use heliosplat_raster::grid::GridSpec;
use heliosplat_raster::{RasterFile, preview};
use heliosplat_scene::{BandKind, Scene, SceneImage, Split};
use heliosplat_stereo::FEWEST_VIEWS;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;

/// Compares the run's `dsm.tif` with the scene's true surface; includes the share of unknown cells among those visible
/// in the run's images. `None` without truth.
///
/// # Errors
/// When the surface or its truth cannot be read.
pub fn dsm(
    scene: &Scene,
    model: &LoadedModel,
    run: &Path,
    protocol: Protocol,
) -> Result<Option<DsmEvaluation>, SatelliteError> {
    let Some(truth) = &scene.truth.dsm else { return Ok(None) };
    let classes = scene.truth.classes.as_deref();
    let mut evaluation = evaluate_dsm(&run.join("dsm.tif"), truth, classes, protocol)?;
    if let Some(crs) = evaluation.truth.crs.clone() {
        let raster = &evaluation.truth.raster;
        let grid = GridSpec {
            width: raster.width,
            height: raster.height,
            transform: evaluation.truth.transform,
            crs,
        };
        let nadir = NadirGrid::on(&model.into(), grid)?;
        let views = seen::views(&nadir, raster.plane(0), &model.file).views;
        let seen: Vec<bool> = views.iter().map(|&views| views >= FEWEST_VIEWS).collect();
        evaluation.count_seen_unknown(&seen);
    }
    Ok(Some(evaluation))
}

/// Metrics (`metrics.json`) that follow from scene and model; `whole` contains the structures of all days. Draws
/// pictures into the run's folder.
///
/// # Errors
/// When truth cannot be read, or a picture cannot be written.
pub fn metrics(scene: &Scene, whole: &LoadedModel, run: &Path, protocol: Protocol) -> Result<Value, SatelliteError> {
    let model = &whole.on_last();
    let mut out = json!({ "gaussians": model.parameters.gaussians.count, "suns": suns(&model.file.images) });
    let (surface, views) = concurrently(
        || surface(scene, model, run, protocol),
        || views(scene, whole, model, run),
    );
    if let Some(surface) = surface? {
        out["dsm"] = surface;
    }
    let views = views?;
    if !views.train.is_empty() {
        out["train"] = mean(&views.train);
    }
    if !views.test.is_empty() {
        out["test"] = mean(&views.test);
        out["test"]["colour"] = json!(views.colour);
    }
    if let Some(changes) = changes(scene, run, whole)? {
        out["change"] = changes;
    }
    if let Some(score) = views.shadows.score().filter(|_| !scene.truth.shadows.is_empty()) {
        out["shadow"] = serde_json::to_value(score).unwrap_or_default();
        out["shadow"]["traced"] = serde_json::to_value(views.traced.score()).unwrap_or_default();
    }
    if let Some(folder) = scene.truth.relit.as_deref().filter(|_| model.file.has_light()) {
        let _part = stage("relit");
        // Errors in optional truth do not fail a run.
        match relit::measure(model, folder, run) {
            Ok(relit) => out["relit"] = relit,
            Err(error) => tracing::warn!("truth under other suns is left out: {error}"),
        }
    }
    Ok(out)
}

/// Accuracy of the surface; writes its picture and its map of errors. `None` without truth.
fn surface(
    scene: &Scene,
    model: &LoadedModel,
    run: &Path,
    protocol: Protocol,
) -> Result<Option<Value>, SatelliteError> {
    let Some(evaluation) = dsm(scene, model, run, protocol)? else {
        return Ok(None);
    };
    preview::write_png(&run.join("error.png"), &error_map::draw(&evaluation.errors))?;
    error_map::write(&run.join("error.tif"), &evaluation)?;
    Ok(Some(surface_metrics(&evaluation)))
}

/// Scores of all views of a run.
#[derive(Default)]
struct Views {
    train: Vec<ImageScore>,
    test: Vec<ImageScore>,
    /// Source of the colours of held-out images.
    colour: Option<&'static str>,
    shadows: ShadowCounts,
    traced: ShadowCounts,
}

impl Views {
    fn add(&mut self, scores: ViewScores) {
        if let Some(score) = scores.score {
            if scores.held_out {
                self.colour = Some(scores.colour);
                self.test.push(score);
            } else {
                self.train.push(score);
            }
        }
        if let Some([with_image, by_trace]) = scores.shadows {
            self.shadows.add(with_image);
            self.traced.add(by_trace);
        }
    }
}

/// Renders, scores and draws the views of the `whole` model; `model` is its state on the last day.
fn views(scene: &Scene, whole: &LoadedModel, model: &LoadedModel, run: &Path) -> Result<Views, SatelliteError> {
    let mut out = Views::default();
    let rgb = colours_among(&model.file.bands);
    let render = |known| -> Option<(View, RenderedView)> {
        let view = View::of(scene, known)?;
        let of_day = (view.known.time)
            .filter(|_| !whole.model.options.days.is_empty())
            .map(|time| whole.on(day_of(time)));
        let rendered = render_view(of_day.as_ref().unwrap_or(model), view.known, Some(&view.truth));
        Some((view, rendered))
    };
    let measure = |(view, rendered): (View, RenderedView)| view.measure(scene, &rendered, rgb, run);
    let mut waiting: Option<(View, RenderedView)> = None;
    // While one view is rendered on nearly all threads, the previous view is scored and drawn.
    for known in &model.file.images {
        let before = waiting.take();
        let (scores, rendered) = concurrently(
            || before.map(measure).transpose(),
            || {
                let _part = stage("render");
                render(known)
            },
        );
        scores?.into_iter().for_each(|scores| out.add(scores));
        waiting = rendered;
    }
    if let Some(scores) = waiting.map(measure) {
        out.add(scores?);
    }
    Ok(out)
}

/// Changes found by the run, compared with the truth if there is one; `None` where no changes were searched.
fn changes(scene: &Scene, run: &Path, whole: &LoadedModel) -> Result<Option<Value>, SatelliteError> {
    let Some(changes) = &whole.file.changes else {
        return Ok(None);
    };
    let mut out = json!({
        "segments": changes.segments.len(),
        "area_m2": changes.segments.iter().fold(0.0, |sum, segment| sum + segment.area_m2),
    });
    let found = run.join("change.tif");
    if let Some(truth) = scene.truth.changes().filter(|_| found.is_file()) {
        let score = evaluate_change(&found, &truth)?;
        out["truth"] = serde_json::to_value(score).unwrap_or_default();
    }
    if let Some(before) = scene.truth.before() {
        let first = whole.model.options.days.iter().copied().fold(f32::MAX, f32::min);
        let first = whole.on(first as i32);
        let path = run.join("dsm_before.tif");
        heliosplat_products::dsm::dsm(&first, first.file.gsd_m, None)?.write(&path)?;
        let evaluation = evaluate_dsm(&path, &before, None, Protocol::Raw)?;
        out["dsm_before"] = surface_metrics(&evaluation);
    }
    Ok(Some(out))
}

/// Image of a run with its pixels.
struct View<'a> {
    known: &'a ModelImage,
    image: &'a SceneImage,
    truth: Arc<Raster>,
}

/// Scores of a view.
struct ViewScores {
    held_out: bool,
    score: Option<ImageScore>,
    /// Source of the view's colours.
    colour: &'static str,
    /// Shadows compared with the true mask, first with the colours of the image, then as traced; `None` without a mask
    /// and for held-out images.
    shadows: Option<[ShadowCounts; 2]>,
}

impl<'a> View<'a> {
    /// Image of the same name as `known`; `None` where the scene no longer contains it.
    fn of(scene: &'a Scene, known: &'a ModelImage) -> Option<Self> {
        let image = scene.images.iter().find(|i| i.name == known.name)?;
        let truth = known.crop.shared(&image.pixels);
        Some(Self { known, image, truth })
    }

    /// Scores the view and draws it into the run's folder.
    fn measure(
        &self,
        scene: &Scene,
        rendered: &RenderedView,
        rgb: Option<[usize; 3]>,
        run: &Path,
    ) -> Result<ViewScores, SatelliteError> {
        let Self { known, image, truth } = self;
        let held_out = known.split == Split::Test;
        let mask = match scene.truth.shadows.iter().find(|(name, _)| *name == known.name) {
            Some((_, path)) => Some(known.crop.cut(&RasterFile::open(path)?.read(image.window, &[0])?)),
            None => None,
        };
        let counts = |mask: &Raster| [&rendered.visibility, &rendered.traced].map(|lit| ShadowCounts::of(lit, mask));
        draw(run, known, truth, rendered, mask.as_ref())?;
        Ok(ViewScores {
            held_out,
            score: score(rendered, truth, rgb),
            colour: rendered.colour.text(),
            shadows: mask.as_ref().filter(|_| !held_out).map(counts),
        })
    }
}

/// Suns of the images (degrees) with standard deviation and source; null for an unknown sun.
fn suns(images: &[ModelImage]) -> Value {
    let sun = |image: &ModelImage| {
        let [azimuth_deg, elevation_deg] = image.sun.map_or([None; 2], |sun| sun.degrees().map(Some));
        json!({
            "image": image.name,
            "azimuth_deg": azimuth_deg,
            "elevation_deg": elevation_deg,
            "sigma_deg": image.sun_sigma_deg,
            "source": image.sun_source,
        })
    };
    images.iter().map(sun).collect()
}

/// Indices of red, green and blue; `None` where there are no other bands besides.
fn colours_among(bands: &[BandKind]) -> Option<[usize; 3]> {
    let place = |kind: BandKind| bands.iter().position(|&band| band == kind);
    let rgb = [place(BandKind::Red)?, place(BandKind::Green)?, place(BandKind::Blue)?];
    (bands.len() > rgb.len()).then_some(rgb)
}

/// Mean of the scores of some images.
fn mean(scores: &[ImageScore]) -> Value {
    let mean = |pick: &dyn Fn(&ImageScore) -> f64| scores.iter().map(pick).sum::<f64>() / scores.len().max(1) as f64;
    let mut out = json!({"psnr": mean(&|s| s.psnr), "ssim": mean(&|s| s.ssim)});
    if scores.iter().all(|s| s.psnr_rgb.is_some()) {
        out["psnr_rgb"] = json!(mean(&|s| s.psnr_rgb.unwrap_or(f64::NAN)));
    }
    out
}

/// Draws the image and its rendering side by side; under a known sun also the shadows over the image, and with a true
/// mask the wrong shadows: blue for missing ones, red for false ones.
fn draw(
    run: &Path,
    known: &ModelImage,
    truth: &Raster,
    rendered: &RenderedView,
    mask: Option<&Raster>,
) -> Result<(), RunError> {
    let folder = run.join("views");
    create_folder(&folder)?;
    let left = preview::stretched(truth);
    let mut panels = vec![left.clone(), preview::stretched(&rendered.image)];
    if known.sun.is_some() {
        let (blue, red) = ([40, 80, 255], [255, 40, 40]);
        let share = |of: &dyn Fn(usize) -> f32| {
            let mut share = rendered.visibility.clone();
            share.values.iter_mut().enumerate().for_each(|(i, v)| *v = of(i));
            share
        };
        let shadow = |i: usize| 1.0 - rendered.visibility.values[i];
        let mut shadows = left.clone();
        preview::overlay(&mut shadows, &share(&shadow), blue);
        panels.push(shadows);
        if let Some(mask) = mask {
            let missing = |i: usize| mask.values[i] - shadow(i);
            let mut wrong = left;
            preview::overlay(&mut wrong, &share(&|i| missing(i).max(0.0)), blue);
            preview::overlay(&mut wrong, &share(&|i| (-missing(i)).max(0.0)), red);
            panels.push(wrong);
        }
    }
    let path = folder.join(format!("{}.png", known.name));
    Ok(preview::write_png(&path, &preview::side_by_side(&panels))?)
}

/// Writes the surface that training started from; it later provides the sweep's standard deviations for the model's
/// surface.
pub(super) fn write_start(run: &Path, fitted: &Fitted, model: &LoadedModel) -> Result<Dsm, SatelliteError> {
    let start = of_surface(&model.into(), &fitted.found.surface, model.file.gsd_m, None)?;
    start.write(&run.join(START))?;
    Ok(start)
}

/// Draws the surface that training started from; returns its error, or null without truth.
pub(super) fn start_metrics(scene: &Scene, run: &Path, start: &Dsm, gsd_m: f64) -> Result<Value, SatelliteError> {
    preview::write_png(&run.join("start.png"), &preview::hillshade(&start.altitude(), gsd_m))?;
    let Some(truth) = &scene.truth.dsm else {
        return Ok(Value::Null);
    };
    let evaluation = evaluate_dsm(&run.join(START), truth, scene.truth.classes.as_deref(), Protocol::Raw)?;
    Ok(surface_metrics(&evaluation))
}

/// Metrics of an evaluation, with the absolute errors at the quantiles 0 %, 5 % … 100 % of the cells, metres.
pub fn surface_metrics(evaluation: &DsmEvaluation) -> Value {
    const PARTS: usize = 20;
    let mut out = serde_json::to_value(&evaluation.metrics).unwrap_or_default();
    let finite = evaluation.errors.values.iter().filter(|v| v.is_finite());
    let mut errors: Vec<f32> = finite.map(|v| v.abs()).collect();
    errors.sort_unstable_by(f32::total_cmp);
    if let Some(last) = errors.len().checked_sub(1) {
        let quantiles: Vec<f32> = (0..=PARTS).map(|part| errors[last * part / PARTS]).collect();
        out["error_quantiles_m"] = json!(quantiles);
    }
    out
}

/// Adds the metrics of the fit; `seconds` is the duration of the run.
pub(super) fn add_fit(metrics: &mut Value, fitted: &Fitted, model: &LoadedModel, seconds: f64) {
    let Fitted { trained, found, .. } = fitted;
    let ([align, sweep], [start, train]) = (found.seconds, fitted.seconds);
    let clouded: Vec<f64> = found.clouds.iter().map(|mask| clouds::share(mask)).collect();
    metrics["seconds"] = json!(seconds);
    metrics["stages_s"] = json!({
        "align": align,
        "sweep": sweep,
        "start": start,
        "train": train,
    });
    metrics["device"] = json!(trained.device);
    metrics["iterations"] = json!(trained.early_stop.steps);
    metrics["best_iteration"] = json!(trained.early_stop.best_step);
    metrics["rejected_steps"] = json!(trained.rejected);
    metrics["gaussians"] = json!(model.parameters.gaussians.count);
    metrics["peak_rss_bytes"] = json!(peak_rss_bytes());
    metrics["memory_estimate_bytes"] = json!(fitted.memory_estimate);
    metrics["shifts_px"] = json!(found.shifts_px);
    metrics["clouded"] = json!(clouded);
    if let Some(lowered) = found.lowered {
        metrics["lowered"] = json!(lowered);
    }
    metrics["plan"] = json!(fitted.decisions.items);
    metrics["curve"] = json!(trained.curve);
}

/// Main figures of a run, one line each.
pub fn summary(metrics: &Value) -> String {
    [accuracy(metrics), engine(metrics)].concat().join("\n")
}

/// Accuracy of a run against the truth of its scene, one line for each metric in `metrics`.
pub fn accuracy(metrics: &Value) -> Vec<String> {
    let protocol = metrics
        .pointer("/dsm/protocol")
        .and_then(Value::as_str)
        .unwrap_or("raw");
    // The surfaces before and after training know other cells.
    let of_truth = |place: &str| {
        let share = metrics.pointer(place).and_then(Value::as_f64);
        share.map_or(String::new(), |share| format!(", {:.1} % of the truth", 100.0 * share))
    };
    let start = format!(
        "m (raw, plane sweep before training{})",
        of_truth("/start/completeness")
    );
    let [all, ground, middle] = [
        format!("m ({protocol}{})", of_truth("/dsm/completeness")),
        format!("m ({protocol}, ground, roads and buildings)"),
        format!("m ({protocol})"),
    ];
    lines_of(
        metrics,
        &[
            (
                "rejected steps",
                "/rejected_steps",
                1.0,
                "(numbers that were not finite)",
            ),
            ("start MAE", "/start/mae_m", 1.0, &start),
            ("DSM MAE", "/dsm/mae_m", 1.0, &all),
            ("DSM MAE", "/dsm/ground_and_buildings/mae_m", 1.0, &ground),
            ("DSM median", "/dsm/median_m", 1.0, &middle),
            ("shadow masks", "/shadow/accuracy", 100.0, "% right"),
            ("... BER", "/shadow/ber", 100.0, "% (balanced error)"),
            (
                "... traced BER",
                "/shadow/traced/ber",
                100.0,
                "% (balanced error from geometry alone)",
            ),
            (
                "reopened",
                "/lowered/area_m2",
                1.0,
                "m² of shaded courtyards and alleys",
            ),
            ("buildings", "/change/segments", 1.0, "changed between the images"),
            (
                "... precision",
                "/change/truth/precision",
                100.0,
                "% of the changed area found",
            ),
            ("... recall", "/change/truth/recall", 100.0, "% of the changed area"),
            (
                "DSM MAE",
                "/change/dsm_before/mae_m",
                1.0,
                "m (raw, at the first image)",
            ),
            (
                "relit PSNR",
                "/relit/mean/psnr_one_gain_db",
                1.0,
                "dB (suns of no image, one gain for all)",
            ),
            (
                "relit PSNR",
                "/relit/mean/psnr_own_gain_db",
                1.0,
                "dB (a gain for each sun)",
            ),
            ("relit BER", "/relit/mean/ber", 100.0, "% (traced)"),
        ],
    )
}

/// JSON pointers of counts and areas that are omitted where they are zero.
const SHOWN_ABOVE_ZERO: [&str; 3] = ["/rejected_steps", "/lowered/area_m2", "/change/segments"];

/// One line for each figure in `metrics`; a row is label, JSON pointer, factor and unit.
fn lines_of(metrics: &Value, rows: &[(&str, &str, f64, &str)]) -> Vec<String> {
    let line = |&(label, place, factor, unit): &(&str, &str, f64, &str)| {
        let value = metrics.pointer(place)?;
        let number = value.as_f64()?;
        let shown = number > 0.0 || !SHOWN_ABOVE_ZERO.contains(&place);
        let digits = match value.is_u64() {
            true => 0,
            false if factor == 100.0 => 1,
            false => 3,
        };
        shown.then(|| format!("{label:<14} {:.digits$} {unit}", factor * number))
    };
    rows.iter().filter_map(line).collect()
}

/// Image quality, time and memory of a run, one line for each metric in `metrics`.
pub fn engine(metrics: &Value) -> Vec<String> {
    let colour = metrics.pointer("/test/colour").and_then(Value::as_str).unwrap_or("");
    let mut lines = lines_of(
        metrics,
        &[
            ("PSNR train", "/train/psnr", 1.0, "dB"),
            ("PSNR held out", "/test/psnr", 1.0, &format!("dB (colour {colour})")),
            ("PSNR held out", "/test/psnr_rgb", 1.0, "dB (red, green, blue alone)"),
            ("time", "/seconds", 1.0, "s"),
            ("memory", "/peak_rss_bytes", 1.0 / f64::from(1 << 20), "MiB at most"),
        ],
    );
    lines.extend(
        metrics["gaussians"]
            .as_u64()
            .map(|count| format!("{:<14} {count}", "Gaussians")),
    );
    lines
}
