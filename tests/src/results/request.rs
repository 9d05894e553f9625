//! Options of the command.

use super::arena::Arena;
use std::path::{Path, PathBuf};

/// Seeds on which no constant was chosen.
const SEEDS: [u64; 3] = [11, 12, 13];
/// The surface without training, then the presets of `train`.
pub(super) const PRESETS: [&str; 4] = ["sweep", "fast", "balanced", "accurate"];

/// Request of a page.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// The page.
    pub out: PathBuf,
    /// The program measured.
    pub program: PathBuf,
    /// Scenes, runs and records.
    pub work: PathBuf,
    /// Arenas to measure.
    pub arenas: Vec<Arena>,
    /// Seeds.
    pub seeds: Vec<u64>,
    /// Presets, and `sweep`.
    pub presets: Vec<String>,
    /// True if only the page is written.
    pub page_only: bool,
}

impl Request {
    /// The request of a command line.
    ///
    /// # Errors
    /// An unknown option or value.
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
