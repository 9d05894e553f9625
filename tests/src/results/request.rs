//! Options of the command `results`.

use super::arena::Arena;
use std::path::{Path, PathBuf};

/// Seeds on which no constant was chosen.
const SEEDS: [u64; 3] = [11, 12, 13];
/// `sweep` for the surface without training, then the presets of `train`.
pub(super) const PRESETS: [&str; 4] = ["sweep", "fast", "balanced", "accurate"];

/// Options of a measurement and its page.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// File of the page.
    pub out: PathBuf,
    /// Program to measure.
    pub program: PathBuf,
    /// Folder of scenes, runs and records.
    pub work: PathBuf,
    /// Arenas to measure, in this order.
    pub arenas: Vec<Arena>,
    /// Seeds of the scenes, or of training where the scene is fixed.
    pub seeds: Vec<u64>,
    /// Presets to measure, among them `sweep`.
    pub presets: Vec<String>,
    /// True if only the page is written.
    pub page_only: bool,
}

impl Request {
    /// Parses the arguments of the command line.
    ///
    /// # Errors
    /// A sentence with the unknown option or value, or the missing value.
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

/// The element of `known` with this name; the error lists all names.
fn named<T: Copy>(name: &str, known: &[T], name_of: impl Fn(T) -> &'static str) -> Result<T, String> {
    let names: Vec<&str> = known.iter().map(|&one| name_of(one)).collect();
    known
        .iter()
        .copied()
        .find(|&one| name_of(one) == name)
        .ok_or_else(|| format!("{name}: not one of {}", names.join(", ")))
}
