//! A push-broom camera on a circular orbit: every line has its own moment, place and attitude.
//!
//! The satellite moves on a circle around the Earth's centre while the Earth turns under it; its attitude swings so
//! that the line of sight runs along the ground at the wanted rate, with small smooth errors in roll, pitch and yaw, a
//! trace of vibration, and a detector that is not perfectly straight. The rational camera that a vendor would deliver
//! is fitted to this model over a scene several times larger than the image, so it has residuals like those of a real
//! RPC.

use crate::nadir::NadirSensor;
use crate::noise::stream;
use crate::rational::RationalSensor;
use crate::ray::Ray;
use heliosplat_rpc::fit::{RpcFit, fit_rpc};
use heliosplat_rpc::{GeoPoint, ImagePoint, LocalFrame, RpcError};
use nalgebra::{Rotation3, Unit, Vector3};
use rand::RngExt;

const GRAVITY_M3_S2: f64 = 3.986_004_418e14;
const EARTH_TURN_RAD_S: f64 = 7.292_115e-5;
/// Inclination of a sun-synchronous orbit near 600 km.
const INCLINATION_DEG: f64 = 97.8;
/// Heights above and below the site over which vendors fit their cameras, metres.
const RPC_HEIGHT_RANGE_M: f64 = 500.0;

/// Viewing geometry that the sensor must realise.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ViewGeometry {
    /// Direction in which the satellite stands, clockwise from north, radians.
    pub(crate) azimuth_rad: f64,
    /// Angle between the nadir and the line of sight at the satellite, radians.
    pub(crate) off_nadir_rad: f64,
    /// Height of the orbit above the site, metres.
    pub(crate) orbit_m: f64,
    /// Direction of image columns on the ground, radians from east, counter-clockwise.
    pub(crate) tilt_rad: f64,
    /// Ground sampling distance, metres.
    pub(crate) gsd_m: f64,
    /// Side of the vendor's full scene, pixels.
    pub(crate) full_px: f64,
    /// Seed of errors of the sensor.
    pub(crate) seed: u64,
}

impl ViewGeometry {
    /// Angle at the site between the zenith and the satellite, on a round Earth, radians.
    pub(crate) fn zenith_rad(&self) -> f64 {
        const EARTH_RADIUS_M: f64 = 6_371_000.0;
        ((1.0 + self.orbit_m / EARTH_RADIUS_M) * self.off_nadir_rad.sin()).asin()
    }
}

/// The sensor in the scene's frame (east, north, up). Lines and samples are those of the vendor's full scene.
#[derive(Debug, Clone)]
pub(crate) struct PushBroom {
    earth_centre: Vector3<f64>,
    earth_axis: Unit<Vector3<f64>>,
    orbit_radius_m: f64,
    orbit_rate_rad_s: f64,
    radial: Vector3<f64>,
    forward: Vector3<f64>,
    line_period_s: f64,
    /// Ground point under the scene's centre.
    centre_ground: Vector3<f64>,
    columns_on_ground: Vector3<f64>,
    rows_on_ground: Vector3<f64>,
    gsd_m: f64,
    pixel_angle: f64,
    centre_px: f64,
    attitude: Attitude,
    /// Bend of the detector at its ends, pixels.
    detector_bend_px: f64,
}

/// Errors of the attitude as rotations about the axes of the camera, in pixels of the line of sight.
#[derive(Debug, Clone, Copy)]
struct Attitude {
    /// Coefficients of the first to third power of the scaled line, for each axis.
    drift_px: [[f64; 3]; 3],
    vibration_px: f64,
    vibration_cycles: f64,
    vibration_phase: f64,
}

/// A camera of any kind.
pub(crate) trait Sensor: Sync {
    /// The ray of each (fractional) sample of a (fractional) line.
    fn rays_of_line(&self, line: f64) -> Box<dyn Fn(f64) -> Ray + '_>;
}

impl Sensor for PushBroom {
    fn rays_of_line(&self, line: f64) -> Box<dyn Fn(f64) -> Ray + '_> {
        let state = self.at_line(line);
        Box::new(move |sample| self.ray(&state, sample))
    }
}

/// Camera of a real image, given as an RPC.
impl Sensor for RationalSensor {
    fn rays_of_line(&self, line: f64) -> Box<dyn Fn(f64) -> Ray + '_> {
        Box::new(move |sample| self.ray(sample, line))
    }
}

