//! Camera adjustment on tracks whose truth is known: push-broom cameras, biased on purpose.

mod common;

use common::push_broom::PushBroom;
use heliosplat_rpc::adjust::{
    AdjustImage, AdjustOptions, Adjustment, BiasModel, Correction, Sighting, Track, adjust, corrected_rpc, exchange,
    pixels_per_metre, smallest_shifts,
};
use heliosplat_rpc::fit::fit_rpc;
use heliosplat_rpc::{GeoPoint, ImagePoint, LocalFrame, Rpc, read, write};
use nalgebra::{Vector2, Vector3};

const SIZE: usize = 1200;

/// Reproducible numbers in [-1, 1).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    /// Approximately normal number: the sum of twelve.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum::<f64>() * 0.5
    }
}

fn frame() -> LocalFrame {
    LocalFrame::new(GeoPoint::new(36.9, 37.5, 100.0))
}

/// True cameras of one place from different sides.
fn cameras(count: usize) -> Vec<Rpc> {
    let sides = [
        [0.25, -0.15],
        [-0.2, 0.1],
        [0.05, 0.3],
        [-0.35, -0.1],
        [0.15, 0.2],
        [0.0, -0.3],
    ];
    sides[..count]
        .iter()
        .map(|&[roll_rad, pitch_rad]| {
            let mut sensor = PushBroom::over(36.9, 37.5);
            (sensor.size, sensor.roll_rad, sensor.pitch_rad) = (SIZE, roll_rad, pitch_rad);
            fit_rpc(&sensor.samples(11, &[0.0, 70.0, 140.0, 210.0]))
                .expect("fits")
                .rpc
        })
        .collect()
}

/// The cameras as delivered: off by these pixels.
fn biased(cameras: &[Rpc], biases_px: &[[f64; 2]]) -> Vec<Rpc> {
    let moved = |(rpc, [col, row]): (&Rpc, &[f64; 2])| rpc.cropped(-col, -row);
    cameras.iter().zip(biases_px).map(moved).collect()
}

fn biases(count: usize, numbers: &mut Numbers) -> Vec<[f64; 2]> {
    (0..count)
        .map(|_| [4.0 * numbers.next(), 4.0 * numbers.next()])
        .collect()
}

/// Points all over the ground as the true cameras see them; `seen` may move a sighting.
fn tracks(cameras: &[Rpc], count: usize, seen: &mut dyn FnMut(ImagePoint) -> ImagePoint) -> Vec<Track> {
    let (frame, mut numbers) = (frame(), Numbers(7));
    (0..count)
        .map(|_| {
            let enu_m = Vector3::new(250.0 * numbers.next(), 250.0 * numbers.next(), 40.0 * numbers.next());
            let ground = frame.geo_from_enu(enu_m);
            let sightings = cameras.iter().enumerate().map(|(image, rpc)| Sighting {
                image,
                at: seen(rpc.project(ground)),
                weight: 1.0,
            });
            Track {
                sightings: sightings.collect(),
                near: frame.geo_from_enu(enu_m + Vector3::new(3.0, -2.0, 8.0)),
            }
        })
        .collect()
}

/// Sightings with the noise and the mismatches of real ties: a quarter are off by pixels, all of those one way.
fn as_matched(numbers: &mut Numbers, at: ImagePoint) -> ImagePoint {
    let wrong = numbers.next() > 0.5;
    let off = if wrong { [3.0 + numbers.next(), 2.0] } else { [0.0; 2] };
    ImagePoint::new(
        at.col + 0.15 * numbers.normal() + off[0],
        at.row + 0.15 * numbers.normal() + off[1],
    )
}

fn images(cameras: &[Rpc]) -> Vec<AdjustImage<'_>> {
    let image = |rpc| AdjustImage {
        rpc,
        width: SIZE,
        height: SIZE,
    };
    cameras.iter().map(image).collect()
}

fn adjusted(delivered: &[Rpc], tracks: &[Track], model: BiasModel) -> Adjustment {
    let images = images(delivered);
    let options = AdjustOptions {
        model,
        ..Default::default()
    };
    adjust(&images, tracks, &frame(), options).expect("adjusts")
}

/// Largest error of the corrected cameras, a common translation of the scene apart.
fn largest_error_px(delivered: &[Rpc], adjustment: &Adjustment, biases_px: &[[f64; 2]]) -> f64 {
    let slopes: Vec<_> = delivered
        .iter()
        .map(|rpc| pixels_per_metre(rpc, &frame(), Vector3::zeros()))
        .collect();
    let errors: Vec<Vector2<f64>> = adjustment
        .corrections
        .iter()
        .zip(biases_px)
        .map(|(correction, bias)| Vector2::from(correction.shift_px) + Vector2::from(*bias))
        .collect();
    let (errors, _) = smallest_shifts(&errors, &slopes);
    errors.iter().map(Vector2::norm).fold(0.0, f64::max)
}

