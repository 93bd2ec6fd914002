// The scene as the tracing kernels read it. Twins: `host::TracedView`, `host::TracedLight`, `host::AlphaMaterial`.

// One frame's camera, and the picture's size.
struct TracedView {
    // The camera's position in local space, in metres.
    origin: vec3f,
    // Width of the picture, in pixels.
    width: u32,
    // Unit vector along the view.
    forward: vec3f,
    // Height of the picture, in pixels.
    height: u32,
    // Half the picture's width on the plane at distance 1.
    right: vec3f,
    // Number of lights, which is the number of planes in the mask.
    lights: u32,
    // Half the picture's height on the plane at distance 1.
    up: vec3f,
    // Nodes of our hierarchy, or triangles if the adapter has its own; 0 if nothing stops rays.
    nodes: u32,
    // First row of tiles in this part of the frame.
    first_row: u32,
    // The row after its last.
    end_row: u32,
    // Where the hierarchy begins: a node; or, if the adapter has its own, the first triangle of those that move.
    root: u32,
    // The first light of the frame's time.
    first_light: u32,
}

// What decides a light's relevance and the end of its shadow rays.
struct TracedLight {
    // Position in local space, in metres; unused for directional lights.
    position: vec3f,
    // LIGHT_DIRECTIONAL, LIGHT_POINT or LIGHT_SPOT.
    kind: u32,
    // Unit vector in which the light travels; unused for point lights.
    direction: vec3f,
    // Cosine of the outer cone's angle.
    cos_outer: f32,
    // Squared range, in square metres; the largest f32 without a range.
    range_squared: f32,
    unused_0: f32,
    unused_1: f32,
    unused_2: f32,
}

const LIGHT_DIRECTIONAL: u32 = 0u;
const LIGHT_POINT: u32 = 1u;
const LIGHT_SPOT: u32 = 2u;

// A MASK material whose alpha varies.
struct AlphaMaterial {
    // Index of the first texel in `alpha_texels`, which holds four a word.
    first_texel: u32,
    // Size of the picture, in texels; 0 without one.
    width: u32,
    height: u32,
    // Wrap modes: u in the low half, v in the high half; see `wrapped` in shared/texels.wgsl.
    wraps: u32,
    // A point stops rays if texel · factor · the vertices' alpha is at least the cutoff.
    cutoff: f32,
    factor: f32,
    // 1 if the alpha of the material's vertices counts, 0 if it is 1.
    vertex_alpha: u32,
    unused_0: u32,
}

// Triangles, in the order of the hierarchy's leaves, three vec4u each. xyz are the corners' positions; the first w is
// the kind of the material, the second the first entry in `alpha_uvs`.
const TRIANGLE_SINGLE_SIDED: u32 = 0x80000000u;
// One more than the index of the alpha material, or 0 for a triangle without holes.
const TRIANGLE_ALPHA: u32 = 0x7fffffffu;

// obvhs' CWBVH nodes, five a node; see shared/cwbvh.wgsl.
@group(0) @binding(0) var<storage, read> nodes: array<vec4u>;
@group(0) @binding(1) var<storage, read> triangles: array<vec4u>;
@group(0) @binding(2) var<storage, read> lights: array<TracedLight>;
@group(0) @binding(3) var<storage, read> alpha_materials: array<AlphaMaterial>;
@group(0) @binding(4) var<storage, read> alpha_texels: array<u32>;
// Texture coordinates of triangles with holes, three each. Where the alpha of vertices counts, it follows: the first two
// corners', then the third's and a zero.
@group(0) @binding(5) var<storage, read> alpha_uvs: array<vec2f>;
// Twelve numbers a triangle: the shading normals of its corners, then the unit normal of its plane.
@group(0) @binding(6) var<storage, read> normals: array<f32>;

// Normal `which` of a triangle: 0 to 2 for its corners' shading normals, 3 for its plane's.
fn triangle_normal(triangle: u32, which: u32) -> vec3f {
    let first = triangle * 12u + which * 3u;
    return vec3f(normals[first], normals[first + 1u], normals[first + 2u]);
}

// The unit normal of a triangle's plane, towards its front; zero for one without an area. Computed in f64: an f32 cross
// product loses most digits of a long thin triangle's plane, and shadow rays would start below their own surface.
fn plane_normal(triangle: u32) -> vec3f {
    return triangle_normal(triangle, 3u);
}
