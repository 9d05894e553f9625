//! Exports of a model for other programs: splats with colours baked for a light, and the model itself as two files.

use super::measure;
use super::model::{Kind, ObjectModel};
use glam::{DVec3, Vec3};
use heliosplat::ProjectiveCamera;
use heliosplat::gaussians::{FEATURES, POSITION, Table, core_groups};
use heliosplat::light::Light;
use heliosplat::model::radiance::{Radiance, RadianceOptions};
use heliosplat::model::{Context, SceneModel, Seen};
use heliosplat::shade::{display, sh};
use heliosplat::splat::Projected;
use heliosplat::trace::{Occluders, transmittance};
use heliosplat_exchange::splat_ply;
use heliosplat_fitting::run_folder::RunError;
use heliosplat_raster::write::write_atomically;
use rayon::prelude::*;
use std::f32::consts::PI;
use std::path::Path;

/// Directions at which colours are sampled before harmonics of degree three are fitted to them.
const DIRECTIONS: usize = 128;
/// Channels of a splat while it is baked: a width that every model fits in.
const STRIDE: usize = 16;

/// The Gaussians of a model as viewers of splats read them: display values, harmonics of degree three, positions in the
/// frame of the cameras. With a `light`, a relightable model is baked under that light alone; without, under the light
/// of the photographs.
///
/// # Errors
/// A sentence with the fault: the model needs a light and has none, or cannot be relit.
pub fn baked(model: &ObjectModel, light: Option<Light>) -> Result<Table, String> {
    let kind = match light {
        None if matches!(model.file.kind, Kind::Olat(_)) => {
            return Err("a model of one light at a time needs a light; give --light or --toward".into());
        }
        None => model.file.kind.clone(),
        Some(_) => {
            let lit = model.file.kind.lit();
            lit.ok_or("this model knows only the light it was photographed in; leave --light and --toward out")?
        }
    };
    // Colours are linear under a lamp, else in the encoding of the images.
    let linear = light.is_some() || measure::is_linear(model);
    let shading = kind.model();
    let gaussians = &model.parameters.gaussians;
    let all = Projected {
        gaussian: (0..gaussians.count as u32).collect(),
        ..Projected::default()
    };
    let transmittances = match light {
        Some(light) if shading.needs_transmittance() => {
            transmittance(&Occluders::new(gaussians), &all.gaussian, &light).values
        }
        _ => vec![1.0; gaussians.count],
    };
    let mut sums = vec![[[0.0f32; 3]; sh::MAX_FUNCTIONS]; gaussians.count];
    for direction in directions() {
        let camera = parallel(direction);
        let context = Context {
            parameters: &model.parameters,
            camera: &camera,
            light,
            appearance: None,
        };
        let seen = Seen {
            projected: &all,
            transmittance: &transmittances,
            stride: STRIDE,
        };
        let mut features = vec![0.0; gaussians.count * STRIDE];
        shading.features(&context, &seen, &mut features);
        let basis = sh::basis(direction);
        let share = 4.0 * PI / DIRECTIONS as f32;
        sums.par_iter_mut()
            .zip(features.par_chunks(STRIDE))
            .for_each(|(sums, feature)| {
                for k in 0..3 {
                    let value = if linear {
                        display::encode(feature[k].max(0.0)).0
                    } else {
                        feature[k]
                    };
                    for (sum, y) in sums.iter_mut().zip(basis) {
                        sum[k] += share * (value.min(1.0) - 0.5) * y;
                    }
                }
            });
    }
    Ok(table(gaussians, &sums, model.file.centre))
}

/// Unit directions that cover the sphere evenly (Fibonacci's spiral).
fn directions() -> impl Iterator<Item = Vec3> {
    (0..DIRECTIONS).map(|i| {
        let z = 1.0 - (2 * i + 1) as f32 / DIRECTIONS as f32;
        let (azimuth, sine) = (2.399_963 * i as f32, (1.0 - z * z).sqrt());
        Vec3::new(sine * azimuth.cos(), sine * azimuth.sin(), z)
    })
}

/// A camera of parallel rays along `direction`.
fn parallel(direction: Vec3) -> ProjectiveCamera {
    let away = direction.as_dvec3();
    let u = away.any_orthonormal_vector();
    let v = away.cross(u);
    ProjectiveCamera::new([u.x, u.y, u.z, 0.0], [v.x, v.y, v.z, 0.0], [0.0; 3], (1, 1), away)
}

fn table(gaussians: &Table, sums: &[[[f32; 3]; sh::MAX_FUNCTIONS]], centre: DVec3) -> Table {
    let mut groups = core_groups();
    groups.extend(Radiance::new(RadianceOptions::default()).feature_groups());
    let mut out = Table::zeros(groups, gaussians.count);
    for group in 0..FEATURES {
        out.group_mut(group).copy_from_slice(gaussians.group(group));
    }
    for (i, place) in out.group_mut(POSITION).iter_mut().enumerate() {
        *place = (f64::from(*place) + centre[i % 3]) as f32;
    }
    for degree in 0..=sh::MAX_DEGREE {
        let count = 2 * degree + 1;
        for (slots, sums) in out.group_mut(FEATURES + degree).chunks_mut(3 * count).zip(sums) {
            let values = sums[degree * degree..].iter().flatten();
            slots.iter_mut().zip(values).for_each(|(slot, value)| *slot = *value);
        }
    }
    out
}

/// Writes [`baked`] splats.
///
/// # Errors
/// [`RunError`] when the file cannot be written.
pub fn write_splats(splats: &Table, path: &Path) -> Result<(), RunError> {
    Ok(write_atomically(path, &splat_ply::encode(splats, &[]))?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn harmonics_are_found_again_from_the_directions() {
        // Baking a sum of functions gives that sum.
        let wanted: Vec<f32> = (0..sh::MAX_FUNCTIONS).map(|f| 0.1 - 0.013 * f as f32).collect();
        let mut found = [0.0f32; sh::MAX_FUNCTIONS];
        for direction in directions() {
            let basis = sh::basis(direction);
            let value: f32 = basis.iter().zip(&wanted).map(|(y, c)| y * c).sum();
            for (sum, y) in found.iter_mut().zip(basis) {
                *sum += 4.0 * PI / DIRECTIONS as f32 * value * y;
            }
        }
        for (a, b) in found.iter().zip(&wanted) {
            assert!((a - b).abs() < 5e-3, "{a} {b}");
        }
        assert!((parallel(Vec3::Y).depth_axis - Vec3::Y).length() < 1e-6);
        assert!(parallel(Vec3::Y).eye().is_none());
    }
}
