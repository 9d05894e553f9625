//! The planner: which components a scene requires, and why, before anything is trained.
//!
//! Decided from what is known then: views, dates, suns, bands and baselines. `inspect` shows the plan, `run.toml` keeps it, and every
//! entry gives way to a value that was set.

use super::config::SatelliteConfig;
use super::shadow_prior::ENOUGH_VIEWS;
use glam::Vec3;
use heliosplat_scene::{BandKind, Scene, SceneImage};
use heliosplat_scene::{crop, saturation};
use heliosplat_stereo::MANY_VIEWS;
use heliosplat_stereo::clouds::FEWEST_VIEWS;

/// One component of the model, whether the scene requires it, and why.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PlanItem {
    /// Its name: that of the configuration, where it can be set.
    pub component: String,
    /// Whether it is on.
    pub on: bool,
    /// Why, in one line.
    pub reason: String,
}

/// Ratio of base to height above which pairs tell altitudes apart well, and below which hardly.
const WIDE_BASE: f32 = 0.15;

/// What the plan is made from.
struct Facts {
    images: usize,
    dates: usize,
    /// Lowest and highest sun, degrees.
    suns_deg: (f64, f64),
    /// Widest ratio of base to height of two images.
    base_to_height: f32,
    near_infrared: bool,
    /// Share of the values that are clipped.
    clipped: f64,
    /// Largest difference between the given cameras and the pinhole cameras fitted to them, pixels.
    residual_px: f64,
}

impl Facts {
    fn of(scene: &Scene) -> Self {
        let images: Vec<&SceneImage> = scene.training().collect();
        let elevations = || images.iter().map(|image| image.sun.elevation_rad.to_degrees());
        let parallax: Vec<Vec3> = images.iter().map(|image| parallax(image)).collect();
        let bases = parallax
            .iter()
            .enumerate()
            .flat_map(|(i, a)| parallax[..i].iter().map(move |b| a.distance(*b)));
        let has = |kind| images.iter().all(|image| image.bands.contains(&kind));
        Self {
            images: images.len(),
            dates: crop::date_groups(&images)
                .into_iter()
                .max()
                .map_or(0, |last| last as usize + 1),
            suns_deg: (
                elevations().fold(f64::INFINITY, f64::min),
                elevations().fold(f64::NEG_INFINITY, f64::max),
            ),
            base_to_height: bases.fold(0.0, f32::max),
            near_infrared: has(BandKind::Red) && has(BandKind::NearInfrared),
            clipped: images.iter().map(|image| saturation::share(&image.pixels)).sum::<f64>()
                / images.len().max(1) as f64,
            residual_px: images.iter().map(|image| image.pinhole.max_px).fold(0.0, f64::max),
        }
    }
}

/// How far the ray of the image's middle moves over the ground per metre of altitude.
fn parallax(image: &SceneImage) -> Vec3 {
    let (width, height) = (image.pixels.width, image.pixels.height);
    let whole = crop::Crop {
        col0: 0,
        row0: 0,
        width,
        height,
    };
    let camera = crop::camera(&image.pinhole.map, &whole, [0.0; 2]);
    let ray = camera.ray_direction(width as f32 / 2.0, height as f32 / 2.0);
    ray / if ray.z.abs() > 1e-3 { ray.z } else { -1e-3 }
}

/// Which components of the model this scene requires; what `config` sets stays as it is.
pub fn plan(scene: &Scene, config: &SatelliteConfig) -> Vec<PlanItem> {
    items(&Facts::of(scene), config)
}

