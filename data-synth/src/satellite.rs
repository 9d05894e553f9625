//! A satellite scene from a request: city, dates, images, truth, files.

use crate::city::{City, CityPlan};
use crate::clouds::{CloudField, CloudSize};
use crate::crop::{Canvas, Crop};
use crate::delivery;
use crate::error::SynthError;
use crate::faults;
use crate::materials::Class;
use crate::nadir::NadirSensor;
use crate::plan::{Collection, ViewPlan};
use crate::radiometry::LitScene;
use crate::rational::{self, RationalSensor};
use crate::relit;
use crate::render::{Image, render};
use crate::request::{BandSet, Delivery, Fault, SatelliteRequest, Site};
use crate::sensor::{PushBroom, Sensor};
use crate::solid::Solids;
use crate::studio::Studio;
use crate::summary::{ImageSummary, Summary};
use crate::truth::{Truth, altitudes, survey};
use crate::truth_files::{SHADOW_MEANS, TruthFolder};
use crate::truth_grid::TruthGrid;
use crate::write::Staging;
use crate::write::geotiff::{Raster, Samples, write};
use crate::write::metadata::{borrowed, image_items, loose_altitudes_m, satnerf_json};
use heliosplat_rpc::fit::RpcFit;
use heliosplat_rpc::{LocalFrame, Rpc};
use jiff::tz::TimeZone;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::path::Path;

/// Pixels that every image shows beyond the site on all sides, at all its altitudes.
const MARGIN_PX: f64 = 12.0;
/// Margin of the city beyond the images, metres, so that shadows fall into the images.
const SURROUNDINGS_M: f64 = 50.0;

/// One image's camera: the sensor, the window of the image, and the delivered RPC.
struct ImageCamera {
    sensor: Box<dyn Sensor>,
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
    let nadir = NadirSensor {
        frame: LocalFrame::new(collection.origin),
        grid: TruthGrid::around(collection.origin, request.site.extent_m(), request.gsd()),
    };
    let cameras = (collection.views.iter())
        .map(|view| camera(request, &nadir, view))
        .collect::<Result<Vec<_>, _>>()?;
    let mut city = City::new(request.seed, city_plan(request, &cameras));
    if request.change > 0.0 {
        city = city.changing(request.seed, request.change, &collection.dates_of_change()?);
    }
    let last = collection.dates.len().saturating_sub(1);
    let truth = survey_city(request, &city, &nadir, last);
    let folder = TruthFolder {
        staging: &staging,
        request,
        nadir: &nadir,
    };
    folder.write(&truth)?;
    if request.change > 0.0 {
        let before = survey_city(request, &city, &nadir, 0);
        folder.write_change([&before, &truth], &changed_at(&city, &collection, &nadir))?;
    }
    let total = cameras.iter().map(|camera| camera.crop.height).sum::<usize>() + request.relight * nadir.grid.size;
    let mut done = 0;
    let mut rows_done = |rows| {
        done += rows;
        progress(done, total);
    };
    let delivered = Delivered {
        staging: &staging,
        request,
        collection: &collection,
        altitudes_m: loose_altitudes_m(truth.altitude_range_m(), request.seed),
    };
    let mut images: Vec<Option<ImageSummary>> = vec![None; cameras.len()];
    for (date, plan) in collection.dates.iter().enumerate() {
        let scene = scene_of(request, &city, city.solids_with_cars(date, plan.car_occupancy));
        for index in (0..cameras.len()).filter(|&index| collection.views[index].date == date) {
            images[index] = Some(delivered.image(index, &cameras[index], &scene, &mut rows_done)?);
        }
    }
    if request.relight > 0
        && let Some(index) = highest_sun(&collection)
    {
        let scene = scene_of(request, &city, city.solids(last));
        let studio = Studio::new(request, &collection, index);
        folder.write_relit(&scene, &studio, &relit::suns_deg(request, &collection), &mut rows_done)?;
    }
    let glossy = request.has(Fault::Glossy);
    let summary = Summary {
        request: request.clone(),
        origin: collection.origin,
        grid: nadir.grid,
        altitude_range_m: truth.altitude_range_m(),
        class_share: class_share(&truth),
        cover_share: share_of(&truth.cover, 1),
        glossy_share: if glossy { share_of(&truth.glossy, 1) } else { 0.0 },
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
        let studio = Studio::new(request, self.collection, index);
        let seed = view.geometry.seed;
        let large = request.has(Fault::LargeClouds);
        let size = if large { CloudSize::LARGE } else { CloudSize::SMALL };
        let clouds = (view.cloudy).then(|| CloudField::over(&*camera.sensor, &camera.crop, size, seed));
        let mut light = studio.light(request, &view.sun, view.geometry.zenith_rad(), seed);
        light.clouds = clouds;
        let exposure = studio.exposure(request, (&*camera.sensor, camera.crop), &light, seed);
        let mut image = render(scene, &exposure, rows_done);
        let stretch = (request.has(Fault::Stretch)).then(|| faults::stretch(&mut image.counts, request.bands, seed));
        let (view, image) = match request.delivery {
            Delivery::Whole => (view.clone(), image),
            Delivery::PanMs => {
                let (coarse, rpc, canvas) =
                    delivery::multispectral(&image, request.bands, (&camera.rpc, camera.canvas));
                self.write_counts(
                    &format!("{}-M1BS", view.name),
                    view,
                    &coarse,
                    request.bands,
                    (&rpc, canvas),
                )?;
                let exposure = delivery::panchromatic_exposure(&exposure);
                let pan = render(scene, &exposure, &mut |_| ());
                (delivery::panchromatic_view(view), pan)
            }
        };
        self.write_image(&view, camera, &image)?;
        Ok(ImageSummary {
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
            shadow_share: share_of(&image.shadow, 1),
            cloud_share: share_of(&image.cloud, 1),
            band_gains: studio
                .band_gains
                .map_or_else(Vec::new, |gains| gains[..request.bands.names().len()].to_vec()),
            haze: studio.haze,
            stretch,
            name: view.name,
            time: view.time,
            date: view.date,
            held_out: view.held_out,
        })
    }

