//! Faults of scenes: of cameras, pixels, bands, dates and altitudes, each of random strength.

use super::delivery::{Declared, Image, Scene};
use crate::terrain::{Cover, TerrainRequest};
use heliosplat::Raster;
use heliosplat_raster::SampleType;
use heliosplat_rpc::Rpc;
use rand::RngExt;
use rand_pcg::Pcg32;
use serde_json::json;

/// Fault or difficulty of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fault {
    /// The pointing of one camera is wrong by one to forty pixels.
    Pointing,
    /// The pointing of every camera is wrong by up to twenty pixels.
    PointingOfAll,
    /// Two images have each other's cameras.
    Swapped,
    /// One camera counts its rows or columns from the other end.
    Mirrored,
    /// One camera, or each, counts from a pixel's corner, or from one.
    Origin,
    /// The height offset of one camera is wrong.
    HeightOffset,
    /// The height scale of one camera is wrong.
    HeightScale,
    /// The coefficients of the cameras have few digits, or those of second and third order are missing.
    Truncated,
    /// One image has half of the resolution that its camera states.
    Halved,
    /// One camera is that of an image of half the resolution.
    HalvedCamera,
    /// One image is turned or mirrored, and its camera is not.
    Turned,
    /// One image is cropped, and its camera is not.
    Cropped,
    /// The pixels of one image are of another place.
    OtherPlace,
    /// All images are one image and its camera.
    OneImage,
    /// Two images show the same pixels, under their own cameras.
    SamePixels,
    /// One image exists twice.
    Copied,
    /// All images look from nearly the same direction.
    NoBase,
    /// There are two images.
    TwoViews,
    /// Pixels are missing in wedges, borders, stripes or holes.
    Missing,
    /// Wedges of noise that nothing declares.
    NoiseCollar,
    /// The bands of one image are in another order.
    BandsSwapped,
    /// One band of one image is constant.
    BandConstant,
    /// One image, or each, is stretched to eight bits.
    EightBits,
    /// One image has floating samples, of another unit.
    Floats,
    /// One image has another gain and offset.
    Gain,
    /// One image is a negative.
    Negative,
    /// A part of each image is saturated.
    Saturated,
    /// One image is noisier than its texture.
    Noise,
    /// One image is blurred.
    Blur,
    /// Bright blobs hide parts of some images.
    Clouds,
    /// A part of the ground looks different in each image, as water does.
    Water,
    /// A part of the ground is of one brightness.
    Plain,
    /// Half of the ground repeats itself, as orchards and parking places do.
    Periodic,
    /// A tower of 20 to 40 m stands in the scene.
    Tower,
    /// The ground is steep.
    Steep,
    /// A building stands in some of the images only.
    Change,
    /// Each image has a date that is not its own.
    Dates,
    /// All images have one date.
    EqualDates,
    /// Dates are missing, or are constants that programs write.
    NoDates,
    /// Suns that are not those of the images.
    Suns,
    /// The stated altitudes exclude the ground, or a part of it.
    Altitudes,
    /// No altitudes are stated.
    NoAltitudes,
    /// The stated altitudes are feet.
    AltitudesInFeet,
    /// The coordinate system of the surface has a vertical part.
    CompoundCrs,
    /// The file of the true heights is in US survey feet.
    TruthInFeet,
}

use Fault::*;

impl Fault {
    /// All faults.
    pub const ALL: [Self; 42] = [
        Pointing,
        PointingOfAll,
        Swapped,
        Mirrored,
        Origin,
        HeightOffset,
        HeightScale,
        Truncated,
        Halved,
        HalvedCamera,
        Turned,
        Cropped,
        OtherPlace,
        OneImage,
        SamePixels,
        Copied,
        NoBase,
        TwoViews,
        Missing,
        NoiseCollar,
        BandsSwapped,
        BandConstant,
        EightBits,
        Floats,
        Gain,
        Negative,
        Saturated,
        Noise,
        Blur,
        Clouds,
        Water,
        Plain,
        Periodic,
        Tower,
        Steep,
        Change,
        Dates,
        EqualDates,
        NoDates,
        Suns,
        Altitudes,
        NoAltitudes,
    ];

