//! The forward pass of the satellite model in f64, written to be obvious: every pixel loops over every Gaussian, every
//! light ray meets every Gaussian. It shares no code with the engine.

use nalgebra::{Matrix2, Matrix3, Quaternion, UnitQuaternion, Vector2, Vector3};

/// One Gaussian of the satellite model.
#[derive(Debug, Clone, PartialEq)]
pub struct Gaussian {
    /// Centre, metres.
    pub position: Vector3<f64>,
    /// Log standard deviations along the own axes, of metres.
    pub log_scale: Vector3<f64>,
    /// Raw quaternion `x, y, z, w`.
    pub rotation: [f64; 4],
    /// Opacity logit.
    pub opacity: f64,
    /// Albedo per band, followed by near-surface light per band where the model has it.
    pub albedo: Vec<f64>,
}

/// A projective camera: `col = (u·p + u0)/(1 + w·p)`, `row = (v·p + v0)/(1 + w·p)`, pixels, with `p` in metres.
#[derive(Debug, Clone)]
pub struct Camera {
    /// Numerator of the column: `u` and `u0`.
    pub u: [f64; 4],
    /// Numerator of the row: `v` and `v0`.
    pub v: [f64; 4],
    /// Denominator of column and row.
    pub w: Vector3<f64>,
    /// Unit vector along which depth grows.
    pub axis: Vector3<f64>,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
}

/// Unit vector toward the light, which is infinitely far.
pub type Sun = Vector3<f64>;

/// Composited values of a pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Pixel {
    /// Composited albedo, and behind it near-surface light.
    pub albedo: Vec<f64>,
    /// Composited visibility of the light, 0 to 1.
    pub visibility: f64,
    /// Composited normal, not of unit length.
    pub normal: Vector3<f64>,
    /// `Σ w`, 0 to 1.
    pub alpha: f64,
    /// `Σ w z`, metres.
    pub depth: f64,
    /// `Σ w z²`, square metres.
    pub depth_square: f64,
    /// True if no splat's alpha is so near the threshold that rounding decides.
    pub is_stable: bool,
}

const ALPHA_MIN: f64 = 1.0 / 255.0;
const ALPHA_MAX: f64 = 0.99;
const DEPTH_FILTER: f64 = 0.05;
const OPACITY_MIN: f64 = 0.001;
const LIFT: f64 = 3.717;
/// Relative distance from a threshold within which rounding decides.
const DOUBT: f64 = 2e-3;

/// A Gaussian as a camera sees it.
pub struct Splat {
    /// Column and row, pixels.
    pub centre: Vector2<f64>,
    /// Inverse covariance, 1/pixels².
    pub conic: Matrix2<f64>,
    /// Opacity at the centre, 0 to 1.
    pub opacity: f64,
    /// Depth of the centre, metres.
    pub depth: f64,
    /// Change of depth per pixel, metres.
    pub slope: Vector2<f64>,
    normal: Vector3<f64>,
    index: usize,
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

impl Gaussian {
    fn rotation_matrix(&self) -> Matrix3<f64> {
        let [x, y, z, w] = self.rotation;
        UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
            .to_rotation_matrix()
            .into_inner()
    }