/// Straight down on every cell of a map grid.
impl Sensor for NadirSensor {
    fn rays_of_line(&self, line: f64) -> Box<dyn Fn(f64) -> Ray + '_> {
        Box::new(move |sample| self.ray(sample, line))
    }
}

/// The camera at the moment of one line.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LineState {
    position: Vector3<f64>,
    /// Along the detector, across it, and along the line of sight.
    axes: [Vector3<f64>; 3],
}

impl PushBroom {
    /// The sensor that sees the origin of `frame` at pixel `aim_px` (sample, line) of its full scene.
    pub(crate) fn new(frame: &LocalFrame, view: &ViewGeometry, aim_px: [f64; 2]) -> Self {
        let mut random = stream(view.seed, 0x5E);
        let (earth_centre, earth_axis) = earth_in(frame);
        let ground_radius_m = earth_centre.norm();
        let orbit_radius_m = ground_radius_m + view.orbit_m;
        let zenith_rad = (orbit_radius_m / ground_radius_m * view.off_nadir_rad.sin()).asin();
        let (sin_a, cos_a) = view.azimuth_rad.sin_cos();
        let sight = Vector3::new(zenith_rad.sin() * sin_a, zenith_rad.sin() * cos_a, zenith_rad.cos());
        let along = -earth_centre.dot(&sight);
        let range_m = (along * along + orbit_radius_m.powi(2) - ground_radius_m.powi(2)).sqrt() - along;
        let radial = (sight * range_m - earth_centre).normalize();
        let (sin_t, cos_t) = view.tilt_rad.sin_cos();
        let columns_on_ground = Vector3::new(cos_t, sin_t, 0.0);
        let rows_on_ground = Vector3::new(sin_t, -cos_t, 0.0);
        let centre_px = 0.5 * (view.full_px - 1.0);
        let offset_m =
            (columns_on_ground * (centre_px - aim_px[0]) + rows_on_ground * (centre_px - aim_px[1])) * view.gsd_m;
        let ground_speed_m_s = random.random_range(5500.0..7000.0);
        let cross = columns_on_ground.dot(&sight);
        Self {
            earth_centre,
            earth_axis,
            orbit_radius_m,
            orbit_rate_rad_s: (GRAVITY_M3_S2 / orbit_radius_m.powi(3)).sqrt(),
            radial,
            forward: heading(radial, earth_axis),
            line_period_s: view.gsd_m / ground_speed_m_s,
            centre_ground: offset_m,
            columns_on_ground,
            rows_on_ground,
            gsd_m: view.gsd_m,
            // The line of sight is slanted: the angle that covers one sampling distance along the detector.
            pixel_angle: view.gsd_m * (1.0 - cross * cross).sqrt() / range_m,
            centre_px,
            attitude: Attitude::new(&mut random),
            detector_bend_px: random.random_range(-0.5..0.5),
        }
    }

    /// The camera at a (fractional) line.
    pub(crate) fn at_line(&self, line: f64) -> LineState {
        let lines = line - self.centre_px;
        let time_s = lines * self.line_period_s;
        let (sin, cos) = (self.orbit_rate_rad_s * time_s).sin_cos();
        let inertial = (self.radial * cos + self.forward * sin) * self.orbit_radius_m;
        let turn = Rotation3::from_axis_angle(&self.earth_axis, -EARTH_TURN_RAD_S * time_s);
        let position = self.earth_centre + turn * inertial;
        let ground = self.centre_ground + self.rows_on_ground * (lines * self.gsd_m);
        let sight = (ground - position).normalize();
        let detector = (self.columns_on_ground - sight * self.columns_on_ground.dot(&sight)).normalize();
        let across = sight.cross(&detector);
        let error_px = self.attitude.error_px(lines / (self.centre_px + 0.5));
        // Roll and pitch move the line of sight by pixels; yaw moves the ends of the detector by pixels.
        let rotation = Rotation3::from_scaled_axis(
            (detector * error_px[0] + across * error_px[1] + sight * (error_px[2] / self.pixel_angle / self.centre_px))
                * self.pixel_angle,
        );
        LineState {
            position,
            axes: [detector, across, sight].map(|axis| rotation * axis),
        }
    }

    /// The direction seen by a (fractional) sample of a line, as a ray from the satellite.
    pub(crate) fn ray(&self, state: &LineState, sample: f64) -> Ray {
        let from_centre = sample - self.centre_px;
        let bent = from_centre + self.detector_bend_px * (from_centre / self.centre_px).powi(3);
        let sight = state.axes[2] + state.axes[0] * (bent * self.pixel_angle);
        Ray::new(state.position, sight.normalize())
    }

