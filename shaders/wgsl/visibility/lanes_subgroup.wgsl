// What the 32 lanes of a workgroup know together, where they are one subgroup. Replaces
// visibility/lanes_workgroup.wgsl.

const LANES: u32 = 32u;

// The lanes where `value` is true, as bits.
fn ballot(value: bool, lane: u32) -> u32 {
    return subgroupBallot(value).x;
}

fn least(value: vec4f, lane: u32) -> vec4f {
    return subgroupMin(value);
}

fn greatest(value: vec4f, lane: u32) -> vec4f {
    return subgroupMax(value);
}

fn total(value: vec4f, lane: u32) -> vec4f {
    return subgroupAdd(value);
}

// Lane 0's value.
fn of_first(value: u32, lane: u32) -> u32 {
    return subgroupBroadcastFirst(value);
}
