//! `relight --times`: a satellite scene under the suns of a series of moments, a file for each or one animation.

use super::model_args::RelightArgs;
use crate::outcome::{CliError, Outcome};
use crate::parse::TimeSeries;
use heliosplat_products::animation::Animation;
use heliosplat_products::model::LoadedModel;
use heliosplat_products::relight::{LOWEST_SUN_DEG, Relit, Viewpoint};
use heliosplat_rpc::sun::{SunPosition, sun_position};
use heliosplat_session::Session;
use jiff::Timestamp;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// A moment and its sun.
type Moment = (Timestamp, SunPosition);

/// Whether a file is to be an animation.
pub(crate) fn is_animation(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("gif"))
}

/// Relights the model at every moment of the series whose sun is up.
///
/// # Errors
/// When the sun is never up, the view is unknown, or a file cannot be written.
pub(crate) fn run(
    args: &RelightArgs,
    model: &LoadedModel,
    times: &TimeSeries,
    session: &Session,
) -> Result<Outcome, CliError> {
    let all = times
        .moments()
        .map(|time| (time, sun_position(time, model.frame.origin)));
    let (day, night): (Vec<Moment>, Vec<Moment>) =
        all.partition(|(_, sun)| sun.elevation_rad.to_degrees() >= LOWEST_SUN_DEG);
    if day.is_empty() {
        return Err(CliError::Input(format!(
            "relight: at none of the {} times the sun stands {LOWEST_SUN_DEG} degrees or higher over this place; times without an offset are UTC",
            night.len()
        )));
    }
    let view = Viewpoint::new(model, &args.view)?;
    let mut text = String::new();
    let (files, animation) = if is_animation(&args.out) {
        (animate(args, &view, &day, session)?, Some(&args.out))
    } else {
        (one_by_one(args, &view, &day, session)?, None)
    };
    for file in &files {
        let angle = |key: &str| file[key].as_f64().unwrap_or(f64::NAN);
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{}: sun at azimuth {:.2}, elevation {:.2}",
            file["image"].as_str().or(file["time"].as_str()).unwrap_or_default(),
            angle("sun_azimuth_deg"),
            angle("sun_elevation_deg")
        );
    }
    if let Some(path) = animation {
        let _ = writeln!(text, "{}: {} frames", path.display(), files.len());
    }
    if !night.is_empty() {
        let _ = writeln!(text, "left out: {} times at night", night.len());
    }
    let night: Vec<Value> = night.iter().map(said).collect();
    Ok(Outcome {
        text,
        json: json!({"files": files, "animation": animation, "night": night}),
    })
}

/// A moment for machines.
fn said((time, sun): &Moment) -> Value {
    json!({
        "time": time.to_string(),
        "sun_azimuth_deg": sun.azimuth_rad.to_degrees(),
        "sun_elevation_deg": sun.elevation_rad.to_degrees(),
    })
}

/// Calls `each` with the relit scene of each moment, until the user stops.
fn for_each(
    view: &Viewpoint,
    day: &[Moment],
    session: &Session,
    mut each: impl FnMut(&Moment, Relit) -> Result<(), CliError>,
) -> Result<(), CliError> {
    session.stop_gently();
    let progress = session.progress("relight", day.len() as u64);
    for (done, moment) in day.iter().enumerate() {
        if session.stopped() {
            return Err(CliError::Interrupted(format!(
                "stopped after {done} of {} times",
                day.len()
            )));
        }
        each(moment, view.relit(&moment.1)?)?;
        progress.set(done as u64 + 1);
    }
    Ok(())
}

fn one_by_one(args: &RelightArgs, view: &Viewpoint, day: &[Moment], session: &Session) -> Result<Vec<Value>, CliError> {
    let mut files = Vec::new();
    for_each(view, day, session, |moment, relit| {
        let path = with_time(&args.out, moment.0);
        let mask = relit.write(&path)?;
        let mut file = said(moment);
        file["image"] = json!(path);
        file["shadow"] = json!(mask);
        files.push(file);
        Ok(())
    })?;
    Ok(files)
}

fn animate(args: &RelightArgs, view: &Viewpoint, day: &[Moment], session: &Session) -> Result<Vec<Value>, CliError> {
    let height = |moment: &&Moment| moment.1.elevation_rad;
    let lowest = day.iter().min_by(|a, b| height(a).total_cmp(&height(b)));
    let highest = day.iter().max_by(|a, b| height(a).total_cmp(&height(b)));
    let (Some(lowest), Some(highest)) = (lowest, highest) else {
        return Ok(Vec::new());
    };
    let [lowest, highest] = [lowest, highest].map(|moment| view.relit(&moment.1));
    let mut animation = Animation::new(&lowest?.image, &highest?.image);
    let mut frames = Vec::new();
    for_each(view, day, session, |moment, relit| {
        animation.push(&relit.image);
        frames.push(said(moment));
        Ok(())
    })?;
    animation.write(&args.out)?;
    Ok(frames)
}

/// `evening.tif` at a time: `evening_20260621T163000Z.tif`.
fn with_time(path: &Path, time: Timestamp) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let mut name = format!("{stem}_{}", time.strftime("%Y%m%dT%H%M%SZ"));
    if let Some(extension) = path.extension() {
        name += &format!(".{}", extension.to_string_lossy());
    }
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_bear_their_time_in_utc_without_colons() {
        let time: Timestamp = "2026-06-21T18:30:05+02:00".parse().expect("a time");
        let named = |path: &str| with_time(Path::new(path), time);
        assert_eq!(named("a/evening.tif"), Path::new("a/evening_20260621T163005Z.tif"));
        assert_eq!(named("b"), Path::new("b_20260621T163005Z"));
        assert!(is_animation(Path::new("day.GIF")) && !is_animation(Path::new("day.png")));
    }
}
