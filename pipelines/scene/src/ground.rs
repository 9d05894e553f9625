//! The ground images share, and the scene made of those that share some.

use super::area::{AreaRequest, window_over};
use super::draft::Draft;
use super::footprint::{self, Footprint};
use super::layout::Layout;
use super::manifest::Counts;
use super::{
    AltitudeRange, Area, ImageSun, Scene, SceneError, SceneImage, Split, Values, acquisition, pixels, values,
    weak_times,
};
use heliosplat::Raster;
use heliosplat_raster::Window;
use heliosplat_rpc::statistics::upper_median;
use heliosplat_rpc::{ImageWindow, LocalFrame, PinholeFit, Rpc};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::path::Path;

/// Images that overlap, and the ground they share.
pub(super) struct Ground {
    drafts: Vec<Draft>,
    frame: LocalFrame,
    area: Area,
    /// Whether it is a part of what the scene's images share: one of them may have no pixels there.
    is_part: bool,
}

/// Share of an image's pixels below which a window of it is read instead of all of it.
const WORTH_READING_LESS: f64 = 0.75;
/// An overlap smaller than this many pixels on a side is none.
const LEAST_OVERLAP_PX: f64 = 16.0;

impl Ground {
    pub(super) fn find(
        source: &Path,
        drafts: Vec<Draft>,
        altitude_range_m: (f64, f64),
        wanted: Option<&AreaRequest>,
        warnings: &mut Vec<String>,
    ) -> Result<Self, SceneError> {
        let count = drafts.iter().filter(|draft| draft.entry.split == Split::Train).count();
        if count < 2 {
            return Err(SceneError::TooFewViews {
                path: source.to_owned(),
                count,
            });
        }
        let altitude_m = (altitude_range_m.0 + altitude_range_m.1) / 2.0;
        // Any frame near the scene will do to find out where its centre is.
        let (width, height) = drafts[0].file.size();
        let near = drafts[0].localise(width as f64 / 2.0, height as f64 / 2.0, altitude_m)?;
        let near = LocalFrame::new(near);
        let drafts = drop_non_overlapping(drafts, &near, altitude_m, warnings)?;
        let footprints = training_footprints(&drafts, &near, altitude_m)?;
        let centre = footprint::common(&footprints).centre();
        let wanted_near = wanted.map(|wanted| wanted.place(near.origin.height_m)).transpose()?;
        let centre = match (centre, footprint::covered_twice(&footprints, 0.0)) {
            (Some(centre), _) => centre,
            (None, Some(area)) => [(area.west_m + area.east_m) / 2.0, (area.south_m + area.north_m) / 2.0],
            (None, None) => [0.0; 2],
        };
        let mut origin = match wanted_near {
            Some(middle) => middle,
            None => near.geo_from_enu(Vector3::new(centre[0], centre[1], 0.0)),
        };
        origin.height_m = altitude_m;
        let frame = LocalFrame::new(origin);
        let footprints = training_footprints(&drafts, &frame, altitude_m)?;
        let least_m2 = LEAST_OVERLAP_PX.powi(2) * drafts[0].gsd_m(&frame, altitude_m)?.powi(2);
        let area = footprint::covered_twice(&footprints, least_m2).ok_or_else(|| SceneError::NoOverlap {
            first: drafts[0].file.path().to_owned(),
            second: drafts[drafts.len() - 1].file.path().to_owned(),
            altitude_m,
        })?;
        let mut ground = Self {
            drafts,
            frame,
            area,
            is_part: false,
        };
        match wanted {
            Some(wanted) => ground.limit(wanted, source, altitude_range_m, warnings)?,
            None => ground.leave_out(altitude_range_m),
        }
        Ok(ground)
    }

    /// Leaves out of the images what lies beyond the ground, where that is a good part of them.
    fn leave_out(&mut self, altitude_range_m: (f64, f64)) {
        for draft in &mut self.drafts {
            let size = |window: &Window| window.width as f64 * window.height as f64;
            if let Some(window) = window_over(draft, &self.frame, &self.area, altitude_range_m)
                && size(&window) < WORTH_READING_LESS * size(&draft.window)
            {
                draft.window = window;
            }
        }
    }

