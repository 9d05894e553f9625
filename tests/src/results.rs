//! The page of results: which runs are measured, what is kept of each, and the tables that are made of them.
//!
//! Every run of the program is one [`Record`], a line of JSON in the work folder. The page is assembled from the records
//! alone, so that arenas can be measured one after another, on different days, and a table is never written by hand.

use crate::measured::{Measured, run_program};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::hash::Hasher as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Seeds on which no constant was chosen.
const SEEDS: [u64; 3] = [11, 12, 13];
/// The surface without training, then the presets of `train`.
const PRESETS: [&str; 4] = ["sweep", "fast", "balanced", "accurate"];
/// Training of objects: one preset.
const OBJECT_PRESET: &str = "fast";
/// No run takes this long.
const LIMIT: Duration = Duration::from_secs(6 * 3600);

/// What is measured on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Arena {
    /// Synthetic site of 128 m × 128 m.
    Block,
    /// Synthetic site of 256 m × 256 m.
    City,
    /// A city rendered by an independent path tracer.
    CityB,
    /// Real images of DFC2019.
    Jax068,
    /// Synthetic object, one light at a time.
    Olat,
    /// Synthetic object in bright surroundings.
    Reflective,
}

impl Arena {
    const ALL: [Self; 6] = [
        Self::Block,
        Self::City,
        Self::CityB,
        Self::Jax068,
        Self::Olat,
        Self::Reflective,
    ];

    /// As the option `--arenas` names it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Block => "block",
            Self::City => "city",
            Self::CityB => "cityb",
            Self::Jax068 => "jax068",
            Self::Olat => "olat",
            Self::Reflective => "reflective",
        }
    }

    fn is_object(self) -> bool {
        matches!(self, Self::Olat | Self::Reflective)
    }

    /// Heading, what the arena is, how it is measured, and the commands.
    fn head(self) -> [&'static str; 3] {
        match self {
            Self::Block => [
                "Synthetic block",
                "128 m × 128 m, 12 views of 0.5 m, 10 of them trained on. Exact truth. Protocol `raw`. The seed is that of the site.",
                "`synth satellite --site block --seed SEED --out SCENE`, then `train SCENE --preset PRESET --out RUN`; sweep: `dsm SCENE --from sweep --out DSM`, then `evaluate --dsm DSM --truth TRUTH`",
            ],
            Self::City => [
                "Synthetic city",
                "256 m × 256 m, 16 views of 0.5 m, 14 of them trained on. Exact truth. Protocol `raw`. The seed is that of the site.",
                "`synth satellite --site city --seed SEED --out SCENE`, then as for the block",
            ],
            Self::CityB => [
                "Independent city",
                "12 views of 0.5 m, RGB, rendered by a path tracer that is no part of this project. All views are trained on, without any truth beside them. Protocol `raw`. The seed is that of training.",
                "`train SCENE --preset PRESET --seed SEED --out RUN`, then `evaluate --dsm RUN/dsm.tif --truth TRUTH --classes CLASSES`",
            ],
            Self::Jax068 => [
                "DFC2019 JAX_068",
                "19 real WorldView-3 crops of 0.33 m, RGB, split and bundle-adjusted RPCs of Sat-NeRF, lidar truth. Protocol `aligned`. The seed is that of training. Data: DFC2019, IEEE DataPort; US3D by JHU/APL, images courtesy DigitalGlobe.",
                "`train SCENE --preset PRESET --seed SEED --out RUN`, then `evaluate --dsm RUN/dsm.tif --truth TRUTH --classes CLASSES --protocol aligned`",
            ],
            Self::Olat => [
                "Synthetic object, one light at a time",
                "Brushed metal, 128 × 128 pixels, 40 held-out images, half of them under lights far from those of training. PSNR of linear values.",
                "`synth olat --look brushed --size 128 --seed SEED --out SCENE`, then `train SCENE --preset fast --out RUN`",
            ],
            Self::Reflective => [
                "Synthetic reflective object",
                "Clear coat, 128 × 128 pixels, 20 held-out images. PSNR of display values.",
                "`synth reflective --look glossy --size 128 --seed SEED --out SCENE`, then `train SCENE --preset fast --out RUN`",
            ],
        }
    }

    fn columns(self) -> &'static [Column] {
        match self {
            Self::Block | Self::City => &SURFACE,
            Self::CityB => &SURFACE_WITHOUT_IMAGES,
            Self::Jax068 => &SURFACE_WITH_IMAGES,
            Self::Olat => &OLAT,
            Self::Reflective => &REFLECTIVE,
        }
    }

    /// What a reader must know of the columns.
    fn note(self) -> &'static str {
        match self {
            Self::Block | Self::City => {
                "BER is the balanced error rate of shadow masks of the images trained on. \"With the image\" uses the image itself to place the border of each traced shadow; \"traced\" does not. PSNR is of held-out images, with the colour of an image of the same day."
            }
            _ => "",
        }
    }
}

