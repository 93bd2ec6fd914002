// What the 32 lanes of a workgroup know together, on any adapter. All lanes call these functions together.
// visibility/lanes_subgroup.wgsl has the same functions for adapters whose subgroups have 32 lanes.

const LANES: u32 = 32u;

var<workgroup> lane_bits: atomic<u32>;
var<workgroup> lane_values: array<vec4f, LANES>;

// The lanes where `value` is true, as bits.
fn ballot(value: bool, lane: u32) -> u32 {
    workgroupBarrier();
    if lane == 0u {
        atomicStore(&lane_bits, 0u);
    }
    workgroupBarrier();
    if value {
        atomicOr(&lane_bits, 1u << lane);
    }
    workgroupBarrier();
    return atomicLoad(&lane_bits);
}

fn show(value: vec4f, lane: u32) {
    workgroupBarrier();
    lane_values[lane] = value;
    workgroupBarrier();
}

fn least(value: vec4f, lane: u32) -> vec4f {
    show(value, lane);
    var result = lane_values[0];
    for (var i = 1u; i < LANES; i++) {
        result = min(result, lane_values[i]);
    }
    return result;
}

fn greatest(value: vec4f, lane: u32) -> vec4f {
    show(value, lane);
    var result = lane_values[0];
    for (var i = 1u; i < LANES; i++) {
        result = max(result, lane_values[i]);
    }
    return result;
}

fn total(value: vec4f, lane: u32) -> vec4f {
    show(value, lane);
    var result = lane_values[0];
    for (var i = 1u; i < LANES; i++) {
        result += lane_values[i];
    }
    return result;
}

// Lane 0's value.
fn of_first(value: u32, lane: u32) -> u32 {
    workgroupBarrier();
    if lane == 0u {
        atomicStore(&lane_bits, value);
    }
    workgroupBarrier();
    return atomicLoad(&lane_bits);
}
