//! Meshes as other programs read them: binary PLY with colours, and glTF 2.0 in one file (GLB).

use super::Mesh;
use heliosplat::shade::display;
use heliosplat_exchange::glb::TooLarge;
use heliosplat_exchange::mesh as gltf;
use std::path::Path;

/// File format of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Stanford's polygons, binary, little-endian.
    Ply,
    /// Khronos' glTF 2.0, binary.
    Glb,
}

impl Format {
    /// Format by the extension of a file's name; `None` where it is neither `ply` nor `glb`.
    pub fn of(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_str()?.to_ascii_lowercase();
        match ending.as_str() {
            "ply" => Some(Self::Ply),
            "glb" => Some(Self::Glb),
            _ => None,
        }
    }
}

/// Encodes a mesh as the bytes of a file.
///
/// # Errors
/// [`TooLarge`] for a GLB file of more than 4 GiB.
pub fn encode(mesh: &Mesh, format: Format) -> Result<Vec<u8>, TooLarge> {
    match format {
        Format::Ply => Ok(ply(mesh)),
        Format::Glb => glb(mesh),
    }
}

fn ply(mesh: &Mesh) -> Vec<u8> {
    let mut out = format!(
        "ply\nformat binary_little_endian 1.0\ncomment heliosplat\nelement vertex {}\n\
         property float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        mesh.positions.len(),
        mesh.triangles.len()
    )
    .into_bytes();
    for ((place, normal), colour) in mesh.positions.iter().zip(&mesh.normals).zip(&mesh.colours) {
        out.extend(place.iter().chain(normal).flat_map(|x| x.to_le_bytes()));
        out.extend(colour);
    }
    for triangle in &mesh.triangles {
        out.push(3);
        out.extend(triangle.iter().flat_map(|i| i.to_le_bytes()));
    }
    out
}

fn glb(mesh: &Mesh) -> Result<Vec<u8>, TooLarge> {
    // Colours of corners are linear in glTF.
    let linear = |c: &[u8; 3]| c.map(|v| display::decode(f32::from(v) / 255.0));
    let colours: Vec<[f32; 3]> = mesh.colours.iter().map(linear).collect();
    let mesh = gltf::Mesh {
        positions: &mesh.positions,
        normals: &mesh.normals,
        triangles: &mesh.triangles,
        look: gltf::Look::Colours(&colours),
    };
    gltf::glb(&mesh, serde_json::Value::Null)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn triangle() -> Mesh {
        Mesh {
            positions: vec![[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, -3.0, 1.0]],
            normals: vec![[0.0, 0.0, 1.0]; 3],
            colours: vec![[255, 0, 128]; 3],
            triangles: vec![[0, 1, 2]],
        }
    }

    #[test]
    fn the_ending_of_a_name_says_the_format() {
        assert_eq!(Format::of(Path::new("a/b.PLY")), Some(Format::Ply));
        assert_eq!(Format::of(Path::new("b.glb")), Some(Format::Glb));
        assert_eq!(Format::of(Path::new("b.obj")), None);
    }

    #[test]
    fn a_ply_file_has_the_bytes_that_its_header_claims() {
        let bytes = encode(&triangle(), Format::Ply).expect("small");
        let end = bytes.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
        assert_eq!(bytes.len() - end, 3 * (6 * 4 + 3) + 1 + 3 * 4);
        assert_eq!(&bytes[end + 24..end + 27], &[255, 0, 128]);
    }

    #[test]
    fn a_glb_file_is_two_chunks_whose_lengths_are_true() {
        let bytes = encode(&triangle(), Format::Glb).expect("small");
        let number = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]) as usize;
        assert_eq!((&bytes[..4], number(4), number(8)), (&b"glTF"[..], 2, bytes.len()));
        let text = number(12);
        let document: serde_json::Value = serde_json::from_slice(&bytes[20..20 + text]).expect("JSON");
        assert_eq!(document["accessors"][0]["min"], json!([0.0, -3.0, 1.0]));
        assert_eq!(document["accessors"][0]["max"], json!([2.0, 0.0, 1.0]));
        let binary = number(20 + text);
        assert_eq!(binary, document["buffers"][0]["byteLength"]);
        assert_eq!(28 + text + binary, bytes.len());
        assert_eq!(binary, 3 * 3 * 12 + 12);
        // Full red, and half of blue as a display value is a fifth of its light.
        let colour = |k: usize| f32::from_bits(number(28 + text + 72 + 4 * k) as u32);
        assert!(colour(0) == 1.0 && colour(1) == 0.0 && (colour(2) - 0.216).abs() < 1e-3);
    }
}