    /// (sample, line), pixels, at which a point of the scene is seen, by Newton's method on the moment of the line.
    pub(crate) fn project(&self, point: Vector3<f64>) -> [f64; 2] {
        let offset = |line: f64| {
            let state = self.at_line(line);
            let sight = point - state.position;
            let [along, across, depth] = state.axes.map(|axis| axis.dot(&sight));
            (along / depth / self.pixel_angle, across / depth / self.pixel_angle)
        };
        let mut line = self.centre_px;
        for _ in 0..8 {
            let (here, next) = (offset(line).1, offset(line + 1.0).1);
            let step = here / (next - here);
            line -= step;
            if step.abs() < 1e-9 {
                break;
            }
        }
        let bent = offset(line).0;
        let mut from_centre = bent;
        for _ in 0..4 {
            from_centre = bent - self.detector_bend_px * (from_centre / self.centre_px).powi(3);
        }
        [from_centre + self.centre_px, line]
    }

    /// RPC that a vendor would deliver with the full scene, fitted on a grid of rays and heights.
    ///
    /// # Errors
    /// When no RPC fits the rays.
    pub(crate) fn fit_rational_camera(&self, frame: &LocalFrame) -> Result<RpcFit, RpcError> {
        const STEPS: usize = 15;
        const HEIGHTS: usize = 7;
        let steps: [f64; STEPS] = std::array::from_fn(|k| 2.0 * self.centre_px * k as f64 / (STEPS - 1) as f64);
        let mut samples = Vec::with_capacity(STEPS * STEPS * HEIGHTS);
        for line in steps {
            let state = self.at_line(line);
            for sample in steps {
                let ray = self.ray(&state, sample);
                for k in 0..HEIGHTS {
                    let share = 2.0 * k as f64 / (HEIGHTS - 1) as f64 - 1.0;
                    let height_m = frame.origin.height_m + share * RPC_HEIGHT_RANGE_M;
                    let point = frame.geo_from_enu(ray.at(distance_to_height(frame, &ray, height_m)));
                    samples.push((point, ImagePoint { col: sample, row: line }));
                }
            }
        }
        fit_rpc(&samples)
    }
}

impl Attitude {
    fn new(random: &mut rand_pcg::Pcg64Mcg) -> Self {
        let drift_px = [0; 3].map(|_| [4.0, 2.0, 1.0].map(|most_px| random.random_range(-most_px..most_px)));
        Self {
            drift_px,
            vibration_px: random.random_range(0.005..0.02),
            vibration_cycles: random.random_range(1.5..3.0),
            vibration_phase: random.random_range(0.0..6.2),
        }
    }

    fn error_px(&self, scaled_line: f64) -> [f64; 3] {
        let s = scaled_line;
        let mut error_px = self.drift_px.map(|[a, b, c]| s * (a + s * (b + s * c)));
        let phase = self.vibration_phase + std::f64::consts::PI * self.vibration_cycles * s;
        error_px[0] += self.vibration_px * phase.sin();
        error_px[1] += self.vibration_px * (1.3 * phase).cos();
        error_px
    }
}

/// Distance along a downward ray to an ellipsoidal height, metres.
pub(crate) fn distance_to_height(frame: &LocalFrame, ray: &Ray, height_m: f64) -> f64 {
    let mut t = (height_m - frame.origin.height_m - ray.origin.z) / ray.direction.z;
    // The vertical leans by less than a thousandth over a scene: each step gains three digits.
    for _ in 0..8 {
        let error_m = height_m - frame.geo_from_enu(ray.at(t)).height_m;
        t += error_m / ray.direction.z;
        if error_m.abs() < 1e-9 {
            break;
        }
    }
    t
}

/// The Earth's centre and axis in a local frame.
fn earth_in(frame: &LocalFrame) -> (Vector3<f64>, Unit<Vector3<f64>>) {
    let [north, south] = [90.0, -90.0].map(|lat_deg| frame.enu_from_geo(GeoPoint::new(0.0, lat_deg, 0.0)));
    (0.5 * (north + south), Unit::new_normalize(north - south))
}