    fn write_image(&self, view: &ViewPlan, camera: &ImageCamera, image: &Image) -> Result<(), SynthError> {
        let (name, place) = (&view.name, (&camera.rpc, camera.canvas));
        let bands = self.request.delivery.main_bands(self.request.bands);
        self.write_counts(name, view, image, bands, place)?;
        let write_mask = |kind: &str, mask: &[u8], about: &str| {
            let raster = Raster {
                samples: Samples::U8(mask),
                bands: &[kind],
                items: &[("DESCRIPTION", about)],
                ..raster_of(image, place)
            };
            write(&self.staging.path(&format!("truth/{kind}_{name}.tif"))?, &raster)
        };
        write_mask("shadow", &image.shadow, SHADOW_MEANS)?;
        if view.cloudy {
            let about = "1 where clouds hide a tenth of the pixel or more";
            write_mask("cloud", &image.cloud, about)?;
        }
        let json = satnerf_json(view, (&camera.crop, camera.canvas), &camera.rpc, self.altitudes_m)
            .map_err(SynthError::camera(name))?;
        self.staging.text(&format!("{name}.json"), &format!("{json:#}\n"))
    }

    /// Writes the counts of an image of a view to the file `name`, with the RPC and the canvas `place`.
    fn write_counts(
        &self,
        name: &str,
        view: &ViewPlan,
        image: &Image,
        bands: BandSet,
        place: (&Rpc, Option<Canvas>),
    ) -> Result<(), SynthError> {
        let items = image_items(view, self.request, share_of(&image.cloud, 1));
        let mut bytes = Vec::new();
        let raster = Raster {
            samples: Samples::of_counts(&image.counts, self.request.file_bits(), &mut bytes),
            bands: bands.names(),
            items: &borrowed(&items),
            nodata: place.1.map(|_| 0.0),
            ..raster_of(image, place)
        };
        write(&self.staging.path(&format!("{name}.tif"))?, &raster)
    }
}

/// Raster of an image with an RPC and a canvas, yet without samples.
fn raster_of<'a>(image: &Image, (rpc, canvas): (&Rpc, Option<Canvas>)) -> Raster<'a> {
    Raster {
        width: image.width,
        height: image.height,
        samples: Samples::U8(&[]),
        bands: &[],
        items: &[],
        rpc: Some(heliosplat_rpc::write::geotiff_tag(rpc)),
        grid: None,
        nodata: None,
        canvas,
    }
}

/// Scene of solids of the city, with solar panels on some roofs if glossy surfaces are requested.
fn scene_of<'a>(request: &SatelliteRequest, city: &'a City, mut solids: Solids) -> LitScene<'a> {
    if request.has(Fault::Glossy) {
        solids.lay_panels();
    }
    LitScene::new(&city.terrain, solids, &city.ground)
}

/// The sensor of a view, the crop that covers the site at all altitudes, and the RPC a vendor would deliver with it.
fn camera(request: &SatelliteRequest, nadir: &NadirSensor, view: &ViewPlan) -> Result<ImageCamera, SynthError> {
    let (fault, frame) = (SynthError::camera(&view.name), &nadir.frame);
    let (sensor, crop, fit): (Box<dyn Sensor>, _, _) = match &view.known {
        None => {
            let sensor = PushBroom::new(frame, &view.geometry, view.aim_px);
            let crop = crop_of(request, nadir, |point| sensor.project(point));
            let fit = sensor.fit_rational_camera(frame).map_err(&fault)?;
            (Box::new(sensor), crop, fit)
        }
        Some(rpc) => {
            let crop = crop_of(request, nadir, |point| rational::project(rpc, frame, point));
            let sensor = RationalSensor::new(rpc, frame, &crop).map_err(&fault)?;
            let fit = RpcFit {
                rpc: rpc.clone(),
                rms_px: 0.0,
                max_px: 0.0,
            };
            (Box::new(sensor), crop, fit)
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
        let [width, height] = [crop.width, crop.height];
        SynthError::BadRequest(format!("a canvas of {size} px, but an image has {width} x {height} px"))
    })
}

