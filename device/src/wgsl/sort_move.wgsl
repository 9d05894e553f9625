// Moves the keys of each block and their values to their places.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<uniform> sort_pass: SortPass;
@group(0) @binding(2) var<storage, read> report: array<u32>;
@group(0) @binding(3) var<storage, read> keys_in: array<u32>;
@group(0) @binding(4) var<storage, read> values_in: array<u32>;
@group(0) @binding(5) var<storage, read> digit_counts: array<u32>;
@group(0) @binding(6) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(7) var<storage, read_write> values_out: array<u32>;

// `[digit][thread]`: the keys of that digit before those of the thread.
var<workgroup> before: array<u32, 2048>;
var<workgroup> sums: array<u32, THREADS>;

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    for (var digit = 0u; digit < DIGITS; digit++) {
        before[digit * THREADS + local] = 0u;
    }
    let count = keys_in_use(report[ENTRIES]);
    let first = group.x * BLOCK + local * KEYS;
    for (var k = 0u; k < KEYS; k++) {
        if first + k < count {
            before[((keys_in[first + k] >> sort_pass.shift) & (DIGITS - 1u)) * THREADS + local] += 1u;
        }
    }
    workgroupBarrier();
    // Each thread sums sixteen counts of one digit, then the sums are summed.
    var sum = 0u;
    for (var k = 0u; k < DIGITS; k++) {
        sum += before[local * DIGITS + k];
    }
    sums[local] = sum;
    workgroupBarrier();
    for (var distance = 1u; distance < THREADS; distance *= 2u) {
        var lower = 0u;
        if local >= distance {
            lower = sums[local - distance];
        }
        workgroupBarrier();
        sums[local] += lower;
        workgroupBarrier();
    }
    var running = sums[local] - sum;
    for (var k = 0u; k < DIGITS; k++) {
        let own = before[local * DIGITS + k];
        before[local * DIGITS + k] = running;
        running += own;
    }
    workgroupBarrier();
    // Where the keys of each digit begin in the block.
    var starts: array<u32, DIGITS>;
    for (var digit = 0u; digit < DIGITS; digit++) {
        starts[digit] = before[digit * THREADS];
    }
    workgroupBarrier();
    for (var k = 0u; k < KEYS; k++) {
        if first + k < count {
            let key = keys_in[first + k];
            let digit = (key >> sort_pass.shift) & (DIGITS - 1u);
            let rank = before[digit * THREADS + local];
            before[digit * THREADS + local] = rank + 1u;
            let to = digit_counts[digit * groups.x + group.x] + rank - starts[digit];
            keys_out[to] = key;
            values_out[to] = values_in[first + k];
        }
    }
}
