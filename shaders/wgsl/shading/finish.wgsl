// How a surface point answers light: glTF's metallic-roughness model (glTF 2.0, appendix B) and its layers. Lengths of
// light are in units of a white Lambert surface's answer: π times a BRDF. See `client/docs/materials.md`.

// Constants of a material. Twin: `material::Finish`.
struct Finish {
    // What a dielectric mirrors at normal incidence, before `strength`.
    mirrored: vec3f,
    // Of what a dielectric mirrors.
    strength: f32,
    sheen: vec3f,
    sheen_roughness: f32,
    // What the last word of the surface holds.
    last: u32,
    unused_0: u32,
    unused_1: u32,
    unused_2: u32,
}

const LAST_IS_SMOOTH: u32 = 0u;
const LAST_IS_COAT_NORMAL: u32 = 1u;
const LAST_IS_SPECULAR: u32 = 2u;
const LAST_IS_SHEEN: u32 = 3u;

// False if no material of the scene has lacquer, sheen or a tint. Then none of it is compiled.
override LAYERED: bool = true;

// A surface point, ready to be asked.
struct Look {
    normal: vec3f,
    coat_normal: vec3f,
    plane_normal: vec3f,
    toward_eye: vec3f,
    // Colour of what is scattered below the surface.
    diffuse: vec3f,
    // What the dielectric part mirrors at normal incidence, and all of it.
    dielectric: vec3f,
    mirrored: vec3f,
    // What is mirrored at grazing angles.
    grazing: f32,
    // Roughness and its square, the α of GGX.
    roughness: f32,
    alpha: f32,
    // Cosine between normal and eye.
    facing_eye: f32,
    // Share of light that single reflections of a white surface return from all sides: at normal and at grazing
    // incidence of the Fresnel term.
    returned: vec2f,
    // What multiple reflections add.
    more: vec3f,
    occlusion: f32,
    coat: f32,
    coat_roughness: f32,
    sheen: vec3f,
    sheen_roughness: f32,
    // Without normal map.
    smooth_normal: vec3f,
    // Sine of the greatest angle between the smooth normal and facets around; 0 if their shadows on themselves are not
    // to be softened.
    lean: f32,
}

// A highlight must not be narrower: a punctual light has no size (Filament and three.js have the same bound).
const LEAST_ROUGHNESS: f32 = 0.045;

fn fifth_power(x: f32) -> f32 {
    let squared = x * x;
    return squared * squared * x;
}

// Schlick's approximation.
fn fresnel(normal: vec3f, grazing: f32, cosine: f32) -> vec3f {
    return mix(normal, vec3f(grazing), fifth_power(saturate(1.0 - cosine)));
}

// Directional albedo of GGX with Smith's correlated shadowing, of white: what comes at Fresnel's normal end, and at its
// grazing end. A fit to integrals: their sum is off by 2.5 % at most, 0.3 % on average.
fn albedo(roughness: f32, cosine: f32) -> vec2f {
    let r = roughness;
    let m = max(cosine, 0.02);
    let lost = r * r * (9.9717 + r * (-6.1021 + 0.95817 * r) + m * (172.98 + r * (-660.58 + 1107.91 * r)))
        / (1.0 + r * (-31.157 + 237.05 * r)
            + m * (161.58 + r * (-1413.55 + 2026.88 * r) + m * (1194.18 + r * (-1949.71 + 666.12 * r))));
    let away = 1.0 - m;
    let grazing = away * away * (away * away * away * (1.0183 + r * (-1.9124 + 1.1975 * r)) + r * (0.4331 - 0.425 * r))
        / (1.0 + r * (-0.2506 + 6.5609 * r) + m * (-0.734 + r * (-10.8379 + 8.6426 * r) + 5.0277 * m));
    return vec2f(saturate(1.0 - lost - grazing), saturate(grazing));
}

