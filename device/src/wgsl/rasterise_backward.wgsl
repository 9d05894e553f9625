// Gradients of each splat of a tile, front to back again: record `entry` gets three of the colours, then the sums of
// h, hx, hy, hx^2, hxy, hy^2 with `h` the gradient to the logarithm of alpha. A batch of splats is worked through by
// one invocation a pixel, then summed by 32 invocations a splat, always in the same order.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> splats: array<vec4f>;
@group(0) @binding(2) var<storage, read> colours: array<vec4f>;
@group(0) @binding(3) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(4) var<storage, read> entries: array<u32>;
@group(0) @binding(5) var<storage, read> owners: array<u32>;
@group(0) @binding(6) var<storage, read> maps: array<vec4f>;
@group(0) @binding(7) var<storage, read> map_gradients: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> records: array<f32>;

const BATCH: u32 = 8u;
const PIXELS: u32 = 256u;
const LANES: u32 = 32u;
const WIDTH: u32 = 9u;

var<workgroup> batch: array<TileSplat, BATCH>;
var<workgroup> slots: array<u32, BATCH>;
var<workgroup> to_maps: array<vec4f, PIXELS>;
// `h` and the weight by splat and pixel, then the sums of 32 lanes.
var<workgroup> arena: array<f32, 4096>;
var<workgroup> votes: atomic<u32>;
var<workgroup> transparent: u32;

// Sums of splat `k` over every 32nd pixel of the tile from `lane` on.
fn lane_sums(k: u32, lane: u32) -> array<f32, WIDTH> {
    var sums: array<f32, WIDTH>;
    for (var q = lane; q < PIXELS; q += LANES) {
        let h = arena[k * PIXELS + q];
        let d = arena[(BATCH + k) * PIXELS + q] * to_maps[q].xyz;
        let at = vec2f(vec2u(q % TILE, q / TILE)) - batch[k].centre.xy;
        let hx = h * at.x;
        let hy = h * at.y;
        sums[0] += d.x;
        sums[1] += d.y;
        sums[2] += d.z;
        sums[3] += h;
        sums[4] += hx;
        sums[5] += hy;
        sums[6] += hx * at.x;
        sums[7] += hx * at.y;
        sums[8] += hy * at.y;
    }
    return sums;
}

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
    var t = 0.0;
    var d_map = vec4f(0.0);
    var rest = 0.0;
    if inside {
        let i = pixel.y * step.size.x + pixel.x;
        t = 1.0;
        d_map = map_gradients[i];
        rest = dot(maps[i], d_map);
    }
    to_maps[local] = d_map;
    var first = range.x;
    for (; first < range.y; first += BATCH) {
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
            let entry = entries[first + local];
            let s = owners[entry];
            slots[local] = entry;
            batch[local] = tile_splat(splats[3u * s], splats[3u * s + 1u], max(colours[s], vec4f(0.0)), corner);
        }
        workgroupBarrier();
        for (var k = 0u; k < count; k++) {
            var h = 0.0;
            var w = 0.0;
            let order = exponent(batch[k], vec2f(place.xy));
            if t >= T_MIN && order >= LOG2_ALPHA_MIN {
                let alpha = exp2(min(order, batch[k].centre.w));
                w = t * alpha;
                let d = dot(batch[k].colour.xyz, d_map.xyz) + d_map.w;
                rest -= w * d;
                let to_log = alpha * (t * d - rest / (1.0 - alpha));
                h = select(to_log, 0.0, order >= LOG2_ALPHA_MAX);
                t -= w;
            }
            arena[k * PIXELS + local] = h;
            arena[(BATCH + k) * PIXELS + local] = w;
        }
        workgroupBarrier();
        let splat = local / LANES;
        let lane = local % LANES;
        var sums: array<f32, WIDTH>;
        if splat < count {
            sums = lane_sums(splat, lane);
        }
        workgroupBarrier();
        for (var quantity = 0u; quantity < WIDTH; quantity++) {
            arena[lane * (BATCH * WIDTH) + splat * WIDTH + quantity] = sums[quantity];
        }
        workgroupBarrier();
        if local < count * WIDTH {
            var sum = 0.0;
            for (var other = 0u; other < LANES; other++) {
                sum += arena[other * (BATCH * WIDTH) + local];
            }
            records[slots[local / WIDTH] * WIDTH + local % WIDTH] = sum;
        }
        workgroupBarrier();
    }
    // Behind opaque pixels nothing has a gradient.
    for (var at = first + local; at < range.y; at += PIXELS) {
        for (var quantity = 0u; quantity < WIDTH; quantity++) {
            records[entries[at] * WIDTH + quantity] = 0.0;
        }
    }
}
