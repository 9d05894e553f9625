//! SPZ, version 3: splats packed into some 20 bytes each, less after gzip; and the glTF that holds them
//! (`KHR_gaussian_splatting_compression_spz_2`, a draft that CesiumJS and others read).
//!
//! Layout: Niantic's spz 2.0.0, `load-spz.cc`. Version 3 and not 4, because CesiumJS 1.145 unpacks gzip only.
//! Coordinates are stored as in glTF, without the draft's change of axes: CesiumJS does not apply it, and would
//! otherwise rotate models by 180 degrees.
//!
//! Steps: 1/4096 m within 2 km of the origin and twice as much for each doubling of that, 6.4 % of a scale, 1/255 of
//! opacity, 1/136 of colour, 0.2 degrees of a rotation. Positions beyond 2000 km are clamped.

use crate::glb::{Builder, TooLarge, bounds};
use crate::splats::{GAUSSIAN_SPLATTING, Splat, extension};
use flate2::{Compression, GzBuilder};
use serde_json::json;
use std::f32::consts::FRAC_1_SQRT_2;
use std::io::Write;

/// Name of the glTF extension for packed splats.
pub const COMPRESSION: &str = "KHR_gaussian_splatting_compression_spz_2";
const MAGIC: u32 = 0x5053_474e;
const VERSION: u32 = 3;
/// Flag of splats that were trained with opacities that shrink with their footprint.
const ANTIALIASED: u8 = 1;
/// Fractional bits of positions near the origin, and the largest signed number of 24 bits.
const FRACTIONAL_BITS: u32 = 12;
const PLACE_MAX: f64 = 8_388_607.0;
/// Share of a byte's range for each unit of a colour coefficient.
const COLOUR_SCALE: f32 = 0.15;
/// Largest number of nine bits.
const TURN_MAX: f32 = 511.0;

/// Packed stream of splats that are already in the frame of glTF, after gzip.
pub fn encode(splats: &[Splat]) -> Vec<u8> {
    let reach = splats.iter().map(|s| f64::from(s.position.abs().max_element()));
    let reach = reach.fold(0.0, f64::max);
    let fits = |bits: &u32| reach * f64::from(1u32 << bits) <= PLACE_MAX;
    let bits = (0..=FRACTIONAL_BITS).rev().find(fits).unwrap_or(0);
    let mut raw = Vec::with_capacity(16 + 20 * splats.len());
    for number in [MAGIC, VERSION, splats.len() as u32] {
        raw.extend(number.to_le_bytes());
    }
    raw.extend([0, bits as u8, ANTIALIASED, 0]);
    for splat in splats {
        for coordinate in splat.position.to_array() {
            let number = (f64::from(coordinate) * f64::from(1u32 << bits)).round();
            let number = number.clamp(-PLACE_MAX, PLACE_MAX) as i32;
            raw.extend(&number.to_le_bytes()[..3]);
        }
    }
    raw.extend(splats.iter().map(|splat| byte(splat.opacity * 255.0)));
    for splat in splats {
        let coefficients = splat.coefficients();
        raw.extend(coefficients.map(|c| byte(c * (COLOUR_SCALE * 255.0) + 0.5 * 255.0)));
    }
    for splat in splats {
        raw.extend(splat.scale.to_array().map(|scale| byte((scale.ln() + 10.0) * 16.0)));
    }
    for splat in splats {
        raw.extend(turn(splat.rotation.to_array()).to_le_bytes());
    }
    gzip(&raw)
}

fn byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// Packed unit quaternion (x, y, z, w): the index of the largest component, which is made positive, then the other
/// three, each a sign and nine bits of its share of `sqrt(1/2)`.
fn turn(rotation: [f32; 4]) -> u32 {
    let larger = |best: usize, i: usize| match rotation[i].abs() > rotation[best].abs() {
        true => i,
        false => best,
    };
    let largest = (1..4).fold(0, larger);
    let flipped = rotation[largest] < 0.0;
    let mut packed = largest as u32;
    for (i, &component) in rotation.iter().enumerate() {
        if i != largest {
            let negative = u32::from((component < 0.0) != flipped);
            let magnitude = (TURN_MAX * (component.abs() / FRAC_1_SQRT_2)).round().min(TURN_MAX) as u32;
            packed = (packed << 10) | (negative << 9) | magnitude;
        }
    }
    packed
}

