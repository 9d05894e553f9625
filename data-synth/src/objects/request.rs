//! Request of a capture of an object.

use crate::error::SynthError;

/// Under which light an object is photographed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Capture {
    /// A sky and a sun that stay: display images (PNG), as NeRF-synthetic.
    Object,
    /// One light at a time, somewhere else in every image: linear images (EXR), as GS³ and NRHints.
    Olat,
    /// An environment map with bright patches, to be seen in reflections: display images (PNG), as Shiny Blender.
    Reflective,
}

/// Material of the object's middle.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// Diffuse reflection alone.
    Matte,
    /// Metal with a grain.
    Brushed,
    /// A colour under a clear coat.
    Glossy,
    /// Wax: light enters and comes out elsewhere.
    Translucent,
}

/// A capture to make.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectRequest {
    /// Under which light.
    pub capture: Capture,
    /// Its material.
    pub look: Look,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Images to train with; `None` for the usual number of such captures.
    pub views: Option<usize>,
    /// Images held out; for [`Capture::Olat`] one half with lights near those of training, one half far from them.
    pub held_out: Option<usize>,
    /// Width and height of every image, pixels.
    pub size_px: usize,
    /// Paths per pixel; a power of two is best.
    pub paths: usize,
}

impl Default for ObjectRequest {
    fn default() -> Self {
        Self {
            capture: Capture::Object,
            look: Look::Matte,
            seed: 1,
            views: None,
            held_out: None,
            size_px: 200,
            paths: 64,
        }
    }
}

impl ObjectRequest {
    /// Images to train with.
    pub fn training(&self) -> usize {
        self.views.unwrap_or(match self.capture {
            Capture::Object => 30,
            Capture::Olat => 160,
            Capture::Reflective => 80,
        })
    }

    /// Images held out.
    pub fn testing(&self) -> usize {
        self.held_out.unwrap_or(match self.capture {
            Capture::Object => 15,
            Capture::Olat => 40,
            Capture::Reflective => 20,
        })
    }

    pub(crate) fn check(&self) -> Result<(), SynthError> {
        let bad = |what: String| Err(SynthError::BadRequest(what));
        if !(16..=2048).contains(&self.size_px) {
            return bad(format!("images of {} pixels; give 16 to 2048", self.size_px));
        }
        if !(2..=2000).contains(&self.training()) || self.testing() > 2000 {
            return bad(format!("{} images to train with; give 2 to 2000", self.training()));
        }
        if !(1..=65_536).contains(&self.paths) {
            return bad(format!("{} paths per pixel; give 1 to 65536", self.paths));
        }
        Ok(())
    }
}
