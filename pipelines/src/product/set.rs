//! All products of a run: cloud-optimised GeoTIFFs on one grid, a point cloud, and a STAC item that describes them.

use super::dsm::{BANDS, Dsm, NadirGrid, UNITS, maps, of_maps};
use super::relight::{RelightError, relight_ortho};
use super::stac::{self, About, Asset, Band};
use super::{ortho, points};
use crate::raster::write::{Bytes, ImageSpec, write_byte_cog, write_cog};
use crate::raster::{Geoid, RasterError, write_atomically};
use crate::run::{LoadedModel, ModelImage};
use crate::scene::bands::vegetation_bands;
use heliosplat::Raster;
use heliosplat_rpc::sun::SunPosition;
use jiff::Timestamp;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What is asked of the products of a run.
#[derive(Debug, Clone, Default)]
pub struct Request {
    /// Ground sampling distance, metres; that of the images by default.
    pub gsd_m: Option<f64>,
    /// Coordinate system; the local UTM zone by default.
    pub crs: Option<String>,
    /// What heights are above; the ellipsoid by default.
    pub geoid: Option<Geoid>,
    /// The sun of the relit ortho image, if there is to be one.
    pub sun: Option<SunPosition>,
}

/// The products of a run.
#[derive(Debug)]
pub struct Set {
    /// The STAC item.
    pub item: serde_json::Value,
    /// The files, `item.json` last.
    pub files: Vec<PathBuf>,
    /// Share of the grid whose altitude is known.
    pub completeness: f64,
}

/// The date of an image by name: its day, or without a time the place of its sun.
pub fn date_of(image: &ModelImage) -> String {
    match image.time {
        Some(time) => time.strftime("%Y-%m-%d").to_string(),
        None => format!(
            "sun_{:03.0}_{:02.0}",
            image.sun.azimuth_rad.to_degrees().rem_euclid(360.0),
            image.sun.elevation_rad.to_degrees()
        ),
    }
}

/// The dates of a run, and the sun of the first image of each.
pub fn dates(images: &[ModelImage]) -> Vec<(String, SunPosition)> {
    let mut known = BTreeMap::new();
    for image in images {
        known.entry(date_of(image)).or_insert(image.sun);
    }
    known.into_iter().collect()
}

struct Writer<'m> {
    model: &'m LoadedModel,
    nadir: NadirGrid,
    gsd_m: f64,
    out: &'m Path,
    assets: Vec<Asset>,
}

impl Writer<'_> {
    fn spec<'a>(&'a self, raster: &'a Raster, names: &'a [&'a str], metadata: &'a [(String, String)]) -> ImageSpec<'a> {
        ImageSpec {
            band_descriptions: names,
            georeference: Some((&self.nadir.grid.transform, &self.nadir.grid.crs)),
            metadata,
            ..ImageSpec::plain(raster)
        }
    }

    fn bytes(
        &mut self,
        (key, title, name): (&str, &str, &str),
        raster: &Raster,
        bytes: Bytes,
        sun: Option<&SunPosition>,
    ) -> Result<(), RasterError> {
        let file = format!("{key}.tif");
        write_byte_cog(&self.out.join(&file), &self.spec(raster, &[name], &said(sun)), bytes)?;
        let bands = [Band { name, unit: "" }];
        let shown;
        // What the file holds is what is described: whole shades.
        let raster = if bytes == Bytes::Shades {
            shown = Raster {
                values: raster.values.iter().map(|v| v.round()).collect(),
                ..raster.clone()
            };
            &shown
        } else {
            raster
        };
        let asset = Asset::raster(
            (key, &file, title),
            raster,
            &bands,
            Some(bytes.nodata()),
            self.gsd_m,
            sun,
        );
        self.assets.push(asset);
        Ok(())
    }

    fn floats(
        &mut self,
        (key, title): (&str, &str),
        raster: &Raster,
        names: &[&str],
        sun: Option<&SunPosition>,
    ) -> Result<(), RasterError> {
        let file = format!("{key}.tif");
        write_cog(&self.out.join(&file), &self.spec(raster, names, &said(sun)))?;
        let bands: Vec<Band> = names.iter().map(|name| Band { name, unit: "" }).collect();
        let asset = Asset::raster((key, &file, title), raster, &bands, None, self.gsd_m, sun);
        self.assets.push(asset);
        Ok(())
    }

    fn surface(&mut self, dsm: &Dsm) -> Result<(), RasterError> {
        dsm.write(&self.out.join("dsm.tif"))?;
        let bands: Vec<Band> = BANDS
            .iter()
            .zip(UNITS)
            .map(|(name, unit)| Band { name, unit })
            .collect();
        let title = format!("Surface model, metres above {}", dsm.vertical_datum());
        let asset = Asset::raster(("dsm", "dsm.tif", &title), &dsm.raster, &bands, None, self.gsd_m, None);
        self.assets.push(asset);
        let shade = ortho::hillshade(&dsm.altitude(), self.gsd_m);
        self.bytes(
            (
                "hillshade",
                "Hillshade of the surface, light from the north-west",
                "shade",
            ),
            &shade,
            Bytes::Shades,
            None,
        )
    }
}

