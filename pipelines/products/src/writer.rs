//! Products on one grid, written one after the other, and recorded for the STAC item, which is written last.

use super::change::{self, ChangeMap};
use super::dsm::{self, BANDS, Dsm, UNITS};
use super::ortho;
use super::stac::{self, Asset, Band, ItemMetadata, Numbers};
use super::style::{Layer, Style, layer_file};
use super::sunshine::{LINKE_TURBIDITY, Period, Sunshine};
use heliosplat::Raster;
use heliosplat_grid::drape;
use heliosplat_raster::preview::{stretched, write_png};
use heliosplat_raster::write::{Bytes, ImageSpec, remove, write_byte_cog, write_cog};
use heliosplat_raster::{GridSpec, Result, bounded, write_atomically};
use heliosplat_rpc::sun::SunPosition;
use heliosplat_scene::BandKind;
use heliosplat_scene::indices::NormalisedDifference;
use serde_json::Value;
use std::path::Path;

/// Name of the STAC item.
const ITEM: &str = "item.json";
/// Name of the layer file.
pub const LAYERS: &str = "layers.qlr";
/// The surface model of the run whose products a folder holds.
const OF_RUN: &str = "../dsm.tif";
/// Name of the small picture, and its longest side, pixels.
const THUMBNAIL: &str = "thumbnail.png";
const THUMBNAIL_PX: usize = 512;

/// Products that were written.
#[derive(Debug)]
pub struct Set {
    /// The STAC item.
    pub item: Value,
    /// Names of the files in the folder.
    pub names: Vec<String>,
    /// Share of the grid whose altitude is known, 0 to 1.
    pub completeness: f64,
}

/// Altitudes of a grid and of the ground around it, for products whose cells depend on other cells.
pub struct Surroundings {
    /// Altitudes, metres, one band.
    pub altitude: Raster,
    /// Column and row of `altitude` at which the grid begins.
    pub at: (usize, usize),
}

impl Surroundings {
    /// Altitudes of a grid without ground around it.
    pub fn none(dsm: &Dsm) -> Self {
        let (altitude, at) = (dsm.altitude(), (0, 0));
        Self { altitude, at }
    }

    /// Part of `raster`, which covers the surroundings, on a grid of `size` columns and rows.
    #[must_use]
    pub fn inner(&self, raster: &Raster, size: (usize, usize)) -> Raster {
        raster.part(self.at, size)
    }
}

/// Writes products of one grid into a folder.
pub struct Writer<'a> {
    grid: &'a GridSpec,
    gsd_m: f64,
    out: &'a Path,
    vertical_datum: &'static str,
    completeness: f64,
    /// Heights above the ground, metres, once they are written.
    above: Option<Raster>,
    assets: Vec<Asset>,
    layers: Vec<Layer>,
    /// The item and the layer file of earlier products in the folder.
    earlier: (Value, String),
}

impl<'a> Writer<'a> {
    /// Writer of rasters on `grid` with cells of `gsd_m` metres into the folder `out`. An item of earlier products in
    /// `out` is removed until the end, since a folder with an item is complete; products that are not written anew stay
    /// and return in the new item.
    ///
    /// # Errors
    /// When the earlier item cannot be removed.
    pub fn new(grid: &'a GridSpec, gsd_m: f64, out: &'a Path) -> Result<Self> {
        let [item, layers] = [ITEM, LAYERS].map(|name| bounded::read_text(&out.join(name)).unwrap_or_default());
        remove(&out.join(ITEM))?;
        Ok(Self {
            grid,
            gsd_m,
            out,
            vertical_datum: "WGS84 ellipsoid",
            completeness: 0.0,
            above: None,
            assets: Vec::new(),
            layers: Vec::new(),
            earlier: (serde_json::from_str(&item).unwrap_or_default(), layers),
        })
    }

