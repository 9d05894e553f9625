// Gradients of the harmonics and, by the direction of view, of the positions.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> parameters: array<f32>;
@group(0) @binding(2) var<storage, read> colours: array<vec4f>;
@group(0) @binding(3) var<storage, read> colour_gradients: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> gradients: array<f32>;
@group(0) @binding(5) var<storage, read_write> report: array<atomic<u32>>;

fn store_three(at: u32, d: vec3f) {
    gradients[at] = d.x;
    gradients[at + 1u] = d.y;
    gradients[at + 2u] = d.z;
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
    // Below black only gradients that brighten pass: a clamped colour must be able to recover.
    let raw = colour_gradients[i].xyz;
    let d_colour = select(min(raw, vec3f(0.0)), raw, colours[i].xyz > vec3f(0.0));
    let view = view_direction(three(3u * i));
    let values = basis(view.xyz);
    let slopes = basis_gradients(view.xyz);
    var d_direction = vec3f(0.0);
    let functions = (step.counts.w + 1u) * (step.counts.w + 1u);
    for (var f = 0u; f < functions; f++) {
        let degree = degree_of(f);
        let at = coefficient(f, degree, i, n);
        d_direction += slopes[f] * dot(d_colour, three(at));
        let d = values[f] * d_colour;
        if !(below(d.x, GRADIENT_MAX) && below(d.y, GRADIENT_MAX) && below(d.z, GRADIENT_MAX)) {
            atomicOr(&report[FAULTS], FAULT_GROUP << (4u + degree));
        }
        store_three(at, d);
    }
    store_three(3u * i, (d_direction - view.xyz * dot(view.xyz, d_direction)) * view.w);
}
