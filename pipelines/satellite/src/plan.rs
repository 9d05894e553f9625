//! The planner: components that a scene requires, decided once, before matching and training.
//!
//! [`Decisions::of`] uses views, dates, suns, bands, baselines and clipped values, and returns one value, which the
//! plane sweep, the initial state and the trainer use. `inspect` prints that value with its reasons, and `run.toml`
//! stores it. Settings of the user take precedence.

mod index;
mod light;

use index::Index;
pub use light::Lighting;

use super::config::{Align, SatelliteConfig, THRESHOLD_PX};
use super::ground::GroundViews;
use heliosplat_radiometry::shadow_prior::ENOUGH_VIEWS;
use heliosplat_radiometry::suns::ShadowSun;
use heliosplat_scene::{ImageSun, Scene, SceneImage, SunSource};
use heliosplat_scene::{crop, saturation};
use heliosplat_stereo::change::dividing_days;
use heliosplat_stereo::clouds::FEWEST_VIEWS;
use heliosplat_stereo::{FEW_VIEWS, MatchingFacts, MatchingParameters, no_match_weight};

/// Decisions for a scene.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Decisions {
    /// Lighting of the model.
    pub light: Lighting,
    /// True if images whose sun stays unknown are left out of training.
    pub only_known_suns: bool,
    /// True if each image has an affine colour.
    pub image_colour: bool,
    /// True if clouds are searched and left out.
    pub clouds: bool,
    /// True if changes of the ground between the images are searched.
    pub change: bool,
    /// True if clipped values count as lower bounds.
    pub saturation: bool,
    /// True if the sun-visibility prior guides training.
    pub shadow_prior: bool,
    /// True if the plane sweep compares a vegetation index besides brightness.
    pub vegetation_index: bool,
    /// Correction of the images' relative pointing.
    pub align: Align,
    /// True if Gaussians have near-surface light.
    pub near_light: bool,
    /// Largest degree of the spherical harmonics of albedo, 0 to 3.
    pub sh_degree: usize,
    /// Parameters of the plane sweep; `None` where no two images show the common ground.
    pub matching: Option<MatchingParameters>,
    /// Decisions in words, with reasons.
    #[serde(skip)]
    pub items: Vec<PlanItem>,
}

/// A component of the model: its state and the reason.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PlanItem {
    /// Name of the component; that of its setting, where there is one.
    pub component: String,
    /// True if the component is on.
    pub on: bool,
    /// Reason, in one line.
    pub reason: String,
}

impl PlanItem {
    fn new(component: &str, on: bool, reason: String) -> Self {
        Self {
            component: component.into(),
            on,
            reason,
        }
    }
}

/// Input of the plan.
struct Facts {
    images: usize,
    dates: usize,
    /// Number of images with a known sun.
    suns: usize,
    /// Lowest and highest elevation of these suns, degrees.
    suns_deg: (f64, f64),
    /// Number of days with enough images on either side for two surfaces; `None` where an image has no date.
    dividing_days: Option<usize>,
    /// Input for the choice of the sweep's matching parameters, or the reason why no ground can be matched.
    matching: Result<MatchingFacts, String>,
    /// The vegetation index, if there is one.
    index: Index,
    /// Share of clipped values, 0..1.
    clipped: f64,
    /// Largest difference between the rational cameras and the pinhole cameras fitted to them, pixels.
    residual_px: f64,
}

impl Facts {
    fn of(scene: &Scene, config: &SatelliteConfig) -> Self {
        let images: Vec<&SceneImage> = scene.training().collect();
        let known = || images.iter().filter_map(|image| image.sun.position);
        let elevations = || known().map(|sun| sun.elevation_rad.to_degrees());
        let ground = GroundViews::new(scene, scene.training()).map_err(|error| error.to_string());
        let cell_m = config.start.cell_gsd * scene.gsd_m;
        let index = Index::of(&images, cell_m);
        Self {
            images: images.len(),
            dates: crop::date_groups(&images)
                .into_iter()
                .max()
                .map_or(0, |last| last as usize + 1),
            suns: known().count(),
            suns_deg: (
                elevations().fold(f64::INFINITY, f64::min),
                elevations().fold(f64::NEG_INFINITY, f64::max),
            ),
            dividing_days: ground
                .as_ref()
                .map_or(Some(Vec::new()), GroundViews::days)
                .map(|days| dividing_days(&days).len()),
            matching: ground.map(|ground| MatchingFacts {
                has_index: index.is_there(),
                ..ground.matching_facts(cell_m)
            }),
            index,
            clipped: images.iter().map(|image| saturation::share(&image.pixels)).sum::<f64>()
                / images.len().max(1) as f64,
            residual_px: images.iter().map(|image| image.pinhole.max_px).fold(0.0, f64::max),
        }
    }

