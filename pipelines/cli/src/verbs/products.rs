//! `heliosplat products`: writes files for a GIS.

use crate::args::{map_of, sun_of};
use crate::outcome::{CliError, Outcome};
use crate::outputs::Inputs;
use crate::parse;
use clap::Args;
use heliosplat_pages::report;
use heliosplat_products::model;
use heliosplat_products::set::{self, Request};
use heliosplat_products::stac;
use heliosplat_products::sunshine::Period;
use heliosplat_products::writer::Set;
use heliosplat_raster::{Geoid, write_atomically};
use heliosplat_rpc::sun::SunPosition;
use heliosplat_session::Session;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// `products`.
#[derive(Debug, Clone, Args)]
pub struct ProductsArgs {
    /// Finished runs
    #[arg(value_name = "RUN", required = true)]
    pub runs: Vec<PathBuf>,
    /// Folder to write to [default: RUN/products; several runs need one, and get a folder each in it]
    #[arg(long, value_name = "FOLDER")]
    pub out: Option<PathBuf>,
    /// Ground sampling distance, metres [default: that of the images]
    #[arg(long, value_parser = parse::positive, value_name = "M")]
    pub gsd: Option<f64>,
    /// Coordinate reference system [default: the local UTM zone]; +5773 or +3855 as --geoid egm96 or egm2008
    #[arg(long, value_name = "EPSG:N[+M]")]
    pub crs: Option<String>,
    /// Heights above this geoid instead of the ellipsoid; its grid must be among PROJ's data files
    #[arg(long, value_enum, value_name = "NAME")]
    pub geoid: Option<Geoid>,
    /// Also an ortho image under this sun: azimuth (clockwise from north) and elevation, degrees
    #[arg(long, value_parser = parse::sun, allow_hyphen_values = true, value_name = "AZ,EL", conflicts_with = "time")]
    pub sun: Option<SunPosition>,
    /// Also an ortho image under the sun of this moment, RFC 3339
    #[arg(long, alias = "at", value_parser = parse::time, value_name = "RFC3339")]
    pub time: Option<jiff::Timestamp>,
    /// Also the sunshine of a day or of a period of at most a year: hours of direct sun, sky view factor, irradiation under a clear sky
    #[arg(long, value_parser = Period::from_str, value_name = "FROM[/TO]")]
    pub sun_hours: Option<Period>,
}

/// Writes the products of runs, and a STAC collection of several.
///
/// # Errors
/// When a run or an option cannot be used, or a file cannot be written.
pub(crate) fn run(args: &ProductsArgs, session: &Session) -> Result<Outcome, CliError> {
    let several = args.runs.len() > 1;
    let out = match (&args.out, several) {
        (Some(out), _) => out.clone(),
        (None, false) => args.runs[0].join("products"),
        (None, true) => return Err(CliError::Input("products: several runs need --out FOLDER".into())),
    };
    for run in &args.runs {
        Inputs::of_run(run).keep_folder(&out)?;
    }
    let collection = name(&out);
    let ids = ids(&args.runs);
    let mut items = Vec::new();
    let mut files = Vec::new();
    let mut text = String::new();
    for (run, id) in args.runs.iter().zip(&ids) {
        let folder = if several { out.join(id) } else { out.clone() };
        let part_of = several.then_some((collection.as_str(), "../collection.json"));
        let set = write_run(args, run, &folder, (id, part_of), session)?;
        let (path, count, share) = (folder.display(), set.names.len(), 100.0 * set.completeness);
        text += &format!("{path}: {count} files, {share:.1} % of the ground known\nQGIS layers    {path}/layers.qlr\n");
        // The report of a run lists its products.
        if folder == run.join("products") && run.join(report::FILE).is_file() {
            let page = report::write(run)?;
            text += &format!("report         {}   (open it in a browser)\n", page.display());
        }
        items.push((id.clone(), set.item));
        files.extend(set.names.iter().map(|name| folder.join(name)));
    }
    if several {
        let path = out.join("collection.json");
        let collection = stac::collection(&collection, &items);
        write_atomically(&path, format!("{collection:#}\n").as_bytes())?;
        files.push(path);
    }
    Ok(Outcome::new(text, json!({"out": out, "files": files, "items": ids})))
}

fn write_run(
    args: &ProductsArgs,
    run: &Path,
    folder: &Path,
    names: (&str, Option<(&str, &str)>),
    session: &Session,
) -> Result<Set, CliError> {
    let model = model::load_whole(run)?;
    let (crs, geoid) = map_of("products", args.crs.as_deref(), args.geoid)?;
    let request = Request {
        gsd_m: args.gsd,
        crs: crs.map(|crs| crs.definition().to_owned()),
        geoid,
        sun: sun_of(args.sun, args.time, model.frame.origin),
        sun_hours: args.sun_hours,
    };
    let progress = session.progress("products", set::steps(&model));
    Ok(set::write(&model, folder, &request, names, &|done| progress.set(done))?)
}

/// Name of a folder, with other characters than ASCII letters, digits and `._-` replaced by `_`; `run` if only dots are
/// left.
fn name(folder: &Path) -> String {
    let whole = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    let name = whole.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let is_safe = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    let name = name.replace(|c| !is_safe(c), "_");
    match name.trim_matches('.') {
        "" => "run".into(),
        _ => name,
    }
}

/// Names of the runs; repeated names are numbered from 2.
fn ids(runs: &[PathBuf]) -> Vec<String> {
    let mut ids: Vec<String> = Vec::new();
    for run in runs {
        let name = name(run);
        let numbered = (2..).map(|number| format!("{name}_{number}"));
        let mut names = std::iter::once(name.clone()).chain(numbered);
        let free = names.find(|id| !ids.contains(id));
        ids.extend(free);
    }
    ids
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_safe_and_do_not_repeat() {
        let runs = ["a/run", "b/run", "c/a b", "d/..", "e/übung"].map(PathBuf::from);
        assert_eq!(ids(&runs), ["run", "run_2", "a_b", "run_3", "_bung"]);
    }
}
