//! Manifest of a batch: areas, sets of images, presets.

use super::blocks::SIDE_LEAST;
use super::{BatchError, Result};
use bytesize::ByteSize;
use heliosplat_fitting::settings::Preset;
use heliosplat_products::relight::LOWEST_SUN_DEG;
use heliosplat_products::sunshine::Period;
use heliosplat_raster::Geoid;
use heliosplat_raster::bounded::read_text;
use heliosplat_rpc::sun::SunPosition;
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_scene::{AreaRequest, RpcPreference, toml_fault};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Least side of a tile's core, metres: of a smaller tile, the overlap would be the largest part.
pub(super) const LEAST_SIDE_M: f64 = 24.0;
/// Sides of the blocks of a mosaic, cells.
const BLOCK_CELLS: std::ops::RangeInclusive<usize> = SIDE_LEAST..=65_536;
/// Most characters in the name of an area, a set of images or a preset.
const LONGEST_NAME: usize = 64;
/// Prefixes of the object stores that products may be copied to. Paths on disk are refused: a batch writes only to its
/// own folder.
const OBJECT_STORES: [&str; 7] = [
    "/vsis3/",
    "/vsigs/",
    "/vsiaz/",
    "/vsiadls/",
    "/vsioss/",
    "/vsiswift/",
    "/vsiwebhdfs/",
];

/// Manifest of a batch: areas, images, presets and products.
#[derive(Debug, Clone, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Folder on an object store to which products are copied, as a GDAL path such as `/vsis3/BUCKET/FOLDER`.
    pub deliver: Option<String>,
    /// Tiling of the areas.
    #[serde(default)]
    pub tiles: TileOptions,
    /// Products of tiles and mosaics.
    #[serde(default)]
    pub products: ProductOptions,
    /// Areas of ground; without any, all ground that the images show.
    #[serde(default)]
    pub areas: Vec<AreaEntry>,
    /// Sets of images.
    pub images: Vec<ImagesEntry>,
    /// Presets to run; without any, `balanced`.
    #[serde(default)]
    pub presets: Vec<PresetEntry>,
}

/// Tiling of areas.
#[derive(Debug, Clone, PartialEq, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TileOptions {
    /// Most memory for one tile, such as `4GiB`.
    pub memory: String,
    /// Margin of a tile around its core, metres; two neighbours overlap by twice as much.
    pub overlap_m: f64,
    /// Largest side of a tile's core, metres; absent: unlimited.
    pub side_m: Option<f64>,
    /// Largest residual of a tile's pinhole cameras against the RPCs, pixels.
    pub residual_px: f64,
    /// Width of a cell of the mosaic, metres; absent: ground sampling distance of the images, in whole centimetres.
    pub gsd_m: Option<f64>,
    /// Largest side of a block of the mosaic, cells; smaller if `memory` does not suffice.
    pub block: usize,
}

impl Default for TileOptions {
    fn default() -> Self {
        Self {
            memory: "4GiB".into(),
            overlap_m: 16.0,
            side_m: None,
            residual_px: 0.05,
            gsd_m: None,
            block: 4096,
        }
    }
}

/// Products of tiles and mosaics.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProductOptions {
    /// True if surface models are the only products.
    pub dsm_only: bool,
    /// Azimuth and elevation of the sun of a relit ortho image, degrees; absent: no relit image.
    pub sun: Option<[f64; 2]>,
    /// Geoid to which heights of mosaics refer; absent: the ellipsoid.
    pub geoid: Option<Geoid>,
    /// Day, or period `FROM/TO`, of the map of sun hours of mosaics; absent: no such map.
    pub sun_hours: Option<String>,
    /// True if mosaics are also written as 3D Tiles: splats and textured surface.
    pub globe: bool,
}

/// Area of ground.
#[derive(Debug, Clone, Default, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AreaEntry {
    /// Name of the area and of its folder.
    pub name: String,
    /// West, south, east, north, in units of `crs`; absent: all ground that the images show.
    pub bounds: Option<[f64; 4]>,
    /// Coordinate reference system of the bounds; absent: longitude and latitude, degrees.
    pub crs: Option<String>,
    /// Lowest and highest ellipsoidal altitude, metres.
    pub altitude_m: Option<[f64; 2]>,
    /// Names of the sets of images to use; absent: all.
    pub images: Option<Vec<String>>,
}

