//! Splats in glTF (`KHR_gaussian_splatting`, Khronos, ratified).
//!
//! Colours are display values (sRGB): viewers blend them without lighting. A splat has the same colour from all
//! directions.
//!
//! The frame of splats is local, in metres: east, north, up. glTF's is `(east, up, -north)`; see [`Splat::in_gltf`].

use crate::glb::{Builder, TooLarge};
use glam::{Mat3, Quat, Vec3};
use heliosplat::gaussians::{FEATURES, GroupSpec, LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups, logit};
use heliosplat::shade::display;
use serde_json::{Value, json};
use std::f32::consts::FRAC_PI_2;

/// Name of the glTF extension for splats.
pub const GAUSSIAN_SPLATTING: &str = "KHR_gaussian_splatting";
/// Spherical harmonic of degree 0, 1 / (2 √π): viewers show `0.5 + C0 · coefficient`.
pub const C0: f32 = 0.282_094_8;
/// Largest opacity in files: an opacity of 1 has no logit, and this one is shown as 1 everywhere.
const MOST_OPAQUE: f32 = 0.9999;

/// Splat: an ellipsoidal Gaussian with an opacity and a colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Splat {
    /// Centre, metres.
    pub position: Vec3,
    /// Standard deviations along its own axes, metres.
    pub scale: Vec3,
    /// Rotation from the splat's own axes to those of the frame; a unit quaternion.
    pub rotation: Quat,
    /// Opacity at the centre, 0 to 1.
    pub opacity: f32,
    /// Colour: display values of red, green and blue, 0 to 1.
    pub colour: [f32; 3],
}

impl Splat {
    /// The splat in the frame of glTF, whose second axis is up.
    #[must_use]
    pub fn in_gltf(self) -> Self {
        let Vec3 { x, y, z } = self.position;
        Self {
            position: Vec3::new(x, z, -y),
            rotation: Quat::from_rotation_x(-FRAC_PI_2) * self.rotation,
            ..self
        }
    }

    /// Covariance of the splat, metres².
    pub fn covariance(&self) -> Mat3 {
        let turned = Mat3::from_quat(self.rotation) * Mat3::from_diagonal(self.scale);
        turned * turned.transpose()
    }

    /// Colour coefficients of the spherical harmonic of degree 0: red, green and blue.
    pub(crate) fn coefficients(&self) -> [f32; 3] {
        self.colour.map(|value| (value - 0.5) / C0)
    }
}

/// Table of splats, as [`splat_ply`](crate::splat_ply) writes it.
pub fn table(splats: &[Splat]) -> Table {
    let mut groups = core_groups();
    groups.push(GroupSpec::new("sh_0", 3));
    let mut table = Table::zeros(groups, splats.len());
    for (i, splat) in splats.iter().enumerate() {
        let mut put = |group: usize, values: &[f32]| {
            let width = values.len();
            table.group_mut(group)[i * width..(i + 1) * width].copy_from_slice(values);
        };
        put(POSITION, &splat.position.to_array());
        put(LOG_SCALE, &splat.scale.to_array().map(f32::ln));
        put(ROTATION, &splat.rotation.to_array());
        put(OPACITY, &[logit(splat.opacity.min(MOST_OPAQUE))]);
        put(FEATURES, &splat.coefficients());
    }
    table
}

/// Bytes of the GLB file of splats without compression, turned into the frame of glTF, with `extras` (an object, or
/// null). Viewers without the extension show points.
///
/// # Errors
/// [`TooLarge`] for a file of more than 4 GiB.
pub fn glb(splats: &[Splat], extras: Value) -> Result<Vec<u8>, TooLarge> {
    let splats: Vec<Splat> = splats.iter().map(|splat| splat.in_gltf()).collect();
    let places: Vec<[f32; 3]> = splats.iter().map(|splat| splat.position.to_array()).collect();
    let mut file = Builder::default();
    let attributes = json!({
        "POSITION": file.places(&places),
        "COLOR_0": file.colours(splats.iter().map(point_colour)),
        format!("{GAUSSIAN_SPLATTING}:ROTATION"): file.floats(splats.iter().map(|s| s.rotation.to_array())),
        format!("{GAUSSIAN_SPLATTING}:SCALE"): file.floats(splats.iter().map(|s| s.scale.to_array())),
        format!("{GAUSSIAN_SPLATTING}:OPACITY"): file.floats(splats.iter().map(|s| [s.opacity])),
        format!("{GAUSSIAN_SPLATTING}:SH_DEGREE_0_COEF_0"): file.floats(splats.iter().map(Splat::coefficients)),
    });
    file.finish(json!({
        "extras": extras, "extensionsUsed": [GAUSSIAN_SPLATTING],
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{
            "mode": 0, "attributes": attributes, "extensions": {GAUSSIAN_SPLATTING: extension()},
        }]}],
    }))
}

