// Projection of each Gaussian to its splat, and the key of its depth; those not seen have the last key.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> parameters: array<f32>;
@group(0) @binding(2) var<storage, read_write> splats: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> depth_keys: array<u32>;
@group(0) @binding(4) var<storage, read_write> order: array<u32>;

fn seen(g: Whitened, opacity: f32, depth: f32, half_size: vec2f) -> bool {
    let size = vec2f(step.size.xy);
    let margin = 0.5 * (size.x + size.y) + 64.0;
    let at = vec2f(g.col, g.row);
    let near = all(at > vec2f(-margin)) && all(at < size + margin);
    let sound = finite(opacity) && finite(depth) && finite(g.conic.x) && finite(g.conic.y) && finite(g.conic.z) && g.det > 0.0;
    let inside = all(at + half_size >= vec2f(0.0)) && all(at - half_size <= size - 1.0);
    return g.denominator > 1e-6 && near && sound && inside && opacity > ALPHA_MIN;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = numbered(group, groups, local);
    let n = step.counts.x;
    if i >= n {
        return;
    }
    let g = whitened_of(i, n);
    let opacity = g.opacity * g.dimming;
    let depth = dot(step.axis.xyz, three(3u * i));
    let reach = 2.0 * log(opacity / ALPHA_MIN);
    let half_size = sqrt(reach * (g.covariance.xz + FILTER));
    let visible = seen(g, opacity, depth, half_size);
    splats[3u * i] = vec4f(g.col, g.row, half_size);
    splats[3u * i + 1u] = vec4f(g.conic, reach);
    splats[3u * i + 2u] = vec4f(opacity, depth, select(0.0, 1.0, visible), 0.0);
    let bits = bitcast<u32>(depth);
    let ordered = select(bits | 0x80000000u, ~bits, (bits >> 31u) == 1u);
    depth_keys[i] = select(0xffffffffu, ordered, visible);
    order[i] = i;
}
