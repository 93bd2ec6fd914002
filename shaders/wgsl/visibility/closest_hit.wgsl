// The closest hit of a ray, with either traversal.

struct ClosestHit {
    // The triangle, or NOTHING.
    triangle: u32,
    weights: vec3f,
    front: bool,
}

const NOTHING: u32 = 0xffffffffu;

// True if a hit is closer than the closest so far. Of hits at the same distance the triangle with the lower number
// counts, so that the order of tests does not. An adapter's own traversal does without: it may leave out what is no
// closer than a hit that was confirmed.
fn is_closer(distance: f32, triangle: u32, limit: f32, closest: u32) -> bool {
    return distance < limit || (distance == limit && triangle < closest);
}
