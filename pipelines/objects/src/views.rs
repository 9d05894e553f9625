//! Images of a capture as training and scoring see them: in front of a background.

use super::capture::{Capture, Frame};
use super::config::Background;
use super::frame_spec::PointLight;
use super::pixels::{Encoding, Picture};
use glam::DVec3;
use heliosplat::model::View;
use heliosplat::shade::display;
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_grid::statistics::upper_quantile;

/// A border is one colour when half of its pixels are this close to it.
const SAME_COLOUR: f32 = 0.02;
/// Band of coverage in an image for training.
const COVERAGE_BAND: usize = 3;
/// Margin of a cropped view, pixels: more than the window of SSIM reaches at half size.
const MARGIN_PX: usize = 16;

/// Background of the images of `capture`, and the reason.
pub fn background(capture: &Capture, wanted: Background) -> ([f32; 3], &'static str) {
    match wanted {
        Background::White => ([1.0; 3], "as configured"),
        Background::Black => ([0.0; 3], "as configured"),
        Background::Auto if capture.has_coverage() => {
            let linear = capture.frames.iter().any(|f| f.picture.encoding == Encoding::Linear);
            if linear {
                ([0.0; 3], "linear images with coverage")
            } else {
                ([1.0; 3], "display images with coverage")
            }
        }
        Background::Auto => match border(capture) {
            Some(colour) => (colour, "the colour of the images' borders"),
            None => ([0.0; 3], "the images' borders have no one colour"),
        },
    }
}

/// Median colour along the borders of all images; `None` where the borders have several colours.
fn border(capture: &Capture) -> Option<[f32; 3]> {
    let mut colour = [0.0; 3];
    for (k, colour) in colour.iter_mut().enumerate() {
        let mut values = Vec::new();
        for frame in &capture.frames {
            let image = &frame.picture.colour;
            let (right, bottom) = (image.width - 1, image.height - 1);
            values.extend((0..image.width).flat_map(|col| [image.at(k, col, 0), image.at(k, col, bottom)]));
            values.extend((0..image.height).flat_map(|row| [image.at(k, 0, row), image.at(k, right, row)]));
        }
        values.retain(|v| v.is_finite());
        let mut at = |share: f64| upper_quantile(&mut values, share);
        let (low, middle, high) = (at(0.25)?, at(0.5)?, at(0.75)?);
        if high - low > 2.0 * SAME_COLOUR {
            return None;
        }
        *colour = middle;
    }
    Some(colour)
}

/// Conversion of images to training data.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Preparation {
    /// Colour behind the object: red, green and blue.
    pub background: [f32; 3],
    /// True if coverage becomes the fourth band of an image.
    pub coverage: bool,
    /// True if display values become linear ones.
    pub linear: bool,
    /// Intensity per colour of a light of strength one, where lights are modelled and have intensities.
    pub unit_light: Option<[f64; 3]>,
}

impl Preparation {
    /// Image in front of the background: red, green and blue, then coverage if `coverage` is set.
    pub fn image(&self, picture: &Picture) -> Raster {
        let mut out = picture.colour.clone();
        let decode = self.linear && picture.encoding == Encoding::Display;
        if let Some(covered) = &picture.coverage {
            for (k, behind) in self.background.into_iter().enumerate() {
                for (value, &covered) in out.plane_mut(k).iter_mut().zip(covered) {
                    if decode {
                        *value = covered * display::decode(*value / covered.max(1e-6));
                    }
                    *value += (1.0 - covered) * behind;
                }
            }
            if self.coverage {
                out.bands = 4;
                out.values.extend(covered);
            }
        } else if decode {
            out.values.iter_mut().for_each(|v| *v = display::decode(*v));
        }
        out
    }

    /// Strength of a light per colour, relative to `unit_light`; one where an intensity is unknown.
    pub fn strength(&self, light: Option<&PointLight>) -> [f32; 3] {
        let known = self.unit_light.zip(light.and_then(|light| light.intensity));
        known.map_or([1.0; 3], |(unit, own)| {
            std::array::from_fn(|k| (own[k] / unit[k]) as f32)
        })
    }
}

/// The part of a frame that shows the object as a view for training: under a light of strength one, where lights are
/// modelled. `None` when its camera looks away from the capture's centre.
pub fn view(frame: &Frame, centre: DVec3, preparation: &Preparation, appearance: usize) -> Option<View> {
    let mut image = preparation.image(&frame.picture);
    let behind = preparation.background;
    for (k, strength) in preparation.strength(frame.light.as_ref()).into_iter().enumerate() {
        if strength != 1.0 && strength > 0.0 {
            let open = frame.picture.coverage.as_deref();
            for (i, value) in image.plane_mut(k).iter_mut().enumerate() {
                // The background is not lit by the lamp.
                let seen = open.map_or(0.0, |covered| (1.0 - covered[i]) * behind[k]);
                *value = (*value - seen) / strength + seen;
            }
        }
    }
    Some(cropped(View {
        name: frame.name.clone(),
        camera: frame.camera.projective(centre)?,
        weight: vec![1.0; image.plane_len()],
        light: frame.light.map(|light| light.seen_from(centre)),
        appearance,
        visibility_prior: None,
        ceiling: Vec::new(),
        image: image.into(),
    }))
}

