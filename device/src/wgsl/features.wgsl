// Colours of the splats: `max(0, 1/2 + sum c_f Y_f)`, before the maximum; the fourth number is not used.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> parameters: array<f32>;
@group(0) @binding(2) var<storage, read_write> colours: array<vec4f>;

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
    let values = basis(view_direction(three(3u * i)).xyz);
    var sum = vec3f(0.0);
    let functions = (step.counts.w + 1u) * (step.counts.w + 1u);
    for (var f = 0u; f < functions; f++) {
        sum += values[f] * three(coefficient(f, degree_of(f), i, n));
    }
    colours[i] = vec4f(0.5 + sum, 0.0);
}
