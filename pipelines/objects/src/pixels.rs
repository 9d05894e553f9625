//! Images of captures: PNG, JPEG and EXR to planes of colour and coverage.

use super::error::CaptureError;
use heliosplat::Raster;
use image::{ColorType, DynamicImage, ImageFormat, ImageReader};
use std::path::Path;

/// The longest side that is read, pixels.
const LONGEST_SIDE: u32 = 16_384;

/// Relation of pixel values to light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Encoding {
    /// Display values (sRGB).
    Display,
    /// Values proportional to light.
    Linear,
}

/// One image: colours, and coverage where the file has it.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Red, green and blue times coverage; `NaN` where the file holds no finite number.
    pub colour: Raster,
    /// Coverage of each pixel, 0 to 1.
    pub coverage: Option<Vec<f32>>,
    /// Encoding of the values.
    pub encoding: Encoding,
}

fn reader(path: &Path) -> Result<ImageReader<std::io::BufReader<std::fs::File>>, CaptureError> {
    let io = CaptureError::io(path);
    let reader = ImageReader::open(path)
        .map_err(&io)?
        .with_guessed_format()
        .map_err(&io)?;
    match reader.format() {
        Some(ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::OpenExr) => Ok(reader),
        _ => Err(CaptureError::file(
            path,
            "it is no PNG, JPEG or EXR",
            "convert it, or leave its frame out",
        )),
    }
}

/// True if a file has far fewer bytes than its pixels need (a decompression bomb): photographs and renderings have a
/// tenth of a byte a pixel or more.
fn is_bomb(path: &Path, pixels: u64) -> bool {
    const FREE: u64 = 1 << 22;
    const PER_BYTE: u64 = 50;
    let held = std::fs::metadata(path).map_or(0, |known| known.len());
    pixels > FREE.max(held.saturating_mul(PER_BYTE))
}

const DAMAGED: &str = "write the file anew, or leave its frame out";

/// Columns and rows of an image, from its header.
///
/// # Errors
/// [`CaptureError`] when the file is missing or no image, has a side of more than 16384 pixels, or states more pixels
/// than its bytes can hold.
pub fn size_px(path: &Path) -> Result<[usize; 2], CaptureError> {
    let size = reader(path)?.into_dimensions();
    let (width, height) =
        size.map_err(|error| CaptureError::file(path, format!("it cannot be read ({error})"), DAMAGED))?;
    if width == 0 || height == 0 || width > LONGEST_SIDE || height > LONGEST_SIDE {
        let what = format!("it has {width} x {height} pixels");
        return Err(CaptureError::file(
            path,
            what,
            "give images of 1 to 16384 pixels a side",
        ));
    }
    if is_bomb(path, u64::from(width) * u64::from(height)) {
        let what = format!("it claims {width} x {height} pixels, more than its bytes can hold");
        return Err(CaptureError::file(path, what, DAMAGED));
    }
    Ok([width as usize, height as usize])
}

/// Reads an image whose header [`size_px`] has checked.
///
/// Colours of PNG are multiplied with their coverage; those of EXR are stored that way (OpenEXR, "Interpreting alpha").
///
/// # Errors
/// [`CaptureError`] when the file is missing or damaged.
pub fn read(path: &Path) -> Result<Picture, CaptureError> {
    let mut reader = reader(path)?;
    let linear = reader.format() == Some(ImageFormat::OpenExr);
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(LONGEST_SIDE);
    limits.max_image_height = Some(LONGEST_SIDE);
    reader.limits(limits);
    let decoded = reader.decode();
    let decoded = decoded.map_err(|error| CaptureError::file(path, format!("it cannot be read ({error})"), DAMAGED))?;
    Ok(picture(&decoded, linear))
}

