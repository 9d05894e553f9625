//! Acquisition plan: place of the site, dates, viewing directions and weather.

use crate::error::SynthError;
use crate::known::{self, KnownCamera};
use crate::materials::Season;
use crate::noise::{hash2, stream};
use crate::radiometry::Weather;
use crate::request::SatelliteRequest;
use crate::sensor::ViewGeometry;
use heliosplat_rpc::sun::{SunPosition, sun_position};
use heliosplat_rpc::{GeoPoint, ImagePoint, LocalFrame, Rpc};
use jiff::{SignedDuration, Timestamp};
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64Mcg;

/// Longitude, latitude and ellipsoidal altitude of places where people live.
const PLACES: [[f64; 3]; 14] = [
    [-81.66, 30.33, 12.0],
    [4.85, 45.75, 225.0],
    [-3.70, 40.42, 705.0],
    [135.50, 34.69, 50.0],
    [150.95, -33.83, 55.0],
    [-58.45, -34.61, 35.0],
    [11.57, 48.14, 565.0],
    [-96.00, 41.26, 290.0],
    [18.50, -33.93, 60.0],
    [-7.60, 33.57, 80.0],
    [69.28, 41.31, 430.0],
    [-47.06, -22.90, 690.0],
    [-73.60, 45.50, 20.0],
    [78.47, 17.40, 450.0],
];

/// Suns lower than this are not photographed, degrees.
const LOWEST_SUN_DEG: f64 = 22.0;
/// Off-nadir angles of real collections over a site, degrees.
const OFF_NADIR_DEG: [f64; 2] = [5.0, 30.0];
/// The vendor's full scene is this many times as wide as the image, and at least this many pixels.
const FULL_SCENE_FACTOR: f64 = 8.0;
const FULL_SCENE_LEAST_PX: f64 = 2400.0;

/// Common data of all images of one date.
#[derive(Debug, Clone)]
pub(crate) struct DatePlan {
    /// Time of the first image of the date.
    pub(crate) time: Timestamp,
    /// Season, air, exposure and water of the date.
    pub(crate) weather: Weather,
    /// Share of the bays that hold a car, 0 to 1.
    pub(crate) car_occupancy: f64,
}

/// One image.
#[derive(Debug, Clone)]
pub(crate) struct ViewPlan {
    /// File name without extension.
    pub(crate) name: String,
    /// Index into the dates.
    pub(crate) date: usize,
    /// Acquisition time.
    pub(crate) time: Timestamp,
    /// Position of the sun at that time.
    pub(crate) sun: SunPosition,
    /// Viewing geometry; for the camera of a real image, an estimate from its RPC.
    pub(crate) geometry: ViewGeometry,
    /// Pixel (sample, line) of the full scene that sees the site's centre.
    pub(crate) aim_px: [f64; 2],
    /// Constant error (column, row) added to the RPC, pixels: the truth for bias correction.
    pub(crate) rpc_bias_px: [f64; 2],
    /// True if the image is held out for testing.
    pub(crate) held_out: bool,
    /// True if clouds are in view.
    pub(crate) cloudy: bool,
    /// RPC of a real image, if the view has one.
    pub(crate) known: Option<Rpc>,
}

impl ViewPlan {
    /// A training image of a place under a clear sky, without a name.
    fn new(date: usize, time: Timestamp, place: GeoPoint, geometry: ViewGeometry) -> Self {
        Self {
            name: String::new(),
            date,
            time,
            sun: sun_position(time, place),
            geometry,
            aim_px: [0.0; 2],
            rpc_bias_px: [0.0; 2],
            held_out: false,
            cloudy: false,
            known: None,
        }
    }
}

/// The whole collection.
#[derive(Debug, Clone)]
pub(crate) struct Collection {
    /// The site's centre, at about the altitude of its ground.
    pub(crate) origin: GeoPoint,
    /// Acquisition dates in order of time.
    pub(crate) dates: Vec<DatePlan>,
    /// Images in order of time.
    pub(crate) views: Vec<ViewPlan>,
}

