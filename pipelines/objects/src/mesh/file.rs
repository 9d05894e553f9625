//! Meshes as other programs read them: binary PLY with colours, and glTF 2.0 in one file (GLB).

use super::Mesh;
use heliosplat::shade::display;
use serde_json::json;
use std::path::Path;

/// How a mesh is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Stanford's polygons, binary, little-endian.
    Ply,
    /// Khronos' glTF 2.0, binary.
    Glb,
}

impl Format {
    /// The format that the ending of a file's name stands for.
    pub fn of(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_str()?.to_ascii_lowercase();
        match ending.as_str() {
            "ply" => Some(Self::Ply),
            "glb" => Some(Self::Glb),
            _ => None,
        }
    }
}

/// The bytes of a file.
pub fn encode(mesh: &Mesh, format: Format) -> Vec<u8> {
    match format {
        Format::Ply => ply(mesh),
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

/// Numbers of glTF 2.0.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

fn glb(mesh: &Mesh) -> Vec<u8> {
    // Colours of corners are linear in glTF.
    let colours = mesh
        .colours
        .iter()
        .map(|c| c.map(|v| display::decode(f32::from(v) / 255.0)));
    let floats = |values: &mut dyn Iterator<Item = [f32; 3]>| -> Vec<u8> {
        values.flatten().flat_map(f32::to_le_bytes).collect()
    };
    let parts = [
        floats(&mut mesh.positions.iter().copied()),
        floats(&mut mesh.normals.iter().copied()),
        floats(&mut { colours }),
        mesh.triangles.iter().flatten().flat_map(|i| i.to_le_bytes()).collect(),
    ];
    let bound = |pick: fn(f32, f32) -> f32, from: f32| {
        let fold = |bound: [f32; 3], p: &[f32; 3]| std::array::from_fn(|k| pick(bound[k], p[k]));
        mesh.positions.iter().fold([from; 3], fold)
    };
    let (mut views, mut offset) = (Vec::new(), 0);
    for (part, bytes) in parts.iter().enumerate() {
        let target = if part == 3 { ELEMENT_ARRAY_BUFFER } else { ARRAY_BUFFER };
        views.push(json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len(), "target": target}));
        offset += bytes.len();
    }
    let corners = mesh.positions.len();
    let document = json!({
        "asset": {"version": "2.0", "generator": concat!("heliosplat ", env!("CARGO_PKG_VERSION"))},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{
            "attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}, "indices": 3, "material": 0,
        }]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}],
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": [
            {"bufferView": 0, "componentType": FLOAT, "count": corners, "type": "VEC3",
             "min": bound(f32::min, f32::INFINITY), "max": bound(f32::max, f32::NEG_INFINITY)},
            {"bufferView": 1, "componentType": FLOAT, "count": corners, "type": "VEC3"},
            {"bufferView": 2, "componentType": FLOAT, "count": corners, "type": "VEC3"},
            {"bufferView": 3, "componentType": UNSIGNED_INT, "count": 3 * mesh.triangles.len(), "type": "SCALAR"},
        ],
    });
    let mut text = document.to_string().into_bytes();
    // Chunks end at multiples of four: text in spaces.
    text.resize(text.len().next_multiple_of(4), b' ');
    let length = 12 + 8 + text.len() + 8 + offset;
    let mut out = Vec::with_capacity(length);
    out.extend(b"glTF");
    for number in [2, length as u32, text.len() as u32] {
        out.extend(number.to_le_bytes());
    }
    out.extend(b"JSON");
    out.extend(text);
    out.extend((offset as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(parts.concat());
    out
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let bytes = encode(&triangle(), Format::Ply);
        let end = bytes.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
        assert_eq!(bytes.len() - end, 3 * (6 * 4 + 3) + 1 + 3 * 4);
        assert_eq!(&bytes[end + 24..end + 27], &[255, 0, 128]);
    }

    #[test]
    fn a_glb_file_is_two_chunks_whose_lengths_are_true() {
        let bytes = encode(&triangle(), Format::Glb);
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
