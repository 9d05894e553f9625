//! A plain ray tracer in f64: a height field, triangles and ellipsoids in a grid of square columns.
//!
//! The scene is 2.5-D (a city seen from above), so one grid cell is a column with a list of primitives and the altitude
//! of its highest point; a ray walks the columns it crosses (Amanatides and Woo, "A fast voxel traversal algorithm for
//! ray tracing", Eurographics 1987) and looks into a column only when it dips below that altitude. It shares no code
//! with the engine and approximates nothing; it also makes the truth rasters.

use crate::ray::Ray;
use crate::terrain::HeightField;
use nalgebra::Vector3;

/// Index into the scene's table of surfaces. The terrain is [`GROUND`].
pub(crate) type SurfaceId = u32;

/// The surface of every hit on the height field.
pub(crate) const GROUND: SurfaceId = u32::MAX;

/// Hits nearer than this along a ray are the surface the ray starts on, metres.
const SELF_HIT_M: f64 = 1e-6;

/// End of a ray. The normal is a unit vector on the side the ray came from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hit {
    /// Place of the hit, metres of the scene's frame.
    pub(crate) point: Vector3<f64>,
    /// Unit normal.
    pub(crate) normal: Vector3<f64>,
    /// Surface of the hit.
    pub(crate) surface: SurfaceId,
}

/// A flat triangle: a corner and its two edges.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Triangle {
    corner: Vector3<f64>,
    edge_1: Vector3<f64>,
    edge_2: Vector3<f64>,
    surface: SurfaceId,
}

/// An ellipsoid with its axes along east, north and up.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ellipsoid {
    /// Centre, metres of the scene's frame.
    pub(crate) centre: Vector3<f64>,
    /// Half axes along east, north and up, metres.
    pub(crate) radii: Vector3<f64>,
    /// Surface of the ellipsoid.
    pub(crate) surface: SurfaceId,
}

impl Triangle {
    /// Triangle of three corners, metres of the scene's frame.
    pub(crate) fn new(corners: [Vector3<f64>; 3], surface: SurfaceId) -> Self {
        Self {
            corner: corners[0],
            edge_1: corners[1] - corners[0],
            edge_2: corners[2] - corners[0],
            surface,
        }
    }

    /// Distance along the ray (Möller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997).
    fn intersect(&self, ray: &Ray) -> Option<f64> {
        // Neighbouring triangles share edges: a hair of overlap keeps rays from slipping between them.
        const OVERLAP: f64 = 1e-9;
        let p = ray.direction.cross(&self.edge_2);
        let determinant = self.edge_1.dot(&p);
        if determinant.abs() < 1e-14 {
            return None;
        }
        let inverse = 1.0 / determinant;
        let s = ray.origin - self.corner;
        let u = s.dot(&p) * inverse;
        if !(-OVERLAP..=1.0 + OVERLAP).contains(&u) {
            return None;
        }
        let q = s.cross(&self.edge_1);
        let v = ray.direction.dot(&q) * inverse;
        if v < -OVERLAP || u + v > 1.0 + OVERLAP {
            return None;
        }
        Some(self.edge_2.dot(&q) * inverse)
    }

    fn bounds(&self) -> (Vector3<f64>, Vector3<f64>) {
        let (b, c) = (self.corner + self.edge_1, self.corner + self.edge_2);
        (self.corner.inf(&b).inf(&c), self.corner.sup(&b).sup(&c))
    }
}

impl Ellipsoid {
    /// Distance along the ray to the first crossing beyond the start.
    fn intersect(&self, ray: &Ray) -> Option<f64> {
        let o = (ray.origin - self.centre).component_div(&self.radii);
        let d = ray.direction.component_div(&self.radii);
        let (a, b) = (d.norm_squared(), o.dot(&d));
        // Distance of closest approach from the centre, squared: free of the cancellation of b² - ac.
        let closest = (o - d * (b / a)).norm_squared();
        if closest > 1.0 {
            return None;
        }
        let half = ((1.0 - closest) / a).sqrt();
        let middle = -b / a;
        let near = middle - half;
        let t = if near > SELF_HIT_M { near } else { middle + half };
        (t > SELF_HIT_M).then_some(t)
    }

    fn normal_at(&self, point: Vector3<f64>) -> Vector3<f64> {
        let squared = self.radii.component_mul(&self.radii);
        (point - self.centre).component_div(&squared).normalize()
    }

