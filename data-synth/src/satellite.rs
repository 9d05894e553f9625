//! A satellite scene from a request: city, dates, images, truth, files.

use crate::city::{City, CityPlan};
use crate::clouds::{CloudField, CloudSize};
use crate::cover::Waves;
use crate::crop::{Canvas, Crop};
use crate::delivery;
use crate::encoding::{Encoding, MEAN_GAIN};
use crate::error::SynthError;
use crate::faults::{self, Haze};
use crate::materials::Class;
use crate::nadir::NadirSensor;
use crate::plan::{Collection, DatePlan, ViewPlan};
use crate::radiometry::{Illumination, LitScene};
use crate::rational::{self, RationalSensor};
use crate::raytrace::Tracer;
use crate::relit::{self, Studio};
use crate::render::{Exposure, Image, render};
use crate::request::{Cover, Delivery, Fault, SatelliteRequest, Site};
use crate::sensor::{PushBroom, Sensor};
use crate::solid::Solids;
use crate::summary::{ImageSummary, Summary};
use crate::truth::{Truth, altitudes, survey};
use crate::truth_files::{SHADOW_MEANS, TruthFolder};
use crate::truth_grid::TruthGrid;
use crate::write::Staging;
use crate::write::geotiff::{Raster, Samples, write};
use crate::write::metadata::{image_items, loose_altitudes_m, satnerf_json};
use heliosplat_rpc::fit::RpcFit;
use heliosplat_rpc::{GeoPoint, LocalFrame, Rpc};
use jiff::tz::TimeZone;
use nalgebra::Vector3;
use rayon::prelude::*;
use std::path::Path;

/// Pixels that every image shows beyond the site on all sides, at all its altitudes.
const MARGIN_PX: f64 = 12.0;
/// Margin of the city beyond the images, metres, so that shadows fall into the images.
const SURROUNDINGS_M: f64 = 50.0;
/// Gain of scenes with snow relative to other scenes, times the sine of the sun's elevation.
const SNOWY_EXPOSURE: f64 = 1.25;

/// One image's camera: the sensor, the window of the image, and the delivered RPC.
struct ImageCamera {
    sensor: Sensor,
    crop: Crop,
    fit: RpcFit,
    /// Larger file that the image lies in, if requested.
    canvas: Option<Canvas>,
    /// RPC of the file, with the requested bias.
    rpc: Rpc,
}