    /// Writes a raster with its style, and records it.
    fn raster(
        &mut self,
        (key, title): (&str, &str),
        (raster, bands): (&Raster, &[Band]),
        (bytes, style): (Option<Bytes>, Style),
        items: &[(String, String)],
        sun: Option<&SunPosition>,
    ) -> Result<()> {
        let file = format!("{key}.tif");
        let path = self.out.join(&file);
        let names: Vec<&str> = bands.iter().map(|band| band.name).collect();
        let units = bands.iter().map(|band| band.unit);
        let units: Vec<&str> = units.filter(|unit| !unit.is_empty()).collect();
        let metadata: Vec<_> = metadata(sun).into_iter().chain(items.iter().cloned()).collect();
        let spec = ImageSpec {
            band_descriptions: &names,
            band_units: &units,
            georeference: Some((&self.grid.transform, &self.grid.crs)),
            metadata: &metadata,
            ..ImageSpec::plain(raster)
        };
        match bytes {
            Some(bytes) => write_byte_cog(&path, &spec, bytes)?,
            None => write_cog(&path, &spec)?,
        }
        style.write(&path)?;
        let numbers = bytes.map_or(Numbers::Float, |bytes| Numbers::Byte(bytes.nodata()));
        self.record((Path::new(&file), title), (raster, bands), (numbers, &style), sun);
        Ok(())
    }

    /// Records a raster, which is written already, for the item and the layer file.
    fn record(
        &mut self,
        (file, title): (&Path, &str),
        (raster, bands): (&Raster, &[Band]),
        (numbers, style): (Numbers, &Style),
        sun: Option<&SunPosition>,
    ) {
        let (stem, name) = (file.file_stem().unwrap_or_default(), file.to_string_lossy());
        let key = stem.to_string_lossy();
        let asset = Asset::raster((&key, &name, title), raster, bands, numbers, self.gsd_m, sun);
        self.assets.push(asset);
        self.layers.push(Layer::new(&name, title, style, &self.grid.crs));
    }

    fn mask(
        &mut self,
        names: (&str, &str),
        raster: &Raster,
        name: &'static str,
        sun: Option<&SunPosition>,
    ) -> Result<()> {
        let bands = [Band { name, unit: "" }];
        let stored = (Some(Bytes::Mask), Style::mask(name));
        self.raster(names, (raster, &bands), stored, &[], sun)
    }

