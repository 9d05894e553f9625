// Where the entries of each tile begin and end in the sorted list.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> report: array<u32>;
@group(0) @binding(2) var<storage, read> tile_keys: array<u32>;
@group(0) @binding(3) var<storage, read_write> ranges: array<vec2u>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = numbered(group, groups, local);
    let count = min(report[ENTRIES], step.counts.y);
    if i >= count {
        return;
    }
    let tile = tile_keys[i];
    if i == 0u || tile_keys[i - 1u] != tile {
        ranges[tile].x = i;
    }
    if i + 1u == count || tile_keys[i + 1u] != tile {
        ranges[tile].y = i + 1u;
    }
}
