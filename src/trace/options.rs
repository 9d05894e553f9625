//! Options of tracing light.

/// How the Gaussians on a ray of parallel light are found. Both routes meet the same Gaussians.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Route {
    /// Grids in the plane normal to the light: cheapest, parallel light only.
    SunPlane,
    /// The bounding volume hierarchy that also answers point lights.
    Hierarchy,
}

/// How light is traced. The defaults keep a lit plane lit at every elevation of the sun, see `light_ray`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TraceOptions {
    /// Peaks nearer than this many standard deviations of the origin (along the ray) do not count.
    pub bias_sigmas: f32,
    /// How far a grazing ray starts above the surface of its origin, as a share of the full lift, see `light_ray`.
    pub lift: f32,
    /// How the Gaussians on a ray of parallel light are found; point lights always take the hierarchy.
    pub route: Route,
    /// Whether gradients reach the occluders; without them only those of the ray origins are found.
    pub occluder_gradients: bool,
}

impl Default for TraceOptions {
    fn default() -> Self {
        Self {
            bias_sigmas: 1.0,
            lift: 1.0,
            route: Route::SunPlane,
            occluder_gradients: true,
        }
    }
}