#[test]
fn known_biases_come_back_from_exact_tracks() {
    let cameras = cameras(6);
    let biases_px = biases(6, &mut Numbers(1));
    let delivered = biased(&cameras, &biases_px);
    let found = adjusted(&delivered, &tracks(&cameras, 200, &mut |at| at), BiasModel::Translation);
    let error_px = largest_error_px(&delivered, &found, &biases_px);
    // A common translation also bends the images by a millipixel, which shifts do not take up.
    assert!(error_px < 5e-3, "{error_px} px");
    assert!(
        found
            .images
            .iter()
            .all(|image| image.before.rms_px > 0.1 && image.after.rms_px < 0.02)
    );
    assert!(
        found
            .pairs
            .iter()
            .all(|pair| pair.ties == 200 && pair.after.rms_px < 0.02)
    );
    assert!(found.converged, "{} rounds", found.rounds);
}

#[test]
fn an_adjustment_that_was_cut_short_has_not_converged() {
    let cameras = cameras(6);
    let delivered = biased(&cameras, &biases(6, &mut Numbers(1)));
    let tracks = tracks(&cameras, 200, &mut |at| at);
    let options = AdjustOptions {
        most_rounds: 5,
        ..Default::default()
    };
    let found = adjust(&images(&delivered), &tracks, &frame(), options).expect("adjusts");
    assert!(!found.converged && found.rounds == 5);
}

/// With few noisy ties, robust weights change for many rounds, by steps below the precision of the ties.
#[test]
fn corrections_that_creep_within_their_noise_have_converged() {
    let cameras = cameras(4);
    let (mut creeping, mut unsettled) = (0, 0);
    for seed in 0..40 {
        let mut numbers = Numbers(seed);
        let delivered = biased(&cameras, &biases(4, &mut numbers));
        let tracks = tracks(&cameras, 12, &mut |at| {
            ImagePoint::new(at.col + 0.3 * numbers.normal(), at.row + 0.3 * numbers.normal())
        });
        let after = |most_rounds: usize| {
            let options = AdjustOptions {
                most_rounds,
                ..Default::default()
            };
            adjust(&images(&delivered), &tracks, &frame(), options).expect("adjusts")
        };
        let last = after(400);
        for most_rounds in [14, 20, 40] {
            let found = after(most_rounds);
            if !found.converged {
                unsettled += 1;
                continue;
            }
            // A solve that uses all of its rounds still moves by small steps.
            creeping += usize::from(found.rounds == most_rounds);
            let apart = found.corrections.iter().zip(&last.corrections);
            let apart_px = apart.flat_map(|(a, b)| (0..2).map(|axis| (a.shift_px[axis] - b.shift_px[axis]).abs()));
            let largest_px = apart_px.fold(0.0, f64::max);
            // The bound is the standard deviation of one tie, because robust weights leave a few of twelve ties.
            assert!(largest_px < last.sigma_px, "{seed}, {most_rounds}: {largest_px} px");
        }
    }
    assert!(creeping > 10 && unsettled > 0, "{creeping} {unsettled}");
}

#[test]
fn noise_averages_out_and_outliers_have_no_say() {
    let cameras = cameras(6);
    let biases_px = biases(6, &mut Numbers(2));
    let delivered = biased(&cameras, &biases_px);
    let mut numbers = Numbers(3);
    // A plain mean would be off by 0.75 px.
    let mut seen = |at: ImagePoint| as_matched(&mut numbers, at);
    let tracks = tracks(&cameras, 500, &mut seen);
    let found = adjusted(&delivered, &tracks, BiasModel::Translation);
    let error_px = largest_error_px(&delivered, &found, &biases_px);
    assert!(error_px < 0.05, "{error_px} px");
    assert!((0.08..0.35).contains(&found.sigma_px), "{}", found.sigma_px);
    let wrong_and_good = found.residuals.iter().filter(|r| r.good && r.after_px[0] > 1.5).count();
    assert!(wrong_and_good < found.residuals.len() / 50, "{wrong_and_good}");
}

#[test]
fn of_all_corrections_that_fit_alike_the_smallest_are_given() {
    let cameras = cameras(4);
    // The delivered cameras agree with each other and see everything elsewhere: nothing is to be corrected.
    let elsewhere_m = Vector3::new(1.5, -2.0, 1.0);
    let slopes: Vec<_> = cameras
        .iter()
        .map(|rpc| pixels_per_metre(rpc, &frame(), Vector3::zeros()))
        .collect();
    let biases_px: Vec<[f64; 2]> = slopes.iter().map(|slope| (slope * elsewhere_m).into()).collect();
    let delivered = biased(&cameras, &biases_px);
    let found = adjusted(&delivered, &tracks(&cameras, 100, &mut |at| at), BiasModel::Translation);
    for correction in &found.corrections {
        let [col, row] = correction.shift_px;
        assert!(col.hypot(row) < 0.01, "{correction:?}");
    }
}