/// Properties of the extension, equal in all files of splats.
pub(crate) fn extension() -> Value {
    json!({
        "kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective",
        "sortingMethod": "cameraDistance",
    })
}

/// Linear light and opacity of a splat, as colours of points are stored in glTF.
fn point_colour(splat: &Splat) -> [u8; 4] {
    let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    let [red, green, blue] = splat.colour.map(|value| byte(display::decode(value)));
    [red, green, blue, byte(splat.opacity)]
}

/// Three splats for tests.
#[cfg(test)]
pub(crate) fn sample() -> Vec<Splat> {
    let splat = |position, turn: Quat, colour| Splat {
        position,
        scale: Vec3::new(0.4, 0.2, 0.05),
        rotation: turn,
        opacity: 0.8,
        colour,
    };
    vec![
        splat(Vec3::new(10.0, 20.0, 3.0), Quat::IDENTITY, [1.0, 0.5, 0.0]),
        splat(
            Vec3::new(-700.25, 0.5, -1.0),
            Quat::from_rotation_z(0.7),
            [0.2, 0.4, 0.6],
        ),
        splat(
            Vec3::new(0.0, -5.0, 40.0),
            Quat::from_xyzw(0.1, -0.7, 0.3, -0.4).normalize(),
            [0.9; 3],
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::glb::chunks;
    use crate::splat_ply;

    #[test]
    fn the_file_says_east_up_and_south_with_display_colours() {
        let bytes = glb(&sample(), json!({"sun": 1})).expect("small");
        let (document, binary) = chunks(&bytes);
        let primitive = &document["meshes"][0]["primitives"][0];
        let floats = |name: &str| {
            let accessor =
                &document["accessors"][primitive["attributes"][name].as_u64().expect("an accessor") as usize];
            let view = &document["bufferViews"][accessor["bufferView"].as_u64().expect("a view") as usize];
            let [from, length] = ["byteOffset", "byteLength"].map(|key| view[key].as_u64().expect("a number") as usize);
            let four = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
            binary[from..from + length].chunks(4).map(four).collect::<Vec<f32>>()
        };
        assert_eq!(&floats("POSITION")[..3], &[10.0, 3.0, -20.0]);
        assert_eq!(document["accessors"][0]["min"][0], -700.25);
        assert_eq!(&floats("KHR_gaussian_splatting:SCALE")[..3], &[0.4, 0.2, 0.05]);
        assert_eq!(floats("KHR_gaussian_splatting:OPACITY"), vec![0.8; 3]);
        let shown: Vec<f32> = floats("KHR_gaussian_splatting:SH_DEGREE_0_COEF_0")[..3]
            .iter()
            .map(|c| 0.282_094_8 * c + 0.5)
            .collect();
        assert!(
            shown.iter().zip([1.0, 0.5, 0.0]).all(|(a, b)| (a - b).abs() < 1e-6),
            "{shown:?}"
        );
        // The thin axis, up in the frame of the ground, is the second one of glTF.
        let turn = floats("KHR_gaussian_splatting:ROTATION");
        let thin = Quat::from_slice(&turn[..4]) * Vec3::Z;
        assert!((thin - Vec3::Y).length() < 1e-6, "{thin}");
        for q in turn.chunks(4) {
            assert!((q.iter().map(|c| c * c).sum::<f32>() - 1.0).abs() < 1e-5);
        }
        // Half of the display range is a fifth of the light.
        let view = &document["bufferViews"][1];
        let at = view["byteOffset"].as_u64().expect("a number") as usize;
        assert_eq!(&binary[at..at + 4], &[255, 55, 0, 204]);
        assert_eq!(document["extensionsUsed"], json!(["KHR_gaussian_splatting"]));
        assert_eq!(document["extras"]["sun"], 1);
        assert_eq!(
            primitive["extensions"]["KHR_gaussian_splatting"]["colorSpace"],
            "srgb_rec709_display"
        );
    }

    #[test]
    fn a_ply_has_the_columns_that_viewers_ask_for() {
        let splats = sample();
        let bytes = splat_ply::encode(&table(&splats), &["anchor 1 2 3".into()]);
        let back = splat_ply::decode(&bytes, vec![GroupSpec::new("sh_0", 3)]).expect("a PLY");
        for (i, splat) in splats.iter().enumerate() {
            assert_eq!(back.position(i), splat.position);
            assert!((back.scale(i) - splat.scale).length() < 1e-6 && (back.opacity(i) - splat.opacity).abs() < 1e-6);
            let turned = back.rotation(i) * Vec3::X - splat.rotation * Vec3::X;
            assert!(turned.length() < 1e-6);
        }
        let text = String::from_utf8_lossy(&bytes);
        assert!(text.contains("comment anchor 1 2 3\n") && text.contains("property float f_dc_2\n"));
        assert!(!text.contains("f_rest"));
    }
}
