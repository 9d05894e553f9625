// Counts the digits of each block: `digit_counts[digit][block]`.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<uniform> sort_pass: SortPass;
@group(0) @binding(2) var<storage, read> report: array<u32>;
@group(0) @binding(3) var<storage, read> keys_in: array<u32>;
@group(0) @binding(4) var<storage, read_write> digit_counts: array<u32>;

var<workgroup> bins: array<atomic<u32>, DIGITS>;

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    if local < DIGITS {
        atomicStore(&bins[local], 0u);
    }
    workgroupBarrier();
    let count = keys_in_use(report[ENTRIES]);
    for (var k = 0u; k < KEYS; k++) {
        let at = group.x * BLOCK + k * THREADS + local;
        if at < count {
            atomicAdd(&bins[(keys_in[at] >> sort_pass.shift) & (DIGITS - 1u)], 1u);
        }
    }
    workgroupBarrier();
    if local < DIGITS {
        digit_counts[local * groups.x + group.x] = atomicLoad(&bins[local]);
    }
}
