// Lengths of the gradients in the image and numbers of views, for the control of density.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> report: array<u32>;
@group(0) @binding(2) var<storage, read> splats: array<vec4f>;
@group(0) @binding(3) var<storage, read> splat_gradients: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> gradient_lengths: array<f32>;
@group(0) @binding(5) var<storage, read_write> views_seen: array<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let s = numbered(group, groups, local);
    if s >= step.counts.x || report[FAULTS] != 0u || splats[3u * s + 2u].z == 0.0 {
        return;
    }
    gradient_lengths[s] += length(splat_gradients[2u * s].xy) * step.adam.w;
    views_seen[s] += 1u;
}
