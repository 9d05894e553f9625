//! Heliocentric position of the Earth: the leading terms of VSOP87 (P. Bretagnon, G. Francou, 1988), as tabled in J.
//! Meeus, *Astronomical Algorithms*, appendix III. Terms under 0.2 arc seconds of longitude are left out.

/// Amplitude (1e-8 radians or astronomical units), phase (radians), frequency (radians per Julian millennium).
type Term = (f64, f64, f64);

const LONGITUDE: [&[Term]; 4] = [
    &[
        (175_347_046.0, 0.0, 0.0),
        (3_341_656.0, 4.669_256_8, 6_283.075_85),
        (34_894.0, 4.626_1, 12_566.151_7),
        (3_497.0, 2.744_1, 5_753.384_9),
        (3_418.0, 2.828_9, 3.523_1),
        (3_136.0, 3.627_7, 77_713.771_5),
        (2_676.0, 4.418_1, 7_860.419_4),
        (2_343.0, 6.135_2, 3_930.209_7),
        (1_324.0, 0.742_5, 11_506.769_8),
        (1_273.0, 2.037_1, 529.691),
        (1_199.0, 1.109_6, 1_577.343_5),
        (990.0, 5.233, 5_884.927),
        (902.0, 2.045, 26.298),
        (857.0, 3.508, 398.149),
        (780.0, 1.179, 5_223.694),
        (753.0, 2.533, 5_507.553),
        (505.0, 4.583, 18_849.228),
        (492.0, 4.205, 775.523),
        (357.0, 2.92, 0.067),
        (317.0, 5.849, 11_790.629),
        (284.0, 1.899, 796.298),
        (271.0, 0.315, 10_977.079),
        (243.0, 0.345, 5_486.778),
        (206.0, 4.806, 2_544.314),
        (205.0, 1.869, 5_573.143),
        (202.0, 2.458, 6_069.777),
        (156.0, 0.833, 213.299),
        (132.0, 3.411, 2_942.463),
        (126.0, 1.083, 20.775),
        (115.0, 0.645, 0.98),
        (103.0, 0.636, 4_694.003),
        (102.0, 0.976, 15_720.839),
        (102.0, 4.267, 7.114),
    ],
    &[
        (628_331_966_747.0, 0.0, 0.0),
        (206_059.0, 2.678_235, 6_283.075_85),
        (4_303.0, 2.635_1, 12_566.151_7),
        (425.0, 1.59, 3.523),
        (119.0, 5.796, 26.298),
        (109.0, 2.966, 1_577.344),
    ],
    &[
        (52_919.0, 0.0, 0.0),
        (8_720.0, 1.072_1, 6_283.075_8),
        (309.0, 0.867, 12_566.152),
    ],
    &[(289.0, 5.844, 6_283.076)],
];

const LATITUDE: [&[Term]; 1] = [&[(280.0, 3.199, 84_334.662), (102.0, 5.422, 5_507.553)]];

const DISTANCE: [&[Term]; 2] = [
    &[
        (100_013_989.0, 0.0, 0.0),
        (1_670_700.0, 3.098_463_5, 6_283.075_85),
        (13_956.0, 3.055_25, 12_566.151_7),
        (3_084.0, 5.198_5, 77_713.771_5),
    ],
    &[(103_019.0, 1.107_49, 6_283.075_85)],
];

/// Heliocentric position of the Earth, ecliptic and mean equinox of date: radians and astronomical units.
pub(super) struct HeliocentricEarth {
    /// Ecliptic longitude.
    pub(super) longitude_rad: f64,
    /// Ecliptic latitude.
    pub(super) latitude_rad: f64,
    /// Distance to the sun.
    pub(super) distance_au: f64,
}

impl HeliocentricEarth {
    /// Position at `millennia`, Julian millennia of terrestrial time from J2000.0.
    pub(super) fn at(millennia: f64) -> Self {
        Self {
            longitude_rad: series(&LONGITUDE, millennia),
            latitude_rad: series(&LATITUDE, millennia),
            distance_au: series(&DISTANCE, millennia),
        }
    }
}

/// `sum over k of millennia^k * sum of A cos(B + C millennia)`.
fn series(powers: &[&[Term]], millennia: f64) -> f64 {
    let sum_of = |terms: &[Term]| -> f64 {
        terms
            .iter()
            .map(|(amplitude, phase, frequency)| amplitude * (phase + frequency * millennia).cos())
            .sum()
    };
    powers
        .iter()
        .rev()
        .fold(0.0, |sum, terms| sum * millennia + sum_of(terms))
        * 1e-8
}
