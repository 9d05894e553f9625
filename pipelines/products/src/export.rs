//! A run or a batch's mosaic for other programs: splats lit by a sun (PLY, glTF, 3D Tiles) and the textured surface
//! (glTF, 3D Tiles).
//!
//! All files use the local frame, metres east, north and up of the site's origin, never map coordinates: a map's north
//! and its scale are not those of the ground. [`anchor`] gives the position of the frame on Earth.

mod folder;
mod joined;
mod lit;
mod mosaic;
mod textured;
mod tile;

pub use joined::join_tilesets;
pub use lit::{Display, Lit, Look, shown};
pub use mosaic::{Mosaic, Reference};
pub use textured::white_of;
pub use tile::MosaicTile;

use crate::dsm;
use crate::model::LoadedModel;
use crate::nadir::NadirGrid;
use crate::ortho;
use crate::relight::RelightError;
use heliosplat_exchange::glb::TooLarge;
use heliosplat_exchange::tiles::{self, Contents, Placement, Tile, WriteFile};
use heliosplat_exchange::{splat_ply, splats};
use heliosplat_fitting::run_folder::RunError;
use heliosplat_raster::crs::utm_epsg;
use heliosplat_raster::{Crs, CrsTransform, RasterError, write_atomically};
use heliosplat_rpc::frame::ecef_from_geo;
use heliosplat_rpc::sun::SunPosition;
use heliosplat_rpc::{GeoPoint, LocalFrame};
use nalgebra::{Matrix4, Vector3};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use textured::{Dressed, TexturedGround};

/// Name of the root file of a folder of tiles.
pub const TILESET: &str = "tileset.json";

/// Files to export; at least one.
#[derive(Debug, Clone, Default)]
pub struct Request {
    /// PLY file of splats, for viewers and editors of splats.
    pub ply: Option<PathBuf>,
    /// glTF file of splats.
    pub splats: Option<PathBuf>,
    /// glTF file of the textured surface.
    pub mesh: Option<PathBuf>,
    /// Folder for 3D Tiles.
    pub tiles: Option<PathBuf>,
    /// True if the tiles hold the textured surface instead of splats.
    pub tiles_of_mesh: bool,
    /// Sun of the splats; that of the reference image by default.
    pub sun: Option<SunPosition>,
}

/// A file or folder that was written.
#[derive(Debug, Clone, Default, serde::Serialize)]
pub struct Written {
    /// Kind of the file: `ply`, `splats`, `mesh`, `tiles`.
    pub kind: &'static str,
    /// Path of the file or folder.
    pub path: PathBuf,
    /// Size of the file, or of all files of the folder, bytes.
    pub bytes: u64,
    /// Number of files written.
    pub files: usize,
    /// Number of splats at the finest level; absent for meshes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub splats: Option<usize>,
    /// Number of triangles at the finest level; absent for splats.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub triangles: Option<usize>,
    /// Number of levels of detail.
    pub levels: usize,
}

/// Exported files and their metadata.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Export {
    /// Files and folders that were written.
    pub written: Vec<Written>,
    /// Metadata in the files: the anchor of the frame, and for splats the sun and the display stretch.
    pub said: Value,
}

/// Reason that a run or a mosaic cannot be exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The sun or the run cannot be used.
    #[error(transparent)]
    Light(#[from] RelightError),
    /// A file cannot be written.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// A file would be too large.
    #[error(transparent)]
    TooLarge(#[from] TooLarge),
    /// The surface has no known cell.
    #[error("{}: the run knows no surface; train it again with more images of the place", .0.display())]
    NoSurface(PathBuf),
}

impl From<RunError> for ExportError {
    fn from(error: RunError) -> Self {
        Self::Light(error.into())
    }
}

impl ExportError {
    /// True if the input of the user is at fault, and not the machine.
    pub fn is_input_fault(&self) -> bool {
        match self {
            Self::Light(error) => error.is_input_fault(),
            Self::Raster(error) => error.is_input_fault(),
            Self::TooLarge(_) | Self::NoSurface(_) => true,
        }
    }
}

/// Transform from metres of a local frame to Earth-centred, Earth-fixed metres (WGS 84): a 4 x 4 matrix, column after
/// column.
pub fn ecef_from_enu(frame: &LocalFrame) -> [f64; 16] {
    let mut matrix = Matrix4::identity();
    let rotation = frame.enu_from_ecef_rotation().transpose();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    let origin = ecef_from_geo(frame.origin);
    matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&origin);
    columns(&matrix)
}

