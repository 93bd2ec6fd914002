// Puts the vertices of what moves where they are in a state of the scene, as `Placement::vertex` in gnomon-scene says,
// but in f32, so that a vertex may lie a few rounding units from where the server has it. Pieces that stand as in the
// file are not touched. Twins: `render/movers/poser.rs`, `own.rs`.

// Four numbers for each row of an affine transform.
struct Transform {
    x: vec4f,
    y: vec4f,
    z: vec4f,
}

// A piece in this state, or a run of its vertices.
struct Placed {
    // To local space, from the piece's space less a middle. Joints count instead where there are any.
    points: Transform,
    // Of normals, up to their length.
    normals: Transform,
    // A sum of the flags below.
    flags: u32,
    // Its first vertex among `own_vertices`, and how many it has.
    first_vertex: u32,
    vertices: u32,
    // Sets of four joints that each vertex follows, none without a skin; the first word of the first in `shapes`.
    sets: u32,
    influences: u32,
    // The first word in `shapes` of what its first morph target changes.
    deltas: u32,
    // Where its joints begin in `state`, and the morph targets that count; how many these are.
    joints: u32,
    targets: u32,
    target_count: u32,
    // The first word of its first vertex in `vertices` and in `more`.
    vertices_to: u32,
    more_to: u32,
}

// Its vertices are to be moved.
const MOVED: u32 = 1u;
// Two corners of each triangle change places.
const TURNED: u32 = 2u;
// Normals are those of moved triangles. Each three vertices are one.
const FLAT: u32 = 4u;
// Tangents change hands.
const MIRRORED: u32 = 8u;

// Places of `state` that a run and a joint take. A target takes one: its number, and its weight.
const PLACED_QUADS: u32 = 9u;
const JOINT_QUADS: u32 = 3u;

// In `shapes`: four joints, two a word, and their weights, which add up to 1 for each vertex.
const INFLUENCE_WORDS: u32 = 6u;

// Words of a vertex in the scene's buffers: see `render/vertex.rs`.
const VERTEX_WORDS: u32 = 7u;
const MORE_WORDS: u32 = 6u;

struct OwnVertex {
    // Less the middle.
    position: vec3f,
    run: u32,
    normal: vec3f,
    unused: u32,
}

// Whether vertices have tangents.
override TANGENTS: bool = false;

// In `shapes`: what a target changes of a position, a normal and perhaps a tangent.
fn delta_words() -> u32 {
    return select(6u, 9u, TANGENTS);
}

@group(0) @binding(0) var<storage, read> own_vertices: array<OwnVertex>;
// One for each vertex.
@group(0) @binding(1) var<storage, read> own_tangents: array<vec4f>;
@group(0) @binding(2) var<storage, read> shapes: array<u32>;
@group(0) @binding(3) var<storage, read_write> vertices: array<u32>;
@group(0) @binding(4) var<storage, read_write> more: array<u32>;
// What is placed, run by run; then joints and targets.
@group(1) @binding(0) var<storage, read> state: array<vec4u>;

fn transform_at(at: u32) -> Transform {
    return Transform(bitcast<vec4f>(state[at]), bitcast<vec4f>(state[at + 1u]), bitcast<vec4f>(state[at + 2u]));
}

fn placed(run: u32) -> Placed {
    let at = run * PLACED_QUADS;
    let a = state[at + 6u];
    let b = state[at + 7u];
    let c = state[at + 8u];
    return Placed(transform_at(at), transform_at(at + 3u), a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w, c.x, c.y, c.z);
}

fn turned(by: Transform, v: vec3f) -> vec3f {
    return vec3f(dot(by.x.xyz, v), dot(by.y.xyz, v), dot(by.z.xyz, v));
}

fn moved(by: Transform, v: vec3f) -> vec3f {
    return turned(by, v) + vec3f(by.x.w, by.y.w, by.z.w);
}

fn most(v: vec3f) -> f32 {
    return max(abs(v.x), max(abs(v.y), abs(v.z)));
}

// `other` if there is no direction.
fn unit_or(v: vec3f, other: vec3f) -> vec3f {
    let size = most(v);
    if !(size > 0.0) {
        return other;
    }
    return normalize(v / size);
}

