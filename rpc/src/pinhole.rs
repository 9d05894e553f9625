//! The local projective (pinhole) camera fitted to an RPC over one image window and altitude range.
//!
//! From orbit, perspective moves the pixels of a window by tenths of a pixel only, so that samples hardly determine the
//! denominator's three coefficients. The fit therefore runs in normalised coordinates and holds the denominator near 1
//! by a prior, which is far weaker than any perspective visible in the pixels.

use crate::frame::LocalFrame;
use crate::rpc::{GeoPoint, ImagePoint, Rpc, RpcError};
use nalgebra::{SMatrix, SVector, Vector2, Vector3};

/// Samples along rows and columns, and along height.
const FIT_GRID: (usize, usize) = (17, 7);
/// The residuals are taken on a denser, even grid.
const CHECK_GRID: (usize, usize) = (2 * FIT_GRID.0 + 1, 2 * FIT_GRID.1 + 1);
const REFINEMENTS: usize = 3;
/// Ratio of the largest residual to the root mean square at which levelling ends.
const LEVEL: f64 = 2.4;
/// Largest residual that needs no levelling, pixels.
const LEVELLED_PX: f64 = 1e-3;
const MAX_LEVELLINGS: usize = 60;
/// Standard deviation of the residuals, pixels: the expected error of the projective map.
const RESIDUAL_SIGMA_PX: f64 = 1e-3;
/// Standard deviation of the denominator's coefficients, per metre. They are 1e-6 for a camera in orbit and 1e-4 for
/// one at 10 km.
const DENOMINATOR_SIGMA_PER_M: f64 = 1e-4;
/// Least denominator, as a share of its value at the frame's origin.
const LEAST_DENOMINATOR: f64 = 0.05;

/// `u` (4), `v` (4) and `w` (3) in one vector.
type Parameters = SVector<f64, 11>;

/// A window of an image, pixels; `col0`, `row0` is its upper-left pixel in the RPC's image coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageWindow {
    /// First column.
    pub col0: f64,
    /// First row.
    pub row0: f64,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// Projective camera: `col = (u[0..3]·p + u[3]) / (1 + w·p)`, `row` likewise with `v`; `p` in ENU metres from the
/// frame's origin. Columns and rows count from the window's own upper-left pixel centre.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ProjectiveMap {
    /// Column numerator: three coefficients in pixels per metre, and a constant in pixels.
    pub u: [f64; 4],
    /// Row numerator, with the units of `u`.
    pub v: [f64; 4],
    /// Three coefficients of the denominator, per metre.
    pub w: [f64; 3],
}

impl ProjectiveMap {
    /// Column and row, pixels, of an ENU point in metres.
    pub fn project(&self, enu_m: Vector3<f64>) -> [f64; 2] {
        let dot = |c: &[f64]| c[0] * enu_m.x + c[1] * enu_m.y + c[2] * enu_m.z;
        let denominator = 1.0 + dot(&self.w);
        [
            (dot(&self.u) + self.u[3]) / denominator,
            (dot(&self.v) + self.v[3]) / denominator,
        ]
    }
}

/// A fitted map and its error relative to the RPC.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PinholeFit {
    /// The fitted map.
    pub map: ProjectiveMap,
    /// Root mean square residual over the check grid, pixels.
    pub rms_px: f64,
    /// Largest residual over the check grid, pixels.
    pub max_px: f64,
}

impl PinholeFit {
    /// Fits a map in `frame` to `rpc` over `window` and between the two ellipsoidal heights `altitude_range_m`, metres.
    ///
    /// # Errors
    /// `RpcError::Invalid` for a window without pixels, heights that do not run from low to high, or an RPC that no map
    /// fits; the errors of `Rpc::localise` over the window.
    pub fn fit(
        rpc: &Rpc,
        frame: &LocalFrame,
        window: ImageWindow,
        altitude_range_m: (f64, f64),
    ) -> Result<Self, RpcError> {
        check_request(window, altitude_range_m)?;
        let samples = sample_grid(rpc, frame, window, altitude_range_m, FIT_GRID)?;
        let normalisation = Normalisation::of(&samples, window);
        let normalised: Vec<Correspondence> = samples.iter().map(|sample| normalisation.apply(sample)).collect();
        let parameters = fit_normalised(&normalised, &normalisation)?;
        let map = normalisation.undo(&parameters)?;
        let between = sample_grid(rpc, frame, window, altitude_range_m, CHECK_GRID)?;
        Self::checked(map, &between)
    }

