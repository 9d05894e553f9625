//! Setting of an image: air, season, exposure and gains of its date.

use crate::cover::Waves;
use crate::crop::Crop;
use crate::encoding::{Encoding, MEAN_GAIN};
use crate::faults::{self, Haze};
use crate::plan::Collection;
use crate::radiometry::{Illumination, Weather};
use crate::render::Exposure;
use crate::request::{Cover, Fault, SatelliteRequest};
use crate::sensor::Sensor;
use heliosplat_rpc::sun::SunPosition;

/// Gain of scenes with snow relative to other scenes, times the sine of the sun's elevation.
const SNOWY_EXPOSURE: f64 = 1.25;

/// The light and the encoding of an image, apart from its sun and camera.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Studio {
    weather: Weather,
    /// Layer of haze, if haze is requested.
    pub(crate) haze: Option<Haze>,
    /// Conversion of the image's light to counts.
    pub(crate) encoding: Encoding,
    /// Gain of each of the renderer's bands relative to that of `encoding`, if the gains of bands are not calibrated.
    pub(crate) band_gains: Option<[f64; 4]>,
}

impl Studio {
    /// Setting of the image at `index`.
    pub(crate) fn new(request: &SatelliteRequest, collection: &Collection, index: usize) -> Self {
        let view = &collection.views[index];
        let date = &collection.dates[view.date];
        let mut gain = MEAN_GAIN * date.weather.exposure;
        if request.cover == Some(Cover::Snow) {
            // Exposed for bare land under the sun of the day, the snow clips.
            gain *= SNOWY_EXPOSURE / view.sun.elevation_rad.sin();
        }
        Self {
            weather: date.weather,
            haze: (request.has(Fault::Haze)).then(|| Haze::of_date(request.seed, view.date)),
            encoding: Encoding {
                gain,
                noise: request.noise,
                // Display images are stretched from linear counts.
                bits: if request.has(Fault::Stretch) { 16 } else { request.bits },
            },
            band_gains: (request.has(Fault::BandGains)).then(|| faults::band_gains(request.seed, index)),
        }
    }

    /// Light without clouds for a view at an angle from the zenith, radians; `seed` is that of the waves.
    pub(crate) fn light(
        &self,
        request: &SatelliteRequest,
        sun: &SunPosition,
        view_zenith_rad: f64,
        seed: u64,
    ) -> Illumination {
        let waves = (request.has_sea()).then(|| Waves::of_image(seed, self.weather.water_slope_variance));
        let mut light =
            Illumination::new(sun, self.weather, view_zenith_rad).under_haze(self.haze.as_ref(), view_zenith_rad);
        light.bounce = request.has(Fault::Interreflection);
        light.glossy = request.has(Fault::Glossy);
        light.waves = waves;
        light
    }

    /// Exposure of the window of a sensor's image to `light`; `seed` is that of noise and random directions.
    pub(crate) fn exposure<'a>(
        &self,
        request: &SatelliteRequest,
        (sensor, crop): (&'a dyn Sensor, Crop),
        light: &'a Illumination,
        seed: u64,
    ) -> Exposure<'a> {
        Exposure {
            sensor,
            crop,
            light,
            bands: request.bands,
            encoding: self.encoding,
            band_gains: self.band_gains.unwrap_or([1.0; 4]),
            sea_is_missing: request.cover == Some(Cover::Nodata),
            seed,
        }
    }
}
