//! GeoTIFF, written tag by tag: rational cameras, georeferencing, GDAL's metadata.

use crate::crop::Canvas;
use crate::error::SynthError;
use crate::truth_grid::TruthGrid;
use std::borrow::Cow;
use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::Path;
use tiff::TiffResult;
use tiff::encoder::{DirectoryEncoder, TiffEncoder, TiffKind, TiffValue};
use tiff::tags::Tag;

/// RPCCoefficientTag.
const RPC_TAG: u16 = 50_844;
const MODEL_PIXEL_SCALE: u16 = 33_550;
const MODEL_TIEPOINT: u16 = 33_922;
const GEO_KEY_DIRECTORY: u16 = 34_735;
const GDAL_METADATA: u16 = 42_112;
const GDAL_NODATA: u16 = 42_113;
/// Approximate size of a strip, bytes.
const STRIP_BYTES: usize = 1 << 16;
/// Side of the tiles of a canvas, pixels.
const TILE: usize = 256;

/// Samples, bands interleaved by pixel.
#[derive(Clone, Copy)]
pub(crate) enum Samples<'a> {
    U8(&'a [u8]),
    U16(&'a [u16]),
    F32(&'a [f32]),
    F64(&'a [f64]),
}

/// A raster and the metadata of its file.
#[derive(Clone)]
pub(crate) struct Raster<'a> {
    /// Columns.
    pub(crate) width: usize,
    /// Rows.
    pub(crate) height: usize,
    /// Samples, row by row.
    pub(crate) samples: Samples<'a>,
    /// Name of each band.
    pub(crate) bands: &'a [&'a str],
    /// Items (name, value) of GDAL's default metadata domain.
    pub(crate) items: &'a [(&'a str, &'a str)],
    /// The 92 values of RPCCoefficientTag, if the raster has a camera.
    pub(crate) rpc: Option<[f64; 92]>,
    /// Georeference, if the raster has one.
    pub(crate) grid: Option<&'a TruthGrid>,
    /// Value of missing samples, if any.
    pub(crate) nodata: Option<f32>,
    /// The larger file that the raster lies in, if any; samples outside of the raster are 0.
    pub(crate) canvas: Option<Canvas>,
}

impl<'a> Samples<'a> {
    /// Samples of the counts of an image: as they are for 16 bits, clipped to 255 and stored in `bytes` for 8 bits.
    pub(crate) fn of_counts(counts: &'a [u16], bits: u8, bytes: &'a mut Vec<u8>) -> Self {
        if bits != 8 {
            return Self::U16(counts);
        }
        bytes.extend(counts.iter().map(|&count| count.min(255) as u8));
        Self::U8(bytes)
    }

    /// The samples in the order of bytes of this machine, their bits, and TIFF's SampleFormat.
    fn encoded(&self) -> (Cow<'a, [u8]>, u16, u16) {
        const UNSIGNED: u16 = 1;
        const FLOATING: u16 = 3;
        match *self {
            Samples::U8(samples) => (samples.data(), 8, UNSIGNED),
            Samples::U16(samples) => (samples.data(), 16, UNSIGNED),
            Samples::F32(samples) => (samples.data(), 32, FLOATING),
            Samples::F64(samples) => (samples.data(), 64, FLOATING),
        }
    }
}

/// Writes a raster as an uncompressed TIFF: in strips, or on a canvas as a BigTIFF of tiles in which tiles outside of
/// the raster are not stored.
///
/// # Errors
/// `SynthError::Failed` when it cannot be written.
pub(crate) fn write(path: &Path, raster: &Raster) -> Result<(), SynthError> {
    let unwritable = SynthError::unwritable(path);
    let mut buffered = BufWriter::new(File::create(path).map_err(&unwritable)?);
    encode(&mut buffered, raster).map_err(SynthError::unwritable(path))?;
    let file = buffered.into_inner().map_err(|error| unwritable(error.into_error()))?;
    file.sync_all().map_err(unwritable)
}

fn encode<W: Write + Seek>(writer: W, raster: &Raster) -> TiffResult<()> {
    match raster.canvas {
        None => put(TiffEncoder::new(writer)?, raster),
        Some(_) => put(TiffEncoder::new_big(writer)?, raster),
    }
}

fn put<W: Write + Seek, K: TiffKind>(mut encoder: TiffEncoder<W, K>, raster: &Raster) -> TiffResult<()> {
    let mut directory = encoder.image_directory()?;
    let (bytes, bits, format) = raster.samples.encoded();
    let pixel_bytes = raster.bands.len() * usize::from(bits / 8);
    match &raster.canvas {
        None => strips(&mut directory, raster, &bytes, pixel_bytes)?,
        Some(canvas) => tiles(&mut directory, raster, &bytes, pixel_bytes, canvas)?,
    }
    baseline_tags(&mut directory, raster, bits, format)?;
    if let Some(rpc) = &raster.rpc {
        directory.write_tag(Tag::Unknown(RPC_TAG), &rpc[..])?;
    }
    if let Some(grid) = raster.grid {
        grid_tags(&mut directory, grid)?;
    }
    directory.write_tag(Tag::Unknown(GDAL_METADATA), metadata_xml(raster).as_str())?;
    if let Some(nodata) = raster.nodata {
        directory.write_tag(Tag::Unknown(GDAL_NODATA), nodata.to_string().as_str())?;
    }
    directory.finish()
}

fn strips<W: Write + Seek, K: TiffKind>(
    directory: &mut DirectoryEncoder<W, K>,
    raster: &Raster,
    bytes: &[u8],
    pixel_bytes: usize,
) -> TiffResult<()> {
    let row_bytes = raster.width * pixel_bytes;
    let rows = (STRIP_BYTES / row_bytes).clamp(1, raster.height);
    let (mut offsets, mut lengths) = (Vec::new(), Vec::new());
    for strip in bytes.chunks(row_bytes * rows) {
        offsets.push(u32::try_from(directory.write_data(strip)?)?);
        lengths.push(u32::try_from(strip.len())?);
    }
    directory.write_tag(Tag::RowsPerStrip, u32::try_from(rows)?)?;
    directory.write_tag(Tag::StripOffsets, &offsets[..])?;
    directory.write_tag(Tag::StripByteCounts, &lengths[..])
}

/// Writes the tiles that hold a part of the raster. The offset and the length of all others are 0, by which GDAL knows
/// tiles that are missing.
fn tiles<W: Write + Seek, K: TiffKind>(
    directory: &mut DirectoryEncoder<W, K>,
    raster: &Raster,
    bytes: &[u8],
    pixel_bytes: usize,
    canvas: &Canvas,
) -> TiffResult<()> {
    let across = canvas.size.div_ceil(TILE);
    let (mut offsets, mut lengths) = (vec![0u64; across * across], vec![0u64; across * across]);
    // Columns or rows of the canvas that a tile shares with the raster.
    let shared =
        |tile: usize, first: usize, length: usize| first.max(tile * TILE)..(first + length).min((tile + 1) * TILE);
    for index in 0..across * across {
        let (left, top) = (index % across, index / across);
        let cols = shared(left, canvas.col, raster.width);
        let rows = shared(top, canvas.row, raster.height);
        if cols.is_empty() || rows.is_empty() {
            continue;
        }
        let mut tile = vec![0u8; TILE * TILE * pixel_bytes];
        for row in rows {
            let from = ((row - canvas.row) * raster.width + cols.start - canvas.col) * pixel_bytes;
            let to = ((row - top * TILE) * TILE + cols.start - left * TILE) * pixel_bytes;
            let length = cols.len() * pixel_bytes;
            tile[to..to + length].copy_from_slice(&bytes[from..from + length]);
        }
        offsets[index] = directory.write_data(&tile[..])?;
        lengths[index] = u64::try_from(tile.len())?;
    }
    directory.write_tag(Tag::TileWidth, u32::try_from(TILE)?)?;
    directory.write_tag(Tag::TileLength, u32::try_from(TILE)?)?;
    directory.write_tag(Tag::TileOffsets, &offsets[..])?;
    directory.write_tag(Tag::TileByteCounts, &lengths[..])
}

fn baseline_tags<W: Write + Seek, K: TiffKind>(
    directory: &mut DirectoryEncoder<W, K>,
    raster: &Raster,
    bits: u16,
    format: u16,
) -> TiffResult<()> {
    const BLACK_IS_ZERO: u16 = 1;
    const RGB: u16 = 2;
    let bands = raster.bands.len();
    let colour = raster.bands.first() == Some(&"Red") && bands >= 3;
    let [width, height] = (raster.canvas).map_or([raster.width, raster.height], |canvas| [canvas.size; 2]);
    directory.write_tag(Tag::ImageWidth, u32::try_from(width)?)?;
    directory.write_tag(Tag::ImageLength, u32::try_from(height)?)?;
    directory.write_tag(Tag::BitsPerSample, &vec![bits; bands][..])?;
    directory.write_tag(Tag::Compression, 1u16)?;
    directory.write_tag(Tag::PhotometricInterpretation, if colour { RGB } else { BLACK_IS_ZERO })?;
    directory.write_tag(Tag::SamplesPerPixel, u16::try_from(bands)?)?;
    directory.write_tag(Tag::PlanarConfiguration, 1u16)?;
    directory.write_tag(Tag::SampleFormat, &vec![format; bands][..])?;
    let extra = bands - if colour { 3 } else { 1 };
    if extra > 0 {
        // 0: unspecified, in particular not transparency.
        directory.write_tag(Tag::ExtraSamples, &vec![0u16; extra][..])?;
    }
    Ok(())
}

fn grid_tags<W: Write + Seek, K: TiffKind>(directory: &mut DirectoryEncoder<W, K>, grid: &TruthGrid) -> TiffResult<()> {
    let scale = [grid.cell_m, grid.cell_m, 0.0];
    let tiepoint = [0.0, 0.0, 0.0, grid.west_m, grid.north_m, 0.0];
    // Version 1.1.0 and three keys: a projected model, pixels that are areas, the zone's EPSG code.
    let epsg = grid.zone.epsg();
    let keys = [[1u16, 1, 0, 3], [1024, 0, 1, 1], [1025, 0, 1, 1], [3072, 0, 1, epsg]].concat();
    directory.write_tag(Tag::Unknown(MODEL_PIXEL_SCALE), &scale[..])?;
    directory.write_tag(Tag::Unknown(MODEL_TIEPOINT), &tiepoint[..])?;
    directory.write_tag(Tag::Unknown(GEO_KEY_DIRECTORY), &keys[..])
}

/// GDAL's metadata tag: items of the default domain, and a description for each band.
fn metadata_xml(raster: &Raster) -> String {
    let mut xml = String::from("<GDALMetadata>\n");
    for (name, value) in raster.items {
        xml += &format!("  <Item name=\"{}\">{}</Item>\n", escaped(name), escaped(value));
    }
    for (index, name) in raster.bands.iter().enumerate() {
        xml += &format!(
            "  <Item name=\"DESCRIPTION\" sample=\"{index}\" role=\"description\">{}</Item>\n",
            escaped(name)
        );
    }
    xml + "</GDALMetadata>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;
    use tiff::decoder::{Decoder, DecodingResult};

    #[test]
    fn samples_and_tags_come_back() {
        let counts: Vec<u16> = (0..4 * 30 * 20).collect();
        let rpc: [f64; 92] = std::array::from_fn(|k| k as f64 * 1.1);
        let items = [("A<B", "1 & 2")];
        let raster = Raster {
            width: 30,
            height: 20,
            samples: Samples::U16(&counts),
            bands: &["Red", "Green", "Blue", "NIR"],
            items: &items,
            rpc: Some(rpc),
            grid: None,
            nodata: None,
            canvas: None,
        };
        let mut bytes = Cursor::new(Vec::new());
        encode(&mut bytes, &raster).expect("encoded");
        bytes.set_position(0);
        let mut decoder = Decoder::new(bytes).expect("a TIFF");
        assert_eq!(decoder.dimensions().expect("size"), (30, 20));
        assert_eq!(decoder.get_tag_f64_vec(Tag::Unknown(RPC_TAG)).expect("tag"), rpc);
        assert_eq!(decoder.get_tag_u16_vec(Tag::ExtraSamples).expect("tag"), [0]);
        let xml = decoder.get_tag_ascii_string(Tag::Unknown(GDAL_METADATA)).expect("tag");
        assert!(xml.contains("<Item name=\"A&lt;B\">1 &amp; 2</Item>") && xml.contains(">NIR</Item>"));
        match decoder.read_image().expect("samples") {
            // The decoder leaves out samples that are neither colour nor transparency.
            DecodingResult::U16(samples) => assert!(samples.iter().eq(counts.iter().filter(|&&count| count % 4 != 3))),
            _ => panic!("not 16-bit samples"),
        }
    }

    #[test]
    fn a_canvas_holds_the_samples_at_their_offset_and_stores_no_other_tile() {
        let counts: Vec<u16> = (1..=3 * 300 * 20).map(|k| (k % 65_000) as u16).collect();
        let canvas = Canvas {
            size: 1500,
            col: 448,
            row: 1024 - 7,
        };
        let raster = Raster {
            width: 300,
            height: 20,
            samples: Samples::U16(&counts),
            bands: &["Red", "Green", "Blue"],
            items: &[],
            rpc: None,
            grid: None,
            nodata: Some(0.0),
            canvas: Some(canvas),
        };
        let mut bytes = Cursor::new(Vec::new());
        encode(&mut bytes, &raster).expect("encoded");
        bytes.set_position(0);
        let mut decoder = Decoder::new(bytes).expect("a BigTIFF");
        assert_eq!(decoder.dimensions().expect("size"), (1500, 1500));
        let lengths = decoder.get_tag_u64_vec(Tag::TileByteCounts).expect("tag");
        let stored = |index: &usize| lengths[*index] > 0;
        // Columns 448 to 747 and rows 1017 to 1036: tiles 1 and 2 of the rows 3 and 4 of 6.
        assert_eq!((0..36).filter(stored).collect::<Vec<_>>(), [19, 20, 25, 26]);
        for index in [19u32, 20, 25, 26] {
            let DecodingResult::U16(tile) = decoder.read_chunk(index).expect("a tile") else {
                panic!("not 16-bit samples");
            };
            for (place, sample) in tile.iter().enumerate() {
                let (pixel, band) = (place / 3, place % 3);
                let col = (index as usize % 6 * TILE + pixel % TILE).wrapping_sub(canvas.col);
                let row = (index as usize / 6 * TILE + pixel / TILE).wrapping_sub(canvas.row);
                let inside = col < 300 && row < 20;
                let expected = if inside {
                    counts[(row * 300 + col) * 3 + band]
                } else {
                    0
                };
                assert_eq!(*sample, expected, "tile {index}, pixel {pixel}");
            }
        }
    }
}
