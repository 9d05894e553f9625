//! `heliosplat inspect`: describes a scene, and the decisions about its model, before training.

use super::object;
use crate::args::{IngestArgs, NamedScene, place_in_words};
use crate::outcome::{CliError, Outcome};
use clap::Args;
use heliosplat_fitting::settings::Preset;
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_satellite::estimate::{Estimate, estimate};
use heliosplat_satellite::{Decisions, PlanItem, adjust, altitude};
use heliosplat_scene::{ImagePair, Index, Scene, SceneImage, Split, ValueKind, Values, saturation};
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::PathBuf;

/// Scene to inspect.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// A folder of images, several image files, a scene.toml, a folder of Sat-NeRF or EOGS, or a capture with
    /// transforms.json, a COLMAP model or cameras.csv
    #[arg(value_name = "SCENE", required = true)]
    scene: Vec<PathBuf>,
    #[command(flatten)]
    ingest: IngestArgs,
}

/// Reads a scene or a capture, and describes it.
///
/// # Errors
/// When the scene cannot be used.
pub(crate) fn run(args: &InspectArgs) -> Result<Outcome, CliError> {
    let scene = NamedScene::new(&args.scene)?;
    let scene = &scene.path;
    if heliosplat_objects::is_capture(scene) {
        return object::inspect(scene);
    }
    let options = args.ingest.options();
    let mut scene = altitude::open(&Index::open(scene, options.rpc)?, &options)?;
    let contradictions = adjust::findings(&scene, &SatelliteConfig::default());
    let messages = contradictions.iter().map(|finding| finding.message.clone());
    scene.warnings.extend(messages);
    scene.findings.extend(contradictions);
    let coverage = Coverage::of(&scene);
    let decisions = Decisions::of(&scene, &SatelliteConfig::default());
    let mut json = describe(&scene, &coverage, &decisions);
    let mut text = table(&scene, &coverage, &decisions.items);
    if scene.training().count() >= 2 {
        let estimates = estimates(&scene)?;
        let named = estimates.iter().map(|(preset, e)| ((*preset).to_owned(), json!(e)));
        json["estimates"] = named.collect();
        text += &estimates_table(&estimates);
    }
    Ok(Outcome::new(text, json))
}

/// Estimated cost of a training with each preset.
fn estimates(scene: &Scene) -> Result<Vec<(&'static str, Estimate)>, CliError> {
    let of = |preset: Preset| {
        let config = SatelliteConfig::resolve(preset, &[], 1)?;
        Ok((preset.name(), estimate(scene, &config)))
    };
    Preset::ALL.into_iter().rev().map(of).collect()
}

fn estimates_table(estimates: &[(&str, Estimate)]) -> String {
    let mut text = "\ntraining will take about\n".to_owned();
    for (preset, e) in estimates {
        let gib = e.peak_bytes / f64::from(1 << 30);
        // Writing to a String cannot fail.
        let _ = writeln!(text, "  {preset:<9} {:>5} steps, {gib:.1} GiB", e.steps);
    }
    text
}

/// Coverage of the scene's area by training images, on a grid of points at mid altitude: shares of the
/// area that at least 1, 2, 3 … images see, 0 to 1.
struct Coverage(Vec<f64>);

impl Coverage {
    fn of(scene: &Scene) -> Self {
        const STEPS: usize = 64;
        let views = scene.training().count();
        let mut at_least = vec![0usize; views];
        for step in 0..STEPS * STEPS {
            let along = |low: f64, high: f64, index: usize| low + (high - low) * (index as f64 + 0.5) / STEPS as f64;
            let east = along(scene.area.west_m, scene.area.east_m, step % STEPS);
            let north = along(scene.area.south_m, scene.area.north_m, step / STEPS);
            for count in &mut at_least[..scene.views_covering(east, north, 0.0)] {
                *count += 1;
            }
        }
        let share = |count: usize| count as f64 / (STEPS * STEPS) as f64;
        Self(at_least.into_iter().map(share).collect())
    }

    fn by(&self, views: usize) -> f64 {
        self.0.get(views.saturating_sub(1)).copied().unwrap_or(0.0)
    }
}