/// Makes a satellite scene in `out_dir`: images with RPC, sun and date as a vendor would deliver them, their metadata
/// in the style of Sat-NeRF, `train.txt` and `test.txt`, and `truth/` (DSM, classes, albedo, masks of shadows and
/// clouds, on request images under other suns).
///
/// `progress` receives the work done and the whole work, on the calling thread. The same request gives the same bytes,
/// for any number of threads.
///
/// # Errors
/// [`SynthError::BadRequest`] for a request that cannot be met, [`SynthError::Failed`] when a
/// file cannot be written; `out_dir` then holds nothing new.
pub fn write_satellite(
    request: &SatelliteRequest,
    out_dir: &Path,
    progress: &dyn Fn(usize, usize),
) -> Result<Summary, SynthError> {
    request.check()?;
    let collection = Collection::new(request)?;
    let staging = Staging::new(out_dir)?;
    let frame = LocalFrame::new(collection.origin);
    let grid = TruthGrid::around(collection.origin, request.site.extent_m(), request.gsd());
    let cameras = (collection.views.iter())
        .map(|view| camera(request, &frame, &grid, view))
        .collect::<Result<Vec<_>, _>>()?;
    let mut city = City::new(request.seed, city_plan(request, &cameras));
    if request.change > 0.0 {
        city = city.changing(request.seed, request.change, &collection.dates_of_change()?);
    }
    let last = collection.dates.len().saturating_sub(1);
    let truth = survey_city(request, &city, &frame, &grid, last);
    let folder = TruthFolder {
        staging: &staging,
        grid: &grid,
    };
    folder.write(request, &truth)?;
    if request.change > 0.0 {
        let before = survey_city(request, &city, &frame, &grid, 0);
        folder.write_change([&before, &truth], &changed_at(&city, &collection, &frame, &grid))?;
    }
    let altitudes_m = loose_altitudes_m(truth.altitude_range_m(), request.seed);
    let total = cameras.iter().map(|camera| camera.crop.height).sum::<usize>() + request.relight * grid.size;
    let mut done = 0;
    let mut rows_done = |rows| {
        done += rows;
        progress(done, total);
    };
    let delivered = Delivered {
        staging: &staging,
        request,
        collection: &collection,
        altitudes_m,
    };
    let mut images: Vec<Option<ImageSummary>> = vec![None; cameras.len()];
    for (date, plan) in collection.dates.iter().enumerate() {
        let solids = fitted(request, city.solids_with_cars(date, plan.car_occupancy));
        let tracer = Tracer::new(&city.terrain, solids.primitives);
        let scene = LitScene::of(&tracer, &solids.surfaces, &city.ground);
        for index in (0..cameras.len()).filter(|&index| collection.views[index].date == date) {
            images[index] = Some(delivered.image(index, &cameras[index], &scene, &mut rows_done)?);
        }
    }
    if request.relight > 0 {
        let sensor = NadirSensor { frame, grid };
        relight(&staging, request, &collection, (&city, &sensor), &mut rows_done)?;
    }
    let summary = Summary {
        request: request.clone(),
        origin: collection.origin,
        grid,
        altitude_range_m: truth.altitude_range_m(),
        class_share: class_share(&truth),
        cover_share: share_of(&truth.cover),
        glossy_share: f64::from(u8::from(request.has(Fault::Glossy))) * share_of(&truth.glossy),
        images: images.into_iter().flatten().collect(),
    };
    write_lists(&staging, &summary)?;
    staging.finish()?;
    Ok(summary)
}

/// Request and folder that all images of a delivery share.
struct Delivered<'a> {
    staging: &'a Staging,
    request: &'a SatelliteRequest,
    collection: &'a Collection,
    /// Altitudes of the scene that the metadata state.
    altitudes_m: [f64; 2],
}

impl Delivered<'_> {
    /// Renders and writes the image at `index`, of `scene` on its date.
    fn image(
        &self,
        index: usize,
        camera: &ImageCamera,
        scene: &LitScene,
        rows_done: &mut dyn FnMut(usize),
    ) -> Result<ImageSummary, SynthError> {
        let (request, view) = (self.request, &self.collection.views[index]);
        let plan = &self.collection.dates[view.date];
        let haze = request.has(Fault::Haze).then(|| Haze::of_date(request.seed, view.date));
        let light = light_of(request, plan, view, camera, haze.as_ref());
        let gains = (request.has(Fault::BandGains)).then(|| faults::band_gains(request.seed, index));
        let exposure = Exposure {
            sensor: &camera.sensor,
            crop: camera.crop,
            light: &light,
            bands: request.bands,
            encoding: encoding_of(request, plan, view),
            band_gains: gains.unwrap_or([1.0; 4]),
            sea_is_missing: request.cover == Some(Cover::Nodata),
            seed: view.geometry.seed,
        };
        let mut image = render(scene, &exposure, rows_done);
        let stretch = (request.has(Fault::Stretch))
            .then(|| faults::stretch(&mut image.counts, request.bands, view.geometry.seed));
        let (view, image) = match request.delivery {
            Delivery::Whole => (view.clone(), image),
            Delivery::PanMs => {
                delivery::write_multispectral(self.staging, request, view, (&camera.rpc, camera.canvas), &image)?;
                let exposure = delivery::panchromatic_exposure(&exposure);
                let pan = render(scene, &exposure, &mut |_| ());
                (delivery::panchromatic_view(view), pan)
            }
        };
        write_image(self.staging, request, &view, camera, &image, self.altitudes_m)?;
        Ok(ImageSummary {
            band_gains: gains.map_or_else(Vec::new, |gains| gains[..request.bands.names().len()].to_vec()),
            haze,
            stretch,
            ..image_summary(&view, camera, &image)
        })
    }
}

