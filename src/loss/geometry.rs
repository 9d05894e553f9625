//! Depth–normal consistency: a loss that aligns the normals of the splats with those of the composited depth.

use crate::camera::ProjectiveCamera;
use crate::splat::{MapGradients, Maps};
use glam::Vec3;
use rayon::prelude::*;

/// Alpha below which a pixel has no depth.
const ALPHA_SEEN: f32 = 0.5;

/// Computes points from pixels and depths in one camera (Cramer's rule on the two pixel equations and the depth).
pub(crate) struct Unprojection<'a>(pub(crate) &'a ProjectiveCamera);

impl Unprojection<'_> {
    /// The point at `depth` on a pixel's ray, and its derivative to the depth.
    #[inline]
    pub(crate) fn point(&self, col: usize, row: usize, depth: f32) -> (Vec3, Vec3) {
        let camera = self.0;
        let (c, r) = (col as f32, row as f32);
        let a = camera.u - camera.w * c;
        let b = camera.v - camera.w * r;
        let ray = a.cross(b);
        let inverse = 1.0 / ray.dot(camera.depth_axis);
        let along = ray * inverse;
        let base = b.cross(camera.depth_axis) * ((c - camera.u0) * inverse)
            + camera.depth_axis.cross(a) * ((r - camera.v0) * inverse);
        (base + along * depth, along)
    }
}

/// Depth–normal loss: mean of `1 - N·Ñ` over the pixels whose four neighbours are seen, `N` from channels
/// `normal_at..normal_at + 3`, `Ñ` from central differences of the expected depth. Adds `weight` times the gradient to
/// `grads`; returns the mean without `weight`, zero when no such pixel exists.
///
/// A pixel whose neighbours' depths differ by much more than `edge_m` metres is on an edge, where the difference is a
/// wall and not a slope. The factor `exp(-(range / edge_m)²)` reduces its share of the mean, and carries no gradient.
pub fn depth_normal(
    camera: &ProjectiveCamera,
    maps: &Maps,
    normal_at: usize,
    edge_m: f32,
    weight: f32,
    grads: &mut MapGradients,
) -> f64 {
    let (width, height) = (maps.width, maps.height);
    if width < 3 || height < 3 {
        return 0.0;
    }
    let unprojection = Unprojection(camera);
    let depth = |i: usize| maps.depth[i] / maps.alpha[i];
    let rows: Vec<Vec<PixelGradient>> = (1..height - 1)
        .into_par_iter()
        .with_min_len(8)
        .map(|row| {
            let mut out = Vec::with_capacity(width);
            for col in 1..width - 1 {
                let i = row * width + col;
                let around = [i - 1, i + 1, i - width, i + width];
                if around.iter().any(|&n| maps.alpha[n] < ALPHA_SEEN) || maps.alpha[i] < ALPHA_SEEN {
                    continue;
                }
                let [dl, dr, du, dd] = around.map(depth);
                let range = (dl - dr).abs().max((du - dd).abs());
                let edge = (-(range / edge_m) * (range / edge_m)).exp();
                if edge < 1e-3 {
                    continue;
                }
                let (left, al) = unprojection.point(col - 1, row, dl);
                let (right, ar) = unprojection.point(col + 1, row, dr);
                let (up, au) = unprojection.point(col, row - 1, du);
                let (down, ad) = unprojection.point(col, row + 1, dd);
                let (x, y) = (right - left, down - up);
                let cross = x.cross(y);
                let length = cross.length();
                if length < 1e-12 {
                    continue;
                }
                let sign = if cross.dot(camera.depth_axis) > 0.0 { -1.0 } else { 1.0 };
                let slope_normal = cross * (sign / length);
                let n = [0, 1, 2].map(|k| maps.channels[normal_at + k][i]);
                let splat_normal = Vec3::from(n);
                // d(1 - N·Ñ) through the normalisation and the cross product.
                let d_cross = (slope_normal * slope_normal.dot(splat_normal) - splat_normal) * (sign / length * edge);
                let (d_x, d_y) = (y.cross(d_cross), d_cross.cross(x));
                out.push(PixelGradient {
                    pixel: i,
                    loss: edge * (1.0 - splat_normal.dot(slope_normal)),
                    weight: edge,
                    normal: slope_normal * -edge,
                    depths: [-al.dot(d_x), ar.dot(d_x), -au.dot(d_y), ad.dot(d_y)],
                });
            }
            out
        })
        .collect();
    let total_weight: f64 = rows.iter().flatten().map(|p| f64::from(p.weight)).sum();
    if total_weight <= 0.0 {
        return 0.0;
    }
    let unit = weight / total_weight as f32;
    let mut total = 0.0;
    for p in rows.iter().flatten() {
        total += f64::from(p.loss);
        for (k, d) in p.normal.to_array().into_iter().enumerate() {
            grads.channels[normal_at + k][p.pixel] += d * unit;
        }
        let around = [p.pixel - 1, p.pixel + 1, p.pixel - width, p.pixel + width];
        for (n, d) in around.into_iter().zip(p.depths) {
            let inverse = 1.0 / maps.alpha[n];
            grads.depth[n] += d * unit * inverse;
            grads.alpha[n] -= d * unit * inverse * inverse * maps.depth[n];
        }
    }
    total / total_weight
}