    /// Faults that are drawn apart from the others, so that seeds keep theirs.
    pub const APART: [Self; 3] = [AltitudesInFeet, CompoundCrs, TruthInFeet];

    /// True for faults of the ground and of the directions of the images: only a terrain is made with them.
    pub fn is_of_terrain(self) -> bool {
        matches!(self, NoBase | Water | Plain | Periodic | Tower | Steep | Change)
    }

    /// Puts a fault of the ground into the request of a terrain.
    pub fn ask(self, request: &mut TerrainRequest, rng: &mut Pcg32) {
        match self {
            NoBase => request.convergence_deg = Some(rng.random_range(0.0..3.0)),
            Water => request.cover = Some(Cover::Water),
            Plain => request.cover = Some(Cover::Plain),
            Periodic => request.periodic = true,
            Tower => request.tower = true,
            Steep => request.hills_m *= rng.random_range(3.0..10.0),
            Change => request.change = true,
            _ => {}
        }
    }

    /// Puts the fault into a scene.
    pub fn apply(self, scene: &mut Scene, rng: &mut Pcg32) {
        let one = rng.random_range(0..scene.images.len());
        let next = (one + 1) % scene.images.len();
        let all_or_one = match rng.random_range(0..2) {
            0 => 0..scene.images.len(),
            _ => one..one + 1,
        };
        let gsd_m = scene.gsd_m;
        match self {
            Pointing => {
                let length = 40f64.powf(rng.random_range(0.0..1.0));
                let turn: f64 = rng.random_range(0.0..std::f64::consts::TAU);
                let rpc = &mut scene.images[one].rpc;
                *rpc = rpc.cropped(length * turn.cos(), length * turn.sin());
                scene.datum_px += length;
            }
            PointingOfAll => {
                let most = 20f64.powf(rng.random_range(0.0..1.0));
                for image in &mut scene.images {
                    image.rpc = image
                        .rpc
                        .cropped(rng.random_range(-most..most), rng.random_range(-most..most));
                }
                scene.datum_px += most;
            }
            Swapped => {
                let rpc = scene.images[one].rpc.clone();
                scene.images[one].rpc = std::mem::replace(&mut scene.images[next].rpc, rpc);
            }
            Mirrored => {
                let rpc = &mut scene.images[one].rpc;
                let numerator = match rng.random_range(0..2) {
                    0 => &mut rpc.line_numerator,
                    _ => &mut rpc.sample_numerator,
                };
                numerator.iter_mut().for_each(|coefficient| *coefficient *= -1.0);
            }
            Origin => {
                let by = [-1.0, -0.5, 0.5, 1.0][rng.random_range(0..4)];
                for image in &mut scene.images[all_or_one] {
                    image.rpc = image.rpc.cropped(by, by);
                }
                scene.datum_px += 1.5;
            }
            HeightOffset => {
                let by = rng.random_range(5.0..60.0) * if rng.random_range(0..2) == 0 { 1.0 } else { -1.0 };
                scene.images[one].rpc.height_offset_m += by;
                scene.datum_px += 0.5 * f64::abs(by) / gsd_m;
            }
            HeightScale => {
                let by = rng.random_range(0.7..1.4);
                let middle_m = 0.5 * (scene.altitude_m.0 + scene.altitude_m.1);
                let rpc = &mut scene.images[one].rpc;
                rpc.height_scale_m *= by;
                // To first order a height offset at the altitude of the ground.
                let moved_m = (1.0 - 1.0 / by) * (middle_m - rpc.height_offset_m);
                scene.datum_px += 0.5 * f64::abs(moved_m) / gsd_m;
            }
            Truncated => {
                let digits = rng.random_range(2..7);
                let linear = rng.random_range(0..3) == 0;
                for image in &mut scene.images {
                    truncate(&mut image.rpc, digits, linear);
                }
                scene.datum_px += 2.0;
            }
            Halved => {
                let image = &mut scene.images[one];
                image.pixels = image.pixels.downscaled(2);
                image.missing.clear();
            }
            HalvedCamera => {
                let rpc = &mut scene.images[one].rpc;
                rpc.sample_offset /= 2.0;
                rpc.line_offset /= 2.0;
                rpc.sample_scale /= 2.0;
                rpc.line_scale /= 2.0;
            }
            Turned => turn(&mut scene.images[one], rng.random_range(0..4)),
            Cropped => {
                let image = &mut scene.images[one];
                let (width, height) = (image.pixels.width, image.pixels.height);
                let [col0, row0]: [usize; 2] = [rng.random_range(0..width / 4), rng.random_range(0..height / 4)];
                image.rearrange((width - col0, height - row0), |col, row| {
                    (row + row0) * width + col + col0
                });
                scene.datum_px += (col0 as f64).hypot(row0 as f64);
            }
            OtherPlace => {
                let image = &mut scene.images[one];
                let plane = image.len();
                let width = image.pixels.width;
                image.rearrange((width, plane / width), |col, row| {
                    (row * width + col + plane / 2 + 17) % plane
                });
            }
            OneImage => {
                let Image { pixels, rpc, .. } = scene.images[one].clone();
                for image in &mut scene.images {
                    (image.pixels, image.rpc) = (pixels.clone(), rpc.clone());
                    image.missing.clear();
                }
            }
            SamePixels => {
                scene.images[one].pixels = scene.images[next].pixels.clone();
                scene.images[one].missing.clear();
            }
            Copied => {
                let mut copy = scene.images[one].clone();
                copy.name += "_copy";
                scene.images.push(copy);
            }
            TwoViews => {
                scene.images.swap(0, one);
                let other = if one == 0 { 1 } else { next.max(1) };
                scene.images.swap(1, other);
                scene.images.truncate(2);
            }
            Missing => {
                let declared = Declared::USUAL[rng.random_range(0..Declared::USUAL.len())];
                let pattern = rng.random_range(0..4);
                for image in &mut scene.images[all_or_one] {
                    lose(image, declared, pattern, rng);
                }
            }
            NoiseCollar => {
                for image in &mut scene.images[all_or_one] {
                    lose(image, Declared::Noise, 0, rng);
                }
            }
            BandsSwapped => {
                let image = &mut scene.images[one];
                let bands = image.pixels.bands;
                let planes: Vec<f32> = (0..bands)
                    .rev()
                    .flat_map(|band| image.pixels.plane(band).to_vec())
                    .collect();
                image.pixels.values = planes;
            }
            BandConstant => {
                let band = rng.random_range(0..scene.images[one].pixels.bands);
                scene.images[one]
                    .pixels
                    .plane_mut(band)
                    .fill(rng.random_range(0.0f32..2000.0).round());
            }
            EightBits => {
                let share = rng.random_range(0.0..0.1);
                scene.images[all_or_one]
                    .iter_mut()
                    .for_each(|image| stretch(image, share));
            }
            Floats => {
                let image = &mut scene.images[one];
                let (gain, offset) = (10f32.powf(rng.random_range(-5.0..1.0)), rng.random_range(-1.0..1.0));
                image.sample = SampleType::F32;
                let values = image.pixels.values.iter_mut();
                values.for_each(|value| *value = gain * (*value + 100.0 * offset));
            }
            Gain => {
                let (gain, offset) = (10f32.powf(rng.random_range(-1.0..1.0)), rng.random_range(0.0..500.0));
                let values = scene.images[one].pixels.values.iter_mut();
                values.for_each(|value| *value = gain * *value + offset);
            }
            Negative => {
                let image = &mut scene.images[one];
                let high = image.pixels.values.iter().copied().fold(0.0f32, f32::max);
                image
                    .pixels
                    .values
                    .iter_mut()
                    .for_each(|value| *value = high + 1.0 - *value);
            }
            Saturated => {
                for image in &mut scene.images {
                    let limit = quantile(&image.pixels.values, rng.random_range(0.3..0.95));
                    image
                        .pixels
                        .values
                        .iter_mut()
                        .for_each(|value| *value = value.min(limit));
                }
            }
            Noise => {
                let image = &mut scene.images[one];
                let by = rng.random_range(0.1..0.6) * quantile(&image.pixels.values, 0.9);
                let values = image.pixels.values.iter_mut();
                values.for_each(|value| *value = (*value + rng.random_range(-by..=by)).max(1.0));
            }
            Blur => {
                let reach: i32 = rng.random_range(1..4);
                blur(&mut scene.images[one].pixels, reach as isize);
            }
            Clouds => {
                for image in scene.images.iter_mut().take(2) {
                    cloud(image, rng);
                }
            }
            Dates => {
                let dates: Vec<_> = scene.images.iter().map(|image| image.items.clone()).collect();
                for (image, items) in scene.images.iter_mut().zip(dates.iter().cycle().skip(1)) {
                    image.items = items.clone();
                }
            }
            EqualDates => {
                let items = scene.images[one].items.clone();
                for image in &mut scene.images {
                    image.items = items.clone();
                }
            }
            NoDates => {
                let date = [
                    None,
                    Some("19700101000000"),
                    Some("20000101000000"),
                    Some("20260101120000"),
                ];
                let date = date[rng.random_range(0..date.len())];
                for image in &mut scene.images[all_or_one] {
                    image.items.remove("acquisition_date");
                    if let Some(date) = date {
                        image.items.insert("acquisition_date".into(), json!(date));
                    }
                }
            }
            Suns => {
                let without_date = rng.random_range(0..2) == 0;
                for image in &mut scene.images[all_or_one] {
                    let [azimuth, elevation] = [rng.random_range(0.0..360.0), rng.random_range(-20.0..90.0)];
                    image.items.insert("sun_azimuth".into(), json!(format!("{azimuth:.1}")));
                    image
                        .items
                        .insert("sun_elevation".into(), json!(format!("{elevation:+.1}")));
                    if without_date {
                        image.items.remove("acquisition_date");
                    }
                }
            }
            Altitudes => {
                let (low, high) = scene.altitude_m;
                let by = rng.random_range(10.0..60.0) * if rng.random_range(0..2) == 0 { 1.0 } else { -1.0 };
                scene.stated_m = Some((low - 10.0 + by, high + 10.0 + by));
            }
            NoAltitudes => scene.stated_m = None,
            AltitudesInFeet => {
                let (low, high) = scene.stated_m.unwrap_or(scene.altitude_m);
                scene.stated_m = Some((low / 0.3048, high / 0.3048));
            }
            CompoundCrs => {
                let rpc = &scene.images[one].rpc;
                let zone = ((rpc.longitude_offset_deg + 180.0) / 6.0).floor() + 1.0;
                let hemisphere = if rpc.latitude_offset_deg < 0.0 {
                    32_700.0
                } else {
                    32_600.0
                };
                let vertical = [5773, 3855][rng.random_range(0..2)];
                scene.crs = Some(format!("EPSG:{}+{vertical}", hemisphere + zone));
            }
            TruthInFeet => scene.truth.in_survey_feet(),
            NoBase | Water | Plain | Periodic | Tower | Steep | Change => {}
        }
    }
}

