// The segment from a shadow ray's start to the light: rule 5 of server/src/visibility/mod.rs.

#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"

fn shadow_ray(start: vec3f, light: TracedLight) -> Ray {
    return make_ray(start, select(light.position - start, -light.direction, light.kind == LIGHT_DIRECTIONAL));
}

fn shadow_end(light: TracedLight) -> End {
    let directional = light.kind == LIGHT_DIRECTIONAL;
    return End(select(1.0, FARTHEST, directional), light.position, !directional);
}
