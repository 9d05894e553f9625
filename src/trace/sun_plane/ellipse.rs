//! A Gaussian projected along parallel light: an ellipse in the plane normal to the light, its peaks on a plane in
//! depth; and the way back from moments of an ellipse to the gradient of its Gaussian.

use crate::trace::bvh::Occluder;
use glam::{Mat3, Vec2, Vec3};

/// Ellipses, or rays, that are worked on together.
pub(super) const LANES: usize = 8;

pub(super) type Lane = [f32; LANES];

/// The plane's axes in the scene.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axes {
    pub(super) right: Vec3,
    pub(super) up: Vec3,
    /// Unit vector toward the light.
    pub(super) light: Vec3,
}

impl Axes {
    /// Duff et al. 2017: no direction is special.
    pub(super) fn new(light: Vec3) -> Self {
        let (right, up) = light.any_orthonormal_pair();
        Self { right, up, light }
    }

    /// Position of a point of the scene on the plane.
    #[inline(always)]
    pub(super) fn place(&self, position: Vec3) -> Vec2 {
        Vec2::new(self.right.dot(position), self.up.dot(position))
    }

    /// A vector of the plane in the scene.
    #[inline(always)]
    pub(super) fn in_scene(&self, v: Vec2) -> Vec3 {
        self.right * v.x + self.up * v.y
    }
}

/// One Gaussian on the plane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ellipse {
    pub(super) centre: Vec2,
    /// Whitening of the plane: `t = (w₀ x, w₁ x + w₂ y)` of an offset from the centre, in standard deviations. `‖t‖²`
    /// is never negative and does not cancel for long ellipses, as their inverse covariance would.
    pub(super) whiten: [f32; 3],
    /// Squared distance beyond which it ends, standard deviations.
    pub(super) reach_square: f32,
    /// Depth of the peak toward the light at the centre, metres, and its change over the plane.
    pub(super) depth: f32,
    pub(super) slope: Vec2,
    pub(super) opacity: f32,
    pub(super) id: u32,
    /// Half sizes of its box, metres.
    pub(super) half_size: Vec2,
}

impl Ellipse {
    /// An ellipse that occludes nothing.
    const EMPTY: Self = Self {
        centre: Vec2::ZERO,
        whiten: [0.0; 3],
        reach_square: 0.0,
        depth: 0.0,
        slope: Vec2::ZERO,
        opacity: 0.0,
        id: u32::MAX,
        half_size: Vec2::ZERO,
    };

    /// The ellipse of Gaussian `id`; one that does not exist if it occludes nothing or is seen as less than an area.
    pub(super) fn new(occluder: &Occluder, id: usize, axes: &Axes) -> Self {
        if occluder.reach_square <= 0.0 {
            return Self::EMPTY;
        }
        let whitened = |axis: Vec3| occluder.scaled_axes.transpose() * axis;
        let (a, b, c) = (whitened(axes.right), whitened(axes.up), whitened(axes.light));
        let (xx, xy, yy) = (a.dot(a), a.dot(b), b.dot(b));
        // The determinant as the squared area of the two whitened axes: never negative, no cancellation for a thin
        // disc.
        let det = a.cross(b).length_squared();
        // Roots before products: `det · xx` leaves the range of numbers twelve decades of sizes apart.
        let (along, area) = (xx.sqrt(), det.sqrt());
        let whiten = [1.0 / along, -xy / (along * area), along / area];
        let (cx, cy) = (c.dot(a), c.dot(b));
        let half_size = Vec2::new((xx * occluder.reach_square).sqrt(), (yy * occluder.reach_square).sqrt());
        let shape = Self {
            centre: axes.place(occluder.position),
            whiten,
            reach_square: occluder.reach_square,
            depth: axes.light.dot(occluder.position),
            slope: Vec2::new((yy * cx - xy * cy) / det, (xx * cy - xy * cx) / det),
            opacity: occluder.opacity,
            id: id as u32,
            half_size,
        };
        let finite = whiten.iter().all(|w| w.is_finite()) && shape.centre.is_finite() && half_size.is_finite();
        if det > 0.0 && det.is_finite() && finite {
            shape
        } else {
            Self::EMPTY
        }
    }

    /// True if the ellipse occludes anything.
    #[inline(always)]
    pub(super) fn exists(&self) -> bool {
        self.reach_square > 0.0
    }