impl Collection {
    /// Plans place, dates, views and weather of a request.
    ///
    /// # Errors
    /// When the cameras of the request cannot be used, or are fewer than its views, or when it has clouds in more
    /// images than there are training images.
    pub(crate) fn new(request: &SatelliteRequest) -> Result<Self, SynthError> {
        let mut collection = match &request.cameras {
            None => Self::made_up(request),
            Some(path) => Self::through(request, known::read(path)?)?,
        };
        cloud_over(&mut collection.views, request)?;
        Ok(collection)
    }

    /// The dates on which buildings may change: those with at least two images to train with before them, and two from
    /// them on.
    ///
    /// # Errors
    /// [`SynthError::BadRequest`] when there is none.
    pub(crate) fn dates_of_change(&self) -> Result<Vec<usize>, SynthError> {
        const EACH_SIDE: usize = 2;
        let images = |side: &dyn Fn(usize) -> bool| {
            let training = self.views.iter().filter(|view| !view.held_out);
            training.filter(|view| side(view.date)).count()
        };
        let on: Vec<usize> = (1..self.dates.len())
            .filter(|&date| images(&|of| of < date) >= EACH_SIDE && images(&|of| of >= date) >= EACH_SIDE)
            .collect();
        if on.is_empty() {
            return Err(SynthError::BadRequest(
                "a change, but no date has two images to train with before it and two from it on; ask for more views and dates".into(),
            ));
        }
        Ok(on)
    }

    /// Plans views through the cameras of real images.
    fn through(request: &SatelliteRequest, cameras: Vec<KnownCamera>) -> Result<Self, SynthError> {
        let (all, wanted) = (cameras.len(), request.views.unwrap_or(cameras.len()));
        if wanted > all {
            let reason = format!("{wanted} views; the file has {all} cameras");
            return Err(SynthError::BadRequest(reason));
        }
        let cameras = known::thinned(&cameras, wanted);
        let origin = known::common_centre(&cameras);
        let frame = LocalFrame::new(origin);
        let mut random = stream(request.seed, 0xC0);
        let (mut dates, mut views): (Vec<DatePlan>, Vec<ViewPlan>) = (Vec::new(), Vec::new());
        for (index, camera) in cameras.into_iter().enumerate() {
            let day = |time: Timestamp| time.as_second().div_euclid(86_400);
            if dates.last().is_none_or(|date| day(date.time) != day(camera.time)) {
                // Days are counted from 1 January 1970; the season depends only on the day of the year.
                let of_year = (camera.time.as_second() as f64 / 86_400.0).rem_euclid(365.25);
                dates.push(date_of(&mut random, camera.time, of_year, origin.lat_deg));
            }
            let geometry = geometry_of(&camera.rpc, &frame).map_err(SynthError::camera(&format!("camera {index}")))?;
            let geometry = ViewGeometry {
                seed: hash2(request.seed, 0x5E0 + index as u64),
                ..geometry
            };
            views.push(ViewPlan {
                known: Some(camera.rpc),
                ..ViewPlan::new(dates.len() - 1, camera.time, origin, geometry)
            });
        }
        finish(&mut views, request);
        Ok(Self { origin, dates, views })
    }

    fn made_up(request: &SatelliteRequest) -> Self {
        let mut random = stream(request.seed, 0xC0);
        let origin = place(&mut random);
        let mut dates: Vec<DatePlan> = (0..request.date_count())
            .map(|index| date_plan(&mut random, origin, index, request.date_count()))
            .collect();
        dates.sort_by_key(|date| date.time);
        let mut views = view_plans(request, &mut random, origin, &dates);
        finish(&mut views, request);
        Self { origin, dates, views }
    }
}

fn place(random: &mut Pcg64Mcg) -> GeoPoint {
    let [lon_deg, lat_deg, height_m] = PLACES[random.random_range(0..PLACES.len())];
    GeoPoint::new(
        lon_deg + random.random_range(-0.04..0.04),
        lat_deg + random.random_range(-0.04..0.04),
        height_m + random.random_range(0.0..60.0),
    )
}

