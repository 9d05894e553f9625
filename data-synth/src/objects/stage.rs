//! The object, its light, and the poses of cameras and lights: everything in a capture that the seed determines.

use super::material::{Colour, Gloss, Medium, PartMaterial, Pattern};
use super::request::{Capture, Look, ObjectRequest};
use super::shape::{Shape, Solid};
use super::trace::{Environment, LightSource, Part, Stage};
use nalgebra::{Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use std::f64::consts::PI;

/// Distance of the cameras from the middle.
const EYE_DISTANCE: f64 = 4.0;
/// Distance of the lights from the middle.
const LIGHT_DISTANCE: f64 = 4.0;
/// Radiant intensity of a light: a white surface that faces it shows about one half.
pub(crate) const LIGHT_STRENGTH: f64 = 25.0;
/// Half of the sector of azimuths, radians, without lights of training; the lights far from those are in it.
const DARK_SECTOR: f64 = PI / 5.0;
/// Angle between a light near those of training and the nearest of these, radians.
const NEAR: f64 = 0.1;

/// Camera of an image, and its light where it has one of its own.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shot {
    /// Position of the camera, which looks at the origin.
    pub(crate) eye: Vector3<f64>,
    /// Position of the point light, if the image has one of its own.
    pub(crate) light: Option<Vector3<f64>>,
}

/// Images of a capture.
#[derive(Debug, Clone)]
pub(crate) struct Shots {
    /// Images to train with.
    pub(crate) train: Vec<Shot>,
    /// Held-out images; in captures under one light, those with lights near the lights of training.
    pub(crate) near: Vec<Shot>,
    /// Held-out images with lights far from those of training; empty if lights do not move.
    pub(crate) far: Vec<Shot>,
}

/// Random numbers of a capture.
struct Dice(Pcg32);

impl Dice {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    fn colour(&mut self) -> Colour {
        // A hue at full strength, mixed with grey: neither black nor glowing.
        let hue = self.between(0.0, 6.0);
        let strength = self.between(0.4, 0.8);
        let channel = |at: f64| {
            let away = (hue - at + 9.0).rem_euclid(6.0) - 3.0;
            (2.0 - away.abs()).clamp(0.0, 1.0)
        };
        Colour::new(channel(0.0), channel(2.0), channel(4.0)) * strength * 0.75 + Colour::repeat(0.12)
    }

    fn turn(&mut self) -> Rotation3<f64> {
        let angle = |dice: &mut Self| dice.between(-PI, PI);
        Rotation3::from_euler_angles(angle(self), angle(self), angle(self))
    }
}

fn direction(azimuth: f64, elevation: f64) -> Vector3<f64> {
    let level = elevation.cos();
    Vector3::new(level * azimuth.cos(), level * azimuth.sin(), elevation.sin())
}

/// `count` places spread evenly over the dome above `lowest` (sine of the elevation), turned by `phase`.
fn dome(count: usize, phase: f64, lowest: f64, highest: f64) -> Vec<(f64, f64)> {
    let golden = PI * (3.0 - 5f64.sqrt());
    (0..count)
        .map(|i| {
            let height = lowest + (highest - lowest) * (i as f64 + 0.5) / count as f64;
            ((golden * i as f64 + phase).rem_euclid(2.0 * PI), height.asin())
        })
        .collect()
}

/// Material of plate and block: matte, or with the clear coat that is on everything.
fn plain(look: Look, dice: &mut Dice, pattern: Pattern) -> PartMaterial {
    let matte = PartMaterial {
        colours: [dice.colour(), dice.colour()],
        pattern,
        gloss: None,
        metal: false,
        medium: None,
    };
    let coat = Gloss {
        alpha: [0.08; 2],
        normal_reflectance: Colour::repeat(0.05),
    };
    PartMaterial {
        gloss: (look == Look::Glossy).then_some(coat),
        ..matte
    }
}

