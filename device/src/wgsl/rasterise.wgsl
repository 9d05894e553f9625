// Composites the splats of each tile front to back: colours and alpha of a pixel, one invocation each.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> splats: array<vec4f>;
@group(0) @binding(2) var<storage, read> colours: array<vec4f>;
@group(0) @binding(3) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(4) var<storage, read> entries: array<u32>;
@group(0) @binding(5) var<storage, read> owners: array<u32>;
@group(0) @binding(6) var<storage, read_write> maps: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> report: array<atomic<u32>>;

const BATCH: u32 = 256u;

var<workgroup> batch: array<TileSplat, BATCH>;
var<workgroup> votes: atomic<u32>;
var<workgroup> transparent: u32;
var<workgroup> pairs_of_tile: atomic<u32>;

@compute @workgroup_size(16, 16)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_id) place: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let corner = group.xy * TILE;
    let pixel = corner + place.xy;
    let inside = all(pixel < step.size.xy);
    let range = ranges[group.y * step.size.z + group.x];
    var t = select(0.0, 1.0, inside);
    var sum = vec3f(0.0);
    var pairs = 0u;
    for (var first = range.x; first < range.y; first += BATCH) {
        if t >= T_MIN {
            atomicStore(&votes, 1u);
        }
        workgroupBarrier();
        if local == 0u {
            transparent = atomicExchange(&votes, 0u);
        }
        if workgroupUniformLoad(&transparent) == 0u {
            break;
        }
        let count = min(BATCH, range.y - first);
        if local < count {
            let s = owners[entries[first + local]];
            batch[local] = tile_splat(splats[3u * s], splats[3u * s + 1u], max(colours[s], vec4f(0.0)), corner);
        }
        workgroupBarrier();
        for (var k = 0u; k < count && t >= T_MIN; k++) {
            let order = exponent(batch[k], vec2f(place.xy));
            if order >= LOG2_ALPHA_MIN {
                let w = t * exp2(min(order, batch[k].centre.w));
                sum += w * batch[k].colour.xyz;
                t -= w;
                pairs++;
            }
        }
        workgroupBarrier();
    }
    if inside {
        maps[pixel.y * step.size.x + pixel.x] = vec4f(sum, 1.0 - t);
    }
    atomicAdd(&pairs_of_tile, pairs);
    workgroupBarrier();
    if local == 0u {
        atomicAdd(&report[PAIRS], atomicLoad(&pairs_of_tile));
    }
}
