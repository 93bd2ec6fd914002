// What moves, put where it is at a frame's time, in the slot's region of the scene's buffers: vertices, then triangles,
// then the nodes above them. Bit by bit what the host would write there, but for nodes, whose boxes may differ.
// Twins: `backend/compute/posing.rs`.

// What one dispatch works on.
struct Posing {
    // First of the slot's placements.
    first_placement: u32,
    // Of vertices, triangles or places in the order of nodes.
    first: u32,
    end: u32,
}

// Words of a placement: three numbers of 64 bits for each column of the transform to the world, and of that of normals;
// the scene's origin; then what follows.
const PLACEMENT_WORDS: u32 = 64u;
const NORMALS_AT: u32 = 24u;
const ORIGIN_AT: u32 = 42u;
// A sum of the flags below.
const FLAGS_AT: u32 = 48u;
// Where its nodes and triangles are in the scene's buffers, less where they are here.
const NODES_AT: u32 = 49u;
const TRIANGLES_AT: u32 = 50u;
// Where its first node goes, which lies apart from the others.
const ROOT_AT: u32 = 51u;
// Its first node here.
const FIRST_NODE_AT: u32 = 52u;
// Its first vertex here, and how many it has.
const FIRST_VERTEX_AT: u32 = 53u;
const VERTICES_AT: u32 = 54u;
// Sets of four joints that each vertex follows, none without a skin; the first word of the first in `shapes`.
const SETS_AT: u32 = 55u;
const INFLUENCES_AT: u32 = 56u;
// The first word in `shapes` of what its first morph target changes.
const DELTAS_AT: u32 = 57u;
// First words in `forms`: of its first joint, and of the first target that counts.
const JOINTS_AT: u32 = 58u;
const TARGETS_AT: u32 = 59u;
const TARGET_COUNT_AT: u32 = 60u;

// The piece is shown and moved here.
const SHOWN: u32 = 1u;
// It is inside out: two corners of each triangle change places.
const TURNED: u32 = 2u;
// Normals are those of moved triangles. Each three vertices are one.
const FLAT: u32 = 4u;

// In `shapes`: four joints, two a word, and their weights; what a target changes of a position and a normal.
const INFLUENCE_WORDS: u32 = 6u;
const DELTA_WORDS: u32 = 6u;
// In `forms`: four columns of three numbers of 64 bits; a target, a word of padding, and its weight of 64 bits.
const JOINT_WORDS: u32 = 24u;
const TARGET_WORDS: u32 = 4u;

var<immediate> posing: Posing;

// The scene's own: see shared/traced_scene.wgsl.
@group(0) @binding(0) var<storage, read_write> nodes: array<vec4u>;
@group(0) @binding(1) var<storage, read_write> triangles: array<vec4u>;
// As bits.
@group(0) @binding(2) var<storage, read_write> normals: array<u32>;
// In the pieces' own spaces, as bits. Two each: the position, and its piece; the normal.
@group(0) @binding(3) var<storage, read> own_vertices: array<vec4u>;
// Two each: corners among the vertices, and the kind; texture coordinates as in the file's pose and turned, the piece.
@group(0) @binding(4) var<storage, read> own_triangles: array<vec4u>;
// The pieces' trees, as `nodes`. Their indices count from the first node and triangle here.
@group(0) @binding(5) var<storage, read> trees: array<vec4u>;
// Nodes by their height above the leaves, each with its piece.
@group(0) @binding(6) var<storage, read> order: array<vec2u>;
// Where `own_vertices` are, as bits. Two each.
@group(0) @binding(7) var<storage, read_write> vertices: array<vec4u>;
// Lowest and highest corner of each node, the former above the latter around nothing.
@group(0) @binding(8) var<storage, read_write> bounds: array<vec4f>;
@group(0) @binding(9) var<storage, read> placements: array<u32>;
// How pieces change their shape: what does not depend on time, and what does.
@group(0) @binding(10) var<storage, read> shapes: array<u32>;
@group(0) @binding(11) var<storage, read> forms: array<u32>;

// The number of this invocation's vertex, triangle or place.
fn item(group: vec3u, groups: vec3u, lane: u32) -> u32 {
    return posing.first + (group.y * groups.x + group.x) * 64u + lane;
}

// The first word of a piece's placement.
fn placement_of(piece: u32) -> u32 {
    return (posing.first_placement + piece) * PLACEMENT_WORDS;
}
