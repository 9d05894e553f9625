//! Training at the extremes ends in a model or in a clear error, and never silently in numbers that are not finite.

use crate::draw::{direction, extreme_gaussians, looks, parameters};
use glam::{DVec3, Vec3};
use heliosplat::gaussians::{OPACITY, POSITION};
use heliosplat::light::Light;
use heliosplat::model::shadow_gs::{ShadowGs, ShadowGsOptions};
use heliosplat::model::{Parameters, View};
use heliosplat::optim::DensityOptions;
use heliosplat::train::{Fault, TrainError, TrainOptions, Trainer};
use heliosplat::{ProjectiveCamera, Raster};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use std::sync::Arc;

const STEPS: usize = 200;
const BOUNDS: (Vec3, Vec3) = (Vec3::splat(-6000.0), Vec3::splat(6000.0));
const IMAGES: [&str; 9] = [
    "noise",
    "even",
    "black",
    "one saturated pixel",
    "half missing",
    "16-bit counts",
    "no numbers among the pixels",
    "nothing at all",
    "one view of nothing",
];
const SIZES: [(usize, usize); 7] = [(1, 1), (1, 60), (60, 1), (24, 24), (33, 17), (48, 30), (1, 20_000)];

fn image(kind: &str, size: (usize, usize), view: usize, random: &mut Pcg32) -> Raster {
    let mut out = Raster::filled(size.0, size.1, 1, 0.5);
    let count = out.values.len();
    if !["even", "black"].contains(&kind) {
        out.values.iter_mut().for_each(|v| *v = random.random::<f32>());
    }
    match kind {
        "black" => out.values.fill(0.0),
        "one saturated pixel" => out.values[count / 2] = 655.35,
        "half missing" => out.values[count / 2..].fill(f32::NAN),
        "16-bit counts" => out.values.iter_mut().for_each(|v| *v = (*v * 65_535.0).round()),
        "no numbers among the pixels" => {
            out.values[0] = f32::INFINITY;
            out.values[count / 2] = f32::NAN;
            out.values[count - 1] = f32::NEG_INFINITY;
        }
        "nothing at all" => out.values.fill(f32::NAN),
        "one view of nothing" if view == 0 => out.values.fill(f32::NAN),
        _ => {}
    }
    out
}

/// One combination of extremes.
struct Combination {
    said: String,
    model: ShadowGs,
    views: Vec<View>,
    parameters: Parameters,
    options: TrainOptions,
}

fn combination(number: u64) -> Combination {
    let mut random = Pcg32::seed_from_u64(0xe7 + number);
    let mut runner = TestRunner::new(proptest::test_runner::Config {
        rng_seed: proptest::test_runner::RngSeed::Fixed(number),
        ..Default::default()
    });
    let kind = IMAGES[random.random_range(0..IMAGES.len())];
    let size = SIZES[random.random_range(0..SIZES.len())];
    let count = random.random_range(2..5);
    let model = ShadowGs::new(ShadowGsOptions {
        bands: 1,
        images: count,
        near_light: random.random(),
        image_colour: random.random(),
        ..ShadowGsOptions::default()
    });
    let along_view: bool = random.random_range(0..4) == 0;
    let views = (0..count)
        .map(|v| {
            let drawn = looks(Just(size)).new_tree(&mut runner).expect("a camera").current();
            let camera = drawn.camera();
            let elevation = [0.5, 3.0, 40.0, 90.0][random.random_range(0..4)];
            let sun = if along_view {
                -camera.depth_axis
            } else {
                direction(elevation, 360.0 * random.random::<f32>())
            };
            View {
                name: format!("view {v}"),
                image: image(kind, size, v, &mut random).into(),
                light: Some(Light::Directional(sun)),
                appearance: v,
                weight: vec![1.0; size.0 * size.1],
                visibility_prior: None,
                ceiling: Vec::new(),
                camera,
            }
        })
        .collect();
    let most = [0, 1, 12, 60, 60, 60][random.random_range(0..6)];
    let drawn = extreme_gaussians(most)
        .new_tree(&mut runner)
        .expect("Gaussians")
        .current();
    let mut parameters = parameters(
        &ShadowGs::new(ShadowGsOptions {
            images: count,
            bands: 1,
            ..ShadowGsOptions::default()
        }),
        &drawn,
    );
    parameters.gaussians = with_groups_of(&model, parameters.gaussians);
    parameters.globals = model.initial_globals(0.3);
    let options = TrainOptions {
        iterations: STEPS,
        gsd_m: [0.05, 0.5, 30.0][random.random_range(0..3)],
        density: DensityOptions {
            every: 40,
            ..DensityOptions::default()
        },
        pyramid_share: if random.random() { 0.4 } else { 0.0 },
        occluder_gradients: random.random(),
        light_every: random.random_range(1..5),
        ..TrainOptions::default()
    };
    Combination {
        said: format!(
            "{kind}, {} x {}, {count} views, {} Gaussians, gsd {}, sun along the view {along_view}",
            size.0, size.1, parameters.gaussians.count, options.gsd_m
        ),
        model,
        views,
        parameters,
        options,
    }
}