// GGX with Smith's height-correlated shadowing (Heitz 2014), times π. The sine comes from a cross product: near 1 a
// cosine has too few digits.
fn mirror_lobe(alpha: f32, normal: vec3f, half_way: vec3f, facing: f32, facing_eye: f32) -> f32 {
    let a2 = alpha * alpha;
    let sine = cross(normal, half_way);
    let cosine = saturate(dot(normal, half_way));
    // Opposite to the normal the sine is 0, too.
    let spread = select(1.0, dot(sine, sine) + cosine * cosine * a2, cosine > 0.0);
    let shadowed = facing * sqrt(a2 + (1.0 - a2) * facing_eye * facing_eye)
        + facing_eye * sqrt(a2 + (1.0 - a2) * facing * facing);
    return a2 / (spread * spread) * 0.5 / max(shadowed, 1e-6);
}

// Share that the sheen takes of light from all sides: Filament's and three.js's fit.
fn sheen_albedo(roughness: f32, cosine: f32) -> f32 {
    let inverse = 1.0 / (roughness + 0.1);
    let a = -1.9362 + 1.0678 * roughness + 0.4573 * roughness * roughness - 0.8469 * inverse;
    let b = -0.6014 + 0.5538 * roughness - 0.4670 * roughness * roughness - 0.1255 * inverse;
    return saturate(exp(a * cosine + b));
}

// Charlie's distribution (Estevez and Kulla 2017) with the visibility of Neubelt and Pettineo (2013), times π.
fn sheen_lobe(roughness: f32, cosine: f32, facing: f32, facing_eye: f32) -> f32 {
    let inverse = 1.0 / (roughness * roughness);
    let squared_sine = max(1.0 - cosine * cosine, 0.0078125);
    let spread = (2.0 + inverse) * pow(squared_sine, 0.5 * inverse) * 0.5;
    return spread * saturate(0.25 / max(facing + facing_eye - facing * facing_eye, 1e-6));
}

// Hides that the facets of a coarse smooth mesh turn from a light one by one. A facet may have turned away, and be dark
// by its bits, where the smooth normal is up to its lean above the light's horizon. So light ends there, and is whole
// at twice that height. The shadow-terminator factor of Chiang, Li and Burley (2019) keeps the facets' steps.
fn terminator(look: Look, toward: vec3f) -> f32 {
    let height = dot(look.smooth_normal, toward);
    let share = saturate(height / max(look.lean, 1e-3) - 1.0);
    return select(share * share * (3.0 - 2.0 * share), 1.0, look.lean == 0.0);
}

// What the surface sends to the eye of light with unit irradiance across its way, from a direction.
fn answer(look: Look, toward: vec3f) -> vec3f {
    let facing = saturate(dot(look.normal, toward));
    // Nothing where the light is straight behind.
    let sum = toward + look.toward_eye;
    let half_way = sum * inverseSqrt(max(dot(sum, sum), 1e-12));
    let between = saturate(dot(look.toward_eye, half_way));
    let lobe = mirror_lobe(look.alpha, look.normal, half_way, facing, look.facing_eye);
    let below = look.diffuse * (1.0 - fresnel(look.dielectric, look.grazing, between));
    var sent = facing * (below + lobe * look.more * fresnel(look.mirrored, look.grazing, between));
    if LAYERED {
        let most = max(max(look.sheen.r, look.sheen.g), look.sheen.b);
        if most > 0.0 {
            let taken = max(
                sheen_albedo(look.sheen_roughness, look.facing_eye), sheen_albedo(look.sheen_roughness, facing),
            );
            let cosine = saturate(dot(look.normal, half_way));
            let shine = sheen_lobe(look.sheen_roughness, cosine, facing, look.facing_eye);
            sent = sent * (1.0 - most * taken) + facing * shine * look.sheen;
        }
        if look.coat > 0.0 {
            let coat_facing = saturate(dot(look.coat_normal, toward));
            let coat_facing_eye = saturate(dot(look.coat_normal, look.toward_eye));
            let alpha = look.coat_roughness * look.coat_roughness;
            let shine = mirror_lobe(alpha, look.coat_normal, half_way, coat_facing, coat_facing_eye);
            let passed = 1.0 - look.coat * fresnel(vec3f(0.04), 1.0, coat_facing_eye);
            sent = sent * passed + coat_facing * shine * look.coat * fresnel(vec3f(0.04), 1.0, between);
        }
    }
    return sent * terminator(look, toward);
}

