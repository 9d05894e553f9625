//! A training on a device: the curve of the CPU, its own bytes again, and the end of it.

mod common;

use common::{adapter, apart, model, parameters, views};
use glam::Vec3;
use heliosplat::gaussians::POSITION;
use heliosplat::model::Parameters;
use heliosplat::train::device::DeviceSource;
use heliosplat::train::{TrainError, TrainOptions, Trainer};

const COUNT: usize = 500;
const STEPS: usize = 60;
/// The box that holds all Gaussians.
const BOUNDS: (Vec3, Vec3) = (Vec3::splat(-9.0), Vec3::splat(9.0));

/// Options like those of a capture, with rounds of density.
fn options() -> TrainOptions {
    let mut options = TrainOptions {
        iterations: STEPS,
        position_rate_gsd: 0.04,
        consistency_weight: 0.0,
        pyramid_share: 0.2,
        patience: 0,
        gsd_m: 0.02,
        scale_gsd: (0.1, 60.0),
        ..TrainOptions::default()
    };
    options.density.every = 20;
    options.density.growth = 0.1;
    options.density.prune_gsd = 120.0;
    options
}

/// Losses of a training from elsewhere than the views' own Gaussians, on a device or the CPU, and its end.
fn trained(on_device: bool) -> Option<(Vec<f64>, Parameters)> {
    let (model, options) = (model(), options());
    let views = views(&parameters(COUNT, 1), 5);
    let mut trainer = Trainer::new(&model, views, parameters(COUNT, 2), options.clone(), BOUNDS, None).expect("sound");
    if on_device {
        let device = adapter()?.open(&model, &options).expect("opened");
        trainer = trainer.on(device.expect("known"));
    }
    let mut losses = Vec::new();
    while !trainer.finished() {
        let report = trainer.step().expect("a step");
        assert_eq!(report.rejected, None);
        losses.push(report.losses[0].1);
    }
    trainer.fetch().expect("fetched");
    Some((losses, trainer.parameters().clone()))
}

#[test]
fn the_curve_is_that_of_the_cpu_and_a_device_repeats_its_own_bytes() {
    let Some((losses, end)) = trained(true) else { return };
    let (expected, cpu) = trained(false).expect("the CPU is always there");
    let mean = |losses: &[f64]| losses.iter().sum::<f64>() / losses.len() as f64;
    assert!(
        mean(&expected[STEPS - 5..]) < 0.8 * mean(&expected[..5]),
        "nothing was learnt"
    );
    for (step, (own, cpu)) in losses.iter().zip(&expected).enumerate() {
        assert!((own / cpu - 1.0).abs() < 1e-3, "step {step}: {own} and {cpu}");
    }
    assert_eq!(end.gaussians.count, cpu.gaussians.count);
    assert!(apart(end.gaussians.group(POSITION), cpu.gaussians.group(POSITION)) < 1e-2);
    let (again, same) = trained(true).expect("as before");
    assert!(again == losses && same == end, "the same device, other bytes");
}

#[test]
fn a_step_that_is_not_finite_changes_nothing() {
    let Some(adapter) = adapter() else { return };
    let (model, mut options) = (model(), options());
    // Means of such values are not finite, and count for nothing.
    options.pyramid_share = 0.0;
    let mut views = views(&parameters(COUNT, 1), 1);
    let mut image = (*views[0].image).clone();
    image.values.iter_mut().for_each(|value| *value = f32::MAX);
    views[0].image = image.into();
    views[0].ceiling.clear();
    let start = parameters(COUNT, 2);
    let device = adapter.open(&model, &options).expect("opened").expect("known");
    let trainer = Trainer::new(&model, views, start.clone(), options, BOUNDS, None).expect("sound");
    let mut trainer = trainer.on(device);
    let report = trainer.step().expect("a rejected step is no error");
    assert!(report.rejected.is_some());
    trainer.fetch().expect("fetched");
    assert!(trainer.parameters() == &start && trainer.rejected() == 1);
}

#[test]
fn a_table_beyond_the_device_is_refused_in_a_line() {
    let Some(adapter) = adapter() else { return };
    let (model, options) = (model(), options());
    let views = views(&parameters(10, 1), 1);
    let device = adapter.open(&model, &options).expect("opened").expect("known");
    // Lavapipe binds 128 MiB, which is half a million Gaussians.
    let mut start = parameters(1, 2);
    start.gaussians = start.gaussians.gather(&vec![0; 700_000]);
    let trainer = Trainer::new(&model, views, start, options, BOUNDS, None).expect("sound");
    let mut trainer = trainer.on(device);
    let Err(TrainError::Device(reason)) = trainer.step() else {
        return;
    };
    assert!(
        reason.contains("too little memory") && !reason.contains('\n'),
        "{reason}"
    );
}

#[test]
fn a_lost_device_is_told_in_a_line_with_the_way_back() {
    let Some(adapter) = adapter() else { return };
    let (model, options) = (model(), options());
    let views = views(&parameters(10, 1), 1);
    let device = adapter.radiance().expect("opened");
    device.lose();
    let trainer = Trainer::new(&model, views, parameters(10, 2), options, BOUNDS, None).expect("sound");
    let error = trainer.on(Box::new(device)).step().expect_err("the device is lost");
    let told = error.to_string();
    assert!(told.contains("--device cpu") && !told.contains('\n'), "{told}");
    assert!(told.starts_with(DeviceSource::name(&adapter)), "{told}");
}
