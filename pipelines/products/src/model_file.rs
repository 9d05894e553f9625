//! Reading `model.json` as untrusted input: no index beyond a list, no size beyond the file.

use crate::model::{ModelFile, ModelImage, SCHEMA};
use heliosplat::gaussians::Table;
use heliosplat::model::SceneModel;
use heliosplat::model::shadow_gs::{ShadowGs, ShadowGsOptions};
use heliosplat::splat::rasterise::MOST_CHANNELS;

/// Channels that hold the normals, behind the model's own.
const NORMALS: usize = 3;
/// Most pixels of an image, and most cells of the ground.
const PIXELS_MAX: f64 = (1u64 << 30) as f64;

impl ModelFile {
    /// Model file parsed from the text of a `model.json` and checked.
    ///
    /// # Errors
    /// A sentence on the fault of the text.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut file: Self = serde_json::from_str(text).map_err(|e| e.to_string())?;
        if file.schema != SCHEMA || file.model != "shadow_gs" {
            return Err(format!("schema {} of model {} is not known", file.schema, file.model));
        }
        check_options(&file.options)?;
        if !complete(&mut file.globals, &file.options) {
            return Err("its shared parameters do not fit its options".into());
        }
        if file.bands.len() != file.options.bands {
            return Err(format!("it names {} bands of {}", file.bands.len(), file.options.bands));
        }
        let gains = &file.values.reflectance;
        let mut lines = gains.iter().flatten();
        let finite = lines.all(|line| line.scale.is_finite() && line.offset.is_finite());
        if !finite || ![0, file.bands.len()].contains(&gains.len()) {
            return Err("its bands have no usable gains to reflectance".into());
        }
        let bands = file.options.bands;
        if file.daylight.as_ref().is_some_and(|light| !light.is_possible(bands)) {
            return Err("its daylight is none".into());
        }
        file.check_numbers()?;
        let days = &file.options.days;
        if ![0, file.options.images].contains(&days.len()) || !days.iter().all(|day| day.is_finite()) {
            return Err("its images have days that are none".into());
        }
        let mut images = file.images.iter();
        images.try_for_each(|image| check_image(image, &file.options))?;
        Ok(file)
    }

    fn check_numbers(&self) -> Result<(), String> {
        let (area, (low_m, high_m)) = (&self.area, self.altitude_range_m);
        let positive = |v: f64| v > 0.0 && v.is_finite();
        if !positive(self.gsd_m) || !positive(self.counts_per_unit) {
            return Err("gsd_m and counts_per_unit must be finite and above zero".into());
        }
        let (east, north) = (area.east_m - area.west_m, area.north_m - area.south_m);
        if !(positive(east) && positive(north) && east / self.gsd_m * (north / self.gsd_m) < PIXELS_MAX) {
            return Err("its area is no ground of a size that can be modelled".into());
        }
        if !(low_m <= high_m && low_m.is_finite() && high_m.is_finite()) {
            return Err("its altitude range is none".into());
        }
        let at = &self.origin;
        let on_earth = (-180.0..=180.0).contains(&at.lon_deg) && (-90.0..=90.0).contains(&at.lat_deg);
        if !(on_earth && at.height_m.is_finite()) {
            return Err("its origin is no place on Earth".into());
        }
        let filter_px2 = self.projection.filter_px2;
        if !(filter_px2 >= 0.0 && filter_px2.is_finite()) {
            return Err("its projection has a filter that is none".into());
        }
        Ok(())
    }
}

fn check_options(options: &ShadowGsOptions) -> Result<(), String> {
    let most = MOST_CHANNELS;
    // Bands come first: the number of channels follows from them.
    let fits = (1..most).contains(&options.bands) && ShadowGs::new(options.clone()).channels() + NORMALS <= most;
    if !fits {
        return Err(format!("{} bands are not possible", options.bands));
    }
    if options.reference >= options.images {
        let (reference, images) = (options.reference, options.images);
        return Err(format!("its reference image {reference} is none of {images}"));
    }
    Ok(())
}

/// True if the shared parameters match the options; checked before anything is allocated by the options. Models of
/// older versions have no path radiance where images have no colours of their own: there it becomes zero.
fn complete(globals: &mut Table, options: &ShadowGsOptions) -> bool {
    let per_image = options.bands * options.bands + 2 * options.bands;
    if options.images.checked_mul(per_image).is_none() || globals.count != 1 {
        return false;
    }
    let expected = ShadowGs::new(options.clone()).global_groups();
    let kept = globals.groups.len();
    if !options.image_colour && kept + 1 == expected.len() {
        globals.groups.extend(Table::zeros(expected[kept..].to_vec(), 1).groups);
    }
    let same = |(group, spec): (&heliosplat::gaussians::Group, _)| {
        group.spec == spec && group.values.len() == group.spec.width
    };
    globals.groups.len() == expected.len() && globals.groups.iter().zip(expected).all(same) && globals.is_finite()
}

fn check_image(image: &ModelImage, options: &ShadowGsOptions) -> Result<(), String> {
    let (crop, name) = (&image.crop, &image.name);
    // Files are named after images: a name is one part of a path, and none that leads away from its folder.
    if name.is_empty() || name == "." || name == ".." || name.contains(['/', '\0']) {
        return Err(format!("image name {name:?} is not one a file can have"));
    }
    let known = |appearance: Option<usize>| appearance.is_none_or(|a| a < options.images);
    if !known(image.appearance) || !known(image.same_day) {
        return Err(format!("image {name} has a colour that is not there"));
    }
    let sides = [crop.col0, crop.row0, crop.width, crop.height].map(|n| n as f64);
    if crop.width == 0 || crop.height == 0 || sides[2] * sides[3] > PIXELS_MAX || sides[0].max(sides[1]) > PIXELS_MAX {
        return Err(format!("image {name} has a crop of no possible size"));
    }
    let map = &image.map;
    let angles = image.sun.iter().flat_map(|sun| [&sun.azimuth_rad, &sun.elevation_rad]);
    let of_map = map.u.iter().chain(&map.v).chain(&map.w);
    let mut numbers = of_map.chain(angles).chain(&image.sun_sigma_deg);
    if !numbers.all(|number| number.is_finite()) || !image.shift_px.iter().all(|s| s.is_finite()) {
        return Err(format!("image {name} has numbers that are not finite"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_without_path_radiance_had_none_and_one_with_other_parameters_is_refused() {
        let options = ShadowGsOptions {
            image_colour: false,
            ..ShadowGsOptions::default()
        };
        let mut globals = ShadowGs::new(options.clone()).initial_globals(0.3);
        let whole = globals.clone();
        globals.groups.truncate(1);
        assert!(complete(&mut globals, &options));
        assert_eq!(globals, whole);
        globals.groups.clear();
        assert!(!complete(&mut globals, &options));
        let coloured = ShadowGsOptions::default();
        let mut globals = ShadowGs::new(coloured.clone()).initial_globals(0.3);
        globals.groups.truncate(2);
        assert!(!complete(&mut globals, &coloured));
    }
}
