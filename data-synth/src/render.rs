//! Images: the sensor's rays, a point spread wider than a pixel, noise, and counts of 8 or 16 bits.

use crate::clouds;
use crate::crop::Crop;
use crate::encoding::{Encoding, bands_of};
use crate::noise::{hash2, normal, unit};
use crate::radiometry::{Illumination, LitScene, SensorSample};
use crate::ray::Ray;
use crate::raytrace::Tracer;
use crate::request::BandSet;
use crate::sensor::Sensor;
use rayon::prelude::*;

/// Sub-pixel samples along each axis.
const FINE: usize = 3;
/// Optical blur besides the pixel's own size, pixels (standard deviation).
const BLUR_PX: f64 = 0.45;
/// Samples by which the point spread reaches beyond a pixel.
const REACH: usize = 5;
/// Rows rendered at a time.
const ROWS_AT_ONCE: usize = 48;

/// Settings of an image: camera, light and encoding.
pub(crate) struct Exposure<'a> {
    /// Camera of the image.
    pub(crate) sensor: &'a dyn Sensor,
    /// Window of the image in the sensor's full scene.
    pub(crate) crop: Crop,
    /// Light of the scene and of the air.
    pub(crate) light: &'a Illumination,
    /// Bands of the image.
    pub(crate) bands: BandSet,
    /// Conversion of radiance to counts.
    pub(crate) encoding: Encoding,
    /// Gain of each of the renderer's bands relative to that of `encoding`.
    pub(crate) band_gains: [f64; 4],
    /// True if pixels that see the sea are missing (count 0).
    pub(crate) sea_is_missing: bool,
    /// Seed of noise and of random directions.
    pub(crate) seed: u64,
}

/// An image and its masks.
pub(crate) struct Image {
    /// Columns.
    pub(crate) width: usize,
    /// Rows.
    pub(crate) height: usize,
    /// Counts, row by row, bands interleaved by pixel.
    pub(crate) counts: Vec<u16>,
    /// 1 where the sun reaches less than half of the pixel.
    pub(crate) shadow: Vec<u8>,
    /// 1 where clouds hide a tenth of the pixel or more.
    pub(crate) cloud: Vec<u8>,
}

/// The part of one fine row in a pixel, already blurred along the row.
struct FinePixel {
    radiance: [f32; 4],
    /// Lit samples.
    lit: u8,
    /// Sum of the cloud opacities of the samples.
    clouded: f64,
    /// True if any sample in the point spread sees the sea.
    sea: bool,
}

/// Renders an image; `rows_done` receives the number of rows of each finished batch.
pub(crate) fn render(scene: &LitScene, exposure: &Exposure, rows_done: &mut dyn FnMut(usize)) -> Image {
    let Crop { width, height, .. } = exposure.crop;
    let mut image = Image {
        width,
        height,
        counts: Vec::with_capacity(width * height * exposure.bands.names().len()),
        shadow: Vec::with_capacity(width * height),
        cloud: Vec::with_capacity(width * height),
    };
    let kernel = point_spread();
    let mut row = 0;
    while row < height {
        let rows = ROWS_AT_ONCE.min(height - row);
        let first = (row * FINE) as i64 - REACH as i64;
        let fine: Vec<Vec<FinePixel>> = (first..first + (rows * FINE + 2 * REACH) as i64)
            .into_par_iter()
            .map(|fine_row| fine_row_of(scene, exposure, &kernel, fine_row))
            .collect();
        for k in 0..rows {
            // A pixel's middle sample is one after its first.
            let middle = k * FINE + FINE / 2 + REACH;
            let spread = &fine[middle - REACH..=middle + REACH];
            finish_row(exposure, &kernel, row + k, spread, &mut image);
        }
        row += rows;
        rows_done(rows);
    }
    image
}

/// The share of each fine sample in a pixel: the pixel's own square blurred by the optics. Sums to 1.
fn point_spread() -> [f32; 2 * REACH + 1] {
    let sigma = BLUR_PX * FINE as f64;
    let half = (FINE / 2) as i32;
    let weight = |k: i32| -> f64 {
        (-half..=half)
            .map(|shift| (-0.5 * (f64::from(k + shift) / sigma).powi(2)).exp())
            .sum()
    };
    let total: f64 = (-(REACH as i32)..=REACH as i32).map(weight).sum();
    std::array::from_fn(|k| (weight(k as i32 - REACH as i32) / total) as f32)
}

