//! The satellite scene to make: settings, their limits and defaults. Also written into the scene's manifest.

use crate::error::SynthError;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::PathBuf;

/// Most additional suns under which truth is rendered.
const MOST_SUNS: usize = 100;

/// Packing of images.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Delivery {
    /// One file for each image.
    #[default]
    Whole,
    /// A panchromatic file `NAME-P1BS.tif` and a multispectral one `NAME-M1BS.tif` for each image.
    PanMs,
}

impl Delivery {
    /// Bands of the file that bears the image's name, or of the panchromatic file of a bundle.
    pub(crate) fn main_bands(self, bands: BandSet) -> BandSet {
        match self {
            Self::Whole => bands,
            Self::PanMs => BandSet::Pan,
        }
    }
}

/// The size and make-up of a site.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Site {
    /// 48 m x 48 m: a street corner, for tests.
    Tiny,
    /// 128 m x 128 m: a few city blocks.
    Block,
    /// 256 m x 256 m: a neighbourhood.
    City,
    /// 1 km x 1 km: a town with a centre, suburbs, a large park with a lake, and a hill.
    District,
}

impl Site {
    /// Lower-case name, side of the square with truth in metres, and default numbers of views and of dates.
    fn numbers(self) -> (&'static str, f64, usize, usize) {
        match self {
            Site::Tiny => ("tiny", 48.0, 8, 5),
            Site::Block => ("block", 128.0, 12, 7),
            Site::City => ("city", 256.0, 16, 9),
            Site::District => ("district", 1000.0, 8, 6),
        }
    }

    /// Side of the square for which there is truth, metres.
    pub fn extent_m(self) -> f64 {
        self.numbers().1
    }

    /// Default number of views.
    pub fn default_views(self) -> usize {
        self.numbers().2
    }

    /// Default number of acquisition dates.
    pub fn default_dates(self) -> usize {
        self.numbers().3
    }

    /// Lower-case name, the stem of the image names.
    pub fn name(self) -> &'static str {
        self.numbers().0
    }

    /// Altitudes below and above the site's centre that images are made to cover, metres.
    pub(crate) fn covered_altitudes_m(self) -> [f64; 2] {
        match self {
            Site::Tiny | Site::Block | Site::City => [-10.0, 44.0],
            Site::District => [-32.0, 84.0],
        }
    }
}

/// Bands of the images.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BandSet {
    /// One panchromatic band.
    Pan,
    /// Red, green, blue.
    Rgb,
    /// Red, green, blue, near infrared.
    RgbNir,
}

impl BandSet {
    /// Names of the bands, in file order.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            BandSet::Pan => &["Panchromatic"],
            BandSet::Rgb => &["Red", "Green", "Blue"],
            BandSet::RgbNir => &["Red", "Green", "Blue", "NIR"],
        }
    }
}

/// A fault of real images that a satellite scene can have.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fault {
    /// A gain for each band, almost the same in all images: counts are not calibrated.
    BandGains,
    /// A layer of haze that differs by date: airlight that is stronger in blue, less contrast, brighter shadows.
    Haze,
    /// Light that surfaces reflect reaches other surfaces: one bounce instead of that of an average neighbourhood.
    Interreflection,
    /// Metal roofs, membranes, cars and solar panels reflect sun and sky in a microfacet lobe.
    Glossy,
    /// Clouds hide a third of the images that have clouds, and a thin veil lies over the rest of them.
    LargeClouds,
    /// 8-bit display images: each band of each image is stretched between two percentiles, with a gamma, both ends
    /// clipped.
    Stretch,
}

/// Faults of a scene.
pub type Faults = BTreeSet<Fault>;

/// The cover of one half of a site.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Cover {
    /// Sea at one altitude, with other waves in every image.
    Sea,
    /// Snow on the ground and on roofs: bright, almost no texture, clipped in the sun.
    Snow,
    /// The land of `sea` alone: the same scene, with pixels that see the sea missing (0).
    Nodata,
}