fn describe(scene: &Scene, coverage: &Coverage, decisions: &Decisions) -> Value {
    let origin = scene.origin();
    json!({
        "kind": "satellite",
        "why": "images with RPC cameras",
        "source": scene.source,
        "images": scene.images.iter().map(describe_image).collect::<Vec<_>>(),
        "pairs": scene.pairs(),
        "bands": scene.bands(),
        "origin": { "lon_deg": origin.lon_deg, "lat_deg": origin.lat_deg, "height_m": origin.height_m },
        "altitude_range_m": [scene.altitude_range_m.0, scene.altitude_range_m.1],
        "altitude_source": scene.altitude_source,
        "altitude_m": {
            "low": scene.altitude_range_m.0,
            "high": scene.altitude_range_m.1,
            "source": scene.altitude_known_from,
        },
        "area_m": scene.area,
        "gsd_m": scene.gsd_m,
        "counts_per_unit": scene.counts_per_unit,
        "covered_by_at_least": coverage.0,
        "truth": {
            "dsm": scene.truth.dsm,
            "classes": scene.truth.classes,
            "shadows": scene.truth.shadows.len(),
        },
        "plan": decisions.items,
        "decisions": decisions,
        "findings": scene.findings,
        "warnings": scene.warnings,
    })
}

fn describe_image(image: &SceneImage) -> Value {
    let sun = |sun: heliosplat_rpc::sun::SunPosition| json!({ "azimuth_deg": sun.azimuth_rad.to_degrees(), "elevation_deg": sun.elevation_rad.to_degrees() });
    json!({
        "name": image.name,
        "path": image.path,
        "split": image.split,
        "width": image.pixels.width,
        "height": image.pixels.height,
        "data_type": image.data_type,
        "bands": image.bands,
        "values": {
            "kind": image.values.kind,
            "source": image.values.source,
            "clipped_low": saturation::share_below(&image.pixels),
            "clipped_high": saturation::share(&image.pixels),
        },
        "rpc_source": image.rpc_source,
        "pinhole_rms_px": image.pinhole.rms_px,
        "pinhole_max_px": image.pinhole.max_px,
        "gsd_m": image.gsd_m,
        "off_nadir_deg": off_nadir_deg(image),
        "time": image.time.map(|time| time.to_string()),
        "sun": {
            "azimuth_deg": image.sun.angles_deg().map(|[azimuth, _]| azimuth),
            "elevation_deg": image.sun.angles_deg().map(|[_, elevation]| elevation),
            "source": image.sun.source,
        },
        "sun_source": image.sun.source,
        "metadata_sun": image.metadata_sun.map(sun),
    })
}

/// Angle between the vertical and the direction to the satellite at the scene's centre, degrees.
fn off_nadir_deg(image: &SceneImage) -> f64 {
    image.ray().z.abs().clamp(0.0, 1.0).acos().to_degrees()
}

/// Most pairs of images in the table: all pairs of six images.
const MOST_PAIRS: usize = 15;

fn pairs_table(mut pairs: Vec<ImagePair>) -> String {
    let lengths = pairs.iter().flat_map(|pair| [pair.a.len(), pair.b.len()]);
    let width = lengths.max().unwrap_or(0);
    let mut text = format!("\n{:<1$}  convergence  base/height  overlap\n", "pair", 2 * width + 3);
    let left_out = pairs.len().saturating_sub(MOST_PAIRS);
    if left_out > 0 {
        pairs.sort_by(|x, y| y.base_to_height.total_cmp(&x.base_to_height));
        pairs.truncate(MOST_PAIRS);
    }
    for pair in pairs {
        let (a, b, angle, base) = (pair.a, pair.b, pair.convergence_deg, pair.base_to_height);
        let overlap = 100.0 * pair.overlap;
        text += &format!("{a:<width$} - {b:<width$}  {angle:>9.1}°  {base:>11.3}  {overlap:>5.0} %\n");
    }
    if left_out > 0 {
        let _ = writeln!(text, "and {left_out} of shorter base (--json lists them)");
    }
    text
}