/// Date in its share of two years, at 9:30 to 11:30 mean solar time, with the sun high enough.
fn date_plan(random: &mut Pcg64Mcg, origin: GeoPoint, index: usize, count: usize) -> DatePlan {
    const DAYS: f64 = 730.0;
    const FIRST_JANUARY_2016: i64 = 1_451_606_400;
    let mut best = (f64::NEG_INFINITY, 0.0, Timestamp::UNIX_EPOCH);
    for attempt in 0..60 {
        // The search widens beyond the share of the two years if its season has no high sun.
        let spread = (1.0 + 0.1 * f64::from(attempt)).min(count as f64);
        let share = (index as f64 + 0.5 + spread * random.random_range(-0.5..0.5)) / count as f64;
        let day = (share * DAYS).rem_euclid(DAYS).floor();
        let solar_hours: f64 = random.random_range(9.5..11.5);
        let seconds = day * 86_400.0 + (solar_hours - origin.lon_deg / 15.0) * 3600.0;
        let time = Timestamp::from_second(FIRST_JANUARY_2016 + seconds as i64).unwrap_or(Timestamp::UNIX_EPOCH);
        let elevation_deg = sun_position(time, origin).elevation_rad.to_degrees();
        if elevation_deg > best.0 {
            best = (elevation_deg, day, time);
        }
        if elevation_deg > LOWEST_SUN_DEG {
            break;
        }
    }
    let (_, day, time) = best;
    date_of(random, time, day, origin.lat_deg)
}

/// The season and the weather of a day, counted from a first of January.
fn date_of(random: &mut Pcg64Mcg, time: Timestamp, day: f64, lat_deg: f64) -> DatePlan {
    DatePlan {
        time,
        weather: Weather {
            season: season(random, day, lat_deg),
            aerosol: random.random_range(0.03..0.16),
            exposure: random.random_range(0.86..1.14),
            water_slope_variance: random.random_range(0.008..0.03),
            water_turbidity: random.random_range(0.7..1.8),
            seed: random.random(),
        },
        car_occupancy: random.random_range(0.4..0.7),
    }
}

/// Summer peaks in mid-July or mid-January; leaves colour some hundred days later; the tropics stay green.
fn season(random: &mut Pcg64Mcg, day: f64, lat_deg: f64) -> Season {
    let peak = if lat_deg >= 0.0 { 196.0 } else { 14.0 };
    let turn = |from: f64| (std::f64::consts::TAU * (day - from) / 365.25).cos();
    let swing = (lat_deg.abs() / 45.0).clamp(0.15, 1.0);
    let dryness: f64 = random.random_range(0.05..0.6);
    Season {
        green: 1.0 - swing * (0.5 - 0.5 * turn(peak)),
        autumn: swing * turn(peak + 105.0).max(0.0).powi(6),
        dry: (0.1 + dryness * turn(peak + 25.0).max(0.0)).clamp(0.0, 0.7),
    }
}

fn view_plans(
    request: &SatelliteRequest,
    random: &mut Pcg64Mcg,
    origin: GeoPoint,
    dates: &[DatePlan],
) -> Vec<ViewPlan> {
    let count = request.view_count();
    let mut order: Vec<usize> = (0..count).collect();
    order.shuffle(random);
    let first_azimuth_deg: f64 = random.random_range(0.0..360.0);
    // Without a requested size, a first guess at the width of the images.
    let guess_px = 1.3 * request.site.extent_m() / request.gsd();
    let full_px = (FULL_SCENE_FACTOR * request.size_px.map_or(guess_px, |size| size as f64))
        .max(FULL_SCENE_LEAST_PX)
        // An RPC holds little beyond the scene that it was fitted over.
        .max(request.canvas_px.unwrap_or(0) as f64)
        .round();
    let mut views: Vec<ViewPlan> = (0..count)
        .map(|index| {
            let date = index % dates.len();
            // Later images of a date are taken from the same pass, about a minute on.
            let delay_s = (index / dates.len()) as i64 * random.random_range(45..100);
            let time = dates[date].time + SignedDuration::from_secs(delay_s);
            // Golden angle: azimuths spread evenly for any number of views.
            let azimuth_deg = first_azimuth_deg + 137.508 * index as f64 + random.random_range(-15.0..15.0);
            let share = (order[index] as f64 + random.random_range(0.0..1.0)) / count as f64;
            let off_nadir_deg = OFF_NADIR_DEG[0] + share * (OFF_NADIR_DEG[1] - OFF_NADIR_DEG[0]);
            let coarser = 0.98 + 0.06 * (off_nadir_deg / 30.0).powi(2);
            let geometry = ViewGeometry {
                azimuth_rad: azimuth_deg.rem_euclid(360.0).to_radians(),
                off_nadir_rad: off_nadir_deg.to_radians(),
                orbit_m: random.random_range(500e3..770e3),
                tilt_rad: random.random_range(-0.14..0.14),
                gsd_m: request.gsd() * coarser,
                full_px,
                seed: hash2(request.seed, 0x5E0 + index as u64),
            };
            ViewPlan {
                aim_px: [0, 1].map(|_| full_px * random.random_range(0.3..0.7)),
                ..ViewPlan::new(date, time, origin, geometry)
            }
        })
        .collect();
    views.sort_by_key(|view| view.time);
    views
}

