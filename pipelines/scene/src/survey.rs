//! What is known of a scene without reading a pixel of it: enough to cut it into tiles.

use super::area::window_over;
use super::draft::{Draft, image_window};
use super::drafts;
use super::footprint::Footprint;
use super::ground::{self, Ground};

use super::{Area, AreaRequest, IngestOptions, SceneError, Split, Truth, altitude, files, layout, sidecars, truth};
use heliosplat_raster::{Window, is_virtual};
use heliosplat_rpc::{ImageWindow, LocalFrame, PinholeFit, Rpc};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// A scene whose files are open and whose pixels are not read.
pub struct Survey {
    ground: Ground,
    /// Corners of the training images on the ground.
    footprints: Vec<Footprint>,
    /// Lowest and highest ellipsoidal altitude the surface may have, metres.
    pub altitude_range_m: (f64, f64),
    /// Largest base-to-height ratio of two training images in their middles, metres of relative parallax per metre of altitude.
    pub widest_base_to_height: f64,
    /// Nominal ground sampling distance, metres, as that of [`super::Scene`].
    pub gsd_m: f64,
    /// Number of bands of every image.
    pub bands: usize,
    /// All files that say something about the scene.
    pub files: Vec<PathBuf>,
    /// Truth, where the scene brings it.
    pub truth: Truth,
    /// Things a user should know that its files say, one line each.
    pub warnings: Vec<String>,
}

/// What opening a part of a scene reads ([`super::Scene::open_part`]).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PartSurvey {
    /// Training images that show some of it.
    pub images: usize,
    /// Pixels of their windows together.
    pub pixels: f64,
    /// Pixels of the largest window.
    pub largest: f64,
}

/// What a tile of a scene takes.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TileSurvey {
    /// Its ground in a local frame at its middle, metres.
    pub area: Area,
    /// Images that show some of it.
    pub images: usize,
    /// Those of them that are trained on.
    pub training: usize,
    /// Share of it that at least two training images show.
    pub covered: f64,
    /// Largest residual of the pinhole cameras, pixels.
    pub residual_px: f64,
    /// Pixels of all windows together.
    pub pixels: f64,
}

impl Survey {
    /// Opens the files of a scene; its area is what `options` say, or all of it.
    ///
    /// # Errors
    /// As [`super::Scene::open`].
    pub fn open(path: &Path, options: &IngestOptions) -> Result<Self, SceneError> {
        let mut layout = layout::find(path)?;
        let mut warnings = std::mem::take(&mut layout.warnings);
        let drafts = drafts::read_all(&layout, options, &mut warnings)?;
        drafts::check_bands(&drafts)?;
        let stated: Vec<altitude::Stated> = drafts.iter().map(Draft::stated_altitude).collect();
        let said = altitude::Said::of(options, layout.altitude_range_m);
        let altitude_range_m = altitude::choose(said, &stated, &mut warnings)?.limits_m();
        let files = files_of(path, &layout, &drafts);
        let bands = drafts.first().map_or(0, |draft| draft.plan.kinds.len());
        let ground = Ground::find(path, drafts, altitude_range_m, options.area.as_ref(), &mut warnings)?;
        truth::keep_if_here(&mut layout.truth, ground.frame(), ground.area(), &mut warnings);
        let height_m = ground.frame().origin.height_m;
        let widest_base_to_height = widest_base_to_height(&ground, altitude_range_m)?;
        let mut gsds = Vec::new();
        for draft in ground.drafts().iter().filter(|draft| is_training(draft)) {
            gsds.push(draft.gsd_m(ground.frame(), height_m)?);
        }
        Ok(Self {
            footprints: ground::training_footprints(ground.drafts(), ground.frame(), height_m)?,
            altitude_range_m,
            widest_base_to_height,
            gsd_m: ground::nominal_gsd_m(gsds),
            bands,
            files,
            truth: layout.truth,
            warnings,
            ground,
        })
    }

    /// Pixels that [`super::Scene::open`] will read, of all images together.
    pub fn pixels(&self) -> f64 {
        let windows = self.ground.drafts().iter().map(|draft| &draft.window);
        windows.map(|window| window.width as f64 * window.height as f64).sum()
    }

    /// Images, and those of them that are trained on.
    pub fn images(&self) -> (usize, usize) {
        let drafts = self.ground.drafts();
        (drafts.len(), drafts.iter().filter(|draft| is_training(draft)).count())
    }

    /// What opening a part of the ground, a rectangle in metres of the survey's frame, reads.
    pub fn part(&self, part: &Area) -> PartSurvey {
        let mut found = PartSurvey::default();
        for draft in self.ground.drafts().iter().filter(|draft| is_training(draft)) {
            if let Some(window) = window_over(draft, self.frame(), part, self.altitude_range_m) {
                let pixels = window.width as f64 * window.height as f64;
                found.images += 1;
                found.pixels += pixels;
                found.largest = found.largest.max(pixels);
            }
        }
        found
    }

    /// Pixels of the largest window that [`super::Scene::open`] will read.
    pub fn largest_image(&self) -> f64 {
        let windows = self.ground.drafts().iter().map(|draft| &draft.window);
        let pixels = windows.map(|window| window.width as f64 * window.height as f64);
        pixels.fold(0.0, f64::max)
    }

    /// The frame at its middle.
    pub fn frame(&self) -> &LocalFrame {
        self.ground.frame()
    }

    /// Its ground, metres of that frame.
    pub fn area(&self) -> &Area {
        self.ground.area()
    }