/// Kinds of the images' values and their sources, such as `reflectance (12 images, a.IMD and others)`.
fn values_in_words(images: &[SceneImage]) -> String {
    let mut kinds: Vec<(&Values, usize)> = Vec::new();
    for image in images {
        match kinds.iter_mut().find(|(values, _)| values.kind == image.values.kind) {
            Some((_, count)) => *count += 1,
            None => kinds.push((&image.values, 1)),
        }
    }
    let words = kinds.iter().map(|(values, count)| {
        let source = match (&values.source, values.kind) {
            (Some(source), _) if *count == 1 => source.clone(),
            (Some(source), _) => format!("{source} and others"),
            (None, ValueKind::Display) => "8 bits clipped at 0 or 255".to_owned(),
            (None, _) => "no gains given".to_owned(),
        };
        let (kind, plural) = (values.kind.name(), if *count == 1 { "" } else { "s" });
        format!("{kind} ({count} image{plural}, {source})")
    });
    words.collect::<Vec<_>>().join(", ")
}

fn images_table(images: &[SceneImage]) -> String {
    let longest = images.iter().map(|image| image.name.len()).max().unwrap_or(0).max(5);
    let mut text = format!(
        "\n{:<longest$}  split  pixels       type     off-nadir  fit rms / max px  sun az / el            time",
        "image"
    );
    for image in images {
        let sun = match image.sun.angles_deg() {
            Some([azimuth, elevation]) => format!("{azimuth:>6.1} / {elevation:<4.1} {}", image.sun.source.name()),
            None => "unknown".to_owned(),
        };
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "\n{:<longest$}  {:<5}  {:<11}  {:<7}  {:>7.1}    {:>7.4} / {:<7.4} {sun:<22}  {}",
            image.name,
            if image.split == Split::Train { "train" } else { "test" },
            format!("{}x{}", image.pixels.width, image.pixels.height),
            image.data_type,
            off_nadir_deg(image),
            image.pinhole.rms_px,
            image.pinhole.max_px,
            image.time.map_or("unknown".to_owned(), |time| time.to_string())
        );
    }
    text
}

fn table(scene: &Scene, coverage: &Coverage, plan: &[PlanItem]) -> String {
    let (area, (low, high)) = (scene.area, scene.altitude_range_m);
    let bands: Vec<&str> = scene.bands().iter().map(|band| band.name()).collect();
    let (place, source) = (place_in_words(scene.origin()), &scene.altitude_source);
    let (width, height, views) = (area.east_m - area.west_m, area.north_m - area.south_m, coverage.0.len());
    let [twice, by_all] = [2, views].map(|views| 100.0 * coverage.by(views));
    let mut text = format!(
        "satellite scene (images with RPC cameras): {}\n\
centre    {place}, {low:.0} to {high:.0} m above the ellipsoid ({source})\n\
area      {width:.0} x {height:.0} m seen twice; {twice:.0} % of it by 2 or more, {by_all:.0} % by all {views} training images\n\
bands     {} ({:.2} m per pixel)\n\
values    {}\n",
        scene.source.display(),
        bands.join(", "),
        scene.gsd_m,
        values_in_words(&scene.images)
    );
    let masks = match scene.truth.shadows.len() {
        0 => None,
        count => Some(format!("{count} shadow masks")),
    };
    let file = |kind: &str, path: &Option<PathBuf>| path.as_ref().map(|path| format!("{kind} {}", path.display()));
    let truth = [
        file("DSM", &scene.truth.dsm),
        file("classes", &scene.truth.classes),
        masks,
    ];
    let truth: Vec<String> = truth.into_iter().flatten().collect();
    if !truth.is_empty() {
        text += &format!("truth     {}\n", truth.join(", "));
    }
    text += &images_table(&scene.images);
    text += &format!("\n{}\n", pairs_table(scene.pairs()).trim_end());
    if !plan.is_empty() {
        text += "\ncomponents\n";
    }
    for item in plan {
        let state = if item.on { "on " } else { "off" };
        text += &format!("  {state} {:<24} {}\n", item.component, item.reason);
    }
    for warning in &scene.warnings {
        text += &format!("\nwarning: {warning}\n");
    }
    text
}
