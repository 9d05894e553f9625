//! The iterations of one adjustment: robust Gauss-Newton over the corrections of all images and the ground points of
//! all tracks.

use super::correction::{BiasModel, Correction};
use super::drift::{self, Quadratic};
use super::gauge::{pixels_per_metre, smallest_shifts};
use super::linear::{Linear, POINT_HOLD, SLOPES};
use super::normal::NormalEquations;
use super::residuals::{self, Sides};
use super::robust;
use super::solution::{AdjustOptions, Adjustment};
use super::tracks::{AdjustImage, FEWEST_SIGHTINGS, Sighting, Track};
use crate::frame::LocalFrame;
use crate::rpc::RpcError;
use crate::triangulate::geo_slope;
use nalgebra::{Matrix2x3, Matrix3, SVector, Vector2, Vector3};
use rayon::prelude::*;

/// Rounds without robust weights: until biases are removed, residuals do not separate good sightings from bad ones.
const PLAIN_ROUNDS: usize = 3;
/// Rounds after which the scale of good residuals is fixed.
const SCALE_ROUNDS: usize = 10;
/// Largest change of a correction at which the rounds end, pixels.
const LAST_CHANGE_PX: f64 = 5e-4;
/// Remaining movement of the corrections, in joint standard deviations, at which they have converged: it adds less than
/// a tenth to their variance.
const REST: f64 = 0.3;
/// Rounds of triangulation with the cameras fixed.
const POINT_ROUNDS: usize = 5;
/// Fewest tracks of one parallel job.
const TRACKS_PER_JOB: usize = 64;

/// Data of the adjustment.
pub(super) struct BlockAdjustment<'a> {
    images: &'a [AdjustImage<'a>],
    tracks: Vec<&'a Track>,
    frame: &'a LocalFrame,
    /// One flag for each image, true if it has enough sightings to be corrected.
    seen: Vec<bool>,
}

/// Result of the rounds.
struct Solution {
    corrections: Vec<Correction>,
    points: Vec<Vector3<f64>>,
    weights: Vec<Vec<f64>>,
    sigma_px: f64,
    rounds: usize,
    converged: bool,
}

/// Adds a step of the solver to a correction with `free` parameters.
fn add<const K: usize>(correction: &mut Correction, step: &SVector<f64, K>, free: usize) {
    correction.shift_px[0] += step[0];
    correction.shift_px[1] += step[1];
    for ([axis, along], value) in SLOPES.into_iter().zip(step.iter().take(free).skip(2)) {
        correction.slope_px[axis][along] += value;
    }
}