/// The part of a view with coverage and a margin around it; all of a view without coverage. Outside there is background
/// alone, on which the loss would spend most of its time.
fn cropped(view: View) -> View {
    let (width, height) = (view.image.width, view.image.height);
    if view.image.bands <= COVERAGE_BAND {
        return view;
    }
    let coverage = view.image.plane(COVERAGE_BAND);
    let row_is_covered = |&row: &usize| coverage[row * width..(row + 1) * width].iter().any(|&c| c > 0.0);
    let column_is_covered = |&col: &usize| coverage[col..].iter().step_by(width).any(|&c| c > 0.0);
    let span = |is_covered: &dyn Fn(&usize) -> bool, count: usize| {
        let (first, last) = ((0..count).find(is_covered)?, (0..count).rfind(is_covered)?);
        Some(first.saturating_sub(MARGIN_PX)..(last + 1 + MARGIN_PX).min(count))
    };
    let Some((rows, cols)) = span(&row_is_covered, height).zip(span(&column_is_covered, width)) else {
        return view;
    };
    let image = view.image.part((cols.start, rows.start), (cols.len(), rows.len()));
    let moved = view.camera.shifted(-(cols.start as f32), -(rows.start as f32));
    View {
        camera: ProjectiveCamera {
            width: image.width,
            height: image.height,
            ..moved
        },
        weight: vec![1.0; image.plane_len()],
        image: image.into(),
        ..view
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(encoding: Encoding) -> Picture {
        Picture {
            // One pixel half covered, with colour 0.6, and one wholly covered.
            colour: Raster {
                width: 2,
                height: 1,
                bands: 3,
                values: vec![0.3, 0.6, 0.3, 0.6, 0.3, 0.6],
            },
            coverage: Some(vec![0.5, 1.0]),
            encoding,
        }
    }

    fn preparation(linear: bool) -> Preparation {
        Preparation {
            background: [1.0, 0.0, 0.5],
            coverage: true,
            linear,
            unit_light: Some([2.0; 3]),
        }
    }

    #[test]
    fn images_stand_in_front_of_the_background_with_coverage_as_a_band() {
        let image = preparation(false).image(&picture(Encoding::Display));
        assert_eq!(image.bands, 4);
        assert_eq!(image.values, [0.8, 0.6, 0.3, 0.6, 0.55, 0.6, 0.5, 1.0]);
    }

    #[test]
    fn a_view_is_the_part_with_coverage_and_its_margin() {
        let (width, height) = (60, 50);
        let mut image = Raster::filled(width, height, 4, 0.0);
        image
            .values
            .iter_mut()
            .zip(0..)
            .for_each(|(value, n)| *value = n as f32);
        let covered = image.plane_mut(COVERAGE_BAND);
        covered.fill(0.0);
        covered[20 * width + 30] = 0.5;
        covered[3 * width + 25] = 1.0;
        let whole = View {
            name: "a".into(),
            camera: ProjectiveCamera::nadir(-10.0, 10.0, 0.5, (width, height)),
            weight: vec![1.0; image.plane_len()],
            light: None,
            appearance: 0,
            visibility_prior: None,
            ceiling: Vec::new(),
            image: image.into(),
        };
        let part = cropped(whole.clone());
        // Columns 25 to 30 and rows 3 to 20, with the margin where there is one.
        assert_eq!(
            (part.image.width, part.image.height),
            (6 + 2 * MARGIN_PX, 21 + MARGIN_PX)
        );
        assert_eq!(
            (part.camera.width, part.camera.height),
            (part.image.width, part.image.height)
        );
        let (first, place) = (25 - MARGIN_PX, glam::Vec3::new(3.0, 4.0, 0.0));
        assert_eq!(part.image.at(1, 0, 2), whole.image.at(1, first, 2));
        let (before, after) = (whole.camera.project(place), part.camera.project(place));
        assert!((before.0 - first as f32 - after.0).abs() < 1e-4 && (before.1 - after.1).abs() < 1e-4);
        let empty = View {
            image: Raster::filled(width, height, 4, 0.0).into(),
            ..whole
        };
        assert_eq!(cropped(empty.clone()).image, empty.image);
    }

    #[test]
    fn display_values_become_linear_where_asked_for_and_linear_ones_stay() {
        let decoded = preparation(true).image(&picture(Encoding::Display));
        assert!((decoded.values[1] - 0.318_546_8).abs() < 1e-5, "{}", decoded.values[1]);
        assert!((decoded.values[2] - 0.5 * 0.318_546_8).abs() < 1e-5);
        let kept = preparation(true).image(&picture(Encoding::Linear));
        assert_eq!(kept.values[1], 0.6);
    }

    #[test]
    fn a_lamp_twice_as_strong_counts_twice() {
        let light = |intensity| PointLight {
            position: DVec3::ZERO,
            intensity,
        };
        let strength = |intensity| preparation(true).strength(Some(&light(intensity)));
        assert_eq!(strength(Some([4.0, 2.0, 1.0])), [2.0, 1.0, 0.5]);
        assert_eq!(strength(None), [1.0; 3]);
        assert_eq!(preparation(true).strength(None), [1.0; 3]);
    }
}
