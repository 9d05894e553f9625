//! `transforms*.json`: cameras and lights of a capture, in every dialect in use.
//!
//! One reader serves NeRF-synthetic, Shiny Blender, NRHints, GS³, RNG and nerfstudio, which differ in which keys they
//! have, and SSS-GS, whose frames hold a list of lights with an image for each. Keys are read per frame: nothing is
//! carried over from the frame before. `docs/guide/objects.md` lists the keys.

use super::colmap;
use super::error::CaptureError;
use super::frame_spec::{
    FrameSpec, Intrinsics, Lens, PointLight, UNDISTORT, find_image, inside, plain_name, sound_size,
};
use super::pinhole::Pinhole;
use glam::{DMat3, DVec3};
use heliosplat_raster::bounded;
use serde_json::{Map, Value};
use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

/// Most images of a capture.
const MOST_FRAMES: usize = 100_000;
/// Camera models of nerfstudio that are pinholes with at most the distortion of [`Lens`].
const PERSPECTIVE: [&str; 5] = ["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"];

/// The images that a file lists, and the point cloud that it names.
#[derive(Debug, Clone, PartialEq)]
pub struct Listed {
    /// The images, in the order of the file.
    pub frames: Vec<FrameSpec>,
    /// Point cloud of the reconstruction (nerfstudio's `ply_file_path`), in the frame of the cameras.
    pub points: Option<PathBuf>,
}

/// Reads one `transforms` file and finds the images of its frames.
///
/// # Errors
/// [`CaptureError`] naming the file, and the frame where one is at fault.
pub fn read(path: &Path) -> Result<Listed, CaptureError> {
    let text = bounded::read_bytes(path, bounded::TEXT_MAX).map_err(CaptureError::io(path))?;
    parse(path, &text)
}

/// The frames listed in the file at `path` with the content `text`; images are searched relative to it.
///
/// # Errors
/// [`CaptureError`] with the file, and the frame where one is at fault.
pub fn parse(path: &Path, text: &[u8]) -> Result<Listed, CaptureError> {
    let value: Value = serde_json::from_slice(text).map_err(|error| {
        let remedy = "write the file anew; JSON has no NaN and no infinity";
        CaptureError::file(path, format!("it is not JSON ({error})"), remedy)
    })?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let reader = Reader::new(path, folder, &value)?;
    Ok(Listed {
        frames: reader.frames()?,
        points: reader.points()?,
    })
}

type Object = Map<String, Value>;

struct Reader<'a> {
    path: &'a Path,
    folder: &'a Path,
    top: &'a Object,
    excluded: BTreeSet<String>,
}

impl<'a> Reader<'a> {
    fn new(path: &'a Path, folder: &'a Path, value: &'a Value) -> Result<Self, CaptureError> {
        let top = value.as_object().ok_or_else(|| {
            CaptureError::file(path, "it is not a JSON object", "a transforms file has a list `frames`")
        })?;
        // SSS-GS lists images that are not to be used; where there is no such file, none are.
        let list = bounded::read_text(&folder.join("exclude_list.txt")).unwrap_or_default();
        let excluded = list
            .lines()
            .map(|line| plain_name(line.trim()))
            .filter(|name| !name.is_empty());
        Ok(Self {
            path,
            folder,
            top,
            excluded: excluded.collect(),
        })
    }

    fn fault(&self, what: impl std::fmt::Display, remedy: &'static str) -> CaptureError {
        CaptureError::file(self.path, what, remedy)
    }

    fn frames(&self) -> Result<Vec<FrameSpec>, CaptureError> {
        let remedy = "a transforms file has a list `frames` with a `file_path` and a `transform_matrix` each";
        let frames = self.top.get("frames").and_then(Value::as_array);
        let frames = frames.ok_or_else(|| self.fault("it has no list `frames`", remedy))?;
        let mut all = Vec::new();
        for (number, frame) in frames.iter().enumerate() {
            let specs = frame.as_object().ok_or_else(|| "it is not an object".to_owned());
            let specs = specs.and_then(|frame| self.frame(frame));
            let wrong = |what| self.fault(format!("frame {number}: {what}"), "correct or remove the frame");
            all.extend(specs.map_err(wrong)?);
            if all.len() > MOST_FRAMES {
                return Err(self.fault(format!("it lists over {MOST_FRAMES} images"), "give fewer"));
            }
        }
        all.retain(|spec| !self.excluded.contains(&spec.name));
        if all.is_empty() {
            return Err(self.fault("it lists no image", remedy));
        }
        Ok(all)
    }

