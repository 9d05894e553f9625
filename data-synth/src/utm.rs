//! Transverse Mercator (UTM) on WGS84, both ways, without PROJ.
//!
//! Krüger's series in the third flattening, to sixth order (C. Karney, "Transverse Mercator with an accuracy of a few
//! nanometers", J. Geodesy 85, 2011, eqs. 35 and 36): below a micrometre within 6 degrees of the central meridian.

use serde::{Deserialize, Serialize};

const SEMI_MAJOR_M: f64 = 6_378_137.0;
const FLATTENING: f64 = 1.0 / 298.257_223_563;
const SCALE: f64 = 0.9996;
const FALSE_EASTING_M: f64 = 500_000.0;
const FALSE_NORTHING_SOUTH_M: f64 = 10_000_000.0;

/// A UTM zone on one hemisphere.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct UtmZone {
    /// Number of the zone, 1 to 60.
    pub number: u8,
    /// True on the southern hemisphere, where northings start at 10 000 km.
    pub south: bool,
}

impl UtmZone {
    /// The zone of a place (the plain six-degree grid, without the exceptions of Norway and Svalbard).
    pub fn of(lon_deg: f64, lat_deg: f64) -> Self {
        let wrapped = (lon_deg + 180.0).rem_euclid(360.0);
        let number = (wrapped / 6.0).floor().min(59.0) as u8 + 1;
        Self {
            number,
            south: lat_deg < 0.0,
        }
    }

    /// EPSG code of WGS 84 / UTM zone.
    pub fn epsg(self) -> u16 {
        let family = if self.south { 32_700 } else { 32_600 };
        family + u16::from(self.number)
    }

    fn central_meridian_deg(self) -> f64 {
        f64::from(self.number) * 6.0 - 183.0
    }

    fn false_northing_m(self) -> f64 {
        if self.south { FALSE_NORTHING_SOUTH_M } else { 0.0 }
    }

    /// Easting and northing, metres, of a longitude and latitude, degrees.
    pub fn project(self, lon_deg: f64, lat_deg: f64) -> [f64; 2] {
        let series = Series::new();
        let difference_deg = (lon_deg - self.central_meridian_deg() + 540.0).rem_euclid(360.0) - 180.0;
        let (sin_l, cos_l) = difference_deg.to_radians().sin_cos();
        let tau = lat_deg.to_radians().tan();
        let conformal = series.conformal_tangent(tau);
        let xi = conformal.atan2(cos_l);
        let eta = (sin_l / conformal.hypot(cos_l)).asinh();
        let [north, east] = corrected([xi, eta], series.alpha);
        let scale = SCALE * series.rectifying_radius_m;
        [FALSE_EASTING_M + scale * east, self.false_northing_m() + scale * north]
    }

    /// Longitude and latitude, degrees, of an easting and northing, metres. Longitudes are in -180..180.
    pub fn unproject(self, easting_m: f64, northing_m: f64) -> [f64; 2] {
        let series = Series::new();
        let scale = SCALE * series.rectifying_radius_m;
        let xi = (northing_m - self.false_northing_m()) / scale;
        let eta = (easting_m - FALSE_EASTING_M) / scale;
        let [xi, eta] = corrected([xi, eta], series.beta.map(|beta| -beta));
        let conformal = xi.sin() / eta.sinh().hypot(xi.cos());
        let tau = series.tangent_from_conformal(conformal);
        let lon_deg = self.central_meridian_deg() + eta.sinh().atan2(xi.cos()).to_degrees();
        [(lon_deg + 540.0).rem_euclid(360.0) - 180.0, tau.atan().to_degrees()]
    }
}

/// Northing and easting of the sphere plus the sum of a series (Karney eqs. 9 and 11), in units of the radius.
fn corrected([xi, eta]: [f64; 2], coefficients: [f64; 6]) -> [f64; 2] {
    let (mut north, mut east) = (xi, eta);
    for (k, coefficient) in coefficients.into_iter().enumerate() {
        let m = 2.0 * (k + 1) as f64;
        north += coefficient * (m * xi).sin() * (m * eta).cosh();
        east += coefficient * (m * xi).cos() * (m * eta).sinh();
    }
    [north, east]
}

struct Series {
    alpha: [f64; 6],
    beta: [f64; 6],
    rectifying_radius_m: f64,
    eccentricity: f64,
}