/// Solids of the scene, with solar panels on some roofs if glossy surfaces are requested.
fn fitted(request: &SatelliteRequest, mut solids: Solids) -> Solids {
    if request.has(Fault::Glossy) {
        solids.lay_panels();
    }
    solids
}

/// The light of an image, with the requested weather and faults.
fn light_of(
    request: &SatelliteRequest,
    date: &DatePlan,
    view: &ViewPlan,
    camera: &ImageCamera,
    haze: Option<&Haze>,
) -> Illumination {
    let size = if request.has(Fault::LargeClouds) {
        CloudSize::LARGE
    } else {
        CloudSize::SMALL
    };
    let clouds = (view.cloudy).then(|| CloudField::over(&camera.sensor, &camera.crop, size, view.geometry.seed));
    let waves = request
        .has_sea()
        .then(|| Waves::of_image(view.geometry.seed, date.weather.water_slope_variance));
    let zenith_rad = view.geometry.zenith_rad();
    Illumination::new(&view.sun, date.weather, date.season, zenith_rad)
        .under_haze(haze, zenith_rad)
        .among(&request.faults)
        .on_sea(waves)
        .through(clouds)
}

/// Conversion of an image's light to counts.
fn encoding_of(request: &SatelliteRequest, date: &DatePlan, view: &ViewPlan) -> Encoding {
    let mut gain = MEAN_GAIN * date.weather.exposure;
    if request.cover == Some(Cover::Snow) {
        // Exposed for bare land under the sun of the day, the snow clips.
        gain *= SNOWY_EXPOSURE / view.sun.elevation_rad.sin();
    }
    Encoding {
        gain,
        noise: request.noise,
        // Display images are stretched from linear counts.
        bits: if request.has(Fault::Stretch) { 16 } else { request.bits },
    }
}

/// The sensor of a view, the crop that covers the site at all altitudes, and the RPC a vendor would deliver with it.
fn camera(
    request: &SatelliteRequest,
    frame: &LocalFrame,
    grid: &TruthGrid,
    view: &ViewPlan,
) -> Result<ImageCamera, SynthError> {
    let fault = SynthError::camera(&view.name);
    let (sensor, crop, fit) = match &view.known {
        None => {
            let sensor = PushBroom::new(frame, &view.geometry, view.aim_px);
            let crop = crop_of(request, frame, grid, &|point| sensor.project(point));
            let fit = sensor.fit_rational_camera(frame).map_err(&fault)?;
            (Sensor::PushBroom(Box::new(sensor)), crop, fit)
        }
        Some(rpc) => {
            let crop = crop_of(request, frame, grid, &|point| rational::project(rpc, frame, point));
            let sensor = RationalSensor::new(rpc, frame, &crop).map_err(&fault)?;
            let fit = RpcFit {
                rpc: rpc.clone(),
                rms_px: 0.0,
                max_px: 0.0,
            };
            (Sensor::Rational(sensor), crop, fit)
        }
    };
    let canvas = (request.canvas_px)
        .map(|size| canvas_of(&crop, &fit.rpc, size))
        .transpose()?;
    let [col, row] = canvas.map_or([0.0; 2], |canvas| [canvas.col as f64, canvas.row as f64]);
    let mut rpc = fit.rpc.cropped(crop.col0 - col, crop.row0 - row);
    rpc.sample_offset += view.rpc_bias_px[0];
    rpc.line_offset += view.rpc_bias_px[1];
    Ok(ImageCamera {
        sensor,
        crop,
        fit,
        canvas,
        rpc,
    })
}

/// The canvas of an image, with the centre of the full scene's RPC in its middle if there is room.
fn canvas_of(crop: &Crop, full_scene: &Rpc, size: usize) -> Result<Canvas, SynthError> {
    let centre_px = [full_scene.sample_offset, full_scene.line_offset];
    Canvas::around(crop, centre_px, size).ok_or_else(|| {
        SynthError::BadRequest(format!(
            "a canvas of {size} px, but an image has {} x {} px",
            crop.width, crop.height
        ))
    })
}

