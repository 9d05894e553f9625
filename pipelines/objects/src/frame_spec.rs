//! An image of a capture as its files describe it, before the image is opened: pose, intrinsics, lens, light.

use super::pinhole::Pinhole;
use glam::DVec3;
use heliosplat::light::Light;
use std::path::{Component, Path, PathBuf};

/// Largest displacement by the lens that is ignored, pixels.
const LENS_TOLERANCE_PX: f64 = 0.5;
/// Remedy for images with distortion.
pub(super) const UNDISTORT: &str =
    "undistort the images, for example with `colmap image_undistorter`, and give the folder that it writes";

/// Intrinsics of a frame, before the size of its image is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Intrinsics {
    /// Focal lengths and principal point, pixels with corners at integers.
    Given {
        /// Along columns and rows.
        focal: [f64; 2],
        /// Column and row; the middle of the image where the files state none.
        principal: Option<[f64; 2]>,
    },
    /// Horizontal field of view, radians.
    Angle(f64),
}

impl Intrinsics {
    /// Intrinsics of these focal lengths and principal point.
    ///
    /// # Errors
    /// A sentence on numbers that no camera has.
    pub(super) fn given(focal: [f64; 2], principal: Option<[f64; 2]>) -> Result<Self, String> {
        let sound = focal.iter().all(|f| (1e-3..1e9).contains(f));
        let sound = sound && principal.is_none_or(|c| c.iter().all(|c| c.abs() < 1e9));
        sound.then_some(Self::Given { focal, principal }).ok_or(format!(
            "focal lengths {focal:?} and principal point {principal:?} are of no camera"
        ))
    }
}

/// Distortion of a lens (Brown 1971): along the radius by `1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸`, and tangential.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Lens {
    pub(super) radial: [f64; 4],
    pub(super) tangential: [f64; 2],
}

impl Lens {
    /// Largest displacement over the corners of an image, pixels.
    fn displacement_px(&self, camera: &Pinhole) -> f64 {
        let [width, height] = camera.size_px.map(|n| n as f64);
        let corners = [[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]];
        let displacement = |corner: [f64; 2]| {
            let [x, y] = [0, 1].map(|k| (corner[k] - 0.5 - camera.principal_px[k]) / camera.focal_px[k]);
            let r2 = x * x + y * y;
            let along = self.radial.iter().rev().fold(0.0, |sum, k| r2 * (sum + k));
            let [p1, p2] = self.tangential;
            let across = [
                2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ];
            let moved = [x, y].map(|c| c * along);
            (camera.focal_px[0] * (moved[0] + across[0])).hypot(camera.focal_px[1] * (moved[1] + across[1]))
        };
        corners.into_iter().map(displacement).fold(0.0, f64::max)
    }
}

/// A point light with its intensity.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PointLight {
    /// Position in the frame of the cameras, in the capture's units.
    pub position: DVec3,
    /// Intensity per colour, in the capture's own units; `None` where the files do not state it.
    pub intensity: Option<[f64; 3]>,
}

impl PointLight {
    /// Light of the engine, in a frame with the origin `centre`.
    pub fn seen_from(&self, centre: DVec3) -> Light {
        Light::Point((self.position - centre).as_vec3())
    }
}

/// One image as its files describe it.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameSpec {
    /// Name: the path as written, without extension.
    pub name: String,
    /// Path of the image file.
    pub path: PathBuf,
    /// Light, if stated.
    pub light: Option<PointLight>,
    /// Pose; intrinsics and size are unset.
    pub(super) pose: Pinhole,
    pub(super) intrinsics: Intrinsics,
    pub(super) declared_size: Option<[f64; 2]>,
    pub(super) lens: Lens,
}

impl FrameSpec {
    /// Camera of the frame, whose image has `size` pixels (columns, rows). Intrinsics for an image declared in another
    /// size are scaled.
    ///
    /// # Errors
    /// The fault and its remedy: the proportions of the declared size differ by more than 2 %, or the lens distorts.
    pub fn camera(&self, size: [usize; 2]) -> Result<Pinhole, (String, &'static str)> {
        let [width, height] = size.map(|n| n as f64);
        let (mut focal, principal) = match self.intrinsics {
            Intrinsics::Given { focal, principal } => (focal, principal),
            Intrinsics::Angle(angle) => ([0.5 * width / (0.5 * angle).tan(); 2], None),
        };
        let mut principal = principal.unwrap_or([0.5 * width, 0.5 * height]);
        if let (Some([w, h]), Intrinsics::Given { principal: given, .. }) = (self.declared_size, self.intrinsics) {
            let scale = [width / w, height / h];
            if (scale[0] / scale[1] - 1.0).abs() > 0.02 {
                return Err((
                    format!("the image has {width} x {height} pixels and not {w} x {h}"),
                    "correct the size of the image in the list of cameras",
                ));
            }
            for k in 0..2 {
                focal[k] *= scale[k];
                principal[k] *= if given.is_some() { scale[k] } else { 1.0 };
            }
        }
        let camera = Pinhole {
            focal_px: focal,
            // Corners at integers in the files, centres at integers here.
            principal_px: principal.map(|c| c - 0.5),
            size_px: size,
            ..self.pose
        };
        let displacement_px = self.lens.displacement_px(&camera);
        if displacement_px < LENS_TOLERANCE_PX {
            return Ok(camera);
        }
        Err((
            format!("the lens displaces pixels by up to {displacement_px:.1} pixels"),
            UNDISTORT,
        ))
    }
}