/// The window that shows the site at all its altitudes in the image plane of `project`, or, with a requested size, its
/// middle.
fn crop_of(request: &SatelliteRequest, nadir: &NadirSensor, project: impl Fn(Vector3<f64>) -> [f64; 2]) -> Crop {
    let side = nadir.grid.size as f64;
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for corner in [[0.0, 0.0], [side, 0.0], [0.0, side], [side, side]] {
        for altitude_m in request.site.covered_altitudes_m() {
            let pixel = project(nadir.point(corner, altitude_m));
            for k in 0..2 {
                low[k] = low[k].min(pixel[k]);
                high[k] = high[k].max(pixel[k]);
            }
        }
    }
    let first = [0, 1].map(|k| match request.size_px {
        Some(size) => (0.5 * (low[k] + high[k]) - 0.5 * (size as f64 - 1.0)).round(),
        None => (low[k] - MARGIN_PX).floor(),
    });
    let length = |k: usize| ((high[k] + MARGIN_PX).ceil() - first[k]) as usize + 1;
    Crop {
        col0: first[0],
        row0: first[1],
        width: request.size_px.unwrap_or_else(|| length(0)),
        height: request.size_px.unwrap_or_else(|| length(1)),
    }
}

/// Plan of a city that extends beyond every image.
fn city_plan(request: &SatelliteRequest, cameras: &[ImageCamera]) -> CityPlan {
    let mut reach_m = 0.5 * request.site.extent_m();
    let [lowest_m, _] = request.site.covered_altitudes_m();
    for ImageCamera { sensor, crop, .. } in cameras {
        for (col, row) in [(0, 0), (crop.width, 0), (0, crop.height), (crop.width, crop.height)] {
            let ray = sensor.rays_of_line(crop.row0 + row as f64)(crop.col0 + col as f64);
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
fn survey_city(request: &SatelliteRequest, city: &City, nadir: &NadirSensor, date: usize) -> Truth {
    let bare = LitScene::new(&city.terrain, Solids::default(), &city.ground);
    Truth {
        ground_m: altitudes(&bare, nadir),
        ..survey(&scene_of(request, city, city.solids(date)), nadir, request.bands)
    }
}

/// The day, as YYYYMMDD, of the first image that shows the new state of each cell of the grid; 0 where nothing is built
/// or torn down.
fn changed_at(city: &City, collection: &Collection, nadir: &NadirSensor) -> Vec<f64> {
    let day = |date: usize| {
        let day = collection.dates[date].time.to_zoned(TimeZone::UTC).date();
        f64::from(i32::from(day.year()) * 10_000 + i32::from(day.month()) * 100 + i32::from(day.day()))
    };
    nadir.of_cells(|centre| {
        let at = nadir.point(centre, 0.0);
        city.changed_at(at.x, at.y).map_or(0.0, day)
    })
}

/// The image with the highest sun.
fn highest_sun(collection: &Collection) -> Option<usize> {
    let height = |index: usize| collection.views[index].sun.elevation_rad;
    (0..collection.views.len()).max_by(|&a, &b| height(a).total_cmp(&height(b)))
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

/// Share of a mask or of classes that has a value.
fn share_of(values: &[u8], wanted: u8) -> f64 {
    values.iter().filter(|&&value| value == wanted).count() as f64 / values.len().max(1) as f64
}

fn class_share(truth: &Truth) -> BTreeMap<String, f64> {
    let share = |&(class, name): &(Class, &str)| (name.to_string(), share_of(&truth.class, class as u8));
    let shares = Class::NAMES.iter().map(share);
    shares.filter(|(_, share)| *share > 0.0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nadir(collection: &Collection, extent_m: f64, cell_m: f64) -> NadirSensor {
        NadirSensor {
            frame: LocalFrame::new(collection.origin),
            grid: TruthGrid::around(collection.origin, extent_m, cell_m),
        }
    }

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
            let nadir = nadir(&collection, 128.0, 1.0);
            let plan = CityPlan {
                half_extent_m: 100.0,
                longest_block_m: 92.0,
                town: false,
                cover: None,
            };
            let truth = survey_city(&request, &City::new(seed, plan), &nadir, 0);
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
                let nadir = nadir(&collection, site.extent_m(), 4.0);
                let plan = CityPlan {
                    half_extent_m: 0.5 * site.extent_m() + 20.0,
                    longest_block_m: 70.0,
                    town: site == Site::District,
                    cover: None,
                };
                let truth = survey_city(&request, &City::new(seed, plan), &nadir, 0);
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
        let extent_m = request.site.extent_m();
        let nadir = nadir(&collection, extent_m, 4.0);
        let plan = CityPlan {
            half_extent_m: 0.5 * extent_m,
            longest_block_m: 92.0,
            town: true,
            cover: None,
        };
        let truth = survey_city(&request, &City::new(41, plan), &nadir, 0);
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
                let nadir = nadir(&collection, site.extent_m(), request.gsd());
                for view in &collection.views {
                    let rpc = camera(&request, &nadir, view).expect("a camera").rpc;
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
