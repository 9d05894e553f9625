//! A camera for examples, tests and benchmarks.

use crate::rpc::Rpc;

impl Rpc {
    /// A cubic camera like those of real satellites, over 36.91 E 37.58 N at 700 m: 16,000 pixels square of half a
    /// metre, mildly curved.
    pub fn example() -> Self {
        let numerator = |l: f64, p: f64, h: f64| {
            let mut c = [1.3e-6; 20];
            c[..10].copy_from_slice(&[2.1e-3, l, p, h, 4.0e-4, -2.5e-4, 1.1e-4, 3.0e-4, -2.0e-4, 1.5e-5]);
            c
        };
        let mut denominator = [4.0e-7; 20];
        denominator[..4].copy_from_slice(&[1.0, 6.0e-4, -4.0e-4, 3.0e-4]);
        Self {
            line_offset: 8_000.0,
            sample_offset: 8_000.0,
            latitude_offset_deg: 37.58,
            longitude_offset_deg: 36.91,
            height_offset_m: 700.0,
            line_scale: 8_000.0,
            sample_scale: 8_000.0,
            latitude_scale_deg: 0.036,
            longitude_scale_deg: 0.045,
            height_scale_m: 500.0,
            line_numerator: numerator(0.02, -1.0, 0.03),
            line_denominator: denominator,
            sample_numerator: numerator(1.0, 0.02, -0.04),
            sample_denominator: denominator,
            error_bias_m: None,
            error_random_m: None,
        }
    }
}