    fn bounds(&self) -> (Vector3<f64>, Vector3<f64>) {
        (self.centre - self.radii, self.centre + self.radii)
    }
}

/// Primitives of the scene before they are sorted into columns.
#[derive(Debug, Clone, Default)]
pub(crate) struct Primitives {
    /// Flat triangles.
    pub(crate) triangles: Vec<Triangle>,
    /// Ellipsoids.
    pub(crate) ellipsoids: Vec<Ellipsoid>,
}

/// Ray tracer of a scene.
pub(crate) struct Tracer<'a> {
    terrain: &'a HeightField,
    primitives: Primitives,
    /// `starts[cell]..starts[cell + 1]` are the places in `members` of a cell.
    starts: Vec<u32>,
    /// Triangles by index, ellipsoids by index past the last triangle.
    members: Vec<u32>,
    /// Highest point in each column, metres.
    tops_m: Vec<f64>,
    /// Altitude below everything in the scene, metres of the tracer's frame.
    pub(crate) bottom_m: f64,
    /// Altitude above everything in the scene, metres of the tracer's frame.
    pub(crate) top_m: f64,
}

/// Nearest primitive so far.
#[derive(Clone, Copy)]
enum Found {
    Terrain,
    Primitive(u32),
}

impl<'a> Tracer<'a> {
    /// Sorts `primitives` into the columns of the terrain's own cells. Parts beyond the terrain are cut off.
    pub(crate) fn new(terrain: &'a HeightField, primitives: Primitives) -> Self {
        let cells = terrain.cells * terrain.cells;
        let mut tops_m: Vec<f64> = (0..cells).map(|cell| terrain.cell_top_m(cell)).collect();
        let bounds: Vec<_> = (primitives.triangles.iter().map(Triangle::bounds))
            .chain(primitives.ellipsoids.iter().map(Ellipsoid::bounds))
            .collect();
        let mut starts = vec![0u32; cells + 1];
        for (low, high) in &bounds {
            terrain.for_cells_within(low, high, |cell| {
                starts[cell + 1] += 1;
                tops_m[cell] = tops_m[cell].max(high.z);
            });
        }
        for cell in 0..cells {
            starts[cell + 1] += starts[cell];
        }
        let mut next = starts.clone();
        let mut members = vec![0u32; starts[cells] as usize];
        for (index, (low, high)) in bounds.iter().enumerate() {
            terrain.for_cells_within(low, high, |cell| {
                members[next[cell] as usize] = index as u32;
                next[cell] += 1;
            });
        }
        let bottom_m = terrain.bottom_m() - 1.0;
        let top_m = tops_m.iter().copied().fold(bottom_m, f64::max) + 1.0;
        Self {
            terrain,
            primitives,
            starts,
            members,
            tops_m,
            bottom_m,
            top_m,
        }
    }

    /// Nearest hit along a ray; `None` if the ray leaves the scene.
    pub(crate) fn trace(&self, ray: &Ray) -> Option<Hit> {
        let mut best: Option<(f64, Found)> = None;
        self.walk(ray, f64::INFINITY, |cell, t_in, t_out| {
            if let Some(t) = self.terrain.intersect_cell(cell, ray, t_in, t_out)
                && t > SELF_HIT_M
                && best.is_none_or(|(t_best, _)| t < t_best)
            {
                best = Some((t, Found::Terrain));
            }
            for &member in self.members_of(cell) {
                if let Some(t) = self.intersect(member, ray)
                    && best.is_none_or(|(t_best, _)| t < t_best)
                {
                    best = Some((t, Found::Primitive(member)));
                }
            }
            // A hit beyond this column may be hidden by something in the next.
            best.is_some_and(|(t, _)| t <= t_out)
        });
        best.map(|(t, found)| self.hit(ray, t, found))
    }

    /// True if a surface lies on the ray within `reach_m`, metres.
    pub(crate) fn occluded(&self, ray: &Ray, reach_m: f64) -> bool {
        let mut blocked = false;
        self.walk(ray, reach_m, |cell, t_in, t_out| {
            let within = |t: &f64| *t > SELF_HIT_M && *t < reach_m;
            let ground = self.terrain.intersect_cell(cell, ray, t_in, t_out);
            blocked = ground.filter(within).is_some()
                || (self.members_of(cell).iter()).any(|&member| self.intersect(member, ray).filter(within).is_some());
            blocked
        });
        blocked
    }

