//! glTF 2.0 in one binary file (GLB): one buffer, its views and accessors, and the document that names them.
//!
//! Source: Khronos, glTF 2.0 specification, §3.6 (accessors) and §4 (GLB). Lengths are 32-bit numbers: a file holds 4
//! GiB at most.

use serde_json::{Value, json};

const FLOAT: u32 = 5126;
const UNSIGNED_BYTE: u32 = 5121;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// The contents exceed the size limit of the format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{0} bytes do not fit into one GLB file, which holds 4 GiB; write tiles instead (--tiles DIR)")]
pub struct TooLarge(pub u64);

/// GLB file under construction: its buffer, buffer views and accessors.
#[derive(Debug, Default)]
pub struct Builder {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Builder {
    /// Adds bytes that no accessor reads, such as a picture; returns the index of their buffer view.
    pub fn bytes(&mut self, bytes: &[u8]) -> usize {
        self.view(bytes.iter().copied(), None)
    }

    /// Adds an accessor of vectors of `N` floats, 1 to 4 (a scalar where `N` is 1); returns its index.
    pub fn floats<const N: usize>(&mut self, values: impl ExactSizeIterator<Item = [f32; N]>) -> usize {
        let count = values.len();
        let view = self.view(values.flatten().flat_map(f32::to_le_bytes), Some(ARRAY_BUFFER));
        let kind = kind(N);
        self.accessor(json!({"bufferView": view, "componentType": FLOAT, "count": count, "type": kind}))
    }

    /// Adds an accessor of positions, with the bounds that glTF requires; returns its index.
    pub fn places(&mut self, places: &[[f32; 3]]) -> usize {
        let accessor = self.floats(places.iter().copied());
        let (low, high) = bounds(places);
        self.accessors[accessor]["min"] = json!(low);
        self.accessors[accessor]["max"] = json!(high);
        accessor
    }

    /// Adds an accessor of colours, four bytes each (red, green, blue, opacity) that stand for 0 to 1; returns its
    /// index.
    pub fn colours(&mut self, colours: impl ExactSizeIterator<Item = [u8; 4]>) -> usize {
        let count = colours.len();
        let view = self.view(colours.flatten(), Some(ARRAY_BUFFER));
        self.accessor(json!({
            "bufferView": view, "componentType": UNSIGNED_BYTE, "normalized": true, "count": count, "type": "VEC4",
        }))
    }

    /// Adds an accessor of triangles, three indices of corners each; returns its index.
    pub fn triangles(&mut self, triangles: &[[u32; 3]]) -> usize {
        let bytes = triangles.iter().flatten().flat_map(|i| i.to_le_bytes());
        let view = self.view(bytes, Some(ELEMENT_ARRAY_BUFFER));
        let count = 3 * triangles.len();
        self.accessor(json!({"bufferView": view, "componentType": UNSIGNED_INT, "count": count, "type": "SCALAR"}))
    }

    /// Adds an accessor of `count` vectors of `width` floats whose values are compressed elsewhere; returns its index.
    pub fn placeholder(&mut self, width: usize, count: usize) -> usize {
        let kind = kind(width);
        self.accessor(json!({"componentType": FLOAT, "count": count, "type": kind}))
    }

    /// Adds an accessor of `count` positions between the corners `low` and `high`, compressed elsewhere; returns its
    /// index.
    pub fn placeholder_places(&mut self, count: usize, low: [f32; 3], high: [f32; 3]) -> usize {
        self.accessor(json!({"componentType": FLOAT, "count": count, "type": "VEC3", "min": low, "max": high}))
    }

    /// Adds an accessor of `count` colours of four bytes, compressed elsewhere; returns its index.
    pub fn placeholder_colours(&mut self, count: usize) -> usize {
        self.accessor(json!({"componentType": UNSIGNED_BYTE, "normalized": true, "count": count, "type": "VEC4"}))
    }

