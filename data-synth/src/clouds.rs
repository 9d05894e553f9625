//! Clouds of one image: a thin level layer high above the site, whose opacity is smooth noise above a threshold.
//!
//! A line crosses the layer in one point. Where a line of sight crosses it, the cloud hides the ground; where a ray to
//! the sun crosses it, some hundred metres to kilometres aside, the ground lies in the cloud's shadow.

use crate::crop::Crop;
use crate::noise::{fractal, hash2, smoothstep, stream};
use crate::ray::Ray;
use crate::sensor::Sensor;
use rand::RngExt;

/// Least opacity of clouds, averaged over a pixel, at which the pixel counts as cloud.
pub(crate) const HIDING: f64 = 0.1;

/// Altitude above the site's centre, metres: that of fair-weather cumulus.
const ALTITUDE_M: [f64; 2] = [900.0, 1500.0];
const OCTAVES: u32 = 4;
/// Albedo of the darkest and the brightest billows.
const ALBEDO: [f64; 2] = [0.72, 0.90];
/// Longest wave of the billows, metres.
const BILLOW_M: f64 = 14.0;

/// Lines of sight along each side of an image that sample the shares.
const PROBES: usize = 48;
/// Most trial positions of the layer. If none fits, the one nearest to the limits is used.
const ATTEMPTS: usize = 400;
/// Largest offset of the layer along each axis, metres.
const REACH_M: f64 = 20e3;

/// Size of clouds, and the share of an image that they hide.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CloudSize {
    /// Least length of the longest wave of the noise, metres.
    wavelength_m: f64,
    /// Least length of the longest wave of the noise, as a share of the image's width.
    width_share: f64,
    /// Noise at which a cloud's edge begins, and at which it is opaque.
    edge: [f64; 2],
    /// Range of the hidden share of the image.
    image_share: [f64; 2],
    /// Range of the hidden share of the middle half of its width and height.
    middle_share: [f64; 2],
    /// Largest opacity of the thin veil that lies everywhere else.
    veil: f64,
}

impl CloudSize {
    /// Fair-weather cumulus 15 to 60 m across, so that a site of 128 m has whole ones and most of the ground is
    /// visible. About a ninth of the layer is above the edge.
    pub(crate) const SMALL: CloudSize = CloudSize {
        wavelength_m: 75.0,
        width_share: 0.0,
        edge: [0.39, 0.63],
        image_share: [0.05, 0.20],
        middle_share: [0.05, 0.25],
        veil: 0.0,
    };

    /// One or two clouds that hide a third of the image, under a veil of haze.
    pub(crate) const LARGE: CloudSize = CloudSize {
        wavelength_m: 200.0,
        width_share: 1.6,
        edge: [0.20, 0.36],
        image_share: [0.28, 0.40],
        middle_share: [0.0, 1.0],
        veil: 0.35,
    };
}

/// A layer of clouds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CloudField {
    size: CloudSize,
    /// The longest wave of the noise, metres.
    wavelength_m: f64,
    altitude_m: f64,
    /// Position of the site in the noise, metres.
    offset_m: [f64; 2],
    /// Cosine and sine of the angle between the noise's axes and east, so that its lattice follows no street.
    turn: [f64; 2],
    seed: u32,
}

/// A cloud in a line of sight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cloud {
    /// Opacity of cloud and veil together, 0 to 1.
    pub(crate) opacity: f64,
    /// Opacity of the cloud alone, 0 to 1, for masks.
    pub(crate) hides: f64,
    /// Albedo of the cloud, 0 to 1.
    pub(crate) albedo: f64,
}

