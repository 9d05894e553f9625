//! Pointing of the images: shifts and tie points that correct their cameras. [`align`] estimates one shift per image on
//! a coarse surface; [`ties`] finds single points of the ground in several images to hundredths of a pixel, and
//! altitudes of such points without a surface.

pub mod align;
pub mod ties;
