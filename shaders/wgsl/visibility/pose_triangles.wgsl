// Makes triangles of moved vertices, with their planes.

#import "visibility/pose_math.wgsl"

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