/// Half of the distance over which the projection of a frame is differentiated, metres.
const STEP_M: f64 = 100.0;

/// Numbers of a matrix, column after column.
fn columns(matrix: &Matrix4<f64>) -> [f64; 16] {
    let mut numbers = [0.0; 16];
    numbers.copy_from_slice(matrix.as_slice());
    numbers
}

/// Place of a local frame on Earth, and in its zone of UTM.
///
/// # Errors
/// When PROJ has no such zone.
fn placement(frame: &LocalFrame) -> Result<Placement, RasterError> {
    let GeoPoint { lon_deg, lat_deg, .. } = frame.origin;
    let epsg = utm_epsg(lon_deg, lat_deg);
    let to_map = CrsTransform::from_lon_lat(&Crs::from_epsg(epsg)?)?;
    let mapped = |enu: Vector3<f64>| {
        let geo = frame.geo_from_enu(enu);
        let (x, y) = to_map.apply(geo.lon_deg, geo.lat_deg)?;
        Ok::<_, RasterError>(Vector3::new(x, y, geo.height_m))
    };
    let mut projected = Matrix4::identity();
    let origin = mapped(Vector3::zeros())?;
    projected.fixed_view_mut::<3, 1>(0, 3).copy_from(&origin);
    for axis in 0..3 {
        let step = STEP_M * Vector3::ith(axis, 1.0);
        let slope = (mapped(step)? - mapped(-step)?) / (2.0 * STEP_M);
        projected.fixed_view_mut::<3, 1>(0, axis).copy_from(&slope);
    }
    let (ecef, projected) = (ecef_from_enu(frame), columns(&projected));
    Ok(Placement { ecef, epsg, projected })
}

/// Anchor of a local frame as JSON: axes, datum, origin (degrees, metres), and transform to Earth-centred, Earth-fixed
/// metres.
pub fn anchor(frame: &LocalFrame) -> Value {
    let origin = frame.origin;
    json!({
        "frame": "metres east, north and up of the origin",
        "datum": "WGS 84, heights above the ellipsoid",
        "origin": {"lon_deg": origin.lon_deg, "lat_deg": origin.lat_deg, "height_m": origin.height_m},
        "ecef_from_enu": ecef_from_enu(frame),
    })
}

/// Source of an export.
pub enum Subject {
    /// A run.
    Run(Box<LoadedModel>),
    /// A batch's mosaic.
    Mosaic(Box<Mosaic>),
}

impl Subject {
    /// Local frame of all files.
    pub fn frame(&self) -> &LocalFrame {
        match self {
            Self::Run(model) => &model.frame,
            Self::Mosaic(mosaic) => &mosaic.frame,
        }
    }

    fn folder(&self) -> &Path {
        match self {
            Self::Run(model) => &model.folder,
            Self::Mosaic(mosaic) => &mosaic.folder,
        }
    }

    fn lit(&self, sun: Option<&SunPosition>) -> Result<Lit, ExportError> {
        match self {
            Self::Run(model) => Ok(Lit::new(model, sun)?),
            Self::Mosaic(mosaic) => mosaic.lit(sun),
        }
    }

    fn ground(&self) -> Result<TexturedGround, ExportError> {
        match self {
            Self::Run(model) => ground(model),
            Self::Mosaic(mosaic) => mosaic.ground(),
        }
    }
}