    /// Writes the map of changes between the images.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn changes(&mut self, changes: &ChangeMap) -> Result<()> {
        const TITLES: [&str; 3] = [
            "Change of heights between the first image and the last",
            "Date of change",
            "Confidence of change",
        ];
        let first = Path::new("change.tif");
        changes.write(&self.out.join(first), self.grid)?;
        for (index, title) in TITLES.into_iter().enumerate().rev() {
            let (name, unit) = (change::BANDS[index], change::UNITS[index]);
            let numbers = if index == 1 { Numbers::Dates } else { Numbers::Float };
            let (file, raster) = (ChangeMap::file_of(first, index), changes.raster.band(index));
            let look = (numbers, &changes.style(index));
            self.record((&file, title), (&raster, &[Band { name, unit }]), look, None);
        }
        Ok(())
    }

    fn floats(
        &mut self,
        names: (&str, &str),
        raster: &Raster,
        bands: &[BandKind],
        sun: Option<&SunPosition>,
    ) -> Result<()> {
        let kinds: Vec<&str> = bands.iter().map(|band| band.name()).collect();
        let bands: Vec<Band> = kinds.iter().map(|name| Band { name, unit: "" }).collect();
        let stored = (None, Style::colours(raster, &kinds));
        self.raster(names, (raster, &bands), stored, &[], sun)
    }

    /// Writes the surface model, the ground below it, the heights above the ground, and a hillshade; returns the ground.
    /// In the products folder of a run with an equal surface model, the item refers to that one instead. Altitudes of `around` may refer
    /// to another vertical datum.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn surface(&mut self, dsm: &Dsm, around: &Surroundings) -> Result<Raster> {
        self.vertical_datum = dsm.vertical_datum();
        // The parent's path is used, since the folder itself may not exist yet.
        let of_run = self.out.parent().map(|run| run.join("dsm.tif"));
        let first = match of_run.is_some_and(|path| path.is_file() && dsm.is_in(&path)) {
            true => Path::new(OF_RUN),
            false => {
                dsm.write(&self.out.join("dsm.tif"))?;
                Path::new("dsm.tif")
            }
        };
        let heights = format!("Surface model, metres above {}", self.vertical_datum);
        let titles = [
            &*heights,
            "Standard deviation of heights",
            "Opacity of the surface",
            "Images that see the surface",
        ];
        for (index, title) in titles.into_iter().enumerate().rev() {
            let (name, unit) = (BANDS[index], UNITS[index]);
            let (file, raster) = (dsm::file_of(first, index), dsm.raster.band(index));
            let look = (Numbers::Float, &dsm::style(index, &raster.values));
            self.record((&file, title), (&raster, &[Band { name, unit }]), look, None);
        }
        self.completeness = dsm.completeness();
        let size = (self.grid.width, self.grid.height);
        let cell_m = self.grid.transform.cell_m(size, Some(&self.grid.crs));
        let ground = self.ground(dsm, around, cell_m[0] as f32)?;
        let shade = around.inner(&ortho::hillshade(&around.altitude, cell_m), size);
        let names = ("hillshade", "Hillshade of the surface, light from the north-west");
        let (name, unit) = ("shade", "");
        let look = (Some(Bytes::Shades), Style::Shades([1.0, 255.0]));
        self.raster(names, (&shade, &[Band { name, unit }]), look, &[], None)?;
        Ok(ground)
    }

    /// Writes the ground below the surface, and the heights above it; returns the ground.
    fn ground(&mut self, dsm: &Dsm, around: &Surroundings, cell_m: f32) -> Result<Raster> {
        let mut above = around.altitude.clone();
        let draped = drape::ground((above.width, above.height), cell_m, &above.values);
        for (height, ground) in above.values.iter_mut().zip(&draped) {
            *height -= ground;
        }
        let above = around.inner(&above, (self.grid.width, self.grid.height));
        let mut ground = dsm.altitude();
        for (ground, height) in ground.values.iter_mut().zip(&above.values) {
            *ground -= height;
        }
        let datum = ("VERTICAL_DATUM".to_owned(), self.vertical_datum.to_owned());
        let title = format!("Ground, metres above {}", self.vertical_datum);
        let style = Style::heights(&ground.values);
        self.quantity(("dtm", &title), &ground, ("ground", "metre"), &[datum], style)?;
        let title = "Heights of buildings and trees above the ground";
        let style = Style::amounts(&above.values);
        self.quantity(("ndsm", title), &above, ("height_above_ground", "metre"), &[], style)?;
        self.above = Some(above);
        Ok(ground)
    }

    /// Writes the albedo with a thumbnail and, where there is a vegetation index, the vegetation mask and, after the
    /// surface, the heights of the vegetation.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn colours(&mut self, albedo: &Raster, bands: &[BandKind], index: Option<NormalisedDifference>) -> Result<()> {
        let title = "True-ortho albedo, relative to level ground in full sun";
        self.floats(("albedo", title), albedo, bands, None)?;
        let (width, height) = (self.grid.width, self.grid.height);
        // A narrow strip keeps at least one pixel of its shorter side.
        let smaller = width.max(height).div_ceil(THUMBNAIL_PX).min(width.min(height)).max(1);
        write_png(&self.out.join(THUMBNAIL), &stretched(&albedo.downscaled(smaller)))?;
        let thumbnail = ("thumbnail", THUMBNAIL, "Thumbnail");
        self.assets.push(Asset::other(thumbnail, "image/png", "thumbnail"));
        let Some(index) = index else {
            return Ok(());
        };
        let leaves = ortho::vegetation(albedo, index);
        self.mask(("vegetation", "Vegetation by its index"), &leaves, "vegetation", None)?;
        let Some(mut canopy) = self.above.take() else {
            return Ok(());
        };
        for (height, leaf) in canopy.values.iter_mut().zip(&leaves.values) {
            *height *= leaf;
        }
        let title = "Heights of vegetation above the ground, 0 elsewhere";
        let style = Style::amounts(&canopy.values);
        self.quantity(("canopy", title), &canopy, ("canopy_height", "metre"), &[], style)
    }

    /// Writes the ortho image under a sun, in counts, and its shadow mask.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn relit(&mut self, image: &Raster, shadows: &Raster, bands: &[BandKind], sun: &SunPosition) -> Result<()> {
        let title = "Ortho image under the sun asked for, counts";
        self.floats(("relit", title), image, bands, Some(sun))?;
        let names = ("relit_shadow", "Shadows under the sun asked for");
        self.mask(names, shadows, "shadow", Some(sun))
    }

    /// Writes hours of direct sun, sky view factor and irradiation of a period.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn sunshine(&mut self, shone: &Sunshine, period: &Period) -> Result<()> {
        let (from, to) = period.ends();
        let when = format!("{from} to {to}");
        let about = |text: &str| vec![("DESCRIPTION".to_owned(), text.to_owned())];
        let ends = [("FROM".to_owned(), from.to_string()), ("TO".to_owned(), to.to_string())];
        let during = |text: &str| [about(text), ends.to_vec()].concat();
        let mut energy = during(
            "irradiation of the inclined surface under a clear sky, total of the period: beam and sky by the ESRA model, without reflected light",
        );
        energy.push(("LINKE_TURBIDITY".to_owned(), LINKE_TURBIDITY.to_string()));
        let products = [
            (
                ("sun_hours", format!("Hours of direct sun per day, mean of {when}")),
                (&shone.sun_hours, "sun_hours", "h"),
                during("hours of direct sun per day, mean over the days of the period"),
            ),
            (
                ("sky_view", "Sky view factor: share of the light of an even sky".into()),
                (&shone.sky_view, "sky_view_factor", "1"),
                about("share of the light of an even sky that reaches the inclined surface"),
            ),
            (
                ("irradiation", format!("Irradiation under a clear sky, total of {when}")),
                (&shone.irradiation, "irradiation", "kWh/m²"),
                energy,
            ),
        ];
        for ((key, title), (raster, name, unit), items) in products {
            let style = Style::amounts(raster.plane(0));
            self.quantity((key, &title), raster, (name, unit), &items, style)?;
        }
        Ok(())
    }

    fn quantity(
        &mut self,
        names: (&str, &str),
        raster: &Raster,
        (name, unit): (&str, &str),
        items: &[(String, String)],
        style: Style,
    ) -> Result<()> {
        self.raster(names, (raster, &[Band { name, unit }]), (None, style), items, None)
    }

    /// Writes the shadow mask of a date.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn shadows(&mut self, date: &str, shadows: &Raster, sun: &SunPosition) -> Result<()> {
        let (key, title) = (format!("shadow_{date}"), format!("Shadows of {date}"));
        self.mask((&key, &title), shadows, "shadow", Some(sun))
    }

    /// Records a point cloud that was written beside the rasters.
    pub fn points(&mut self, file: &str, count: usize) {
        self.assets.push(Asset::points(file, count));
    }

    /// Records 3D Tiles that were written beside the rasters; `file` is their `tileset.json`.
    pub fn tiles(&mut self, key: &str, file: &str, title: &str) {
        let asset = Asset::other((key, file, title), "application/3dtiles+json", "visual");
        self.assets.push(asset);
    }

    /// Records a page for people that was written beside the rasters.
    pub fn page(&mut self, file: &str, title: &str) {
        let asset = Asset::other(("page", file, title), "text/html", "overview");
        self.assets.push(asset);
    }

    /// Writes the layer file, and last the STAC item of all products.
    ///
    /// # Errors
    /// When the grid lies outside its coordinate system, or a file cannot be written.
    pub fn finish(self, said: &ItemMetadata) -> Result<Set> {
        let mut item = stac::item(said, (self.grid, self.gsd_m, self.vertical_datum), &self.assets)?;
        let kept = stac::kept(&self.earlier.0, &item, self.out);
        let files = kept.values().filter_map(|asset| asset["href"].as_str());
        let files = files.map(|href| href.trim_start_matches("./"));
        let kept_layers: Vec<Layer> = files.filter_map(|file| Layer::earlier(&self.earlier.1, file)).collect();
        if let Some(assets) = item["assets"].as_object_mut() {
            assets.extend(kept);
        }
        // The last written layer lies on top.
        let own = self.layers.iter().rev().cloned();
        let layers: Vec<Layer> = kept_layers.into_iter().chain(own).collect();
        write_atomically(&self.out.join(LAYERS), layer_file(said.id, &layers).as_bytes())?;
        write_atomically(&self.out.join(ITEM), format!("{item:#}\n").as_bytes())?;
        let styles = self.layers.iter().map(|layer| layer.file.replace(".tif", ".qml"));
        let mut names: Vec<String> = self.assets.into_iter().map(|asset| asset.file).chain(styles).collect();
        names.extend([LAYERS.into(), ITEM.into()]);
        Ok(Set {
            item,
            names,
            completeness: self.completeness,
        })
    }
}

/// Metadata items of a raster: the software, and the sun, if any.
fn metadata(sun: Option<&SunPosition>) -> Vec<(String, String)> {
    let software = concat!("heliosplat ", env!("CARGO_PKG_VERSION"));
    let mut items = vec![("SOFTWARE".to_owned(), software.to_owned())];
    if let Some(sun) = sun {
        let [azimuth, elevation] = sun.degrees();
        items.push(("SUN_AZIMUTH".into(), format!("{azimuth:.4}")));
        items.push(("SUN_ELEVATION".into(), format!("{elevation:.4}")));
    }
    items
}
