// Moves the vertices of pieces with a shape: by morph targets, then by joints. See `Form` in gnomon-scene.

#import "visibility/pose_math.wgsl"

struct Reshaped {
    // In the scene's local space, as bits.
    position: vec3u,
    // Before it is turned.
    normal: Double3,
    // Of normals.
    turn: Transform,
}

fn form_number(word: u32) -> Double {
    return double_of(forms[word], forms[word + 1u]);
}

fn form_numbers(word: u32) -> Double3 {
    return Double3(form_number(word), form_number(word + 2u), form_number(word + 4u));
}

fn moved_by(to: Double3, change: u32, weight: Double) -> Double3 {
    let by = double3_of_singles(vec3u(shapes[change], shapes[change + 1u], shapes[change + 2u]));
    return sum3(to, scaled(by, weight));
}

// The mean of its joints' transforms, by weight.
fn blended(placement: u32, within: u32) -> Transform {
    let none = Double3(ZERO, ZERO, ZERO);
    var all = Transform(none, none, none, none);
    var weights = ZERO;
    let sets = placements[placement + SETS_AT];
    let first = placements[placement + INFLUENCES_AT] + within * sets * INFLUENCE_WORDS;
    let joints = placements[placement + JOINTS_AT];
    for (var i = 0u; i < 4u * sets; i++) {
        let influence = first + (i >> 2u) * INFLUENCE_WORDS;
        let part = i & 3u;
        let weight = double_of_single(shapes[influence + 2u + part]);
        if weight.mantissa != 0lu {
            let joint = (shapes[influence + (part >> 1u)] >> (16u * (part & 1u))) & 0xffffu;
            let word = joints + joint * JOINT_WORDS;
            all.x = sum3(all.x, scaled(form_numbers(word), weight));
            all.y = sum3(all.y, scaled(form_numbers(word + 6u), weight));
            all.z = sum3(all.z, scaled(form_numbers(word + 12u), weight));
            all.w = sum3(all.w, scaled(form_numbers(word + 18u), weight));
            weights = sum(weights, weight);
        }
    }
    if weights.mantissa == 0lu {
        return Transform(Double3(ONE, ZERO, ZERO), Double3(ZERO, ONE, ZERO), Double3(ZERO, ZERO, ONE), none);
    }
    let one = quotient(ONE, weights);
    return Transform(scaled(all.x, one), scaled(all.y, one), scaled(all.z, one), scaled(all.w, one));
}

fn negative3(v: Double3) -> Double3 {
    return Double3(negative(v.x), negative(v.y), negative(v.z));
}

// Takes normals to the world, up to a positive factor.
fn cofactors(of_points: Transform) -> Transform {
    let none = Double3(ZERO, ZERO, ZERO);
    let x = cross3(of_points.y, of_points.z);
    let y = cross3(of_points.z, of_points.x);
    let z = cross3(of_points.x, of_points.y);
    let determinant = dot3(of_points.x, x);
    if determinant.sign != 0u && determinant.mantissa != 0lu {
        return Transform(negative3(x), negative3(y), negative3(z), none);
    }
    return Transform(x, y, z, none);
}

fn reshaped(placement: u32, vertex: u32) -> Reshaped {
    let within = vertex - placements[placement + FIRST_VERTEX_AT];
    var position = double3_of_singles(own_vertices[2u * vertex].xyz);
    var normal = double3_of_singles(own_vertices[2u * vertex + 1u].xyz);
    let targets = placements[placement + TARGETS_AT];
    for (var i = 0u; i < placements[placement + TARGET_COUNT_AT]; i++) {
        let word = targets + i * TARGET_WORDS;
        let place = forms[word] * placements[placement + VERTICES_AT] + within;
        let change = placements[placement + DELTAS_AT] + place * DELTA_WORDS;
        let weight = form_number(word + 2u);
        position = moved_by(position, change, weight);
        normal = moved_by(normal, change + 3u, weight);
    }
    var by = world_from_piece(placement);
    var turn = normals_of_piece(placement);
    if placements[placement + SETS_AT] != 0u {
        by = blended(placement, within);
        turn = cofactors(by);
    }
    return Reshaped(position_bits(by, position, numbers(placement + ORIGIN_AT)), normal, turn);
}

@compute @workgroup_size(64)
fn pose_shapes(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let vertex = item(group, groups, lane);
    if vertex >= posing.end {
        return;
    }
    let placement = placement_of(own_vertices[2u * vertex].w);
    let flags = placements[placement + FLAGS_AT];
    if (flags & SHOWN) == 0u {
        return;
    }
    let own_normal = own_vertices[2u * vertex + 1u].xyz;
    // A loop, so that the kernel has all this once.
    let flat_shaded = (flags & FLAT) != 0u;
    let corner = (vertex - placements[placement + FIRST_VERTEX_AT]) % 3u;
    var corners: array<vec3u, 3>;
    var position = vec3u(0u);
    var normal = own_normal;
    for (var i = 0u; i < select(1u, 3u, flat_shaded); i++) {
        let here = reshaped(placement, select(vertex, vertex - corner + i, flat_shaded));
        corners[i] = here.position;
        if !flat_shaded {
            position = here.position;
            normal = normal_bits(here.turn, here.normal, own_normal);
        }
    }
    if flat_shaded {
        position = corners[corner];
        let turned = (flags & TURNED) != 0u;
        let bits = plane(array(
            corners[0],
            select(corners[1], corners[2], turned),
            select(corners[2], corners[1], turned),
        ));
        if any((bits & vec3u(0x7fffffffu)) != vec3u(0u)) {
            normal = single_unit(double3_of_singles(bits));
        }
    }
    vertices[2u * vertex] = vec4u(position, 0u);
    vertices[2u * vertex + 1u] = vec4u(normal, 0u);
}