    fn is_divided(&self) -> bool {
        self.dividing_days.is_some_and(|days| days > 0)
    }
}

/// Plan item of the model's lighting.
const SUN: &str = "sun";
/// Plan item of the shadow prior.
const SHADOW_PRIOR: &str = "model.shadow_prior";
impl Decisions {
    /// Decisions for `scene`; settings in `config` take precedence.
    pub fn of(scene: &Scene, config: &SatelliteConfig) -> Self {
        Self::from_facts(&Facts::of(scene, config), config)
    }

    fn from_facts(facts: &Facts, config: &SatelliteConfig) -> Self {
        let model = &config.model;
        let light = facts.light();
        let mut decisions = Self {
            light,
            image_colour: model.image_colour.unwrap_or(facts.dates > 1),
            clouds: model.clouds.unwrap_or(facts.images >= FEWEST_VIEWS),
            change: model.change.unwrap_or(facts.is_divided()),
            saturation: model.saturation.unwrap_or(facts.clipped > 0.0),
            shadow_prior: model.shadow_prior.unwrap_or(facts.images < ENOUGH_VIEWS),
            vegetation_index: facts.index.is_there() && facts.images >= 2,
            align: config.cameras.align,
            only_known_suns: false,
            near_light: model.near_light,
            sh_degree: model.sh_degree,
            matching: facts.matching.as_ref().ok().map(MatchingParameters::choose),
            items: Vec::new(),
        };
        decisions.items = decisions.in_words(facts, config);
        decisions
    }

    /// Configuration completed by the decisions, as in `run.toml`.
    pub fn resolved(&self, config: &SatelliteConfig) -> SatelliteConfig {
        let mut config = config.clone();
        let model = &mut config.model;
        model.image_colour = Some(self.image_colour);
        model.clouds = Some(self.clouds);
        model.change = Some(self.change);
        model.saturation = Some(self.saturation);
        model.shadow_prior = Some(self.shadow_prior);
        config
    }

    /// Decisions after the search for suns: `suns` are those of the training images, `searched` the results of the
    /// search for each of them.
    pub(super) fn after_search(&self, suns: &[ImageSun], searched: &[Option<ShadowSun>]) -> Self {
        let mut decisions = self.clone();
        if self.light != Lighting::FromShadows {
            return decisions;
        }
        let any = |source: SunSource| suns.iter().any(|sun| sun.source == source);
        let lit = suns.iter().any(|sun| sun.position.is_some());
        decisions.light = match (lit, any(SunSource::Shadows)) {
            (true, true) => Lighting::FromShadows,
            (true, false) => Lighting::Known,
            (false, _) => Lighting::LeftOut,
        };
        let mut set = |component: &str, on: bool, reason: String| {
            let found = decisions.items.iter_mut().find(|item| item.component == component);
            if let Some(item) = found {
                (item.on, item.reason) = (on, reason);
            }
        };
        set(SUN, lit, light::search_in_words(suns, searched));
        decisions.only_known_suns = light::only_known(suns);
        if !lit {
            set(SHADOW_PRIOR, false, "no sun is known: shadows cannot be traced".into());
            decisions.shadow_prior = false;
        }
        decisions
    }

    /// Expected lighting of the model, with the reason.
    pub fn light_reason(&self) -> &str {
        let found = self.items.iter().find(|item| item.component == SUN);
        found.map_or("", |item| &item.reason)
    }