fn picture(decoded: &DynamicImage, linear: bool) -> Picture {
    let has_coverage = decoded.color().has_alpha();
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let plane = width * height;
    let mut colour = Raster::filled(width, height, 3, 0.0);
    let mut coverage = if has_coverage { vec![1.0; plane] } else { Vec::new() };
    let mut put = |i: usize, [r, g, b, a]: [f32; 4]| {
        let times = if has_coverage && !linear { a } else { 1.0 };
        for (k, value) in [r, g, b].into_iter().enumerate() {
            // A pixel that is no number counts as missing.
            let value = value * times;
            colour.values[k * plane + i] = if value.is_finite() { value } else { f32::NAN };
        }
        if let Some(slot) = coverage.get_mut(i) {
            *slot = if a.is_finite() { a.clamp(0.0, 1.0) } else { 0.0 };
        }
    };
    // Sixteen bits and floats keep their precision; eight bits need no more.
    let eight = matches!(
        decoded.color(),
        ColorType::L8 | ColorType::La8 | ColorType::Rgb8 | ColorType::Rgba8
    );
    if eight {
        let pixels = decoded.to_rgba8();
        pixels
            .pixels()
            .enumerate()
            .for_each(|(i, p)| put(i, p.0.map(|v| f32::from(v) / 255.0)));
    } else {
        let pixels = decoded.to_rgba32f();
        pixels.pixels().enumerate().for_each(|(i, p)| put(i, p.0));
    }
    Picture {
        colour,
        coverage: has_coverage.then_some(coverage),
        encoding: if linear { Encoding::Linear } else { Encoding::Display },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, Rgb32FImage, Rgba, Rgba32FImage, RgbaImage};

    #[test]
    fn a_png_is_multiplied_with_its_coverage_and_an_exr_is_as_stored() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (png, exr) = (folder.path().join("a.png"), folder.path().join("a.exr"));
        RgbaImage::from_pixel(4, 3, Rgba([255, 102, 0, 51]))
            .save(&png)
            .expect("written");
        let read_png = read(&png).expect("a sound file");
        assert_eq!(size_px(&png).expect("a sound file"), [4, 3]);
        assert!((read_png.colour.at(0, 1, 1) - 0.2).abs() < 1e-6 && (read_png.colour.at(1, 1, 1) - 0.08).abs() < 1e-6);
        assert_eq!(read_png.coverage.expect("coverage")[0], 0.2);
        assert_eq!(read_png.encoding, Encoding::Display);
        Rgba32FImage::from_pixel(4, 3, Rgba([3.0, 0.5, 0.0, 0.5]))
            .save(&exr)
            .expect("written");
        let read_exr = read(&exr).expect("a sound file");
        assert_eq!(
            (read_exr.colour.at(0, 3, 2), read_exr.encoding),
            (3.0, Encoding::Linear)
        );
        Rgb32FImage::from_pixel(4, 3, Rgb([f32::NAN, 0.5, 0.0]))
            .save(&exr)
            .expect("written");
        let read_exr = read(&exr).expect("a sound file");
        assert!(read_exr.coverage.is_none() && read_exr.colour.at(0, 0, 0).is_nan());
    }

    #[test]
    fn a_header_that_claims_too_much_and_a_file_cut_short_are_refused() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.png");
        RgbaImage::new(8, 8).save(&path).expect("written");
        let mut bytes = std::fs::read(&path).expect("readable");
        std::fs::write(&path, &bytes[..bytes.len() - 20]).expect("written");
        let error = read(&path).expect_err("cut short").to_string();
        assert!(
            error.contains("a.png: it cannot be read") && error.contains("anew"),
            "{error}"
        );
        // Width in the header, whose checksum no longer holds either.
        bytes[16..20].copy_from_slice(&200_000u32.to_be_bytes());
        std::fs::write(&path, &bytes).expect("written");
        assert!(size_px(&path).is_err());
        let notes = folder.path().join("notes");
        std::fs::write(&notes, "text").expect("written");
        let error = size_px(&notes).expect_err("no image").to_string();
        assert!(error.contains("no PNG, JPEG or EXR"), "{error}");
    }
}
