//! Relit images of a run, compared with truth under suns that no image had.
//!
//! The prediction is the image that `relight` writes: a view from straight above on the run's grid, resampled to the
//! truth's grid by bilinear interpolation. Shadows are traced; no image is used.

use crate::error::SatelliteError;
use heliosplat::Raster;
use heliosplat_evaluate::resample::Placement;
use heliosplat_evaluate::{RelitPair, RelitScore, RelitScores, score_relit};
use heliosplat_fitting::run_folder::create_folder;
use heliosplat_products::model::LoadedModel;
use heliosplat_products::nadir::NadirGrid;
use heliosplat_products::relight::Viewpoint;
use heliosplat_raster::{GeoRaster, preview};
use heliosplat_rpc::sun::SunPosition;
use heliosplat_scene::{RelitTruth, relit_truth};
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;

/// Name of the folder in a run with the pictures.
pub const PICTURES: &str = "relit";

/// Prediction and truth under one sun, on the truth's grid.
struct Compared {
    sun: SunPosition,
    ours: Raster,
    our_shadow: Raster,
    truth: Raster,
    true_shadow: Raster,
}

/// Compares a run's relit images with the truth in `folder`; returns `relit` of `metrics.json`. Draws a picture of each
/// sun into the run's folder.
///
/// # Errors
/// When the truth cannot be read or is of another scene, the model has no light, or a picture cannot be written.
pub fn measure(model: &LoadedModel, folder: &Path, run: &Path) -> Result<Value, SatelliteError> {
    let truths = relit_truth(folder)?;
    let nadir = NadirGrid::new(&model.into(), model.file.gsd_m, None)?;
    let above = Viewpoint::above(model, &nadir);
    let compared = truths
        .iter()
        .map(|truth| compare(model, &above, &nadir, truth))
        .collect::<Result<Vec<_>, _>>()?;
    let pairs: Vec<RelitPair> = compared.iter().map(Compared::pair).collect();
    let scores = score_relit(&pairs).ok_or_else(|| {
        let folder = folder.display();
        SatelliteError::Input(format!(
            "{folder}: under one of its suns no pixel is known to the run; truth for relighting is of the run's ground"
        ))
    })?;
    draw(&compared, &scores, run)?;
    Ok(value(&compared, &scores))
}

impl Compared {
    fn pair(&self) -> RelitPair<'_> {
        RelitPair {
            ours: &self.ours,
            truth: &self.truth,
            our_shadow: &self.our_shadow,
            true_shadow: &self.true_shadow,
        }
    }
}

fn compare(
    model: &LoadedModel,
    above: &Viewpoint,
    nadir: &NadirGrid,
    truth: &RelitTruth,
) -> Result<Compared, SatelliteError> {
    let image = GeoRaster::read(&truth.image)?;
    let (found, expected) = (image.raster.bands, model.file.bands.len());
    if found != expected {
        return Err(SatelliteError::Input(format!(
            "{}: {found} bands, and the run has {expected}; truth for relighting has the bands of the images",
            truth.image.display()
        )));
    }
    let mask = GeoRaster::read(&truth.shadow)?;
    let relit = above.relit(&truth.sun)?;
    let ours = geo(relit.image.clone(), nadir);
    let shadow = geo(relit.shadows(), nadir);
    Ok(Compared {
        sun: truth.sun,
        ours: onto(&ours, &image)?,
        our_shadow: onto(&shadow, &mask)?,
        truth: image.raster,
        true_shadow: mask.raster,
    })
}

fn geo(raster: Raster, nadir: &NadirGrid) -> GeoRaster {
    GeoRaster {
        raster,
        transform: nadir.grid.transform,
        crs: Some(nadir.grid.crs.clone()),
        band_names: Vec::new(),
    }
}