/// The same Gaussians with all groups of a model.
fn with_groups_of(model: &ShadowGs, table: heliosplat::gaussians::Table) -> heliosplat::gaussians::Table {
    use heliosplat::gaussians::{Table, core_groups};
    use heliosplat::model::SceneModel;
    let mut groups = core_groups();
    groups.extend(model.feature_groups());
    let mut out = Table::zeros(groups, table.count);
    for (to, from) in out.groups.iter_mut().zip(&table.groups) {
        to.values.copy_from_slice(&from.values);
    }
    out
}

/// Trains to the end; returns the steps done, and the error that stopped it.
fn run(combination: Combination) -> (usize, Option<TrainError>) {
    let Combination {
        model,
        views,
        parameters,
        options,
        said,
    } = combination;
    let nadir = ProjectiveCamera::nadir(-8.0, 8.0, 1.0, (16, 16));
    let mut trainer = match Trainer::new(&model, views, parameters, options, BOUNDS, Some(nadir)) {
        Ok(trainer) => trainer,
        Err(error) => return (0, Some(error)),
    };
    while !trainer.finished() {
        match trainer.step() {
            Ok(report) => {
                assert_eq!(report.rejected, None, "{said}: step {}", report.step);
                assert!(
                    report.l1.is_finite() && report.losses.iter().all(|(_, v)| v.is_finite()),
                    "{said}"
                );
            }
            Err(error) => {
                assert!(trainer.parameters().is_finite(), "{said}: {error}");
                return (trainer.steps(), Some(error));
            }
        }
    }
    assert!(trainer.parameters().is_finite() && trainer.rejected() == 0, "{said}");
    let steps = trainer.steps();
    assert!(trainer.into_best().0.is_finite(), "{said}");
    (steps, None)
}

#[test]
fn thirty_combinations_of_extremes_train_or_say_why_not() {
    let (mut trained, mut refused) = (0, 0);
    for number in 0..30 {
        let combination = combination(number);
        let said = combination.said.clone();
        let (steps, error) = run(combination);
        match &error {
            None => trained += 1,
            Some(TrainError::NotFinite { .. }) => panic!("{said}: {}", error.expect("there")),
            Some(_) => refused += 1,
        }
        println!(
            "{number}: {said}: {steps} steps{}",
            error.map_or(String::new(), |e| format!(", {e}"))
        );
    }
    assert!(trained >= 15 && refused >= 2, "{trained} trained, {refused} refused");
}

/// A scene that trains: noise seen by two cameras, ordinary Gaussians in a level grid.
fn sound() -> (ShadowGs, Vec<View>, Parameters, TrainOptions) {
    let model = ShadowGs::new(ShadowGsOptions {
        bands: 1,
        images: 2,
        ..ShadowGsOptions::default()
    });
    let mut random = Pcg32::seed_from_u64(5);
    let view = |v: usize, random: &mut Pcg32| View {
        name: format!("view {v}"),
        image: image("noise", (24, 24), v, random).into(),
        light: Some(Light::Directional(direction(40.0, 100.0))),
        appearance: v,
        weight: vec![1.0; 24 * 24],
        visibility_prior: None,
        ceiling: Vec::new(),
        camera: ProjectiveCamera::new(
            [2.0, 0.0, 0.3 * v as f64, 11.5],
            [0.0, -2.0, 0.0, 11.5],
            [0.0; 3],
            (24, 24),
            -DVec3::Z,
        ),
    };
    let views = vec![view(0, &mut random), view(1, &mut random)];
    let mut groups = heliosplat::gaussians::core_groups();
    groups.extend(heliosplat::model::SceneModel::feature_groups(&model));
    let mut gaussians = heliosplat::gaussians::Table::zeros(groups, 144);
    for i in 0..144 {
        gaussians.group_mut(POSITION)[i * 3] = (i % 12) as f32 - 5.5;
        gaussians.group_mut(POSITION)[i * 3 + 1] = (i / 12) as f32 - 5.5;
        gaussians.group_mut(heliosplat::gaussians::LOG_SCALE)[i * 3..i * 3 + 3].fill(-0.7);
        gaussians.group_mut(OPACITY)[i] = 1.0;
    }
    let parameters = Parameters {
        gaussians,
        globals: model.initial_globals(0.3),
    };
    (
        model,
        views,
        parameters,
        TrainOptions {
            iterations: STEPS,
            holdout: 0.0,
            ..TrainOptions::default()
        },
    )
}