/// Rounds the coefficients of a camera to some digits, or leaves those of first order only.
fn truncate(rpc: &mut Rpc, digits: i32, linear: bool) {
    let polynomials = [
        &mut rpc.line_numerator,
        &mut rpc.line_denominator,
        &mut rpc.sample_numerator,
        &mut rpc.sample_denominator,
    ];
    for (index, coefficient) in polynomials.into_iter().flat_map(|all| all.iter_mut().enumerate()) {
        match linear {
            true if index > 3 => *coefficient = 0.0,
            true => {}
            false => *coefficient = (*coefficient * 10f64.powi(digits)).round() / 10f64.powi(digits),
        }
    }
}

/// Turns an image by 90, 180 or 270 degrees, or mirrors it.
fn turn(image: &mut Image, kind: usize) {
    let (width, height) = (image.pixels.width, image.pixels.height);
    match kind {
        0 => image.rearrange((height, width), |col, row| (height - 1 - col) * width + row),
        1 => image.rearrange((width, height), |col, row| (height - 1 - row) * width + width - 1 - col),
        2 => image.rearrange((height, width), |col, row| col * width + width - 1 - row),
        _ => image.rearrange((width, height), |col, row| row * width + width - 1 - col),
    }
}

/// Marks missing pixels: a wedge, a border, stripes or holes.
fn lose(image: &mut Image, declared: Declared, pattern: usize, rng: &mut Pcg32) {
    let (width, height) = (image.pixels.width as f64, image.pixels.height as f64);
    let turn: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let (sin, cos) = turn.sin_cos();
    let (share, period) = (rng.random_range(0.1..0.4), rng.random_range(8.0..24.0));
    let holes: Vec<[f64; 3]> = (0..rng.random_range(1..6))
        .map(|_| {
            [
                rng.random_range(0.0..width),
                rng.random_range(0.0..height),
                rng.random_range(2.0..10.0),
            ]
        })
        .collect();
    let gone = |index: usize| {
        let (col, row) = ((index % image.pixels.width) as f64, (index / image.pixels.width) as f64);
        let across = (col - width / 2.0) * cos + (row - height / 2.0) * sin;
        match pattern {
            0 => across > width * (0.5 - share),
            1 => col.min(width - 1.0 - col) < 0.4 * share * width || row.min(height - 1.0 - row) < 0.4 * share * height,
            2 => across.rem_euclid(period) < share * period,
            _ => holes.iter().any(|[x, y, radius]| (col - x).hypot(row - y) < *radius),
        }
    };
    image.missing = (0..image.len()).map(gone).collect();
    image.declared = declared;
}

