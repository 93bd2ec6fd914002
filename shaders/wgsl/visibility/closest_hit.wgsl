// The closest hit of a ray, however the triangles on its way are found.

struct ClosestHit {
    // The triangle, or NOTHING.
    triangle: u32,
    weights: vec3f,
    front: bool,
}

const NOTHING: u32 = 0xffffffffu;
