//! The Gaussians of a run as splats: each has the colour of its albedo times the light that reaches it, as a display
//! value.
//!
//! The light of each Gaussian is traced from its centre. Here albedo and light are multiplied before splats are
//! composited, in a rendering afterwards: at the border of a shadow both differ a little. Viewers blend display values,
//! a rendering blends light.

use super::tile::MosaicTile;
use crate::model::{LoadedModel, ModelFile, load};
use crate::nadir::NadirGrid;
use crate::relight::{RelightError, composed, light_of};
use crate::surface::forget_thin;
use glam::{DMat3, DQuat, DVec3, Vec3};
use heliosplat::gaussians::normalised;
use heliosplat::light::Light;
use heliosplat::model::{Context, SceneModel, Seen};
use heliosplat::render::render;
use heliosplat::shade::display;
use heliosplat::splat::{Maps, Projected};
use heliosplat::trace::{Occluders, transmittance};
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_exchange::splats::Splat;
use heliosplat_raster::preview::percentiles;
use heliosplat_rpc::LocalFrame;
use heliosplat_rpc::sun::SunPosition;
use heliosplat_scene::BandKind;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Least opacity of an exported splat: a step of a byte.
const OPACITY_LEAST: f32 = 1.0 / 255.0;
/// Largest standard deviation of an exported splat, metres: half-precision covariances of viewers end near here.
const SCALE_MOST_M: f32 = 100.0;
/// Quantiles of the image from above that are shown black and white.
const BLACK: f64 = 0.01;
const WHITE: f64 = 0.995;
/// Approximate number of values of each band from which the display of a mosaic is found.
const DISPLAY_VALUES: usize = 4_000_000;

/// Display stretch: linear from black to white, then the sRGB curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Display {
    /// Indices of the bands shown as red, green and blue; the first one thrice where there is no colour.
    pub bands: [usize; 3],
    /// Value that is shown black, in the unit of the image.
    pub black: f32,
    /// Value that is shown white, in the unit of the image.
    pub white: f32,
}

impl Display {
    /// Display stretch between two quantiles of an image.
    pub(super) fn of(image: &Raster, kinds: &[BandKind], quantiles: (f64, f64)) -> Self {
        let bands = shown(kinds);
        let values: Vec<f32> = bands.iter().flat_map(|&band| image.plane(band)).copied().collect();
        Self::of_values(bands, &values, quantiles)
    }

    /// Display stretch between two quantiles of the values of these bands.
    fn of_values(bands: [usize; 3], values: &[f32], quantiles: (f64, f64)) -> Self {
        let (black, white) = percentiles(values, quantiles.0, quantiles.1).unwrap_or((0.0, 1.0));
        let white = white.max(black + f32::MIN_POSITIVE.max(1e-6 * black.abs()));
        Self { bands, black, white }
    }

    /// Display value (sRGB) of a value, 0 to 1.
    pub fn show(&self, value: f32) -> f32 {
        display::encode(((value - self.black) / (self.white - self.black)).clamp(0.0, 1.0)).0
    }
}

/// Indices of the bands that are shown as red, green and blue: the bands of these kinds, or the first three, or the
/// first for all.
pub fn shown(kinds: &[BandKind]) -> [usize; 3] {
    let place = |kind: BandKind| kinds.iter().position(|&k| k == kind);
    match (place(BandKind::Red), place(BandKind::Green), place(BandKind::Blue)) {
        (Some(red), Some(green), Some(blue)) => [red, green, blue],
        _ if kinds.len() >= 3 => [0, 1, 2],
        _ => [0; 3],
    }
}

/// Light and display of the splats of several tiles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Look {
    /// Sun of the splats; `None` for models without light, which show the ground as it was photographed.
    sun: Option<SunPosition>,
    /// Display stretch of the splats' colours.
    display: Display,
    counts_per_unit: f64,
}

impl Look {
    /// Look of `tiles` under `sun`, or under the sun of the first tile's reference image. The display stretch is the
    /// same for all suns: that of the reference image's sun, seen from above. Tiles are loaded one after the other.
    ///
    /// # Errors
    /// Errors of [`Lit::new`], and when a tile cannot be read.
    pub fn of(tiles: &[MosaicTile], sun: Option<&SunPosition>) -> Result<Self, RelightError> {
        let mut own = None;
        let mut said = ([0; 3], 1.0);
        let mut values = Vec::new();
        for (place, tile) in tiles.iter().enumerate() {
            let model = load(&tile.run)?;
            if place == 0 {
                own = own_sun(&model.file);
                said = (shown(&model.file.bands), model.file.counts_per_unit);
            }
            let mut image = from_above(&model, lit_by(&model, own)?)?;
            tile.balance(&mut image);
            let step = (image.plane_len() * tiles.len() / DISPLAY_VALUES).max(1);
            for band in said.0.into_iter().filter(|&band| band < image.bands) {
                values.extend(image.plane(band).iter().step_by(step));
            }
        }
        Ok(Self {
            sun: sun.copied().or(own),
            display: Display::of_values(said.0, &values, (BLACK, WHITE)),
            counts_per_unit: said.1,
        })
    }
}