#[test]
fn two_views_are_corrected_across_their_epipolar_lines_only() {
    let cameras = cameras(2);
    let biases_px = [[-0.5, -1.0], [1.0, 2.0]];
    let delivered = biased(&cameras, &biases_px);
    let found = adjusted(&delivered, &tracks(&cameras, 100, &mut |at| at), BiasModel::Translation);
    assert_eq!(found.pairs.len(), 1);
    assert!(
        found.pairs[0].before.median_px > 0.5 && found.pairs[0].after.rms_px < 0.01,
        "{:?}",
        found.pairs
    );
    let length = |shifts: &mut dyn Iterator<Item = [f64; 2]>| shifts.map(|s| s[0].hypot(s[1])).sum::<f64>();
    let corrected = length(&mut found.corrections.iter().map(|c| c.shift_px));
    assert!(corrected < length(&mut biases_px.iter().copied()), "{corrected}");
}

#[test]
fn rotation_and_drift_are_found_where_they_are_allowed() {
    let cameras = cameras(5);
    let bend = Correction {
        shift_px: [1.0, -2.0],
        slope_px: [[0.6, -0.5], [0.5, 0.4]],
        ..Correction::none(SIZE, SIZE)
    };
    // The third image is rotated and stretched, which its camera does not model.
    let mut tracks = tracks(&cameras, 300, &mut |at| at);
    for track in &mut tracks {
        track.sightings[2].at = bend.apply(track.sightings[2].at);
    }
    let shifted = adjusted(&cameras, &tracks, BiasModel::Translation);
    let affine = adjusted(&cameras, &tracks, BiasModel::Affine);
    assert!(
        shifted.images[2].after.median_px > 0.05 || shifted.images[2].good < 200,
        "{:?}",
        shifted.images[2]
    );
    assert!(
        affine.images[2].good == 300 && affine.images[2].after.rms_px < 0.03,
        "{:?}",
        affine.images[2]
    );
    let slope = affine.corrections[2].slope_px;
    assert!(
        (slope[0][1] + 0.5).abs() < 0.25 && (slope[1][0] - 0.5).abs() < 0.25,
        "{slope:?}"
    );
}

#[test]
fn a_drift_along_the_rows_is_found_in_its_image_alone() {
    let cameras = cameras(6);
    for (seed, drift_px) in [(1, [3.0, 0.0]), (2, [0.0, -3.0]), (3, [1.0, 0.5]), (4, [0.4, -0.3])] {
        let mut numbers = Numbers(seed);
        let biases_px = biases(6, &mut numbers);
        let delivered = biased(&cameras, &biases_px);
        let mut tracks = tracks(&cameras, 500, &mut |at| as_matched(&mut numbers, at));
        for at in tracks.iter_mut().map(|track| &mut track.sightings[2].at) {
            let share = at.row / SIZE as f64 - 0.5;
            *at = ImagePoint::new(at.col + drift_px[0] * share, at.row + drift_px[1] * share);
        }
        let found = adjusted(&delivered, &tracks, BiasModel::Drift);
        assert_eq!(found.model, BiasModel::Drift);
        for (image, correction) in found.corrections.iter().enumerate() {
            assert_eq!(
                correction.is_translation(),
                image != 2,
                "{seed}, image {image}: {correction:?}"
            );
        }
        let Correction {
            slope_px, half_side_px, ..
        } = found.corrections[2];
        for axis in 0..2 {
            let over_image_px = slope_px[axis][1] / half_side_px * SIZE as f64;
            assert!(
                (over_image_px - drift_px[axis]).abs() < 0.1,
                "{seed}: {over_image_px} px"
            );
        }
    }
}

#[test]
fn ties_without_drift_show_none() {
    let cameras = cameras(6);
    for seed in 0..20 {
        let mut numbers = Numbers(seed);
        let delivered = biased(&cameras, &biases(6, &mut numbers));
        let tracks = tracks(&cameras, 500, &mut |at| as_matched(&mut numbers, at));
        let found = adjusted(&delivered, &tracks, BiasModel::Drift);
        assert_eq!(found, adjusted(&delivered, &tracks, BiasModel::Translation), "{seed}");
    }
}

#[test]
fn a_few_ties_far_from_the_others_show_no_drift() {
    let cameras = cameras(4);
    let mut tracks = tracks(&cameras, 200, &mut |at| at);
    tracks.sort_by(|a, b| a.sightings[2].at.row.total_cmp(&b.sightings[2].at.row));
    // Ties of the first rows and five of the last, which are off by pixels.
    let mut few = tracks[..100].to_vec();
    few.extend_from_slice(&tracks[195..]);
    few[100..].iter_mut().for_each(|track| track.sightings[2].at.row += 1.5);
    let found = adjusted(&cameras, &few, BiasModel::Drift);
    assert_eq!(found.model, BiasModel::Translation);
}