// What the surface sends to the eye of light from all around. `irradiance` is that of `ambient`; `mirrored` and
// `coat_mirrored` are radiance from where the eye's rays are mirrored to.
fn answer_around(look: Look, irradiance: vec3f, mirrored: vec3f, coat_mirrored: vec3f) -> vec3f {
    let dielectric = scattered(look, look.dielectric);
    let whole = scattered(look, look.mirrored);
    // Of a highlight less is hidden than of all light around (Lagarde and de Rousiers 2014).
    let open = saturate(
        pow(look.facing_eye + look.occlusion, exp2(-16.0 * look.roughness - 1.0)) - 1.0 + look.occlusion,
    );
    var sent = look.diffuse * (1.0 - dielectric) * irradiance * look.occlusion + whole * mirrored * open;
    if LAYERED {
        let taken = sheen_albedo(look.sheen_roughness, look.facing_eye);
        let most = max(max(look.sheen.r, look.sheen.g), look.sheen.b);
        sent = sent * (1.0 - most * taken) + look.sheen * (taken * look.occlusion) * irradiance;
        let coat_facing_eye = saturate(dot(look.coat_normal, look.toward_eye));
        let passed = 1.0 - look.coat * fresnel(vec3f(0.04), 1.0, coat_facing_eye);
        let ends = albedo(look.coat_roughness, coat_facing_eye);
        sent = sent * passed + coat_mirrored * (look.coat * (0.04 * ends.x + ends.y) * look.occlusion);
    }
    return sent;
}

// Share of light from all around that a surface with this Fresnel term returns by one reflection and by many
// (Fdez-Agüera, "A Multiple-Scattering Microfacet Model for Real-Time Image-Based Lighting", JCGT 2019).
fn scattered(look: Look, mirrored: vec3f) -> vec3f {
    let once = mirrored * look.returned.x + look.grazing * look.returned.y;
    let lost = 1.0 - look.returned.x - look.returned.y;
    let mean = mirrored + (1.0 - mirrored) / 21.0;
    return once + lost * once * mean / (1.0 - lost * mean);
}

// `normals`: shading, lacquer's, plane. `smooth_normal`: and lean. `gloss`: roughness, metallic, the lacquer's strength
// and roughness.
fn look_of(
    normals: mat3x3f, smooth_normal: vec4f, toward_eye: vec3f, color: vec3f, finish: Finish, gloss: vec4f, tint: vec4f,
    occlusion: f32,
) -> Look {
    let normal = normals[0];
    let metallic = gloss.y;
    let roughness = max(gloss.x, LEAST_ROUGHNESS);
    let specular = select(vec4f(1.0), tint, LAYERED && finish.last == LAST_IS_SPECULAR);
    let sheen_tint = select(vec4f(1.0), tint, LAYERED && finish.last == LAST_IS_SHEEN);
    let strength = finish.strength * specular.a;
    let dielectric = min(finish.mirrored * specular.rgb, vec3f(1.0)) * strength;
    let mirrored = mix(dielectric, color, metallic);
    let facing_eye = saturate(dot(normal, toward_eye));
    let returned = albedo(roughness, facing_eye);
    // Turquin, "Practical Multiple Scattering Compensation for Microfacet Models" (2019).
    let more = 1.0 + mirrored * (1.0 / (returned.x + returned.y) - 1.0);
    return Look(
        normal, normals[1], normals[2], toward_eye, color * (1.0 - metallic), dielectric, mirrored,
        mix(strength, 1.0, metallic), roughness, roughness * roughness, facing_eye, returned, more, occlusion,
        gloss.z, max(gloss.w, LEAST_ROUGHNESS), finish.sheen * sheen_tint.rgb,
        max(finish.sheen_roughness * sheen_tint.a, 0.07), smooth_normal.xyz, smooth_normal.w,
    );
}
