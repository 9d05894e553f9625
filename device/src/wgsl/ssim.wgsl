// SSIM of each pixel and band, weighted, and its slopes to the windowed means of x, xx and xy: three planes a band.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> truth: array<f32>;
@group(0) @binding(3) var<storage, read_write> slopes: array<f32>;
@group(0) @binding(4) var<storage, read_write> ssim_sums: array<f32>;

const C1: f32 = 0.01 * 0.01;
const C2: f32 = 0.03 * 0.03;

var<workgroup> both: array<vec2f, 676>;
var<workgroup> means: array<vec4f, ROWS>;
var<workgroup> products: array<f32, ROWS>;
var<workgroup> pairs: array<vec2f, 256>;

fn load(local: u32, group: vec3u) {
    let pixels = step.size.x * step.size.y;
    for (var k = local; k < SIDE * SIDE; k += 256u) {
        let at = margin_pixel(k, group);
        var x_and_y = vec2f(0.0);
        if at.z == 1u {
            let i = at.y * step.size.x + at.x;
            let x = image[group.z * pixels + i];
            x_and_y = vec2f(x, truth_of(x, group.z, i).value);
        }
        both[k] = x_and_y;
    }
}

// SSIM and its slopes from the means of x, y, xx, yy and xy.
fn ssim_of(mean: vec4f, xy: f32) -> vec4f {
    let a = mean.x;
    let b = mean.y;
    let vx = max(mean.z - a * a, 0.0);
    let vy = max(mean.w - b * b, 0.0);
    let bound = sqrt(vx * vy);
    let cov = clamp(xy - a * b, -bound, bound);
    let l_num = 2.0 * a * b + C1;
    let l_den = a * a + b * b + C1;
    let c_num = 2.0 * cov + C2;
    let c_den = vx + vy + C2;
    let ssim = (l_num * c_num) / (l_den * c_den);
    let d_cov = 2.0 * l_num / (l_den * c_den);
    let d_vx = -ssim / c_den;
    let d_mean = 2.0 * b * c_num / (l_den * c_den) - 2.0 * a * ssim / l_den - 2.0 * a * d_vx - b * d_cov;
    return vec4f(ssim, d_mean, d_vx, d_cov);
}

@compute @workgroup_size(16, 16)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_id) place: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    load(local, group);
    workgroupBarrier();
    for (var k = local; k < ROWS; k += 256u) {
        var mean = vec4f(0.0);
        var product = 0.0;
        for (var tap = 0u; tap < TAPS; tap++) {
            let value = both[k / TILE * SIDE + k % TILE + tap];
            mean += WEIGHTS[tap] * vec4f(value, value * value);
            product += WEIGHTS[tap] * (value.x * value.y);
        }
        means[k] = mean;
        products[k] = product;
    }
    workgroupBarrier();
    let pixel = group.xy * TILE + place.xy;
    var value = 0.0;
    if all(pixel < step.size.xy) {
        var mean = vec4f(0.0);
        var product = 0.0;
        for (var tap = 0u; tap < TAPS; tap++) {
            let k = (place.y + tap) * TILE + place.x;
            mean += WEIGHTS[tap] * means[k];
            product += WEIGHTS[tap] * products[k];
        }
        let pixels = step.size.x * step.size.y;
        let i = pixel.y * step.size.x + pixel.x;
        let found = truth_of(image[group.z * pixels + i], group.z, i).weight * ssim_of(mean, product);
        let at = 3u * group.z * pixels + i;
        slopes[at] = found.y;
        slopes[at + pixels] = found.z;
        slopes[at + 2u * pixels] = found.w;
        value = found.x * step.inverse_norm[group.z];
    }
    let sum = total(vec2f(value, 0.0), local);
    if local == 0u {
        ssim_sums[(group.z * groups.y + group.y) * groups.x + group.x] = sum.x;
    }
}