/// Material of ball and ring, which have the look of the capture.
fn special(look: Look, dice: &mut Dice, pattern: Pattern) -> PartMaterial {
    let base = plain(look, dice, pattern);
    match look {
        Look::Matte => base,
        Look::Glossy => PartMaterial {
            pattern: Pattern::Spots(0.9),
            ..base
        },
        Look::Brushed => PartMaterial {
            colours: [base.colours[0].map(|c| 0.45 + 0.5 * c); 2],
            pattern: Pattern::Plain,
            gloss: Some(Gloss {
                alpha: [0.4, 0.15],
                normal_reflectance: Colour::zeros(),
            }),
            metal: true,
            ..base
        },
        Look::Translucent => PartMaterial {
            pattern: Pattern::Plain,
            medium: Some(Medium {
                extinction: 16.0,
                // Light is scattered many times, so a little colour has a large effect.
                albedo: base.colours[0].map(|c| 0.9 + 0.09 * c),
            }),
            ..base
        },
    }
}

/// The object: a base plate with a ball, a ring and a block on it.
fn parts(look: Look, dice: &mut Dice) -> Vec<Part> {
    let part = |shape, centre, turn: Rotation3<f64>, material| Part {
        solid: Solid {
            shape,
            centre,
            own_from_world: turn.inverse().into_inner(),
        },
        material,
    };
    let start = dice.between(0.0, 2.0 * PI);
    let place = |step: f64, radius: f64, up: f64| {
        let angle = start + step * 2.0 * PI / 3.0;
        Vector3::new(radius * angle.cos(), radius * angle.sin(), up)
    };
    let plate = Vector3::new(0.95, 0.95, 0.06);
    let ball = dice.between(0.36, 0.44);
    let (major, minor) = (dice.between(0.27, 0.32), dice.between(0.1, 0.14));
    let block = Vector3::new(dice.between(0.2, 0.28), dice.between(0.2, 0.28), dice.between(0.3, 0.5));
    let floor = plate.z - 0.5;
    let upright = Rotation3::from_axis_angle(&Vector3::z_axis(), dice.between(0.0, PI));
    // The ring leans: its lowest point still touches the plate.
    let lean = Rotation3::from_axis_angle(&Vector3::z_axis(), dice.between(0.0, 2.0 * PI))
        * Rotation3::from_axis_angle(&Vector3::x_axis(), dice.between(0.9, 1.3));
    let ring_up = floor + minor + major * (lean * Vector3::z()).xy().norm();
    let spin = dice.turn();
    let plain_plate = plain(look, dice, Pattern::Checks(0.24));
    let special_ball = special(look, dice, Pattern::Spots(0.5));
    let special_ring = special(look, dice, Pattern::Bands(0.2));
    let plain_block = plain(look, dice, Pattern::Checks(0.13));
    let (middle, still) = (Vector3::new(0.0, 0.0, -0.5), Rotation3::identity());
    let ball_at = place(0.0, 0.5, floor + ball);
    let (ring_at, block_at) = (place(1.0, 0.52, ring_up), place(2.0, 0.52, floor + block.z));
    vec![
        part(Shape::Box { half: plate }, middle, still, plain_plate),
        part(Shape::Sphere { radius: ball }, ball_at, spin, special_ball),
        part(Shape::Torus { major, minor }, ring_at, lean, special_ring),
        part(Shape::Box { half: block }, block_at, upright, plain_block),
    ]
}

fn environment(capture: Capture, dice: &mut Dice) -> (Environment, Vec<LightSource>) {
    let grey = Colour::repeat;
    let (shades, patches, lights) = match capture {
        Capture::Olat => return Default::default(),
        Capture::Object => {
            let sun = LightSource::Sun {
                toward: direction(dice.between(0.0, 2.0 * PI), dice.between(0.7, 1.1)),
                strength: Colour::new(1.7, 1.6, 1.4),
            };
            (
                [Colour::new(0.55, 0.62, 0.75), grey(0.45), grey(0.25)],
                Vec::new(),
                vec![sun],
            )
        }
        Capture::Reflective => {
            let patches = (0..7).map(|i| {
                let toward = direction(f64::from(i) * 2.4 + dice.between(-0.3, 0.3), dice.between(-0.2, 1.2));
                // Lamps and windows: far brighter than their surroundings, so that their reflection in a clear coat is
                // visible.
                let sharpness = dice.between(40.0, 200.0);
                (toward, sharpness, (dice.colour() + grey(0.3)) * dice.between(4.0, 12.0))
            });
            let shades = [Colour::new(0.5, 0.55, 0.65), Colour::new(0.5, 0.42, 0.35), grey(0.15)];
            (shades, patches.collect(), Vec::new())
        }
    };
    (Environment { shades, patches }, lights)
}

