//! The surface as triangles, two for each square of four cells, with the albedo as their picture.
//!
//! Steep triangles, the walls, have corners and normals of their own; all others share corners and are smooth. Unknown
//! cells are holes. Tiles of one level share the cells of their border, so no gap shows between them; where levels meet
//! there may be a gap as wide as the error of a coarse cell.

use super::ExportError;
use super::lit::{Display, shown};
use crate::dsm::Dsm;
use glam::Vec3;
use heliosplat::Raster;
use heliosplat_exchange::glb::{TooLarge, bounds};
use heliosplat_exchange::mesh::{Look, Mesh, glb};
use heliosplat_exchange::tiles::{ERROR_OF_CELL, Tile, WriteFile};
use heliosplat_raster::EnuGrid;
use heliosplat_scene::BandKind;
use image::imageops::{FilterType, crop_imm, resize};
use image::{ImageFormat, Rgb, RgbImage};
use serde_json::{Value, json};
use std::io::Cursor;

/// Cells along a side of a tile.
const TILE_CELLS: usize = 256;
/// Least number of levels above the finest: a small site is seen from far away, too.
const LEVELS_LEAST: u32 = 2;
/// Cosine of the slope beyond which a triangle is a wall: 60 degrees.
const WALL: f32 = 0.5;
/// Quantile of the albedo that is shown white.
const WHITE: f64 = 0.995;
const PNG: &str = "image/png";

/// Surface on a grid, in the local frame, and its picture.
pub(super) struct TexturedGround {
    width: usize,
    height: usize,
    /// Positions of the cells' centres, metres; NaN where unknown.
    places: Vec<Vec3>,
    picture: RgbImage,
    cell_m: f64,
    white: f32,
}

/// Part of the surface as a GLB file.
pub(super) struct Dressed {
    /// Bytes of the file.
    pub(super) glb: Vec<u8>,
    /// Number of triangles.
    pub(super) triangles: usize,
    low: [f64; 3],
    high: [f64; 3],
}

/// Rectangle of cells, first and last included, of which every `step`-th is a corner.
#[derive(Debug, Clone, Copy)]
struct Part {
    from: [usize; 2],
    to: [usize; 2],
    step: usize,
}

#[derive(Default)]
struct Triangles {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    places: Vec<[f32; 2]>,
    triangles: Vec<[u32; 3]>,
}

/// Albedo that is shown white: a high quantile of the bands shown.
pub fn white_of(albedo: &Raster, bands: &[BandKind]) -> f32 {
    Display::of(albedo, bands, (0.0, WHITE)).white
}

impl TexturedGround {
    /// Textured surface of `dsm`, whose altitudes are above the ellipsoid, with an albedo of `bands` on the same grid;
    /// the albedo `white` is shown white.
    pub(super) fn new((dsm, albedo): (&Dsm, &Raster), (bands, white): (&[BandKind], f32), enu: &EnuGrid) -> Self {
        let (width, height) = (dsm.grid.width, dsm.grid.height);
        let altitude = dsm.raster.plane(0);
        let place = |i: usize| {
            let [east, north, up] = enu.enu((i % width) as f64, (i / width) as f64, f64::from(altitude[i]));
            Vec3::new(east as f32, north as f32, up as f32)
        };
        let (bands, black) = (shown(bands), 0.0);
        let display = Display { bands, black, white };
        Self {
            width,
            height,
            places: (0..width * height).map(place).collect(),
            picture: picture(albedo, &display),
            cell_m: dsm.grid.transform.pixel_size().0 * dsm.grid.crs.metres_per_unit(),
            white: display.white,
        }
    }

    /// Metadata of the surface in files: display stretch of the albedo, and width of a cell, metres.
    pub(super) fn metadata(&self) -> Value {
        json!({"albedo": {"black": 0.0, "white": self.white, "curve": "sRGB"}, "cell_m": self.cell_m})
    }

    /// Whole surface as one file with `said` as metadata; `None` where nothing is known.
    ///
    /// # Errors
    /// `TooLarge` for a file of more than 4 GiB.
    pub(super) fn whole(&self, said: Value) -> Result<Option<Dressed>, TooLarge> {
        let (from, to, step) = ([0, 0], [self.width - 1, self.height - 1], 1);
        self.dressed(&Part { from, to, step }, said)
    }

    /// Writes the whole surface as tiles, each coarser level with a quarter of the cells, and returns the root; `None`
    /// where nothing is known. Adds the triangles of the finest level to `triangles`.
    ///
    /// # Errors
    /// Errors of `write`, and `ExportError::TooLarge` for a tile of more than 4 GiB.
    pub(super) fn tiles(
        &self,
        write: &mut WriteFile<ExportError>,
        triangles: &mut usize,
    ) -> Result<Option<Tile>, ExportError> {
        let side = self.width.max(self.height);
        let levels = (0..).find(|&level| (TILE_CELLS << level) >= side - 1).unwrap_or(0);
        self.grow([0, 0], levels.max(LEVELS_LEAST), "tile".into(), write, triangles)
    }

