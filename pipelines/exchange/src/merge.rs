//! Coarser splats from finer ones: splats whose centres share a cell become one splat with their moments.
//!
//! A splat's weight is its opacity times its area, the product of its two larger standard deviations, since surfaces
//! consist of flat splats. The mean, the covariance and the colour of the merged splat are those of the mixture. Its
//! opacity keeps the covered area, `Σ o A = o A`. Where overlapping parts cover more than the ellipse of their mixture
//! at opacity 1, its two larger axes grow to the same area. Otherwise merged splats of a level surface would be a
//! lattice of separate dots.

use crate::splats::Splat;
use glam::{Mat3, Quat, Vec3};
use rayon::prelude::*;

/// Least standard deviation of a merged splat along an axis, metres.
const THINNEST_M: f32 = 1e-3;
/// Limit of the growth of a merged splat's standard deviation, cells: at this size the discs of a lattice overlap, and
/// several layers in one cell grow no further.
const WIDEST_CELLS: f32 = 2.0 / 3.0;

/// Merged splats: one for each occupied cube of `cell_m` metres, in the order of the cubes.
pub fn merged(splats: &[Splat], cell_m: f32) -> Vec<Splat> {
    let key = |splat: &Splat| (splat.position / cell_m).floor().as_ivec3().to_array();
    let mut order: Vec<([i32; 3], u32)> = splats.iter().map(key).zip(0..).collect();
    order.par_sort_unstable();
    let cells: Vec<&[([i32; 3], u32)]> = order.chunk_by(|a, b| a.0 == b.0).collect();
    let cells = cells.par_iter().with_min_len(256);
    cells
        .map(|cell| mixture(cell.iter().map(|&(_, i)| &splats[i as usize]), WIDEST_CELLS * cell_m))
        .collect()
}

/// Product of the two larger of three lengths.
fn area(scale: Vec3) -> f32 {
    scale.element_product() / scale.min_element()
}

/// Splat with the moments of `parts`; where they overlap it grows, to standard deviations of `widest_m` metres at most.
fn mixture<'a>(parts: impl ExactSizeIterator<Item = &'a Splat> + Clone, widest_m: f32) -> Splat {
    if let (1, Some(only)) = (parts.len(), parts.clone().next()) {
        return *only;
    }
    let weight = |splat: &Splat| splat.opacity * area(splat.scale).max(f32::MIN_POSITIVE);
    let (mut covered, mut mean, mut colour) = (0.0, Vec3::ZERO, Vec3::ZERO);
    for part in parts.clone() {
        let w = weight(part);
        covered += w;
        mean += w * part.position;
        colour += w * Vec3::from(part.colour);
    }
    mean /= covered;
    let mut covariance = Mat3::ZERO;
    for part in parts {
        let aside = part.position - mean;
        let spread = Mat3::from_cols(aside * aside.x, aside * aside.y, aside * aside.z);
        covariance += (part.covariance() + spread) * (weight(part) / covered);
    }
    let (scale, rotation) = axes(covariance);
    let scale = grown(scale, covered / area(scale), widest_m);
    Splat {
        position: mean,
        scale,
        rotation,
        opacity: (covered / area(scale)).min(1.0),
        colour: (colour / covered).to_array(),
    }
}

/// Axes with the area of the two larger ones multiplied by `times`, each of them at most `widest_m` unless it was wider
/// before.
fn grown(scale: Vec3, times: f32, widest_m: f32) -> Vec3 {
    let thinnest = scale.min_element();
    let grow = |axis: f32| match axis > thinnest {
        true => (axis * times.max(1.0).sqrt()).min(axis.max(widest_m)),
        false => axis,
    };
    Vec3::new(grow(scale.x), grow(scale.y), grow(scale.z))
}

/// Standard deviations along the principal axes of a covariance, and the rotation to these axes.
fn axes(covariance: Mat3) -> (Vec3, Quat) {
    let matrix = nalgebra::Matrix3::from_column_slice(&covariance.to_cols_array());
    let eigen = matrix.symmetric_eigen();
    let (eigenvalues, eigenvectors) = (eigen.eigenvalues, eigen.eigenvectors);
    let column = |k: usize| Vec3::from(<[f32; 3]>::from(eigenvectors.column(k).into_owned()));
    let turn = Mat3::from_cols(column(0), column(1), column(0).cross(column(1)));
    let scale = Vec3::from(<[f32; 3]>::from(eigenvalues)).max(Vec3::ZERO);
    let scale = Vec3::from(scale.to_array().map(f32::sqrt)).max(Vec3::splat(THINNEST_M));
    (scale, Quat::from_mat3(&turn).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splats::sample;

    #[test]
    fn a_splat_alone_in_its_cell_stays_as_it_is() {
        let merged = merged(&sample(), 1.0);
        assert_eq!(merged.len(), 3);
        assert!(sample().iter().all(|splat| merged.contains(splat)));
    }

    #[test]
    fn level_discs_become_one_level_disc_of_their_extent() {
        let disc = |x: f32, y: f32, grey: f32| Splat {
            position: Vec3::new(x, y, 5.25),
            scale: Vec3::new(0.3, 0.3, 0.02),
            rotation: Quat::IDENTITY,
            opacity: 0.5,
            colour: [grey; 3],
        };
        let four = [
            disc(0.5, 0.5, 0.2),
            disc(1.5, 0.5, 0.2),
            disc(0.5, 1.5, 0.6),
            disc(1.5, 1.5, 0.6),
        ];
        let merged = merged(&four, 2.0);
        let [one] = merged[..] else {
            panic!("{merged:?}");
        };
        assert!((one.position - Vec3::new(1.0, 1.0, 5.25)).length() < 1e-5);
        assert!((one.colour[0] - 0.4).abs() < 1e-6);
        let expected = Mat3::from_diagonal(Vec3::new(0.34, 0.34, 0.0004));
        let difference = one.covariance() - expected;
        assert!(
            difference.to_cols_array().iter().all(|d| d.abs() < 2e-3),
            "{difference}"
        );
        // Four times 0.5 of 0.09 m² on 0.34 m².
        assert!((one.opacity - 0.18 / 0.34).abs() < 1e-3, "{}", one.opacity);
    }

    #[test]
    fn a_level_surface_has_no_gaps_between_merged_splats() {
        let disc = |i: usize| Splat {
            position: Vec3::new(0.5 * (i % 64) as f32, 0.5 * (i / 64) as f32, 0.1),
            scale: Vec3::new(0.33, 0.33, 0.02),
            rotation: Quat::IDENTITY,
            opacity: 0.9,
            colour: [0.5; 3],
        };
        let fine: Vec<Splat> = (0..64 * 64).map(disc).collect();
        for cell_m in [1.0, 2.0, 4.0] {
            let coarse = merged(&fine, cell_m);
            // Transmittance from above at the point where four cells meet.
            let seen_through = |splat: &Splat| {
                let aside = (splat.position - Vec3::new(16.0, 16.0, 0.1)).truncate();
                let axes = splat.covariance();
                let [a, b, c] = [axes.x_axis.x, axes.x_axis.y, axes.y_axis.y];
                let square =
                    (c * aside.x * aside.x - 2.0 * b * aside.x * aside.y + a * aside.y * aside.y) / (a * c - b * b);
                1.0 - splat.opacity * (-0.5 * square).exp()
            };
            let gap: f32 = coarse.iter().map(seen_through).product();
            assert!(gap < 0.1, "{gap} at {cell_m} m");
        }
    }
}
