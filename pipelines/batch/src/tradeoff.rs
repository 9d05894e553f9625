//! The trainings that measure speed against accuracy on the user's own scenes, each a process of its own.

use crate::BatchError;
use heliosplat_fitting::program::identity_of_program;
use heliosplat_pages::tradeoff::Row;
use heliosplat_pages::tradeoff::points::{Point, Seeds};
use heliosplat_raster::bounded::read_text;
use heliosplat_raster::write::write_atomically;
use heliosplat_session::Session;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Trainings of a trade-off between time and accuracy: scenes, presets and seeds.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// The scenes, all with every point.
    pub scenes: Vec<PathBuf>,
    /// The ways to train.
    pub points: Vec<Point>,
    /// Seeds 1 to this.
    pub seeds: u64,
    /// Threads of each training; all where not said.
    pub threads: Option<usize>,
    /// Folder of the runs and results.
    pub out: PathBuf,
}

/// A training to be made.
struct Job<'a> {
    scene: &'a Path,
    scene_name: String,
    point: &'a Point,
    seed: u64,
    folder: PathBuf,
}

impl Sweep {
    fn jobs(&self) -> Vec<Job<'_>> {
        let mut jobs = Vec::new();
        for (number, scene) in self.scenes.iter().enumerate() {
            let name = scene
                .file_name()
                .unwrap_or(scene.as_os_str())
                .to_string_lossy()
                .into_owned();
            let name = if self.scenes.len() > 1 {
                format!("{}-{name}", number + 1)
            } else {
                name
            };
            for point in &self.points {
                let seeds = match point.seeds {
                    Seeds::First => 1,
                    Seeds::All => self.seeds,
                };
                jobs.extend((1..=seeds).map(|seed| Job {
                    scene,
                    scene_name: name.clone(),
                    folder: self.out.join("runs").join(&name).join(format!("{}-{seed}", point.name)),
                    point,
                    seed,
                }));
            }
        }
        jobs
    }

    /// Trains everything that is not there yet and returns one row per training.
    ///
    /// # Errors
    /// When a training fails, or the user stops.
    pub fn run(&self, session: &Session) -> Result<Vec<Row>, BatchError> {
        session.stop_gently();
        let jobs = self.jobs();
        let progress = session.progress("trainings", jobs.len() as u64);
        let mut rows = Vec::new();
        for (done, job) in jobs.iter().enumerate() {
            progress.message(&format!("{} {} seed {}", job.scene_name, job.point.name, job.seed));
            if session.stopped() {
                return Err(BatchError::Interrupted(format!(
                    "stopped; the {done} trainings that are done are kept, run the same command to go on"
                )));
            }
            rows.push(row(job, &self.train(job, session)?));
            progress.set(done as u64 + 1);
            tracing::info!(
                "trained {} of {}: {}, seed {}",
                done + 1,
                jobs.len(),
                job.point.name,
                job.seed
            );
        }
        Ok(rows)
    }

    /// The metrics of a job: of an earlier training with the same arguments, or of one made now.
    fn train(&self, job: &Job, session: &Session) -> Result<Value, BatchError> {
        let mut arguments = vec![
            "train".to_owned(),
            canonical(job.scene),
            "--seed".to_owned(),
            job.seed.to_string(),
        ];
        arguments.extend(job.point.arguments());
        if let Some(threads) = self.threads {
            arguments.extend(["--threads".to_owned(), threads.to_string()]);
        }
        let said = format!("{}{}\n", identity_of_program(), arguments.join(" "));
        let stamp = job.folder.join("tradeoff.txt");
        let done = read_text(&stamp).is_ok_and(|before| before == said);
        if let Some(metrics) = metrics(&job.folder).filter(|_| done) {
            return Ok(metrics);
        }
        let failed = |reason: String| BatchError::Failed(format!("{}: {reason}", job.folder.display()));
        let program =
            std::env::current_exe().map_err(|error| failed(format!("this program is not found ({error})")))?;
        let output = Command::new(program)
            .args(&arguments)
            .arg("--out")
            .arg(&job.folder)
            .arg("--overwrite")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .output()
            .map_err(|error| failed(format!("the training cannot be started ({error})")))?;
        if session.stopped() || output.status.code() == Some(130) {
            return Err(BatchError::Interrupted(
                "stopped; finished trainings are kept, run the same command to go on".into(),
            ));
        }
        if !output.status.success() {
            let text = String::from_utf8_lossy(&output.stderr).into_owned();
            let line = text.lines().rev().find_map(|line| line.strip_prefix("error: "));
            let line = line.unwrap_or("the training stopped without saying why").to_owned();
            return Err(match output.status.code() {
                Some(2) => BatchError::Refused(line),
                _ => failed(line),
            });
        }
        let metrics = metrics(&job.folder).ok_or_else(|| failed("metrics.json is missing".into()))?;
        write_atomically(&stamp, said.as_bytes())?;
        Ok(metrics)
    }
}

/// The whole path of a scene, so that a run is the same from wherever it was asked for.
fn canonical(path: &Path) -> String {
    std::fs::canonicalize(path)
        .unwrap_or_else(|_| path.to_owned())
        .to_string_lossy()
        .into_owned()
}

fn metrics(folder: &Path) -> Option<Value> {
    serde_json::from_str(&read_text(&folder.join("metrics.json")).ok()?).ok()
}

/// Processor seconds of all stages together.
fn processor_seconds(metrics: &Value) -> Option<f64> {
    let stages = metrics["timeline"].as_array()?;
    stages.iter().map(|stage| stage["processor_s"].as_f64()).sum()
}

fn row(job: &Job, metrics: &Value) -> Row {
    let number = |pointer: &str| metrics.pointer(pointer).and_then(Value::as_f64);
    let steps = number("/iterations").unwrap_or(f64::NAN);
    // Without training the surface is the initial one: what stands at an edge is undecided still.
    let surface = if steps == 0.0 { "start" } else { "dsm" };
    Row {
        scene: job.scene_name.clone(),
        point: job.point.name.clone(),
        seed: job.seed,
        seconds: number("/seconds").unwrap_or(f64::NAN),
        processor_s: processor_seconds(metrics).unwrap_or(f64::NAN),
        peak_bytes: number("/peak_rss_bytes").unwrap_or(f64::NAN),
        gaussians: number("/gaussians").unwrap_or(f64::NAN),
        steps,
        mae_m: number(&format!("/{surface}/mae_m")),
        median_m: number(&format!("/{surface}/median_m")),
        // As traced: what a component is worth to the geometry, not what images make of it.
        shadows_right: number("/shadow/traced/accuracy").or(number("/shadow/accuracy")),
        psnr_train: number("/train/psnr"),
        psnr_held_out: number("/test/psnr"),
    }
}