/// Writes the requested files of a run or a mosaic. Each file and each folder is complete or absent.
///
/// # Errors
/// [`ExportError`] where the run, the sun or the surface cannot be used, or a file is too large or cannot be written.
pub fn write(subject: &Subject, request: &Request) -> Result<Export, ExportError> {
    let mut said = json!({
        "anchor": anchor(subject.frame()), "software": concat!("heliosplat ", env!("CARGO_PKG_VERSION")),
    });
    let mut written = Vec::new();
    let tiles_of_splats = request.tiles.as_deref().filter(|_| !request.tiles_of_mesh);
    let tiles_of_mesh = request.tiles.as_deref().filter(|_| request.tiles_of_mesh);
    if request.ply.is_some() || request.splats.is_some() || tiles_of_splats.is_some() {
        let lit = subject.lit(request.sun.as_ref())?;
        if lit.splats.is_empty() {
            return Err(ExportError::NoSurface(subject.folder().to_owned()));
        }
        let of_splats = with(&said, &lit.metadata());
        if let Some(path) = &request.ply {
            written.push(write_ply(path, &lit, &of_splats)?);
        }
        if let Some(path) = &request.splats {
            let bytes = splats::glb(&lit.splats, of_splats.clone())?;
            let splats = Some(lit.splats.len());
            let one = write_one(path, "splats", &bytes)?;
            written.push(Written { splats, ..one });
        }
        if let Some(folder) = tiles_of_splats {
            let grow = |write: &mut WriteFile<_>| Ok(Some(tiles::of_splats(lit.splats.clone(), write)?));
            let tiled = write_tiles(folder, subject.frame(), Contents::Splats, &of_splats, grow)?;
            let splats = Some(lit.splats.len());
            written.push(Written { splats, ..tiled });
        }
        said = of_splats;
    }
    if request.mesh.is_some() || tiles_of_mesh.is_some() {
        let ground = subject.ground()?;
        let of_mesh = with(&said, &ground.metadata());
        if let Some(path) = &request.mesh {
            let dressed = ground.whole(of_mesh.clone())?;
            let Dressed { glb, triangles, .. } =
                dressed.ok_or_else(|| ExportError::NoSurface(subject.folder().to_owned()))?;
            let (triangles, one) = (Some(triangles), write_one(path, "mesh", &glb)?);
            written.push(Written { triangles, ..one });
        }
        if let Some(folder) = tiles_of_mesh {
            let mut triangles = 0;
            let grow = |write: &mut WriteFile<_>| ground.tiles(write, &mut triangles);
            let tiled = write_tiles(folder, subject.frame(), Contents::Meshes, &of_mesh, grow)?;
            let triangles = Some(triangles);
            written.push(Written { triangles, ..tiled });
        }
        said = of_mesh;
    }
    Ok(Export { written, said })
}

/// Textured surface of a run, with its albedo.
fn ground(model: &LoadedModel) -> Result<TexturedGround, ExportError> {
    let nadir = NadirGrid::new(&model.into(), model.file.gsd_m, None)?;
    let mut albedo = ortho::albedo(model, &dsm::maps(model, &nadir));
    let surface = dsm::of_model(&nadir, model)?;
    surface.blank_unknown(&mut albedo);
    let bands = &model.file.bands;
    let look = (bands.as_slice(), white_of(&albedo, bands));
    Ok(TexturedGround::new((&surface, &albedo), look, &nadir.enu))
}

/// Object with the members of two objects.
fn with(a: &Value, b: &Value) -> Value {
    let members = [a, b].into_iter().filter_map(Value::as_object).flatten();
    Value::Object(members.map(|(key, value)| (key.clone(), value.clone())).collect())
}

fn write_one(path: &Path, kind: &'static str, bytes: &[u8]) -> Result<Written, ExportError> {
    write_atomically(path, bytes)?;
    Ok(Written {
        kind,
        path: path.to_owned(),
        bytes: bytes.len() as u64,
        files: 1,
        levels: 1,
        ..Written::default()
    })
}

