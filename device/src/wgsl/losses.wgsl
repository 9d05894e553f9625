// Sums of the tiles' losses, by one workgroup: the photometric loss and the sum of absolute differences.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> ssim_sums: array<f32>;
@group(0) @binding(2) var<storage, read> difference_sums: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> report: array<u32>;

var<workgroup> sums: array<vec3f, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    let count = step.size.z * step.size.w * step.counts.z;
    var own = vec3f(0.0);
    for (var i = local; i < count; i += 256u) {
        own += vec3f(ssim_sums[i], difference_sums[i]);
    }
    sums[local] = own;
    workgroupBarrier();
    for (var reach = 128u; reach > 0u; reach /= 2u) {
        if local < reach {
            sums[local] += sums[local + reach];
        }
        workgroupBarrier();
    }
    if local == 0u {
        var bands = 0.0;
        for (var band = 0u; band < step.counts.z; band++) {
            bands += select(0.0, 1.0 / f32(step.counts.z), step.inverse_norm[band] > 0.0);
        }
        let loss = (1.0 - LAMBDA) * sums[0].y + LAMBDA * (bands - sums[0].x);
        report[LOSSES] = bitcast<u32>(loss);
        report[LOSSES + 1u] = bitcast<u32>(sums[0].z);
        if !finite(loss) {
            report[FAULTS] |= FAULT_LOSS;
        }
    }
}
