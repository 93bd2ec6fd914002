// Light around the scene, exposed: what is seen behind everything, and what arrives from all sides.

#import "shading/inputs.wgsl"

// Radiance from a direction in which there is no surface. The direction need not be a unit vector.
fn sky(direction: vec3f) -> vec3f {
    return mix(lighting.horizon, lighting.zenith, sqrt(saturate(normalize(direction).y)));
}

// Irradiance of a surface with this normal from all around, over π: white paint shows it.
fn ambient(normal: vec3f) -> vec3f {
    return mix(lighting.ambient_below, lighting.ambient_above, 0.5 * normal.y + 0.5);
}

// Radiance that a surface of this roughness mirrors from around a direction, a unit vector.
fn reflected(direction: vec3f, roughness: f32) -> vec3f {
    return vec3f(0.0);
}