/// Writes splats as PLY, with their metadata in its comments and in a JSON file beside it.
fn write_ply(path: &Path, lit: &Lit, said: &Value) -> Result<Written, ExportError> {
    let mut sidecar = path.as_os_str().to_owned();
    sidecar.push(".json");
    let text = format!("{said:#}\n");
    let members = said.as_object().into_iter().flatten();
    let comments: Vec<String> = members.map(|(key, value)| format!("{key} {value}")).collect();
    write_atomically(Path::new(&sidecar), text.as_bytes())?;
    let bytes = splat_ply::encode(&splats::table(&lit.splats), &comments);
    let one = write_one(path, "ply", &bytes)?;
    Ok(Written {
        splats: Some(lit.splats.len()),
        bytes: one.bytes + text.len() as u64,
        files: 2,
        ..one
    })
}

/// Writes a folder of tiles, `tileset.json` last.
fn write_tiles(
    folder: &Path,
    frame: &LocalFrame,
    contents: Contents,
    said: &Value,
    grow: impl FnOnce(&mut WriteFile<ExportError>) -> Result<Option<Tile>, ExportError>,
) -> Result<Written, ExportError> {
    folder::replace(folder, |new| {
        let (mut bytes, mut files) = (0, 0);
        let mut write = |name: &str, content: Vec<u8>| {
            write_atomically(&new.join(name), &content)?;
            (bytes, files) = (bytes + content.len() as u64, files + 1);
            Ok(())
        };
        let root = grow(&mut write)?.ok_or_else(|| ExportError::NoSurface(folder.to_owned()))?;
        let tileset = tiles::tileset(&root, &placement(frame)?, contents, said.clone());
        let text = format!("{tileset:#}\n");
        write(TILESET, text.into_bytes())?;
        Ok(Written {
            kind: "tiles",
            path: folder.to_owned(),
            bytes,
            files,
            levels: root.depth(),
            ..Written::default()
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat_rpc::frame::geo_from_ecef;
    use nalgebra::Vector4;

    #[test]
    fn a_kilometre_is_placed_on_the_map_to_a_decimetre() {
        for (lon_deg, lat_deg) in [(36.91, 37.58), (-47.03, -22.89), (11.9, 78.2)] {
            let frame = LocalFrame::new(GeoPoint::new(lon_deg, lat_deg, 712.0));
            let Placement { epsg, projected, .. } = placement(&frame).expect("a zone of UTM");
            let to_map = CrsTransform::from_lon_lat(&Crs::from_epsg(epsg).expect("known")).expect("known");
            let matrix = Matrix4::from_column_slice(&projected);
            for (east, north, up) in [(0.0, 0.0, 30.0), (500.0, -500.0, 0.0), (-500.0, 500.0, 80.0)] {
                let geo = frame.geo_from_enu(Vector3::new(east, north, up));
                let (x, y) = to_map.apply(geo.lon_deg, geo.lat_deg).expect("inside");
                let off = (matrix * Vector4::new(east, north, up, 1.0)).xyz() - Vector3::new(x, y, geo.height_m);
                assert!(off.norm() < 0.1, "{off}");
            }
        }
    }

    #[test]
    fn corners_of_a_site_are_where_they_belong_on_earth() {
        for (lon_deg, lat_deg) in [(36.91, 37.58), (-47.03, -22.89), (179.999, 65.0), (0.0, 0.0)] {
            let frame = LocalFrame::new(GeoPoint::new(lon_deg, lat_deg, 712.0));
            let matrix = Matrix4::from_column_slice(&ecef_from_enu(&frame));
            for (east, north, up) in [(0.0, 0.0, 0.0), (2000.0, -1500.0, 80.0), (-64.0, 64.0, -12.5)] {
                let placed = matrix * Vector4::new(east, north, up, 1.0);
                let geo = geo_from_ecef(placed.xyz());
                let back = frame.enu_from_geo(geo) - nalgebra::Vector3::new(east, north, up);
                assert!(back.norm() < 1e-6, "{back}");
                assert_eq!(placed.w, 1.0);
            }
        }
    }
}
