//! Options of the model, and the components of its light that can be shown alone.

/// Options of the one-light-at-a-time model.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OlatOptions {
    /// True if surfaces are glossy.
    pub specular: bool,
    /// True if the light that reaches a surface is traced.
    pub shadow: bool,
    /// True if light scatters under the surface.
    pub scattering: bool,
    /// True if the shadow network refines the traced shadows.
    pub refined: bool,
    /// Units of the hidden layers of both networks.
    pub width: usize,
    /// Hidden layers of both networks.
    pub hidden: usize,
    /// Half the side of the cube that contains the positions, scene units.
    pub half_size: f32,
    /// Colour behind everything.
    pub background: [f32; 3],
    /// True if images have coverage as a fourth band.
    pub coverage: bool,
    /// Distance `D` of the falloff, scene units: a light of strength one and no radius has the falloff one there.
    pub distance: f32,
    /// Radius of the lights, scene units.
    pub radius: f32,
    /// Weight of the depth–normal loss; 0 is off.
    pub normal_weight: f32,
    /// Range of depths, scene units, beyond which neighbouring pixels are an edge, not a slope.
    pub normal_edge: f32,
    /// The rendered component.
    pub shows: Component,
}

/// Components of the rendered light, to show one alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Component {
    /// All components.
    #[default]
    All,
    /// The diffuse part, in shadow too.
    Diffuse,
    /// The specular part, in shadow too.
    Specular,
    /// Transmittance toward the light alone, 0 to 1.
    Shadow,
    /// Light scattered under the surface.
    Scattering,
    /// The normals of the frames behind the colours, where a model rasterises them.
    Normal,
}

impl Default for OlatOptions {
    fn default() -> Self {
        Self {
            specular: true,
            shadow: true,
            scattering: false,
            refined: false,
            width: 32,
            hidden: 3,
            half_size: 1.0,
            background: [0.0; 3],
            coverage: false,
            distance: 1.0,
            radius: 0.0,
            normal_weight: 0.0,
            normal_edge: 0.1,
            shows: Component::All,
        }
    }
}
