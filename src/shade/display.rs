//! The transfer curve of sRGB (IEC 61966-2-1): linear light to display values and back. Values above one follow the
//! same curve.

/// Linear light up to which the curve is a line.
const LINEAR_END: f32 = 0.003_130_8;
/// Display value at `LINEAR_END`.
const LINEAR_END_ENCODED: f32 = 0.040_45;

/// Display value of linear light, and the slope of the curve there.
#[inline]
pub fn encode(light: f32) -> (f32, f32) {
    if light <= LINEAR_END {
        return (12.92 * light, 12.92);
    }
    let power = light.powf(1.0 / 2.4);
    (1.055 * power - 0.055, 1.055 / 2.4 * power / light)
}

/// Linear light of a display value.
#[inline]
pub fn decode(value: f32) -> f32 {
    if value <= LINEAR_END_ENCODED {
        value / 12.92
    } else {
        ((value + 0.055) / 1.055).powf(2.4)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn display_values_become_the_light_of_the_standard() {
        assert!((decode(0.5) - 0.214_041).abs() < 1e-5);
        assert!((decode(1.0) - 1.0).abs() < 1e-6);
        assert!((decode(0.04) - 0.04 / 12.92).abs() < 1e-9);
    }

    #[test]
    fn encoding_is_inverted_and_its_slope_is_that_of_the_curve() {
        for light in [0.0f32, 0.001, 0.0031, 0.0032, 0.05, 0.5, 1.0, 3.0] {
            let (encoded, slope) = encode(light);
            assert!((decode(encoded) - light).abs() < 1e-5 * (1.0 + light), "{light}");
            let step = 1e-4 * (light + 1e-3);
            let numeric =
                (f64::from(encode(light + step).0) - f64::from(encode(light - step).0)) / (2.0 * f64::from(step));
            assert!(
                (numeric - f64::from(slope)).abs() < 2e-2 * f64::from(slope),
                "{light}: {numeric} {slope}"
            );
        }
    }
}