fn gzip(raw: &[u8]) -> Vec<u8> {
    // No name and no time: the same splats are the same bytes.
    let mut encoder = GzBuilder::new().write(Vec::new(), Compression::best());
    let written = encoder.write_all(raw);
    debug_assert!(written.is_ok(), "memory takes all that is written to it");
    encoder.finish().unwrap_or_default()
}

/// Bytes of the GLB file of packed splats, turned from the local frame into that of glTF: the content of a 3D tile.
///
/// # Errors
/// [`TooLarge`] for a file of more than 4 GiB.
pub fn glb(splats: &[Splat]) -> Result<Vec<u8>, TooLarge> {
    let splats: Vec<Splat> = splats.iter().map(|splat| splat.in_gltf()).collect();
    let places: Vec<[f32; 3]> = splats.iter().map(|splat| splat.position.to_array()).collect();
    let (low, high) = bounds(&places);
    let mut file = Builder::default();
    let count = splats.len();
    let attributes = json!({
        "POSITION": file.placeholder_places(count, low, high),
        "COLOR_0": file.placeholder_colours(count),
        format!("{GAUSSIAN_SPLATTING}:SCALE"): file.placeholder(3, count),
        format!("{GAUSSIAN_SPLATTING}:ROTATION"): file.placeholder(4, count),
    });
    let mut splatting = extension();
    splatting["extensions"] = json!({COMPRESSION: {"bufferView": file.bytes(&encode(&splats))}});
    let names = json!([GAUSSIAN_SPLATTING, COMPRESSION]);
    file.finish(json!({
        "extensionsUsed": names, "extensionsRequired": names,
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{
            "mode": 0, "attributes": attributes, "extensions": {GAUSSIAN_SPLATTING: splatting},
        }]}],
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::glb::chunks;
    use crate::splats::sample;
    use flate2::read::GzDecoder;
    use glam::{Quat, Vec3};
    use std::io::Read;

    fn unpacked(bytes: &[u8]) -> Vec<u8> {
        let mut raw = Vec::new();
        GzDecoder::new(bytes).read_to_end(&mut raw).expect("gzip");
        raw
    }

    /// Splats of a stream, by the reader's arithmetic of spz 2.0.0.
    fn decode(raw: &[u8]) -> Vec<Splat> {
        let number = |at: usize| u32::from_le_bytes([raw[at], raw[at + 1], raw[at + 2], raw[at + 3]]);
        assert_eq!(
            (number(0), number(4), raw[12], raw[14], raw[15]),
            (0x5053_474e, 3, 0, 1, 0)
        );
        let (n, unit) = (number(8) as usize, 1.0 / f32::from(1u16 << raw[13]));
        assert_eq!(raw.len(), 16 + n * (9 + 1 + 3 + 3 + 4));
        let [places, alphas, colours, scales, turns] = [16, 16 + 9 * n, 16 + 10 * n, 16 + 13 * n, 16 + 16 * n];
        let place = |at: usize| {
            let fixed = i32::from_le_bytes([0, raw[at], raw[at + 1], raw[at + 2]]) >> 8;
            fixed as f32 * unit
        };
        (0..n)
            .map(|i| {
                let mut packed = number(turns + 4 * i);
                let largest = (packed >> 30) as usize;
                let mut q = [0.0f32; 4];
                let mut squares = 0.0;
                for k in (0..4).rev().filter(|&k| k != largest) {
                    let magnitude = FRAC_1_SQRT_2 * (packed & 511) as f32 / 511.0;
                    q[k] = if packed >> 9 & 1 == 1 { -magnitude } else { magnitude };
                    squares += q[k] * q[k];
                    packed >>= 10;
                }
                q[largest] = (1.0 - squares).sqrt();
                let three = |at: usize, f: &dyn Fn(u8) -> f32| [0, 1, 2].map(|k| f(raw[at + 3 * i + k]));
                let shown = |byte: u8| (f32::from(byte) / 255.0 - 0.5) / 0.15 * 0.282_094_8 + 0.5;
                Splat {
                    position: Vec3::from([0, 1, 2].map(|k| place(places + 9 * i + 3 * k))),
                    scale: Vec3::from(three(scales, &|byte| (f32::from(byte) / 16.0 - 10.0).exp())),
                    rotation: Quat::from_array(q),
                    opacity: f32::from(raw[alphas + i]) / 255.0,
                    colour: three(colours, &shown),
                }
            })
            .collect()
    }

    #[test]
    fn splats_read_back_within_the_steps_of_the_format() {
        let splats: Vec<Splat> = sample().iter().map(|s| s.in_gltf()).collect();
        for (a, b) in decode(&unpacked(&encode(&splats))).iter().zip(&splats) {
            assert!(
                (a.position - b.position).abs().max_element() <= 0.5 / 4096.0,
                "{a:?} {b:?}"
            );
            assert!(
                (a.scale / b.scale)
                    .to_array()
                    .iter()
                    .all(|r| (r.ln()).abs() <= 1.01 / 32.0)
            );
            assert!((a.opacity - b.opacity).abs() <= 0.51 / 255.0);
            assert!(
                (0..3).all(|k| (a.colour[k] - b.colour[k]).abs() <= 0.51 / 136.0),
                "{a:?} {b:?}"
            );
            assert!(a.rotation.angle_between(b.rotation) < 0.004, "{a:?} {b:?}");
        }
    }

    #[test]
    fn a_turn_is_packed_as_two_bits_and_three_times_ten() {
        // z is the largest: its number is on top, then x, y, w with their signs turned as z is made positive.
        let packed = turn([0.5 * FRAC_1_SQRT_2, -0.25 * FRAC_1_SQRT_2, -0.9, 0.0]);
        assert_eq!(packed >> 30, 2);
        assert_eq!((packed >> 29 & 1, packed >> 20 & 511), (1, 256));
        assert_eq!((packed >> 19 & 1, packed >> 10 & 511), (0, 128));
        assert_eq!(packed & 511, 0);
    }

    #[test]
    fn far_places_get_coarser_steps_instead_of_the_edge() {
        let far = Splat {
            position: Vec3::new(5000.0, -7.0, 8000.5),
            ..sample()[0]
        };
        let raw = unpacked(&encode(&[far]));
        assert_eq!(raw[13], 10);
        assert!((decode(&raw)[0].position - far.position).abs().max_element() <= 0.5 / 1024.0);
    }

    #[test]
    fn the_tile_names_both_extensions_and_no_values_outside_of_the_stream() {
        let bytes = glb(&sample()).expect("small");
        let (document, binary) = chunks(&bytes);
        let names = json!(["KHR_gaussian_splatting", "KHR_gaussian_splatting_compression_spz_2"]);
        assert_eq!(
            (&document["extensionsUsed"], &document["extensionsRequired"]),
            (&names, &names)
        );
        let attributes = document["meshes"][0]["primitives"][0]["attributes"]
            .as_object()
            .expect("attributes");
        // Viewers take the degree from the number of such names.
        assert!(
            attributes.keys().all(|name| !name.contains("SH_DEGREE")),
            "{attributes:?}"
        );
        for accessor in document["accessors"].as_array().expect("accessors") {
            assert!(accessor.get("bufferView").is_none() && accessor["count"] == 3);
        }
        let view = &document["bufferViews"][0];
        let length = view["byteLength"].as_u64().expect("a number") as usize;
        assert_eq!(decode(&unpacked(&binary[..length])).len(), 3);
        assert_eq!(encode(&sample()), encode(&sample()));
    }
}