    fn covariance(&self) -> Matrix3<f64> {
        let r = self.rotation_matrix();
        let s = Matrix3::from_diagonal(&self.log_scale.map(f64::exp));
        r * s * s * r.transpose()
    }
}

/// Projects Gaussian number `index`. `filter` is the variance added to the footprint, square pixels; with `antialias`
/// opacity is dimmed by the growth of the footprint.
pub fn project(g: &Gaussian, index: usize, camera: &Camera, filter: f64, antialias: bool) -> Splat {
    let p = g.position;
    let (u, v) = (
        Vector3::from_row_slice(&camera.u[..3]),
        Vector3::from_row_slice(&camera.v[..3]),
    );
    let den = 1.0 + camera.w.dot(&p);
    let centre = Vector2::new((u.dot(&p) + camera.u[3]) / den, (v.dot(&p) + camera.v[3]) / den);
    let ju = (u - camera.w * centre.x) / den;
    let jv = (v - camera.w * centre.y) / den;
    let sigma = g.covariance();
    let cov = Matrix2::new(
        ju.dot(&(sigma * ju)),
        ju.dot(&(sigma * jv)),
        ju.dot(&(sigma * jv)),
        jv.dot(&(sigma * jv)),
    );
    let filtered = cov + Matrix2::identity() * filter;
    let cross = Vector2::new(camera.axis.dot(&(sigma * ju)), camera.axis.dot(&(sigma * jv)));
    let slope = (cov + Matrix2::identity() * DEPTH_FILTER)
        .try_inverse()
        .expect("filtered")
        * cross;
    let dim = if antialias {
        (cov.determinant().max(0.0) / filtered.determinant()).sqrt()
    } else {
        1.0
    };
    Splat {
        centre,
        conic: filtered.try_inverse().expect("filtered"),
        opacity: sigmoid(g.opacity) * dim,
        depth: camera.axis.dot(&p),
        slope,
        normal: (ju * slope.x + jv * slope.y - camera.axis).normalize(),
        index,
    }
}

/// A ray from a Gaussian toward the sun.
struct Ray {
    start: Vector3<f64>,
    bias: f64,
    /// True if rounding may turn the axis that the start was lifted along.
    doubtful: bool,
}

fn ray(own: &Gaussian, sun: &Sun) -> Ray {
    let rotation = own.rotation_matrix();
    let scale = own.log_scale.map(f64::exp);
    let thin = scale.imin();
    let axis = rotation.column(thin).into_owned();
    let along = axis.dot(sun);
    let axis = if along < 0.0 { -axis } else { axis };
    let as_thin = (0..3).filter(|&k| scale[k] < scale[thin] * (1.0 + DOUBT)).count();
    Ray {
        start: own.position + axis * (LIFT * scale[thin] * (1.0 - axis.dot(sun))),
        bias: (sun.transpose() * own.covariance() * sun)[0].sqrt(),
        doubtful: along.abs() < DOUBT || as_thin > 1,
    }
}

/// A Gaussian on the way of a ray.
struct Meeting {
    /// Distance of its peak along the ray, metres.
    peak: f64,
    /// Squared distance from its centre, and that of its reach, standard deviations.
    miss: f64,
    reach: f64,
    alpha: f64,
    /// Distance of its centre from the start, metres and standard deviations.
    away: [f64; 2],
}

fn meeting(ray: &Ray, g: &Gaussian, sun: &Sun) -> Meeting {
    let whiten = Matrix3::from_diagonal(&g.log_scale.map(|s| (-s).exp())) * g.rotation_matrix().transpose();
    let e = whiten * (ray.start - g.position);
    let d = whiten * sun;
    let miss = e.cross(&d).norm_squared() / d.norm_squared();
    let opacity = sigmoid(g.opacity);
    Meeting {
        peak: -e.dot(&d) / d.dot(&d),
        miss,
        reach: 2.0 * (opacity / OPACITY_MIN).ln(),
        alpha: (opacity * (-0.5 * miss).exp()).min(ALPHA_MAX),
        away: [(ray.start - g.position).norm(), e.norm()],
    }
}

/// Transmittance from Gaussian `origin` toward the sun through all others, 0 to 1.
pub fn transmittance(gaussians: &[Gaussian], origin: usize, sun: &Sun) -> f64 {
    transmittance_along(gaussians, origin, sun, f64::INFINITY)
}

/// Transmittance along a unit direction, from peaks within `length`.
fn transmittance_along(gaussians: &[Gaussian], origin: usize, sun: &Sun, length: f64) -> f64 {
    let ray = ray(&gaussians[origin], sun);
    let others = gaussians.iter().enumerate().filter(|(i, _)| *i != origin);
    let meetings = others.map(|(_, g)| meeting(&ray, g, sun));
    meetings
        .filter(|m| m.peak > ray.bias && m.peak < length && m.miss < m.reach)
        .map(|m| 1.0 - m.alpha)
        .product()
}

/// Transmittance from Gaussian `origin` toward a point light at `light` (metres) through all others, 0 to 1.
pub fn transmittance_to_point(gaussians: &[Gaussian], origin: usize, light: &Vector3<f64>) -> f64 {
    let offset = light - gaussians[origin].position;
    transmittance_along(gaussians, origin, &offset.normalize(), offset.norm())
}

/// Range of [`transmittance`] at the precision of `f32`: occluders at the edge of the threshold may count or not, and
/// an alpha has the error of its Gaussian's position. `None` where rounding may change the ray itself.
pub fn transmittance_bounds(gaussians: &[Gaussian], origin: usize, sun: &Sun) -> Option<(f64, f64)> {
    let ray = ray(&gaussians[origin], sun);
    if ray.doubtful {
        return None;
    }
    let (mut least, mut most) = (1.0, 1.0);
    for (i, g) in gaussians.iter().enumerate() {
        if i == origin {
            continue;
        }
        let m = meeting(&ray, g, sun);
        let slack_m = DOUBT * (m.away[0] + ray.bias);
        let slack = DOUBT * (1.0 + m.away[1]);
        let unsure = 1e-5 + 1e-6 * m.away[1] * (1.0 + m.miss.sqrt());
        if m.peak > ray.bias - slack_m && m.miss < m.reach + slack {
            least *= 1.0 - (m.alpha * (1.0 + unsure)).min(ALPHA_MAX);
        }
        if m.peak > ray.bias + slack_m && m.miss < m.reach - slack {
            most *= 1.0 - m.alpha * (1.0 - unsure);
        }
    }
    Some((least, most))
}

/// Renders every pixel of a view, row by row. `visibility` has each Gaussian's transmittance toward the light; `filter`
/// (square pixels) and `antialias` are those of [`project`].
pub fn render(gaussians: &[Gaussian], camera: &Camera, visibility: &[f64], filter: f64, antialias: bool) -> Vec<Pixel> {
    let bands = gaussians[0].albedo.len();
    let mut splats: Vec<Splat> = gaussians
        .iter()
        .enumerate()
        .map(|(i, g)| project(g, i, camera, filter, antialias))
        .collect();
    splats.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    let mut pixels = Vec::new();
    for row in 0..camera.height {
        for col in 0..camera.width {
            let mut t = 1.0;
            let mut pixel = Pixel {
                albedo: vec![0.0; bands],
                visibility: 0.0,
                normal: Vector3::zeros(),
                alpha: 0.0,
                depth: 0.0,
                depth_square: 0.0,
                is_stable: true,
            };
            for s in &splats {
                let d = Vector2::new(col as f64, row as f64) - s.centre;
                let raw = s.opacity * (-0.5 * (d.transpose() * s.conic * d)[0]).exp();
                pixel.is_stable &= (raw / ALPHA_MIN - 1.0).abs() > DOUBT;
                if raw < ALPHA_MIN {
                    continue;
                }
                let w = t * raw.min(ALPHA_MAX);
                let z = s.depth + s.slope.dot(&d);
                for (a, g) in pixel.albedo.iter_mut().zip(&gaussians[s.index].albedo) {
                    *a += w * g;
                }
                pixel.visibility += w * visibility[s.index];
                pixel.normal += s.normal * w;
                pixel.alpha += w;
                pixel.depth += w * z;
                pixel.depth_square += w * z * z;
                t -= w;
            }
            pixels.push(pixel);
        }
    }
    pixels
}

/// Composed colour of a pixel: `A (F ⊙ (S + (1 - S) (sky + near))) + b`, with the `matrix` `A` (bands × bands, row by
/// row), the albedo `F`, the visibility `S` and the `offset` `b`.
pub fn compose(pixel: &Pixel, sky: &[f64], matrix: &[f64], offset: &[f64]) -> Vec<f64> {
    let bands = sky.len();
    let s = pixel.visibility;
    let shade = |k: usize| sky[k] + pixel.albedo.get(bands + k).unwrap_or(&0.0);
    let colour: Vec<f64> = (0..bands)
        .map(|k| pixel.albedo[k] * (s + (1.0 - s) * shade(k)))
        .collect();
    (0..bands)
        .map(|r| offset[r] + (0..bands).map(|k| matrix[r * bands + k] * colour[k]).sum::<f64>())
        .collect()
}
