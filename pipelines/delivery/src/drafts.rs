//! Drafts of a scene's images: files opened, and files of one image joined.

use super::draft::Draft;
use super::files::Folders;
use super::layout::Layout;
use super::{Result, RpcPreference, acquisition, bands, calibration, camera, files, pairs};

/// Opens every image and reads its metadata.
pub(super) fn read_all(
    layout: &Layout,
    preference: RpcPreference,
    folders: &Folders,
    warnings: &mut Vec<String>,
) -> Result<Vec<Draft>> {
    let mut drafts = Vec::with_capacity(layout.images.len());
    let declared = layout.bands.as_deref();
    for entry in &layout.images {
        let file = entry.tiles.open(folders)?;
        if let Some(own) = files::own_output(&file).filter(|_| entry.said.is_none()) {
            warnings.push(own);
            continue;
        }
        let found = camera::find(&file, entry, preference, folders, warnings)?;
        let plan = match &entry.multispectral {
            // The joined image has the bands of its multispectral half, so the bands in `scene.toml` do not apply here.
            Some(_) => bands::plan(&file, None, folders)?,
            None => bands::plan(&file, declared, folders)?,
        };
        let acquisition = acquisition::find(&file, entry, folders)?;
        let radiometry = calibration::find(&file, entry, folders)?;
        let size = file.size();
        let draft = Draft {
            entry: entry.clone(),
            file,
            plan,
            rpc: found.used.rpc.clone(),
            cameras: found,
            camera_size: size,
            acquisition,
            time_of_tag: false,
            radiometry,
            multispectral: None,
        };
        drafts.push(match &entry.multispectral {
            Some(multispectral) => pairs::with_colours(draft, multispectral, declared, folders)?,
            None => draft,
        });
    }
    let drafts = pairs::by_time(drafts, declared, folders)?;
    warnings.extend(pairs::joined_pairs(&drafts));
    // The assumption is equal for all images, so it is one warning.
    let stacked = || drafts.iter().filter(|draft| !draft.entry.tiles.more.is_empty());
    if let Some(first) = stacked().next() {
        let (path, more, count) = (
            first.entry.path.display(),
            first.entry.tiles.more.len(),
            stacked().count(),
        );
        let plural = if more == 1 { "" } else { "s" };
        warnings.push(format!(
            "{path}: one image with the bands of {more} more file{plural} of the same acquisition ({count} such images)"
        ));
    }
    let assumption = drafts.iter().find_map(|draft| draft.plan.assumption.as_ref());
    if let Some((assumption, first)) = assumption.zip(drafts.first()) {
        let path = first.entry.path.display();
        let text = format!("{path}: {assumption}; say otherwise with bands = [...] in a scene.toml");
        warnings.push(text);
    }
    Ok(drafts)
}
