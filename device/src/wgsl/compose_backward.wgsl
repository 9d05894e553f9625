// Gradients of the maps from those of the image.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> image_gradient: array<f32>;
@group(0) @binding(2) var<storage, read_write> map_gradients: array<vec4f>;

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
    var d = vec4f(0.0);
    for (var band = 0u; band < step.counts.z; band++) {
        d[band] = image_gradient[band * pixels + i];
    }
    map_gradients[i] = vec4f(d.xyz, d.w - dot(d.xyz, step.background.xyz));
}