#[test]
fn an_exported_camera_projects_as_adjusted() {
    let rpc = &cameras(1)[0];
    let shift = Correction {
        shift_px: [1.25, -3.5],
        ..Correction::none(SIZE, SIZE)
    };
    let affine = Correction {
        slope_px: [[0.3, -0.2], [0.1, 0.4]],
        ..shift
    };
    for (correction, tolerance_px) in [(shift, 1e-9), (affine, 2e-3)] {
        let exported = corrected_rpc(rpc, &correction, (SIZE, SIZE), (0.0, 200.0)).expect("exports");
        assert!(exported.max_px < tolerance_px, "{}", exported.max_px);
        let text = write::rpc_txt(&exported.rpc);
        let back = read::rpc_from_text("image_RPC.TXT", &text).expect("reads back");
        for (col, row, height_m) in [(0.0, 0.0, 20.0), (600.0, 300.0, 100.0), (1199.0, 1000.0, 180.0)] {
            let ground = rpc.localise(ImagePoint { col, row }, height_m).expect("localises");
            let (want, got) = (correction.apply(rpc.project(ground)), back.project(ground));
            let off_px = (want.col - got.col).hypot(want.row - got.row);
            assert!(off_px < tolerance_px, "{off_px} px at {col} {row}");
        }
    }
}

#[test]
fn an_image_with_hardly_a_tie_keeps_its_camera() {
    let cameras = cameras(4);
    let biases_px = biases(4, &mut Numbers(5));
    let delivered = biased(&cameras, &biases_px);
    let mut tracks = tracks(&cameras, 100, &mut |at| at);
    for track in &mut tracks[2..] {
        track.sightings.pop();
    }
    let found = adjusted(&delivered, &tracks, BiasModel::Translation);
    let [col, row] = found.corrections[3].shift_px;
    assert!(col.hypot(row) < 1e-3, "{:?}", found.corrections[3]);
}

#[test]
fn tracks_that_cannot_be_used_are_refused() {
    let cameras = cameras(2);
    let images = images(&cameras);
    let mut tracks = tracks(&cameras, 20, &mut |at| at);
    let refused = |tracks: &[Track]| {
        let error = adjust(&images, tracks, &frame(), AdjustOptions::default()).expect_err("refused");
        error.to_string()
    };
    assert!(refused(&tracks[..3]).contains("overlap"));
    tracks[4].sightings[1].image = 9;
    assert!(refused(&tracks).contains("image 9"));
}

#[test]
fn of_several_tracks_without_a_place_the_first_is_named_on_any_number_of_threads() {
    let cameras = cameras(2);
    let images = images(&cameras);
    let tracks = |bad: &[usize]| {
        let mut tracks = tracks(&cameras, 2000, &mut |at| at);
        for &track in bad {
            tracks[track].sightings[1].at.col = f64::NAN;
        }
        tracks
    };
    let refused = |threads: usize, tracks: &[Track]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let adjusted = || adjust(&images, tracks, &frame(), AdjustOptions::default());
        let error = pool.expect("a pool").install(adjusted).expect_err("refused");
        error.to_string()
    };
    let first = refused(1, &tracks(&[400]));
    assert!(first.contains("no place for the track"), "{first}");
    let several = tracks(&[400, 1000, 1800]);
    for threads in [1, 4] {
        assert_eq!(refused(threads, &several), first);
    }
}

#[test]
fn exchanged_cameras_of_like_views_are_found_and_own_ones_are_not() {
    for seed in 0..6 {
        let mut numbers = Numbers(seed);
        let mut truth = cameras(4);
        // A view two degrees from the first one.
        let mut sensor = PushBroom::over(36.9, 37.5);
        (sensor.size, sensor.roll_rad, sensor.pitch_rad) = (SIZE, 0.27, -0.12);
        truth.push(
            fit_rpc(&sensor.samples(11, &[0.0, 70.0, 140.0, 210.0]))
                .expect("fits")
                .rpc,
        );
        let seen = tracks(&truth, 150, &mut |at| as_matched(&mut numbers, at));
        let mut delivered = biased(&truth, &biases(5, &mut numbers));
        assert_eq!(exchange(&images(&delivered), &seen, &frame()), None, "{seed}");
        delivered.swap(0, 4);
        // Files whose windows begin elsewhere.
        delivered[4] = delivered[4].cropped(-300.0, 120.0);
        let found = exchange(&images(&delivered), &seen, &frame()).expect("an exchange");
        assert_eq!(found.images, [0, 4], "{seed}");
        assert!(found.sigma_px[1] < found.sigma_px[0], "{found:?}");
    }
}
