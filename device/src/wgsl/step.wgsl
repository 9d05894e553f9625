// What every kernel of a step knows. Bindings are found by the names of their variables, see src/kernel.rs.

struct Step {
    // Coefficients of the column and of the row, each with its constant; the denominator; the axis of depth.
    u: vec4f,
    v: vec4f,
    w: vec4f,
    axis: vec4f,
    // Common point of all rays, and one; zero where rays are parallel.
    eye: vec4f,
    background: vec4f,
    // Per band: the value at which a pixel is saturated, and one over the bands' weights.
    ceiling: vec4f,
    inverse_norm: vec4f,
    // Columns and rows of pixels, then of tiles.
    size: vec4u,
    // Gaussians, room for entries, bands, degree of the harmonics.
    counts: vec4u,
    // Decay of the first moment, the two corrections of bias, pixels of the view.
    adam: vec4f,
    // Bounds of log scales and of opacities.
    bounds: vec4f,
    // Weights of the prior: of standard deviations and of opacities.
    prior: vec4f,
    // Learning rates, by group.
    rates: array<vec4f, 2>,
}

// Faults, entries, pairs, then losses as bits.
const FAULTS: u32 = 0u;
const ENTRIES: u32 = 1u;
const PAIRS: u32 = 2u;
const LOSSES: u32 = 4u;
// Bits of faults: the loss, one for each group of parameters, and no room for all entries.
const FAULT_LOSS: u32 = 1u;
const FAULT_GROUP: u32 = 2u;
const FAULT_ROOM: u32 = 0x80000000u;

// Groups of the table: where their columns begin.
const LOG_SCALE: u32 = 3u;
const ROTATION: u32 = 6u;
const OPACITY: u32 = 10u;
const FEATURES: u32 = 11u;

// Number of an invocation of 256 in a workgroup.
fn numbered(group: vec3u, groups: vec3u, local: u32) -> u32 {
    return (group.y * groups.x + group.x) * 256u + local;
}

// By bits: compilers may take comparisons with numbers that are not finite for constant.
fn below(x: f32, bound: f32) -> bool {
    return (bitcast<u32>(x) & 0x7fffffffu) < bitcast<u32>(bound);
}

fn finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7fffffffu) < 0x7f800000u;
}
