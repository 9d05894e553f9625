// Sums of all numbers before each, in place, by one workgroup.

struct ScanPass {
    // Numbers; zero: one for each Gaussian.
    length: u32,
    // True if the sum of all is the number of entries.
    of_entries: u32,
    unused: vec2u,
}

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<uniform> scan_pass: ScanPass;
@group(0) @binding(2) var<storage, read_write> numbers: array<u32>;
@group(0) @binding(3) var<storage, read_write> report: array<u32>;

var<workgroup> sums: array<u32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    let length = select(scan_pass.length, step.counts.x, scan_pass.length == 0u);
    var carry = 0u;
    for (var base = 0u; base < length; base += 1024u) {
        let first = base + local * 4u;
        var own: array<u32, 4>;
        var sum = 0u;
        for (var k = 0u; k < 4u; k++) {
            if first + k < length {
                own[k] = numbers[first + k];
            }
            sum += own[k];
        }
        sums[local] = sum;
        workgroupBarrier();
        for (var distance = 1u; distance < 256u; distance *= 2u) {
            var lower = 0u;
            if local >= distance {
                lower = sums[local - distance];
            }
            workgroupBarrier();
            sums[local] += lower;
            workgroupBarrier();
        }
        var running = carry + sums[local] - sum;
        for (var k = 0u; k < 4u; k++) {
            if first + k < length {
                numbers[first + k] = running;
            }
            running += own[k];
        }
        carry += sums[255];
        workgroupBarrier();
    }
    if local == 0u && scan_pass.of_entries == 1u {
        report[ENTRIES] = carry;
        if carry > step.counts.y {
            report[FAULTS] |= FAULT_ROOM;
        }
    }
}
