// Where surface points were when a mask was traced.

// From a piece's place now to the one before: the rows of an affine transform of local space. All zeros if it was not
// shown. Twin: `shading::Before`.
struct Before {
    x: vec4f,
    y: vec4f,
    z: vec4f,
}

fn was_shown(before: Before) -> bool {
    return any(before.x != vec4f(0.0)) || any(before.y != vec4f(0.0)) || any(before.z != vec4f(0.0));
}

fn point_before(before: Before, point: vec3f) -> vec3f {
    let at = vec4f(point, 1.0);
    return vec3f(dot(before.x, at), dot(before.y, at), dot(before.z, at));
}

// Exact where the piece is not stretched.
fn normal_before(before: Before, normal: vec3f) -> vec3f {
    return normalize(vec3f(dot(before.x.xyz, normal), dot(before.y.xyz, normal), dot(before.z.xyz, normal)));
}