/// Splats of a run or a mosaic under a sun.
pub struct Lit {
    /// Splats in the local frame.
    pub splats: Vec<Splat>,
    look: Look,
}

impl Lit {
    /// Splats of `model` under `sun`, or under the sun of its reference image. The display stretch is the same for all
    /// suns: that of the reference image's sun, seen from above.
    ///
    /// # Errors
    /// [`RelightError`] where the sun is too low, or the model has no light and `sun` is given.
    pub fn new(model: &LoadedModel, sun: Option<&SunPosition>) -> Result<Self, RelightError> {
        let own = lit_by(model, own_sun(&model.file))?;
        let light = lit_by(model, sun.copied())?.or(own);
        let display = Display::of(&from_above(model, own)?, &model.file.bands, (BLACK, WHITE));
        let splats = splats(model, &colours(model, light)?, &display);
        let look = Look {
            sun: light.map(|(sun, _)| sun),
            display,
            counts_per_unit: model.file.counts_per_unit,
        };
        Ok(Self { splats, look })
    }

    /// Splats of all tiles of a mosaic in the frame of `nadir`, those of each tile within its core and with its gains.
    /// Tiles are loaded one after the other.
    ///
    /// # Errors
    /// Errors of [`Lit::new`], and when a tile cannot be read.
    pub(super) fn of_tiles(
        tiles: &[MosaicTile],
        (nadir, frame): (&NadirGrid, &LocalFrame),
        look: &Look,
    ) -> Result<Self, RelightError> {
        let mut all = Vec::new();
        for tile in tiles {
            let model = load(&tile.run)?;
            let mut colours = colours(&model, lit_by(&model, look.sun)?)?;
            tile.balance(&mut colours);
            let splats = splats(&model, &colours, &look.display);
            let splats = splats.into_iter().map(between(&model.frame, frame));
            all.extend(splats.filter(|splat| tile.contains(&nadir.camera, splat.position)));
        }
        Ok(Self {
            splats: all,
            look: *look,
        })
    }

    /// Metadata of the splats in files: sun angles, degrees, and display stretch, counts.
    pub(super) fn metadata(&self) -> Value {
        let Look { sun, display, .. } = self.look;
        let counts = |value: f32| f64::from(value) * self.look.counts_per_unit;
        let sun = sun.map(|sun| sun.degrees());
        let sun = sun.map(|[azimuth, elevation]| json!({"azimuth_deg": azimuth, "elevation_deg": elevation}));
        json!({
            "sun": sun,
            "display": {
                "bands": display.bands, "black_counts": counts(display.black),
                "white_counts": counts(display.white), "curve": "sRGB",
            },
        })
    }
}

/// Moves splats from one local frame to another; the two are turned against each other by the angle between their plumb
/// lines.
fn between(from: &LocalFrame, to: &LocalFrame) -> impl Fn(Splat) -> Splat {
    let turn = to.enu_from_ecef_rotation() * from.enu_from_ecef_rotation().transpose();
    let turn = DMat3::from_cols_slice(turn.as_slice());
    let offset = to.enu_from_geo(from.origin);
    let offset_m = DVec3::new(offset.x, offset.y, offset.z);
    move |splat| {
        let rotation = DQuat::from_mat3(&turn).as_quat() * splat.rotation;
        Splat {
            position: (turn * splat.position.as_dvec3() + offset_m).as_vec3(),
            rotation: rotation.normalize(),
            ..splat
        }
    }
}

/// A sun with its light on `model`.
///
/// # Errors
/// [`RelightError`] where the sun is too low, or the model has no light.
fn lit_by(model: &LoadedModel, sun: Option<SunPosition>) -> Result<Option<(SunPosition, Light)>, RelightError> {
    sun.map(|sun| Ok((sun, light_of(model, &sun)?))).transpose()
}

/// Default sun of a model's splats: that of its reference image; `None` for a model without light.
fn own_sun(file: &ModelFile) -> Option<SunPosition> {
    reference_sun(file).filter(|_| file.has_light())
}

/// Sun of the image whose colour is the model's, or of the first other training image where that is unknown.
fn reference_sun(file: &ModelFile) -> Option<SunPosition> {
    let trained = || file.images.iter().filter(|image| image.appearance.is_some());
    let reference = trained().find(|image| image.appearance == Some(file.options.reference));
    let sun = reference.and_then(|image| image.sun);
    sun.or_else(|| trained().find_map(|image| image.sun))
}

/// Nadir image in the model's units; NaN where alpha is below one half.
fn from_above(model: &LoadedModel, light: Option<(SunPosition, Light)>) -> Result<Raster, RelightError> {
    let nadir = NadirGrid::new(&model.into(), model.file.gsd_m, None)?;
    let (parallel, shown, options) = (light.map(|(_, light)| light), &model.parameters, model.pass_options());
    let seen = render(&model.model, shown, &nadir.camera, parallel, None, options);
    let mut image = match light {
        Some((sun, light)) => composed(model, &sun, light, &nadir.camera, &seen.maps)?,
        None => seen.image,
    };
    for band in 0..image.bands {
        forget_thin(image.plane_mut(band), &seen.maps.alpha);
    }
    Ok(image)
}

