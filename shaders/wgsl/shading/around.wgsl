// What a surface sends to the eye of the light around it.

#import "shading/environment.wgsl"
#import "shading/finish.wgsl"

// Share of what comes from a mirrored direction that is above the surface's own plane: a bent normal may mirror what is
// below it.
fn above_plane(look: Look, direction: vec3f) -> f32 {
    let above = saturate(1.0 + dot(direction, look.plane_normal));
    return above * above;
}

fn light_around(look: Look) -> vec3f {
    let mirror = reflect(-look.toward_eye, look.normal);
    let mirrored = reflected(mirror, look.roughness) * above_plane(look, mirror);
    var coat_mirrored = vec3f(0.0);
    if LAYERED {
        let coat_mirror = reflect(-look.toward_eye, look.coat_normal);
        coat_mirrored = reflected(coat_mirror, look.coat_roughness) * above_plane(look, coat_mirror);
    }
    return answer_around(look, ambient(look.normal), mirrored, coat_mirrored);
}