    /// The images of a frame: one, or in the dialect of SSS-GS one per light.
    fn frame(&self, frame: &Object) -> Result<Vec<FrameSpec>, String> {
        let pose = pose(frame)?;
        let intrinsics = self.intrinsics(frame)?;
        let declared_size = self.declared_size(frame)?;
        let lens = self.lens(frame)?;
        let spec = |written: &str, path: PathBuf, light| FrameSpec {
            name: plain_name(written),
            path,
            light,
            pose,
            intrinsics,
            declared_size,
            lens,
        };
        let Some(paths) = present(frame, "file_paths") else {
            let (written, path) = self.image_of(frame)?;
            return Ok(vec![spec(written, path, light_of(frame)?)]);
        };
        let paths = paths.as_array().ok_or("`file_paths` is not a list")?;
        let list = |key: &str| -> Result<&[Value], String> {
            let list = present(frame, key).map(|list| list.as_array().ok_or(format!("`{key}` is not a list")));
            Ok(list.transpose()?.map_or(&[], Vec::as_slice))
        };
        let (positions, intensities) = (list("light_positions")?, list("light_intensities")?);
        for (key, values) in [("light_positions", positions), ("light_intensities", intensities)] {
            if !values.is_empty() && values.len() != paths.len() {
                let (entries, images) = (values.len(), paths.len());
                return Err(format!("`{key}` has {entries} entries for {images} images"));
            }
        }
        let mut specs = Vec::with_capacity(paths.len());
        for (i, written) in paths.iter().enumerate() {
            let written = written.as_str().ok_or("`file_paths` holds something that is no text")?;
            let position = positions.get(i).map(|p| three("light_positions", p)).transpose()?;
            let light = position.map(|position| -> Result<_, String> {
                let intensity = intensities.get(i).map(intensity).transpose()?;
                Ok(PointLight { position, intensity })
            });
            let path = find_image(self.folder, written, None)?;
            specs.push(spec(written, path, light.transpose()?));
        }
        Ok(specs)
    }

    /// The image of a frame as written, and its file. `img_path`, an absolute path on the machine that wrote the file,
    /// counts only where it lies in this folder.
    fn image_of<'f>(&self, frame: &'f Object) -> Result<(&'f str, PathBuf), String> {
        let text = |key: &str| frame.get(key).and_then(Value::as_str);
        if let Some(path) = text("img_path").map(Path::new)
            && path.starts_with(self.folder)
            && !path.components().any(|part| part == Component::ParentDir)
            && path.is_file()
        {
            let written = text("file_path").or(text("img_path")).unwrap_or_default();
            return Ok((written, path.to_owned()));
        }
        let written = text("file_path").ok_or("it has no `file_path`")?;
        Ok((written, find_image(self.folder, written, text("file_ext"))?))
    }

    /// Intrinsics of the frame, else of the whole file.
    fn intrinsics(&self, frame: &Object) -> Result<Intrinsics, String> {
        for from in [frame, self.top] {
            if let Some(value) = present(from, "camera_intrinsics") {
                let n = numbers("camera_intrinsics", value, 4)?;
                // Centre first.
                return Intrinsics::given([n[2], n[3]], Some([n[0], n[1]]));
            }
            if let Some(fx) = number(from, "fl_x")? {
                let fy = number(from, "fl_y")?.unwrap_or(fx);
                let principal = number(from, "cx")?.zip(number(from, "cy")?).map(|(cx, cy)| [cx, cy]);
                return Intrinsics::given([fx, fy], principal);
            }
            if let Some(angle) = number(from, "camera_angle_x")? {
                let sound = angle > 1e-4 && angle < std::f64::consts::PI - 1e-3;
                return sound
                    .then_some(Intrinsics::Angle(angle))
                    .ok_or(format!("a field of view of {angle} rad (camera_angle_x) is none"));
            }
        }
        Err("neither it nor the file has camera_angle_x, camera_intrinsics or fl_x".into())
    }

    /// Distortion of the frame's lens, else of the whole file's (nerfstudio, instant-ngp).
    fn lens(&self, frame: &Object) -> Result<Lens, String> {
        let text = |from: &'a Object| from.get("camera_model").and_then(Value::as_str);
        let model = frame.get("camera_model").and_then(Value::as_str).or(text(self.top));
        if let Some(model) = model
            && !PERSPECTIVE.contains(&model)
        {
            return Err(format!("its `camera_model` is {model}; {UNDISTORT}"));
        }
        let coefficient = |key: &str| -> Result<f64, String> {
            let own = number(frame, key)?;
            own.map_or_else(|| Ok(number(self.top, key)?.unwrap_or(0.0)), Ok)
        };
        let [k1, k2, k3, k4, p1, p2] = ["k1", "k2", "k3", "k4", "p1", "p2"].map(coefficient);
        Ok(Lens {
            radial: [k1?, k2?, k3?, k4?],
            tangential: [p1?, p2?],
        })
    }

    /// The file that `ply_file_path` names.
    fn points(&self) -> Result<Option<PathBuf>, CaptureError> {
        let Some(written) = self.top.get("ply_file_path").and_then(Value::as_str) else {
            return Ok(None);
        };
        let path = inside(written).map(|path| self.folder.join(path));
        path.map(Some)
            .map_err(|what| self.fault(what, "correct `ply_file_path`"))
    }

    fn declared_size(&self, frame: &Object) -> Result<Option<[f64; 2]>, String> {
        for from in [frame, self.top] {
            for [w, h] in [["w", "h"], ["width", "height"]] {
                if let Some(size) = number(from, w)?.zip(number(from, h)?) {
                    return sound_size([size.0, size.1]).map(Some);
                }
            }
        }
        Ok(None)
    }
}

