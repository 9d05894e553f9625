//! The arenas: description, columns of the table, and the values kept of a run.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A scene on which the program is measured.
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
    /// All arenas, in the order of the page.
    pub(super) const ALL: [Self; 6] = [
        Self::Block,
        Self::City,
        Self::CityB,
        Self::Jax068,
        Self::Olat,
        Self::Reflective,
    ];

    /// Name of the arena in the option `--arenas`.
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

    /// True for a captured object, false for a satellite scene.
    pub(super) fn is_object(self) -> bool {
        matches!(self, Self::Olat | Self::Reflective)
    }

    /// Heading, setting and commands of the arena's section, in Markdown.
    pub(super) fn head(self) -> [&'static str; 3] {
        match self {
            Self::Block => [
                "Synthetic block",
                "128 m × 128 m, 12 images of 0.5 m, two of them held out; exact truth; protocol `raw`. The seed is that of the site.",
                "`synth satellite --site block --seed SEED --out SCENE`, then `train SCENE --preset PRESET --out RUN`; sweep: `dsm SCENE --from sweep --out DSM`, then `evaluate --dsm DSM --truth TRUTH`",
            ],
            Self::City => [
                "Synthetic city",
                "256 m × 256 m, 16 images of 0.5 m, two of them held out; exact truth; protocol `raw`. The seed is that of the site.",
                "`synth satellite --site city --seed SEED --out SCENE`, then as for the block",
            ],
            Self::CityB => [
                "Independent city",
                "12 RGB images of 0.5 m from a path tracer that shares no code with this project, none held out; exact truth; protocol `raw`. The seed is that of training.",
                "`train SCENE --preset PRESET --seed SEED --out RUN`, then `evaluate --dsm RUN/dsm.tif --truth TRUTH --classes CLASSES`",
            ],
            Self::Jax068 => [
                "DFC2019 JAX_068",
                "19 real WorldView-3 crops of 0.33 m, RGB, with Sat-NeRF's split and bundle-adjusted RPCs; lidar truth; protocol `aligned`. The seed is that of training. Data: DFC2019, IEEE DataPort; US3D by JHU/APL, images courtesy DigitalGlobe.",
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

    /// Columns of the arena's table.
    pub(super) fn columns(self) -> &'static [Column] {
        match self {
            Self::Block | Self::City => &SURFACE,
            Self::CityB => &SURFACE_WITHOUT_IMAGES,
            Self::Jax068 => &SURFACE_WITH_IMAGES,
            Self::Olat => &OLAT,
            Self::Reflective => &REFLECTIVE,
        }
    }
}

/// One column of a table.
pub(super) struct Column {
    /// Heading of the column, with its unit.
    pub(super) head: &'static str,
    /// Key of the number in [`Record::numbers`].
    pub(super) key: &'static str,
    /// Factor from the stored number to the printed one.
    pub(super) factor: f64,
    /// Number of decimals printed.
    pub(super) decimals: usize,
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
const BEYOND: Column = column("beyond 5 m %", "/dsm/beyond_5m", 100.0, 1);
const SEEN_UNKNOWN: Column = column("unknown of seen %", "/dsm/seen_unknown", 100.0, 1);
const HELD_OUT: Column = column("PSNR held out dB", "/test/psnr", 1.0, 2);
const TIME: Column = column("time s", SECONDS, 1.0, 0);
const MEMORY: Column = column("peak memory MiB", PEAK_BYTES, 1.0 / 1_048_576.0, 0);

const SURFACE: [Column; 12] = [
    MAE,
    MEDIAN,
    WITHIN,
    BEYOND,
    COMPLETE,
    SEEN_UNKNOWN,
    column("BER with the image %", "/shadow/ber", 100.0, 1),
    column("BER traced %", "/shadow/traced/ber", 100.0, 1),
    HELD_OUT,
    column("the same, RGB dB", "/test/psnr_rgb", 1.0, 2),
    TIME,
    MEMORY,
];
const SURFACE_WITHOUT_IMAGES: [Column; 7] = [MAE, MEDIAN, WITHIN, BEYOND, COMPLETE, TIME, MEMORY];
const SURFACE_WITH_IMAGES: [Column; 8] = [MAE, MEDIAN, WITHIN, BEYOND, COMPLETE, HELD_OUT, TIME, MEMORY];
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
/// Notes on columns, by the key of the column.
pub(super) const NOTES: [(&str, &str); 4] = [
    (
        "/dsm/seen_unknown",
        "**Unknown of seen**: unknown share of the ground that two images or more see.",
    ),
    (
        "/shadow/ber",
        "**BER with the image**: balanced error rate of shadow masks whose borders are refined by the image, on training images.",
    ),
    (
        "/shadow/traced/ber",
        "**BER traced**: the same without the image, comparable with other methods.",
    ),
    (
        "/test/psnr_rgb",
        "**PSNR held out**: images that were not trained on, in the colour of a training image of the same day.",
    ),
];
/// Key of the wall time of the command, seconds.
pub(super) const SECONDS: &str = "seconds";
/// Key of the peak memory of the command, bytes.
pub(super) const PEAK_BYTES: &str = "peak_bytes";

/// Measurements of one run of the program.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Arena of the run.
    pub arena: Arena,
    /// Name of the preset, or `sweep`.
    pub preset: String,
    /// Seed of the scene, or of training where the scene is fixed.
    pub seed: u64,
    /// Version that the program reports.
    pub version: String,
    /// Hash of the program's file: records of another program are not used.
    pub program: String,
    /// Day of the run, `YYYY-MM-DD`.
    pub date: String,
    /// Number of cores and name of the processor.
    pub machine: String,
    /// Numbers by their JSON pointer in `metrics.json`, and wall time (seconds) and peak memory (bytes) of the process.
    pub numbers: BTreeMap<String, f64>,
    /// Reason why nothing could be measured; `None` for a measured run.
    pub not_run: Option<String>,
}