/// One column of a table.
struct Column {
    head: &'static str,
    /// Key of [`Record::numbers`].
    key: &'static str,
    factor: f64,
    decimals: usize,
}

const fn column(head: &'static str, key: &'static str, factor: f64, decimals: usize) -> Column {
    Column {
        head,
        key,
        factor,
        decimals,
    }
}

const MAE: Column = column("MAE m", "/dsm/mae_m", 1.0, 3);
const MEDIAN: Column = column("median m", "/dsm/median_m", 1.0, 3);
const WITHIN: Column = column("within 1 m %", "/dsm/within_1m", 100.0, 1);
const COMPLETE: Column = column("completeness %", "/dsm/completeness", 100.0, 1);
const HELD_OUT: Column = column("PSNR held out dB", "/test/psnr", 1.0, 2);
const TIME: Column = column("time s", SECONDS, 1.0, 0);
const MEMORY: Column = column("peak memory MiB", PEAK_BYTES, 1.0 / 1_048_576.0, 0);

const SURFACE: [Column; 10] = [
    MAE,
    MEDIAN,
    WITHIN,
    COMPLETE,
    column("BER with the image %", "/shadow/ber", 100.0, 1),
    column("BER traced %", "/shadow/traced/ber", 100.0, 1),
    HELD_OUT,
    column("the same, RGB dB", "/test/psnr_rgb", 1.0, 2),
    TIME,
    MEMORY,
];
const SURFACE_WITHOUT_IMAGES: [Column; 6] = [MAE, MEDIAN, WITHIN, COMPLETE, TIME, MEMORY];
const SURFACE_WITH_IMAGES: [Column; 7] = [MAE, MEDIAN, WITHIN, COMPLETE, HELD_OUT, TIME, MEMORY];
const NORMALS: Column = column("normals off °", "/test/normals/mean_deg", 1.0, 1);
const SSIM: Column = column("SSIM", "/test/ssim", 1.0, 3);
const OLAT: [Column; 7] = [
    HELD_OUT,
    column("near dB", "/test/near/psnr", 1.0, 2),
    column("far dB", "/test/far/psnr", 1.0, 2),
    SSIM,
    NORMALS,
    TIME,
    MEMORY,
];
const REFLECTIVE: [Column; 5] = [HELD_OUT, SSIM, NORMALS, TIME, MEMORY];

/// Wall time of the command, seconds.
const SECONDS: &str = "seconds";
/// Most memory that the command held, bytes.
const PEAK_BYTES: &str = "peak_bytes";

/// What was measured in one run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Where.
    pub arena: Arena,
    /// The preset, or `sweep`.
    pub preset: String,
    /// The seed.
    pub seed: u64,
    /// What the program says of its version.
    pub version: String,
    /// Hash of the program's file: records of another program are not used.
    pub program: String,
    /// Day of the run.
    pub date: String,
    /// Cores and processor.
    pub machine: String,
    /// Numbers by their place in `metrics.json`, and [`SECONDS`] and [`PEAK_BYTES`] of the process.
    pub numbers: BTreeMap<String, f64>,
    /// Why nothing could be measured, if so.
    pub not_run: Option<String>,
}

/// What is asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// The page.
    pub out: PathBuf,
    /// The program measured.
    pub program: PathBuf,
    /// Scenes, runs and records.
    pub work: PathBuf,
    /// Where to measure.
    pub arenas: Vec<Arena>,
    /// Seeds.
    pub seeds: Vec<u64>,
    /// Presets, and `sweep`.
    pub presets: Vec<String>,
    /// Whether only the page is written.
    pub page_only: bool,
}

impl Request {
    /// The request of a command line.
    ///
    /// # Errors
    /// An option or a value that there is not.
    pub fn parse(words: &[String]) -> Result<Self, String> {
        let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let mut request = Self {
            out: workspace.join("docs/results.md"),
            program: workspace.join("target/release/heliosplat"),
            work: workspace.join("target/results"),
            arenas: Arena::ALL.to_vec(),
            seeds: SEEDS.to_vec(),
            presets: PRESETS.map(str::to_owned).to_vec(),
            page_only: false,
        };
        let mut words = words.iter();
        while let Some(option) = words.next() {
            if option == "--page-only" {
                request.page_only = true;
                continue;
            }
            let value = words.next().ok_or_else(|| format!("{option}: a value is missing"))?;
            let list = || value.split(',').map(str::trim).filter(|part| !part.is_empty());
            match option.as_str() {
                "--out" => request.out = value.into(),
                "--program" => request.program = value.into(),
                "--work" => request.work = value.into(),
                "--arenas" => {
                    request.arenas = list()
                        .map(|name| named(name, &Arena::ALL, Arena::name))
                        .collect::<Result<_, _>>()?;
                }
                "--presets" => {
                    request.presets = list()
                        .map(|name| named(name, &PRESETS, |preset| preset).map(str::to_owned))
                        .collect::<Result<_, _>>()?;
                }
                "--seeds" => {
                    request.seeds = list()
                        .map(|seed| seed.parse().map_err(|_| format!("--seeds: {seed} is no seed")))
                        .collect::<Result<_, _>>()?;
                }
                _ => return Err(format!("{option}: there is no such option")),
            }
        }
        Ok(request)
    }
}