/// Set of images.
#[derive(Debug, Clone, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImagesEntry {
    /// Name of the set and of its folder.
    pub name: String,
    /// Path of the scene, as for `train`; relative to the manifest.
    pub scene: PathBuf,
    /// Preferred camera model where the sources of an image differ: `json`, `image`, `sidecar` or `tag`.
    #[serde(default)]
    pub rpc: RpcPreference,
}

/// Preset with its overrides.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PresetEntry {
    /// Name of the entry and of its folder.
    pub name: String,
    /// `preview`, `fast`, `balanced`, `accurate`, `best`, or `sweep` for surface models without training; absent:
    /// `name`.
    pub preset: Option<String>,
    /// Seed of the random numbers.
    #[serde(default = "first_seed")]
    pub seed: u64,
    /// Overrides of settings by their keys, as for `--set`.
    #[serde(default)]
    pub set: BTreeMap<String, toml::Value>,
}

/// Name of the preset without training.
const SWEEP: &str = "sweep";

fn first_seed() -> u64 {
    1
}

impl PresetEntry {
    /// Name of the preset before the overrides.
    pub fn base(&self) -> &str {
        self.preset.as_deref().unwrap_or(&self.name)
    }

    /// True if it computes surface models without training.
    pub fn is_sweep(&self) -> bool {
        self.base() == SWEEP
    }

    /// Preset before the overrides; a sweep uses the settings of preset `fast`, as does `dsm --from sweep`.
    ///
    /// # Errors
    /// When no preset has this name.
    pub fn parsed(&self) -> Result<Preset, heliosplat_fitting::settings::ConfigError> {
        match self.is_sweep() {
            true => Ok(Preset::Fast),
            false => self.base().parse(),
        }
    }

    /// Overrides as pairs of key and value, as for `--set`.
    pub fn changes(&self) -> Vec<(String, String)> {
        let pairs = self.set.iter();
        pairs.map(|(key, value)| (key.clone(), value.to_string())).collect()
    }

    /// Complete configuration, with overrides and seed.
    ///
    /// # Errors
    /// When the preset, a key or a value is invalid.
    pub fn config(&self) -> Result<SatelliteConfig, heliosplat_fitting::settings::ConfigError> {
        SatelliteConfig::resolve(self.parsed()?, &self.changes(), self.seed)
    }
}

impl AreaEntry {
    /// Bounds with their coordinate reference system, if stated.
    pub fn request(&self) -> Option<AreaRequest> {
        let (bounds, crs) = (self.bounds?, self.crs.clone());
        Some(AreaRequest { bounds, crs })
    }
}

impl TileOptions {
    /// Most memory for one tile, bytes; `None` if it is no size.
    pub fn memory_bytes(&self) -> Option<u64> {
        bytes(&self.memory).ok()
    }

    fn check(&self) -> Result<(), String> {
        let Self { memory, block, .. } = self;
        if self.memory_bytes().is_none() {
            return Err(format!("tiles.memory is '{memory}', expected a size such as 4GiB"));
        }
        let (least, gsd_m) = (f64::MIN_POSITIVE, self.gsd_m.unwrap_or(1.0));
        let limits = [
            ("overlap_m", self.overlap_m, 0.0),
            ("residual_px", self.residual_px, least),
            ("gsd_m", gsd_m, least),
        ];
        let is_wrong = |(_, value, least): &&(&str, f64, f64)| !(*least..=f64::MAX).contains(value);
        if let Some((key, value, _)) = limits.iter().find(is_wrong) {
            return Err(format!("tiles.{key} is {value}, expected a finite number above zero"));
        }
        if let Some(side_m) = self.side_m.filter(|side_m| !(LEAST_SIDE_M..=1e6).contains(side_m)) {
            return Err(format!("tiles.side_m is {side_m}, expected {LEAST_SIDE_M} m or more"));
        }
        if !BLOCK_CELLS.contains(&self.block) {
            let [least, most] = [BLOCK_CELLS.start(), BLOCK_CELLS.end()];
            return Err(format!("tiles.block is {block}, expected {least} to {most} cells"));
        }
        Ok(())
    }
}

impl ProductOptions {
    fn check(&self) -> Result<(), String> {
        if let Some([azimuth, elevation]) = self.sun
            && (SunPosition::stated(azimuth, elevation).is_err() || elevation < LOWEST_SUN_DEG)
        {
            let expected = format!("azimuth and elevation in degrees, {LOWEST_SUN_DEG} or more above the horizon");
            return Err(format!("products.sun is [{azimuth}, {elevation}], expected {expected}"));
        }
        if let Some(days) = &self.sun_hours {
            (days.parse::<Period>()).map_err(|reason| format!("products.sun_hours: {reason}"))?;
        }
        if self.dsm_only && (self.sun_hours.is_some() || self.globe) {
            return Err("products.dsm_only leaves sun_hours and globe out; say one or the other".into());
        }
        Ok(())
    }
}

