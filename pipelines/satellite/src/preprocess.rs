//! Stages before training: clouds, pointing, tie points, and the initial surface.

use super::adjust;
use super::altitude;
use super::clouds;
use super::config::{Align, CameraOptions, SatelliteConfig, THRESHOLD_PX};
use super::error::SatelliteError;
use super::ground::GroundViews;
use super::limits::CellCounts;
use super::plan::Decisions;
use heliosplat::Raster;
use heliosplat::timeline::stage;
use heliosplat_radiometry::bridged::{self, Lowered};
use heliosplat_radiometry::change;
use heliosplat_radiometry::suns::{Inversion, ShadowSun};
use heliosplat_scene::{AltitudeSource, ImageSun, Index, IngestOptions, Scene};
use heliosplat_session::Session;
use heliosplat_stereo::change::Changes;
use heliosplat_stereo::{MatchingParameters, PlaneSweepRequest, Surface, SweepView, plane_sweep};
use std::time::Instant;

/// Correction of the pointing above which clouds are searched again, pixels: at this displacement, bright roofs are
/// mistaken for clouds.
const CLOUDS_AGAIN_PX: f32 = 4.0;

/// Results that are computed once before training and stored in its checkpoint.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct Preprocessed {
    /// The swept surface; where the ground changed, that of the last images.
    pub surface: Surface,
    /// Changes of the ground between the images.
    pub changes: Changes,
    /// Parts of the surface that were lowered because they bridged shaded ground; `None` where fewer than two suns are
    /// known.
    pub lowered: Option<Lowered>,
    /// Pointing correction of each training image, columns and rows, pixels.
    pub shifts_px: Vec<[f32; 2]>,
    /// Cloud mask of each crop; empty where there are no clouds.
    pub clouds: Vec<Vec<bool>>,
    /// Sun estimated from shadows for each image of the scene; `None` where the sun is known or there is no estimate.
    pub shadow_suns: Vec<Option<ShadowSun>>,
    /// Seconds spent on alignment, and on the sweep.
    pub seconds: [f64; 2],
}

/// Surface of a scene before training, with the ground and the images that it comes from.
pub(super) struct Preprocess<'a> {
    /// The ground and the images that show it.
    pub(super) ground: GroundViews<'a>,
    /// Results of the stages.
    pub(super) found: Preprocessed,
}

impl<'a> Preprocess<'a> {
    /// Runs the stages before training.
    ///
    /// # Errors
    /// When too few images show the common ground, or one of them has no contrast there.
    pub(super) fn new(
        scene: &'a Scene,
        config: &SatelliteConfig,
        decisions: &Decisions,
        session: &Session,
    ) -> Result<Self, SatelliteError> {
        let started = Instant::now();
        let ground = GroundViews::new(scene, scene.training())?;
        let images = ground.images.len();
        let matching = decisions
            .matching
            .ok_or_else(|| SatelliteError::too_few_views(images))?;
        let request = ground.request(config.start.cell_gsd * scene.gsd_m, matching);
        tracing::debug!(parameters = ?matching, "matching");
        let known = known_corrections(&ground, &config.cameras);
        let is_known = known.is_some();
        let (mut shifts_px, mut left_out) = known.unwrap_or_else(|| (vec![[0.0; 2]; images], Vec::new()));
        let cameras = session.progress("cameras", 1);
        let part = stage("clouds");
        let (mut rasters, mut clouds) = clear_rasters(&ground, decisions, &shifts_px, &request);
        ground.check_contrast(&rasters)?;
        drop(part);
        if !is_known && config.cameras.align != Align::Off {
            let part = stage("ties");
            (shifts_px, left_out) = align(&ground, &rasters, config.cameras.align, matching, scene.gsd_m);
            drop(part);
            if decisions.clouds && shifts_px.iter().flatten().any(|shift| shift.abs() > CLOUDS_AGAIN_PX) {
                let _part = stage("clouds");
                tracing::info!("Searching clouds again with the corrected cameras");
                (rasters, clouds) = clear_rasters(&ground, decisions, &shifts_px, &request);
            }
        }
        clouds::leave_out(&mut rasters, &mut clouds, &left_out);
        clouds::log_shares(&ground, &clouds, &left_out);
        let aligned = started.elapsed();
        drop(cameras);
        let progress = session.progress("sweep", 100);
        let part = stage("sweep");
        let mut surface = sweep(&ground, &rasters, &shifts_px, decisions, &request, &|share| {
            progress.set((100.0 * share) as u64);
        });
        drop(part);
        let part = stage("changes");
        let mut changes = changes(&ground, &rasters, &shifts_px, decisions, &request, &mut surface);
        drop(part);
        let lowered = lower(&ground, &rasters, &shifts_px, &mut surface, &mut changes).inspect(log_lowered);
        for warning in CellCounts::of(&surface, scene).warnings(scene.altitude_range_m) {
            tracing::warn!("{warning}");
        }
        warn_of_inversion(inversion(&ground, &rasters, &shifts_px, &surface));
        let seconds = [aligned.as_secs_f64(), (started.elapsed() - aligned).as_secs_f64()];
        let found = Preprocessed {
            surface,
            changes,
            lowered,
            shifts_px,
            clouds,
            shadow_suns: vec![None; scene.images.len()],
            seconds,
        };
        Ok(Self { ground, found })
    }

