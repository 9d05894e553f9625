//! Lighting of a model, from the suns or the shadows of its images, with reasons.

use super::Facts;
use heliosplat_radiometry::suns::ShadowSun;
use heliosplat_scene::{ImageSun, SunSource};

/// Remedy for unknown suns.
const REMEDY: &str = "add acquisition times: .IMD, DIM_*.XML or .json files beside the images, or time = \"2016-04-23T08:34:00Z\" in scene.toml";

/// Lighting of a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Lighting {
    /// Lit by the known suns. Images without a sun are rendered as lit everywhere, each in its own colour.
    Known,
    /// Lit by the known suns, and for the other images by suns estimated from shadows on the swept surface. Without any
    /// sun after the estimate, the light is left out.
    FromShadows,
    /// Not lit: no sun is known, and each image has its own colour.
    LeftOut,
}

impl Facts {
    /// Expected lighting of the model.
    pub(super) fn light(&self) -> Lighting {
        match self.suns == self.images {
            true => Lighting::Known,
            false => Lighting::FromShadows,
        }
    }

    /// Expected lighting of the model, in words with the reason.
    pub(super) fn light_reason(&self) -> String {
        let &Self {
            images, dates, suns, ..
        } = self;
        if suns == images {
            let (lowest, highest) = self.suns_deg;
            return format!(
                "{dates} dates with known suns, {lowest:.0} to {highest:.0} degrees high: shadows are traced through the geometry"
            );
        }
        format!(
            "{} of {images} images have no acquisition time and no sun angles: their suns are estimated from shadows in training, or left out where that fails ({REMEDY})",
            images - suns
        )
    }
}

/// Share of images with known suns at or above which the other images are left out of training: their shadows would
/// become dark ground (docs/lab/suns.md).
const SHARE_KNOWN: f64 = 0.75;

/// True if images whose sun stays unknown are left out of training.
pub(super) fn only_known(suns: &[ImageSun]) -> bool {
    let known = suns.iter().filter(|sun| sun.position.is_some()).count();
    known < suns.len() && known as f64 >= SHARE_KNOWN * suns.len() as f64
}

/// Result of the search for suns, in words.
pub(super) fn search_in_words(suns: &[ImageSun], searched: &[Option<ShadowSun>]) -> String {
    let images = suns.len();
    let from_shadows = suns.iter().filter(|sun| sun.source == SunSource::Shadows);
    let sigmas: Vec<f64> = from_shadows.filter_map(|sun| sun.sigma_deg).collect();
    let unknown = suns.iter().filter(|sun| sun.position.is_none()).count();
    let (least, most) = sigmas
        .iter()
        .fold((f64::INFINITY, 0.0f64), |(least, most), &s| (least.min(s), most.max(s)));
    let mut text = format!(
        "the suns of {} of {images} images are known",
        images - unknown - sigmas.len()
    );
    if !sigmas.is_empty() {
        text += &format!(
            ", of {} they are estimated from shadows, to {least:.1} to {most:.1} degrees (standard deviation)",
            sigmas.len()
        );
    }
    if unknown == images {
        tracing::debug!("suns from shadows: {}", closest_in_words(suns, searched));
        return format!(
            "Sun position unknown for all {images} images, and the shadows were too weak to estimate it. The surface model is not affected; shadow masks and relighting are not available for this run. To get them, {REMEDY}"
        );
    }
    if unknown == 0 {
        return text + ": cast shadows are traced through the geometry";
    }
    text += &format!(", of {unknown} {}", closest_in_words(suns, searched));
    text += if only_known(suns) {
        ": these were swept but take no part in training, and count as lit everywhere"
    } else {
        ": these count as lit everywhere, in colours of their own"
    };
    text + " (" + REMEDY + ")"
}

/// The rejected sun nearest to being decisive, in words: its figures show why the others were rejected too.
fn closest_in_words(suns: &[ImageSun], searched: &[Option<ShadowSun>]) -> String {
    let undecided = suns.iter().zip(searched).filter(|(sun, _)| sun.position.is_none());
    let closest = undecided
        .filter_map(|(_, found)| *found)
        .max_by(|a, b| a.margin.total_cmp(&b.margin));
    match closest {
        Some(sun) => format!(
            "shadows are not decisive (at best correlation {:.2}, standard deviation {:.1} degrees, ahead of other suns by {:.1} deviations)",
            sun.score, sun.sigma_deg, sun.margin
        ),
        None => "shadows give no direction".to_owned(),
    }
}
