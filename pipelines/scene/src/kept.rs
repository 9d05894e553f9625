//! The cut of a run as the run keeps it (`cut.json`): everything that decides which pixels and cameras were used.

use super::crop::Crop;
use super::{AltitudeRange, Area, BandKind, Cut, CutImage, RpcPreference, SceneError, SceneImage, Split};
use heliosplat_delivery::{Counts, FileIdentity, Hashes, Index, IndexImage, hash_of_values};
use heliosplat_raster::{Window, is_virtual};
use heliosplat_rpc::{GeoPoint, LocalFrame, Rpc};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A cut that was read, with the identities of its files.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct KeptCut {
    /// Preference between two different cameras.
    pub rpc: RpcPreference,
    /// Origin of the frame.
    pub origin: GeoPoint,
    /// Altitudes that the surface may have.
    pub altitude: AltitudeRange,
    /// Ground, metres of the frame.
    pub area: Area,
    /// Counts per unit of the pixels.
    pub counts_per_unit: f64,
    /// Its images.
    pub images: Vec<KeptImage>,
}

/// An image of a cut that was read.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct KeptImage {
    /// Its name.
    pub name: String,
    /// Its file, and the other files that its pixels come from.
    pub paths: Vec<PathBuf>,
    /// Identities of the files; none where `pixels_sha256` replaces them.
    #[serde(default)]
    pub files: Vec<FileIdentity>,
    /// SHA-256 of the values that were read, where these are a part of the image or its file is on a virtual file
    /// system.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixels_sha256: Option<String>,
    /// Train or test.
    pub split: Split,
    /// Columns and rows.
    pub size: (usize, usize),
    /// Pixels that were read.
    pub window: Crop,
    /// Places of the bands in the file.
    pub file_bands: Vec<usize>,
    /// Spectral bands.
    pub bands: Vec<BandKind>,
    /// Linear counts, or values encoded for display.
    pub counts: Counts,
    /// Rational camera.
    pub camera: Rpc,
    /// `image` or a file name.
    pub camera_source: String,
}

impl KeptCut {
    /// The images of a cut as the index has them.
    pub(super) fn of(index: &Index, cut: &Cut, counts_per_unit: f64) -> Self {
        let images = cut.images.iter().filter_map(|part| {
            let image = index.images.get(part.image)?;
            let window = &part.window;
            Some(KeptImage {
                name: image.name.clone(),
                paths: std::iter::once(&image.path).chain(&image.others).cloned().collect(),
                files: Vec::new(),
                pixels_sha256: None,
                split: part.split,
                size: image.size,
                window: Crop {
                    col0: window.col0,
                    row0: window.row0,
                    width: window.width,
                    height: window.height,
                },
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

    /// Notes size, time of change and hash of each file that pixels come from; known hashes are not computed again. The
    /// `images` that were read in part, or from a virtual file system, count by their pixels: no more of a file is read
    /// for its identity than for itself.
    ///
    /// # Errors
    /// When a file cannot be read.
    pub fn identify(&mut self, images: &[SceneImage], hashes: &mut Hashes) -> Result<(), SceneError> {
        for kept in &mut self.images {
            if !kept.is_whole() {
                let read = images.iter().find(|image| image.name == kept.name);
                kept.pixels_sha256 = read.map(|image| hash_of_values(&image.pixels.values));
                continue;
            }
            for path in &kept.paths {
                kept.files.push(hashes.identify(path)?);
            }
        }
        Ok(())
    }

    /// The first of the `images` that were read again whose pixels are not those that were read before, in words.
    ///
    /// # Errors
    /// A description of the first difference.
    pub fn check_pixels(&self, images: &[SceneImage]) -> Result<(), String> {
        for kept in self.images.iter().filter(|kept| kept.pixels_sha256.is_some()) {
            let read = images.iter().find(|image| image.name == kept.name);
            if let Some(read) = read.filter(|read| kept.pixels_sha256 != Some(hash_of_values(&read.pixels.values))) {
                return Err(format!("{} has changed", read.path.display()));
            }
        }
        Ok(())
    }

    /// The same cut of the current delivery.
    ///
    /// # Errors
    /// The first difference in words: an image that is gone or has changed, other bands, another camera.
    pub fn again(&self, index: &Index) -> Result<Cut, String> {
        let by_name: BTreeMap<&str, usize> = (index.images.iter().enumerate())
            .map(|(place, image)| (image.name.as_str(), place))
            .collect();
        let mut images = Vec::with_capacity(self.images.len());
        for kept in &self.images {
            let found = by_name
                .get(kept.name.as_str())
                .and_then(|&place| Some((place, index.images.get(place)?)));
            let Some((place, image)) = found else {
                return Err(format!("the image {} is missing", kept.name));
            };
            if let Some(difference) = kept.difference(image) {
                return Err(difference);
            }
            let Crop {
                col0,
                row0,
                width,
                height,
            } = kept.window;
            images.push(CutImage {
                image: place,
                window: Window {
                    col0,
                    row0,
                    width,
                    height,
                },
                split: kept.split,
            });
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
    /// True if the whole image was read, from files on disk.
    fn is_whole(&self) -> bool {
        (self.window.width, self.window.height) == self.size && !self.paths.iter().any(|path| is_virtual(path))
    }

    /// The first difference to the current image, in words.
    fn difference(&self, now: &IndexImage) -> Option<String> {
        let path = now.path.display();
        let (width, height) = self.size;
        if self.size != now.size {
            return Some(format!(
                "{path} has {} x {} pixels, not {width} x {height}",
                now.size.0, now.size.1
            ));
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
            let here = FileIdentity {
                path: path.clone(),
                ..file.clone()
            };
            !here.is_unchanged()
        };
        let on_disk = paths().filter(|path| !is_virtual(path));
        if let Some((_, path)) = self.files.iter().zip(on_disk).find(|(file, path)| changed(file, path)) {
            return Some(format!("{} has changed", path.display()));
        }
        if replaced {
            return Some(format!("{path} is made of other files"));
        }
        let source = &now.rpc_source;
        (self.camera != now.rpc).then(|| match *source == self.camera_source {
            true => format!("the camera of {path} ({source}) has changed"),
            false => format!(
                "the camera of {path} is that of {source}, not that of {}",
                self.camera_source
            ),
        })
    }
}
