//! A triangle mesh of a model: the depths of its cameras, fused into a grid of truncated signed distances (Curless and
//! Levoy 1996); surface nets extract its zero surface.
//!
//! Space that no camera sees counts as inside, so that the mesh is closed: an object seen from above gets a flat
//! bottom.

mod file;

pub use file::{Format, encode};

use super::measure;
use super::model::ObjectModel;
use fast_surface_nets::ndshape::{RuntimeShape, Shape};
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use glam::Vec3;
use heliosplat::ProjectiveCamera;
use heliosplat::gaussians::{POSITION, Table};
use heliosplat::shade::display;
use rayon::prelude::*;

/// Distances are cut at this many cells.
const TRUNCATION_CELLS: f32 = 3.0;
/// Free cells around the meshed volume, so that the mesh is closed.
const MARGIN_CELLS: usize = 3;
/// Gaussians fainter than this are no surface.
const OPACITY_KNOWN: f32 = 0.5;
/// Pieces with fewer triangles than this share of the largest one's are left out.
const CRUMB: f64 = 0.01;
/// Share of the Gaussians that may lie outside on either side of an axis.
const OUTLIERS: f64 = 0.002;

/// A closed surface in the frame of the cameras.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mesh {
    /// Positions of the vertices, in the capture's units.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals of the vertices, outward.
    pub normals: Vec<[f32; 3]>,
    /// Display colours of the vertices (sRGB): red, green and blue.
    pub colours: Vec<[u8; 3]>,
    /// Vertices of the triangles, anticlockwise as seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// Meshes a model in a grid whose longest side has `cells` cells. Colours are means over the images, each in its own
/// light. `progress` gets the number of renderings done, two for each image.
///
/// # Errors
/// A sentence with the fault: the model has no opaque Gaussian, or its cameras see no surface.
pub fn mesh(model: &ObjectModel, cells: usize, progress: &dyn Fn(u64)) -> Result<Mesh, String> {
    let mut grid = Grid::around(&model.parameters.gaussians, cells).ok_or("it has no Gaussian that is opaque")?;
    for (done, image) in model.file.images.iter().enumerate() {
        if let Some((camera, maps, _)) = model.seen(image) {
            grid.add(&camera, &depths(&maps.median_depth, &maps.alpha));
        }
        progress(done as u64 + 1);
    }
    let mut mesh = grid.surface().without_crumbs();
    if mesh.triangles.is_empty() {
        return Err("its cameras see no surface".into());
    }
    paint(model, &grid, &mut mesh, progress);
    let centre = model.file.centre;
    for place in &mut mesh.positions {
        *place = (Vec3::from(*place).as_dvec3() + centre).as_vec3().to_array();
    }
    Ok(mesh)
}

impl Mesh {
    /// The mesh without pieces that are much smaller than the largest one: remains of noise between surfaces.
    fn without_crumbs(self) -> Self {
        let piece = self.pieces();
        let mut sizes = vec![0usize; self.positions.len()];
        for triangle in &self.triangles {
            sizes[piece[triangle[0] as usize]] += 1;
        }
        let largest = sizes.iter().copied().max().unwrap_or(0);
        let kept = |corner: usize| sizes[piece[corner]] as f64 >= CRUMB * largest as f64;
        let mut out = Self::default();
        let mut number = vec![u32::MAX; self.positions.len()];
        for corner in (0..self.positions.len()).filter(|&corner| kept(corner)) {
            number[corner] = out.positions.len() as u32;
            out.positions.push(self.positions[corner]);
            out.normals.push(self.normals[corner]);
            out.colours.push(self.colours[corner]);
        }
        let triangles = self.triangles.iter().filter(|t| kept(t[0] as usize));
        out.triangles = triangles.map(|t| t.map(|corner| number[corner as usize])).collect();
        out
    }

    /// For each corner, the representative of its connected component.
    fn pieces(&self) -> Vec<usize> {
        fn root(parent: &mut [usize], mut corner: usize) -> usize {
            while parent[corner] != corner {
                parent[corner] = parent[parent[corner]];
                corner = parent[corner];
            }
            corner
        }
        let mut parent: Vec<usize> = (0..self.positions.len()).collect();
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|corner| root(&mut parent, corner as usize));
            let least = a.min(b).min(c);
            (parent[a], parent[b], parent[c]) = (least, least, least);
        }
        (0..parent.len()).map(|corner| root(&mut parent, corner)).collect()
    }
}

/// Depths of a view; infinite where more is open than covered.
fn depths(surface: &[f32], alpha: &[f32]) -> Vec<f32> {
    let depth = |(&depth, &alpha): (&f32, &f32)| {
        if alpha > 0.5 && depth.is_finite() {
            depth
        } else {
            f32::INFINITY
        }
    };
    surface.iter().zip(alpha).map(depth).collect()
}

