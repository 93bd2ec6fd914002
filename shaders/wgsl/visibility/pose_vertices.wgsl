// Moves the vertices of rigid pieces.

#import "visibility/pose_math.wgsl"

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
    let at = own_vertices[2u * vertex];
    let own_normal = own_vertices[2u * vertex + 1u].xyz;
    let placement = placement_of(at.w);
    if (placements[placement + FLAGS_AT] & SHOWN) == 0u {
        return;
    }
    let origin = numbers(placement + ORIGIN_AT);
    let position = position_bits(world_from_piece(placement), double3_of_singles(at.xyz), origin);
    let normal = normal_bits(normals_of_piece(placement), double3_of_singles(own_normal), own_normal);
    vertices[2u * vertex] = vec4u(position, 0u);
    vertices[2u * vertex + 1u] = vec4u(normal, 0u);
}
