// The closest hit of a ray, with either traversal.

struct ClosestHit {
    // The triangle, or NOTHING.
    triangle: u32,
    weights: vec3f,
    front: bool,
}

const NOTHING: u32 = 0xffffffffu;
