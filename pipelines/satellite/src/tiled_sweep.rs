//! Plane sweep of a scene that does not fit into memory: tile by tile, into one surface model.
//!
//! The range of altitudes, the matching of views, and the pointing of the cameras are decided once for all tiles, from
//! patches all over the ground. Every tile reads its windows of the images, fits pinhole cameras to them in the frame
//! of the whole scene, and is swept on the cells of the whole. Surface models of tiles are stored on disk until all are
//! complete, and are then blended row by row.

use super::adjust;
use super::altitude::ROUNDS;
use super::clouds;
use super::config::{Align, SatelliteConfig};
use super::error::SatelliteError;
use super::ground::{GroundViews, volume};
use super::limits::CellCounts;
use super::plan::Decisions;
use super::preprocess::{clear_rasters, inversion, log_lowered, lower, sweep, warn_of_inversion, worth_correcting};
use super::sweep_tiles::{ROWS_AT_ONCE, SweepPlan, SweepTile, SweepTiling};
use heliosplat::timeline::stage;
use heliosplat_grid::statistics::upper_median;
use heliosplat_products::blend::Piece;
use heliosplat_products::dsm::{self, StreamedDsm};
use heliosplat_products::nadir::{GroundExtent, NadirGrid};
use heliosplat_products::stored::{StoredPiece, blend_rows};
use heliosplat_radiometry::bridged::Lowered;
use heliosplat_radiometry::suns::Inversion;
use heliosplat_raster::Geoid;
use heliosplat_raster::geoid::GeoidGrid;
use heliosplat_raster::temporary::TemporaryFolder;
use heliosplat_scene::survey::Survey;
use heliosplat_scene::{Area, Scene, SceneError};
use heliosplat_session::Session;
use heliosplat_stereo::change::Changes;
use heliosplat_stereo::{MatchingParameters, PlaneSweepRequest};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// Centres of the patches on which the pointing is estimated, as shares of the ground: one in the middle and one in
/// each quarter.
const PATCHES: [[f64; 2]; 5] = [[0.5, 0.5], [0.25, 0.25], [0.75, 0.75], [0.75, 0.25], [0.25, 0.75]];
/// Largest number of cells along each side of a patch.
const PATCH_CELLS: f64 = 1000.0;

/// Plane sweep in tiles, written to a file.
pub struct TiledSweep<'a> {
    /// Configuration of the run.
    pub config: &'a SatelliteConfig,
    /// Survey of the scene, without pixels.
    pub survey: &'a Survey<'a>,
    /// Plan of the sweep.
    pub plan: &'a SweepPlan,
    /// Tiles of that plan.
    pub tiling: &'a SweepTiling,
    /// Geoid that the heights refer to; `None` for the ellipsoid.
    pub geoid: Option<Geoid>,
}

/// Summary of a tiled sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Written {
    /// Number of tiles that were swept.
    pub tiles: usize,
    /// Share of the map's cells with known altitude, 0..1.
    pub completeness: f64,
    /// Wider range of altitudes, metres above the ellipsoid, where the surface touches a limit of a range from tie
    /// points; `None` otherwise.
    pub wider_m: Option<(f64, f64)>,
}

/// Decisions that apply to all tiles.
struct Decided {
    decisions: Decisions,
    matching: MatchingParameters,
    /// Pointing corrections (columns, rows; pixels) by image name.
    shifts_px: BTreeMap<String, [f32; 2]>,
    /// Names of the images that are left out.
    left_out: Vec<String>,
}

/// Surface of a tile, with its counts.
struct Swept {
    piece: Piece,
    counts: CellCounts,
    lowered: Lowered,
    inversion: Option<Inversion>,
}

