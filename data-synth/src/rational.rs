//! A camera given only as an RPC: the real camera of a real image, applied to a synthetic site.

use crate::crop::Crop;
use crate::ray::Ray;
use heliosplat_rpc::{ImagePoint, LocalFrame, Rpc, RpcError};
use nalgebra::Vector3;

/// Distance between the nodes where rays are computed from the camera, pixels. Rays between them are interpolated: over
/// so few of the tens of thousands of pixels of a full scene a camera deviates from linear by far less than a
/// thousandth of a pixel.
const NODE_PX: f64 = 32.0;
/// Heights above and below the frame's origin between which a ray is assumed to be straight, metres.
const SPAN_M: f64 = 150.0;

/// The camera of a crop, in the scene's frame. Lines and samples are those of the whole image.
#[derive(Debug, Clone)]
pub(crate) struct RationalSensor {
    corner: [f64; 2],
    columns: usize,
    /// Places high above and deep below the ground that each node sees.
    nodes: Vec<[Vector3<f64>; 2]>,
}

/// (sample, line) at which `rpc` sees a point of `frame`.
pub(crate) fn project(rpc: &Rpc, frame: &LocalFrame, point: Vector3<f64>) -> [f64; 2] {
    let ImagePoint { col, row } = rpc.project(frame.geo_from_enu(point));
    [col, row]
}

impl RationalSensor {
    /// The camera `rpc` over `crop` and a little around it.
    ///
    /// # Errors
    /// When the camera cannot be localised at a pixel of the crop.
    pub(crate) fn new(rpc: &Rpc, frame: &LocalFrame, crop: &Crop) -> Result<Self, RpcError> {
        let corner = [crop.col0 - NODE_PX, crop.row0 - NODE_PX];
        let nodes_along = |pixels: usize| (pixels as f64 / NODE_PX).ceil() as usize + 4;
        let (columns, rows) = (nodes_along(crop.width), nodes_along(crop.height));
        let place = |node: usize, up_m: f64| {
            let (col, row) = ((node % columns) as f64, (node / columns) as f64);
            let point = ImagePoint::new(corner[0] + NODE_PX * col, corner[1] + NODE_PX * row);
            let ground = rpc.localise(point, frame.origin.height_m + up_m)?;
            Ok(frame.enu_from_geo(ground))
        };
        let nodes = (0..columns * rows)
            .map(|node| Ok([place(node, SPAN_M)?, place(node, -SPAN_M)?]))
            .collect::<Result<Vec<_>, RpcError>>()?;
        Ok(Self { corner, columns, nodes })
    }

    /// The ray of a (fractional) sample of a (fractional) line, from high above the ground.
    pub(crate) fn ray(&self, sample: f64, line: f64) -> Ray {
        let rows = self.nodes.len() / self.columns;
        let at = |value: f64, corner: f64, count: usize| {
            let nodes = (value - corner) / NODE_PX;
            let first = nodes.floor().clamp(0.0, (count - 2) as f64);
            (first as usize, nodes - first)
        };
        let (c, fc) = at(sample, self.corner[0], self.columns);
        let (r, fr) = at(line, self.corner[1], rows);
        let between = |end: usize| {
            let node = |dc: usize, dr: usize| self.nodes[(r + dr) * self.columns + c + dc][end];
            let upper = node(0, 0).lerp(&node(1, 0), fc);
            upper.lerp(&node(0, 1).lerp(&node(1, 1), fc), fr)
        };
        let (high, low) = (between(0), between(1));
        Ray::new(high, (low - high).normalize())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{PushBroom, ViewGeometry};
    use heliosplat_rpc::GeoPoint;

    #[test]
    fn rays_pass_through_what_the_camera_projects_to_their_pixel() {
        let frame = LocalFrame::new(GeoPoint::new(-58.6, -34.45, 30.0));
        let view = ViewGeometry {
            azimuth_rad: 1.0,
            off_nadir_rad: 0.5,
            orbit_m: 617e3,
            tilt_rad: 0.1,
            gsd_m: 0.4,
            full_px: 9000.0,
            seed: 5,
        };
        let sensor = PushBroom::new(&frame, &view, [4000.0, 5000.0]);
        let rpc = sensor.fit_rational_camera(&frame).expect("a camera").rpc;
        let [col, row] = project(&rpc, &frame, Vector3::zeros()).map(f64::floor);
        let crop = Crop {
            col0: col - 150.0,
            row0: row - 150.0,
            width: 301,
            height: 301,
        };
        let seen = RationalSensor::new(&rpc, &frame, &crop).expect("a camera over the site");
        for k in 0..200 {
            let sample = crop.col0 - 20.0 + 340.0 * (f64::from(k) * 0.618_03).fract();
            let line = crop.row0 - 20.0 + 340.0 * (f64::from(k) * 0.754_88).fract();
            let ray = seen.ray(sample, line);
            for up_m in [-20.0, 0.0, 60.0] {
                let point = ray.at((up_m - ray.origin.z) / ray.direction.z);
                let [sample_back, line_back] = project(&rpc, &frame, point);
                let error_px = (sample_back - sample).hypot(line_back - line);
                assert!(error_px < 2e-3, "{error_px} px at {sample}, {line}, {up_m} m");
            }
        }
    }
}