    /// `Pᵀ Aᵀ t`: gradient of half a squared distance to the place of the ray, in the scene, where
    /// `t = A (place - centre)`.
    #[inline(always)]
    pub(super) fn in_scene(&self, axes: &Axes, t: Vec2) -> Vec3 {
        axes.in_scene(transposed_whitening(self.whiten, t.x, t.y).into())
    }
}

/// Offset from the centre in standard deviations.
#[inline(always)]
pub(super) fn whitened(w: [f32; 3], dx: f32, dy: f32) -> [f32; 2] {
    [w[0] * dx, w[1] * dx + w[2] * dy]
}

/// The transposed whitening applied to `t`: a gradient to `t` becomes one in the plane.
#[inline(always)]
pub(super) fn transposed_whitening(w: [f32; 3], tx: f32, ty: f32) -> [f32; 2] {
    [w[0] * tx + w[1] * ty, w[2] * ty]
}

/// Eight ellipses, number by number.
#[derive(Debug, Clone, Copy)]
pub(super) struct EllipseBlock {
    pub(super) x: Lane,
    pub(super) y: Lane,
    pub(super) whiten: [Lane; 3],
    pub(super) reach_square: Lane,
    pub(super) depth: Lane,
    pub(super) slope: [Lane; 2],
    pub(super) opacity: Lane,
    pub(super) id: [u32; LANES],
}

impl EllipseBlock {
    /// Up to eight ellipses; missing ones are hit by no ray.
    pub(super) fn new(ellipses: &[Ellipse]) -> Self {
        let of = |number: fn(&Ellipse) -> f32| std::array::from_fn(|l| ellipses.get(l).map_or(0.0, number));
        Self {
            x: of(|e| e.centre.x),
            y: of(|e| e.centre.y),
            whiten: [of(|e| e.whiten[0]), of(|e| e.whiten[1]), of(|e| e.whiten[2])],
            reach_square: of(|e| e.reach_square),
            depth: of(|e| e.depth),
            slope: [of(|e| e.slope.x), of(|e| e.slope.y)],
            opacity: of(|e| e.opacity),
            id: std::array::from_fn(|l| ellipses.get(l).map_or(u32::MAX, |e| e.id)),
        }
    }
}

/// Contributions of the rays that hit an ellipse to its gradient: sums over rays with `h = ∂L/∂(-½‖t‖²)`.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct EllipseMoments {
    /// `Σh`.
    pub(super) h: f32,
    /// `Σ h t`.
    pub(super) t: [f32; 2],
    /// `Σ h t tᵀ`: xx, xy, yy.
    pub(super) tt: [f32; 3],
}

/// Gradients to a Gaussian's centre, axes and size.
pub(super) struct ShapeGradient {
    pub(super) position: Vec3,
    pub(super) log_scale: Vec3,
    /// To the rotation matrix, column by column.
    pub(super) rotation: Mat3,
}

impl EllipseMoments {
    /// Gradient of the Gaussian's shape, back through the projection. With `B = (A P L)ᵀ`, whose columns are
    /// orthonormal, the nearest point of a ray in the Gaussian's whitened space is `n = B t`; `∂/∂ ln s_k = Σ h n_k²`
    /// and `∂/∂R e_k = Σ h (Pᵀ Aᵀ t) n_k s_k`.
    pub(super) fn shape_gradient(&self, ellipse: &Ellipse, axes: &Axes, occluder: &Occluder) -> ShapeGradient {
        let columns = [ellipse.in_scene(axes, Vec2::X), ellipse.in_scene(axes, Vec2::Y)];
        let n = columns.map(|v| occluder.scaled_axes.transpose() * v);
        let [xx, xy, yy] = self.tt;
        let mixed = [n[0] * xx + n[1] * xy, n[0] * xy + n[1] * yy];
        let column = |k: usize| (columns[0] * mixed[0][k] + columns[1] * mixed[1][k]) * occluder.scale[k];
        ShapeGradient {
            position: columns[0] * self.t[0] + columns[1] * self.t[1],
            log_scale: n[0] * mixed[0] + n[1] * mixed[1],
            rotation: Mat3::from_cols(column(0), column(1), column(2)),
        }
    }
}
