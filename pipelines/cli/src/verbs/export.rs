//! `heliosplat export` for runs on satellite scenes, and for mosaics of batches.

mod mosaic;

use super::export_args::ExportArgs;
use crate::args::sun_of;
use crate::outcome::{CliError, Outcome};
use crate::outputs::{Inputs, must_end_in};
use bytesize::ByteSize;
use heliosplat_pages::page::MOSAIC_FILE;
use heliosplat_products::export::{Request, Subject, Written, write};
use heliosplat_products::model::load;
use serde_json::json;
use std::path::Path;

/// Writes splats, meshes and tiles of a run or a mosaic for other programs.
///
/// # Errors
/// When the run, the sun, an option or a file name cannot be used, or a file cannot be written.
pub(crate) fn of_satellite(args: &ExportArgs) -> Result<Outcome, CliError> {
    let (subject, gaussians) = open(&args.run)?;
    CliError::refuse(
        "export",
        &[
            (args.light.is_some(), "light"),
            (args.toward.is_some(), "toward"),
            (args.asset.is_some(), "asset"),
            (args.cells.is_some(), "cells"),
        ],
        "for runs on objects; leave it out for one on a satellite scene",
    )?;
    let (mesh, tiles_of_mesh) = match &args.mesh {
        Some(Some(path)) => (Some(path.clone()), false),
        Some(None) if args.tiles.is_none() => {
            let text = "export --mesh: give it a name that ends in .glb, or a folder for tiles with --tiles DIR";
            return Err(CliError::Input(text.into()));
        }
        Some(None) => (None, true),
        None => (None, false),
    };
    let inputs = Inputs::of_run(&args.run);
    for (path, option, format) in [
        (&args.ply, "--ply", "ply"),
        (&args.splats, "--splats", "glb"),
        (&mesh, "--mesh", "glb"),
    ] {
        if let Some(path) = path {
            must_end_in(option, path, &[format])?;
            inputs.keep(path)?;
        }
    }
    if let Some(folder) = &args.tiles {
        inputs.keep_folder(folder)?;
    }
    let sun = sun_of(args.sun, args.time, subject.frame().origin);
    let request = Request {
        ply: args.ply.clone(),
        splats: args.splats.clone(),
        mesh,
        tiles: args.tiles.clone(),
        tiles_of_mesh,
        sun,
    };
    let export = write(&subject, &request)?;
    let lines: Vec<String> = export.written.iter().map(line).collect();
    let text = lines.join("\n");
    let json = json!({"written": export.written, "said": export.said, "gaussians": gaussians});
    Ok(Outcome::new(text, json))
}

/// The run or the mosaic in a folder, and the number of Gaussians of a run.
fn open(folder: &Path) -> Result<(Subject, Option<usize>), CliError> {
    if folder.join(MOSAIC_FILE).is_file() {
        return Ok((Subject::Mosaic(Box::new(mosaic::open(folder)?)), None));
    }
    let model = load(folder)?;
    let gaussians = model.parameters.gaussians.count;
    Ok((Subject::Run(Box::new(model)), Some(gaussians)))
}

fn line(written: &Written) -> String {
    let content = match (written.splats, written.triangles) {
        (Some(splats), _) => format!("{splats} splats"),
        (None, Some(triangles)) => format!("{triangles} triangles"),
        (None, None) => String::new(),
    };
    let Written {
        path, levels, files, ..
    } = written;
    let (path, bytes) = (path.display(), ByteSize(written.bytes));
    format!("{path}: {content}, {levels} level(s) of detail, {files} file(s), {bytes}")
}
