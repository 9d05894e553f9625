//! The images of a scene as drafts: opened, joined where two files are one image, and checked against each other.

use super::draft::Draft;
use super::layout::Layout;
use super::{IngestOptions, SceneError, acquisition, bands, calibration, camera, pairs};
use heliosplat::splat::rasterise::MOST_CHANNELS;

/// Most bands of an image: the rasteriser renders them beside the sun visibility and a normal.
const MOST_BANDS: usize = MOST_CHANNELS - 1 - 3;

/// Opens every image and reads what its files say about it.
pub(super) fn read_all(
    layout: &Layout,
    options: &IngestOptions,
    warnings: &mut Vec<String>,
) -> Result<Vec<Draft>, SceneError> {
    let mut drafts = Vec::with_capacity(layout.images.len());
    let declared = layout.bands.as_deref();
    for entry in &layout.images {
        let file = entry.tiles.open()?;
        let found = camera::find(&file, entry, options.rpc, warnings)?;
        let plan = match &entry.multispectral {
            // Its bands will be those of its other half.
            Some(_) => bands::plan(&file, None)?,
            None => bands::plan(&file, declared)?,
        };
        let acquisition = acquisition::find(&file, entry)?;
        let radiometry = calibration::find(&file, entry)?;
        let window = file.whole();
        let draft = Draft {
            entry: entry.clone(),
            file,
            plan,
            rpc: found.rpc,
            rpc_source: found.source,
            acquisition,
            radiometry,
            multispectral: None,
            window,
        };
        drafts.push(match &entry.multispectral {
            Some(multispectral) => pairs::with_colours(draft, multispectral, declared)?,
            None => draft,
        });
    }
    let drafts = pairs::by_time(drafts, declared)?;
    warnings.extend(pairs::told(&drafts));
    // The same assumption about every image is one warning.
    if let Some(assumption) = drafts.iter().find_map(|draft| draft.plan.assumption.as_ref()) {
        warnings.push(format!(
            "{}: {assumption}; say otherwise with bands = [...] in a scene.toml",
            layout.images[0].path.display()
        ));
    }
    Ok(drafts)
}

/// Refuses images of different bands, and more bands than a model renders.
pub(super) fn check_bands(drafts: &[Draft]) -> Result<(), SceneError> {
    let Some(first) = drafts.first() else {
        return Ok(());
    };
    let bands = first.plan.kinds.len();
    if bands > MOST_BANDS {
        return Err(SceneError::TooManyBands {
            path: first.file.path().to_owned(),
            bands,
            most: MOST_BANDS,
        });
    }
    match drafts.iter().find(|draft| draft.plan.kinds != first.plan.kinds) {
        None => Ok(()),
        Some(differing) => Err(SceneError::MixedBands {
            path: differing.file.path().to_owned(),
            found: bands::in_words(&differing.plan.kinds),
            other: first.file.path().to_owned(),
            expected: bands::in_words(&first.plan.kinds),
        }),
    }
}
