//! A Gaussian projected along parallel light: an ellipse in the plane normal to the light, its peaks on a plane in
//! depth; and the way back from moments of an ellipse to the gradient of its Gaussian.

use crate::trace::bvh::Occluder;
use glam::{Mat3, Vec2, Vec3};

/// Number of ellipses, or rays, that are processed together.
pub(super) const LANES: usize = 8;

/// One number for each of eight ellipses or rays.
pub(super) type Lane = [f32; LANES];

/// Unit axes of the plane and its normal, in the scene.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axes {
    /// First axis of the plane.
    pub(super) right: Vec3,
    /// Second axis of the plane.
    pub(super) up: Vec3,
    /// Unit vector toward the light.
    pub(super) light: Vec3,
}

impl Axes {
    /// The plane normal to the unit vector `light` toward the light. Its axes are those of Duff et al. 2017, for whom
    /// no direction is special.
    pub(super) fn new(light: Vec3) -> Self {
        let (right, up) = light.any_orthonormal_pair();
        Self { right, up, light }
    }

    /// Position of a point of the scene on the plane.
    #[inline(always)]
    pub(super) fn place(&self, position: Vec3) -> Vec2 {
        Vec2::new(self.right.dot(position), self.up.dot(position))
    }

    /// The vector of the scene for a vector of the plane.
    #[inline(always)]
    pub(super) fn in_scene(&self, v: Vec2) -> Vec3 {
        self.right * v.x + self.up * v.y
    }
}

/// One Gaussian on the plane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ellipse {
    /// Centre on the plane, metres.
    pub(super) centre: Vec2,
    /// Whitening of the plane: `t = (w₀ x, w₁ x + w₂ y)` of an offset from the centre, in standard deviations. `‖t‖²`
    /// is never negative and does not cancel for long ellipses, as their inverse covariance would.
    pub(super) whiten: [f32; 3],
    /// Squared distance beyond which the ellipse ends, in standard deviations.
    pub(super) reach_square: f32,
    /// Depth of the peak at the centre, metres toward the light.
    pub(super) depth: f32,
    /// Change of the peak's depth over the plane, metres per metre.
    pub(super) slope: Vec2,
    /// Opacity, 0 to 1.
    pub(super) opacity: f32,
    /// Index of the Gaussian.
    pub(super) id: u32,
    /// Half sizes of the ellipse's bounding box, metres.
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

    /// The ellipse of Gaussian `id`; an empty one if the Gaussian occludes nothing or its projection has no area.
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

/// Offset (`dx`, `dy`) from the centre, metres, whitened by `w` to standard deviations.
#[inline(always)]
pub(super) fn whitened(w: [f32; 3], dx: f32, dy: f32) -> [f32; 2] {
    [w[0] * dx, w[1] * dx + w[2] * dy]
}

/// The transposed whitening applied to `t`: a gradient to `t` becomes one in the plane.
#[inline(always)]
pub(super) fn transposed_whitening(w: [f32; 3], tx: f32, ty: f32) -> [f32; 2] {
    [w[0] * tx + w[1] * ty, w[2] * ty]
}

/// Eight ellipses as a structure of arrays; fields as in [`Ellipse`].
#[derive(Debug, Clone, Copy)]
pub(super) struct EllipseBlock {
    /// Centres along the first axis, metres.
    pub(super) x: Lane,
    /// Centres along the second axis, metres.
    pub(super) y: Lane,
    /// Whitenings of the plane.
    pub(super) whiten: [Lane; 3],
    /// Squared distances beyond which the ellipses end, in standard deviations.
    pub(super) reach_square: Lane,
    /// Depths of the peaks at the centres, metres.
    pub(super) depth: Lane,
    /// Changes of the peaks' depths over the plane.
    pub(super) slope: [Lane; 2],
    /// Opacities, 0 to 1.
    pub(super) opacity: Lane,
    /// Indices of the Gaussians.
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
    /// Sum `Σh`.
    pub(super) h: f32,
    /// Sum `Σ h t`.
    pub(super) t: [f32; 2],
    /// Sums `Σ h t tᵀ`: xx, xy, yy.
    pub(super) tt: [f32; 3],
}

/// Gradients of a loss to a Gaussian's centre, axes and size.
pub(super) struct ShapeGradient {
    /// Gradient to the centre, 1/m.
    pub(super) position: Vec3,
    /// Gradient to the log scales.
    pub(super) log_scale: Vec3,
    /// Gradient to the rotation matrix, column by column.
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
