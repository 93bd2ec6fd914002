// A pixel's surface point, found by a ray of its own. Imported by the kernels of primary rays, which declare `view`.

#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "visibility/traverse.wgsl"
#import "visibility/primary_ray.wgsl"
#import "visibility/surface.wgsl"

// All zeros where nothing is seen, and outside the picture.
fn seen_at(pixel: vec2u) -> vec4u {
    if pixel.x >= view.width || pixel.y >= view.height {
        return vec4u(0u);
    }
    let hit = intersect(make_ray(view.origin, pixel_direction(pixel)));
    if hit.triangle == NOTHING {
        return vec4u(0u);
    }
    return surface(hit);
}
