//! Distance falloff of a light that has a size.

/// Least radius of a point light, as a share of the distance `D` of the falloff. It bounds the light on a Gaussian at
/// the position of the light.
pub const LEAST_RADIUS: f32 = 1e-3;

/// Falloff `D² / (d² + r²)` at the distance `d` to the light (`to_light`), of a light of radius `r` (`radius`) that
/// counts as one at the distance `D` (`distance`), and its slope to `d`; all in one unit of length.
#[inline]
pub fn falloff(to_light: f32, distance: f32, radius: f32) -> (f32, f32) {
    // In units of D, whose square might overflow.
    let (d, r) = (to_light / distance, (radius / distance).max(LEAST_RADIUS));
    let value = 1.0 / (d * d + r * r);
    (value, -2.0 * d * value * value / distance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lamp_counts_as_one_at_its_distance_and_is_bounded_in_its_own_place() {
        assert!((falloff(3.0, 3.0, 0.0).0 - 1.0).abs() < 2e-6);
        assert!((falloff(6.0, 3.0, 0.0).0 - 0.25).abs() < 1e-6);
        let (most, slope) = falloff(0.0, 3.0, 0.0);
        assert!((most - 1e6).abs() < 1.0 && slope == 0.0, "{most} {slope}");
        assert_eq!(falloff(0.0, 3.0, 3.0).0, 1.0);
        assert_eq!(falloff(f32::MAX, 3.0, 0.0).0, 0.0);
    }

    #[test]
    fn its_slope_is_that_of_the_value() {
        for to_light in [0.01f32, 0.5, 3.0, 40.0] {
            let exact = |d: f64| 9.0 / (d * d + 0.25);
            let (d, step) = (f64::from(to_light), 1e-6);
            let numeric = (exact(d + step) - exact(d - step)) / (2.0 * step);
            let slope = f64::from(falloff(to_light, 3.0, 0.5).1);
            assert!(
                (slope - numeric).abs() < 1e-5 * numeric.abs(),
                "{to_light}: {slope} {numeric}"
            );
        }
    }
}
