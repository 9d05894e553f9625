//! Evidence of light in satellite images: of the surface, of the sun and of the air. Before training, shadows on a
//! swept surface give suns, shaded courts, days of change and masks, and images get their colours. After training,
//! least squares give albedo, and the light of a day is fitted for relighting.

pub mod bridged;
pub mod change;
pub mod colours;
pub mod daylight;
pub mod ground;
pub mod linear;
pub mod one_light;
mod path_radiance;
pub mod shadow_prior;
pub mod suns;