/// Object of a request and its static light.
pub(crate) fn stage(request: &ObjectRequest) -> Stage {
    let mut dice = Dice(Pcg32::seed_from_u64(request.seed));
    let parts = parts(request.look, &mut dice);
    let (environment, lights) = environment(request.capture, &mut dice);
    Stage {
        parts,
        lights,
        environment,
    }
}

/// Positions of cameras and lights of a request.
pub(crate) fn shots(request: &ObjectRequest) -> Shots {
    let mut dice = Dice(Pcg32::seed_from_u64(request.seed ^ 0x5eed));
    let phase = dice.between(0.0, 2.0 * PI);
    let eyes = |count: usize, phase: f64| {
        let places = dome(count, phase, 0.08, 0.95).into_iter();
        places.map(|(azimuth, elevation)| direction(azimuth, elevation) * EYE_DISTANCE)
    };
    let (training, testing) = (request.training(), request.testing());
    if request.capture != Capture::Olat {
        let still = |eye| Shot { eye, light: None };
        return Shots {
            train: eyes(training, phase).map(still).collect(),
            near: eyes(testing, phase + 1.0).map(still).collect(),
            far: Vec::new(),
        };
    }
    let shot = |eye, light| Shot {
        eye,
        light: Some(light),
    };
    // Lights of training keep out of a sector of azimuths; lights far from them are in its middle half.
    let dark = dice.between(0.0, 2.0 * PI);
    let lit = |share: f64| dark + DARK_SECTOR + share * (2.0 * PI - 2.0 * DARK_SECTOR);
    let mut lights: Vec<Vector3<f64>> = dome(training, 0.0, 0.3, 0.98)
        .into_iter()
        .map(|(azimuth, elevation)| direction(lit(azimuth / (2.0 * PI)), elevation) * LIGHT_DISTANCE)
        .collect();
    // Neighbours of a camera see the object under unlike lights.
    for i in (1..lights.len()).rev() {
        let other = (dice.between(0.0, 1.0) * (i + 1) as f64) as usize;
        lights.swap(i, other.min(i));
    }
    let far_count = testing / 2;
    let near = eyes(testing - far_count, phase + 1.0).map(|eye| {
        let light = lights[(dice.between(0.0, 1.0) * training as f64) as usize % training];
        let aside = Vector3::from([0; 3].map(|_| dice.between(-1.0, 1.0)));
        let moved = light.normalize() + aside.cross(&light).normalize() * NEAR;
        shot(eye, moved.normalize() * LIGHT_DISTANCE)
    });
    let near = near.collect();
    let far = eyes(far_count, phase + 2.0).map(|eye| {
        let azimuth = dark + 0.5 * DARK_SECTOR * dice.between(-1.0, 1.0);
        shot(eye, direction(azimuth, dice.between(0.35, 0.8)) * LIGHT_DISTANCE)
    });
    let far = far.collect();
    let train = eyes(training, phase).zip(&lights);
    Shots {
        train: train.map(|(eye, &light)| shot(eye, light)).collect(),
        near,
        far,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn angle_to_nearest(shot: &Shot, others: &[Shot]) -> f64 {
        let light = shot.light.expect("a light").normalize();
        let angles = others.iter().map(|o| {
            light
                .dot(&o.light.expect("a light").normalize())
                .clamp(-1.0, 1.0)
                .acos()
        });
        angles.fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn lights_held_out_are_near_those_of_training_or_far_from_them() {
        for seed in 1..4 {
            let request = ObjectRequest {
                capture: Capture::Olat,
                seed,
                ..ObjectRequest::default()
            };
            let shots = shots(&request);
            assert_eq!((shots.train.len(), shots.near.len(), shots.far.len()), (160, 20, 20));
            for shot in &shots.near {
                assert!(angle_to_nearest(shot, &shots.train) < 0.12);
            }
            let far: Vec<f64> = shots.far.iter().map(|s| angle_to_nearest(s, &shots.train)).collect();
            let least = far.iter().copied().fold(f64::INFINITY, f64::min);
            assert!(least > 0.15, "{least}");
        }
    }

    #[test]
    fn everything_stands_on_the_plate_and_in_sight() {
        for seed in 1..6 {
            let request = ObjectRequest {
                seed,
                ..ObjectRequest::default()
            };
            for part in stage(&request).parts {
                assert!(part.solid.centre.norm() < 1.2);
            }
        }
    }
}
