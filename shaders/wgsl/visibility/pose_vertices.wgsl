// Moves vertices, as `Placement::vertex` does for rigid pieces.

#import "visibility/pose.wgsl"
#import "shared/double.wgsl"

fn number(word: u32) -> Double {
    return double_of(placements[word], placements[word + 1u]);
}

fn numbers(word: u32) -> Double3 {
    return Double3(number(word), number(word + 2u), number(word + 4u));
}

fn position(placement: u32, own: vec3u) -> vec3u {
    let at = double3_of_singles(own);
    var there = scaled(numbers(placement), at.x);
    there = sum3(scaled(numbers(placement + 6u), at.y), there);
    there = sum3(scaled(numbers(placement + 12u), at.z), there);
    there = sum3(numbers(placement + 18u), there);
    return singles_of(difference3(there, numbers(placement + ORIGIN_AT)));
}

// As f32, whose sums and products round an f64's: that has more than twice their digits.
fn single_unit(v: Double3) -> vec3u {
    let x = to_single(product(v.x, v.x));
    let y = to_single(product(v.y, v.y));
    let z = to_single(product(v.z, v.z));
    let length = to_single(root(to_single(sum(to_single(sum(x, y)), z))));
    return singles_of(scaled(v, to_single(quotient(ONE, length))));
}

fn normal(placement: u32, own: vec3u) -> vec3u {
    let unturned = double3_of_singles(own);
    var there = scaled(numbers(placement + NORMALS_AT), unturned.x);
    there = sum3(there, scaled(numbers(placement + NORMALS_AT + 6u), unturned.y));
    there = sum3(there, scaled(numbers(placement + NORMALS_AT + 12u), unturned.z));
    let squared = dot3(there, there);
    if squared.mantissa == 0lu {
        return own;
    }
    let unit = scaled(there, quotient(ONE, root(squared)));
    return single_unit(Double3(to_single(unit.x), to_single(unit.y), to_single(unit.z)));
}

@compute @workgroup_size(64)
fn pose_vertices(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let vertex = item(group, groups, lane);
    if vertex >= posing.end {
        return;
    }
    let own = own_vertices[2u * vertex];
    let placement = placement_of(own.w);
    if (placements[placement + FLAGS_AT] & SHOWN) == 0u {
        return;
    }
    vertices[2u * vertex] = vec4u(position(placement, own.xyz), 0u);
    vertices[2u * vertex + 1u] = vec4u(normal(placement, own_vertices[2u * vertex + 1u].xyz), 0u);
}