    fn in_words(&self, facts: &Facts, config: &SatelliteConfig) -> Vec<PlanItem> {
        let item = PlanItem::new;
        // Settings of the user take precedence, and the reason states that.
        let decided = |component: &str, set: Option<bool>, by_facts: bool, [yes, no]: [String; 2]| {
            let (otherwise, reason) = if by_facts { ("on", yes) } else { ("off", no) };
            match set {
                Some(set) if set != by_facts => {
                    item(component, set, format!("set so; otherwise {otherwise}: {reason}"))
                }
                _ => item(component, by_facts, reason),
            }
        };
        let &Facts { images, dates, .. } = facts;
        let [many_view_matching, cost_aggregation] = matching_items(&facts.matching, self.matching);
        vec![
            item(SUN, self.light != Lighting::LeftOut, facts.light_reason()),
            decided(
                "model.image_colour",
                config.model.image_colour,
                dates > 1,
                [
                    match facts.dividing_days {
                        None => "an image has no date: each image gets an affine colour".into(),
                        Some(_) => {
                            format!(
                                "{dates} dates differ in haze, exposure and season: each image gets an affine colour"
                            )
                        }
                    },
                    "all images are of one date: one colour is enough".into(),
                ],
            ),
            decided(
                "model.clouds",
                config.model.clouds,
                images >= FEWEST_VIEWS,
                [
                    format!(
                        "{images} views: areas much brighter than the sunlit ground of the other views are left out as clouds"
                    ),
                    format!("{images} views are too few to separate clouds from ground"),
                ],
            ),
            decided(
                "model.change",
                config.model.change,
                facts.is_divided(),
                [
                    format!(
                        "searching changed buildings; days with two images before and after: {}",
                        facts.dividing_days.unwrap_or(0)
                    ),
                    match facts.dividing_days {
                        None => "an image has no date: changes cannot be ordered in time".into(),
                        Some(_) => "no day has two images before and two after it, as a surface needs".into(),
                    },
                ],
            ),
            decided(
                "model.saturation",
                config.model.saturation,
                facts.clipped > 0.0,
                [
                    format!(
                        "{:.2} % of the values are saturated: the model may be brighter",
                        100.0 * facts.clipped
                    ),
                    "no image is clipped".into(),
                ],
            ),
            decided(
                SHADOW_PRIOR,
                config.model.shadow_prior,
                images < ENOUGH_VIEWS,
                [
                    format!("{images} views are few: dark pixels with an object toward the sun guide the shadows"),
                    format!("{images} views: enough to find shadows from the geometry alone"),
                ],
            ),
            item(
                "start.vegetation_index",
                self.vegetation_index,
                facts.index.reason().into(),
            ),
            many_view_matching,
            cost_aggregation,
            item(
                "cameras.pinhole",
                true,
                format!(
                    "pinhole cameras fit the given ones to {:.3} px over the area",
                    facts.residual_px
                ),
            ),
            item("cameras.align", self.align != Align::Off, pointing_reason(self.align)),
            item(
                "model.near_light",
                self.near_light,
                "coloured light in shadows, per Gaussian; only by --set".into(),
            ),
            item(
                "model.sh_degree",
                self.sh_degree > 0,
                match self.sh_degree {
                    0 => "one albedo per Gaussian and band, the same in all directions".into(),
                    degree => format!("albedo may change with the viewing direction, to degree {degree}"),
                },
            ),
        ]
    }
}

/// Plan items of the sweep's matching parameters: for many or for few views, and the windows.
fn matching_items(facts: &Result<MatchingFacts, String>, parameters: Option<MatchingParameters>) -> [PlanItem; 2] {
    let item = PlanItem::new;
    let components = ["start.many_views", "start.cost_aggregation"];
    let (facts, parameters) = match (facts, parameters) {
        (Ok(facts), Some(parameters)) => (facts, parameters),
        (facts, _) => {
            let reason = facts.as_ref().err().cloned().unwrap_or_default();
            return components.map(|component| item(component, false, reason.clone()));
        }
    };
    let [many_views, aggregation] = components;
    [
        item(
            many_views,
            facts.views > FEW_VIEWS,
            format!(
                "{:.1} views per cell on average: outlier weight {:.1} %, penalty of a height step {}, {}",
                facts.views,
                100.0 * no_match_weight(facts.views),
                parameters.jump_penalty,
                match parameters.same_date_weight {
                    Some(weight) => format!("pixel values of one date compared with weight {weight:.2}"),
                    None => "pixel values not compared".into(),
                }
            ),
        ),
        item(
            aggregation,
            parameters.aggregation_radius > 0,
            format!(
                "base-to-height ratio {:.2} of {:.1} views: {}",
                facts.combined_base_to_height,
                facts.views,
                windows(&parameters)
            ),
        ),
    ]
}

