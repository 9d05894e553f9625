//! Inputs of tests: noise that leaning cameras see on level ground, a metre to a cell and a pixel.

use super::parameters::{MatchingFacts, MatchingParameters};
use super::request::PlaneSweepRequest;
use super::views::SweepView;
use super::volume::SearchVolume;
use glam::{DVec3, Vec3};
use heliosplat::{ProjectiveCamera, Raster};

/// A square image of noise; pixels of equal `seed_of` have equal values in every image.
pub(super) fn noise(side: usize, seed_of: impl Fn(usize) -> u64) -> Raster {
    let mut image = Raster::filled(side, side, 1, 0.0);
    for (pixel, value) in image.values.iter_mut().enumerate() {
        let mut random = (pixel as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ seed_of(pixel) << 40;
        random = (random ^ (random >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        *value = ((random >> 33) % 1000) as f32 + 1.0;
    }
    image
}

/// A view of a square `image` that shifts by `lean` columns per metre of altitude and is `off_px` columns off.
pub(super) fn leaning(image: &Raster, lean: f64, off_px: f64, date_group: u32) -> SweepView<'_> {
    let middle = image.width as f64 / 2.0 - 0.5;
    SweepView {
        camera: ProjectiveCamera::new(
            [1.0, 0.0, lean, middle + off_px],
            [0.0, -1.0, 0.0, middle],
            [0.0; 3],
            (image.width, image.height),
            DVec3::new(lean, 0.0, -1.0).normalize(),
        ),
        image,
        index: None,
        date_group,
        sun: None,
    }
}

/// A search of the ground of such images, altitudes of -5 to 5 m.
pub(super) fn request(side: usize, views: usize) -> PlaneSweepRequest {
    let half = side as f32 / 2.0;
    PlaneSweepRequest {
        volume: SearchVolume {
            west_m: -half,
            south_m: -half,
            east_m: half,
            north_m: half,
            cell_m: 1.0,
            altitude_min_m: -5.0,
            altitude_max_m: 5.0,
        },
        centre: Vec3::ZERO,
        parameters: MatchingParameters::choose(&MatchingFacts {
            views: views as f32,
            combined_base_to_height: 1.0,
            has_index: false,
        }),
    }
}