#[test]
fn steps_that_are_not_finite_are_rejected_named_and_leave_the_last_good_state() {
    let (model, mut views, parameters, options) = sound();
    // Finite, and its square is not: the gradient of the loss leaves the numbers.
    Arc::make_mut(&mut views[1].image).values.fill(f32::MAX);
    let mut trainer = Trainer::new(&model, views, parameters, options, BOUNDS, None).expect("can begin");
    let (mut good, mut bad) = (0, 0);
    for _ in 0..20 {
        let before = trainer.parameters().clone();
        let report = trainer.step().expect("one view in two is sound");
        match report.rejected {
            Some(fault) => {
                bad += 1;
                assert_eq!(report.view, 1, "{fault}");
                assert_eq!(&before, trainer.parameters(), "a rejected step changes nothing");
            }
            None => good += 1,
        }
    }
    assert_eq!((good, bad, trainer.rejected()), (10, 10, 10));
    assert!(trainer.parameters().is_finite());
}

#[test]
fn training_stops_where_no_step_is_finite_and_says_where() {
    let (model, mut views, parameters, options) = sound();
    views
        .iter_mut()
        .for_each(|view| Arc::make_mut(&mut view.image).values.fill(f32::MAX));
    let start = parameters.clone();
    let mut trainer = Trainer::new(&model, views, parameters, options, BOUNDS, None).expect("can begin");
    let error = loop {
        if let Err(error) = trainer.step() {
            break error;
        }
    };
    assert!(matches!(&error, TrainError::NotFinite { rejected: 20, .. }), "{error}");
    let said = error.to_string();
    assert!(
        said.contains("photometric") && said.contains("view ") && said.contains("last good state"),
        "{said}"
    );
    assert_eq!(trainer.parameters(), &start);
}

#[test]
fn what_cannot_be_trained_says_why() {
    let begin = |change: &dyn Fn(&mut Vec<View>, &mut Parameters, &mut TrainOptions)| {
        let (model, mut views, mut parameters, mut options) = sound();
        change(&mut views, &mut parameters, &mut options);
        Trainer::new(&model, views, parameters, options, BOUNDS, None)
            .err()
            .map(|error| error.to_string())
    };
    assert_eq!(begin(&|_, _, _| {}), None);
    let said = |change: &dyn Fn(&mut Vec<View>, &mut Parameters, &mut TrainOptions)| begin(change).expect("refused");
    assert!(said(&|views, _, _| views.clear()).contains("at least one view"));
    assert!(said(&|_, p, _| p.gaussians = p.gaussians.gather(&[])).contains("no Gaussians"));
    assert!(
        said(&|views, _, _| views
            .iter_mut()
            .for_each(|v| Arc::make_mut(&mut v.image).values.fill(f32::NAN)))
        .contains("no pixel of any view")
    );
    assert!(said(&|views, _, _| views.iter_mut().for_each(|v| v.weight.fill(0.0))).contains("no pixel of any view"));
    assert!(said(&|_, p, _| p.gaussians.group_mut(OPACITY)[3] = f32::NAN).contains("'opacity'"));
    assert!(said(&|_, p, _| p.globals.group_mut(0)[0] = f32::NEG_INFINITY).contains("'sky'"));
    assert!(said(&|_, _, o| o.pyramid_share = 1.5).contains("train.pyramid_share"));
}

#[test]
fn cameras_that_look_past_the_model_are_noticed() {
    let (model, views, mut parameters, options) = sound();
    for x in parameters.gaussians.group_mut(POSITION).iter_mut().step_by(3) {
        *x += 2000.0;
    }
    let mut trainer = Trainer::new(&model, views, parameters, options, BOUNDS, None).expect("can begin");
    let error = loop {
        if let Err(error) = trainer.step() {
            break error;
        }
        assert!(!trainer.finished(), "it went on to the end without a word");
    };
    assert!(matches!(error, TrainError::NothingSeen { .. }), "{error}");
}

#[test]
fn a_rate_of_zero_freezes_positions_and_nothing_else() {
    let (model, views, parameters, options) = sound();
    let start = parameters.clone();
    let options = TrainOptions {
        position_rate_gsd: 0.0,
        iterations: 30,
        ..options
    };
    let mut trainer = Trainer::new(&model, views, parameters, options, BOUNDS, None).expect("can begin");
    while !trainer.finished() {
        trainer.step().expect("trains");
    }
    assert_eq!(
        trainer.parameters().gaussians.group(POSITION),
        start.gaussians.group(POSITION)
    );
    assert!(trainer.parameters().is_finite() && trainer.parameters() != &start);
}

#[test]
fn faults_name_what_was_not_finite() {
    assert_eq!(
        Fault::Gradient("opacity".into()).to_string(),
        "the gradient to 'opacity' is not finite"
    );
}
