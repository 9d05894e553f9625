//! Fit of a model to a capture: selection of the model, initial Gaussians, training.

use super::capture::{Capture, Frame};
use super::config::ObjectConfigs;
use super::model::{self, ObjectImage, ObjectModel};
use super::plan::{self, Plan};
use super::prepare;
use super::{measure, views};
use heliosplat::model::View;
use heliosplat::timeline::stage;
use heliosplat::train::{CameraTurn, Trainer};
use heliosplat_fitting::budget::Budget;
use heliosplat_fitting::checkpoint::{CheckpointWriter, LoadedCheckpoint};
use heliosplat_fitting::curve::CurvePoint;
use heliosplat_fitting::request::TrainDevice;
use heliosplat_fitting::training::{Ending, TrainingError, train};
use heliosplat_scene::Split;
use heliosplat_session::Session;
use heliosplat_session::log::grouped;
use std::time::Instant;

/// A trained model, with the plan and the course of its training.
pub struct Fitted {
    /// The trained model.
    pub model: ObjectModel,
    /// The fitted model and the reasons for it.
    pub plan: Plan,
    /// Place of the initial Gaussians, in words.
    pub start: &'static str,
    /// Initial number of Gaussians.
    pub started: usize,
    /// Number of steps done.
    pub iterations: usize,
    /// Steps rejected because of a number that is not finite.
    pub rejected: usize,
    /// Seconds before the training, and of the training.
    pub seconds: [f64; 2],
    /// Losses and accuracy during training.
    pub curve: Vec<CurvePoint>,
    /// Reason why the training ended.
    pub ending: Ending,
    /// Rotations of the training cameras.
    pub turns: Vec<CameraTurn>,
    /// Name of the device of the training.
    pub device: String,
}

/// Fits a model to `capture`, or continues from the `checkpoint` of an interrupted fit; `checkpoints` writes the state.
///
/// # Errors
/// [`TrainingError`] when a short fit or the training fails, or the state cannot be written.
pub fn fit(
    capture: &Capture,
    configs: &ObjectConfigs,
    session: &Session,
    budget: Option<Budget>,
    device: &TrainDevice,
    mut checkpoints: CheckpointWriter<Plan>,
    checkpoint: Option<LoadedCheckpoint<Plan>>,
) -> Result<Fitted, TrainingError> {
    let begun = Instant::now();
    let planned_before = checkpoint.as_ref().and_then(|before| before.preprocessed.clone());
    let part = stage("trials");
    let plan = planned_before.map_or_else(|| plan::plan(capture, &configs.lamps, session), Ok)?;
    drop(part);
    checkpoints.preprocessed = Some(plan.clone());
    let with_or_without = |has: bool| if has { "with" } else { "without" };
    tracing::info!(
        "model: {:?}, {} gloss, {} scattering ({})",
        plan.kind,
        with_or_without(plan.parts.specular),
        with_or_without(plan.parts.scattering),
        plan.reason
    );
    let planned = plan.parts.of(configs.of(plan.kind));
    let part = stage("start");
    let frames: Vec<&Frame> = capture.of(Split::Train).collect();
    let input = prepare::input(capture, plan.kind, &planned, &frames);
    let (kind, preparation, parameters) = (input.kind, input.preparation, input.parameters);
    tracing::info!("start: {} Gaussians {}", grouped(parameters.gaussians.count), input.how);
    let scene_model = kind.model();
    let views: Vec<View> = frames
        .iter()
        .enumerate()
        .filter_map(|(i, frame)| views::view(frame, capture.centre, &preparation, i))
        .collect();
    let mut options = planned.train.clone().for_views(views.len());
    options.gsd_m = capture.pixel_size as f32;
    let steps = options.iterations;
    let started = parameters.gaussians.count;
    let begins = parameters.globals.clone();
    drop(part);
    let part = stage("train");
    let prepared = begun.elapsed();
    let device = device.open(&*scene_model, &options)?;
    let mut trainer = Trainer::new(&*scene_model, views, parameters, options, input.bounds, None)?;
    if let Some(device) = device {
        tracing::info!("Cameras stay as they were given: {} does not turn them", device.name());
        trainer = trainer.on(device);
    } else if !trainer.may_turn_cameras() {
        tracing::info!(
            "Cameras stay as they were given: {steps} steps visit {} images too seldom to find their errors",
            trainer.views()
        );
    }
    if let Some(checkpoint) = checkpoint {
        tracing::info!(
            "Training continues after step {} of {steps}",
            checkpoint.trainer.steps()
        );
        checkpoints.log = checkpoint.log;
        trainer
            .restore(checkpoint.trainer)
            .map_err(|error| checkpoints.does_not_fit(&error))?;
    }
    let probe = measure::psnr_probe(capture, model::file(capture, kind.clone(), preparation, begins));
    let trained = train(trainer, steps, session, budget, checkpoints, probe.as_deref())?;
    drop(part);
    let mut file = model::file(capture, kind, preparation, trained.parameters.globals.clone());
    turn_cameras(&mut file.images, &trained.turns);
    Ok(Fitted {
        model: ObjectModel::new(file, trained.parameters),
        plan,
        start: input.how,
        started,
        iterations: trained.early_stop.steps,
        rejected: trained.rejected,
        seconds: [prepared.as_secs_f64(), (begun.elapsed() - prepared).as_secs_f64()],
        curve: trained.curve,
        ending: trained.ending,
        turns: trained.turns,
        device: trained.device,
    })
}

/// Turns the cameras of training images as the training did.
fn turn_cameras(images: &mut [ObjectImage], turns: &[CameraTurn]) {
    let Some(most) = turns.iter().map(|turn| turn.pixels).max_by(f64::total_cmp) else {
        return;
    };
    let mean = turns.iter().map(|turn| turn.pixels).sum::<f64>() / turns.len() as f64;
    tracing::warn!(
        "The cameras of the training images were off by {mean:.1} pixels, {most:.1} at most. They were turned about \
         their centres; held-out cameras are as given. A bundle adjustment of the capture may do better"
    );
    let mut trained: Vec<&mut ObjectImage> = images.iter_mut().filter(|image| image.split == Split::Train).collect();
    for turn in turns {
        if let Some(image) = trained.iter_mut().find(|image| image.name == turn.image) {
            image.camera = image.camera.turned(turn.radians.into());
        }
    }
}
