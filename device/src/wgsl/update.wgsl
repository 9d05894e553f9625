// The prior's gradients, one step of Adam for each number, and bounds of scales and opacities; nothing where the step has a fault.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> report: array<u32>;
@group(0) @binding(2) var<storage, read> gradients: array<f32>;
@group(0) @binding(3) var<storage, read_write> parameters: array<f32>;
@group(0) @binding(4) var<storage, read_write> first_moments: array<f32>;
@group(0) @binding(5) var<storage, read_write> second_moments: array<f32>;

// Column after the last of each group.
const ENDS = array<u32, 8>(3u, 6u, 10u, 11u, 14u, 23u, 38u, 59u);

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = numbered(group, groups, local);
    let functions = (step.counts.w + 1u) * (step.counts.w + 1u);
    if i >= (FEATURES + 3u * functions) * step.counts.x || report[FAULTS] != 0u {
        return;
    }
    var own = 0u;
    while i >= ENDS[own] * step.counts.x {
        own++;
    }
    let rate = step.rates[own / 4u][own % 4u];
    var value = parameters[i];
    if rate != 0.0 {
        var d = gradients[i];
        if own == 1u {
            d += step.prior.x * exp(value);
        }
        if own == 3u {
            let absorbed = 1.0 / (1.0 + exp(-value));
            d += step.prior.y * absorbed * (1.0 - absorbed);
        }
        let m = step.adam.x * first_moments[i] + (1.0 - step.adam.x) * d;
        let v = BETA2 * second_moments[i] + (1.0 - BETA2) * d * d;
        first_moments[i] = m;
        second_moments[i] = v;
        value -= rate / step.adam.y * m / (sqrt(v) / step.adam.z + EPSILON);
    }
    if own == 1u {
        value = clamp(value, step.bounds.x, step.bounds.y);
    }
    if own == 3u {
        value = clamp(value, step.bounds.z, step.bounds.w);
    }
    parameters[i] = value;
}