fn items(facts: &Facts, config: &SatelliteConfig) -> Vec<PlanItem> {
    let item = |component: &str, on: bool, reason: String| PlanItem {
        component: component.into(),
        on,
        reason,
    };
    // What was set wins, and says so.
    let decided = |component: &str, set: Option<bool>, on: bool, reason: String| match set {
        Some(set) if set != on => item(
            component,
            set,
            format!("set so; otherwise {}: {reason}", if on { "on" } else { "off" }),
        ),
        _ => item(component, on, reason),
    };
    let &Facts { images, dates, .. } = facts;
    let (lowest, highest) = facts.suns_deg;
    vec![
        item(
            "sun",
            true,
            format!("{dates} date(s) with known suns, {lowest:.0} to {highest:.0} degrees high: cast shadows are traced through the geometry"),
        ),
        decided(
            "model.image_colour",
            config.model.image_colour,
            dates > 1,
            if dates > 1 {
                format!("{dates} dates differ in haze, exposure and season: each image gets an affine colour")
            } else {
                "all images are of one date: one colour serves".into()
            },
        ),
        decided(
            "model.clouds",
            config.model.clouds,
            images >= FEWEST_VIEWS,
            if images >= FEWEST_VIEWS {
                format!("{images} views: what one shows brighter than the others show the ground in the sun is a cloud, and left out")
            } else {
                format!("{images} views cannot say which of them shows a cloud")
            },
        ),
        decided(
            "model.saturation",
            config.model.saturation,
            facts.clipped > 0.0,
            if facts.clipped > 0.0 {
                format!("{:.2} % of the values are as great as their images can say: the model may be brighter", 100.0 * facts.clipped)
            } else {
                "no image is clipped".into()
            },
        ),
        decided(
            "model.shadow_prior",
            config.model.shadow_prior,
            images < ENOUGH_VIEWS,
            if images < ENOUGH_VIEWS {
                format!("{images} views say little of what throws a shadow: dark places with something toward the sun guide it")
            } else {
                format!("{images} views: shadows follow from what they agree on")
            },
        ),
        item(
            "start.vegetation_index",
            facts.near_infrared && images >= 2,
            if facts.near_infrared {
                "red and near infrared: leaves are told from pavement where both are as bright".into()
            } else {
                "no near infrared in all images: the sweep compares brightness alone".into()
            },
        ),
        item(
            "start.bold_search",
            images >= MANY_VIEWS,
            if images >= MANY_VIEWS {
                format!("{images} views: what they agree on is seldom chance, so walls and trees are sought boldly")
            } else {
                format!("{images} views agree by chance more often: the surface is sought with caution")
            },
        ),
        item(
            "start.wide_windows",
            facts.base_to_height < WIDE_BASE,
            format!(
                "widest ratio of base to height {:.2}: {}",
                facts.base_to_height,
                if facts.base_to_height < WIDE_BASE {
                    "a pixel is metres of altitude, so costs are averaged and surfaces smoothed"
                } else {
                    "single cells tell altitudes apart"
                }
            ),
        ),
        item(
            "cameras.pinhole",
            true,
            format!("pinhole cameras fit the given ones to {:.3} px over the area", facts.residual_px),
        ),
        item(
            "cameras.align",
            config.cameras.align != super::config::Align::Off,
            "one shift per image is estimated, and used where it exceeds a quarter pixel and the images agree better with it".into(),
        ),
        item(
            "cameras.refine",
            config.cameras.refine,
            "images are moved against each other before training; moving them in it too is for cameras that stay off".into(),
        ),
        item(
            "model.facing",
            config.model.facing,
            "roofs and façades are as bright as they face the sun".into(),
        ),
        item(
            "model.near_light",
            config.model.near_light,
            "light reflected into shadows is below what one ground sample shows".into(),
        ),
        item(
            "model.sh_degree",
            config.model.sh_degree > 0,
            match config.model.sh_degree {
                0 => "surfaces look alike from all views: one albedo per Gaussian and band serves".into(),
                degree => format!("albedo may change with the viewing direction, to degree {degree}"),
            },
        ),
    ]
}

/// The configuration with what the plan decides where nothing was set.
pub fn with_plan(scene: &Scene, config: &SatelliteConfig) -> SatelliteConfig {
    let plan = plan(scene, config);
    let on = |component: &str| plan.iter().find(|item| item.component == component).map(|item| item.on);
    let mut config = config.clone();
    let model = &mut config.model;
    model.image_colour = model.image_colour.or(on("model.image_colour"));
    model.clouds = model.clouds.or(on("model.clouds"));
    model.saturation = model.saturation.or(on("model.saturation"));
    model.shadow_prior = model.shadow_prior.or(on("model.shadow_prior"));
    config
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts(images: usize, dates: usize) -> Facts {
        Facts {
            images,
            dates,
            suns_deg: (35.0, 60.0),
            base_to_height: 0.4,
            near_infrared: true,
            clipped: 0.0,
            residual_px: 0.01,
        }
    }

    fn on(facts: &Facts, config: &SatelliteConfig, component: &str) -> bool {
        let items = items(facts, config);
        let found = items.iter().find(|item| item.component == component);
        found.is_some_and(|item| item.on)
    }

    #[test]
    fn few_views_get_a_prior_and_many_dates_their_colours() {
        let config = SatelliteConfig::default();
        assert!(on(&facts(3, 3), &config, "model.shadow_prior") && on(&facts(3, 3), &config, "model.image_colour"));
        assert!(!on(&facts(9, 1), &config, "model.shadow_prior") && !on(&facts(9, 1), &config, "model.image_colour"));
        assert!(on(&facts(9, 1), &config, "start.bold_search") && !on(&facts(3, 1), &config, "start.bold_search"));
    }

    #[test]
    fn what_was_set_stays_and_says_so() {
        let mut config = SatelliteConfig::default();
        config.model.shadow_prior = Some(true);
        let items = items(&facts(12, 5), &config);
        let prior = items.iter().find(|item| item.component == "model.shadow_prior");
        assert!(prior.is_some_and(|item| item.on && item.reason.starts_with("set so")));
    }

    #[test]
    fn the_degree_of_albedo_is_said() {
        let mut config = SatelliteConfig::default();
        assert!(!on(&facts(9, 3), &config, "model.sh_degree"));
        config.model.sh_degree = 2;
        let items = items(&facts(9, 3), &config);
        let degree = items.iter().find(|item| item.component == "model.sh_degree");
        assert!(degree.is_some_and(|item| item.on && item.reason.ends_with("degree 2")));
    }

    #[test]
    fn a_short_base_and_missing_bands_are_seen() {
        let mut scene = facts(2, 1);
        scene.base_to_height = 0.085;
        scene.near_infrared = false;
        let config = SatelliteConfig::default();
        assert!(on(&scene, &config, "start.wide_windows") && !on(&scene, &config, "start.vegetation_index"));
    }
}
