//! The vegetation index that the plane sweep compares, if there is one.

use heliosplat_scene::{BandKind, SceneImage};

/// Whether the images have a vegetation index, and of what.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Index {
    /// Red or near infrared are missing.
    NoBands,
    /// Values are for display.
    ForDisplay,
    /// Of counts.
    Counts,
    /// Of reflectance.
    Reflectance,
}

impl Index {
    /// What all of some images have.
    pub(super) fn of(images: &[&SceneImage]) -> Self {
        let has = |kind| images.iter().all(|image| image.bands.contains(&kind));
        if !(has(BandKind::Red) && has(BandKind::NearInfrared)) {
            return Self::NoBands;
        }
        if images.iter().any(|image| image.vegetation_index().is_none()) {
            return Self::ForDisplay;
        }
        match images.iter().all(|image| image.values.reflectance.is_empty()) {
            true => Self::Counts,
            false => Self::Reflectance,
        }
    }

    /// Whether there is one.
    pub(super) fn is_there(self) -> bool {
        matches!(self, Self::Counts | Self::Reflectance)
    }

    /// In words.
    pub(super) fn reason(self) -> &'static str {
        match self {
            Self::NoBands => "no near infrared in all images: the sweep compares brightness alone",
            Self::ForDisplay => {
                "values are for display: their bands cannot be compared, and the sweep compares brightness alone"
            }
            Self::Counts => "red and near infrared: leaves are told from pavement where both are as bright",
            Self::Reflectance => {
                "reflectance of red and near infrared: leaves are told from pavement where both are as bright"
            }
        }
    }
}
