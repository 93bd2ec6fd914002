// Where surface points were when a mask was traced.

#import "shading/view.wgsl"

// From a piece's place now to the one before: the rows of an affine transform of local space. All zeros if it was not
// shown, or that is not known. A piece that changes its shape has 0 0 0 1 in `x` and else zeros: what is drawn of its
// points says where they were. Twin: `shading::Before`.
struct Before {
    x: vec4f,
    y: vec4f,
    z: vec4f,
}

// A surface point as it was.
struct Then {
    point: vec3f,
    normal: vec3f,
    is_known: bool,
}

// `drawn` is what `pieces.wgsl` draws.
fn then_of(before: Before, drawn: vec4u, point: vec3f, normal: vec3f) -> Then {
    let linear = mat3x3f(before.x.xyz, before.y.xyz, before.z.xyz);
    let offset = vec3f(before.x.w, before.y.w, before.z.w);
    let moves = any(linear[0] != vec3f(0.0)) || any(linear[1] != vec3f(0.0)) || any(linear[2] != vec3f(0.0));
    if !moves && all(offset == vec3f(1.0, 0.0, 0.0)) {
        let way = vec3f(unpack2x16float(drawn.y), unpack2x16float(drawn.z).x);
        return Then(point + way, from_octahedral(unpack2x16snorm(drawn.w)), true);
    }
    // Rows, so vectors come first. The normal is exact where the piece is not stretched.
    return Then(point * linear + offset, normalize(normal * linear), moves || any(offset != vec3f(0.0)));
}