fn crop_of(
    request: &SatelliteRequest,
    frame: &LocalFrame,
    grid: &TruthGrid,
    project: &dyn Fn(Vector3<f64>) -> [f64; 2],
) -> Crop {
    let side = grid.size as f64;
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for [col, row] in [[0.0, 0.0], [side, 0.0], [0.0, side], [side, side]] {
        for altitude_m in request.site.covered_altitudes_m() {
            let [lon_deg, lat_deg] = grid.lon_lat(col, row);
            let height_m = frame.origin.height_m + altitude_m;
            let pixel = project(frame.enu_from_geo(GeoPoint::new(lon_deg, lat_deg, height_m)));
            for k in 0..2 {
                low[k] = low[k].min(pixel[k]);
                high[k] = high[k].max(pixel[k]);
            }
        }
    }
    let (first, [width, height]) = match request.size_px {
        Some(size) => {
            let first = [0, 1].map(|k| (0.5 * (low[k] + high[k]) - 0.5 * (size as f64 - 1.0)).round());
            (first, [size; 2])
        }
        None => {
            let (first, last) = (
                low.map(|v| (v - MARGIN_PX).floor()),
                high.map(|v| (v + MARGIN_PX).ceil()),
            );
            (first, [0, 1].map(|k| (last[k] - first[k]) as usize + 1))
        }
    };
    Crop {
        col0: first[0],
        row0: first[1],
        width,
        height,
    }
}

/// Plan of a city that extends beyond every image.
fn city_plan(request: &SatelliteRequest, cameras: &[ImageCamera]) -> CityPlan {
    let mut reach_m = 0.5 * request.site.extent_m();
    let [lowest_m, _] = request.site.covered_altitudes_m();
    for ImageCamera { sensor, crop, .. } in cameras {
        for (col, row) in [(0, 0), (crop.width, 0), (0, crop.height), (crop.width, crop.height)] {
            let ray = sensor.at_line(crop.row0 + row as f64).ray(crop.col0 + col as f64);
            let ground = ray.at((lowest_m - ray.origin.z) / ray.direction.z);
            reach_m = reach_m.max(ground.x.abs()).max(ground.y.abs());
        }
    }
    CityPlan {
        half_extent_m: reach_m + SURROUNDINGS_M,
        longest_block_m: if request.site == Site::Tiny { 54.0 } else { 92.0 },
        town: request.site == Site::District,
        cover: request.cover,
    }
}

/// Truth rasters of the city on a date.
fn survey_city(request: &SatelliteRequest, city: &City, frame: &LocalFrame, grid: &TruthGrid, date: usize) -> Truth {
    let solids = fitted(request, city.solids(date));
    let tracer = Tracer::new(&city.terrain, solids.primitives);
    let scene = LitScene::of(&tracer, &solids.surfaces, &city.ground);
    let bare = Tracer::new(&city.terrain, Default::default());
    let ground = LitScene { tracer: &bare, ..scene };
    Truth {
        ground_m: altitudes(&ground, frame, grid),
        ..survey(&scene, frame, grid, request.bands)
    }
}

/// The day, as YYYYMMDD, of the first image that shows the new state of each cell of the grid; 0 where nothing is built
/// or torn down.
fn changed_at(city: &City, collection: &Collection, frame: &LocalFrame, grid: &TruthGrid) -> Vec<f64> {
    let day = |date: usize| {
        let day = collection.dates[date].time.to_zoned(TimeZone::UTC).date();
        f64::from(i32::from(day.year()) * 10_000 + i32::from(day.month()) * 100 + i32::from(day.day()))
    };
    let of_cell = |cell: usize| {
        let [lon_deg, lat_deg] = grid.lon_lat((cell % grid.size) as f64 + 0.5, (cell / grid.size) as f64 + 0.5);
        let height_m = frame.origin.height_m;
        let at = frame.enu_from_geo(GeoPoint::new(lon_deg, lat_deg, height_m));
        city.changed_at(at.x, at.y).map_or(0.0, day)
    };
    (0..grid.size * grid.size).into_par_iter().map(of_cell).collect()
}

