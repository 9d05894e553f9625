// Entries of each splat, one for each of its tiles: front to back, and those of a splat one after another. `places` says
// where the entries of a splat begin, and how many there are: they are its gradient records too.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> splats: array<vec4f>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(4) var<storage, read_write> places: array<vec2u>;
@group(0) @binding(5) var<storage, read_write> tile_keys: array<u32>;
@group(0) @binding(6) var<storage, read_write> entries: array<u32>;
@group(0) @binding(7) var<storage, read_write> owners: array<u32>;

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
    let first = tile_counts[rank];
    var entry = first;
    if splats[3u * s + 2u].z > 0.0 {
        let tiles = span(splats[3u * s], step.size.zw);
        for (var row = tiles.y; row < tiles.w; row++) {
            for (var column = tiles.x; column < tiles.z; column++) {
                if entry < step.counts.y {
                    tile_keys[entry] = row * step.size.z + column;
                    entries[entry] = entry;
                    owners[entry] = s;
                    entry++;
                }
            }
        }
    }
    places[s] = vec2u(first, entry - min(first, entry));
}
