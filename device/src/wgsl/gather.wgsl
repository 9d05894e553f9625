// Gradients of each splat and of its colours: the sum of its records, in their order.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> splats: array<vec4f>;
@group(0) @binding(2) var<storage, read> places: array<vec2u>;
@group(0) @binding(3) var<storage, read> records: array<f32>;
@group(0) @binding(4) var<storage, read_write> colour_gradients: array<vec4f>;
// Two vectors each, `[column, row, opacity, 0]` and `[conic, 0]`.
@group(0) @binding(5) var<storage, read_write> splat_gradients: array<vec4f>;

const WIDTH: u32 = 9u;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let s = numbered(group, groups, local);
    if s >= step.counts.x {
        return;
    }
    let own = places[s];
    var sums: array<f32, WIDTH>;
    for (var r = own.x; r < own.x + own.y; r++) {
        for (var k = 0u; k < WIDTH; k++) {
            sums[k] += records[r * WIDTH + k];
        }
    }
    colour_gradients[s] = vec4f(sums[0], sums[1], sums[2], 0.0);
    let conic = splats[3u * s + 1u].xyz;
    var first = vec4f(0.0);
    if own.y > 0u {
        let centre = vec2f(conic.x * sums[4] + conic.y * sums[5], conic.y * sums[4] + conic.z * sums[5]);
        first = vec4f(centre, sums[3] / splats[3u * s + 2u].x, 0.0);
    }
    splat_gradients[2u * s] = first;
    splat_gradients[2u * s + 1u] = vec4f(-0.5 * sums[6], -sums[7], -0.5 * sums[8], 0.0);
}