    /// Leaves of the ground what is wanted, and of the images what shows it.
    fn limit(
        &mut self,
        wanted: &AreaRequest,
        source: &Path,
        altitude_range_m: (f64, f64),
        warnings: &mut Vec<String>,
    ) -> Result<(), SceneError> {
        let Some(area) = wanted.area(&self.frame)?.intersection(&self.area) else {
            return Err(SceneError::NotCovered {
                path: source.to_owned(),
                area: wanted.to_string(),
            });
        };
        self.area = area;
        for draft in self.keep_showing(altitude_range_m) {
            warnings.push(format!(
                "{}: does not show the area, left out",
                draft.file.path().display()
            ));
        }
        self.must_be_shown_twice(source, || wanted.to_string())
    }

    /// Leaves `part` of the ground (metres of its frame), and of the training images what shows it.
    pub(super) fn cut(&mut self, part: &Area, source: &Path, altitude_range_m: (f64, f64)) -> Result<(), SceneError> {
        self.area = *part;
        self.drafts.retain(|draft| draft.entry.split == Split::Train);
        self.keep_showing(altitude_range_m);
        self.is_part = true;
        self.must_be_shown_twice(source, || part.to_string())
    }

    /// Limits every image to the window that shows the ground; returns those that show none of it, which are left out.
    fn keep_showing(&mut self, altitude_range_m: (f64, f64)) -> Vec<Draft> {
        let (mut kept, mut left_out) = (Vec::with_capacity(self.drafts.len()), Vec::new());
        for mut draft in std::mem::take(&mut self.drafts) {
            match window_over(&draft, &self.frame, &self.area, altitude_range_m) {
                Some(window) => {
                    draft.window = window;
                    kept.push(draft);
                }
                None => left_out.push(draft),
            }
        }
        self.drafts = kept;
        left_out
    }

    fn must_be_shown_twice(&self, source: &Path, area: impl Fn() -> String) -> Result<(), SceneError> {
        let training = self.drafts.iter().filter(|draft| draft.entry.split == Split::Train);
        if training.count() < 2 {
            return Err(SceneError::NotCovered {
                path: source.to_owned(),
                area: area(),
            });
        }
        Ok(())
    }

    pub(super) fn drafts(&self) -> &[Draft] {
        &self.drafts
    }

    pub(super) fn frame(&self) -> &LocalFrame {
        &self.frame
    }

    pub(super) fn area(&self) -> &Area {
        &self.area
    }

    /// The pixels of all images, as [`pixels::read`] gives them, each with its warnings.
    fn read(&mut self, counts: Option<Counts>) -> Vec<(Result<Raster, SceneError>, Vec<String>)> {
        let drafts = self.drafts.par_iter_mut();
        let read = |Draft { file, plan, window, .. }: &mut Draft| {
            let mut warnings = Vec::new();
            (pixels::read(file, plan, *window, counts, &mut warnings), warnings)
        };
        drafts.map(read).collect()
    }