/// All bands of a raster, resampled to another raster's grid.
fn onto(source: &GeoRaster, target: &GeoRaster) -> Result<Raster, SatelliteError> {
    let placement = Placement::new(source, target)?;
    let bands = source.raster.bands;
    Ok(Raster {
        width: target.raster.width,
        height: target.raster.height,
        bands,
        values: (0..bands)
            .flat_map(|band| placement.moved_band(band, 0.0, 0.0).values)
            .collect(),
    })
}

/// Draws truth, prediction after a common gain, and the truth with missing (blue) and false (red) shadows. All suns
/// have one stretch, so pictures get darker with lower suns.
fn draw(compared: &[Compared], scores: &RelitScores, run: &Path) -> Result<(), SatelliteError> {
    let folder = run.join(PICTURES);
    create_folder(&folder)?;
    let ranges = || compared.iter().filter_map(|sun| preview::shown_range(&sun.truth));
    let range = (
        ranges().map(|range| range.0).fold(f32::INFINITY, f32::min),
        ranges().map(|range| range.1).fold(f32::NEG_INFINITY, f32::max),
    );
    for (number, sun) in compared.iter().enumerate() {
        let mut ours = sun.ours.clone();
        for (band, [gain, offset]) in scores.gains.iter().enumerate() {
            for value in ours.plane_mut(band) {
                *value = (gain * f64::from(*value) + offset) as f32;
            }
        }
        let truth = preview::stretched_within(&sun.truth, range);
        let mut wrong = truth.clone();
        let share = |sign: f32| {
            let values = sun.true_shadow.values.iter().zip(&sun.our_shadow.values);
            Raster {
                values: values.map(|(truth, ours)| (sign * (truth - ours)).max(0.0)).collect(),
                ..sun.our_shadow
            }
        };
        preview::overlay(&mut wrong, &share(1.0), [40, 80, 255]);
        preview::overlay(&mut wrong, &share(-1.0), [255, 40, 40]);
        let panels = [truth, preview::stretched_within(&ours, range), wrong];
        preview::write_png(
            &folder.join(format!("sun_{number}.png")),
            &preview::side_by_side(&panels),
        )?;
    }
    Ok(())
}

fn value(compared: &[Compared], scores: &RelitScores) -> Value {
    let suns: Vec<Value> = compared
        .iter()
        .zip(&scores.suns)
        .map(|(compared, score)| {
            let mut out = json!(score);
            let [azimuth, elevation] = compared.sun.degrees();
            out["sun_azimuth_deg"] = json!(azimuth);
            out["sun_elevation_deg"] = json!(elevation);
            out
        })
        .collect();
    let ratios = || scores.suns.iter().map(|sun| sun.brightness_ratio);
    json!({
        "suns": suns,
        "mean": scores.mean,
        "brightness_range": [ratios().fold(f64::INFINITY, f64::min), ratios().fold(f64::NEG_INFINITY, f64::max)],
        "gains": scores.gains,
        "peak": scores.peak,
    })
}

/// `relit` of `metrics.json` as a table in text; empty where there is none.
pub fn table(relit: &Value) -> String {
    let Some(suns) = relit["suns"].as_array() else {
        return String::new();
    };
    let mut text =
        String::from("relit, suns of no image  one gain dB  a gain each dB  brightness  shadow BER  shadow IoU\n");
    let mut line = |name: String, row: &Value| {
        let Ok(score) = serde_json::from_value::<RelitScore>(row.clone()) else {
            return;
        };
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{name:<23}  {:>11.2}  {:>14.2}  {:>10.3}  {:>8.1} %  {:>10.3}",
            score.psnr_one_gain_db,
            score.psnr_own_gain_db,
            score.brightness_ratio,
            100.0 * score.ber,
            score.iou
        );
    };
    for sun in suns {
        let angle = |key: &str| sun[key].as_f64().unwrap_or(f64::NAN);
        line(
            format!(
                "azimuth {:>5.1}, high {:>4.1}",
                angle("sun_azimuth_deg"),
                angle("sun_elevation_deg")
            ),
            sun,
        );
    }
    line("mean".into(), &relit["mean"]);
    text
}