    /// Bytes of the finished file. `document` is an object of everything outside the buffer: meshes, nodes, materials
    /// and so on; its null entries are left out.
    ///
    /// # Errors
    /// [`TooLarge`] for a file of more than 4 GiB.
    pub fn finish(mut self, mut document: Value) -> Result<Vec<u8>, TooLarge> {
        self.pad();
        if let Some(document) = document.as_object_mut() {
            document.retain(|_, value| !value.is_null());
        }
        document["asset"] = json!({"version": "2.0", "generator": concat!("heliosplat ", env!("CARGO_PKG_VERSION"))});
        document["buffers"] = json!([{"byteLength": self.binary.len()}]);
        document["bufferViews"] = self.views.into();
        document["accessors"] = self.accessors.into();
        let mut text = document.to_string().into_bytes();
        // Chunks end at multiples of four: text in spaces, numbers in zeros.
        text.resize(text.len().next_multiple_of(4), b' ');
        let length = 12 + 8 + text.len() + 8 + self.binary.len();
        let short = |length: usize| u32::try_from(length).map_err(|_| TooLarge(length as u64));
        let mut out = Vec::with_capacity(length);
        out.extend(b"glTF");
        for number in [2, short(length)?, short(text.len())?] {
            out.extend(number.to_le_bytes());
        }
        out.extend(b"JSON");
        out.extend(text);
        out.extend(short(self.binary.len())?.to_le_bytes());
        out.extend(b"BIN\0");
        out.extend(self.binary);
        Ok(out)
    }

    fn pad(&mut self) {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
    }

    fn view(&mut self, bytes: impl Iterator<Item = u8>, target: Option<u32>) -> usize {
        self.pad();
        let offset = self.binary.len();
        self.binary.extend(bytes);
        let mut view = json!({"buffer": 0, "byteOffset": offset, "byteLength": self.binary.len() - offset});
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.views.push(view);
        self.views.len() - 1
    }

    fn accessor(&mut self, accessor: Value) -> usize {
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }
}

/// Lowest and highest coordinate of positions along each axis; infinite without positions.
pub fn bounds(places: &[[f32; 3]]) -> ([f32; 3], [f32; 3]) {
    let start = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    places.iter().fold(start, |(low, high), place| {
        let bound = |k| (f32::min(low[k], place[k]), f32::max(high[k], place[k]));
        let [x, y, z] = [0, 1, 2].map(bound);
        ([x.0, y.0, z.0], [x.1, y.1, z.1])
    })
}

fn kind(width: usize) -> &'static str {
    ["SCALAR", "VEC2", "VEC3", "VEC4"][width - 1]
}

/// The two chunks of a file, for tests: its document and its buffer.
///
/// # Panics
/// When the file is not framed as specified.
#[cfg(test)]
pub(crate) fn chunks(bytes: &[u8]) -> (Value, &[u8]) {
    let number = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]) as usize;
    assert_eq!((&bytes[..4], number(4), number(8)), (&b"glTF"[..], 2, bytes.len()));
    let text = number(12);
    assert_eq!((&bytes[16..20], text % 4), (&b"JSON"[..], 0));
    let document: Value = serde_json::from_slice(&bytes[20..20 + text]).expect("JSON");
    let binary = number(20 + text);
    assert_eq!((&bytes[24 + text..28 + text], binary % 4), (&b"BIN\0"[..], 0));
    assert_eq!(28 + text + binary, bytes.len());
    assert_eq!(document["buffers"][0]["byteLength"], binary);
    (document, &bytes[28 + text..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_begin_at_multiples_of_four_and_chunks_are_padded() {
        let mut file = Builder::default();
        assert_eq!(file.bytes(&[1, 2, 3, 4, 5]), 0);
        let places = [[0.0, -3.0, 1.0], [2.0, 0.5, 1.0], [0.0, 0.0, -7.0]];
        let accessor = file.places(&places);
        let bytes = file.finish(json!({"scene": 0, "odd": "x"})).expect("small");
        let (document, binary) = chunks(&bytes);
        assert_eq!(document["bufferViews"][0]["byteLength"], 5);
        assert_eq!(document["bufferViews"][1]["byteOffset"], 8);
        assert_eq!(&binary[5..8], &[0; 3]);
        assert_eq!(&binary[12..16], &(-3f32).to_le_bytes());
        assert_eq!(document["accessors"][accessor]["min"], json!([0.0, -3.0, -7.0]));
        assert_eq!(document["accessors"][accessor]["max"], json!([2.0, 0.5, 1.0]));
        assert_eq!(document["accessors"][accessor]["count"], 3);
    }
}