/// Names, held-out images and biases of the cameras.
fn finish(views: &mut [ViewPlan], request: &SatelliteRequest) {
    for (index, view) in views.iter_mut().enumerate() {
        view.name = format!("{}_{:03}_{:02}", request.site.name(), request.seed, index);
    }
    hold_out(views, SatelliteRequest::test_count(views.len()));
    bias(views, request);
}

/// Direction of a real camera from the origin of `frame`, at the height of WorldView-3's orbit.
fn geometry_of(rpc: &Rpc, frame: &LocalFrame) -> Result<ViewGeometry, heliosplat_rpc::RpcError> {
    const ORBIT_M: f64 = 617e3;
    const EARTH_RADIUS_M: f64 = 6_371_000.0;
    const SPAN_M: f64 = 100.0;
    let middle = rpc.project(frame.origin);
    let ground = |col: f64, row: f64, up_m: f64| {
        let point = ImagePoint::new(middle.col + col, middle.row + row);
        let height_m = frame.origin.height_m + up_m;
        rpc.localise(point, height_m).map(|point| frame.enu_from_geo(point))
    };
    let here = ground(0.0, 0.0, 0.0)?;
    let (right, below) = (ground(1.0, 0.0, 0.0)? - here, ground(0.0, 1.0, 0.0)? - here);
    let sight = (ground(0.0, 0.0, SPAN_M)? - here).normalize();
    Ok(ViewGeometry {
        azimuth_rad: sight.x.atan2(sight.y).rem_euclid(std::f64::consts::TAU),
        off_nadir_rad: (sight.x.hypot(sight.y) / (1.0 + ORBIT_M / EARTH_RADIUS_M)).asin(),
        orbit_m: ORBIT_M,
        tilt_rad: right.y.atan2(right.x),
        gsd_m: (right.norm() * below.norm()).sqrt(),
        full_px: rpc.sample_scale * 2.0,
        seed: 0,
    })
}

/// Holds out images at moderate angles on dates that also have training images, so that training images show their
/// weather.
fn hold_out(views: &mut [ViewPlan], count: usize) {
    let images_of_date = |date: usize| views.iter().filter(|view| view.date == date).count();
    let mut candidates: Vec<(bool, f64, usize)> = (views.iter().enumerate())
        .map(|(index, view)| {
            let off_nadir_deg = view.geometry.off_nadir_rad.to_degrees();
            (images_of_date(view.date) < 2, (off_nadir_deg - 15.0).abs(), index)
        })
        .collect();
    candidates.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut taken_dates = Vec::new();
    for (_, _, index) in candidates {
        if taken_dates.len() == count {
            break;
        }
        if !taken_dates.contains(&views[index].date) {
            taken_dates.push(views[index].date);
            views[index].held_out = true;
        }
    }
}

/// Puts clouds into the requested number of training images. Held-out images stay clear, since they serve as reference.
fn cloud_over(views: &mut [ViewPlan], request: &SatelliteRequest) -> Result<(), SynthError> {
    let mut training: Vec<&mut ViewPlan> = views.iter_mut().filter(|view| !view.held_out).collect();
    let cloudy = request.cloudy_images(training.len());
    let (asked, most) = (request.clouds, training.len());
    if cloudy > most {
        let reason = format!("clouds in {asked} images; ask for 0 to {most}, the images to train with");
        return Err(SynthError::BadRequest(reason));
    }
    training.shuffle(&mut stream(request.seed, 0xC10D));
    for view in training.into_iter().take(cloudy) {
        view.cloudy = true;
    }
    Ok(())
}