/// A satellite scene to be made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SatelliteRequest {
    /// Size and make-up of the site.
    pub site: Site,
    /// Seed of all random numbers: place, city, dates, sensors, noise.
    pub seed: u64,
    /// JSON file, as VisSat writes it, of the cameras, dates and suns of real images; if absent, sensors are simulated.
    pub cameras: Option<PathBuf>,
    /// Number of images, 1 to 500; if absent, the site's own number, or all of `cameras`.
    pub views: Option<usize>,
    /// Number of acquisition dates, at least 1, at most one per view; if absent, the site's own number. With `cameras`
    /// it must be absent.
    pub dates: Option<usize>,
    /// Ground sampling distance, 0.1 to 4 m; 0.5 if absent. It is also the resolution of the truth rasters.
    pub gsd_m: Option<f64>,
    /// Width and height of every image, 16 to 8192 pixels and at most 2 km; if absent, the size that covers the site at
    /// all its altitudes.
    pub size_px: Option<usize>,
    /// Width and height of the file of every image, 16 to 100,000 pixels; the image lies at an offset, and the rest is
    /// missing (0) and takes no space. The sensor's scene is at least as wide, so that the RPC holds over the whole
    /// file. If absent, a file is as large as its image, and the manifest does not name it.
    #[serde(skip_serializing_if = "is_default")]
    pub canvas_px: Option<usize>,
    /// Bands of the images.
    pub bands: BandSet,
    /// Bits per sample: 16 for linear counts of 11 bits, as vendors deliver them; 8 for display images with the
    /// transfer curve of sRGB.
    pub bits: u8,
    /// RPC bias: root mean square length of the constant (column, row) error put into the RPC of each image, 0 to 100
    /// pixels.
    pub pointing_bias_px: f64,
    /// Sensor noise relative to a good sensor's, 0 to 100 (1 = signal-to-noise about 100 at middle grey, 0 = none).
    pub noise: f64,
    /// Number of training images that have clouds in view. Absent from the manifest if 0.
    #[serde(skip_serializing_if = "is_default")]
    pub clouds: usize,
    /// Faults of real images. Absent from the manifest if none.
    #[serde(skip_serializing_if = "is_default")]
    pub faults: Faults,
    /// Cover of one half of the site, or a little more. Absent from the manifest if there is none.
    #[serde(skip_serializing_if = "is_default")]
    pub cover: Option<Cover>,
    /// Packing of images. Absent from the manifest if each is one file.
    #[serde(skip_serializing_if = "is_default")]
    pub delivery: Delivery,
    /// Number of additional suns, 0 to 100, under which the site is rendered from straight above as truth. Absent from
    /// the manifest if 0.
    #[serde(skip_serializing_if = "is_default")]
    pub relight: usize,
    /// Share of the buildings that are built or torn down between two dates, 0 to 1. Absent from the manifest if none.
    #[serde(skip_serializing_if = "is_default")]
    pub change: f64,
}

/// True for the value that the manifest leaves out.
pub(crate) fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl Default for SatelliteRequest {
    fn default() -> Self {
        Self {
            site: Site::Block,
            seed: 1,
            cameras: None,
            views: None,
            dates: None,
            gsd_m: None,
            size_px: None,
            canvas_px: None,
            bands: BandSet::RgbNir,
            bits: 16,
            pointing_bias_px: 0.0,
            noise: 1.0,
            clouds: 0,
            faults: Faults::new(),
            cover: None,
            delivery: Delivery::Whole,
            relight: 0,
            change: 0.0,
        }
    }
}

impl SatelliteRequest {
    /// Ground sampling distance, metres.
    pub fn gsd(&self) -> f64 {
        self.gsd_m.unwrap_or(0.5)
    }