impl Series {
    fn new() -> Self {
        let n = FLATTENING / (2.0 - FLATTENING);
        let (n2, n3, n4, n5, n6) = (n * n, n.powi(3), n.powi(4), n.powi(5), n.powi(6));
        let alpha = [
            n / 2.0 - 2.0 * n2 / 3.0 + 5.0 * n3 / 16.0 + 41.0 * n4 / 180.0 - 127.0 * n5 / 288.0 + 7891.0 * n6 / 37800.0,
            13.0 * n2 / 48.0 - 3.0 * n3 / 5.0 + 557.0 * n4 / 1440.0 + 281.0 * n5 / 630.0
                - 1_983_433.0 * n6 / 1_935_360.0,
            61.0 * n3 / 240.0 - 103.0 * n4 / 140.0 + 15061.0 * n5 / 26880.0 + 167_603.0 * n6 / 181_440.0,
            49561.0 * n4 / 161_280.0 - 179.0 * n5 / 168.0 + 6_601_661.0 * n6 / 7_257_600.0,
            34729.0 * n5 / 80640.0 - 3_418_889.0 * n6 / 1_995_840.0,
            212_378_941.0 * n6 / 319_334_400.0,
        ];
        let beta = [
            n / 2.0 - 2.0 * n2 / 3.0 + 37.0 * n3 / 96.0 - n4 / 360.0 - 81.0 * n5 / 512.0 + 96199.0 * n6 / 604_800.0,
            n2 / 48.0 + n3 / 15.0 - 437.0 * n4 / 1440.0 + 46.0 * n5 / 105.0 - 1_118_711.0 * n6 / 3_870_720.0,
            17.0 * n3 / 480.0 - 37.0 * n4 / 840.0 - 209.0 * n5 / 4480.0 + 5569.0 * n6 / 90720.0,
            4397.0 * n4 / 161_280.0 - 11.0 * n5 / 504.0 - 830_251.0 * n6 / 7_257_600.0,
            4583.0 * n5 / 161_280.0 - 108_847.0 * n6 / 3_991_680.0,
            20_648_693.0 * n6 / 638_668_800.0,
        ];
        Self {
            alpha,
            beta,
            rectifying_radius_m: SEMI_MAJOR_M / (1.0 + n) * (1.0 + n2 / 4.0 + n4 / 64.0 + n6 / 256.0),
            eccentricity: (FLATTENING * (2.0 - FLATTENING)).sqrt(),
        }
    }

    /// Tangent of the conformal latitude from the tangent of the geodetic one.
    fn conformal_tangent(&self, tau: f64) -> f64 {
        let sigma = (self.eccentricity * (self.eccentricity * tau / tau.hypot(1.0)).atanh()).sinh();
        tau * sigma.hypot(1.0) - sigma * tau.hypot(1.0)
    }

    /// The inverse of [`Self::conformal_tangent`] by Newton's method (Karney eqs. 19 to 21).
    fn tangent_from_conformal(&self, conformal: f64) -> f64 {
        let e2 = self.eccentricity * self.eccentricity;
        let mut tau = conformal / (1.0 - e2);
        for _ in 0..8 {
            let now = self.conformal_tangent(tau);
            let step =
                (conformal - now) / now.hypot(1.0) * (1.0 + (1.0 - e2) * tau * tau) / ((1.0 - e2) * tau.hypot(1.0));
            tau += step;
            if step.abs() < 1e-15 * tau.abs().max(1.0) {
                break;
            }
        }
        tau
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// longitude, latitude, EPSG, easting, northing: from PROJ 9.1.1 through `gdaltransform`.
    const FROM_PROJ: [(f64, f64, u16, f64, f64); 5] = [
        (2.35, 48.85, 32631, 452_314.891_233_666, 5_410_984.887_604_44),
        (-81.66, 30.35, 32617, 436_568.395_077_271, 3_357_753.826_763_99),
        (150.9, -33.8, 32756, 305_599.516_395_902, 6_258_036.886_805_46),
        (37.0, 37.6, 32637, 323_446.623_905_647, 4_163_316.258_712_61),
        (-58.4, -34.6, 32721, 371_624.544_190_303, 6_170_423.240_398_88),
    ];

    #[test]
    fn agrees_with_proj_to_ten_micrometres() {
        for (lon, lat, epsg, easting, northing) in FROM_PROJ {
            let zone = UtmZone::of(lon, lat);
            assert_eq!(zone.epsg(), epsg);
            let [e, n] = zone.project(lon, lat);
            assert!((e - easting).abs() < 1e-5, "{epsg}: {e} {easting}");
            assert!((n - northing).abs() < 1e-5, "{epsg}: {n} {northing}");
        }
    }

    #[test]
    fn inverse_returns_to_the_start() {
        for (lon, lat, ..) in FROM_PROJ {
            let zone = UtmZone::of(lon, lat);
            let [e, n] = zone.project(lon, lat);
            let [lon_back, lat_back] = zone.unproject(e, n);
            assert!((lon_back - lon).abs() < 1e-12 && (lat_back - lat).abs() < 1e-12);
        }
    }

    #[test]
    fn zones_end_at_the_date_line() {
        assert_eq!(UtmZone::of(179.999, 10.0).number, 60);
        assert_eq!(UtmZone::of(-179.999, 10.0).number, 1);
        assert_eq!(UtmZone::of(180.0, -10.0), UtmZone { number: 1, south: true });
    }
}