/// Setting of the truth under additional suns: that of the image with the highest sun.
fn studio_of(request: &SatelliteRequest, collection: &Collection) -> Option<Studio> {
    let height = |view: &ViewPlan| view.sun.elevation_rad;
    let views = collection.views.iter().enumerate();
    let (index, view) = views.max_by(|(_, a), (_, b)| height(a).total_cmp(&height(b)))?;
    let date = &collection.dates[view.date];
    let gains = (request.has(Fault::BandGains)).then(|| faults::band_gains(request.seed, index));
    Some(Studio {
        weather: date.weather,
        season: date.season,
        haze: (request.has(Fault::Haze)).then(|| Haze::of_date(request.seed, view.date)),
        gain: encoding_of(request, date, view).gain,
        band_gains: gains.unwrap_or([1.0; 4]),
    })
}

/// Writes the site under suns that no image has, without cars and clouds.
fn relight(
    staging: &Staging,
    request: &SatelliteRequest,
    collection: &Collection,
    (city, sensor): (&City, &NadirSensor),
    rows_done: &mut dyn FnMut(usize),
) -> Result<(), SynthError> {
    let Some(studio) = studio_of(request, collection) else {
        return Ok(());
    };
    let solids = fitted(request, city.solids(collection.dates.len().saturating_sub(1)));
    let tracer = Tracer::new(&city.terrain, solids.primitives);
    let scene = LitScene::of(&tracer, &solids.surfaces, &city.ground);
    let suns_deg = relit::suns_deg(request, collection);
    let folder = TruthFolder {
        staging,
        grid: &sensor.grid,
    };
    folder.write_relit(request, (&scene, sensor), &studio, &suns_deg, rows_done)
}

fn write_image(
    staging: &Staging,
    request: &SatelliteRequest,
    view: &ViewPlan,
    camera: &ImageCamera,
    image: &Image,
    altitudes_m: [f64; 2],
) -> Result<(), SynthError> {
    let items = image_items(view, request, share_of(&image.cloud));
    let mut bytes = Vec::new();
    let samples = Samples::of_counts(&image.counts, request.file_bits(), &mut bytes);
    let raster = Raster {
        width: image.width,
        height: image.height,
        samples,
        bands: request.delivery.main_bands(request.bands).names(),
        items: &items,
        rpc: Some(heliosplat_rpc::write::geotiff_tag(&camera.rpc)),
        grid: None,
        nodata: camera.canvas.map(|_| 0.0),
        canvas: camera.canvas,
    };
    write(&staging.path(&format!("{}.tif", view.name))?, &raster)?;
    let write_mask = |name: &'static str, mask: &[u8], what: &str| {
        let raster = Raster {
            samples: Samples::U8(mask),
            bands: &[name],
            items: &[("DESCRIPTION".to_string(), what.to_string())],
            nodata: None,
            ..raster.clone()
        };
        write(&staging.path(&format!("truth/{name}_{}.tif", view.name))?, &raster)
    };
    write_mask("shadow", &image.shadow, SHADOW_MEANS)?;
    if view.cloudy {
        write_mask(
            "cloud",
            &image.cloud,
            "1 where clouds hide a tenth of the pixel or more",
        )?;
    }
    let json = satnerf_json(view, (&camera.crop, camera.canvas), &camera.rpc, altitudes_m)
        .map_err(SynthError::camera(&view.name))?;
    staging.text(&format!("{}.json", view.name), &format!("{json:#}\n"))
}