impl CloudField {
    /// Random layer whose clouds hide a share of the image within the limits of `size`.
    pub(crate) fn over(sensor: &dyn Sensor, crop: &Crop, size: CloudSize, seed: u64) -> Self {
        let mut random = stream(seed, 0xC10D);
        let turn_rad: f64 = random.random_range(0.0..std::f64::consts::TAU);
        let mut field = Self {
            size,
            wavelength_m: size.wavelength_m,
            altitude_m: random.random_range(ALTITUDE_M[0]..ALTITUDE_M[1]),
            offset_m: [0.0; 2],
            turn: [turn_rad.cos(), turn_rad.sin()],
            seed: hash2(seed, 0xC1) as u32,
        };
        let probes = field.probes(sensor, crop);
        field.wavelength_m = size.wavelength_m.max(size.width_share * width_m(&probes));
        let mut least_excess = f64::INFINITY;
        let mut offset_m = field.offset_m;
        for _ in 0..ATTEMPTS {
            field.offset_m = [0, 1].map(|_| random.random_range(-REACH_M..REACH_M));
            let excess = field.excess(&probes);
            if excess < least_excess {
                (least_excess, offset_m) = (excess, field.offset_m);
            }
            if excess == 0.0 {
                break;
            }
        }
        Self { offset_m, ..field }
    }

    /// Share of the light along a line that the layer absorbs, 0 to 1.
    pub(crate) fn opacity_along(&self, ray: &Ray) -> f64 {
        let place = self.crossing(ray);
        through_both(self.opacity(place), self.veil(place))
    }

    /// The cloud in a line of sight.
    pub(crate) fn seen_along(&self, ray: &Ray) -> Cloud {
        let [x, y] = self.crossing(ray);
        let billows = fractal(self.seed ^ 0xB1110, x, y, BILLOW_M, 3);
        let hides = self.opacity([x, y]);
        Cloud {
            opacity: through_both(hides, self.veil([x, y])),
            hides,
            albedo: ALBEDO[0] + (ALBEDO[1] - ALBEDO[0]) * smoothstep(-0.7, 0.7, billows),
        }
    }

    /// Intersection of a line with the layer, in the noise's own axes. Rays of the sensor start below it: the line
    /// extends behind their start.
    fn crossing(&self, ray: &Ray) -> [f64; 2] {
        let point = ray.at((self.altitude_m - ray.origin.z) / ray.direction.z);
        let [cos, sin] = self.turn;
        [
            cos * point.x - sin * point.y + self.offset_m[0],
            sin * point.x + cos * point.y + self.offset_m[1],
        ]
    }

    fn opacity(&self, [x, y]: [f64; 2]) -> f64 {
        let [begins, opaque] = self.size.edge;
        smoothstep(begins, opaque, fractal(self.seed, x, y, self.wavelength_m, OCTAVES))
    }

    /// Opacity of the veil: smooth, thicker here and thinner there.
    fn veil(&self, [x, y]: [f64; 2]) -> f64 {
        if self.size.veil == 0.0 {
            return 0.0;
        }
        self.size.veil * smoothstep(-0.5, 0.6, fractal(self.seed ^ 0x7E11, x, y, self.wavelength_m, 2))
    }

    /// Intersections of the layer with lines of sight spread evenly over an image, each with a flag: true in the middle
    /// half of the width and height.
    fn probes(&self, sensor: &dyn Sensor, crop: &Crop) -> Vec<([f64; 2], bool)> {
        let share = |index: usize| (index as f64 + 0.5) / PROBES as f64;
        let inner = |index: usize| (0.25..0.75).contains(&share(index));
        let mut probes = Vec::with_capacity(PROBES * PROBES);
        for row in 0..PROBES {
            let ray = sensor.rays_of_line(crop.row0 + share(row) * crop.height as f64 - 0.5);
            probes.extend((0..PROBES).map(|col| {
                let ray = ray(crop.col0 + share(col) * crop.width as f64 - 0.5);
                (self.crossing(&ray), inner(row) && inner(col))
            }));
        }
        probes
    }

    /// Distance of the hidden shares from their allowed ranges.
    fn excess(&self, probes: &[([f64; 2], bool)]) -> f64 {
        let hidden = |[x, y]: [f64; 2]| self.opacity([x + self.offset_m[0], y + self.offset_m[1]]) >= HIDING;
        // Numbers of hidden probes and of all probes, in the image and in its middle.
        let (mut image, mut middle) = ([0usize; 2], [0usize; 2]);
        for &(point, inner) in probes {
            let hides = usize::from(hidden(point));
            image = [image[0] + hides, image[1] + 1];
            if inner {
                middle = [middle[0] + hides, middle[1] + 1];
            }
        }
        let beyond = |[hides, all]: [usize; 2], [least, most]: [f64; 2]| {
            let share = hides as f64 / all.max(1) as f64;
            (least - share).max(share - most).max(0.0)
        };
        beyond(image, self.size.image_share) + beyond(middle, self.size.middle_share)
    }
}