impl Manifest {
    /// Parses a manifest and checks it; paths stay as written.
    ///
    /// # Errors
    /// Message with the fault and its place: the line, or the key or entry.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut manifest: Self = toml::from_str(text).map_err(|error| toml_fault(&error, text))?;
        if manifest.areas.is_empty() {
            let name = "all".into();
            manifest.areas.push(AreaEntry {
                name,
                ..AreaEntry::default()
            });
        }
        if manifest.presets.is_empty() {
            manifest.presets.push(PresetEntry {
                name: "balanced".into(),
                preset: None,
                seed: first_seed(),
                set: BTreeMap::new(),
            });
        }
        manifest.check()?;
        Ok(manifest)
    }

    /// Reads a manifest, checks it, and resolves its paths against its folder.
    ///
    /// # Errors
    /// When it cannot be read, or is invalid.
    pub fn read(path: &Path) -> Result<Self> {
        let fault = |reason: String| BatchError::Refused(format!("{}: {reason}", path.display()));
        let text = read_text(path).map_err(|error| fault(error.to_string()))?;
        let mut manifest = Self::parse(&text).map_err(fault)?;
        let folder = path.parent().unwrap_or_else(|| Path::new("."));
        for images in &mut manifest.images {
            images.scene = folder.join(&images.scene);
        }
        Ok(manifest)
    }

    fn check(&self) -> Result<(), String> {
        if self.images.is_empty() {
            return Err("it lists no images; add [[images]] with a name and a scene".into());
        }
        names("areas", self.areas.iter().map(|area| &area.name))?;
        names("images", self.images.iter().map(|images| &images.name))?;
        names("presets", self.presets.iter().map(|preset| &preset.name))?;
        if let Some(to) = &self.deliver
            && (!OBJECT_STORES.iter().any(|store| to.starts_with(store)) || to.contains(".."))
        {
            let stores = OBJECT_STORES.join(", ");
            return Err(format!("deliver is '{to}', expected a folder on one of {stores}"));
        }
        self.tiles.check()?;
        self.products.check()?;
        for area in &self.areas {
            if let Some(request) = area.request() {
                (request.check()).map_err(|reason| format!("area {}: {reason}", area.name))?;
            }
            for name in area.images.iter().flatten() {
                if !self.images.iter().any(|images| images.name == *name) {
                    return Err(format!("area {}: there are no images named '{name}'", area.name));
                }
            }
        }
        for preset in &self.presets {
            let name = &preset.name;
            if preset.parsed().is_err() {
                let all = "\"sweep\", \"preview\", \"fast\", \"balanced\", \"accurate\" or \"best\"";
                return Err(format!("preset {name}: say preset = {all}"));
            }
            preset.config().map_err(|error| format!("preset {name}: {error}"))?;
        }
        Ok(())
    }
}

/// Parses a size such as `512MiB`, `4GiB` or `500MB` to bytes; a bare number is bytes. `k`, `M` and `G` alone are
/// powers of 1000, like `kB`, `MB` and `GB`.
///
/// # Errors
/// Message for the user, if the text is no size of a kibibyte or more: a bare `4` means gibibytes to most.
pub fn bytes(text: &str) -> Result<u64, String> {
    match text.trim().parse::<ByteSize>() {
        Ok(size) if size.as_u64() >= 1 << 10 => Ok(size.as_u64()),
        _ => Err("expected a size with its unit, such as 512MiB or 4GiB".to_owned()),
    }
}

