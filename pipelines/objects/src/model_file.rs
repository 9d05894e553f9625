//! Reading the `model.json` of an object as untrusted input: no size beyond its content, no value that is not a number.

use super::model::{Kind, ObjectFile, ObjectImage, SCHEMA};
use heliosplat::gaussians::{Group, GroupSpec};

/// Most units of a hidden layer, and most hidden layers: far more than the 256 and 8 of the configuration.
const WIDTH_MAX: usize = 4096;
const HIDDEN_MAX: usize = 64;
/// Most pixels of an image.
const PIXELS_MAX: f64 = (1u64 << 30) as f64;

impl ObjectFile {
    /// Parses the text of a `model.json` and checks its values.
    ///
    /// # Errors
    /// A sentence with the fault.
    pub fn parse(text: &str) -> Result<Self, String> {
        let file: Self = serde_json::from_str(text).map_err(|e| e.to_string())?;
        if file.schema != SCHEMA {
            return Err(format!("schema {} is not known", file.schema));
        }
        check_kind(&file.kind)?;
        // The options are used only after a check that the file holds as many numbers as they require.
        let expected = file.kind.model().global_groups();
        let same = |(group, spec): (&Group, &GroupSpec)| group.spec == *spec && group.values.len() == group.spec.width;
        let globals = &file.globals;
        let fits = globals.groups.len() == expected.len() && globals.groups.iter().zip(&expected).all(same);
        if !fits || !globals.is_finite() {
            return Err("its shared parameters do not fit its options".into());
        }
        let positive = |v: f64| v > 0.0 && v.is_finite();
        if !(file.centre.is_finite() && positive(file.half_size) && positive(file.pixel_size)) {
            return Err("its centre, half_size and pixel_size are those of no object".into());
        }
        let filter_px2 = file.projection.filter_px2;
        if !(filter_px2 >= 0.0 && filter_px2.is_finite()) {
            return Err("its projection has a filter that is none".into());
        }
        file.images.iter().try_for_each(check_image)?;
        Ok(file)
    }
}

fn check_kind(kind: &Kind) -> Result<(), String> {
    let (width, hidden, numbers) = match kind {
        Kind::Radiance(o) => (1, 1, o.background.to_vec()),
        Kind::Olat(o) => {
            let lamp = [o.distance, o.radius, o.half_size];
            if !(o.distance > 0.0 && o.radius >= 0.0 && o.half_size > 0.0) {
                return Err(format!("distance, radius and half_size of its lights are {lamp:?}"));
            }
            let normals = [o.normal_edge, o.normal_weight];
            (o.width, o.hidden, [&o.background[..], &lamp, &normals].concat())
        }
        Kind::Reflective(o) => {
            if !(o.half_size > 0.0 && o.normal_edge > 0.0) {
                return Err(format!(
                    "its half_size is {} and its normal_edge {}",
                    o.half_size, o.normal_edge
                ));
            }
            let scales = [o.half_size, o.normal_edge, o.normal_weight];
            (o.width, o.hidden, [&o.background[..], &scales].concat())
        }
    };
    if width > WIDTH_MAX || hidden > HIDDEN_MAX {
        return Err(format!("networks of {hidden} layers of {width} units are not possible"));
    }
    if !numbers.iter().all(|v| v.is_finite()) {
        return Err("its options hold numbers that are not finite".into());
    }
    Ok(())
}

fn check_image(image: &ObjectImage) -> Result<(), String> {
    let camera = &image.camera;
    let axes = [camera.eye, camera.right, camera.down, camera.forward];
    let numbers = camera.focal_px.iter().chain(&camera.principal_px);
    let size = camera.size_px.map(|n| n as f64);
    let light = image.light.as_ref().is_none_or(|light| light.position.is_finite());
    let sound = axes.iter().all(|v| v.is_finite()) && numbers.copied().all(f64::is_finite) && light;
    if !sound || camera.size_px.contains(&0) || size[0] * size[1] > PIXELS_MAX {
        return Err(format!("image {} has a camera or a light that is none", image.name));
    }
    Ok(())
}