    pub(super) fn finish(
        mut self,
        source: &Path,
        layout: Layout,
        range: AltitudeRange,
        mut warnings: Vec<String>,
    ) -> Result<Scene, SceneError> {
        let (mut rasters, mut known) = (
            Vec::with_capacity(self.drafts.len()),
            Vec::with_capacity(self.drafts.len()),
        );
        for (read, said) in self.read(layout.counts) {
            warnings.extend(said);
            match read {
                Err(SceneError::NoPixels(_)) if self.is_part => known.push(false),
                read => {
                    rasters.push(read?);
                    known.push(true);
                }
            }
        }
        let mut known = known.into_iter();
        self.drafts.retain(|_| known.next().unwrap_or(false));
        self.must_be_shown_twice(source, || self.area.to_string())?;
        let Self {
            mut drafts,
            frame,
            area,
            ..
        } = self;
        let doubtful = weak_times::fill(&mut drafts, frame.origin, &mut warnings);
        let altitude_range_m = range.limits_m();
        let mut suns = Vec::with_capacity(drafts.len());
        for (place, draft) in drafts.iter().enumerate() {
            let sun = acquisition::sun(&draft.file, &draft.acquisition, frame.origin, &mut warnings)?;
            let sigma_deg = sun.sigma_deg.filter(|_| !doubtful.contains(&place));
            suns.push(ImageSun { sigma_deg, ..sun });
        }
        let shown = drafts.iter().zip(&rasters);
        let shown: Vec<_> = shown
            .map(|(draft, raster)| pixels::for_display(draft, raster, layout.counts))
            .collect();
        let counts_per_unit = pixels::scale_together(&mut rasters);
        let mut values = Vec::with_capacity(drafts.len());
        for ((draft, sun), shown) in drafts.iter().zip(&suns).zip(shown) {
            let path = draft.file.path().display().to_string();
            values.push((path, shown.unwrap_or_else(|| values_of(draft, sun, counts_per_unit))));
        }
        let kinds = drafts.first().map_or(&[][..], |draft| &draft.plan.kinds);
        warnings.extend(pixels::stretched(&values, kinds));
        if Values::default().ndvi(kinds).is_some() {
            warnings.extend(values::same_for_all(&mut values));
        }
        let fits = fit_pinholes(&drafts, &frame, altitude_range_m, &mut warnings)?;
        let mut images = Vec::with_capacity(drafts.len());
        let read = rasters.into_iter().zip(values);
        for (((draft, sun), (pixels, (_, values))), pinhole) in drafts.into_iter().zip(suns).zip(read).zip(fits) {
            let gsd_m = draft.gsd_m(&frame, frame.origin.height_m)?;
            images.push(SceneImage {
                name: draft.entry.name,
                path: draft.entry.path,
                split: draft.entry.split,
                window: draft.window,
                pixels: pixels.into(),
                values,
                data_type: draft.file.bands[draft.plan.file_bands[0]].data_type.clone(),
                bands: draft.plan.kinds,
                rpc: draft.rpc,
                rpc_source: draft.rpc_source,
                pinhole,
                time: draft.acquisition.time,
                sun,
                metadata_sun: draft.acquisition.stated_sun(),
                gsd_m,
            });
        }
        images.sort_by_key(|image| image.split == Split::Test);
        let training = images.iter().filter(|image| image.split == Split::Train);
        let gsd_m = nominal_gsd_m(training.map(|image| image.gsd_m).collect());
        let mut scene = Scene {
            source: source.to_owned(),
            gsd_m,
            images,
            frame,
            altitude_range_m,
            altitude_known_from: range.source,
            altitude_source: range.words,
            area,
            counts_per_unit,
            truth: layout.truth,
            warnings,
        };
        scene.warn_of_copies();
        Ok(scene)
    }
}

/// What metadata say of the values of an image.
fn values_of(draft: &Draft, sun: &ImageSun, counts_per_unit: f64) -> Values {
    let bands = values::FileBands {
        kinds: &draft.plan.kinds,
        places: &draft.plan.file_bands,
    };
    let light = values::Light {
        sun: sun.position,
        time: draft.acquisition.time,
    };
    let said = draft.radiometry.as_ref();
    said.map_or_else(Values::default, |found| {
        Values::of_metadata(found, &bands, &light, counts_per_unit)
    })
}

/// Ground sampling distances that differ by more than this factor are not those of one kind of image.
const UNLIKE: f64 = 1.5;

/// Share by which a ground sampling distance may be rounded to one significant digit.
const ROUNDED: f64 = 0.05;

/// The median of `gsds` (metres, one at least), what at least half of the images resolve, in one significant digit where that is nearly
/// the same and else in two: cells of 0.5 m coincide with those of other data, those of 0.51 m do not.
///
/// A surface is found from pairs, and a pair shows what its coarser image resolves: cells of a few finer images would be empty detail, those
/// of the coarsest would lose what most images show. Of two middle ones of unlike images the finer counts where two images or more have it.
pub(super) fn nominal_gsd_m(mut gsds: Vec<f64>) -> f64 {
    let upper = upper_median(&mut gsds).unwrap_or(f64::NAN);
    gsds.sort_by(f64::total_cmp);
    let lower = gsds.get(gsds.len().saturating_sub(1) / 2).copied().unwrap_or(upper);
    let median = if gsds.len() > 3 && upper > UNLIKE * lower {
        lower
    } else {
        upper
    };
    // Multiples of a whole divisor are nearer to decimals than those of a fraction are.
    let in_digits = |digits: i32| {
        let per_unit = 10f64.powi(digits - 1 - median.log10().floor() as i32);
        (median * per_unit).round() / per_unit
    };
    let round = in_digits(1);
    if (round - median).abs() <= ROUNDED * median {
        round
    } else {
        in_digits(2)
    }
}

/// Corners of the training images on the ground.
pub(super) fn training_footprints(
    drafts: &[Draft],
    frame: &LocalFrame,
    altitude_m: f64,
) -> Result<Vec<Footprint>, SceneError> {
    let training = drafts.iter().filter(|draft| draft.entry.split == Split::Train);
    training.map(|draft| draft.footprint(frame, altitude_m)).collect()
}

