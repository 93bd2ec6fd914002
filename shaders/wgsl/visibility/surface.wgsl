// A pixel's surface point, and the lights that need a shadow ray from there: rules 1 to 4 of
// server/src/visibility/mod.rs. Imported by the kernels of primary rays, which declare `view`.
//
// The result is 16 bytes a pixel: the start of the shadow rays, and one bit for each light that matters and is not
// behind the surface. Relevance needs the point, both normals and all lights. Deciding it here keeps the normals in
// registers, in full precision, and leaves the shadow kernel nothing to do but trace.

#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "visibility/closest_hit.wgsl"

// How far rounding may move the distance n · (l − s) of a light l from the plane through a shadow ray's start s, in
// rounding units of Σ |lᵢ − sᵢ|: 1 for n, which has no coordinate above 1, 1 for l − s, 3 for products and sums. The
// start is above its surface, so a light that is not above the start by more than this may lie in the surface's plane.
// Twin: `FACING_ROUNDINGS` in backend/cpu/light.rs.
const FACING_ROUNDINGS: f32 = 5.0;

// True if a surface faces a light in this direction by more than rounding can account for.
fn faces(geometric: vec3f, toward: vec3f) -> bool {
    return dot(geometric, toward) > FACING_ROUNDINGS * ROUNDING * dot(vec3f(1.0), abs(toward));
}

// True if `light` matters at `point` and the surface does not face away from it. Shadow rays begin at `start`.
fn needs_shadow_ray(light: TracedLight, point: vec3f, start: vec3f, geometric: vec3f, shading: vec3f) -> bool {
    if light.kind == LIGHT_DIRECTIONAL {
        return dot(shading, light.direction) < 0.0 && faces(geometric, -light.direction);
    }
    let toward = light.position - point;
    let squared = dot(toward, toward);
    if light.kind == LIGHT_SPOT && -dot(toward, light.direction) < light.cos_outer * sqrt(squared) {
        return false;
    }
    return squared <= light.range_squared && dot(shading, toward) > 0.0 && faces(geometric, light.position - start);
}

// How far rounding may move an interpolated point off its triangle's plane, in rounding units of Σ |nᵢ|·Σₖ wₖ·|pₖᵢ|
// with unit normal n, corners p and weights w: 3 for products and sums; 8 because weights that do not sum to 1 scale
// the point (a quotient is good to 2.5 units in the last place, and the sum of the weights is rounded); 1 for the sum
// that gives the start. That is 12; shadow rays start 16 above the surface. Errors of the weights only slide the point
// along the plane. The bound takes the terms, not their sum: a point near the origin of a large triangle carries the
// large triangle's error. Twin: `OFFSET_ROUNDINGS` in backend/cpu/surface.rs.
override OFFSET_ROUNDINGS: f32 = 16.0;

fn surface(hit: ClosestHit) -> vec4u {
    let at = hit.triangle * 3u;
    let a = bitcast<vec3f>(triangles[at].xyz);
    let b = bitcast<vec3f>(triangles[at + 1u].xyz);
    let c = bitcast<vec3f>(triangles[at + 2u].xyz);
    let turn = select(-1.0, 1.0, hit.front);
    let point = a * hit.weights.x + b * hit.weights.y + c * hit.weights.z;
    let geometric = turn * plane_normal(hit.triangle);
    let shading = turn * (triangle_normal(hit.triangle, 0u) * hit.weights.x
        + triangle_normal(hit.triangle, 1u) * hit.weights.y + triangle_normal(hit.triangle, 2u) * hit.weights.z);

    let summed = abs(a) * hit.weights.x + abs(b) * hit.weights.y + abs(c) * hit.weights.z;
    let start = point + geometric * (OFFSET_ROUNDINGS * ROUNDING * dot(abs(geometric), summed));
    var needed = 0u;
    for (var light = 0u; light < view.lights; light++) {
        let about = lights[view.first_light + light];
        needed |= select(0u, 1u << light, needs_shadow_ray(about, point, start, geometric, shading));
    }
    return vec4u(bitcast<vec3u>(start), needed);
}