/// Opacity of two layers together.
fn through_both(one: f64, other: f64) -> f64 {
    // Without a second layer the first is returned exactly.
    one + other * (1.0 - one)
}

/// Width of an image at the intersections of its lines of sight with the layer, metres: that of the square with the
/// area of their bounding box.
fn width_m(probes: &[([f64; 2], bool)]) -> f64 {
    let span = |axis: usize| {
        let values = || probes.iter().map(|(place, _)| place[axis]);
        values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
    };
    (span(0) * span(1)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::city::GroundCover;
    use crate::encoding::{FULL_COUNT, MEAN_GAIN};
    use crate::materials::{Material, Season, grey};
    use crate::radiometry::{Illumination, LitScene, Weather};
    use crate::sensor::{PushBroom, ViewGeometry};
    use crate::solid::Solids;
    use crate::terrain::HeightField;
    use heliosplat_rpc::sun::SunPosition;
    use heliosplat_rpc::{GeoPoint, LocalFrame};
    use nalgebra::Vector3;

    fn sensor(off_nadir_deg: f64) -> PushBroom {
        let frame = LocalFrame::new(GeoPoint::new(4.8, 45.7, 225.0));
        let view = ViewGeometry {
            azimuth_rad: 1.1,
            off_nadir_rad: off_nadir_deg.to_radians(),
            orbit_m: 620e3,
            tilt_rad: 0.05,
            gsd_m: 0.5,
            full_px: 2400.0,
            seed: 5,
        };
        PushBroom::new(&frame, &view, [1200.0, 1200.0])
    }

    fn crop(size: usize) -> Crop {
        Crop {
            col0: 1200.0 - 0.5 * size as f64,
            row0: 1200.0 - 0.5 * size as f64,
            width: size,
            height: size,
        }
    }

    /// Share of an image's pixels hidden by clouds, from every second pixel.
    fn share(field: &CloudField, sensor: &dyn Sensor, crop: &Crop) -> f64 {
        let side = crop.width / 2;
        let hidden = (0..side * side).filter(|index| {
            let ray = sensor.rays_of_line(crop.row0 + (2 * (index / side)) as f64);
            field.opacity_along(&ray(crop.col0 + (2 * (index % side)) as f64)) >= HIDING
        });
        hidden.count() as f64 / (side * side) as f64
    }

    #[test]
    fn an_image_shows_some_clouds_and_most_of_the_ground_whatever_its_size() {
        for seed in 0..25 {
            for (size, off_nadir_deg) in [(80, 12.0), (300, 28.0), (600, 5.0)] {
                let (sensor, crop) = (sensor(off_nadir_deg), crop(size));
                let field = CloudField::over(&sensor, &crop, CloudSize::SMALL, seed);
                let share = share(&field, &sensor, &crop);
                assert!((0.045..0.21).contains(&share), "{seed}, {size} px: {share}");
                assert_eq!(field, CloudField::over(&sensor, &crop, CloudSize::SMALL, seed));
                assert!((ALTITUDE_M[0]..ALTITUDE_M[1]).contains(&field.altitude_m));
            }
        }
    }

    #[test]
    fn large_clouds_hide_a_third_of_an_image_and_the_veil_is_no_cloud() {
        let mut veiled_images = 0;
        for seed in 0..10 {
            for size in [100, 320] {
                let (sensor, crop) = (sensor(15.0), crop(size));
                let field = CloudField::over(&sensor, &crop, CloudSize::LARGE, seed);
                let (mut hidden, mut veiled, mut all) = (0, 0, 0);
                for row in (0..size).step_by(4) {
                    let ray = sensor.rays_of_line(crop.row0 + row as f64);
                    for col in (0..size).step_by(4) {
                        let cloud = field.seen_along(&ray(crop.col0 + col as f64));
                        assert!(cloud.opacity >= cloud.hides && cloud.opacity - cloud.hides <= 0.351);
                        hidden += usize::from(cloud.hides >= HIDING);
                        veiled += usize::from(cloud.hides == 0.0 && cloud.opacity > 0.02);
                        all += 1;
                    }
                }
                let share = |count: usize| count as f64 / all as f64;
                assert!(
                    (0.26..0.42).contains(&share(hidden)),
                    "{seed}, {size} px: {}",
                    share(hidden)
                );
                veiled_images += usize::from(share(veiled) > 0.1);
            }
        }
        assert!(veiled_images >= 15, "{veiled_images} of 20");
    }

    #[test]
    fn clouds_are_tens_of_metres_across() {
        const STEP_M: f64 = 1.0;
        let field = CloudField::over(&sensor(10.0), &crop(300), CloudSize::SMALL, 3);
        let hidden = |east: usize, north: usize| field.opacity([east as f64 * STEP_M, 37.0 * north as f64]) >= HIDING;
        let (mut inside, mut entries) = (0, 0);
        for north in 0..300 {
            for east in 1..3000 {
                inside += usize::from(hidden(east, north));
                entries += usize::from(hidden(east, north) && !hidden(east - 1, north));
            }
        }
        let chord_m = inside as f64 * STEP_M / entries as f64;
        let cover = inside as f64 / (300.0 * 3000.0);
        println!("chord {chord_m} m, cover {cover}");
        assert!((12.0..45.0).contains(&chord_m), "{chord_m} m");
        assert!((0.08..0.20).contains(&cover), "{cover}");
    }

    #[test]
    fn a_cloud_hides_what_is_under_it_and_throws_its_shadow_elsewhere() {
        let terrain = HeightField::sample(400.0, 4.0, |_, _| 0.0);
        let ground = GroundCover::plain(Material::Plain(grey(0.1)));
        let scene = LitScene::new(&terrain, Solids::default(), &ground);
        let weather = Weather {
            season: Season::REFERENCE,
            aerosol: 0.1,
            exposure: 1.0,
            water_slope_variance: 0.02,
            water_turbidity: 1.0,
            seed: 3,
        };
        let sun = SunPosition::from_degrees(130.0, 40.0);
        let clear = Illumination::new(&sun, weather, 0.2);
        let field = CloudField::over(&sensor(10.0), &crop(300), CloudSize::SMALL, 3);
        let mut cloudy = clear;
        cloudy.clouds = Some(field);
        let sight = Vector3::new(-0.15, 0.1, -1.0).normalize();
        let (mut hidden, mut shaded, mut untouched) = (0, 0, 0);
        for index in 0..160 * 160 {
            let place = |index: i32| f64::from(index) * 4.0 - 320.0;
            let point = Vector3::new(place(index % 160), place(index / 160), 0.0);
            let ray = Ray::new(point - sight * 50.0, sight);
            let to_sun = Ray::new(point, clear.to_sun);
            let (before, after) = (clear.sample(&scene, &ray, 7), cloudy.sample(&scene, &ray, 7));
            let (veil, shade) = (field.opacity_along(&ray), field.opacity_along(&to_sun));
            assert!(before.lit && before.clouded == 0.0);
            assert!((after.clouded - veil).abs() < 1e-9);
            if (shade - 0.5).abs() > 1e-3 {
                assert_eq!(after.lit, shade < 0.5);
            }
            if veil == 1.0 {
                hidden += 1;
                let count = MEAN_GAIN * after.radiance.x;
                assert!((0.7 * FULL_COUNT..1.3 * FULL_COUNT).contains(&count), "{count}");
            } else if veil == 0.0 && shade == 1.0 {
                shaded += 1;
                assert!(after.radiance.x < 0.5 * before.radiance.x);
            } else if veil == 0.0 && shade == 0.0 {
                untouched += 1;
                assert_eq!(after.radiance, before.radiance);
            }
        }
        assert!(
            hidden > 20 && shaded > 20 && untouched > 10_000,
            "{hidden} {shaded} {untouched}"
        );
    }
}