// The mean of a vertex's joints' transforms, by weight.
fn blended(piece: Placed, within: u32) -> Transform {
    var all = Transform(vec4f(0.0), vec4f(0.0), vec4f(0.0));
    let first = piece.influences + within * piece.sets * INFLUENCE_WORDS;
    for (var i = 0u; i < 4u * piece.sets; i++) {
        let influence = first + (i >> 2u) * INFLUENCE_WORDS;
        let part = i & 3u;
        let weight = bitcast<f32>(shapes[influence + 2u + part]);
        if weight != 0.0 {
            let joint = (shapes[influence + (part >> 1u)] >> (16u * (part & 1u))) & 0xffffu;
            let by = transform_at(piece.joints + joint * JOINT_QUADS);
            all = Transform(all.x + by.x * weight, all.y + by.y * weight, all.z + by.z * weight);
        }
    }
    return all;
}

// Takes normals along with points, up to their length. Scaled, so that no product is too small or too large.
fn cofactors(of_points: Transform) -> Transform {
    let size = max(most(of_points.x.xyz), max(most(of_points.y.xyz), most(of_points.z.xyz)));
    let scale = select(1.0, 1.0 / size, size > 0.0);
    let x = of_points.x.xyz * scale;
    let y = of_points.y.xyz * scale;
    let z = of_points.z.xyz * scale;
    let across = cross(y, z);
    let sense = select(1.0, -1.0, dot(x, across) < 0.0);
    return Transform(
        vec4f(across * sense, 0.0), vec4f(cross(z, x) * sense, 0.0), vec4f(cross(x, y) * sense, 0.0),
    );
}

struct Reshaped {
    position: vec3f,
    normal: vec3f,
    // Zero if there is none.
    tangent: vec3f,
}

fn change(at: u32) -> vec3f {
    return vec3f(bitcast<f32>(shapes[at]), bitcast<f32>(shapes[at + 1u]), bitcast<f32>(shapes[at + 2u]));
}

fn reshaped(piece: Placed, vertex: u32) -> Reshaped {
    let within = vertex - piece.first_vertex;
    let own = own_vertices[vertex];
    var position = own.position;
    var normal = own.normal;
    var tangent = vec3f(0.0);
    if TANGENTS {
        tangent = own_tangents[vertex].xyz;
    }
    for (var i = 0u; i < piece.target_count; i++) {
        let it = bitcast<vec4f>(state[piece.targets + i]);
        let at = piece.deltas + (u32(it.x) * piece.vertices + within) * delta_words();
        position += change(at) * it.y;
        normal += change(at + 3u) * it.y;
        if TANGENTS {
            tangent += change(at + 6u) * it.y;
        }
    }
    var points = piece.points;
    var normals = piece.normals;
    if piece.sets != 0u {
        points = blended(piece, within);
        normals = cofactors(points);
    }
    return Reshaped(
        moved(points, position), unit_or(turned(normals, normal), own.normal),
        unit_or(turned(points, tangent), vec3f(0.0)),
    );
}

// The normal of a moved triangle that shows this vertex.
fn flat_normal(piece: Placed, vertex: u32) -> vec3f {
    let first = vertex - (vertex - piece.first_vertex) % 3u;
    let a = reshaped(piece, first).position;
    let b = reshaped(piece, first + 1u).position;
    let c = reshaped(piece, first + 2u).position;
    let plane = cross(b - a, c - a);
    return unit_or(select(plane, -plane, (piece.flags & TURNED) != 0u), own_vertices[vertex].normal);
}

@compute @workgroup_size(64)
fn pose(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let vertex = (group.y * groups.x + group.x) * 64u + lane;
    if vertex >= arrayLength(&own_vertices) {
        return;
    }
    let piece = placed(own_vertices[vertex].run);
    if (piece.flags & MOVED) == 0u {
        return;
    }
    let it = reshaped(piece, vertex);
    var normal = it.normal;
    if (piece.flags & FLAT) != 0u {
        normal = flat_normal(piece, vertex);
    }
    let within = vertex - piece.first_vertex;
    let at = piece.vertices_to + within * VERTEX_WORDS;
    vertices[at] = bitcast<u32>(it.position.x);
    vertices[at + 1u] = bitcast<u32>(it.position.y);
    vertices[at + 2u] = bitcast<u32>(it.position.z);
    vertices[at + 3u] = pack2x16snorm(normal.xy);
    // The lean stays.
    vertices[at + 4u] = (vertices[at + 4u] & 0xffff0000u) | (pack2x16snorm(vec2f(normal.z, 0.0)) & 0xffffu);
    if TANGENTS {
        let hand = select(1.0, -1.0, (piece.flags & MIRRORED) != 0u) * own_tangents[vertex].w;
        let has_none = all(it.tangent == vec3f(0.0));
        let to = piece.more_to + within * MORE_WORDS + 2u;
        more[to] = pack2x16snorm(it.tangent.xy);
        more[to + 1u] = pack2x16snorm(vec2f(it.tangent.z, select(hand, 0.0, has_none)));
    }
}
