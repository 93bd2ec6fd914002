// Light on a point from the lights; `environment.wgsl` has the light around. Twin: `shading::Lighting`.

const DIRECTIONAL: u32 = 0u;
const POINT: u32 = 1u;
const SPOT: u32 = 2u;

struct Light {
    // Position in local space, in metres.
    position: vec3f,
    // DIRECTIONAL, POINT or SPOT.
    kind: u32,
    // Unit vector in which the light travels.
    direction: vec3f,
    // One over the range in metres, or 0 for a light without one.
    inverse_range: f32,
    // Colour times intensity (candela or lux), times the exposure.
    intensity: vec3f,
    // The cone's falloff is (cosine · scale + offset)², clamped to 0 and 1 before it is squared (KHR_lights_punctual).
    cone_scale: f32,
    cone_offset: f32,
    // The light's first view in the shadow map.
    shadow_view: u32,
    // Square of the distance within which light grows no more.
    closest_squared: f32,
    unused_0: f32,
}

struct Lighting {
    // Ambient irradiance from above, times the exposure.
    ambient_above: vec3f,
    // Number of lights.
    count: u32,
    // Ambient irradiance from below, times the exposure.
    ambient_below: vec3f,
    // First column of the picture that is drawn without shadows.
    lit_from_px: u32,
    // Radiance of a painted sky at the zenith and at the horizon, exposed.
    zenith: vec3f,
    // Factors of the environment: as it is seen, and as it lights surfaces.
    sky_seen: f32,
    horizon: vec3f,
    sky_lit: f32,
    lights: array<Light, 32>,
    // Irradiance from the environment over π, exposed: factors of 1, y, z, x, xy, yz, 3z² − 1, xz, x² − y².
    harmonics: array<vec4f, 9>,
    // 1 if surfaces mirror the ambient light, else 0.
    mirrored: f32,
    unused_0: f32,
    unused_1: f32,
    unused_2: f32,
}

// Light that arrives unoccluded at a point.
struct Arrival {
    // Unit vector towards the light.
    toward: vec3f,
    // Irradiance on a surface that faces the light; 0 outside the light's range and cone.
    irradiance: vec3f,
}

fn arrival(light: Light, point: vec3f) -> Arrival {
    if light.kind == DIRECTIONAL {
        return Arrival(-light.direction, light.intensity);
    }
    let between = light.position - point;
    // Clamped: a punctual light has no size, and would be infinitely bright at its own position.
    let squared = max(dot(between, between), light.closest_squared);
    let toward = between * inverseSqrt(squared);
    let reach = squared * light.inverse_range * light.inverse_range;
    var strength = saturate(1.0 - reach * reach) / squared;
    if light.kind == SPOT {
        let cone = saturate(-dot(toward, light.direction) * light.cone_scale + light.cone_offset);
        strength *= cone * cone;
    }
    return Arrival(toward, light.intensity * strength);
}