    /// What a tile takes; `None` where two training images do not show it.
    ///
    /// # Errors
    /// When its coordinates cannot be transformed, or a camera does not see it.
    pub fn tile(&self, wanted: &AreaRequest) -> Result<Option<TileSurvey>, SceneError> {
        let height_m = self.frame().origin.height_m;
        let frame = LocalFrame::new(wanted.place(height_m)?);
        let area = wanted.area(&frame)?;
        let covered = self.covered(&wanted.area(self.frame())?);
        let seen: Vec<(&Draft, Window)> = self
            .ground
            .drafts()
            .iter()
            .filter_map(|draft| Some((draft, window_over(draft, &frame, &area, self.altitude_range_m)?)))
            .collect();
        let training = seen.iter().filter(|(draft, _)| is_training(draft)).count();
        if training < 2 || covered <= 0.0 {
            return Ok(None);
        }
        let pixels = seen
            .iter()
            .map(|(_, window)| window.width as f64 * window.height as f64)
            .sum();
        let cameras: Vec<(&Rpc, ImageWindow)> = seen.iter().map(|(d, w)| (&d.rpc, image_window(w))).collect();
        // Open GDAL files cannot be shared between threads.
        let altitude_range_m = self.altitude_range_m;
        let fits: Vec<_> = cameras
            .par_iter()
            .map(|(rpc, window)| PinholeFit::fit(rpc, &frame, *window, altitude_range_m))
            .collect();
        let mut residual_px = 0.0f64;
        for (fit, (draft, _)) in fits.into_iter().zip(&seen) {
            let fit = fit.map_err(|source| draft.camera_fault(height_m, source))?;
            residual_px = residual_px.max(fit.max_px);
        }
        Ok(Some(TileSurvey {
            area,
            images: seen.len(),
            training,
            covered,
            residual_px,
            pixels,
        }))
    }

    /// Share of an area that at least two training images show, counted on a grid.
    fn covered(&self, area: &Area) -> f64 {
        const STEPS: usize = 24;
        let mut count = 0;
        for i in 0..STEPS * STEPS {
            let along = |low: f64, high: f64, index: usize| low + (high - low) * (index as f64 + 0.5) / STEPS as f64;
            let x = along(area.west_m, area.east_m, i % STEPS);
            let y = along(area.south_m, area.north_m, i / STEPS);
            let showing = self.footprints.iter().filter(|footprint| footprint.contains([x, y]));
            count += usize::from(showing.take(2).count() == 2);
        }
        count as f64 / (STEPS * STEPS) as f64
    }
}

fn widest_base_to_height(ground: &Ground, (low_m, high_m): (f64, f64)) -> Result<f64, SceneError> {
    let mut parallaxes = Vec::new();
    for draft in ground.drafts().iter().filter(|draft| is_training(draft)) {
        let (width, height) = draft.file.size();
        let at = |height_m| {
            let place = draft.localise(width as f64 / 2.0, height as f64 / 2.0, height_m)?;
            Ok::<_, SceneError>(ground.frame().enu_from_geo(place))
        };
        let apart = at(high_m)? - at(low_m)?;
        parallaxes.push([apart.x / apart.z, apart.y / apart.z]);
    }
    let mut widest = 0.0f64;
    for (index, [x, y]) in parallaxes.iter().enumerate() {
        for [other_x, other_y] in &parallaxes[index + 1..] {
            widest = widest.max((x - other_x).hypot(y - other_y));
        }
    }
    Ok(widest)
}

fn is_training(draft: &Draft) -> bool {
    draft.entry.split == Split::Train
}

/// The images, what was said about them, and what lies beside them under their names.
fn files_of(path: &Path, layout: &layout::Layout, drafts: &[Draft]) -> Vec<PathBuf> {
    let mut files = BTreeSet::new();
    for name in ["scene.toml", "train.txt", "test.txt"] {
        files.insert(path.join(name));
    }
    files.insert(path.to_owned());
    for draft in drafts {
        let image = &draft.entry.path;
        files.insert(image.clone());
        if let Some(json) = &draft.entry.json {
            files.insert(json.clone());
            // The lists of a split lie beside the cameras where images have a folder of their own.
            files.extend(["train.txt", "test.txt"].map(|name| json.with_file_name(name)));
        }
        if let Some(said) = &draft.entry.said {
            files.extend([&said.rpc, &said.metadata].into_iter().flatten().cloned());
        }
        files.extend(beside(image));
        files.extend(sidecars::belonging_texts(image).unwrap_or_default());
        for other in draft.file.others() {
            files.insert(other.clone());
            files.extend(beside(other));
        }
    }
    let truth = &layout.truth;
    files.extend([&truth.dsm, &truth.classes].into_iter().flatten().cloned());
    files.extend(truth.dsm.iter().map(|dsm| dsm.with_extension("txt")));
    files.extend(truth.shadows.iter().map(|(_, path)| path.clone()));
    files.into_iter().filter(|file| !file.is_dir()).collect()
}

/// Files in an image's folder whose names begin as its own.
fn beside(image: &Path) -> Vec<PathBuf> {
    if is_virtual(image) {
        return Vec::new();
    }
    let folder = image.parent().unwrap_or_else(|| Path::new("."));
    let stem = files::stem(image);
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .filter(|entry| entry.file_name().to_string_lossy().contains(&stem))
        .map(|entry| entry.path())
        .collect()
}