/// Direction of motion of a sun-synchronous satellite on its southbound (morning) pass.
fn heading(radial: Vector3<f64>, axis: Unit<Vector3<f64>>) -> Vector3<f64> {
    let north = (axis.into_inner() - radial * axis.dot(&radial)).normalize();
    let east = north.cross(&radial);
    let cos_latitude = axis.cross(&radial).norm();
    let sin_heading = (INCLINATION_DEG.to_radians().cos() / cos_latitude).clamp(-1.0, 1.0);
    (east * sin_heading - north * (1.0 - sin_heading * sin_heading).sqrt()).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensor(seed: u64) -> (LocalFrame, PushBroom, ViewGeometry) {
        let frame = LocalFrame::new(GeoPoint::new(4.85, 45.75, 220.0));
        let view = ViewGeometry {
            azimuth_rad: 2.0 + seed as f64,
            off_nadir_rad: 0.4,
            orbit_m: 617_000.0,
            tilt_rad: 0.1,
            gsd_m: 0.5,
            full_px: 2600.0,
            seed,
        };
        let sensor = PushBroom::new(&frame, &view, [900.0, 1500.0]);
        (frame, sensor, view)
    }

    #[test]
    fn projection_inverts_the_rays_of_every_line() {
        let (_, sensor, _) = sensor(1);
        for k in 0..60 {
            let (sample, line) = (f64::from(k) * 41.3, 2600.0 - f64::from(k) * 37.7);
            let ray = sensor.ray(&sensor.at_line(line), sample);
            for height_m in [-30.0, 0.0, 55.0] {
                let point = ray.at((height_m - ray.origin.z) / ray.direction.z);
                let [sample_back, line_back] = sensor.project(point);
                assert!((sample_back - sample).abs() < 1e-6, "{sample_back} {sample}");
                assert!((line_back - line).abs() < 1e-6, "{line_back} {line}");
            }
        }
    }

    #[test]
    fn pixels_are_as_far_apart_on_the_ground_as_asked_and_the_image_is_not_mirrored() {
        let (_, sensor, view) = sensor(2);
        let ground = |sample: f64, line: f64| {
            let ray = sensor.ray(&sensor.at_line(line), sample);
            ray.at(-ray.origin.z / ray.direction.z)
        };
        let (here, right, below) = (ground(900.0, 1500.0), ground(901.0, 1500.0), ground(900.0, 1501.0));
        assert!(((right - here).norm() - view.gsd_m).abs() < 0.01 * view.gsd_m);
        assert!(((below - here).norm() - view.gsd_m).abs() < 0.01 * view.gsd_m);
        assert!((right - here).x > 0.45 && (below - here).y < -0.45);
        assert!(here.norm() < 10.0, "aims at the origin to a few pixels: {here}");
    }

    #[test]
    fn satellite_stands_where_the_view_says() {
        let (_, sensor, view) = sensor(3);
        let position = sensor.at_line(1299.5).position;
        let azimuth_rad = position.x.atan2(position.y).rem_euclid(std::f64::consts::TAU);
        assert!((azimuth_rad - view.azimuth_rad.rem_euclid(std::f64::consts::TAU)).abs() < 0.01);
        let from_centre = (position - sensor.earth_centre).norm();
        assert!((from_centre - sensor.earth_centre.norm() - view.orbit_m).abs() < 1.0);
    }

    #[test]
    fn the_satellite_moves_at_orbital_speed_over_a_turning_earth() {
        let (_, sensor, _) = sensor(4);
        let step_m = sensor.at_line(1001.0).position - sensor.at_line(1000.0).position;
        let speed_m_s = step_m.norm() / sensor.line_period_s;
        assert!((7_300.0..7_800.0).contains(&speed_m_s), "{speed_m_s}");
        assert!(step_m.y < 0.0, "southbound in the morning");
    }

    #[test]
    fn the_fitted_rational_camera_is_imperfect_in_the_real_way() {
        for seed in 5..9 {
            let (frame, sensor, _) = sensor(seed);
            let fit = sensor.fit_rational_camera(&frame).expect("a camera");
            assert!((1e-4..0.03).contains(&fit.rms_px), "{}", fit.rms_px);
            // Between the samples of the fit too.
            for k in 0..300 {
                let share = |step: f64| (f64::from(k) * step).fract() - 0.5;
                let point = Vector3::new(
                    400.0 * share(0.618_03),
                    400.0 * share(0.754_88),
                    120.0 * share(0.569_84),
                );
                let [sample, line] = sensor.project(point);
                let by_rpc = fit.rpc.project(frame.geo_from_enu(point));
                assert!((by_rpc.col - sample).hypot(by_rpc.row - line) < 0.05);
            }
        }
    }
}
