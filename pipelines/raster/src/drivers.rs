//! GDAL as this program uses it: a fixed list of formats, each complete in its own file and a header beside it, and no
//! network.
//!
//! A file can name other files: as overviews, as masks, as the place of its pixels. GDAL opens such names with every
//! registered driver, also where the file itself was opened with few. So all others are deregistered before the first
//! file is opened.

use gdal::{Driver, DriverManager, config};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Erdas Imagine. The pixels of such a file may be in another folder, so that it is checked before GDAL opens it.
pub(super) const HFA: &str = "HFA";
/// The other registered formats. Those that name other files or addresses (VRT, WMS, HTTP, DIMAP, PCIDSK, PDF …) are
/// not among them. `COG` is for writing alone.
pub(super) const DRIVERS: [&str; 21] = [
    "GTiff",
    "LIBERTIFF",
    "COG",
    "JP2OpenJPEG",
    "JP2KAK",
    "JP2ECW",
    "JP2MrSID",
    "JP2Lura",
    "NITF",
    "ENVI",
    "EHdr",
    "PNG",
    "JPEG",
    "WEBP",
    "BMP",
    "PNM",
    "AAIGrid",
    "DTED",
    "SRTMHGT",
    "USGSDEM",
    "GTX",
];

/// GDAL's options that hold for the whole process.
const OPTIONS: [(&str, &str); 2] = [
    // Megabytes. Every image is read once, in order, so that no block is needed again; GDAL's default is a twentieth of
    // the memory.
    ("GDAL_CACHEMAX", "64"),
    // Remote file systems may open this name alone, which no file has.
    ("CPL_VSIL_CURL_ALLOWED_FILENAME", "/vsicurl/none"),
];

/// Address of the driver of rasters in memory. It is not registered, because a file that names `MEM:::DATAPOINTER=…`
/// could read any address.
static MEMORY: OnceLock<usize> = OnceLock::new();

/// Sets GDAL's options and deregisters all drivers but [`DRIVERS`] and [`HFA`]; once, before the first use of GDAL.
#[allow(unsafe_code, reason = "the crate gdal keeps no driver that is not registered")]
pub(super) fn restrict() {
    for (key, value) in OPTIONS {
        let is_users = key == "GDAL_CACHEMAX" && std::env::var_os(key).is_some();
        if !is_users && config::set_config_option(key, value).is_err() {
            tracing::debug!("GDAL takes no options");
        }
    }
    let carried = std::env::current_exe().ok().and_then(|program| carried_data(&program));
    if let Some(data) = carried.filter(|_| std::env::var_os("GDAL_DATA").is_none())
        && config::set_config_option("GDAL_DATA", &data.to_string_lossy()).is_err()
    {
        tracing::debug!("GDAL takes no folder of data");
    }
    if let Ok(driver) = DriverManager::get_driver_by_name("MEM") {
        // SAFETY: the pointer is not used for anything but `memory` below.
        MEMORY.get_or_init(|| unsafe { driver.c_driver() } as usize);
    }
    for index in (0..DriverManager::count()).rev() {
        if let Ok(driver) = DriverManager::get_driver(index)
            && !is_registered(&driver.short_name())
        {
            DriverManager::deregister_driver(&driver);
        }
    }
}

/// GDAL's data in a portable package (`scripts/portable.sh`), which carries the libraries beside the folder of
/// `program`. PROJ finds its own data, because they are beside its library.
fn carried_data(program: &Path) -> Option<PathBuf> {
    let data = program.parent()?.parent()?.join("lib/heliosplat/share/gdal");
    data.is_dir().then_some(data)
}

fn is_registered(name: &str) -> bool {
    name == HFA || DRIVERS.contains(&name)
}

/// The driver of rasters in memory.
///
/// # Errors
/// When this GDAL has no such driver.
#[allow(unsafe_code, reason = "the crate gdal keeps no driver that is not registered")]
pub(super) fn memory() -> gdal::errors::Result<Driver> {
    match MEMORY.get() {
        // SAFETY: GDAL never frees a driver that was deregistered, and drivers are safe to share between threads.
        Some(&address) => Ok(unsafe { Driver::from_c_driver(address as gdal_sys::GDALDriverH) }),
        None => DriverManager::get_driver_by_name("MEM"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages;

    #[test]
    fn no_driver_is_registered_that_opens_other_files() {
        messages::install();
        for index in 0..DriverManager::count() {
            let name = DriverManager::get_driver(index).expect("a driver").short_name();
            assert!(is_registered(&name), "{name}");
        }
        assert_eq!(memory().expect("in memory").short_name(), "MEM");
    }

    #[test]
    fn a_portable_package_carries_the_data_of_gdal() {
        let package = tempfile::tempdir().expect("a folder");
        let (program, data) = (
            package.path().join("bin/heliosplat"),
            package.path().join("lib/heliosplat/share/gdal"),
        );
        assert_eq!(carried_data(&program), None);
        std::fs::create_dir_all(&data).expect("a folder");
        assert_eq!(carried_data(&program), Some(data));
    }
}