    fn members_of(&self, cell: usize) -> &[u32] {
        &self.members[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    fn intersect(&self, member: u32, ray: &Ray) -> Option<f64> {
        let index = member as usize;
        let t = match self.primitives.triangles.get(index) {
            Some(triangle) => triangle.intersect(ray),
            None => self.primitives.ellipsoids[index - self.primitives.triangles.len()].intersect(ray),
        };
        t.filter(|t| *t > SELF_HIT_M)
    }

    fn hit(&self, ray: &Ray, t: f64, found: Found) -> Hit {
        let point = ray.at(t);
        let (normal, surface) = match found {
            Found::Terrain => (self.terrain.normal_at(point.x, point.y), GROUND),
            Found::Primitive(member) => match self.primitives.triangles.get(member as usize) {
                Some(triangle) => (triangle.edge_1.cross(&triangle.edge_2).normalize(), triangle.surface),
                None => {
                    let ellipsoid = &self.primitives.ellipsoids[member as usize - self.primitives.triangles.len()];
                    (ellipsoid.normal_at(point), ellipsoid.surface)
                }
            },
        };
        let from_behind = normal.dot(&ray.direction) > 0.0;
        Hit {
            point,
            normal: if from_behind { -normal } else { normal },
            surface,
        }
    }

    /// Visits the columns the ray dips into, in order, until `visit(cell, t_in, t_out)` returns true.
    fn walk(&self, ray: &Ray, reach_m: f64, mut visit: impl FnMut(usize, f64, f64) -> bool) {
        let Some((mut t, t_end)) = self.clip(ray, reach_m) else {
            return;
        };
        let n = self.terrain.cells as i64;
        let mut axes = [0, 1].map(|axis| Axis::new(self.terrain, ray, axis, t));
        while t < t_end {
            let t_out = axes[0].t_next.min(axes[1].t_next).min(t_end);
            let cell = (axes[1].cell * n + axes[0].cell) as usize;
            let lowest = (ray.origin.z + ray.direction.z * t).min(ray.origin.z + ray.direction.z * t_out);
            if lowest <= self.tops_m[cell] && visit(cell, t, t_out) {
                return;
            }
            t = t_out;
            let axis = &mut axes[usize::from(axes[1].t_next < axes[0].t_next)];
            axis.cell += axis.step;
            axis.t_next += axis.t_step;
            if axis.cell < 0 || axis.cell >= n {
                return;
            }
        }
    }

    /// The stretch of the ray inside the scene's box.
    fn clip(&self, ray: &Ray, reach_m: f64) -> Option<(f64, f64)> {
        let half = self.terrain.half_extent_m;
        let low = Vector3::new(-half, -half, self.bottom_m);
        let high = Vector3::new(half, half, self.top_m);
        let (mut t_in, mut t_out) = (0.0f64, reach_m);
        for axis in 0..3 {
            let inverse = 1.0 / ray.direction[axis];
            let a = (low[axis] - ray.origin[axis]) * inverse;
            let b = (high[axis] - ray.origin[axis]) * inverse;
            // A ray along the wall of the box divides 0 by 0; `max` and `min` then keep the other bound.
            t_in = t_in.max(a.min(b));
            t_out = t_out.min(a.max(b));
        }
        (t_in < t_out).then_some((t_in, t_out))
    }
}

/// One axis of the walk through the columns.
struct Axis {
    cell: i64,
    step: i64,
    t_next: f64,
    t_step: f64,
}

impl Axis {
    fn new(terrain: &HeightField, ray: &Ray, axis: usize, t: f64) -> Self {
        let size = terrain.cell_m;
        let direction = ray.direction[axis];
        let position = (ray.origin[axis] + direction * t + terrain.half_extent_m) / size;
        let cell = (position.floor() as i64).clamp(0, terrain.cells as i64 - 1);
        let step = if direction > 0.0 { 1 } else { -1 };
        let wall = (cell + i64::from(direction > 0.0)) as f64 * size - terrain.half_extent_m;
        let crossing = ((wall - ray.origin[axis]) / direction).max(t);
        Self {
            cell,
            step,
            // A ray along the walls crosses none.
            t_next: if direction == 0.0 { f64::INFINITY } else { crossing },
            t_step: size / direction.abs(),
        }
    }
}
