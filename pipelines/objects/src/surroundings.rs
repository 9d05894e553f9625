//! Surroundings as light: a panoramic image of radiance, importance-sampled as lamps.
//!
//! Columns run once around (the middle looks along +x, to the left of it is +y), rows from straight up (+z) to straight
//! down, the usual layout of such images. Every lamp drawn stands for the same share of the light (Pharr et al.,
//! "Physically Based Rendering", infinite area lights), at places that fill the image evenly (Hammersley's points), so
//! the same file gives the same lamps.

use super::error::CaptureError;
use super::pixels::{self, Encoding};
use glam::{DVec3, Vec3};
use heliosplat::Raster;
use heliosplat::light::Light;
use heliosplat::shade::display;
use std::f64::consts::PI;
use std::path::Path;

/// A lamp and its colour, relative to a lamp of strength one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lamp {
    /// Direction or position of the lamp.
    pub light: Light,
    /// Red, green and blue, relative to a lamp of strength one.
    pub colour: [f32; 3],
}

/// Reads a panoramic image as linear radiance: display values are decoded, missing and negative ones become zero.
///
/// # Errors
/// [`CaptureError`] when the file is missing, damaged or no image.
pub fn read(path: &Path) -> Result<Raster, CaptureError> {
    pixels::size_px(path)?;
    let picture = pixels::read(path)?;
    let mut light = picture.colour;
    for value in &mut light.values {
        let radiance = if value.is_finite() { value.max(0.0) } else { 0.0 };
        *value = match picture.encoding {
            Encoding::Display => display::decode(radiance),
            Encoding::Linear => radiance,
        };
    }
    Ok(light)
}

/// Direction of the light at a position in the image.
fn direction(col: f64, row: f64, width: usize, height: usize) -> DVec3 {
    let (azimuth, down) = (PI - 2.0 * PI * col / width as f64, PI * row / height as f64);
    DVec3::new(down.sin() * azimuth.cos(), down.sin() * azimuth.sin(), down.cos())
}

/// Radical inverse of `b` in base two: its digits mirrored behind the point, 0 to 1.
fn mirrored(b: u32) -> f64 {
    f64::from(b.reverse_bits()) / 2f64.powi(32)
}

/// Index in a running sum of weights at which `share` of the total is reached, and the fraction within that entry.
fn find(sums: &[f64], share: f64) -> (usize, f64) {
    let wanted = share * sums.last().copied().unwrap_or(0.0);
    let at = sums.partition_point(|&sum| sum <= wanted).min(sums.len() - 1);
    let before = if at == 0 { 0.0 } else { sums[at - 1] };
    let width = (sums[at] - before).max(1e-300);
    (at, ((wanted - before) / width).clamp(0.0, 1.0))
}

fn running(weights: impl Iterator<Item = f64>) -> Vec<f64> {
    weights
        .scan(0.0, |sum, weight| {
            *sum += weight;
            Some(*sum)
        })
        .collect()
}

/// `count` lamps that together light a scene as `image` does; none where it is black.
pub fn lamps(image: &Raster, count: usize) -> Vec<Lamp> {
    let (width, height) = (image.width, image.height);
    let area = |row: usize| {
        let edge = |row: usize| (PI * row as f64 / height as f64).cos();
        (edge(row) - edge(row + 1)) * 2.0 * PI / width as f64
    };
    let colour = |col: usize, row: usize| [0, 1, 2].map(|k| f64::from(image.at(k, col, row)));
    let weight = |col: usize, row: usize| colour(col, row).iter().sum::<f64>() / 3.0 * area(row);
    let within: Vec<Vec<f64>> = (0..height)
        .map(|row| running((0..width).map(|col| weight(col, row))))
        .collect();
    let rows = running(within.iter().map(|sums| sums.last().copied().unwrap_or(0.0)));
    let all = rows.last().copied().unwrap_or(0.0);
    if all <= 0.0 || count == 0 {
        return Vec::new();
    }
    let lamp = |n: usize| {
        let (row, down) = find(&rows, (n as f64 + 0.5) / count as f64);
        let (col, along) = find(&within[row], mirrored(n as u32));
        let light = colour(col, row);
        // Light times area over the chance to be drawn, which is its weight over all: the colour at the strength of the
        // mean.
        let mean = light.iter().sum::<f64>() / 3.0;
        let toward = direction(col as f64 + along, row as f64 + down, width, height);
        Lamp {
            light: Light::Directional(Vec3::new(toward.x as f32, toward.y as f32, toward.z as f32)),
            colour: light.map(|c| (c / mean.max(1e-300) * all / count as f64) as f32),
        }
    };
    (0..count).map(lamp).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Light that falls on a surface facing `up`.
    fn irradiance(lamps: &[Lamp], up: Vec3) -> f32 {
        let one = |lamp: &Lamp| lamp.light.seen_from(Vec3::ZERO).0.dot(up).max(0.0) * lamp.colour[1];
        lamps.iter().map(one).sum()
    }

    #[test]
    fn even_surroundings_lay_pi_on_every_side() {
        let lamps = lamps(&Raster::filled(64, 32, 3, 1.0), 512);
        for up in [Vec3::X, Vec3::NEG_Y, Vec3::Z, Vec3::new(0.6, 0.0, -0.8)] {
            let found = irradiance(&lamps, up);
            assert!((found - std::f32::consts::PI).abs() < 0.03 * found, "{up} {found}");
        }
    }

    #[test]
    fn a_small_bright_place_is_found_and_counts_as_much_as_it_gives() {
        let mut image = Raster::filled(64, 32, 3, 0.0);
        // A quarter of the way from the top, in the middle: 45 degrees up, along +x.
        for k in 0..3 {
            image.plane_mut(k)[8 * 64 + 32] = 100.0;
        }
        let lamps = lamps(&image, 16);
        let toward = direction(32.5, 8.5, 64, 32).as_vec3();
        assert!(toward.x > 0.6 && toward.z > 0.6 && toward.y.abs() < 0.1);
        let area = ((PI * 8.0 / 32.0).cos() - (PI * 9.0 / 32.0).cos()) * 2.0 * PI / 64.0;
        let found = irradiance(&lamps, toward);
        assert!((f64::from(found) - 100.0 * area).abs() < 0.01 * 100.0 * area, "{found}");
        assert!(super::lamps(&Raster::filled(8, 4, 3, 0.0), 4).is_empty());
    }
}