/// `transform_matrix`, or the refined pose of GS³ (`R_opt`, `T_opt`: world to camera in OpenCV's axes, the rotation
/// transposed).
fn pose(frame: &Object) -> Result<Pinhole, String> {
    let bad = "spans no space, is mirrored, or holds numbers beyond reason";
    if let (Some(r), Some(t)) = (present(frame, "R_opt"), present(frame, "T_opt")) {
        let world_from_camera = world_from_camera(&matrix("R_opt", r, 3, 3)?);
        return colmap::pose(world_from_camera, three("T_opt", t)?).ok_or(format!("R_opt {bad}"));
    }
    let value = present(frame, "transform_matrix").ok_or("it has no `transform_matrix`")?;
    let rows = matrix("transform_matrix", value, 3, 4)?;
    Pinhole::from_opengl(world_from_camera(&rows), column(&rows, 3)).ok_or(format!("transform_matrix {bad}"))
}

fn world_from_camera(rows: &[Vec<f64>]) -> DMat3 {
    DMat3::from_cols(column(rows, 0), column(rows, 1), column(rows, 2))
}

fn column(rows: &[Vec<f64>], k: usize) -> DVec3 {
    DVec3::new(rows[0][k], rows[1][k], rows[2][k])
}

/// `pl_pos` with `pl_intensity`, or `light` with `position` and `intensity`; `null` is no light.
fn light_of(frame: &Object) -> Result<Option<PointLight>, String> {
    let light = || frame.get("light").and_then(Value::as_object);
    let (position, strength) = match present(frame, "pl_pos") {
        Some(position) => (Some(position), present(frame, "pl_intensity")),
        None => light().map_or((None, None), |light| {
            (present(light, "position"), present(light, "intensity"))
        }),
    };
    let Some(position) = position else { return Ok(None) };
    Ok(Some(PointLight {
        position: three("pl_pos", position)?,
        intensity: strength.map(intensity).transpose()?,
    }))
}

/// A number for all colours, or one for each.
fn intensity(value: &Value) -> Result<[f64; 3], String> {
    let all = match value.as_f64() {
        Some(one) => [one; 3],
        None => three("a light's intensity", value)?.into(),
    };
    let sound = all.iter().all(|i| (0.0..1e12).contains(i));
    sound
        .then_some(all)
        .ok_or(format!("a light of intensity {all:?} is none"))
}

/// Value of a key; `None` where it is absent or null.
fn present<'a>(object: &'a Object, key: &str) -> Option<&'a Value> {
    object.get(key).filter(|value| !value.is_null())
}

fn number(object: &Object, key: &str) -> Result<Option<f64>, String> {
    let value = present(object, key);
    value
        .map(|value| value.as_f64().ok_or(format!("`{key}` is not a number")))
        .transpose()
}

fn numbers(key: &str, value: &Value, count: usize) -> Result<Vec<f64>, String> {
    let list: Option<Vec<f64>> = value
        .as_array()
        .and_then(|list| list.iter().map(Value::as_f64).collect());
    list.filter(|list| list.len() == count && list.iter().all(|n| n.is_finite()))
        .ok_or(format!("`{key}` is not a list of {count} finite numbers"))
}

fn three(key: &str, value: &Value) -> Result<DVec3, String> {
    numbers(key, value, 3).map(|n| DVec3::new(n[0], n[1], n[2]))
}

/// At least `rows` rows of `columns` numbers.
fn matrix(key: &str, value: &Value, rows: usize, columns: usize) -> Result<Vec<Vec<f64>>, String> {
    let list = value.as_array().filter(|list| list.len() >= rows);
    let list = list.ok_or(format!("`{key}` has fewer than {rows} rows"))?;
    list[..rows].iter().map(|row| numbers(key, row, columns)).collect()
}

#[cfg(test)]
mod tests;