/// The one of `known` that is called `name`.
fn named<T: Copy>(name: &str, known: &[T], name_of: impl Fn(T) -> &'static str) -> Result<T, String> {
    let names: Vec<&str> = known.iter().map(|&one| name_of(one)).collect();
    known
        .iter()
        .copied()
        .find(|&one| name_of(one) == name)
        .ok_or_else(|| format!("{name}: not one of {}", names.join(", ")))
}

/// Measures what has no record yet, then writes the page of all records of the program.
///
/// # Errors
/// When the program cannot be run, a command fails that should not, or a file cannot be written.
pub fn write(request: &Request) -> Result<(), String> {
    let bench = Bench::new(request)?;
    let mut records = bench.records()?;
    if !request.page_only {
        for &arena in &request.arenas {
            bench.measure(arena, &mut records)?;
        }
    }
    std::fs::write(&request.out, page(&records)).map_err(|fault| format!("{}: {fault}", request.out.display()))
}

/// A program and where its runs are kept.
struct Bench<'a> {
    request: &'a Request,
    version: String,
    program: String,
    machine: String,
}

impl<'a> Bench<'a> {
    fn new(request: &'a Request) -> Result<Self, String> {
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

    /// The records of this program.
    fn records(&self) -> Result<Vec<Record>, String> {
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

    /// Measures what an arena has no record of.
    fn measure(&self, arena: Arena, records: &mut Vec<Record>) -> Result<(), String> {
        let presets: Vec<&str> = match arena.is_object() {
            true => vec![OBJECT_PRESET],
            false => self.request.presets.iter().map(String::as_str).collect(),
        };
        for &seed in &self.request.seeds {
            for &preset in &presets {
                // Of a fixed scene the sweep is the same for every seed.
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

    /// Runs the program, which must succeed.
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

/// Why an arena has no scene.
enum NoScene {
    /// It is not here, or the program does not take it: the page says so.
    Absent(String),
    /// Something went wrong.
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

/// What the program said against a folder, without the place of the folder.
fn refusal(stderr: &str, folder: &Path) -> String {
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

/// What stands before the tables.
const HEAD: &str = "# Results

Written by `cargo run --release -p heliosplat-tests --bin results`; no figure here is written by hand. Constants and presets were chosen
on seeds 1 to 3 of `block` and `city`, so other seeds are measured here. Times are wall times of the whole command on a machine that may do
other work; memory is the most that its process held. `sweep` is the surface before training. What the protocols mean is in
[guide/evaluate.md](guide/evaluate.md), what was tried in [lab](lab/README.md).
";

/// The page.
pub fn page(records: &[Record]) -> String {
    let mut text = HEAD.to_owned();
    for arena in Arena::ALL {
        let of_arena: Vec<&Record> = records.iter().filter(|r| r.arena == arena).collect();
        if !of_arena.is_empty() {
            text.push('\n');
            text += &section(arena, &of_arena);
        }
    }
    text
}

fn section(arena: Arena, records: &[&Record]) -> String {
    let [title, what, how] = arena.head();
    let mut text = format!("## {title}\n\n{what}\n\n");
    // Writing to a String cannot fail.
    let measured: Vec<&Record> = records.iter().copied().filter(|r| r.not_run.is_none()).collect();
    if measured.is_empty() {
        let reason = records.iter().rev().find_map(|r| r.not_run.as_deref());
        let _ = writeln!(text, "Not run: {}", reason.unwrap_or_default());
        return text;
    }
    let columns: Vec<&Column> = arena
        .columns()
        .iter()
        .filter(|column| measured.iter().any(|r| r.numbers.contains_key(column.key)))
        .collect();
    let heads: Vec<&str> = columns.iter().map(|column| column.head).collect();
    let _ = writeln!(text, "| preset | seed | {} |", heads.join(" | "));
    let _ = writeln!(text, "|---|---|{}", "---|".repeat(columns.len()));
    for preset in PRESETS {
        let mut rows: Vec<&Record> = measured.iter().copied().filter(|r| r.preset == preset).collect();
        rows.sort_by_key(|r| r.seed);
        for row in &rows {
            let cells = columns
                .iter()
                .map(|column| cell(column, row.numbers.get(column.key).copied()));
            let _ = writeln!(
                text,
                "| {preset} | {} | {} |",
                row.seed,
                cells.collect::<Vec<_>>().join(" | ")
            );
        }
        if rows.len() > 1 {
            let cells = columns.iter().map(|column| cell(column, mean(&rows, column.key)));
            let _ = writeln!(
                text,
                "| **{preset}** | mean | {} |",
                cells.collect::<Vec<_>>().join(" | ")
            );
        }
    }
    if !arena.note().is_empty() {
        let _ = writeln!(text, "\n{}", arena.note());
    }
    let all = |pick: fn(&Record) -> String| {
        let mut values: Vec<String> = measured.iter().map(|r| pick(r)).collect();
        values.sort();
        values.dedup();
        values.join("; ")
    };
    let mut seeds: Vec<u64> = measured.iter().map(|r| r.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    let seeds: Vec<String> = seeds.iter().map(u64::to_string).collect();
    let _ = writeln!(
        text,
        "\nCommands: {how}. Version: {}. Seeds: {}. Date: {}. Machine: {}.",
        all(|r| r.version.clone()),
        seeds.join(", "),
        all(|r| r.date.clone()),
        all(|r| r.machine.clone()),
    );
    text
}

fn cell(column: &Column, value: Option<f64>) -> String {
    value.map_or_else(
        || "–".to_owned(),
        |value| format!("{:.*}", column.decimals, value * column.factor),
    )
}

/// The mean of a number over records that all have it.
fn mean(records: &[&Record], key: &str) -> Option<f64> {
    let values: Option<Vec<f64>> = records.iter().map(|r| r.numbers.get(key).copied()).collect();
    values.map(|values| values.iter().sum::<f64>() / values.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(seed: u64, mae_m: f64) -> Record {
        let numbers = [
            ("/dsm/mae_m", mae_m),
            ("/dsm/within_1m", 0.95),
            (SECONDS, 61.4),
            (PEAK_BYTES, 300.0 * 1_048_576.0),
        ];
        Record {
            arena: Arena::Block,
            preset: "fast".to_owned(),
            seed,
            version: "heliosplat 1.2.3".to_owned(),
            program: "0123456789abcdef".to_owned(),
            date: "2026-02-03".to_owned(),
            machine: "2 cores".to_owned(),
            numbers: numbers.map(|(key, value)| (key.to_owned(), value)).into(),
            not_run: None,
        }
    }

    #[test]
    fn a_table_has_a_row_for_each_record_and_their_mean() {
        let page = page(&[record(12, 0.5), record(11, 0.4)]);
        let table: Vec<&str> = page.lines().filter(|line| line.starts_with('|')).collect();
        assert_eq!(
            table,
            [
                "| preset | seed | MAE m | within 1 m % | time s | peak memory MiB |",
                "|---|---|---|---|---|---|",
                "| fast | 11 | 0.400 | 95.0 | 61 | 300 |",
                "| fast | 12 | 0.500 | 95.0 | 61 | 300 |",
                "| **fast** | mean | 0.450 | 95.0 | 61 | 300 |",
            ]
        );
        let foot = "Version: heliosplat 1.2.3. Seeds: 11, 12. Date: 2026-02-03. Machine: 2 cores.";
        assert!(page.lines().last().is_some_and(|line| line.ends_with(foot)), "{page}");
    }

    #[test]
    fn what_could_not_be_run_says_why() {
        let refused = Record {
            arena: Arena::Jax068,
            numbers: BTreeMap::new(),
            not_run: Some(refusal(
                "x\nerror: /data/jax068: holds several scenes",
                Path::new("/data/jax068"),
            )),
            ..record(11, 0.0)
        };
        assert!(page(&[refused]).ends_with("Not run: jax068: holds several scenes\n"));
    }

    #[test]
    fn options_that_do_not_exist_are_named() {
        let parse = |text: &str| Request::parse(&text.split(' ').map(str::to_owned).collect::<Vec<_>>());
        let request = parse("--arenas block,olat --seeds 21 --presets fast --out page.md").expect("sound options");
        assert_eq!(request.arenas, [Arena::Block, Arena::Olat]);
        assert_eq!((request.seeds, request.presets), (vec![21], vec!["fast".to_owned()]));
        for text in ["--arenas blok", "--seeds x", "--presets quick", "--colour red", "--out"] {
            let fault = parse(text).expect_err(text);
            assert!(text.split(' ').any(|word| fault.contains(word)), "{fault}");
        }
    }
}