/// Gives corners the colours that the cameras see there.
fn paint(model: &ObjectModel, grid: &Grid, mesh: &mut Mesh, progress: &dyn Fn(u64)) {
    let mut sums = vec![[0.0f32; 4]; mesh.positions.len()];
    let images = &model.file.images;
    for (done, image) in images.iter().enumerate() {
        if let Some((camera, maps, seen)) = model.seen(image) {
            let depths = depths(&maps.median_depth, &maps.alpha);
            sums.par_iter_mut().zip(&mesh.positions).for_each(|(sum, &place)| {
                let place = Vec3::from(place);
                let Some(pixel) = pixel(&camera, place) else { return };
                if (depths[pixel] - camera.depth(place)).abs() < TRUNCATION_CELLS * grid.cell {
                    for (k, sum) in sum[..3].iter_mut().enumerate() {
                        *sum += seen.plane(k)[pixel];
                    }
                    sum[3] += 1.0;
                }
            });
        }
        progress((images.len() + done) as u64 + 1);
    }
    let linear = measure::is_linear(model);
    mesh.colours = sums
        .iter()
        .map(|&[red, green, blue, count]| {
            [red, green, blue].map(|sum| {
                let mean = (sum / count.max(1.0)).max(0.0);
                let shown = if linear { display::encode(mean).0 } else { mean };
                (shown.min(1.0) * 255.0).round() as u8
            })
        })
        .collect();
}

/// The pixel that shows a place; `None` outside of the image and behind the camera.
fn pixel(camera: &ProjectiveCamera, place: Vec3) -> Option<usize> {
    let (pixel, before) = camera.pixel(place)?;
    (before > 0.0).then_some(pixel)
}

/// Truncated signed distances to the surface, positive outside, in cells of a box.
struct Grid {
    /// Place of the first corner.
    origin: Vec3,
    /// Width of a cell, in units of the capture.
    cell: f32,
    size: [usize; 3],
    /// Sums over views of their signed distances, -1 to 1, and the number of views that contributed.
    sums: Vec<[f32; 2]>,
}

impl Grid {
    /// A grid around the opaque Gaussians; `None` where there are none.
    fn around(gaussians: &Table, cells: usize) -> Option<Self> {
        let opaque: Vec<usize> = (0..gaussians.count)
            .filter(|&i| gaussians.opacity(i) >= OPACITY_KNOWN)
            .collect();
        let side = |axis: usize| -> Option<(f32, f32)> {
            let mut places: Vec<f32> = opaque.iter().map(|i| gaussians.group(POSITION)[3 * i + axis]).collect();
            places.sort_by(f32::total_cmp);
            let outside = (OUTLIERS * places.len() as f64) as usize;
            Some((*places.get(outside)?, places[places.len() - 1 - outside]))
        };
        let sides = [side(0)?, side(1)?, side(2)?];
        let low = Vec3::from(sides.map(|s| s.0));
        let extent = Vec3::from(sides.map(|s| s.1)) - low;
        let longest = extent.max_element();
        if !(longest > 0.0 && longest.is_finite()) {
            return None;
        }
        Some(Self::new(low, extent, longest / cells as f32))
    }

    /// A grid around a box.
    fn new(low: Vec3, extent: Vec3, cell: f32) -> Self {
        let size = extent
            .to_array()
            .map(|side| (side / cell).ceil() as usize + 1 + 2 * MARGIN_CELLS);
        Self {
            origin: low - Vec3::splat(MARGIN_CELLS as f32 * cell),
            cell,
            size,
            sums: vec![[0.0; 2]; size.iter().product()],
        }
    }

    /// Adds a depth map: depths along the camera's axis, infinite where there is no surface.
    fn add(&mut self, camera: &ProjectiveCamera, depths: &[f32]) {
        let truncation = TRUNCATION_CELLS * self.cell;
        let (origin, cell, [width, height, _]) = (self.origin, self.cell, self.size);
        let layers = self.sums.par_chunks_mut(width * height).enumerate();
        layers.for_each(|(z, layer)| {
            for (i, sum) in layer.iter_mut().enumerate() {
                let place = origin + cell * Vec3::new((i % width) as f32, (i / width) as f32, z as f32);
                let Some(pixel) = pixel(camera, place) else { continue };
                let before = (depths[pixel] - camera.depth(place)) / truncation;
                if before > -1.0 {
                    sum[0] += before.min(1.0);
                    sum[1] += 1.0;
                }
            }
        });
    }