fn quantile(values: &[f32], share: f32) -> f32 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f32::total_cmp);
    sorted[(share * (sorted.len() - 1) as f32) as usize]
}

/// Stretches each band to eight bits between two quantiles, of which `share` lies beyond.
fn stretch(image: &mut Image, share: f32) {
    for band in 0..image.pixels.bands {
        let plane = image.pixels.plane_mut(band);
        let (low, high) = (quantile(plane, 0.5 * share), quantile(plane, 1.0 - 0.5 * share));
        for value in plane {
            *value = (255.0 * (*value - low) / (high - low).max(1e-6))
                .clamp(0.0, 255.0)
                .round();
        }
    }
    image.sample = SampleType::U8;
}

/// Means over squares.
fn blur(pixels: &mut Raster, reach: isize) {
    let (width, height, from) = (pixels.width as isize, pixels.height as isize, pixels.clone());
    for band in 0..pixels.bands {
        for (index, value) in pixels.plane_mut(band).iter_mut().enumerate() {
            let (col, row) = (index as isize % width, index as isize / width);
            let (mut sum, mut count) = (0.0, 0.0);
            for r in (row - reach).max(0)..(row + reach + 1).min(height) {
                for c in (col - reach).max(0)..(col + reach + 1).min(width) {
                    sum += from.at(band, c as usize, r as usize);
                    count += 1.0;
                }
            }
            *value = sum / count;
        }
    }
}

/// Puts a bright blob into an image.
fn cloud(image: &mut Image, rng: &mut Pcg32) {
    let (width, plane) = (image.pixels.width, image.len());
    let (x, y) = (
        rng.random_range(0..width) as f64,
        rng.random_range(0..plane / width) as f64,
    );
    let radius = rng.random_range(6.0..20.0);
    let bright = 1.5 * quantile(&image.pixels.values, 0.99);
    for index in 0..plane {
        let (col, row) = ((index % width) as f64, (index / width) as f64);
        if (col - x).hypot(row - y) < radius {
            for band in 0..image.pixels.bands {
                image.pixels.values[band * plane + index] = bright * rng.random_range(0.97..1.03);
            }
        }
    }
}