fn write_lists(staging: &Staging, summary: &Summary) -> Result<(), SynthError> {
    let list = |held_out: bool| -> String {
        let names = summary.images.iter().filter(|image| image.held_out == held_out);
        names.map(|image| format!("{}.json\n", image.name)).collect()
    };
    staging.text("train.txt", &list(false))?;
    staging.text("test.txt", &list(true))?;
    // A map with string keys and finite numbers cannot fail to serialise; an empty file would show it.
    let text = serde_json::to_string_pretty(summary).unwrap_or_default();
    staging.text("truth/summary.json", &(text + "\n"))
}

fn image_summary(view: &ViewPlan, camera: &ImageCamera, image: &Image) -> ImageSummary {
    ImageSummary {
        name: view.name.clone(),
        time: view.time,
        date: view.date,
        held_out: view.held_out,
        size_px: [image.width, image.height],
        canvas_offset_px: camera.canvas.map(|canvas| [canvas.col, canvas.row]),
        gsd_m: view.geometry.gsd_m,
        sun_azimuth_deg: view.sun.azimuth_rad.to_degrees(),
        sun_elevation_deg: view.sun.elevation_rad.to_degrees(),
        satellite_azimuth_deg: view.geometry.azimuth_rad.to_degrees(),
        off_nadir_deg: view.geometry.off_nadir_rad.to_degrees(),
        rpc_rms_px: camera.fit.rms_px,
        rpc_max_px: camera.fit.max_px,
        pointing_bias_px: view.rpc_bias_px,
        shadow_share: share_of(&image.shadow),
        cloud_share: share_of(&image.cloud),
        band_gains: Vec::new(),
        haze: None,
        stretch: None,
    }
}

/// Share of a mask that is 1.
fn share_of(mask: &[u8]) -> f64 {
    mask.iter().filter(|&&value| value == 1).count() as f64 / mask.len().max(1) as f64
}