/// Leaves out images that see no ground a training image sees; at least two training images must remain.
fn drop_non_overlapping(
    drafts: Vec<Draft>,
    frame: &LocalFrame,
    altitude_m: f64,
    warnings: &mut Vec<String>,
) -> Result<Vec<Draft>, SceneError> {
    let mut footprints = Vec::with_capacity(drafts.len());
    for draft in &drafts {
        footprints.push(draft.footprint(frame, altitude_m)?);
    }
    let least_m2 = LEAST_OVERLAP_PX.powi(2) * drafts[0].gsd_m(frame, altitude_m)?.powi(2);
    let is_training = |index: usize| drafts[index].entry.split == Split::Train;
    let overlaps: Vec<bool> = (0..drafts.len())
        .map(|index| {
            (0..drafts.len()).any(|other| {
                let shared = || footprints[index].intersection(&footprints[other]).area_m2();
                other != index && is_training(other) && shared() >= least_m2
            })
        })
        .collect();
    let remaining = (0..drafts.len())
        .filter(|&index| is_training(index) && overlaps[index])
        .count();
    if remaining < 2 {
        let mut training = (0..drafts.len()).filter(|&index| is_training(index));
        let first = training.next().unwrap_or(0);
        let second = training.next().unwrap_or(first);
        return Err(SceneError::NoOverlap {
            first: drafts[first].file.path().to_owned(),
            second: drafts[second].file.path().to_owned(),
            altitude_m,
        });
    }
    let mut kept = Vec::with_capacity(drafts.len());
    for (draft, overlaps) in drafts.into_iter().zip(overlaps) {
        if overlaps {
            kept.push(draft);
        } else {
            warnings.push(format!(
                "{}: overlaps no other training image, left out",
                draft.file.path().display()
            ));
        }
    }
    Ok(kept)
}

fn fit_pinholes(
    drafts: &[Draft],
    frame: &LocalFrame,
    altitude_range_m: (f64, f64),
    warnings: &mut Vec<String>,
) -> Result<Vec<PinholeFit>, SceneError> {
    /// A larger residual shows as blur in the model.
    const WORTH_A_WARNING_PX: f64 = 0.25;
    // Open GDAL files cannot be shared between threads: take out what the fit needs.
    let cameras: Vec<(&Rpc, ImageWindow)> = drafts.iter().map(|draft| (&draft.rpc, draft.image_window())).collect();
    let fits: Vec<_> = cameras
        .par_iter()
        .map(|(rpc, window)| PinholeFit::fit(rpc, frame, *window, altitude_range_m))
        .collect();
    let mut good = Vec::with_capacity(fits.len());
    for (draft, fit) in drafts.iter().zip(fits) {
        let fit = fit.map_err(|source| draft.camera_fault(frame.origin.height_m, source))?;
        if fit.max_px > WORTH_A_WARNING_PX {
            warnings.push(format!(
                "{}: a pinhole camera stands for its RPC only to {:.2} px (rms {:.2}); give smaller crops or a narrower altitude \
                 range",
                draft.file.path().display(),
                fit.max_px,
                fit.rms_px
            ));
        }
        good.push(fit);
    }
    Ok(good)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_as_wide_as_people_say() {
        assert_eq!(nominal_gsd_m(vec![0.62, 0.504_142, 0.49]), 0.5);
        assert_eq!(nominal_gsd_m(vec![0.509]), 0.5);
        assert_eq!(nominal_gsd_m(vec![0.309]), 0.3);
        assert_eq!(nominal_gsd_m(vec![0.332]), 0.33);
        assert_eq!(nominal_gsd_m(vec![0.0996]), 0.1);
        assert_eq!(nominal_gsd_m(vec![1.94, 2.06]), 2.0);
        assert_eq!(nominal_gsd_m(vec![12.4]), 12.0);
    }

    #[test]
    fn cells_are_what_half_of_the_images_resolve() {
        assert_eq!(nominal_gsd_m(vec![0.5, 1.0, 0.5, 1.0]), 0.5);
        assert_eq!(nominal_gsd_m(vec![0.3, 2.0, 2.0]), 2.0);
        assert_eq!(nominal_gsd_m(vec![0.3, 2.0, 0.3]), 0.3);
        // One fine image alone shows no surface.
        assert_eq!(nominal_gsd_m(vec![0.3, 2.0]), 2.0);
        // One camera that looks aslant is no other kind of image.
        assert_eq!(nominal_gsd_m(vec![0.5, 0.5, 0.6, 0.6]), 0.6);
    }
}