impl TiledSweep<'_> {
    /// Sweeps all tiles and writes the surface model to `out`; no incomplete file is left.
    ///
    /// # Errors
    /// When the scene is invalid, too few images show any of it, the file cannot be written, or the user stops it.
    pub fn write(&self, out: &Path, session: &Session) -> Result<Written, SatelliteError> {
        let decided = self.decide()?;
        session.stop_gently();
        let folder = TemporaryFolder::beside(out)?;
        let progress = session.progress("sweep", self.tiling.tiles.len() as u64);
        let mut pieces = Vec::with_capacity(self.tiling.tiles.len());
        let mut counts = CellCounts::default();
        // Cells where tiles overlap are counted twice.
        let mut lowered = Lowered::default();
        let mut inversions = Vec::new();
        let count = self.tiling.tiles.len();
        for (index, tile) in self.tiling.tiles.iter().enumerate() {
            if session.stopped() {
                return Err(SatelliteError::Stopped);
            }
            let begun = Instant::now();
            if let Some(tile) = self.tile(tile, &decided)? {
                counts += tile.counts;
                lowered += tile.lowered;
                inversions.extend(tile.inversion);
                let _part = stage("products");
                pieces.push(StoredPiece::write(
                    tile.piece,
                    folder.path().join(format!("tile-{index}")),
                )?);
            }
            tracing::info!("tile {} of {count}: {:.1} s", index + 1, begun.elapsed().as_secs_f64());
            progress.set(index as u64 + 1);
        }
        if pieces.is_empty() {
            return Err(SatelliteError::too_few_views(0));
        }
        log_lowered(&lowered);
        // The median tile: a lake or a wrong roof is no inverted scene.
        inversions.sort_by(|one, other| one.margin.total_cmp(&other.margin));
        warn_of_inversion(inversions.get(inversions.len() / 2).copied());
        for warning in counts.warnings(self.survey.altitude_range_m) {
            tracing::warn!("{warning}");
        }
        Ok(Written {
            tiles: pieces.len(),
            completeness: self.blended(&pieces, out)?,
            wider_m: counts.wider(self.survey.altitude_range_m),
        })
    }

    /// Blends the tiles into the file; returns the share of the map's cells with known altitude.
    fn blended(&self, pieces: &[StoredPiece], out: &Path) -> Result<f64, SatelliteError> {
        let _part = stage("products");
        let grid = &self.tiling.grid;
        let gsd_m = grid.transform.pixel_size().0 * grid.crs.metres_per_unit();
        let mut file = StreamedDsm::create(out, grid, self.geoid)?;
        let table = self.geoid.map(|geoid| GeoidGrid::new(geoid, grid)).transpose()?;
        let mut known = 0;
        for first in (0..grid.height).step_by(ROWS_AT_ONCE) {
            let rows = first..(first + ROWS_AT_ONCE).min(grid.height);
            let mut raster = blend_rows(pieces, grid.width, rows, gsd_m as f32)?;
            if let Some(table) = &table {
                table.subtract(first, grid.width, raster.plane_mut(0));
            }
            known += raster.plane(0).iter().filter(|z| z.is_finite()).count();
            file.write_rows(first, &raster)?;
        }
        // Without any known cell, no file is written.
        if known > 0 {
            file.finish()?;
        }
        Ok(known as f64 / (grid.width * grid.height).max(1) as f64)
    }

    /// Sweeps a tile; `None` where fewer than two images show it.
    fn tile(&self, tile: &SweepTile, decided: &Decided) -> Result<Option<Swept>, SatelliteError> {
        let Some(scene) = self.open(&tile.area)? else {
            return Ok(None);
        };
        let kept = scene.training().filter(|image| !decided.left_out.contains(&image.name));
        let Ok(ground) = GroundViews::over(&scene, tile.area, kept) else {
            return Ok(None);
        };
        let request = self.request(&ground, decided.matching);
        let shift = |name: &String| decided.shifts_px.get(name).copied().unwrap_or_default();
        let shifts_px: Vec<[f32; 2]> = ground.images.iter().map(|image| shift(&image.name)).collect();
        let part = stage("clouds");
        let (rasters, clouds) = clear_rasters(&ground, &decided.decisions, &shifts_px, &request);
        clouds::log_shares(&ground, &clouds, &[]);
        drop(part);
        let part = stage("sweep");
        let mut surface = sweep(&ground, &rasters, &shifts_px, &decided.decisions, &request, &|_| {});
        let lowered = lower(&ground, &rasters, &shifts_px, &mut surface, &mut Changes::default());
        let inversion = inversion(&ground, &rasters, &shifts_px, &surface);
        drop(part);
        let _part = stage("products");
        let counts = CellCounts::of(&surface, &scene);
        let [columns, rows] = tile.bounds;
        let grid = self
            .tiling
            .grid
            .part((columns[0], rows[0]), (columns[1] - columns[0], rows[1] - rows[0]));
        let place = GroundExtent::from(&scene);
        let dsm = dsm::of_surface_on(NadirGrid::on(&place, grid)?, &place, &surface);
        let signed = |spans: [[usize; 2]; 2]| spans.map(|span| span.map(|at| at as isize));
        let piece = Piece {
            unit: String::new(),
            raster: dsm.raster,
            at: [columns[0] as isize, rows[0] as isize],
            core: signed(tile.core),
            bounds: signed(tile.bounds),
        };
        Ok(Some(Swept {
            piece,
            counts,
            lowered: lowered.unwrap_or_default(),
            inversion,
        }))
    }

    /// Reads the images of a part of the ground; `None` where fewer than two images show it.
    fn open(&self, part: &Area) -> Result<Option<Scene>, SatelliteError> {
        let _part = stage("read");
        let Survey { index, cut, .. } = self.survey;
        let read = cut.part(index, part);
        match read.and_then(|part| Scene::read(index, &part, Vec::new())) {
            Ok(scene) => Ok(Some(scene)),
            Err(SceneError::NotCovered(..)) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// Request for the sweep of a tile. Viewing directions are those at the centre of the whole ground, so that all
    /// tiles have the same height hypotheses.
    fn request(&self, ground: &GroundViews, matching: MatchingParameters) -> PlaneSweepRequest {
        let whole = volume(&self.tiling.whole, ground.up_m, self.plan.cell_m);
        PlaneSweepRequest {
            centre: whole.centre(),
            ..ground.request(self.plan.cell_m, matching)
        }
    }

    /// Decides for all tiles, from patches all over the ground.
    fn decide(&self) -> Result<Decided, SatelliteError> {
        let mut found: Option<(usize, Decisions, MatchingParameters)> = None;
        let mut shifts_by_image: BTreeMap<String, Vec<[f32; 2]>> = BTreeMap::new();
        let mut out_by_image: BTreeMap<String, Vec<String>> = BTreeMap::new();
        let mut refused = SatelliteError::too_few_views(0);
        for area in self.patches() {
            let Some(scene) = self.open(&area)? else { continue };
            let decisions = Decisions::of(&scene, self.config);
            let ground = match GroundViews::over(&scene, area, scene.training()) {
                Ok(ground) => ground,
                Err(error) => {
                    refused = error;
                    continue;
                }
            };
            let Some(matching) = decisions.matching else { continue };
            // The matching is that of the patch with the most images.
            let images = ground.images.len();
            if found.as_ref().is_none_or(|(most, ..)| images > *most) {
                found = Some((images, decisions.clone(), matching));
            }
            if decisions.align == Align::Off {
                break;
            }
            let request = self.request(&ground, matching);
            let part = stage("clouds");
            let (rasters, _) = clear_rasters(&ground, &decisions, &vec![[0.0; 2]; images], &request);
            drop(part);
            let _part = stage("ties");
            match adjust::adjustment_of_ties(&ground, &rasters, matching, self.survey.gsd_m) {
                Ok(adjustment) => {
                    let shifts_px = adjust::shifts(&adjustment);
                    for contradiction in adjust::contradictions(&ground.pixels(), &adjustment) {
                        let name = &ground.images[contradiction.image].name;
                        let messages = out_by_image.entry(name.clone()).or_default();
                        messages.extend(contradiction.is_out.then(|| contradiction.message(name)));
                    }
                    for (image, shift) in ground.images.iter().zip(shifts_px) {
                        shifts_by_image.entry(image.name.clone()).or_default().push(shift);
                    }
                }
                Err(error) => tracing::debug!("no pointing from the ties of a patch: {error}"),
            }
        }
        let Some((_, decisions, matching)) = found else {
            return Err(refused);
        };
        if shifts_by_image.is_empty() && decisions.align != Align::Off {
            tracing::warn!("Too few tie points to refine the cameras; using them as delivered");
        }
        // An image is left out where most of the patches that show it contradict its camera.
        out_by_image.retain(|name, messages| {
            let patches = shifts_by_image.get(name).map_or(0, Vec::len);
            2 * messages.len() > patches
        });
        for message in out_by_image.values().filter_map(|messages| messages.first()) {
            tracing::warn!("{message}");
        }
        let (names, shifts): (Vec<String>, Vec<[f32; 2]>) = shifts_by_image
            .into_iter()
            .map(|(name, shifts)| (name, middle(&shifts)))
            .unzip();
        let shifts = worth_correcting(shifts, decisions.align);
        Ok(Decided {
            shifts_px: names.into_iter().zip(shifts).collect(),
            left_out: out_by_image.into_keys().collect(),
            decisions,
            matching,
        })
    }

    /// Patches on which the pointing is estimated; none is larger than a tile.
    fn patches(&self) -> impl Iterator<Item = Area> {
        let SweepTiling { whole, size, .. } = self.tiling;
        let (wide_m, high_m) = (whole.east_m - whole.west_m, whole.north_m - whole.south_m);
        let half = |length_m: f64, parts: usize| 0.5 * (length_m / parts as f64).min(PATCH_CELLS * self.plan.cell_m);
        let (aside, along) = (half(wide_m, size.1), half(high_m, size.0));
        let whole = *whole;
        PATCHES.into_iter().map(move |[x, y]| {
            let (east, north) = (whole.west_m + x * wide_m, whole.south_m + y * high_m);
            Area::new([east - aside, north - along, east + aside, north + along])
        })
    }
}

/// Median of several shifts along each axis, pixels.
fn middle(shifts: &[[f32; 2]]) -> [f32; 2] {
    [0, 1].map(|axis| {
        let mut values: Vec<f32> = shifts.iter().map(|shift| shift[axis]).collect();
        upper_median(&mut values).unwrap_or(0.0)
    })
}

/// Most times that a range of altitudes from tie points is widened and the ground swept again.
pub const MOST_ROUNDS: usize = ROUNDS;