    /// Sweeps again under `suns`, one for each image of the ground, if they group the images into other passes; pixel
    /// values within a pass are comparable. Returns true after a sweep.
    pub(super) fn sweep_under(
        &mut self,
        suns: Vec<ImageSun>,
        scene: &Scene,
        config: &SatelliteConfig,
        decisions: &Decisions,
        session: &Session,
    ) -> bool {
        let Some(matching) = decisions.matching else {
            return false;
        };
        if !self.ground.take_suns(suns) {
            return false;
        }
        tracing::info!("Matching the surface again with the suns estimated from shadows");
        let started = Instant::now();
        let request = self.ground.request(config.start.cell_gsd * scene.gsd_m, matching);
        let mut rasters = self.ground.rasters();
        let clouded = rasters.iter_mut().zip(&self.found.clouds);
        clouded.for_each(|(raster, mask)| clouds::blank(raster, mask));
        let found = &mut self.found;
        let shifts_px = &found.shifts_px;
        let _part = stage("sweep");
        let progress = session.progress("sweep again", 100);
        found.surface = sweep(&self.ground, &rasters, shifts_px, decisions, &request, &|share| {
            progress.set((100.0 * share) as u64);
        });
        let surface = &mut found.surface;
        found.changes = changes(&self.ground, &rasters, shifts_px, decisions, &request, surface);
        found.lowered = lower(&self.ground, &rasters, shifts_px, surface, &mut found.changes).inspect(log_lowered);
        found.seconds[1] += started.elapsed().as_secs_f64();
        true
    }

    /// Continues from stored results; `None` where they are of another scene.
    ///
    /// # Errors
    /// When too few images show the common ground.
    pub(super) fn again(scene: &'a Scene, found: Preprocessed) -> Result<Option<Self>, SatelliteError> {
        let ground = GroundViews::new(scene, scene.training())?;
        let images = ground.images.len();
        let mut masks = found.clouds.iter().zip(&ground.crops);
        let fits = found.shifts_px.len() == images
            && found.clouds.len() == images
            && found.shadow_suns.len() == scene.images.len()
            && masks.all(|(mask, crop)| mask.is_empty() || mask.len() == crop.width * crop.height)
            && found.surface.is_whole()
            && [0, found.surface.altitude.len()].contains(&found.changes.label.len())
            && found.changes.before_m.len() == found.changes.label.len();
        Ok(fits.then_some(Self { ground, found }))
    }
}