/// Colour of each Gaussian under a light, in the model's units: the model composes an image in which each Gaussian is a
/// pixel that it covers alone.
///
/// # Errors
/// [`RelightError`] for a model without daylight.
fn colours(model: &LoadedModel, lit_by: Option<(SunPosition, Light)>) -> Result<Raster, RelightError> {
    let light = lit_by.map(|(_, light)| light);
    let gaussians = &model.parameters.gaussians;
    let all = Projected {
        gaussian: (0..gaussians.count as u32).collect(),
        ..Projected::default()
    };
    let transmittances = match light {
        Some(light) => transmittance(&Occluders::new(gaussians), &all.gaussian, &light).values,
        None => vec![1.0; gaussians.count],
    };
    // The colour of a Gaussian does not depend on the direction of view, so a nadir camera serves for all.
    let camera = ProjectiveCamera::nadir(0.0, 0.0, 1.0, (gaussians.count, 1));
    let context = Context {
        parameters: &model.parameters,
        camera: &camera,
        light,
        appearance: None,
    };
    let stride = model.model.channels();
    let seen = Seen {
        projected: &all,
        transmittance: &transmittances,
        stride,
    };
    let mut features = vec![0.0; gaussians.count * stride];
    model.model.features(&context, &seen, &mut features);
    let channel = |k: usize| features.iter().skip(k).step_by(stride).copied().collect();
    let maps = Maps {
        width: gaussians.count,
        height: 1,
        channels: (0..stride).map(channel).collect(),
        alpha: vec![1.0; gaussians.count],
        ..Maps::default()
    };
    match lit_by {
        Some((sun, light)) => composed(model, &sun, light, &camera, &maps),
        None => Ok(model.model.compose(&context, &maps)),
    }
}

fn splats(model: &LoadedModel, colours: &Raster, display: &Display) -> Vec<Splat> {
    let gaussians = &model.parameters.gaussians;
    let splat = |i: usize| Splat {
        position: gaussians.position(i),
        scale: gaussians.scale(i).min(Vec3::splat(SCALE_MOST_M)),
        rotation: normalised(gaussians.raw_rotation(i)),
        opacity: gaussians.opacity(i),
        colour: display.bands.map(|band| display.show(colours.plane(band)[i])),
    };
    let seen = |i: &usize| gaussians.opacity(*i) >= OPACITY_LEAST;
    (0..gaussians.count).filter(seen).map(splat).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat_rpc::GeoPoint;

    #[test]
    fn a_splat_moved_to_another_frame_stays_where_it_is_on_earth() {
        let at = |lon_deg, lat_deg, height_m| LocalFrame::new(GeoPoint::new(lon_deg, lat_deg, height_m));
        let (from, to) = (at(36.91, 37.58, 700.0), at(36.93, 37.57, 655.0));
        let splat = Splat {
            position: Vec3::new(30.0, -40.0, 12.0),
            scale: Vec3::ONE,
            rotation: glam::Quat::IDENTITY,
            opacity: 1.0,
            colour: [0.5; 3],
        };
        let moved = between(&from, &to)(splat);
        let there = to.enu_from_geo(from.geo_from_enu(nalgebra::Vector3::new(30.0, -40.0, 12.0)));
        let there = Vec3::new(there.x as f32, there.y as f32, there.z as f32);
        assert!((moved.position - there).length() < 1e-3, "{} {there}", moved.position);
        // Over two kilometres plumb lines differ by a minute of arc.
        let turned = 2.0 * moved.rotation.xyz().length().to_degrees() * 60.0;
        assert!((0.5..2.0).contains(&turned), "{turned}");
    }

    #[test]
    fn colours_are_found_by_what_bands_are() {
        use BandKind::{Blue, Green, NearInfrared, Other, Pan, Red};
        assert_eq!(shown(&[Blue, Green, Red, NearInfrared]), [2, 1, 0]);
        assert_eq!(shown(&[Other, Other, Other]), [0, 1, 2]);
        assert_eq!(shown(&[Pan]), [0; 3]);
    }

    #[test]
    fn black_and_white_are_the_ends_of_the_display() {
        let mut image = Raster::filled(100, 10, 1, f32::NAN);
        for (i, value) in image.values.iter_mut().enumerate().skip(1) {
            *value = i as f32;
        }
        let display = Display::of(&image, &[BandKind::Pan], (0.01, 0.995));
        assert!((display.black - 10.0).abs() < 2.0 && (display.white - 994.0).abs() < 2.0);
        assert_eq!(display.show(-3.0), 0.0);
        assert!((display.show(2000.0) - 1.0).abs() < 1e-6);
        let middle = 0.5 * (display.black + display.white);
        assert!((display.show(middle) - 0.7354).abs() < 1e-3);
        let even = Display::of(&Raster::filled(3, 3, 1, 7.0), &[BandKind::Pan], (0.01, 0.995));
        assert!(even.show(7.0).is_finite());
    }
}