    fn grow(
        &self,
        from: [usize; 2],
        level: u32,
        name: String,
        write: &mut WriteFile<ExportError>,
        triangles: &mut usize,
    ) -> Result<Option<Tile>, ExportError> {
        let last = [self.width - 1, self.height - 1];
        let step = 1 << level;
        let to = [0, 1].map(|k| last[k].min(from[k] + TILE_CELLS * step));
        if (0..2).any(|k| from[k] >= last[k]) {
            return Ok(None);
        }
        let Some(dressed) = self.dressed(&Part { from, to, step }, Value::Null)? else {
            // Parts thinner than the step appear at finer levels only, and are too small to matter.
            return Ok(None);
        };
        let mut tile = Tile {
            file: format!("{name}.glb"),
            low: dressed.low,
            high: dressed.high,
            error_m: 0.0,
            children: Vec::new(),
        };
        write(&tile.file, dressed.glb)?;
        if level == 0 {
            *triangles += dressed.triangles;
            return Ok(Some(tile));
        }
        tile.error_m = ERROR_OF_CELL * self.cell_m * step as f64;
        let half = TILE_CELLS * step / 2;
        for quarter in 0..4 {
            let start = [from[0] + (quarter % 2) * half, from[1] + (quarter / 2) * half];
            if let Some(child) = self.grow(start, level - 1, format!("{name}-{quarter}"), write, triangles)? {
                tile.add(child);
            }
        }
        Ok(Some(tile))
    }

    /// A part as a file; `None` where it has no triangle.
    fn dressed(&self, part: &Part, said: Value) -> Result<Option<Dressed>, TooLarge> {
        let mesh = self.triangles(part);
        if mesh.triangles.is_empty() {
            return Ok(None);
        }
        let (low, high) = bounds(&mesh.positions);
        let gltf = |v: &[f32; 3]| [v[0], v[2], -v[1]];
        let positions: Vec<[f32; 3]> = mesh.positions.iter().map(gltf).collect();
        let normals: Vec<[f32; 3]> = mesh.normals.iter().map(gltf).collect();
        let file = Mesh {
            positions: &positions,
            normals: &normals,
            triangles: &mesh.triangles,
            look: Look::Picture {
                file: &self.png(part),
                media_type: PNG,
                places: &mesh.places,
            },
        };
        Ok(Some(Dressed {
            glb: glb(&file, said)?,
            triangles: mesh.triangles.len(),
            low: low.map(f64::from),
            high: high.map(f64::from),
        }))
    }

    fn triangles(&self, part: &Part) -> Triangles {
        let at = |k: usize| -> Vec<usize> {
            let steps = (part.from[k]..part.to[k]).step_by(part.step);
            steps.chain([part.to[k]]).collect()
        };
        let (cols, rows) = (at(0), at(1));
        let place = |c: usize, r: usize| self.places[rows[r] * self.width + cols[c]];
        let mut faces: Vec<[[usize; 2]; 3]> = Vec::new();
        for r in 1..rows.len() {
            for c in 1..cols.len() {
                let corners = [[c - 1, r - 1], [c - 1, r], [c, r], [c, r - 1]];
                let known = corners.map(|[c, r]| place(c, r).is_finite());
                let height = |i: usize| place(corners[i][0], corners[i][1]).z;
                match known.iter().filter(|known| **known).count() {
                    // Along the diagonal whose ends are nearer in height, so that edges are not notched.
                    4 => {
                        let is_first = (height(0) - height(2)).abs() <= (height(1) - height(3)).abs();
                        let halves = if is_first {
                            [[0, 1, 2], [0, 2, 3]]
                        } else {
                            [[0, 1, 3], [1, 2, 3]]
                        };
                        faces.extend(halves.map(|half| half.map(|i| corners[i])));
                    }
                    3 => {
                        let unknown = known.iter().position(|known| !known).unwrap_or(0);
                        faces.push([1, 2, 3].map(|i| corners[(unknown + i) % 4]));
                    }
                    _ => {}
                }
            }
        }
        let normal = |face: &[[usize; 2]; 3]| {
            let [a, b, c] = face.map(|[c, r]| place(c, r));
            (b - a).cross(c - a).normalize_or(Vec3::Z)
        };
        let mut sums = vec![Vec3::ZERO; cols.len() * rows.len()];
        for face in &faces {
            let normal = normal(face);
            if normal.z >= WALL {
                face.iter().for_each(|[c, r]| sums[r * cols.len() + c] += normal);
            }
        }
        let size = [0, 1].map(|k| (part.to[k] - part.from[k] + 1) as f32);
        let on_picture = |c: usize, r: usize| {
            let aside = [cols[c] - part.from[0], rows[r] - part.from[1]];
            [0, 1].map(|k| (aside[k] as f32 + 0.5) / size[k])
        };
        let mut out = Triangles::default();
        let add = |c: usize, r: usize, normal: Vec3, out: &mut Triangles| {
            out.positions.push(place(c, r).to_array());
            out.normals.push(normal.to_array());
            out.places.push(on_picture(c, r));
            (out.positions.len() - 1) as u32
        };
        let mut shared: Vec<Option<u32>> = vec![None; sums.len()];
        for face in &faces {
            let own = normal(face);
            let triangle = face.map(|[c, r]| {
                if own.z < WALL {
                    return add(c, r, own, &mut out);
                }
                let corner = r * cols.len() + c;
                let new = || add(c, r, sums[corner].normalize_or(Vec3::Z), &mut out);
                *shared[corner].get_or_insert_with(new)
            });
            out.triangles.push(triangle);
        }
        out
    }

