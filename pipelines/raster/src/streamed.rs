//! Cloud-optimised GeoTIFFs that are larger than memory: rows are written as they come, and assembled to the file at
//! the end.
//!
//! Rows go to a plain GeoTIFF in a temporary folder beside the target, which is removed after success and failure
//! alike. The finished file is renamed to the target, which is therefore never incomplete.

use super::temporary::{TemporaryFolder, target};
use super::write::{NODATA, add_statistics, cog_options, describe, with_nodata};
use super::{ImageSpec, RasterError, Result, messages};
use gdal::raster::{Buffer, RasterCreationOptions};
use gdal::{Dataset, DriverManager};
use heliosplat::Raster;
use std::path::{Path, PathBuf};

/// A float32 cloud-optimised GeoTIFF as [`super::write_cog`] writes it, written row by row.
pub struct StreamedCog {
    path: PathBuf,
    folder: TemporaryFolder,
    dataset: Dataset,
}

impl StreamedCog {
    /// Begins a file with the width, height and bands of the raster of `spec`; its values are not read.
    ///
    /// # Errors
    /// A full disk, a refused permission or another failure to write, as [`super::write_cog`].
    pub fn create(path: &Path, spec: &ImageSpec) -> Result<Self> {
        let folder = TemporaryFolder::beside(path)?;
        let rows = folder.path().join("rows.tif");
        let Raster {
            width, height, bands, ..
        } = *spec.raster;
        let dataset = messages::collect_strictly(|| {
            let driver = DriverManager::get_driver_by_name("GTiff")?;
            let options = RasterCreationOptions::from_iter([
                "TILED=YES",
                "BLOCKXSIZE=256",
                "BLOCKYSIZE=256",
                "INTERLEAVE=BAND",
                "BIGTIFF=IF_SAFER",
            ]);
            let mut dataset =
                driver.create_with_band_type_with_options::<f32, _>(&rows, width, height, bands, &options)?;
            describe(&mut dataset, spec, Some(NODATA))?;
            Ok(dataset)
        })
        .map_err(|reason| failed(path, reason))?;
        let path = path.to_owned();
        Ok(Self { path, folder, dataset })
    }

    /// Writes whole rows of all bands from `row0` on; `NaN` and infinities become nodata.
    ///
    /// # Errors
    /// A full disk, a refused permission or another failure to write, as [`super::write_cog`].
    pub fn write_rows(&mut self, row0: usize, rows: &Raster) -> Result<()> {
        let size = (rows.width, rows.height);
        messages::collect_strictly(|| {
            for band in 0..rows.bands {
                let values = rows.plane(band).iter().map(|&value| with_nodata(value)).collect();
                let mut band = self.dataset.rasterband(band + 1)?;
                band.write((0, row0 as isize), size, &mut Buffer::new(size, values))?;
            }
            Ok(())
        })
        .map_err(|reason| failed(&self.path, reason))
    }

    /// Assembles the file from its rows.
    ///
    /// # Errors
    /// A full disk, a refused permission or another failure to write, as [`super::write_cog`]; nothing is left behind.
    pub fn finish(mut self) -> Result<()> {
        let finished = self.folder.path().join("finished.tif");
        messages::collect_strictly(|| self.dataset.flush_cache()).map_err(|reason| failed(&self.path, reason))?;
        add_statistics(&self.dataset);
        messages::collect_strictly(|| {
            let driver = DriverManager::get_driver_by_name("COG")?;
            let options = RasterCreationOptions::from_iter(cog_options("AVERAGE").iter().map(AsRef::<str>::as_ref));
            self.dataset.create_copy(&driver, &finished, &options)?.close()
        })
        .map_err(|reason| failed(&self.path, reason))?;
        let synced = std::fs::File::open(&finished).and_then(|file| file.sync_all());
        let done = synced.and_then(|()| std::fs::rename(&finished, target(&self.path)));
        done.map_err(|error| RasterError::from_io(&self.path, &error))
    }
}

fn failed(path: &Path, reason: String) -> RasterError {
    RasterError::Write(path.to_owned(), reason)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Crs, GeoTransform, RasterFile, write_cog};

    #[test]
    fn a_file_written_row_by_row_is_the_one_written_at_once_and_leaves_nothing_else() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut raster = Raster::filled(600, 530, 2, 0.0);
        for (index, value) in raster.values.iter_mut().enumerate() {
            *value = if index % 91 == 3 {
                f32::NAN
            } else {
                (index % 977) as f32 * 0.25
            };
        }
        let transform = GeoTransform::north_up(312_000.0, 4_160_500.0, 0.5);
        let crs = Crs::from_epsg(32637).expect("UTM 37N");
        let spec = ImageSpec {
            band_descriptions: &["altitude", "views"],
            band_units: &["metre", "1"],
            georeference: Some((&transform, &crs)),
            ..ImageSpec::plain(&raster)
        };
        let [at_once, in_rows] = ["whole.tif", "rows.tif"].map(|name| folder.path().join(name));
        write_cog(&at_once, &spec).expect("written");
        let mut file = StreamedCog::create(&in_rows, &spec).expect("begun");
        for row0 in (0..raster.height).step_by(100) {
            let height = 100.min(raster.height - row0);
            let mut rows = Raster::filled(raster.width, height, 2, 0.0);
            for band in 0..2 {
                let first = row0 * raster.width;
                let values = &raster.plane(band)[first..first + height * raster.width];
                rows.plane_mut(band).copy_from_slice(values);
            }
            file.write_rows(row0, &rows).expect("rows");
        }
        assert!(!in_rows.exists(), "nothing before the end");
        file.finish().expect("finished");
        let [a, b] = [&at_once, &in_rows].map(|path| RasterFile::open(path).expect("readable"));
        assert_eq!(
            b.domain("IMAGE_STRUCTURE").get("LAYOUT").map(String::as_str),
            Some("COG")
        );
        assert_eq!(a.bands, b.bands);
        let [a, b] = [a, b].map(|file| file.read_all().expect("pixels"));
        assert!(a.values.iter().zip(&b.values).all(|(a, b)| a.to_bits() == b.to_bits()));
        assert_eq!(std::fs::read_dir(folder.path()).expect("listable").count(), 2);
    }
}