/// Pixels of the crops of `ground` without clouds, and the cloud masks, if clouds are searched; cameras are moved by
/// `shifts_px`.
pub(super) fn clear_rasters(
    ground: &GroundViews,
    decisions: &Decisions,
    shifts_px: &[[f32; 2]],
    request: &PlaneSweepRequest,
) -> (Vec<Raster>, Vec<Vec<bool>>) {
    let mut rasters = ground.rasters();
    let clouds = match decisions.clouds {
        true => clouds::find(ground, &rasters, shifts_px, request),
        false => vec![Vec::new(); rasters.len()],
    };
    let clouded = rasters.iter_mut().zip(&clouds);
    clouded.for_each(|(raster, mask)| clouds::blank(raster, mask));
    (rasters, clouds)
}

/// Surface from all crops of `ground`, with the cameras moved by `shifts_px`; `progress` receives the completed share,
/// 0..1.
pub(super) fn sweep(
    ground: &GroundViews,
    rasters: &[Raster],
    shifts_px: &[[f32; 2]],
    decisions: &Decisions,
    request: &PlaneSweepRequest,
    progress: &dyn Fn(f32),
) -> Surface {
    let indices = indices(ground, rasters, decisions);
    plane_sweep(&views(ground, rasters, &indices, shifts_px), request, progress)
}

/// Vegetation index of each crop; `None` where the sweep compares none.
fn indices(ground: &GroundViews, rasters: &[Raster], decisions: &Decisions) -> Option<Vec<Raster>> {
    let asked = decisions.vegetation_index.then(|| ground.vegetation_indices(rasters));
    asked.flatten()
}

/// Crops as input of the sweep.
fn views<'r>(
    ground: &GroundViews,
    rasters: &'r [Raster],
    indices: &'r Option<Vec<Raster>>,
    shifts_px: &[[f32; 2]],
) -> Vec<SweepView<'r>> {
    let mut views = ground.sweep_views(rasters, shifts_px);
    for (view, index) in views.iter_mut().zip(indices.iter().flatten()) {
        view.index = Some(index);
    }
    views
}

/// Changes between the images, if they are searched; `surface` becomes that of the last images.
fn changes(
    ground: &GroundViews,
    rasters: &[Raster],
    shifts_px: &[[f32; 2]],
    decisions: &Decisions,
    request: &PlaneSweepRequest,
    surface: &mut Surface,
) -> Changes {
    let Some(days) = ground.days().filter(|_| decisions.change) else {
        return Changes::default();
    };
    let indices = indices(ground, rasters, decisions);
    let begun = Instant::now();
    let changes = change::find(&views(ground, rasters, &indices, shifts_px), &days, request, surface);
    match changes.segments.len() {
        0 => tracing::info!("No changed buildings found"),
        1 => tracing::info!("1 building changed between the images"),
        count => tracing::info!("{count} buildings changed between the images"),
    }
    tracing::debug!("changes took {:.1} s", begun.elapsed().as_secs_f64());
    changes
}

/// Lowers parts of the surface that bridge shaded ground, by the brightness of the crops; `None` where that is
/// impossible, such as with fewer than two known suns.
pub(super) fn lower(
    ground: &GroundViews,
    rasters: &[Raster],
    shifts_px: &[[f32; 2]],
    surface: &mut Surface,
    changes: &mut Changes,
) -> Option<Lowered> {
    bridged::lower(&views(ground, rasters, &None, shifts_px), surface, changes)
}

/// Shadows of the surface on the crops, and those of the surface upside down; `None` without a known sun.
pub(super) fn inversion(
    ground: &GroundViews,
    rasters: &[Raster],
    shifts_px: &[[f32; 2]],
    surface: &Surface,
) -> Option<Inversion> {
    Inversion::of(&views(ground, rasters, &None, shifts_px), surface, &surface.supported())
}

/// Warns of shadows that are those of a surface upside down.
pub(super) fn warn_of_inversion(inversion: Option<Inversion>) {
    tracing::debug!(?inversion, "shadows of the surface and of it upside down");
    if let Some(found) = inversion.filter(Inversion::is_decisive) {
        tracing::warn!(
            "the shadows in the images are those of a surface upside down (correlation {:.2}; of the surface itself {:.2}): check that each \
             image has its own camera and date",
            found.inverted,
            found.upright
        );
    }
}

