// Gradient of the photometric loss to the image, and the sums of absolute differences: weighted, and of all pixels.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> truth: array<f32>;
@group(0) @binding(3) var<storage, read> slopes: array<f32>;
@group(0) @binding(4) var<storage, read_write> image_gradient: array<f32>;
@group(0) @binding(5) var<storage, read_write> difference_sums: array<vec2f>;

var<workgroup> around: array<vec3f, 676>;
var<workgroup> smooth_rows: array<vec3f, ROWS>;
var<workgroup> pairs: array<vec2f, 256>;

@compute @workgroup_size(16, 16)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_id) place: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let pixels = step.size.x * step.size.y;
    for (var k = local; k < SIDE * SIDE; k += 256u) {
        let at = margin_pixel(k, group);
        var slope = vec3f(0.0);
        if at.z == 1u {
            let i = 3u * group.z * pixels + at.y * step.size.x + at.x;
            slope = vec3f(slopes[i], slopes[i + pixels], slopes[i + 2u * pixels]);
        }
        around[k] = slope;
    }
    workgroupBarrier();
    for (var k = local; k < ROWS; k += 256u) {
        var sum = vec3f(0.0);
        for (var tap = 0u; tap < TAPS; tap++) {
            sum += WEIGHTS[tap] * around[k / TILE * SIDE + k % TILE + tap];
        }
        smooth_rows[k] = sum;
    }
    workgroupBarrier();
    let pixel = group.xy * TILE + place.xy;
    var differences = vec2f(0.0);
    if all(pixel < step.size.xy) {
        var slope = vec3f(0.0);
        for (var tap = 0u; tap < TAPS; tap++) {
            slope += WEIGHTS[tap] * smooth_rows[(place.y + tap) * TILE + place.x];
        }
        let i = pixel.y * step.size.x + pixel.x;
        let x = image[group.z * pixels + i];
        let found = truth_of(x, group.z, i);
        let difference = x - found.value;
        let d_ssim = select(0.0, slope.x + 2.0 * x * slope.y + found.value * slope.z, found.weight > 0.0);
        let d_l1 = (1.0 - LAMBDA) * found.weight * sign(difference);
        image_gradient[group.z * pixels + i] = (d_l1 - LAMBDA * d_ssim) * step.inverse_norm[group.z] * PHOTOMETRIC_WEIGHT;
        let all_pixels = select(0.0, abs(x - found.seen), found.known);
        differences = vec2f(found.weight * abs(difference) * step.inverse_norm[group.z], all_pixels);
    }
    let sum = total(differences, local);
    if local == 0u {
        difference_sums[(group.z * groups.y + group.y) * groups.x + group.x] = sum;
    }
}
