//! Triangle meshes as glTF: with colours of the corners, or with a picture spread over them. Materials are rough and
//! lit by the viewer.

use crate::glb::{Builder, TooLarge};
use serde_json::{Value, json};

/// Surface colour of a mesh before lighting.
#[derive(Debug, Clone, Copy)]
pub enum Look<'a> {
    /// Colour of each corner, red, green and blue in linear light.
    Colours(&'a [[f32; 3]]),
    /// Picture spread over the mesh.
    Picture {
        /// Bytes of the picture's file.
        file: &'a [u8],
        /// Media type of the file: `image/png` or `image/jpeg`.
        media_type: &'a str,
        /// Position of each corner in the picture: 0 to 1 from left to right, and from top to bottom.
        places: &'a [[f32; 2]],
    },
}

/// Triangle mesh in the frame of the glTF file.
#[derive(Debug, Clone, Copy)]
pub struct Mesh<'a> {
    /// Positions of the corners, metres.
    pub positions: &'a [[f32; 3]],
    /// Unit normals of the corners.
    pub normals: &'a [[f32; 3]],
    /// Indices of the corners of each triangle, anticlockwise as seen from outside.
    pub triangles: &'a [[u32; 3]],
    /// Surface colour.
    pub look: Look<'a>,
}

/// Bytes of the GLB file of a mesh, with `extras` (an object, or null) as metadata.
///
/// # Errors
/// [`TooLarge`] for a file of more than 4 GiB.
pub fn glb(mesh: &Mesh, extras: Value) -> Result<Vec<u8>, TooLarge> {
    let mut file = Builder::default();
    let mut attributes = json!({
        "POSITION": file.places(mesh.positions), "NORMAL": file.floats(mesh.normals.iter().copied()),
    });
    let mut surface = json!({"metallicFactor": 0.0, "roughnessFactor": 1.0});
    let mut document = json!({"extras": extras, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]});
    match mesh.look {
        Look::Colours(colours) => attributes["COLOR_0"] = file.floats(colours.iter().copied()).into(),
        Look::Picture {
            file: picture,
            media_type,
            places,
        } => {
            attributes["TEXCOORD_0"] = file.floats(places.iter().copied()).into();
            surface["baseColorTexture"] = json!({"index": 0});
            document["images"] = json!([{"bufferView": file.bytes(picture), "mimeType": media_type}]);
            document["textures"] = json!([{"source": 0, "sampler": 0}]);
            // Linear filters and mip maps; the picture ends at its edges.
            document["samplers"] = json!([{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}]);
        }
    }
    let indices = file.triangles(mesh.triangles);
    document["meshes"] = json!([{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}]);
    document["materials"] = Value::Array(vec![json!({"pbrMetallicRoughness": surface})]);
    file.finish(document)
}