impl<'a> BlockAdjustment<'a> {
    /// Checks the tracks, and counts the sightings of each image.
    pub(super) fn new(
        images: &'a [AdjustImage<'a>],
        tracks: &'a [Track],
        frame: &'a LocalFrame,
    ) -> Result<Self, RpcError> {
        let mut count = vec![0; images.len()];
        let tracks: Vec<&Track> = tracks.iter().collect();
        for sighting in tracks.iter().flat_map(|track| &track.sightings) {
            let Some(count) = count.get_mut(sighting.image) else {
                return Err(RpcError::Invalid(format!(
                    "adjustment: a track names image {}, and there are {}",
                    sighting.image,
                    images.len()
                )));
            };
            *count += 1;
        }
        let useful = tracks.iter().filter(|track| track.sightings.len() > 1).count();
        if useful < FEWEST_SIGHTINGS {
            return Err(RpcError::Invalid(format!(
                "adjustment: {useful} tracks of two or more sightings, {FEWEST_SIGHTINGS} are needed; do the images overlap?"
            )));
        }
        Ok(Self {
            images,
            tracks,
            frame,
            seen: count.iter().map(|&count| count >= FEWEST_SIGHTINGS).collect(),
        })
    }

    fn no_corrections(&self) -> Vec<Correction> {
        let none = |image: &AdjustImage| Correction::none(image.width, image.height);
        self.images.iter().map(none).collect()
    }

    /// Number of parameters of each image of which as many as `most` are allowed; none with too few sightings.
    fn free(&self, most: usize) -> Vec<usize> {
        self.seen.iter().map(|&seen| most * usize::from(seen)).collect()
    }

    /// Corrections of one model for all images.
    pub(super) fn adjust<const K: usize>(&self, options: AdjustOptions) -> Result<Adjustment, RpcError> {
        let solution = self.solve::<K>(self.no_corrections(), &self.free(K), options)?;
        self.finish(solution, options.model)
    }

    /// Corrections with a drift for the images whose ties show it; [`BiasModel::Translation`] if none do.
    pub(super) fn adjust_drifts(&self, options: AdjustOptions) -> Result<Adjustment, RpcError> {
        let spans = drift::spans(&self.no_corrections(), &self.tracks);
        let begin = |drifts: &[bool]| -> (Vec<Correction>, Vec<usize>) {
            let images = (self.no_corrections().into_iter().zip(self.free(2))).zip(spans.iter().zip(drifts));
            images
                .map(|((none, free), (span, drifts))| match span.filter(|_| *drifts) {
                    Some(span) => (span, free + 2),
                    None => (none, free),
                })
                .unzip()
        };
        let may: Vec<bool> = spans.iter().map(Option::is_some).collect();
        let (start, free) = begin(&may);
        // Ties that leave drifts open show none.
        let drifts = match self.solve::<4>(start, &free, options) {
            Ok(all) => {
                let linear = self.linearised(&all.corrections, &all.points)?;
                let good = good_weights(&linear, all.sigma_px);
                Quadratic::of(&linear, &good, &all.corrections, &free).drifting(&may)
            }
            Err(_) => vec![false; may.len()],
        };
        if !drifts.contains(&true) {
            let model = BiasModel::Translation;
            return self.adjust::<2>(AdjustOptions { model, ..options });
        }
        let (start, free) = begin(&drifts);
        let solution = self.solve::<4>(start, &free, options)?;
        self.finish(solution, options.model)
    }

    /// All rounds from `start`, where every image has as many free parameters as `free` states.
    fn solve<const K: usize>(
        &self,
        start: Vec<Correction>,
        free: &[usize],
        options: AdjustOptions,
    ) -> Result<Solution, RpcError> {
        let mut corrections = start;
        let mut points: Vec<Vector3<f64>> = self
            .tracks
            .iter()
            .map(|track| self.frame.enu_from_geo(track.near))
            .collect();
        let mut weights: Vec<Vec<f64>> = self.tracks.iter().map(|track| own_weights(track)).collect();
        let (mut sigma_px, mut rounds, mut converged) = (f64::NAN, 0, false);
        let mut moved = f64::INFINITY;
        self.triangulate(&corrections, &weights, &mut points)?;
        for round in 0..options.most_rounds {
            rounds = round + 1;
            let linear = self.linearised(&corrections, &points)?;
            if round >= PLAIN_ROUNDS {
                if round <= SCALE_ROUNDS {
                    sigma_px = self.sigma_px(&linear, K);
                }
                weights = reweighted(&linear, sigma_px);
            }
            let system = NormalEquations::<K>::of(&linear, &weights, &corrections, free);
            let (steps, length) = system.solve(&mut points)?;
            let mut largest: f64 = 0.0;
            for ((correction, step), free) in corrections.iter_mut().zip(&steps).zip(free) {
                add(correction, step, *free);
                largest = largest.max(step.amax());
            }
            let has_stopped = largest < LAST_CHANGE_PX;
            converged = round > SCALE_ROUNDS && (has_stopped || distance_left(moved, length) < REST * sigma_px);
            if converged && has_stopped {
                break;
            }
            moved = length;
        }
        Ok(Solution {
            corrections,
            points,
            weights,
            sigma_px,
            rounds,
            converged,
        })
    }

    /// The gauge, and the residuals before and after.
    fn finish(&self, mut found: Solution, model: BiasModel) -> Result<Adjustment, RpcError> {
        self.fix_gauge(&mut found.corrections, &mut found.points);
        self.triangulate(&found.corrections, &found.weights, &mut found.points)?;
        let mut before = found.points.clone();
        self.triangulate(&self.no_corrections(), &found.weights, &mut before)?;
        let sides = Sides {
            before: self.linearised(&self.no_corrections(), &before)?,
            after: self.linearised(&found.corrections, &found.points)?,
            sigma_px: found.sigma_px,
        };
        let points = found.points.iter().map(|point| self.frame.geo_from_enu(*point));
        Ok(Adjustment {
            model,
            points: points.collect(),
            sigma_px: found.sigma_px,
            rounds: found.rounds,
            converged: found.converged,
            images: residuals::of_images(&sides, self.images.len()),
            pairs: residuals::of_pairs(&sides),
            residuals: residuals::vectors(&sides, &self.tracks),
            corrections: found.corrections,
        })
    }

    /// Residuals and slopes of all sightings, track by track.
    fn linearised(&self, corrections: &[Correction], points: &[Vector3<f64>]) -> Result<Vec<Vec<Linear>>, RpcError> {
        let tracks = self.tracks.par_iter().zip(points).with_min_len(TRACKS_PER_JOB);
        first_error(tracks.map(|(track, point)| self.linearised_track(track, corrections, *point)))
    }

    fn linearised_track(
        &self,
        track: &Track,
        corrections: &[Correction],
        point: Vector3<f64>,
    ) -> Result<Vec<Linear>, RpcError> {
        let geo = self.frame.geo_from_enu(point);
        let geo_from_enu = geo_slope(self.frame, point);
        let one = |sighting: &Sighting| {
            let (projected, by_geo) = self.images[sighting.image].rpc.project_with_jacobian(geo);
            let correction = &corrections[sighting.image];
            let corrected = correction.apply(projected);
            let residual = Vector2::new(sighting.at.col - corrected.col, sighting.at.row - corrected.row);
            if !residual.iter().all(|v| v.is_finite()) {
                return Err(RpcError::Invalid(format!(
                    "adjustment: image {} has no place for the track at {geo:?}; are the cameras of one place?",
                    sighting.image
                )));
            }
            Ok(Linear {
                image: sighting.image,
                weight: sighting.weight,
                residual,
                slope: by_geo * geo_from_enu,
                from_centre: correction.half_sides_from_centre(projected),
            })
        };
        track.sightings.iter().map(one).collect()
    }

    /// Moves each point to its least weighted residuals, with the cameras fixed.
    fn triangulate(
        &self,
        corrections: &[Correction],
        weights: &[Vec<f64>],
        points: &mut [Vector3<f64>],
    ) -> Result<(), RpcError> {
        let tracks = (self.tracks.par_iter().zip(weights).zip(points)).with_min_len(TRACKS_PER_JOB);
        let place = |((track, weights), point): ((&&Track, &Vec<f64>), &mut Vector3<f64>)| {
            for _ in 0..POINT_ROUNDS {
                let linear = self.linearised_track(track, corrections, *point)?;
                let (mut normal, mut right) = (Matrix3::identity() * POINT_HOLD, Vector3::zeros());
                for (line, weight) in linear.iter().zip(weights) {
                    normal += line.slope.transpose() * line.slope * *weight;
                    right += line.slope.transpose() * line.residual * *weight;
                }
                let step = normal
                    .cholesky()
                    .map_or_else(Vector3::zeros, |factor| factor.solve(&right));
                *point += step;
                if step.norm() < 1e-5 {
                    break;
                }
            }
            Ok(())
        };
        first_error(tracks.map(place))
    }

    fn sigma_px(&self, linear: &[Vec<Linear>], parameters: usize) -> f64 {
        let several = || linear.iter().filter(|track| track.len() > 1);
        let lengths: Vec<f64> = several().flat_map(|track| robust::lengths_px(track)).collect();
        let equations = 2.0 * lengths.len() as f64;
        let unknowns = 3.0 * several().count() as f64 + (parameters * self.images.len()) as f64;
        robust::sigma_px(lengths, 1.0 - unknowns / equations.max(1.0))
    }

    /// Replaces the corrections by the smallest set that fits equally well, and moves the points accordingly.
    fn fix_gauge(&self, corrections: &mut [Correction], points: &mut [Vector3<f64>]) {
        let centre = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
        let seen: Vec<usize> = (0..self.images.len()).filter(|&image| self.seen[image]).collect();
        let shifts: Vec<Vector2<f64>> = seen.iter().map(|&image| corrections[image].shift_px.into()).collect();
        let slopes: Vec<Matrix2x3<f64>> = seen
            .iter()
            .map(|&image| pixels_per_metre(self.images[image].rpc, self.frame, centre))
            .collect();
        let (smallest, translation_m) = smallest_shifts(&shifts, &slopes);
        for (&image, shift) in seen.iter().zip(smallest) {
            corrections[image].shift_px = shift.into();
        }
        points.iter_mut().for_each(|point| *point += translation_m);
    }
}

