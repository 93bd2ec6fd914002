// Triangles of a list, read once for a workgroup.

#import "shared/traced_scene.wgsl"

// Triangles that are read at once.
const CHUNK: u32 = 64u;

struct Candidate {
    corner_a: vec3f,
    triangle: u32,
    corner_b: vec3f,
    // The first word of the triangle that is no coordinate.
    kind: u32,
    corner_c: vec3f,
    unused: u32,
    normal: vec3f,
}

var<workgroup> candidates: array<Candidate, CHUNK>;
fn candidate_of(triangle: u32) -> Candidate {
    let a = triangles[triangle * 3u];
    let b = triangles[triangle * 3u + 1u];
    let c = triangles[triangle * 3u + 2u];
    return Candidate(bitcast<vec3f>(a.xyz), triangle, bitcast<vec3f>(b.xyz), a.w, bitcast<vec3f>(c.xyz), 0u,
        plane_normal(triangle));
}
