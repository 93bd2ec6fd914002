// Makes triangles of moved vertices, with their planes: see `triangle_normal` in gnomon-scene.

#import "visibility/pose.wgsl"
#import "shared/double.wgsl"

// 1e-7 and 1e-16, as f64.
const MIN_HEIGHT_RATIO = vec2u(0x9abcaf48u, 0x3e7ad7f2u);
const MIN_DOUBLE_AREA_M2 = vec2u(0x97d889bcu, 0x3c9cd2b2u);

fn larger(x: Double, y: Double) -> Double {
    if is_greater(y, x) {
        return y;
    }
    return x;
}

fn plane(corners: array<vec3u, 3>) -> vec3u {
    let a = double3_of_singles(corners[0]);
    let b = double3_of_singles(corners[1]);
    let c = double3_of_singles(corners[2]);
    let ab = difference3(b, a);
    let ac = difference3(c, a);
    let bc = difference3(c, b);
    let across = cross3(ab, ac);
    let squared = dot3(across, across);
    if squared.mantissa == 0lu {
        return vec3u(0u);
    }
    let double_area = root(squared);
    let longest_squared = larger(larger(dot3(ab, ab), dot3(ac, ac)), dot3(bc, bc));
    let ratio = double_of(MIN_HEIGHT_RATIO.x, MIN_HEIGHT_RATIO.y);
    let least = double_of(MIN_DOUBLE_AREA_M2.x, MIN_DOUBLE_AREA_M2.y);
    if !is_greater(double_area, product(ratio, longest_squared)) || !is_greater(double_area, least) {
        return vec3u(0u);
    }
    return vec3u(
        single_of(quotient(across.x, double_area)),
        single_of(quotient(across.y, double_area)),
        single_of(quotient(across.z, double_area)),
    );
}

fn set_normal(triangle: u32, which: u32, bits: vec3u) {
    let first = triangle * 12u + which * 3u;
    normals[first] = bits.x;
    normals[first + 1u] = bits.y;
    normals[first + 2u] = bits.z;
}

@compute @workgroup_size(64)
fn pose_triangles(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let own = item(group, groups, lane);
    if own >= posing.end {
        return;
    }
    let head = own_triangles[2u * own];
    let tail = own_triangles[2u * own + 1u];
    let placement = placement_of(tail.z);
    let flags = placements[placement + FLAGS_AT];
    if (flags & SHOWN) == 0u {
        return;
    }
    let turned = (flags & TURNED) != 0u;
    let corners = select(head.xyz, head.xzy, turned) * 2u;
    let a = vertices[corners.x].xyz;
    let b = vertices[corners.y].xyz;
    let c = vertices[corners.z].xyz;
    let to = own + placements[placement + TRIANGLES_AT];
    triangles[3u * to] = vec4u(a, head.w);
    triangles[3u * to + 1u] = vec4u(b, select(tail.x, tail.y, turned));
    triangles[3u * to + 2u] = vec4u(c, 0u);
    set_normal(to, 0u, vertices[corners.x + 1u].xyz);
    set_normal(to, 1u, vertices[corners.y + 1u].xyz);
    set_normal(to, 2u, vertices[corners.z + 1u].xyz);
    set_normal(to, 3u, plane(array(a, b, c)));
}