    /// The residuals of `map` over `samples`.
    fn checked(map: ProjectiveMap, samples: &[Correspondence]) -> Result<Self, RpcError> {
        let (mut sum, mut max_px) = (0.0, 0.0_f64);
        for sample in samples {
            let denominator = 1.0 + Vector3::from(map.w).dot(&sample.enu_m);
            let [col, row] = map.project(sample.enu_m);
            let residual_px = (col - sample.pixel.x).hypot(row - sample.pixel.y);
            if !residual_px.is_finite() || denominator < LEAST_DENOMINATOR {
                return Err(RpcError::Invalid(format!(
                    "no pinhole camera fits this RPC: its denominator is {denominator} at east, north, up \
                     {:?} m; give a smaller window or a frame nearer to it",
                    sample.enu_m.as_slice()
                )));
            }
            sum += residual_px * residual_px;
            max_px = max_px.max(residual_px);
        }
        Ok(Self {
            map,
            rms_px: (sum / samples.len() as f64).sqrt(),
            max_px,
        })
    }
}

/// A ground point and its pixel in the window.
#[derive(Clone, Copy)]
struct Correspondence {
    enu_m: Vector3<f64>,
    pixel: Vector2<f64>,
}

fn check_request(window: ImageWindow, altitude_range_m: (f64, f64)) -> Result<(), RpcError> {
    let (low_m, high_m) = altitude_range_m;
    if window.width == 0 || window.height == 0 {
        return Err(RpcError::Invalid(format!(
            "a pinhole camera needs a window with pixels, got {} by {}",
            window.width, window.height
        )));
    }
    if !(low_m.is_finite() && high_m.is_finite() && low_m <= high_m) {
        return Err(RpcError::Invalid(format!(
            "a pinhole camera needs an altitude range from low to high, got {low_m} to {high_m} m"
        )));
    }
    Ok(())
}

/// The pixels of the window, its corners among them, at altitudes from the lowest to the highest.
fn sample_grid(
    rpc: &Rpc,
    frame: &LocalFrame,
    window: ImageWindow,
    (low_m, high_m): (f64, f64),
    (across, levels): (usize, usize),
) -> Result<Vec<Correspondence>, RpcError> {
    // A flat range gets a depth of two metres; without it the samples do not determine the dependence on height.
    let middle_m = 0.5 * (low_m + high_m);
    let half_m = (0.5 * (high_m - low_m)).max(1.0);
    // A window of one column or row is sampled over one pixel for the same reason.
    let [last_col, last_row] = [window.width, window.height].map(|size| (size as f64 - 1.0).max(1.0));
    let share = |i: usize, count: usize| i as f64 / (count - 1) as f64;
    let mut samples = Vec::with_capacity(across * across * levels);
    for level in 0..levels {
        let height_m = middle_m + half_m * (2.0 * share(level, levels) - 1.0);
        for down in 0..across {
            for right in 0..across {
                let pixel = Vector2::new(share(right, across) * last_col, share(down, across) * last_row);
                let image = ImagePoint::new(pixel.x + window.col0, pixel.y + window.row0);
                let ground: GeoPoint = rpc.localise(image, height_m)?;
                samples.push(Correspondence {
                    enu_m: frame.enu_from_geo(ground),
                    pixel,
                });
            }
        }
    }
    Ok(samples)
}

/// Shift and scale that bring ground and image to [-1, 1].
struct Normalisation {
    ground_centre_m: Vector3<f64>,
    ground_scale_m: f64,
    image_centre_px: Vector2<f64>,
    image_scale_px: f64,
}

impl Normalisation {
    fn of(samples: &[Correspondence], window: ImageWindow) -> Self {
        let ground_centre_m =
            samples.iter().fold(Vector3::zeros(), |sum, sample| sum + sample.enu_m) / samples.len() as f64;
        let reach_m = samples
            .iter()
            .map(|s| (s.enu_m - ground_centre_m).amax())
            .fold(0.0, f64::max);
        Self {
            ground_centre_m,
            ground_scale_m: reach_m.max(f64::MIN_POSITIVE),
            image_centre_px: Vector2::new(window.width as f64 - 1.0, window.height as f64 - 1.0) * 0.5,
            image_scale_px: window.width.max(window.height) as f64 * 0.5,
        }
    }

    fn apply(&self, sample: &Correspondence) -> Correspondence {
        Correspondence {
            enu_m: (sample.enu_m - self.ground_centre_m) / self.ground_scale_m,
            pixel: (sample.pixel - self.image_centre_px) / self.image_scale_px,
        }
    }

    /// The map in pixels and metres from the frame's origin, its denominator 1 there.
    fn undo(&self, parameters: &Parameters) -> Result<ProjectiveMap, RpcError> {
        let per_metre =
            |offset: usize| -> Vector3<f64> { parameters.fixed_rows::<3>(offset).into_owned() / self.ground_scale_m };
        let w = per_metre(8);
        let at_origin = 1.0 - w.dot(&self.ground_centre_m);
        if !at_origin.is_finite() || at_origin < LEAST_DENOMINATOR {
            return Err(RpcError::Invalid(format!(
                "no pinhole camera fits this RPC: its denominator is {at_origin} at the frame's origin; \
                 give a frame nearer to the window"
            )));
        }
        let numerator = |offset: usize, image_centre_px: f64| -> [f64; 4] {
            let slope = per_metre(offset);
            let constant = parameters[offset + 3] - slope.dot(&self.ground_centre_m);
            let slope = (slope * self.image_scale_px + w * image_centre_px) / at_origin;
            let constant = (constant * self.image_scale_px) / at_origin + image_centre_px;
            [slope.x, slope.y, slope.z, constant]
        };
        Ok(ProjectiveMap {
            u: numerator(0, self.image_centre_px.x),
            v: numerator(4, self.image_centre_px.y),
            w: (w / at_origin).into(),
        })
    }
}

