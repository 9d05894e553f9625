// Splats: three vectors each, `[col, row, half width, half height]`, `[conic, reach]`, `[opacity, depth, visible, 0]`.

// Columns and rows of a tile, pixels.
const TILE: u32 = 16u;
// log2 of the least alpha and of the alpha at saturation, and the transmittance of an opaque pixel.
const LOG2_ALPHA_MIN: f32 = -7.9943533;
const LOG2_ALPHA_MAX: f32 = -0.01449957;
const T_MIN: f32 = 1e-4;
const LOG2_E: f32 = 1.442695;

// First column and row of the tiles that a splat touches, and one past the last.
fn span(box: vec4f, tiles: vec2u) -> vec4u {
    let low = vec2u(max(ceil(box.xy - box.zw), vec2f(0.0))) / TILE;
    let last = floor(box.xy + box.zw);
    let beyond = select(vec2u(0u), vec2u(max(last, vec2f(0.0))) / TILE + 1u, last >= vec2f(0.0));
    let first = min(low, tiles);
    return vec4u(first, max(min(beyond, tiles), first));
}

// A splat in the pixel coordinates of a tile, with its exponent to base two:
// `log2 alpha = (form.x x + form.y y) x + form.z y^2 + peak`.
struct TileSplat {
    // Column and row of the centre, the exponent there before and after saturation.
    centre: vec4f,
    form: vec4f,
    colour: vec4f,
}

fn tile_splat(box: vec4f, conic: vec4f, colour: vec4f, corner: vec2u) -> TileSplat {
    let peak = 0.5 * LOG2_E * conic.w + LOG2_ALPHA_MIN;
    return TileSplat(
        vec4f(box.xy - vec2f(corner), peak, min(peak, LOG2_ALPHA_MAX)),
        vec4f(-0.5 * LOG2_E * conic.x, -LOG2_E * conic.y, -0.5 * LOG2_E * conic.z, 0.0),
        colour,
    );
}

// log2 of alpha at a pixel of the tile, before saturation.
fn exponent(splat: TileSplat, pixel: vec2f) -> f32 {
    let at = pixel - splat.centre.xy;
    let tilt = splat.form.y * at.y;
    return (splat.form.x * at.x + tilt) * at.x + (splat.form.z * at.y * at.y + splat.centre.z);
}
