// The window of SSIM over a tile of pixels and its margins, along rows, then along columns.

const TILE: u32 = 16u;
const RADIUS: u32 = 5u;
const TAPS: u32 = 11u;
const SIDE: u32 = 26u;
// Rows of the tile and its margins.
const ROWS: u32 = SIDE * TILE;
const WEIGHTS = array<f32, TAPS>(
    0.00102838, 0.00759876, 0.03600077, 0.10936069, 0.21300554, 0.26601172,
    0.21300554, 0.10936069, 0.03600077, 0.00759876, 0.00102838,
);

// Pixel of the tile and its margins, at `k` of 26 by 26; false outside the image.
fn margin_pixel(k: u32, group: vec3u) -> vec3u {
    let at = vec2i(group.xy * TILE) + vec2i(vec2u(k % SIDE, k / SIDE)) - i32(RADIUS);
    let inside = all(at >= vec2i(0)) && all(at < vec2i(step.size.xy));
    return vec3u(vec2u(max(at, vec2i(0))), select(0u, 1u, inside));
}

// Sum of a pair of numbers of all invocations, in a fixed order; the first has it.
fn total(own: vec2f, local: u32) -> vec2f {
    pairs[local] = own;
    workgroupBarrier();
    for (var reach = 128u; reach > 0u; reach /= 2u) {
        if local < reach {
            pairs[local] += pairs[local + reach];
        }
        workgroupBarrier();
    }
    return pairs[0];
}