    /// Picture of a part as PNG: one pixel for each of its cells, averaged where not every cell is a corner.
    fn png(&self, part: &Part) -> Vec<u8> {
        let [width, height] = [0, 1].map(|k| part.to[k] - part.from[k] + 1);
        let [left, top] = part.from.map(|at| at as u32);
        let mut picture = crop_imm(&self.picture, left, top, width as u32, height as u32).to_image();
        if part.step > 1 {
            let [width, height] = [width, height].map(|n| n.div_ceil(part.step) as u32);
            picture = resize(&picture, width, height, FilterType::Triangle);
        }
        let mut bytes = Cursor::new(Vec::new());
        let written = picture.write_to(&mut bytes, ImageFormat::Png);
        debug_assert!(written.is_ok(), "memory takes all that is written to it");
        bytes.into_inner()
    }
}

/// Display values of an albedo; unknown cells get the mean of the known ones, so that no edge shines through.
fn picture(albedo: &Raster, display: &Display) -> RgbImage {
    let shown = |i: usize| display.bands.map(|band| display.show(albedo.plane(band)[i]));
    let known = |i: &usize| display.bands.iter().all(|&band| albedo.plane(band)[*i].is_finite());
    let mut sums = [0.0f64; 4];
    for i in (0..albedo.plane_len()).filter(known) {
        let colour = shown(i);
        (0..3).for_each(|k| sums[k] += f64::from(colour[k]));
        sums[3] += 1.0;
    }
    let mean = [0, 1, 2].map(|k| (sums[k] / sums[3].max(1.0)) as f32);
    RgbImage::from_fn(albedo.width as u32, albedo.height as u32, |col, row| {
        let i = row as usize * albedo.width + col as usize;
        let colour = if known(&i) { shown(i) } else { mean };
        Rgb(colour.map(|value| (value * 255.0).round() as u8))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Level ground with a block three metres high in the middle, and one cell that is not known.
    fn ground(width: usize, height: usize) -> TexturedGround {
        let place = |i: usize| {
            let (c, r) = (i % width, i / width);
            let block = (2..4).contains(&c) && (2..4).contains(&r);
            let up = if block { 3.0 } else { 0.0 };
            Vec3::new(c as f32, -(r as f32), if i == 0 { f32::NAN } else { up })
        };
        TexturedGround {
            width,
            height,
            places: (0..width * height).map(place).collect(),
            picture: RgbImage::from_pixel(width as u32, height as u32, Rgb([9, 8, 7])),
            cell_m: 1.0,
            white: 1.0,
        }
    }

    #[test]
    fn triangles_face_up_or_aside_and_unknown_cells_are_holes() {
        let mesh = ground(6, 6).triangles(&Part {
            from: [0, 0],
            to: [5, 5],
            step: 1,
        });
        // Two for each of 25 squares but one, which has one.
        assert_eq!(mesh.triangles.len(), 49);
        let at = |i: u32| Vec3::from(mesh.positions[i as usize]);
        for [a, b, c] in &mesh.triangles {
            let normal = (at(*b) - at(*a)).cross(at(*c) - at(*a)).normalize();
            assert!(normal.z > 0.0, "{normal}");
            for corner in [a, b, c] {
                let own = Vec3::from(mesh.normals[*corner as usize]);
                assert!((own.length() - 1.0).abs() < 1e-6);
                assert!(normal.dot(own) > 0.99, "flat ground and walls are flat: {own} {normal}");
            }
        }
        assert!(mesh.places.iter().flatten().all(|&p| p > 0.0 && p < 1.0));
    }

    #[test]
    fn tiles_cover_all_cells_once_and_coarse_ones_hold_fine_ones() {
        let ground = ground(600, 300);
        let (mut names, mut triangles) = (Vec::new(), 0);
        let mut write = |name: &str, _: Vec<u8>| {
            names.push(name.to_owned());
            Ok(())
        };
        let tile = ground
            .tiles(&mut write, &mut triangles)
            .expect("written")
            .expect("a surface");
        assert_eq!(triangles, 2 * 599 * 299 - 1);
        assert_eq!((tile.depth(), tile.count()), (3, names.len()));
        assert_eq!(tile.count(), 1 + 2 + 6);
        fn check(tile: &Tile) {
            for child in &tile.children {
                assert!(child.error_m < tile.error_m);
                assert!((0..3).all(|k| child.low[k] >= tile.low[k] && child.high[k] <= tile.high[k]));
                check(child);
            }
        }
        check(&tile);
    }
}