/// Metadata items that say which sun a raster stands for.
fn said(sun: Option<&SunPosition>) -> Vec<(String, String)> {
    let mut items = vec![(
        "SOFTWARE".to_owned(),
        concat!("heliosplat ", env!("CARGO_PKG_VERSION")).to_owned(),
    )];
    if let Some(sun) = sun {
        items.push((
            "SUN_AZIMUTH".into(),
            format!("{:.4}", sun.azimuth_rad.to_degrees().rem_euclid(360.0)),
        ));
        items.push(("SUN_ELEVATION".into(), format!("{:.4}", sun.elevation_rad.to_degrees())));
    }
    items
}

/// How many steps [`write()`] reports.
pub fn steps(model: &LoadedModel) -> u64 {
    4 + dates(&model.file.images).len() as u64
}

/// Writes all products of `model` into the folder `out`, `item.json` last; `done` is called with the number of steps done.
///
/// # Errors
/// When the grid cannot be made, a geoid is missing, the sun asked for is down (before anything is written), or a file cannot be written.
pub fn write(
    model: &LoadedModel,
    out: &Path,
    request: &Request,
    (id, collection): (&str, Option<&str>),
    done: &dyn Fn(u64),
) -> Result<Set, RelightError> {
    let gsd_m = request.gsd_m.unwrap_or(model.file.gsd_m);
    let nadir = NadirGrid::new(&model.into(), gsd_m, request.crs.as_deref())?;
    let seen = maps(model, &nadir);
    let mut surface = of_maps(&nadir, &seen);
    if let Some(geoid) = request.geoid {
        surface = surface.above(geoid)?;
    }
    let known = surface.raster.plane(0).iter().filter(|v| v.is_finite()).count();
    if known == 0 {
        return Err(RelightError::Raster(RasterError::Transform {
            crs: nadir.grid.crs.name().to_owned(),
            reason: "nothing of the run falls on its grid".into(),
        }));
    }
    let completeness = known as f64 / surface.raster.plane_len().max(1) as f64;
    let relit = request
        .sun
        .map(|sun| Ok::<_, RelightError>((sun, relight_ortho(model, &sun, &nadir)?)));
    let relit = relit.transpose()?;
    done(1);
    let mut writer = Writer {
        model,
        nadir,
        gsd_m,
        out,
        assets: Vec::new(),
    };
    writer.surface(&surface)?;
    writer.colours(&ortho::albedo(model, &seen))?;
    done(2);
    if let Some((sun, relit)) = &relit {
        writer.floats(
            ("relit", "Ortho image under the sun asked for, counts"),
            &relit.image,
            &names(model),
            Some(sun),
        )?;
        let title = "Shadows under the sun asked for";
        writer.bytes(
            ("relit_shadow", title, "shadow"),
            &relit.shadows(),
            Bytes::Mask,
            Some(sun),
        )?;
    }
    done(3);
    let dates = dates(&model.file.images);
    for (place, (date, sun)) in dates.iter().enumerate() {
        let shadows = relight_ortho(model, sun, &writer.nadir)?.shadows();
        let title = format!("Shadows of {date}");
        writer.bytes(
            (&format!("shadow_{date}"), &title, "shadow"),
            &shadows,
            Bytes::Mask,
            Some(sun),
        )?;
        done(4 + place as u64);
    }
    let count = points::write(&out.join("points.laz"), model, &writer.nadir.grid.crs, request.geoid)?;
    writer.assets.push(Asset::points("points.laz", count));
    let times = times(model);
    let about = About {
        id,
        grid: &writer.nadir.grid,
        gsd_m,
        vertical_datum: surface.vertical_datum(),
        times: &times,
        sun: dates.first().filter(|_| dates.len() == 1).map(|(_, sun)| sun),
        collection,
    };
    let item = stac::item(&about, &writer.assets)?;
    let path = out.join("item.json");
    write_atomically(&path, format!("{item:#}\n").as_bytes())?;
    let mut files: Vec<PathBuf> = writer.assets.iter().map(|asset| out.join(&asset.file)).collect();
    files.push(path);
    done(steps(model));
    Ok(Set {
        item,
        files,
        completeness,
    })
}

fn names(model: &LoadedModel) -> Vec<&'static str> {
    model.file.bands.iter().map(|band| band.name()).collect()
}

impl Writer<'_> {
    fn colours(&mut self, albedo: &Raster) -> Result<(), RasterError> {
        let names = names(self.model);
        self.floats(
            ("albedo", "True-ortho albedo, relative to level ground in full sun"),
            albedo,
            &names,
            None,
        )?;
        if let Some(bands) = vegetation_bands(&self.model.file.bands) {
            let leaves = ortho::vegetation(albedo, bands);
            self.bytes(
                ("vegetation", "Vegetation by its index", "vegetation"),
                &leaves,
                Bytes::Mask,
                None,
            )?;
        }
        Ok(())
    }
}

/// When the images of a run were taken; where none is known, when its model was written.
fn times(model: &LoadedModel) -> Vec<Timestamp> {
    let times: Vec<Timestamp> = model.file.images.iter().filter_map(|image| image.time).collect();
    if !times.is_empty() {
        return times;
    }
    let written = std::fs::metadata(model.folder.join("model.json")).and_then(|m| m.modified());
    vec![
        written
            .ok()
            .and_then(|t| Timestamp::try_from(t).ok())
            .unwrap_or_default(),
    ]
}
