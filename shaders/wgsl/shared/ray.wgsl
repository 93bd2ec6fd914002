// Rays, and their intersection with triangles: watertight along shared edges (Woop, Benthin, Wald, "Watertight
// Ray/Triangle Intersection", JCGT 2013).

#import "shared/traced_scene.wgsl"

struct Ray {
    origin: vec3f,
    // Not normalised. Distances are in units of its length.
    direction: vec3f,
    // The direction for box tests: zeros are replaced by tiny values.
    slanted: vec3f,
    // 1 / `slanted`.
    inverse: vec3f,
    // Octant of the direction in obvhs' form: bits 2, 1, 0 are set where x, y, z are not negative.
    octant: u32,
    // Rows of the matrix that projects points relative to the origin to the plane across the ray.
    shear_x: vec3f,
    shear_y: vec3f,
}

// The largest f32: the length of rays to directional lights.
const FARTHEST: f32 = 3.4028235e38;

fn make_ray(origin: vec3f, direction: vec3f) -> Ray {
    var ray: Ray;
    ray.origin = origin;
    ray.direction = direction;
    // A zero would give 0 · ∞ for a plane that contains the origin.
    let negative = direction < vec3f(0.0);
    let tiny = select(vec3f(1e-18), vec3f(-1e-18), negative);
    ray.slanted = select(direction, tiny, abs(direction) < vec3f(1e-18));
    ray.inverse = 1.0 / ray.slanted;
    let positive = select(vec3u(4u, 2u, 1u), vec3u(0u), negative);
    ray.octant = positive.x | positive.y | positive.z;

    let size = abs(direction);
    var x = vec3f(1.0, 0.0, 0.0);
    var y = vec3f(0.0, 1.0, 0.0);
    var z = vec3f(0.0, 0.0, 1.0);
    if size.x >= size.y && size.x >= size.z {
        x = vec3f(0.0, 1.0, 0.0);
        y = vec3f(0.0, 0.0, 1.0);
        z = vec3f(1.0, 0.0, 0.0);
    } else if size.y >= size.z {
        x = vec3f(0.0, 0.0, 1.0);
        y = vec3f(1.0, 0.0, 0.0);
        z = vec3f(0.0, 1.0, 0.0);
    }
    let along = dot(direction, z);
    // Mirroring would swap front and back faces.
    let swapped = along < 0.0;
    let right = select(x, y, swapped);
    let up = select(y, x, swapped);
    ray.shear_x = right - z * (dot(direction, right) / along);
    ray.shear_y = up - z * (dot(direction, up) / along);
    return ray;
}

struct Hit {
    // Distance along the ray, in lengths of its direction; negative for a miss.
    distance: f32,
    // Barycentric weights of the three corners.
    weights: vec3f,
    // True for a hit on the front.
    front: bool,
    // True if the origin lies off the triangle's plane by more than rounding can account for.
    clear: bool,
}

// The rounding unit of f32, 2⁻²⁴.
const ROUNDING: f32 = 5.9604644775390625e-8;

// How far rounding may move the distance n · (a − s) of a ray's origin s from a triangle's plane, in rounding units of
// Σ |nᵢ|·|aᵢ − sᵢ|: 1 for n, which is rounded from f64; 1 for a − s; 3 for products and sums, contracted or not; and
// one more for the rounding of this bound. Twin: `PLANE_ROUNDINGS` in backend/cpu/rounding.rs.
const PLANE_ROUNDINGS: f32 = 6.0;

// Explicit fma, so that the compiler has no choice of what to contract: the same corner and ray must give the same
// number in every triangle that shares the corner.
fn along_row(row: vec3f, point: vec3f) -> f32 {
    return fma(row.x, point.x, fma(row.y, point.y, row.z * point.z));
}

// p · q − r · s with its exact sign and nearly all of its digits (Kahan's algorithm) on adapters that fuse. On others
// it is the plain difference, whose sign is antisymmetric too.
fn difference_of_products(p: f32, q: f32, r: f32, s: f32) -> f32 {
    let product = r * s;
    let error = fma(-r, s, product);
    return fma(p, q, -product) + error;
}

// Both triangles at an edge compute the same number with opposite signs. A plain difference, half of it contracted to
// an fma, would not be antisymmetric, and rays would leak through edges.
fn edge(a: vec2f, b: vec2f) -> f32 {
    return difference_of_products(a.x, b.y, a.y, b.x);
}

// Twice the areas that the ray spans with the edges opposite the corners, seen along the ray.
fn areas_across(ray: Ray, corner_a: vec3f, corner_b: vec3f, corner_c: vec3f) -> vec3f {
    let to_a = corner_a - ray.origin;
    let to_b = corner_b - ray.origin;
    let to_c = corner_c - ray.origin;
    let a = vec2f(along_row(ray.shear_x, to_a), along_row(ray.shear_y, to_a));
    let b = vec2f(along_row(ray.shear_x, to_b), along_row(ray.shear_y, to_b));
    let c = vec2f(along_row(ray.shear_x, to_c), along_row(ray.shear_y, to_c));
    return vec3f(edge(c, b), edge(a, c), edge(b, a));
}

// True if a ray with these areas passes a triangle by. Points on an edge belong to both of its triangles.
fn is_beside(areas: vec3f) -> bool {
    return any(areas < vec3f(0.0)) && any(areas > vec3f(0.0));
}

const MISSED: Hit = Hit(-1.0, vec3f(0.0), false, false);

fn intersect_triangle(ray: Ray, triangle: u32, corner_a: vec3f, corner_b: vec3f, corner_c: vec3f) -> Hit {
    let areas = areas_across(ray, corner_a, corner_b, corner_c);
    let area = areas.x + areas.y + areas.z;
    if is_beside(areas) || area == 0.0 {
        return MISSED;
    }
    // The distance comes from the plane, not from the corners' depths by their weights. The weights of a thin triangle
    // are quotients of small differences: they would be off by more than shadow rays are pushed off their surface.
    let normal = plane_normal(triangle);
    let to_a = corner_a - ray.origin;
    let height = dot(normal, to_a);
    return Hit(height / dot(normal, ray.direction), areas / area, area > 0.0, is_off_plane(normal, to_a, height));
}

// True if a point lies off a plane by more than rounding can account for. `height` is normal · to_a.
fn is_off_plane(normal: vec3f, to_a: vec3f, height: f32) -> bool {
    return abs(height) > PLANE_ROUNDINGS * ROUNDING * dot(abs(normal), abs(to_a));
}

// Where a shadow ray ends.
struct End {
    // Distance along the ray, in lengths of its direction.
    limit: f32,
    // The light's position; unused for directional lights.
    light: vec3f,
    has_position: bool,
}

// True if a triangle that the ray hits lies between its origin and its end. A triangle whose plane contains either,
// within rounding, does not: a surface does not shadow itself, nor a lamp that sits on it.
fn is_between(hit: Hit, triangle: u32, corner_a: vec3f, end: End) -> bool {
    if !hit.clear || hit.distance <= 0.0 || hit.distance >= end.limit {
        return false;
    }
    return is_end_off_plane(plane_normal(triangle), corner_a, end);
}

// True if the end of a shadow ray lies off the plane of a triangle with this normal and corner.
fn is_end_off_plane(normal: vec3f, corner_a: vec3f, end: End) -> bool {
    let to_a = corner_a - end.light;
    return !end.has_position || is_off_plane(normal, to_a, dot(normal, to_a));
}