fn fine_row_of(scene: &LitScene, exposure: &Exposure, kernel: &[f32], fine_row: i64) -> Vec<FinePixel> {
    let Crop { col0, row0, width, .. } = exposure.crop;
    let centre = (FINE / 2) as f64;
    let position = |fine: i64, jitter: f64| (fine as f64 - centre + jitter) / FINE as f64;
    let ray_of = exposure.sensor.rays_of_line(row0 + position(fine_row, 0.0));
    let samples: Vec<SensorSample> = (-(REACH as i64)..(width * FINE + REACH) as i64)
        .map(|fine_col| {
            let draw = hash2(hash2(exposure.seed, fine_row as u64), fine_col as u64);
            let jitter = unit(hash2(draw, 1)) - 0.5;
            let ray = lowered(&ray_of(col0 + position(fine_col, jitter)), &scene.tracer);
            exposure.light.sample(scene, &ray, draw)
        })
        .collect();
    let pixel = |col: usize| {
        let spread = &samples[col * FINE + FINE / 2..][..kernel.len()];
        let own = &samples[col * FINE + REACH..][..FINE];
        let mut radiance = [0f32; 4];
        for (sample, weight) in spread.iter().zip(kernel) {
            let (bands, count) = bands_of(&sample.radiance, exposure.bands);
            for band in 0..count {
                radiance[band] += weight * bands[band];
            }
        }
        FinePixel {
            radiance,
            lit: own.iter().map(|sample| u8::from(sample.lit)).sum(),
            clouded: own.iter().map(|sample| sample.clouded).sum(),
            sea: spread.iter().any(|sample| sample.sea),
        }
    };
    (0..width).map(pixel).collect()
}

/// The ray with its start just above the scene: a start 600 km away would cost digits in every intersection.
pub(crate) fn lowered(ray: &Ray, tracer: &Tracer) -> Ray {
    let t = (tracer.top_m - ray.origin.z) / ray.direction.z;
    Ray::new(ray.at(t), ray.direction)
}