/// Least squares from the linear equations, refined on pixel residuals, then levelled. Levelling raises the weights of
/// samples with large residuals until the largest residual is at most [`LEVEL`] times the root mean square; the root
/// mean square grows by a few percent.
fn fit_normalised(samples: &[Correspondence], normalisation: &Normalisation) -> Result<Parameters, RpcError> {
    let mut weights = vec![1.0; samples.len()];
    // From zero parameters (image 0 everywhere, denominator 1) the step is the linear equations' solution.
    let mut parameters = normal_step(samples, &weights, normalisation, &Parameters::zeros())?;
    for _ in 0..REFINEMENTS {
        parameters += normal_step(samples, &weights, normalisation, &parameters)?;
    }
    for _ in 0..MAX_LEVELLINGS {
        let residuals: Vec<f64> = samples
            .iter()
            .map(|s| (predict(&parameters, &s.enu_m) - s.pixel).norm())
            .collect();
        let largest = residuals.iter().copied().fold(0.0, f64::max);
        let rms = (residuals.iter().map(|r| r * r).sum::<f64>() / residuals.len() as f64).sqrt();
        // Non-finite values are left to the check of the finished map.
        if largest * normalisation.image_scale_px < LEVELLED_PX || largest <= LEVEL * rms || !rms.is_finite() {
            break;
        }
        for (weight, residual) in weights.iter_mut().zip(&residuals) {
            *weight *= (0.05 + residual / rms).powf(0.1);
        }
        parameters += normal_step(samples, &weights, normalisation, &parameters)?;
    }
    Ok(parameters)
}

fn dot(parameters: &Parameters, offset: usize, p: &Vector3<f64>) -> f64 {
    parameters.fixed_rows::<3>(offset).dot(p)
}

/// The map in normalised coordinates.
fn predict(parameters: &Parameters, p: &Vector3<f64>) -> Vector2<f64> {
    let numerators = Vector2::new(
        dot(parameters, 0, p) + parameters[3],
        dot(parameters, 4, p) + parameters[7],
    );
    numerators / (1.0 + dot(parameters, 8, p))
}

/// One Gauss-Newton step from `parameters` on the weighted pixel residuals with the denominator's prior. At zero
/// parameters the residuals do not depend on the denominator; there the linear equations `u p + u0 - col (w p) = col`
/// are solved instead.
fn normal_step(
    samples: &[Correspondence],
    weights: &[f64],
    normalisation: &Normalisation,
    parameters: &Parameters,
) -> Result<Parameters, RpcError> {
    let linear = *parameters == Parameters::zeros();
    let mut normal = SMatrix::<f64, 11, 11>::zeros();
    let mut right = Parameters::zeros();
    for (sample, &weight) in samples.iter().zip(weights) {
        let p = &sample.enu_m;
        let denominator = 1.0 + dot(parameters, 8, p);
        let predicted = predict(parameters, p);
        for (axis, offset) in [(0, 0), (1, 4)] {
            let image = if linear { sample.pixel[axis] } else { predicted[axis] };
            let (slope, by_denominator) = (p / denominator, p * (-image / denominator));
            // Seven of the eleven derivatives are not zero. The factorisation reads the lower triangle alone.
            let derivatives = [
                (offset, slope.x),
                (offset + 1, slope.y),
                (offset + 2, slope.z),
                (offset + 3, 1.0 / denominator),
                (8, by_denominator.x),
                (9, by_denominator.y),
                (10, by_denominator.z),
            ];
            for (i, &(at, by)) in derivatives.iter().enumerate() {
                for &(other, by_other) in &derivatives[..=i] {
                    normal[(at, other)] += by * by_other * weight;
                }
                right[at] += by * (weight * (sample.pixel[axis] - predicted[axis]));
            }
        }
    }
    let sigma = RESIDUAL_SIGMA_PX / normalisation.image_scale_px;
    let prior = (sigma / (DENOMINATOR_SIGMA_PER_M * normalisation.ground_scale_m)).powi(2);
    for i in 8..11 {
        normal[(i, i)] += prior;
        right[i] -= prior * parameters[i];
    }
    let step = normal
        .cholesky()
        .map(|factor| factor.solve(&right))
        .filter(|step| step.iter().all(|v| v.is_finite()));
    step.ok_or_else(|| {
        RpcError::Invalid("no pinhole camera fits this RPC: its window does not spread over the ground".into())
    })
}
