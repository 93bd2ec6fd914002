// Light around the scene, exposed: what is seen behind everything, and what arrives from all sides. Radiance is over
// that of white paint that receives 1 exposed lux, so that an even environment shows white paint as itself.
// Made by `client/core/src/render/environment/`.

#import "shading/inputs.wgsl"

// Radiance by direction, to be multiplied; a level for each fifth of roughness.
@group(0) @binding(8) var environment: texture_cube<f32>;
@group(0) @binding(9) var environment_sampler: sampler;

// Level of roughness 1.
const ROUGHEST: f32 = 5.0;

// From below and above, all around.
fn hemisphere(direction: vec3f) -> vec3f {
    return mix(lighting.ambient_below, lighting.ambient_above, 0.5 * direction.y + 0.5);
}

// Radiance from a direction in which there is no surface. The direction need not be a unit vector.
fn sky(direction: vec3f) -> vec3f {
    let painted = mix(lighting.horizon, lighting.zenith, sqrt(saturate(normalize(direction).y)));
    return painted + lighting.sky_seen * textureSampleLevel(environment, environment_sampler, direction, 0.0).rgb;
}

// Irradiance of a surface with this normal from all around, over π: white paint shows it.
fn ambient(normal: vec3f) -> vec3f {
    let n = normal;
    let h = &lighting.harmonics;
    let around = (*h)[0].rgb + (*h)[1].rgb * n.y + (*h)[2].rgb * n.z + (*h)[3].rgb * n.x
        + (*h)[4].rgb * (n.x * n.y) + (*h)[5].rgb * (n.y * n.z) + (*h)[6].rgb * (3.0 * n.z * n.z - 1.0)
        + (*h)[7].rgb * (n.x * n.z) + (*h)[8].rgb * (n.x * n.x - n.y * n.y);
    return hemisphere(normal) + max(around, vec3f(0.0));
}

// Radiance that a surface of this roughness mirrors from around a direction, a unit vector.
fn reflected(direction: vec3f, roughness: f32) -> vec3f {
    let around = textureSampleLevel(environment, environment_sampler, direction, saturate(roughness) * ROUGHEST).rgb;
    return lighting.sky_lit * around + lighting.mirrored * hemisphere(direction);
}
