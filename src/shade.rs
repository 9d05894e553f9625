//! Shading formulas, each with its gradient: spherical harmonics, microfacets, shared lobes, subsurface scattering,
//! falloff, display curve. And the light of day, which is not trained.

pub mod asg;
pub mod daylight;
pub mod dipole;
pub mod display;
pub mod falloff;
pub mod ggx;
pub mod sh;
pub mod split_sum;