fn finish_row(exposure: &Exposure, kernel: &[f32], row: usize, fine: &[Vec<FinePixel>], image: &mut Image) {
    let bands = exposure.bands.names().len();
    let own = &fine[REACH - FINE / 2..=REACH + FINE / 2];
    for col in 0..exposure.crop.width {
        let missing = exposure.sea_is_missing && fine.iter().any(|line| line[col].sea);
        for band in 0..bands {
            if missing {
                image.counts.push(0);
                continue;
            }
            let weighted = fine
                .iter()
                .zip(kernel)
                .map(|(line, weight)| weight * line[col].radiance[band]);
            let radiance: f32 = weighted.sum();
            let place = ((row * exposure.crop.width + col) * bands + band) as u64;
            let draw = normal(hash2(exposure.seed ^ 0x4015E, place));
            let radiance = exposure.band_gains[band] * f64::from(radiance);
            image.counts.push(exposure.encoding.count(radiance, draw));
        }
        let lit: u32 = own.iter().map(|line| u32::from(line[col].lit)).sum();
        image.shadow.push(u8::from(2 * lit < (FINE * FINE) as u32));
        let clouded: f64 = own.iter().map(|line| line[col].clouded).sum();
        let hidden = clouded >= clouds::HIDING * (FINE * FINE) as f64;
        image.cloud.push(u8::from(hidden));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::city::GroundCover;
    use crate::encoding::MEAN_GAIN;
    use crate::materials::{Class, Material, Season, grey};
    use crate::radiometry::Weather;
    use crate::sensor::{PushBroom, ViewGeometry};
    use crate::solid::{Finish, Footprint, Solids};
    use crate::terrain::HeightField;
    use heliosplat_rpc::sun::SunPosition;
    use heliosplat_rpc::{GeoPoint, LocalFrame};
    use nalgebra::Vector3;

    /// Flat dark ground with a test's objects, viewed from one side.
    struct Studio {
        frame: LocalFrame,
        sensor: PushBroom,
        crop: Crop,
        terrain: HeightField,
        ground: GroundCover,
        sun: SunPosition,
    }

    impl Studio {
        fn new(off_nadir_deg: f64, sun: SunPosition) -> Self {
            let frame = LocalFrame::new(GeoPoint::new(11.6, 48.1, 560.0));
            let view = ViewGeometry {
                azimuth_rad: 2.2,
                off_nadir_rad: off_nadir_deg.to_radians(),
                orbit_m: 620e3,
                tilt_rad: 0.09,
                gsd_m: 0.5,
                full_px: 2400.0,
                seed: 11,
            };
            let sensor = PushBroom::new(&frame, &view, [1000.0, 1300.0]);
            let [col, row] = sensor.project(Vector3::zeros()).map(|v| v.floor() - 80.0);
            Self {
                frame,
                sensor,
                crop: Crop {
                    col0: col,
                    row0: row,
                    width: 160,
                    height: 160,
                },
                terrain: HeightField::sample(90.0, 1.0, |_, _| 0.0),
                ground: GroundCover::plain(Material::Plain(grey(0.05))),
                sun,
            }
        }

        fn shoot(&self, solids: Solids, bits: u8) -> Image {
            let scene = LitScene::new(&self.terrain, solids, &self.ground);
            let weather = Weather {
                season: Season::REFERENCE,
                aerosol: 0.1,
                exposure: 1.0,
                water_slope_variance: 0.02,
                water_turbidity: 1.0,
                seed: 3,
            };
            let light = Illumination::new(&self.sun, weather, 0.3);
            let exposure = Exposure {
                sensor: &self.sensor,
                crop: self.crop,
                light: &light,
                bands: BandSet::Pan,
                encoding: Encoding {
                    gain: MEAN_GAIN,
                    noise: 0.0,
                    bits,
                },
                band_gains: [1.0; 4],
                sea_is_missing: false,
                seed: 8,
            };
            render(&scene, &exposure, &mut |_| {})
        }
    }

    fn white(class: Class) -> Finish {
        Finish::new(class, Material::Plain(grey(0.8)), 0)
    }

    /// Column and row of the centroid of the pixels brighter than the background.
    fn centroid(image: &Image) -> [f64; 2] {
        let background = f64::from(image.counts[0]);
        let mut sums = [0.0; 3];
        for (index, &count) in image.counts.iter().enumerate() {
            let weight = (f64::from(count) - background - 6.0).max(0.0);
            let (col, row) = (index % image.width, index / image.width);
            sums = [
                sums[0] + weight,
                sums[1] + weight * col as f64,
                sums[2] + weight * row as f64,
            ];
        }
        [sums[1] / sums[0], sums[2] / sums[0]]
    }

    #[test]
    fn a_marker_lies_where_the_delivered_camera_says() {
        let studio = Studio::new(24.0, SunPosition::from_degrees(130.0, 50.0));
        let fit = studio.sensor.fit_rational_camera(&studio.frame).expect("a camera");
        let rpc = fit.rpc.cropped(studio.crop.col0, studio.crop.row0);
        for (x, y, z) in [(3.3, -7.1, 0.02), (-14.2, 11.8, 0.02), (18.0, 16.5, 22.0)] {
            let plan = Footprint {
                x,
                y,
                angle_rad: 0.3,
                half: [2.5, 2.5],
            };
            let mut solids = Solids::default();
            solids.polygon(&plan.corners(z), white(Class::Building));
            let image = studio.shoot(solids, 16);
            let [col, row] = centroid(&image);
            let pixel = rpc.project(studio.frame.geo_from_enu(Vector3::new(x, y, z)));
            let error_px = (pixel.col - col).hypot(pixel.row - row);
            assert!(error_px < 0.05, "({x}, {y}, {z}): {error_px}");
        }
    }

    #[test]
    fn the_shadow_of_a_tower_ends_at_h_over_tan_e_from_it_away_from_the_sun() {
        let (azimuth_deg, elevation_deg, height_m) = (118.0f64, 41.0f64, 14.0);
        let studio = Studio::new(12.0, SunPosition::from_degrees(azimuth_deg, elevation_deg));
        let plan = Footprint {
            x: 4.0,
            y: -5.0,
            angle_rad: 0.0,
            half: [3.0, 3.0],
        };
        let mut solids = Solids::default();
        solids.block(&plan, -1.0, height_m, white(Class::Building), white(Class::Building));
        let image = studio.shoot(solids, 16);
        let (sin, cos) = azimuth_deg.to_radians().sin_cos();
        let length_m = height_m / elevation_deg.to_radians().tan();
        // From the tower's middle, straight away from the sun: the shadow's far edge is that of the top.
        let inside_m = 3.0 / sin.abs().max(cos.abs());
        let shadow_at = |distance_m: f64| {
            let point = Vector3::new(plan.x - sin * distance_m, plan.y - cos * distance_m, 0.0);
            let [col, row] = studio.sensor.project(point);
            let pixel = [col - studio.crop.col0, row - studio.crop.row0].map(|v| v.round() as usize);
            image.shadow[pixel[1] * image.width + pixel[0]] == 1
        };
        assert!(shadow_at(length_m + inside_m - 0.8) && shadow_at(0.5 * length_m + inside_m));
        assert!(!shadow_at(length_m + inside_m + 0.8) && !shadow_at(-inside_m - 3.0));
    }

    #[test]
    fn eight_bit_images_have_the_same_marker_in_the_same_place() {
        let studio = Studio::new(20.0, SunPosition::from_degrees(130.0, 50.0));
        let plan = Footprint {
            x: 1.0,
            y: 2.0,
            angle_rad: 0.0,
            half: [3.0, 2.0],
        };
        let marker = || {
            let mut solids = Solids::default();
            solids.polygon(&plan.corners(0.02), white(Class::Building));
            solids
        };
        let (linear, display) = (studio.shoot(marker(), 16), studio.shoot(marker(), 8));
        assert!(display.counts.iter().all(|&count| count <= 255));
        let (a, b) = (centroid(&linear), centroid(&display));
        assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 0.1, "{a:?} {b:?}");
    }

    #[test]
    fn point_spread_is_symmetric_and_keeps_the_light() {
        let kernel = point_spread();
        assert!((kernel.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        for k in 0..REACH {
            assert!((kernel[k] - kernel[2 * REACH - k]).abs() < 1e-9);
        }
        assert!(kernel[0] < 0.01 && kernel[REACH] > 0.15);
    }
}
