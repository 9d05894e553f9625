// The image over the background, and coverage as a fourth band where there is one.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> maps: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> image: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = numbered(group, groups, local);
    let pixels = step.size.x * step.size.y;
    if i >= pixels {
        return;
    }
    let seen = maps[i];
    let colour = vec4f(seen.xyz + (1.0 - seen.w) * step.background.xyz, seen.w);
    for (var band = 0u; band < step.counts.z; band++) {
        image[band * pixels + i] = colour[band];
    }
}