    /// Number of images: `views`, or the site's own number. It does not hold for `cameras` without `views`, where every
    /// camera gives an image.
    pub fn view_count(&self) -> usize {
        self.views.unwrap_or(self.site.default_views())
    }

    /// Number of acquisition dates.
    pub fn date_count(&self) -> usize {
        self.dates.unwrap_or(self.site.default_dates()).min(self.view_count())
    }

    /// True if `fault` is requested.
    pub fn has(&self, fault: Fault) -> bool {
        self.faults.contains(&fault)
    }

    /// True if the scene has a sea.
    pub(crate) fn has_sea(&self) -> bool {
        matches!(self.cover, Some(Cover::Sea | Cover::Nodata))
    }

    /// Bits per sample of the files: 8 for stretched images, else `bits`.
    pub fn file_bits(&self) -> u8 {
        if self.has(Fault::Stretch) { 8 } else { self.bits }
    }

    /// Number of images with clouds among `training` training images: `clouds`, or, if that is 0, a quarter with
    /// [`Fault::LargeClouds`].
    pub fn cloudy_images(&self, training: usize) -> usize {
        let some = self.clouds == 0 && self.has(Fault::LargeClouds);
        if some { training.div_ceil(4) } else { self.clouds }
    }

    /// Number of `views` held out for testing: none below 4 views, one below 8, else two.
    pub fn test_count(views: usize) -> usize {
        match views {
            0..4 => 0,
            4..8 => 1,
            _ => 2,
        }
    }

    /// Checks the request.
    ///
    /// # Errors
    /// [`SynthError::BadRequest`] naming the first field that cannot be met and the values it may have.
    pub fn check(&self) -> Result<(), SynthError> {
        let bad = |text: String| Err(SynthError::BadRequest(text));
        if !(1..=500).contains(&self.view_count()) {
            return bad(format!("{} views; ask for 1 to 500", self.view_count()));
        }
        if self.cameras.is_some() && self.dates.is_some() {
            return bad("a number of dates and cameras; the cameras have their own dates".into());
        }
        if self.dates == Some(0) {
            return bad("0 dates; ask for at least 1".into());
        }
        if self.has(Fault::Stretch) && self.delivery != Delivery::Whole {
            let both = "a stretch for display and a delivery of pan and multispectral";
            return bad(format!("{both}; display images come whole"));
        }
        if !(0.1..=4.0).contains(&self.gsd()) {
            return bad(format!("a sampling distance of {} m; ask for 0.1 to 4 m", self.gsd()));
        }
        if let Some(size) = self.size_px.filter(|size| !(16..=8192).contains(size)) {
            return bad(format!("images of {size} px; ask for 16 to 8192"));
        }
        if self.size_px.is_some_and(|size| size as f64 * self.gsd() > 2000.0) {
            return bad("images wider than 2 km; lower the size or the sampling distance".into());
        }
        if let Some(canvas) = self.canvas_px.filter(|canvas| !(16..=100_000).contains(canvas)) {
            return bad(format!("a canvas of {canvas} px; ask for 16 to 100000"));
        }
        if self.bits != 8 && self.bits != 16 {
            return bad(format!("{} bits per sample; ask for 8 or 16", self.bits));
        }
        if !(0.0..=100.0).contains(&self.pointing_bias_px) {
            let bias_px = self.pointing_bias_px;
            return bad(format!("a pointing bias of {bias_px} px; ask for 0 to 100"));
        }
        if self.relight > MOST_SUNS {
            let suns = self.relight;
            return bad(format!("{suns} suns to relight under; ask for 0 to {MOST_SUNS}"));
        }
        if !(0.0..=1.0).contains(&self.change) {
            return bad(format!("a share of {} that changes; ask for 0 to 1", self.change));
        }
        if !(0.0..=100.0).contains(&self.noise) {
            return bad(format!("noise {}; ask for 0 to 100", self.noise));
        }
        Ok(())
    }
}
