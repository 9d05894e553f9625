//! Settings in layers: the defaults of a configuration, then the text of a preset, then the user's settings.

/// Reason why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// A preset file that does not parse (a fault of the program, not of the user).
    /// Fields: the preset, error of the parser.
    #[error("preset {0}: {1}")]
    Preset(String, String),
    /// A value that is not allowed.
    #[error("{key} is {value}, expected {expected}")]
    Value {
        /// The key.
        key: String,
        /// The value.
        value: String,
        /// The values allowed.
        expected: &'static str,
    },
    /// A `--set` with an unknown key or a value of another kind.
    #[error("--set {key}={value}: {reason}; the keys are those of run.toml, such as train.iterations=2000")]
    Set {
        /// The key.
        key: String,
        /// The value.
        value: String,
        /// The fault.
        reason: String,
    },
}

impl ConfigError {
    /// Checks values. Each one comes with its key, a flag that is true if it is allowed, and a description of the
    /// values allowed.
    ///
    /// # Errors
    /// [`Self::Value`] for the first value that is not allowed.
    pub fn check(values: &[(&str, f64, bool, &'static str)]) -> Result<(), Self> {
        match values.iter().find(|(_, _, fits, _)| !fits) {
            Some(&(key, value, _, expected)) => {
                let (key, value) = (key.into(), value.to_string());
                Err(Self::Value { key, value, expected })
            }
            None => Ok(()),
        }
    }
}

/// Trade-off between time and quality of a training: the name of a file of settings.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Preset {
    /// Seconds, to check cameras, altitudes and suns (satellite scenes).
    Preview,
    /// A first look.
    Fast,
    /// The default.
    #[default]
    Balanced,
    /// Smaller errors.
    Accurate,
    /// Smallest errors, twice the time of accurate (satellite scenes).
    Best,
}

impl Preset {
    /// All presets, the most accurate first.
    pub const ALL: [Self; 5] = [Self::Best, Self::Accurate, Self::Balanced, Self::Fast, Self::Preview];

    /// Name of the preset on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Preview => "preview",
            Self::Fast => "fast",
            Self::Balanced => "balanced",
            Self::Accurate => "accurate",
            Self::Best => "best",
        }
    }
}

impl std::str::FromStr for Preset {
    type Err = ConfigError;

    fn from_str(text: &str) -> Result<Self, ConfigError> {
        let found = Self::ALL.into_iter().find(|preset| preset.name() == text);
        let expected = "preview, fast, balanced, accurate or best";
        let (key, value) = ("preset".into(), text.into());
        found.ok_or(ConfigError::Value { key, value, expected })
    }
}

/// Former settings in runs of earlier builds, which are ignored: group and name.
const RETIRED: [(&str, &str); 3] = [
    ("start", "step_opacity"),
    ("model", "opaqueness_weight"),
    ("train", "depth_normal_weight"),
];

/// Content of a `run.toml`, without former settings.
///
/// # Errors
/// One sentence with the fault of the TOML.
pub fn run_of<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, String> {
    let run = || -> Result<T, toml::de::Error> {
        let mut run: toml::Table = text.parse()?;
        for (group, setting) in RETIRED {
            let config = run.get_mut("config");
            let settings = config.and_then(|config| config.get_mut(group)?.as_table_mut());
            settings.and_then(|settings| settings.remove(setting));
        }
        run.try_into()
    };
    run().map_err(|error| error.message().to_owned())
}

/// Resolves a configuration: its defaults, then the text of a preset, then the `--set` pairs in their order. Later
/// values replace earlier ones.
///
/// # Errors
/// [`ConfigError::Set`] for a key that does not exist or a value of another kind, [`ConfigError::Preset`] for an
/// invalid preset.
pub fn resolve<T: serde::de::DeserializeOwned>(
    preset: &str,
    text: &str,
    set: &[(String, String)],
) -> Result<T, ConfigError> {
    let fault = |reason: String| ConfigError::Preset(preset.into(), reason);
    let mut table: toml::Table = text.parse().map_err(|e: toml::de::Error| fault(e.to_string()))?;
    let parse = |table: &toml::Table| table.clone().try_into::<T>().map_err(|e| e.to_string());
    parse(&table).map_err(fault)?;
    for (key, value) in set {
        let error = |reason: String| ConfigError::Set {
            key: key.clone(),
            value: value.clone(),
            reason,
        };
        insert(&mut table, key, parse_value(value)).map_err(error)?;
        parse(&table).map_err(|e| error(e.lines().next().unwrap_or("does not fit").to_owned()))?;
    }
    parse(&table).map_err(fault)
}

/// A TOML value where the text is one, a string otherwise.
fn parse_value(text: &str) -> toml::Value {
    let table = format!("v = {text}").parse::<toml::Table>().ok();
    let value = table.and_then(|mut table| table.remove("v"));
    value.unwrap_or_else(|| toml::Value::String(text.into()))
}

fn insert(table: &mut toml::Table, key: &str, value: toml::Value) -> Result<(), String> {
    let Some((head, rest)) = key.split_once('.') else {
        table.insert(key.into(), value);
        return Ok(());
    };
    let inner = table.entry(head).or_insert_with(|| toml::Table::new().into());
    let inner = inner.as_table_mut().ok_or_else(|| format!("{head} is not a section"))?;
    insert(inner, rest, value)
}