/// The unscaled gradient that one pixel contributes.
struct PixelGradient {
    pixel: usize,
    loss: f32,
    weight: f32,
    normal: Vec3,
    /// Gradients to the expected depths left, right, above and below.
    depths: [f32; 4],
}

#[cfg(test)]
mod tests {
    use super::*;

    fn maps(camera: &ProjectiveCamera, depth: impl Fn(usize, usize) -> f32) -> Maps {
        let (width, height) = (camera.width, camera.height);
        let pixels = width * height;
        let alpha: Vec<f32> = (0..pixels).map(|i| 0.8 + 0.002 * (i % 7) as f32).collect();
        let depths: Vec<f32> = (0..pixels).map(|i| depth(i % width, i / width)).collect();
        Maps {
            width,
            height,
            channels: (0..3)
                .map(|k| (0..pixels).map(|i| 0.2 + 0.1 * ((i * (k + 3)) % 5) as f32).collect())
                .collect(),
            depth: alpha.iter().zip(&depths).map(|(a, d)| a * d).collect(),
            alpha,
            ..Maps::default()
        }
    }

    #[test]
    fn a_tilted_plane_agrees_with_its_own_normal() {
        let camera = ProjectiveCamera::nadir(-4.0, 4.0, 0.5, (16, 16));
        // Depth is down: altitude rises 0.2 m per metre to the east.
        let mut maps = maps(&camera, |col, _| -0.2 * (0.5 * col as f32));
        let normal = Vec3::new(-0.2, 0.0, 1.0).normalize();
        for k in 0..3 {
            maps.channels[k].fill(normal[k]);
        }
        let mut grads = MapGradients::zeros(3, 256);
        let value = depth_normal(&camera, &maps, 0, 10.0, 1.0, &mut grads);
        assert!(value.abs() < 1e-5, "{value}");
    }

    #[test]
    fn the_gradients_match_central_differences() {
        let camera = ProjectiveCamera::nadir(-4.0, 4.0, 0.5, (9, 8));
        let base = maps(&camera, |col, row| (0.7 * col as f32).sin() + 0.3 * (row as f32).cos());
        // A wide edge scale keeps the (gradient-free) edge weight constant.
        let loss = |m: &Maps, g: &mut MapGradients| depth_normal(&camera, m, 0, 1e4, 1.0, g);
        let mut grads = MapGradients::zeros(3, 72);
        loss(&base, &mut grads);
        let check = |pick: &dyn Fn(&mut Maps) -> &mut Vec<f32>, analytic: &[f32], step: f32| {
            for i in [10, 13, 31, 40] {
                let (mut hi, mut lo) = (base.clone(), base.clone());
                pick(&mut hi)[i] += step;
                pick(&mut lo)[i] -= step;
                let mut unused = MapGradients::zeros(3, 72);
                let numeric = (loss(&hi, &mut unused) - loss(&lo, &mut unused)) / (2.0 * f64::from(step));
                let got = f64::from(analytic[i]);
                assert!(
                    (numeric - got).abs() < 2e-2 * got.abs() + 2e-4,
                    "{i}: {numeric} against {got}"
                );
            }
        };
        check(&|m| &mut m.depth, &grads.depth, 2e-3);
        check(&|m| &mut m.alpha, &grads.alpha, 2e-3);
        check(&|m| &mut m.channels[1], &grads.channels[1], 1e-2);
    }
}