/// Checks names. They become folders of the batch, so they must be plain, and unique on file systems that ignore case.
fn names<'n>(what: &str, names: impl Iterator<Item = &'n String>) -> Result<(), String> {
    let mut known = BTreeSet::new();
    for name in names {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        let begins = name.starts_with(|c: char| c.is_ascii_alphanumeric());
        if !(name.chars().all(is_plain) && begins && name.len() <= LONGEST_NAME) {
            let shown: String = name.chars().take(LONGEST_NAME).collect();
            return Err(format!(
                "{what}: '{shown}' is no name; use letters, digits, '-', '_' and '.', a letter or digit first, {LONGEST_NAME} at most"
            ));
        }
        if !known.insert(name.to_lowercase()) {
            return Err(format!("{what}: the name '{name}' comes twice"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const IMAGES: &str = "[[images]]\nname = \"a\"\nscene = \"a\"\n";

    #[test]
    fn a_short_manifest_is_one_area_and_one_preset() {
        let manifest = Manifest::parse(IMAGES).expect("sound");
        assert_eq!(
            (manifest.areas[0].name.as_str(), manifest.presets[0].base()),
            ("all", "balanced")
        );
        assert_eq!(manifest.tiles.memory_bytes(), Some(4 << 30));
    }

    #[test]
    fn a_sweep_has_the_settings_of_a_fast_training_and_may_change_them() {
        let manifest = |more: &str| Manifest::parse(&format!("{IMAGES}[[presets]]\nname = \"sweep\"\n{more}"));
        let sweep = &manifest("").expect("sound").presets[0];
        assert!(sweep.is_sweep());
        let fast = SatelliteConfig::resolve(Preset::Fast, &[], 1).expect("settings");
        assert_eq!(format!("{:?}", sweep.config().expect("settings")), format!("{fast:?}"));
        let off = &manifest("set = { \"cameras.align\" = \"off\" }")
            .expect("sound")
            .presets[0];
        assert_ne!(format!("{:?}", off.config().expect("settings")), format!("{fast:?}"));
    }

    #[test]
    fn names_that_would_leave_the_folder_are_refused() {
        for name in [
            "..",
            "../x",
            "/etc",
            "a/b",
            "",
            ".hidden",
            "a\\b",
            "a b",
            "tile\u{202e}",
        ] {
            let text = format!("{IMAGES}[[areas]]\nname = {name:?}\n");
            let error = Manifest::parse(&text).expect_err(name);
            assert!(error.contains("no name") || error.contains("line"), "{name}: {error}");
        }
        let twice = format!("{IMAGES}{IMAGES}");
        assert!(Manifest::parse(&twice).expect_err("twice").contains("comes twice"));
    }

    #[test]
    fn what_means_nothing_is_named_with_its_place() {
        let refused = |more: &str| Manifest::parse(&format!("{IMAGES}{more}")).expect_err(more);
        assert!(refused("[tiles]\nmemory = \"much\"\n").contains("tiles.memory"));
        assert!(refused("[tiles]\noverlap_m = -1.0\n").contains("tiles.overlap_m"));
        assert!(refused("[[areas]]\nname = \"x\"\nimages = [\"b\"]\n").contains("'b'"));
        assert!(refused("[[areas]]\nname = \"x\"\nbounds = [3.0, 0.0, 1.0, 1.0]\n").contains("west below east"));
        assert!(refused("[[presets]]\nname = \"x\"\n").contains("preset ="));
        assert!(
            refused("[[presets]]\nname = \"fast\"\nset = { \"train.iteration\" = 4 }\n").contains("train.iteration")
        );
        assert!(refused("colour = 3\n").contains("line"));
        assert!(refused("[products]\nsun = [200.0, -5.0]\n").contains("products.sun"));
        assert!(refused("[products]\nsun_hours = \"2026-06-31\"\n").contains("products.sun_hours"));
        assert!(refused("[products]\ndsm_only = true\nglobe = true\n").contains("dsm_only"));
        assert!(refused("[products]\ngeoid = \"sea\"\n").contains("line"));
        let elsewhere = Manifest::parse(&format!("deliver = \"/vsizip//etc/x.zip\"\n{IMAGES}"));
        assert!(elsewhere.expect_err("the disk").contains("deliver"));
    }

    #[test]
    fn sizes_carry_their_units_and_bare_numbers_are_bytes() {
        for (text, bytes_of) in [
            ("4096", 4096),
            ("4GiB", 4 << 30),
            (" 4 gib ", 4 << 30),
            ("0.5GiB", 1 << 29),
            ("512MiB", 512 << 20),
            ("500MB", 500_000_000),
            ("1.5MB", 1_500_000),
            ("4G", 4_000_000_000),
            ("1TiB", 1 << 40),
        ] {
            assert_eq!(bytes(text), Ok(bytes_of), "{text}");
        }
        for bad in ["", "0", "5", "0GiB", "-1GiB", "lots", "GiB", "4Gib/s", "nan", "inf"] {
            assert!(bytes(bad).is_err(), "{bad}");
        }
    }
}