/// All results, or the error of the first track that has one: the same on any number of threads.
fn first_error<T: Send, C: FromIterator<T>>(
    of_tracks: impl IndexedParallelIterator<Item = Result<T, RpcError>>,
) -> Result<C, RpcError> {
    let of_tracks: Vec<Result<T, RpcError>> = of_tracks.collect();
    of_tracks.into_iter().collect()
}

/// Bound on the length of all further steps, from a geometric series through the last two; infinite where they do not
/// shrink.
fn distance_left(before: f64, last: f64) -> f64 {
    match last < before {
        true => last / (1.0 - last / before),
        false => f64::INFINITY,
    }
}

fn own_weights(track: &Track) -> Vec<f64> {
    track.sightings.iter().map(|sighting| sighting.weight).collect()
}

/// Own weights of the good sightings, zero for the others.
fn good_weights(linear: &[Vec<Linear>], sigma_px: f64) -> Vec<Vec<f64>> {
    let of_track = |track: &Vec<Linear>| {
        let lengths_px = robust::lengths_px(track).into_iter();
        let weight = |(line, length_px): (&Linear, f64)| match robust::is_good(length_px, sigma_px) {
            true => line.weight,
            false => 0.0,
        };
        track.iter().zip(lengths_px).map(weight).collect()
    };
    linear.iter().map(of_track).collect()
}

fn reweighted(linear: &[Vec<Linear>], sigma_px: f64) -> Vec<Vec<f64>> {
    let of_track = |track: &Vec<Linear>| {
        let lengths_px = robust::lengths_px(track).into_iter();
        let lines = track.iter().zip(lengths_px);
        lines
            .map(|(line, length_px)| line.weight * robust::weight(length_px, sigma_px))
            .collect()
    };
    linear.iter().map(of_track).collect()
}