/// Logs the lowered parts, if there are any.
pub(super) fn log_lowered(lowered: &Lowered) {
    if lowered.parts > 0 {
        tracing::info!(
            "Reopened {} shaded {} ({:.0} m²)",
            lowered.parts,
            if lowered.parts == 1 {
                "courtyard or alley"
            } else {
                "courtyards or alleys"
            },
            lowered.area_m2
        );
    }
}

/// Surface of a scene from all of its views, without training.
///
/// # Errors
/// When too few images show the common ground.
pub fn sweep_only(scene: &Scene, config: &SatelliteConfig, session: &Session) -> Result<Surface, SatelliteError> {
    let decisions = Decisions::of(scene, config);
    Preprocess::new(scene, config, &decisions, session).map(|swept| swept.found.surface)
}

/// A scene, and its surface from all views without training. A range of altitudes from tie points is widened where the
/// surface touches its limits; for a stated range, this is a warning.
///
/// # Errors
/// Those of [`Scene::open`] and [`sweep_only`].
pub fn open_and_sweep(
    index: &Index,
    options: &IngestOptions,
    config: &SatelliteConfig,
    session: &Session,
) -> Result<(Scene, Surface), SatelliteError> {
    let part = stage("read");
    let mut scene = altitude::open(index, options)?;
    for warning in &scene.warnings {
        tracing::warn!("{warning}");
    }
    drop(part);
    let mut surface = sweep_only(&scene, config, session)?;
    for _ in 0..altitude::ROUNDS {
        let wider = CellCounts::of(&surface, &scene).wider(scene.altitude_range_m);
        let Some(range_m) = wider.filter(|_| scene.altitude_known_from == AltitudeSource::Ties) else {
            break;
        };
        tracing::info!(
            "Sweeping again from {:.0} to {:.0} m: the surface touched a limit",
            range_m.0,
            range_m.1
        );
        let options = IngestOptions {
            altitude_from_ties_m: Some(range_m),
            ..options.clone()
        };
        drop(scene);
        let part = stage("read");
        scene = Scene::of(index, &options)?;
        drop(part);
        surface = sweep_only(&scene, config, session)?;
    }
    Ok((scene, surface))
}

/// Pointing correction of each image (columns, rows; pixels), and a flag for each image that is left out because its
/// ties contradict its camera; no flags where no image is left out.
type Corrections = (Vec<[f32; 2]>, Vec<bool>);

/// Corrections in the configuration; `None` if it has none.
fn known_corrections(ground: &GroundViews, cameras: &CameraOptions) -> Option<Corrections> {
    let names = || ground.images.iter().map(|image| &image.name);
    let shift = |name| cameras.shifts_px.get(name).copied().unwrap_or_default();
    let is_known = !(cameras.shifts_px.is_empty() && cameras.left_out.is_empty());
    is_known.then(|| {
        let left_out = names().map(|name| cameras.left_out.contains(name));
        (names().map(shift).collect(), left_out.collect())
    })
}

/// Corrections by the ties of the images, zero where they are small or the ties are too few.
fn align(
    ground: &GroundViews,
    rasters: &[Raster],
    align: Align,
    matching: MatchingParameters,
    gsd_m: f64,
) -> Corrections {
    match adjust::adjustment_of_ties(ground, rasters, matching, gsd_m) {
        Ok(adjustment) => {
            let left_out = adjust::left_out(ground, &adjustment);
            (worth_correcting(adjust::shifts(&adjustment), align), left_out)
        }
        Err(error) => {
            tracing::warn!("Too few tie points to refine the cameras; using them as delivered ({error})");
            (vec![[0.0; 2]; ground.images.len()], Vec::new())
        }
    }
}

/// The shifts, if `align` is on or they are large enough; else none.
pub(super) fn worth_correcting(shifts_px: Vec<[f32; 2]>, align: Align) -> Vec<[f32; 2]> {
    let largest = shifts_px.iter().flatten().fold(0.0f32, |a, &b| a.max(b.abs()));
    tracing::info!("Largest correction of a camera: {largest:.2} px");
    if align == Align::On || largest > THRESHOLD_PX {
        shifts_px
    } else {
        vec![[0.0; 2]; shifts_px.len()]
    }
}
