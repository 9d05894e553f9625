//! Request of a capture: light, material, images and paths.

use crate::error::SynthError;

/// Light under which an object is photographed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Capture {
    /// Fixed sky and sun: display images (PNG), as NeRF-synthetic.
    Object,
    /// One point light, at another place in every image: linear images (EXR), as GS³ and NRHints.
    Olat,
    /// Environment map with bright patches that show in reflections: display images (PNG), as Shiny Blender.
    Reflective,
}

/// Material of the ball and the ring of the object.
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
    /// Light of the capture.
    pub capture: Capture,
    /// Material of the object.
    pub look: Look,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Number of images to train with, 2 to 2000; `None` for the usual number of such captures.
    pub views: Option<usize>,
    /// Number of images held out, at most 2000; `None` for the usual number. For [`Capture::Olat`], one half has lights
    /// near those of training, one half far from them.
    pub held_out: Option<usize>,
    /// Width and height of every image, 16 to 2048 pixels.
    pub size_px: usize,
    /// Paths per pixel, 1 to 65536; a power of two is best.
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
    /// Usual numbers of images to train with and of images held out.
    fn usual(&self) -> [usize; 2] {
        match self.capture {
            Capture::Object => [30, 15],
            Capture::Olat => [160, 40],
            Capture::Reflective => [80, 20],
        }
    }

    /// Number of images to train with: `views`, or the usual number of such captures.
    pub fn training(&self) -> usize {
        self.views.unwrap_or(self.usual()[0])
    }

    /// Number of images held out: `held_out`, or the usual number of such captures.
    pub fn testing(&self) -> usize {
        self.held_out.unwrap_or(self.usual()[1])
    }

    /// Checks the request.
    ///
    /// # Errors
    /// `SynthError::BadRequest` with the first value out of range and its limits.
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