    /// The surface at which the mean distance is zero.
    fn surface(&self) -> Mesh {
        let shape = RuntimeShape::<u32, 3>::new(self.size.map(|side| side as u32));
        let mut distances: Vec<f32> = self
            .sums
            .iter()
            .map(|&[sum, count]| if count > 0.0 { sum / count } else { -1.0 })
            .collect();
        let last = self.size.map(|side| side as u32 - 1);
        for (i, distance) in distances.iter_mut().enumerate() {
            let at = shape.delinearize(i as u32);
            if (0..3).any(|axis| at[axis] == 0 || at[axis] == last[axis]) {
                *distance = 1.0;
            }
        }
        let mut found = SurfaceNetsBuffer::default();
        surface_nets(&distances, &shape, [0; 3], last, &mut found);
        let place = |p: &[f32; 3]| (self.origin + self.cell * Vec3::from(*p)).to_array();
        Mesh {
            positions: found.positions.iter().map(place).collect(),
            normals: found
                .normals
                .iter()
                .map(|n| Vec3::from(*n).normalize_or(Vec3::Z).to_array())
                .collect(),
            colours: vec![[0; 3]; found.positions.len()],
            triangles: found.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use std::collections::BTreeMap;

    const RADIUS: f32 = 0.8;

    /// A camera of parallel rays along `axis`, and the depths of a ball that it sees.
    fn ball_from(axis: DVec3) -> (ProjectiveCamera, Vec<f32>) {
        const SIZE: usize = 101;
        let (u, per_unit) = (axis.any_orthonormal_vector(), 40.0);
        let v = axis.cross(u);
        let middle = (SIZE as f64 - 1.0) / 2.0;
        let row = |a: DVec3| [a.x * per_unit, a.y * per_unit, a.z * per_unit, middle];
        let camera = ProjectiveCamera::new(row(u), row(v), [0.0; 3], (SIZE, SIZE), axis);
        let depth = |i: usize| {
            let (x, y) = ((i % SIZE) as f32 - middle as f32, (i / SIZE) as f32 - middle as f32);
            let left = RADIUS * RADIUS - (x * x + y * y) / (per_unit * per_unit) as f32;
            if left > 0.0 { -left.sqrt() } else { f32::INFINITY }
        };
        (camera, (0..SIZE * SIZE).map(depth).collect())
    }

    fn ball() -> (Mesh, f32) {
        let mut grid = Grid::new(Vec3::splat(-RADIUS), Vec3::splat(2.0 * RADIUS), 0.04);
        for i in 0..24 {
            let z = 1.0 - f64::from(2 * i + 1) / 24.0;
            let (azimuth, sine) = (2.4 * f64::from(i), (1.0 - z * z).sqrt());
            let (camera, depths) = ball_from(DVec3::new(sine * azimuth.cos(), sine * azimuth.sin(), z));
            grid.add(&camera, &depths);
        }
        (grid.surface(), grid.cell)
    }

    #[test]
    fn a_ball_is_a_ball_again_with_its_outside_out() {
        let (mesh, cell) = ball();
        assert!(mesh.triangles.len() > 5000, "{} triangles", mesh.triangles.len());
        let mut volume = 0.0;
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| Vec3::from(mesh.positions[i as usize]));
            volume += a.dot(b.cross(c)) / 6.0;
        }
        let truth = 4.0 / 3.0 * std::f32::consts::PI * RADIUS.powi(3);
        assert!(
            (volume / truth - 1.0).abs() < 0.03,
            "volume {volume}, of a ball {truth}"
        );
        let mut along = 0.0;
        for (place, normal) in mesh.positions.iter().zip(&mesh.normals) {
            let (place, normal) = (Vec3::from(*place), Vec3::from(*normal));
            assert!((place.length() - RADIUS).abs() < cell, "a corner at {}", place.length());
            let cosine = normal.dot(place.normalize());
            assert!(cosine > 0.8, "a normal of {normal} at {place}");
            along += cosine / mesh.positions.len() as f32;
        }
        assert!(along > 0.98, "normals along {along}");
    }

    #[test]
    fn crumbs_are_left_out_and_pieces_of_some_size_stay() {
        let (ball, _) = ball();
        let mut all = ball.clone();
        let mut add = |triangles: &[[u32; 3]], shift: f32| {
            let first = all.positions.len() as u32;
            all.positions
                .extend(ball.positions.iter().map(|p| [p[0] + shift, p[1], p[2]]));
            all.normals.extend(&ball.normals);
            all.colours.extend(&ball.colours);
            all.triangles
                .extend(triangles.iter().map(|t| t.map(|corner| corner + first)));
        };
        add(&ball.triangles, 3.0);
        add(&ball.triangles[..1], 6.0);
        let kept = all.without_crumbs();
        assert_eq!(kept.triangles.len(), 2 * ball.triangles.len());
        assert_eq!(kept.positions.len(), 2 * ball.positions.len());
        assert_eq!(kept.triangles[..ball.triangles.len()], ball.triangles[..]);
    }

    #[test]
    fn every_edge_has_two_triangles_that_run_along_it_in_opposite_ways() {
        let (mesh, _) = ball();
        let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
        for &[a, b, c] in &mesh.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *edges.entry((from, to)).or_default() += 1;
            }
        }
        for (&(from, to), &count) in &edges {
            assert_eq!(edges.get(&(to, from)), Some(&count), "edge {from} to {to}");
        }
    }
}
