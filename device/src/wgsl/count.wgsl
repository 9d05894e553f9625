// Number of tiles of each splat, in the order of depths.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> splats: array<vec4f>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read_write> tile_counts: array<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let rank = numbered(group, groups, local);
    if rank >= step.counts.x {
        return;
    }
    let s = order[rank];
    var count = 0u;
    if splats[3u * s + 2u].z > 0.0 {
        let tiles = span(splats[3u * s], step.size.zw);
        count = (tiles.z - tiles.x) * (tiles.w - tiles.y);
    }
    tile_counts[rank] = count;
}
