//! A push-broom on a circular orbit over the WGS84 ellipsoid: cameras whose truth needs no shared data.

use heliosplat_rpc::frame::{ecef_from_geo, geo_from_ecef};
use heliosplat_rpc::{GeoPoint, ImagePoint, LocalFrame};
use nalgebra::Vector3;

/// A sensor that looks at `target` from a southward orbit, one row per line of time.
pub struct PushBroom {
    target: GeoPoint,
    /// Ground per pixel, metres.
    pub ground_sample_m: f64,
    /// Rows and columns.
    pub size: usize,
    /// Off-nadir angles to the side and along the track, radians.
    pub roll_rad: f64,
    pub pitch_rad: f64,
}

const ORBIT_HEIGHT_M: f64 = 694_000.0;

impl PushBroom {
    pub fn over(lon_deg: f64, lat_deg: f64) -> Self {
        Self {
            target: GeoPoint::new(lon_deg, lat_deg, 100.0),
            ground_sample_m: 0.5,
            size: 4_000,
            roll_rad: 0.25,
            pitch_rad: -0.15,
        }
    }

    /// Position of the sensor and direction of a pixel, Earth-centred.
    fn ray(&self, image: ImagePoint) -> (Vector3<f64>, Vector3<f64>) {
        let frame = LocalFrame::new(self.target);
        let to_ecef = frame.enu_from_ecef_rotation().transpose();
        let half = 0.5 * self.size as f64;
        // The orbit's arc angle of this row, and the pixel's angle across the track.
        let radius_m = ecef_from_geo(self.target).norm() + ORBIT_HEIGHT_M;
        let arc_rad = (image.row - half) * self.ground_sample_m / 6_371_000.0;
        let across_rad = (image.col - half) * self.ground_sample_m / ORBIT_HEIGHT_M;
        // Position of a sensor straight above, moved so that the middle pixel sees the target.
        let side_m = -ORBIT_HEIGHT_M * self.roll_rad.tan();
        let ahead_m = ORBIT_HEIGHT_M * self.pitch_rad.tan() / self.roll_rad.cos();
        let position_enu = Vector3::new(side_m, ahead_m, ORBIT_HEIGHT_M)
            + Vector3::new(0.0, -radius_m * arc_rad.sin(), radius_m * (arc_rad.cos() - 1.0));
        let middle = -Vector3::new(side_m, ahead_m, ORBIT_HEIGHT_M).normalize();
        let across = Vector3::new(1.0, 0.0, 0.0);
        // The whole sensor turns with the orbit, and a little yaw drift bends the image.
        let drift = 2e-7 * (image.row / half - 1.0).powi(2);
        let turned = middle + across * (across_rad + drift);
        let (sin, cos) = arc_rad.sin_cos();
        let turned = Vector3::new(
            turned.x,
            turned.y * cos + turned.z * sin,
            turned.z * cos - turned.y * sin,
        );
        (
            ecef_from_geo(self.target) + to_ecef * position_enu,
            to_ecef * turned.normalize(),
        )
    }

    /// The ground point at `height_m` that a pixel sees.
    pub fn ground(&self, image: ImagePoint, height_m: f64) -> GeoPoint {
        let (position, direction) = self.ray(image);
        let mut distance_m = ORBIT_HEIGHT_M;
        for _ in 0..50 {
            let point = geo_from_ecef(position + direction * distance_m);
            let up = LocalFrame::new(point).enu_from_ecef_rotation().row(2).transpose();
            distance_m -= (point.height_m - height_m) / direction.dot(&up);
        }
        let point = geo_from_ecef(position + direction * distance_m);
        assert!((point.height_m - height_m).abs() < 1e-6);
        point
    }

    /// A grid of pixels seen at several heights.
    pub fn samples(&self, across: usize, heights_m: &[f64]) -> Vec<(GeoPoint, ImagePoint)> {
        let mut samples = Vec::new();
        for height_m in heights_m {
            for i in 0..across {
                for j in 0..across {
                    let at = |k: usize| self.size as f64 * k as f64 / (across - 1) as f64;
                    let image = ImagePoint { col: at(j), row: at(i) };
                    samples.push((self.ground(image, *height_m), image));
                }
            }
        }
        samples
    }
}
