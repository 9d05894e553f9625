//! The cut stored with a run (`cut.json`): all quantities that decide which pixels and cameras were used.

use super::{AltitudeRange, Area, BandKind, Cut, CutImage, Result, RpcPreference, SceneImage, Split};
use heliosplat_delivery::{Counts, FileIdentity, Hashes, Index, IndexImage};
use heliosplat_raster::{Window, is_virtual, sha256};
use heliosplat_rpc::{GeoPoint, LocalFrame, Rpc};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A cut whose pixels were read, with the identities of its files.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct KeptCut {
    /// Preferred kind of camera, for images with several.
    pub rpc: RpcPreference,
    /// Origin of the ENU frame.
    pub origin: GeoPoint,
    /// Altitudes that the surface may have, metres above the ellipsoid.
    pub altitude: AltitudeRange,
    /// Ground of the cut, metres of the frame.
    pub area: Area,
    /// Counts per unit of the pixels.
    pub counts_per_unit: f64,
    /// Images of the cut.
    pub images: Vec<KeptImage>,
}

/// An image of a cut whose pixels were read.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct KeptImage {
    /// Name of the image.
    pub name: String,
    /// The image file, and further files with pixels of the image.
    pub paths: Vec<PathBuf>,
    /// Identities of these files; empty where `pixels_sha256` replaces them.
    #[serde(default)]
    pub files: Vec<FileIdentity>,
    /// SHA-256 of the values read, for an image that was read in part or from a virtual file system.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixels_sha256: Option<String>,
    /// Train or test.
    pub split: Split,
    /// Columns and rows of the image.
    pub size: (usize, usize),
    /// Window that was read, pixels.
    pub window: Window,
    /// Indices of the bands in the file, from 0.
    pub file_bands: Vec<usize>,
    /// Kind of each band.
    pub bands: Vec<BandKind>,
    /// Linear counts or display values.
    pub counts: Counts,
    /// Rational camera, in pixels of the file.
    pub camera: Rpc,
    /// Source of the camera: `image` or a file name.
    pub camera_source: String,
}

impl KeptCut {
    /// The images of a cut, with the data of the index.
    pub(super) fn of(index: &Index, cut: &Cut, counts_per_unit: f64) -> Self {
        let images = cut.images.iter().filter_map(|part| {
            let image = index.images.get(part.image)?;
            Some(KeptImage {
                name: image.name.clone(),
                paths: std::iter::once(&image.path).chain(&image.others).cloned().collect(),
                files: Vec::new(),
                pixels_sha256: None,
                split: part.split,
                size: image.size,
                window: part.window,
                file_bands: image.bands.file_bands.clone(),
                bands: image.bands.kinds.clone(),
                counts: image.counts,
                camera: image.rpc.clone(),
                camera_source: image.rpc_source.clone(),
            })
        });
        Self {
            rpc: index.rpc,
            origin: cut.frame.origin,
            altitude: cut.altitude.clone(),
            area: cut.area,
            counts_per_unit,
            images: images.collect(),
        }
    }

    /// Stores size, modification time and hash of each file with pixels; hashes in `hashes` are reused. Of the `images`
    /// that were read in part or from a virtual file system, the pixels are hashed instead: the rest of such a file is
    /// not read for its identity.
    ///
    /// # Errors
    /// When a file cannot be read.
    pub fn identify(&mut self, images: &[SceneImage], hashes: &mut Hashes) -> Result<()> {
        for kept in &mut self.images {
            if !kept.is_whole() {
                let read = images.iter().find(|image| image.name == kept.name);
                kept.pixels_sha256 = read.map(|image| sha256::of_values(&image.pixels.values));
                continue;
            }
            for path in &kept.paths {
                kept.files.push(hashes.identify(path)?);
            }
        }
        Ok(())
    }

    /// Compares the pixels of `images`, which were read again, with the stored hashes.
    ///
    /// # Errors
    /// The first image with other pixels, in words.
    pub fn check_pixels(&self, images: &[SceneImage]) -> Result<(), String> {
        for kept in self.images.iter().filter(|kept| kept.pixels_sha256.is_some()) {
            let read = images.iter().find(|image| image.name == kept.name);
            if let Some(read) = read.filter(|read| kept.pixels_sha256 != Some(sha256::of_values(&read.pixels.values))) {
                return Err(format!("{} has changed", read.path.display()));
            }
        }
        Ok(())
    }

    /// The stored cut, applied to the current delivery.
    ///
    /// # Errors
    /// The first difference in words: a missing or changed image, other bands, or another camera.
    pub fn again(&self, index: &Index) -> Result<Cut, String> {
        let numbered = index.images.iter().enumerate();
        let by_name: BTreeMap<&str, usize> = numbered.map(|(place, image)| (image.name.as_str(), place)).collect();
        let mut images = Vec::with_capacity(self.images.len());
        for kept in &self.images {
            let place = by_name.get(kept.name.as_str());
            let found = place.and_then(|&place| Some((place, index.images.get(place)?)));
            let Some((place, image)) = found else {
                return Err(format!("the image {} is missing", kept.name));
            };
            if let Some(difference) = kept.difference(image) {
                return Err(difference);
            }
            let (window, split) = (kept.window, kept.split);
            let image = place;
            images.push(CutImage { image, window, split });
        }
        Ok(Cut {
            frame: LocalFrame::new(self.origin),
            altitude: self.altitude.clone(),
            area: self.area,
            images,
            is_part: false,
            counts_per_unit: Some(self.counts_per_unit),
        })
    }
}

impl KeptImage {
    /// True for an image that was read as a whole, from files on disk.
    fn is_whole(&self) -> bool {
        (self.window.width, self.window.height) == self.size && !self.paths.iter().any(|path| is_virtual(path))
    }

    /// First difference to the current image, in words; `None` where there is none.
    fn difference(&self, now: &IndexImage) -> Option<String> {
        let path = now.path.display();
        let ((width, height), (now_width, now_height)) = (self.size, now.size);
        if self.size != now.size {
            let text = format!("{path} has {now_width} x {now_height} pixels, not {width} x {height}");
            return Some(text);
        }
        if self.bands != now.bands.kinds || self.file_bands != now.bands.file_bands {
            return Some(format!("{path} has other bands"));
        }
        if self.counts != now.counts {
            return Some(format!("the values of {path} are decoded in another way"));
        }
        let paths = || std::iter::once(&now.path).chain(&now.others);
        let replaced = paths().count() != self.paths.len();
        let changed = |file: &FileIdentity, path: &PathBuf| {
            let path = path.clone();
            !FileIdentity { path, ..file.clone() }.is_unchanged()
        };
        let on_disk = paths().filter(|path| !is_virtual(path));
        if let Some((_, path)) = self.files.iter().zip(on_disk).find(|(file, path)| changed(file, path)) {
            return Some(format!("{} has changed", path.display()));
        }
        if replaced {
            return Some(format!("{path} is made of other files"));
        }
        let (source, before) = (&now.rpc_source, &self.camera_source);
        (self.camera != now.rpc).then(|| match source == before {
            true => format!("the camera of {path} ({source}) has changed"),
            false => format!("the camera of {path} is that of {source}, not that of {before}"),
        })
    }
}
