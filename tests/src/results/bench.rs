//! Runs the program on the arenas and records the measurements.

use super::arena::{Arena, PEAK_BYTES, Record, SECONDS};
use super::request::Request;
use crate::measured::{Measured, run_program};
use serde_json::Value;
use std::collections::BTreeMap;
use std::hash::Hasher as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Only preset of the trainings of objects.
const OBJECT_PRESET: &str = "fast";
/// Time after which a run is killed, longer than any run takes.
const LIMIT: Duration = Duration::from_secs(6 * 3600);

/// A program to measure and the work folder of its runs.
pub(super) struct Bench<'a> {
    request: &'a Request,
    version: String,
    program: String,
    machine: String,
}

impl<'a> Bench<'a> {
    /// Reads the version of the program and the hash of its file, and makes the work folder.
    ///
    /// # Errors
    /// A sentence with the program or folder at fault.
    pub(super) fn new(request: &'a Request) -> Result<Self, String> {
        let bytes = std::fs::read(&request.program)
            .map_err(|fault| format!("{}: {fault}; build it with make build", request.program.display()))?;
        let mut hasher = std::hash::DefaultHasher::new();
        hasher.write(&bytes);
        std::fs::create_dir_all(&request.work).map_err(|fault| format!("{}: {fault}", request.work.display()))?;
        let said = run_program(&request.program, &["--version"], LIMIT);
        Ok(Self {
            request,
            version: said.stdout.trim().to_owned(),
            program: format!("{:016x}", hasher.finish()),
            machine: machine(),
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.request.work.join(name)
    }

    /// Reads the records of this program from the work folder; none without a file of records.
    ///
    /// # Errors
    /// A sentence with the file that cannot be read.
    pub(super) fn records(&self) -> Result<Vec<Record>, String> {
        let path = self.path("records.jsonl");
        if !path.exists() {
            return Ok(Vec::new());
        }
        let text = std::fs::read_to_string(&path).map_err(|fault| format!("{}: {fault}", path.display()))?;
        let records: Vec<Record> = text
            .lines()
            .map(|line| serde_json::from_str(line).map_err(|fault| format!("{}: {fault}", path.display())))
            .collect::<Result<_, _>>()?;
        Ok(records.into_iter().filter(|r| r.program == self.program).collect())
    }

    fn keep(&self, record: Record, records: &mut Vec<Record>) -> Result<(), String> {
        let path = self.path("records.jsonl");
        let line = serde_json::to_string(&record).map_err(|fault| fault.to_string())?;
        std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .and_then(|mut file| writeln!(file, "{line}"))
            .map_err(|fault| format!("{}: {fault}", path.display()))?;
        records.push(record);
        Ok(())
    }

    fn record(&self, arena: Arena, preset: &str, seed: u64) -> Record {
        Record {
            arena,
            preset: preset.to_owned(),
            seed,
            version: self.version.clone(),
            program: self.program.clone(),
            date: jiff::Zoned::now().date().to_string(),
            machine: self.machine.clone(),
            numbers: BTreeMap::new(),
            not_run: None,
        }
    }

    /// Measures the runs of an arena that have no record. A missing scene is recorded as such.
    ///
    /// # Errors
    /// A sentence with the command or file at fault.
    pub(super) fn measure(&self, arena: Arena, records: &mut Vec<Record>) -> Result<(), String> {
        let presets: Vec<&str> = match arena.is_object() {
            true => vec![OBJECT_PRESET],
            false => self.request.presets.iter().map(String::as_str).collect(),
        };
        for &seed in &self.request.seeds {
            for &preset in &presets {
                // The sweep of a fixed scene is the same for every seed.
                let fixed = matches!(arena, Arena::CityB | Arena::Jax068) && preset == "sweep";
                let same = |r: &Record| r.arena == arena && r.preset == preset && (fixed || r.seed == seed);
                if records.iter().any(|r| same(r) && r.not_run.is_none()) {
                    continue;
                }
                eprintln!("{} {preset} seed {seed}", arena.name());
                let mut record = self.record(arena, preset, seed);
                match self.scene(arena, seed) {
                    Ok(scene) => record.numbers = self.run(arena, &scene, preset, seed)?,
                    Err(NoScene::Absent(reason)) => {
                        // Once for the arena: its other seeds and presets lack the same scene.
                        record.not_run = Some(reason);
                        return self.keep(record, records);
                    }
                    Err(NoScene::Fault(fault)) => return Err(fault),
                }
                self.keep(record, records)?;
            }
        }
        Ok(())
    }

    /// The scene of an arena, made or copied where it is not there yet.
    fn scene(&self, arena: Arena, seed: u64) -> Result<Scene, NoScene> {
        let absent = || NoScene::Absent("the shared data are not here".to_owned());
        match arena {
            Arena::Block | Arena::City => {
                let folder = self.synthesised(arena, seed, &["satellite", "--site", arena.name()])?;
                let truth = folder.join("truth");
                Ok(Scene {
                    folder,
                    truth: Some((truth.join("dsm.tif"), truth.join("classes.tif"))),
                    protocol: "raw",
                })
            }
            Arena::Olat => self.object(arena, seed, &["olat", "--look", "brushed", "--size", "128"]),
            Arena::Reflective => self.object(arena, seed, &["reflective", "--look", "glossy", "--size", "128"]),
            Arena::CityB => {
                let source = shared("data/cityB").ok_or_else(absent)?;
                let folder = self.path("cityb");
                copy_files(&source, &folder)?;
                Ok(Scene {
                    folder,
                    truth: Some((source.join("truth/dsm.tif"), source.join("truth/class.tif"))),
                    protocol: "raw",
                })
            }
            Arena::Jax068 => {
                let source = shared("data/jax068").ok_or_else(absent)?;
                let inspected = self.call(&["inspect".as_ref(), source.as_os_str()]);
                if inspected.code != Some(0) {
                    return Err(NoScene::Absent(refusal(&inspected.stderr, &source)));
                }
                let truth = source.join("DFC2019/Track3-Truth");
                Ok(Scene {
                    folder: source,
                    truth: Some((truth.join("JAX_068_DSM.tif"), truth.join("JAX_068_CLS.tif"))),
                    protocol: "aligned",
                })
            }
        }
    }

    fn object(&self, arena: Arena, seed: u64, words: &[&str]) -> Result<Scene, NoScene> {
        Ok(Scene {
            folder: self.synthesised(arena, seed, words)?,
            truth: None,
            protocol: "raw",
        })
    }

    /// A synthesised scene; one that was begun and not finished is made again.
    fn synthesised(&self, arena: Arena, seed: u64, words: &[&str]) -> Result<PathBuf, String> {
        let name = format!("{}_{seed}", arena.name());
        let (folder, unfinished) = (self.path(&name), self.path(&format!("{name}.part")));
        if folder.exists() {
            return Ok(folder);
        }
        remove(&unfinished)?;
        let seed = seed.to_string();
        let mut arguments: Vec<&std::ffi::OsStr> = vec!["synth".as_ref()];
        arguments.extend(words.iter().map(|word| std::ffi::OsStr::new(*word)));
        arguments.extend([
            "--seed".as_ref(),
            seed.as_ref(),
            "--out".as_ref(),
            unfinished.as_os_str(),
        ]);
        self.must(&arguments)?;
        std::fs::rename(&unfinished, &folder).map_err(|fault| format!("{}: {fault}", folder.display()))?;
        Ok(folder)
    }

    /// Trains, or sweeps, and measures.
    fn run(&self, arena: Arena, scene: &Scene, preset: &str, seed: u64) -> Result<BTreeMap<String, f64>, String> {
        let name = format!("{}_{seed}_{preset}", arena.name());
        let (mut metrics, measured, dsm) = if preset == "sweep" {
            let dsm = self.path(&format!("{name}.tif"));
            let words: [&std::ffi::OsStr; 6] = [
                "dsm".as_ref(),
                scene.folder.as_ref(),
                "--from".as_ref(),
                "sweep".as_ref(),
                "--out".as_ref(),
                dsm.as_ref(),
            ];
            (Value::Object(serde_json::Map::new()), self.must(&words)?, dsm)
        } else {
            let run = self.path(&name);
            remove(&run)?;
            // The seed of a synthesised scene is that of the site, and training keeps its default.
            let training_seed = match arena {
                Arena::CityB | Arena::Jax068 => seed.to_string(),
                _ => "1".to_owned(),
            };
            let words: [&std::ffi::OsStr; 8] = [
                "train".as_ref(),
                scene.folder.as_ref(),
                "--preset".as_ref(),
                preset.as_ref(),
                "--seed".as_ref(),
                training_seed.as_ref(),
                "--out".as_ref(),
                run.as_ref(),
            ];
            let measured = self.must(&words)?;
            let path = run.join("metrics.json");
            let text = std::fs::read_to_string(&path).map_err(|fault| format!("{}: {fault}", path.display()))?;
            let metrics = serde_json::from_str(&text).map_err(|fault| format!("{}: {fault}", path.display()))?;
            (metrics, measured, run.join("dsm.tif"))
        };
        if let Some((truth, classes)) = &scene.truth {
            let words: [&std::ffi::OsStr; 10] = [
                "evaluate".as_ref(),
                "--dsm".as_ref(),
                dsm.as_ref(),
                "--truth".as_ref(),
                truth.as_ref(),
                "--classes".as_ref(),
                classes.as_ref(),
                "--protocol".as_ref(),
                scene.protocol.as_ref(),
                "--json".as_ref(),
            ];
            let said = self.must(&words)?.stdout;
            let evaluated: Value = serde_json::from_str(&said).map_err(|fault| format!("evaluate --json: {fault}"))?;
            metrics["dsm"] = evaluated["dsm"].clone();
        }
        Ok(numbers(arena, &metrics, &measured))
    }

    fn call<S: AsRef<std::ffi::OsStr>>(&self, arguments: &[S]) -> Measured {
        run_program(&self.request.program, arguments, LIMIT)
    }

    /// Runs the program; a failure is the error.
    fn must<S: AsRef<std::ffi::OsStr>>(&self, arguments: &[S]) -> Result<Measured, String> {
        let measured = self.call(arguments);
        if measured.code == Some(0) {
            return Ok(measured);
        }
        let words: Vec<_> = arguments.iter().map(|word| word.as_ref().to_string_lossy()).collect();
        Err(format!(
            "heliosplat {} ended with {:?}: {}",
            words.join(" "),
            measured.code,
            measured.stderr.lines().last().unwrap_or_default()
        ))
    }
}

/// Reason why an arena has no scene.
enum NoScene {
    /// The scene is missing, or the program does not accept it; the page states the reason.
    Absent(String),
    /// A command failed or a file could not be read or written.
    Fault(String),
}

impl From<String> for NoScene {
    fn from(fault: String) -> Self {
        Self::Fault(fault)
    }
}

/// A scene and the truth it is measured against.
struct Scene {
    folder: PathBuf,
    /// Surface model and classes.
    truth: Option<(PathBuf, PathBuf)>,
    protocol: &'static str,
}

/// The numbers that the table of an arena shows.
fn numbers(arena: Arena, metrics: &Value, measured: &Measured) -> BTreeMap<String, f64> {
    let mut numbers: BTreeMap<String, f64> = arena
        .columns()
        .iter()
        .filter_map(|column| Some((column.key.to_owned(), metrics.pointer(column.key)?.as_f64()?)))
        .collect();
    numbers.insert(SECONDS.to_owned(), measured.took.as_secs_f64());
    numbers.insert(PEAK_BYTES.to_owned(), measured.peak_bytes as f64);
    numbers
}

/// The program's refusal of a folder, without the path of the folder.
pub(super) fn refusal(stderr: &str, folder: &Path) -> String {
    let line = stderr.lines().find_map(|line| line.strip_prefix("error: "));
    let parent = folder.parent().unwrap_or(folder).display().to_string();
    line.unwrap_or("refused without a reason")
        .replace(&format!("{parent}/"), "")
}

/// A folder of the shared material, if it is here.
fn shared(relative: &str) -> Option<PathBuf> {
    let root = std::env::var_os("HELIOSPLAT_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"),
        PathBuf::from,
    );
    let path = root.join(relative);
    path.exists().then(|| std::fs::canonicalize(&path).unwrap_or(path))
}

/// Copies the files of a folder, not its folders.
fn copy_files(from: &Path, to: &Path) -> Result<(), String> {
    let copy = || -> std::io::Result<()> {
        std::fs::create_dir_all(to)?;
        for entry in std::fs::read_dir(from)? {
            let entry = entry?;
            let target = to.join(entry.file_name());
            if entry.file_type()?.is_file() && !target.exists() {
                std::fs::write(target, std::fs::read(entry.path())?)?;
            }
        }
        Ok(())
    };
    copy().map_err(|fault| format!("{}: {fault}", from.display()))
}

/// Removes a folder, if it is there.
fn remove(folder: &Path) -> Result<(), String> {
    match folder.exists() {
        true => std::fs::remove_dir_all(folder).map_err(|fault| format!("{}: {fault}", folder.display())),
        false => Ok(()),
    }
}

/// Cores and processor of this machine.
fn machine() -> String {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(':'))
        .map(|(_, name)| format!(", {}", name.trim()))
        .unwrap_or_default();
    format!("{cores} {}{model}", if cores == 1 { "core" } else { "cores" })
}