fn class_share(truth: &Truth) -> std::collections::BTreeMap<String, f64> {
    let share = |class: Class| {
        truth.class.iter().filter(|&&code| code == class as u8).count() as f64 / truth.class.len().max(1) as f64
    };
    let present = Class::NAMES
        .iter()
        .map(|&(class, name)| (name.to_string(), share(class)));
    present.filter(|(_, share)| *share > 0.0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_site_has_the_make_up_of_a_city() {
        let mut all = Vec::new();
        for seed in 1..=6 {
            let request = SatelliteRequest {
                seed,
                gsd_m: Some(1.0),
                ..Default::default()
            };
            let collection = Collection::new(&request).expect("a plan");
            let frame = LocalFrame::new(collection.origin);
            let grid = TruthGrid::around(collection.origin, 128.0, 1.0);
            let plan = CityPlan {
                half_extent_m: 100.0,
                longest_block_m: 92.0,
                town: false,
                cover: None,
            };
            let truth = survey_city(&request, &City::new(seed, plan), &frame, &grid, 0);
            let [low_m, high_m] = truth.altitude_range_m();
            let share = class_share(&truth);
            println!("{seed}: {:.1} m {share:?}", high_m - low_m);
            assert!((12.0..48.0).contains(&(high_m - low_m)), "{seed}: {}", high_m - low_m);
            assert!(!share.contains_key("car"), "no cars in the truth");
            all.push(share);
        }
        let mean = |name: &str| all.iter().filter_map(|share| share.get(name)).sum::<f64>() / all.len() as f64;
        assert!((0.17..0.35).contains(&mean("building")), "{}", mean("building"));
        assert!((0.10..0.18).contains(&mean("vegetation")), "{}", mean("vegetation"));
        assert!((0.15..0.32).contains(&mean("road")), "{}", mean("road"));
        assert!((0.003..0.05).contains(&mean("water")), "{}", mean("water"));
    }

    #[test]
    fn every_site_stays_within_the_altitudes_that_images_are_made_to_cover() {
        for seed in 100..116 {
            for site in [Site::Tiny, Site::Block, Site::City, Site::District] {
                // A whole town takes seconds.
                if site == Site::District && seed >= 102 {
                    continue;
                }
                let request = SatelliteRequest {
                    site,
                    seed,
                    gsd_m: Some(4.0),
                    ..Default::default()
                };
                let collection = Collection::new(&request).expect("a plan");
                let frame = LocalFrame::new(collection.origin);
                let grid = TruthGrid::around(collection.origin, site.extent_m(), 4.0);
                let plan = CityPlan {
                    half_extent_m: 0.5 * site.extent_m() + 20.0,
                    longest_block_m: 70.0,
                    town: site == Site::District,
                    cover: None,
                };
                let truth = survey_city(&request, &City::new(seed, plan), &frame, &grid, 0);
                let [low_m, high_m] = truth.altitude_range_m().map(|m| m - collection.origin.height_m);
                let [lowest_m, highest_m] = site.covered_altitudes_m();
                assert!(low_m > lowest_m && high_m < highest_m, "{seed}: {low_m} {high_m}");
            }
        }
    }

    #[test]
    fn a_district_has_the_make_up_of_a_town() {
        let request = SatelliteRequest {
            site: Site::District,
            seed: 41,
            gsd_m: Some(4.0),
            ..Default::default()
        };
        let collection = Collection::new(&request).expect("a plan");
        let frame = LocalFrame::new(collection.origin);
        let extent_m = request.site.extent_m();
        let grid = TruthGrid::around(collection.origin, extent_m, 4.0);
        let plan = CityPlan {
            half_extent_m: 0.5 * extent_m,
            longest_block_m: 92.0,
            town: true,
            cover: None,
        };
        let truth = survey_city(&request, &City::new(41, plan), &frame, &grid, 0);
        let share = class_share(&truth);
        let of = |name: &str| share.get(name).copied().unwrap_or(0.0);
        println!("{share:?}");
        assert!((0.15..0.30).contains(&of("building")) && (0.2..0.35).contains(&of("road")));
        assert!(of("vegetation") > 0.06 && of("water") * extent_m * extent_m > 1500.0);
        // The hill and the general slope, without what stands on them.
        let ground = |pick: fn(f32, f32) -> f32| truth.ground_m.iter().copied().reduce(pick).unwrap_or(f32::NAN);
        assert!(ground(f32::max) - ground(f32::min) > 15.0);
        // Houses are low, towers are high.
        let heights_m: Vec<f32> = (0..truth.class.len())
            .filter(|&cell| truth.class[cell] == Class::Building as u8)
            .map(|cell| truth.altitude_m[cell] - truth.ground_m[cell])
            .collect();
        let higher = |metres: f32| heights_m.iter().filter(|&&m| m > metres).count() as f64 / heights_m.len() as f64;
        assert!(
            higher(20.0) > 0.005 && higher(12.0) < 0.5,
            "{} {}",
            higher(20.0),
            higher(12.0)
        );
    }

    #[test]
    fn cameras_hold_at_the_corners_of_a_canvas() {
        for (site, canvas) in [(Site::Tiny, 2400), (Site::Tiny, 40_000), (Site::District, 40_000)] {
            for seed in 0..20 {
                let request = SatelliteRequest {
                    site,
                    seed,
                    canvas_px: Some(canvas),
                    ..Default::default()
                };
                let collection = Collection::new(&request).expect("a plan");
                let frame = LocalFrame::new(collection.origin);
                let grid = TruthGrid::around(collection.origin, site.extent_m(), request.gsd());
                for view in &collection.views {
                    let rpc = camera(&request, &frame, &grid, view).expect("a camera").rpc;
                    let last = canvas as f64 - 1.0;
                    for (col, row) in [(0.0, 0.0), (last, 0.0), (0.0, last), (last, last)] {
                        for height_m in [-60.0, 0.0, 120.0] {
                            let height_m = collection.origin.height_m + height_m;
                            let corner = rpc.localise(heliosplat_rpc::ImagePoint { col, row }, height_m);
                            assert!(corner.is_ok(), "{} on {canvas} px: {corner:?}", view.name);
                        }
                    }
                }
            }
        }
    }
}