/// A size in pixels, if an image can have it.
///
/// # Errors
/// A sentence with the size.
pub(super) fn sound_size(size: [f64; 2]) -> Result<[f64; 2], String> {
    match size.iter().all(|&n| (1.0..1e6).contains(&n)) {
        true => Ok(size),
        false => Err(format!("an image of {} x {} pixels is none", size[0], size[1])),
    }
}

/// The file of an image as written, whose extension may be missing.
///
/// # Errors
/// A sentence on a path out of `folder`, or on a missing file.
pub(super) fn find_image(folder: &Path, written: &str, extension: Option<&str>) -> Result<PathBuf, String> {
    let whole = folder.join(inside(written)?);
    if whole.is_file() {
        return Ok(whole);
    }
    let known = [".png", ".exr", ".jpg", ".jpeg", ".PNG", ".EXR", ".JPG"];
    for ending in extension.into_iter().chain(known) {
        if ending.contains(['/', '\\']) {
            return Err(format!("`file_ext` {ending:?} is no extension"));
        }
        let dot = if ending.starts_with('.') { "" } else { "." };
        let mut name = whole.clone().into_os_string();
        name.push(dot);
        name.push(ending);
        let path = PathBuf::from(name);
        if path.is_file() {
            return Ok(path);
        }
    }
    Err(format!("there is no image {written} (nor with .png, .exr or .jpg)"))
}

/// A path as written, if it stays in its folder.
///
/// # Errors
/// A sentence with the path.
pub(super) fn inside(written: &str) -> Result<PathBuf, String> {
    // Files written on Windows.
    let text = written.replace('\\', "/");
    let mut path = PathBuf::new();
    for part in Path::new(&text).components() {
        let stays = match part {
            Component::CurDir => true,
            Component::Normal(name) => {
                path.push(name);
                true
            }
            Component::ParentDir => path.pop(),
            _ => false,
        };
        if !stays {
            return Err(format!("the path {written:?} points out of the folder"));
        }
    }
    if path.as_os_str().is_empty() {
        return Err("its path is empty".into());
    }
    Ok(path)
}

/// A path as written without `./` and without the extension of an image.
pub(super) fn plain_name(written: &str) -> String {
    let name = written.trim_start_matches("./");
    let ending = Path::new(name).extension().and_then(|e| e.to_str()).unwrap_or_default();
    let known = ["png", "exr", "jpg", "jpeg", "npy"].contains(&ending.to_ascii_lowercase().as_str());
    let length = name.len() - if known { ending.len() + 1 } else { 0 };
    name[..length].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    #[test]
    fn a_lens_that_moves_no_pixel_by_half_of_one_is_none() {
        let spec = |lens| FrameSpec {
            name: "a".into(),
            path: "a.png".into(),
            light: None,
            pose: Pinhole::from_opengl(DMat3::IDENTITY, DVec3::ZERO).expect("a frame"),
            intrinsics: Intrinsics::Given {
                focal: [100.0, 100.0],
                principal: None,
            },
            declared_size: None,
            lens,
        };
        let radial = |k1: f64| Lens {
            radial: [k1, 0.0, 0.0, 0.0],
            ..Lens::default()
        };
        // The corner is at (1, 0.5) in units of the focal length: r² = 1.25, r = 1.118.
        let displacement_px = 100.0 * 1.25f64.powf(1.5);
        assert!(spec(radial(0.4 / displacement_px)).camera([200, 100]).is_ok());
        let (fault, remedy) = spec(radial(-3.0 / displacement_px))
            .camera([200, 100])
            .expect_err("distorted");
        assert!(
            fault.contains("up to 3.0 pixels") && remedy.contains("image_undistorter"),
            "{fault}"
        );
        let tangential = Lens {
            tangential: [0.1, 0.0],
            ..Lens::default()
        };
        assert!(spec(tangential).camera([200, 100]).is_err());
    }
}