/// Windows over which the plane sweep averages its costs and smooths its surface, in words.
fn windows(parameters: &MatchingParameters) -> String {
    let side = |radius: usize| 2 * radius + 1;
    if parameters.aggregation_radius == 0 {
        return "matching by single cells, no smoothing".into();
    }
    let adaptive = match parameters.adaptive_plane_radius {
        Some(least) => format!(", {0} x {0} or more at low confidence", side(least)),
        None => String::new(),
    };
    format!(
        "costs averaged over {0} x {0} cells, smoothing by planes over {1} x {1}{adaptive}",
        side(parameters.aggregation_radius),
        side(parameters.plane_radius),
    )
}

/// Correction of the images' relative pointing, in words.
fn pointing_reason(align: Align) -> String {
    let method = "one shift per image is estimated from tie points";
    match align {
        Align::Auto => format!("{method}; used if the largest exceeds {THRESHOLD_PX} px"),
        Align::On => format!("{method}, and used"),
        Align::Off => "the cameras are used as they are".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts(images: usize, dates: usize) -> Facts {
        Facts {
            images,
            dates,
            suns: images,
            suns_deg: (35.0, 60.0),
            dividing_days: Some(dates.saturating_sub(1)),
            matching: Ok(MatchingFacts {
                views: images as f32,
                combined_base_to_height: 0.4,
                has_index: true,
            }),
            index: Index::Counts,
            clipped: 0.0,
            residual_px: 0.01,
        }
    }

    fn on(facts: &Facts, config: &SatelliteConfig, component: &str) -> bool {
        let items = Decisions::from_facts(facts, config).items;
        let found = items.iter().find(|item| item.component == component);
        found.is_some_and(|item| item.on)
    }

    #[test]
    fn few_views_get_a_prior_and_many_dates_their_colours() {
        let config = SatelliteConfig::default();
        assert!(on(&facts(3, 3), &config, "model.shadow_prior") && on(&facts(3, 3), &config, "model.image_colour"));
        assert!(!on(&facts(9, 1), &config, "model.shadow_prior") && !on(&facts(9, 1), &config, "model.image_colour"));
        let component = "start.many_views";
        assert!(on(&facts(9, 1), &config, component) && !on(&facts(3, 1), &config, component));
    }

    fn shadow_sun(margin: f64) -> ShadowSun {
        ShadowSun {
            azimuth_deg: 150.0,
            elevation_deg: 40.0,
            sigma_deg: 0.7,
            score: 0.5,
            margin,
            of_model: false,
        }
    }

    #[test]
    fn where_no_sun_is_found_the_light_is_left_out_whatever_is_set() {
        let mut config = SatelliteConfig::default();
        config.model.shadow_prior = Some(true);
        let dark = Facts { suns: 0, ..facts(3, 3) };
        let before = Decisions::from_facts(&dark, &config);
        assert_eq!(before.light, Lighting::FromShadows);
        let after = before.after_search(&[ImageSun::unknown(); 3], &[None, Some(shadow_sun(1.3)), None]);
        assert_eq!(after.light, Lighting::LeftOut);
        assert!(!after.shadow_prior && after.image_colour);
        let off = |component| after.items.iter().any(|item| item.component == component && !item.on);
        assert!(off(SUN) && off(SHADOW_PRIOR));
        assert!(
            after.light_reason().contains("unknown for all 3 images"),
            "{}",
            after.light_reason()
        );
    }

    #[test]
    fn images_without_a_sun_are_counted() {
        let some = Facts { suns: 1, ..facts(3, 3) };
        let before = Decisions::from_facts(&some, &SatelliteConfig::default());
        assert!(
            before.light_reason().contains("2 of 3 images"),
            "{}",
            before.light_reason()
        );
        let position = heliosplat_rpc::sun::SunPosition::from_degrees(150.0, 40.0);
        let suns = [
            ImageSun::from_time(position),
            ImageSun::from_shadows(position, 0.7),
            ImageSun::unknown(),
        ];
        let after = before.after_search(&suns, &[None, Some(shadow_sun(9.0)), None]);
        assert_eq!(after.light, Lighting::FromShadows);
        let text = after.light_reason();
        assert!(
            text.contains("of 1 of 3 images are known") && text.contains("of 1 shadows give no direction"),
            "{text}"
        );
        assert!(
            !after.only_known_suns && text.contains("count as lit everywhere"),
            "{text}"
        );
    }

    #[test]
    fn few_images_without_a_sun_are_left_out_of_training_and_the_plan_says_so() {
        let some = Facts { suns: 3, ..facts(4, 4) };
        let before = Decisions::from_facts(&some, &SatelliteConfig::default());
        let position = heliosplat_rpc::sun::SunPosition::from_degrees(150.0, 40.0);
        let mut suns = [ImageSun::from_time(position); 4];
        suns[3] = ImageSun::unknown();
        let after = before.after_search(&suns, &[None; 4]);
        let text = after.light_reason();
        assert!(
            after.only_known_suns && text.contains("take no part in training"),
            "{text}"
        );
    }

    #[test]
    fn change_is_searched_where_dates_can_tell_it_unless_it_is_set_otherwise() {
        let mut config = SatelliteConfig::default();
        assert!(on(&facts(12, 6), &config, "model.change"));
        assert!(!on(&facts(12, 1), &config, "model.change"));
        let dateless = Facts {
            dividing_days: None,
            ..facts(12, 6)
        };
        assert!(!on(&dateless, &config, "model.change"));
        config.model.change = Some(false);
        assert!(!on(&facts(12, 6), &config, "model.change"));
        assert!(reason(&facts(12, 6), &config, "model.change").starts_with("set so"));
    }

    #[test]
    fn what_was_set_stays_and_says_so() {
        let mut config = SatelliteConfig::default();
        config.model.shadow_prior = Some(true);
        let items = Decisions::from_facts(&facts(12, 5), &config).items;
        let prior = items.iter().find(|item| item.component == "model.shadow_prior");
        assert!(prior.is_some_and(|item| item.on && item.reason.starts_with("set so")));
    }

    #[test]
    fn the_degree_of_albedo_is_said() {
        let mut config = SatelliteConfig::default();
        assert!(!on(&facts(9, 3), &config, "model.sh_degree"));
        config.model.sh_degree = 2;
        let items = Decisions::from_facts(&facts(9, 3), &config).items;
        let degree = items.iter().find(|item| item.component == "model.sh_degree");
        assert!(degree.is_some_and(|item| item.on && item.reason.ends_with("degree 2")));
    }

    fn reason(facts: &Facts, config: &SatelliteConfig, component: &str) -> String {
        let items = Decisions::from_facts(facts, config).items;
        let found = items.into_iter().find(|item| item.component == component);
        found.map(|item| item.reason).unwrap_or_default()
    }

    #[test]
    fn missing_bands_are_seen() {
        let mut scene = facts(2, 1);
        scene.index = Index::NoBands;
        assert!(!on(&scene, &SatelliteConfig::default(), "start.vegetation_index"));
        scene.index = Index::Coarse;
        assert!(!on(&scene, &SatelliteConfig::default(), "start.vegetation_index"));
    }

    #[test]
    fn the_windows_said_are_those_that_the_sweep_is_given() {
        let config = SatelliteConfig::default();
        let mut scene = facts(2, 1);
        for ratio in [0.085, 0.31, 0.5, 1.2] {
            let matching = MatchingFacts {
                views: 6.0,
                combined_base_to_height: ratio,
                has_index: false,
            };
            scene.matching = Ok(matching);
            let parameters = MatchingParameters::choose(&matching);
            let (radius, text) = (
                parameters.aggregation_radius,
                reason(&scene, &config, "start.cost_aggregation"),
            );
            assert_eq!(on(&scene, &config, "start.cost_aggregation"), radius > 0);
            let side = 2 * radius + 1;
            assert_eq!(
                text.contains(&format!("averaged over {side} x {side} cells")),
                radius > 0,
                "{text}"
            );
            assert_eq!(
                text.contains("confidence"),
                parameters.adaptive_plane_radius.is_some(),
                "{text}"
            );
        }
    }

    #[test]
    fn scenes_without_common_ground_are_planned_all_the_same() {
        let mut scene = facts(1, 1);
        scene.matching = Err("two images are needed".into());
        let config = SatelliteConfig::default();
        assert_eq!(
            reason(&scene, &config, "start.cost_aggregation"),
            "two images are needed"
        );
        assert!(!on(&scene, &config, "start.many_views"));
    }

    #[test]
    fn the_threshold_of_pointing_is_that_of_the_configuration() {
        let config = SatelliteConfig::default();
        let text = reason(&facts(3, 1), &config, "cameras.align");
        assert!(text.contains("tie points") && text.contains("0.1 px"), "{text}");
    }
}