/// Sets the RPC biases: shifts in random directions, with random lengths of the requested root mean square.
fn bias(views: &mut [ViewPlan], request: &SatelliteRequest) {
    let mut random = stream(request.seed, 0xB1A5);
    let shifts: Vec<[f64; 2]> = (0..views.len())
        .map(|_| {
            let direction: f64 = random.random_range(0.0..std::f64::consts::TAU);
            let length: f64 = random.random_range(0.3..1.3);
            [length * direction.cos(), length * direction.sin()]
        })
        .collect();
    let mean_square = shifts.iter().map(|[c, r]| c * c + r * r).sum::<f64>() / shifts.len().max(1) as f64;
    let scale = request.pointing_bias_px / mean_square.sqrt();
    for (view, shift) in views.iter_mut().zip(shifts) {
        view.rpc_bias_px = shift.map(|s| s * scale);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_date_has_a_high_sun_in_the_morning_and_every_view_its_angles() {
        for seed in 0..30 {
            let collection = Collection::made_up(&SatelliteRequest {
                seed,
                ..Default::default()
            });
            assert_eq!(collection.views.len(), 12);
            assert_eq!(collection.dates.len(), 7);
            for view in &collection.views {
                let elevation_deg = view.sun.elevation_rad.to_degrees();
                assert!(elevation_deg > 20.0, "seed {seed}: {elevation_deg}");
                let azimuth_deg = view.sun.azimuth_rad.to_degrees();
                let east = (0.0..180.0).contains(&azimuth_deg);
                assert!(east, "seed {seed}: a morning sun stands in the east, got {azimuth_deg}");
                assert!((5.0..=30.0).contains(&view.geometry.off_nadir_rad.to_degrees()));
            }
            let held_out: Vec<_> = collection.views.iter().filter(|view| view.held_out).collect();
            assert_eq!(held_out.len(), 2);
            for view in held_out {
                let shown = |other: &ViewPlan| other.date == view.date && !other.held_out;
                assert!(collection.views.iter().any(shown), "its date is also seen in training");
            }
        }
    }

    #[test]
    fn bias_has_the_root_mean_square_asked_for() {
        let request = SatelliteRequest {
            pointing_bias_px: 3.0,
            ..Default::default()
        };
        let views = Collection::made_up(&request).views;
        let square = |view: &ViewPlan| view.rpc_bias_px[0].powi(2) + view.rpc_bias_px[1].powi(2);
        let mean = views.iter().map(square).sum::<f64>() / views.len() as f64;
        assert!((mean.sqrt() - 3.0).abs() < 1e-12);
    }

    #[test]
    fn clouds_are_in_as_many_training_images_as_asked_for_and_others_join_when_more_are_asked_for() {
        let cloudy = |clouds: usize| -> Vec<usize> {
            let request = SatelliteRequest {
                clouds,
                ..Default::default()
            };
            let views = Collection::new(&request).expect("a plan").views;
            assert!(views.iter().all(|view| !(view.cloudy && view.held_out)));
            (0..views.len()).filter(|&index| views[index].cloudy).collect()
        };
        let mut before = cloudy(0);
        assert!(before.is_empty());
        for clouds in 1..=10 {
            let now = cloudy(clouds);
            assert_eq!(now.len(), clouds);
            assert_eq!(now, cloudy(clouds), "the same each time");
            assert!(before.iter().all(|index| now.contains(index)));
            before = now;
        }
    }

    #[test]
    fn one_view_and_one_date_per_view_can_be_planned() {
        for views in [1, 2, 5] {
            let request = SatelliteRequest {
                views: Some(views),
                dates: Some(20),
                ..Default::default()
            };
            let collection = Collection::made_up(&request);
            assert_eq!((collection.views.len(), collection.dates.len()), (views, views));
        }
    }
}
