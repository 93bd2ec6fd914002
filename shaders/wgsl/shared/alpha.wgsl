// The alpha test of MASK triangles.

#import "shared/texels.wgsl"
#import "shared/traced_scene.wgsl"

fn alpha_texel(material: AlphaMaterial, x: i32, y: i32) -> f32 {
    let column = u32(wrapped(x, i32(material.width), material.wraps & 0xffffu));
    let row = u32(wrapped(y, i32(material.height), material.wraps >> 16u));
    let texel = material.first_texel + row * material.width + column;
    return f32((alpha_texels[texel >> 2u] >> ((texel & 3u) * 8u)) & 0xffu);
}

// False if no vertex of the scene's MASK triangles is see-through.
override HAS_VERTEX_ALPHA: bool = true;

// Bilinear in the full-size picture, times the alpha of the factor and of the vertices.
fn passes_material_alpha(index: u32, uv: vec2f, vertex_alpha: f32) -> bool {
    let material = alpha_materials[index];
    if HAS_VERTEX_ALPHA && material.width == 0u {
        return material.factor * vertex_alpha >= material.cutoff;
    }
    let texels = texels_around(uv, vec2f(f32(material.width), f32(material.height)));
    let x = texels.corner.x;
    let y = texels.corner.y;
    let upper = mix(alpha_texel(material, x, y), alpha_texel(material, x + 1, y), texels.weight.x);
    let lower = mix(alpha_texel(material, x, y + 1), alpha_texel(material, x + 1, y + 1), texels.weight.x);
    return mix(upper, lower, texels.weight.y) / 255.0 * material.factor * vertex_alpha >= material.cutoff;
}

// False if the scene has no triangles with holes. Then none of this is compiled.
override HAS_ALPHA: bool = true;

// True if a hit of `triangle` with these weights passes its material's alpha test.
fn passes_alpha_test(triangle: u32, kind: u32, weights: vec3f) -> bool {
    let alpha = kind & TRIANGLE_ALPHA;
    if !HAS_ALPHA || alpha == 0u {
        return true;
    }
    let first = triangles[triangle * 3u + 1u].w;
    let uv = alpha_uvs[first] * weights.x + alpha_uvs[first + 1u] * weights.y + alpha_uvs[first + 2u] * weights.z;
    var vertex_alpha = 1.0;
    if HAS_VERTEX_ALPHA && alpha_materials[alpha - 1u].vertex_alpha != 0u {
        let alphas = vec3f(alpha_uvs[first + 3u], alpha_uvs[first + 4u].x);
        // Rounding must not take from what is solid.
        vertex_alpha = select(dot(alphas, weights), 1.0, all(alphas == vec3f(1.0)));
    }
    return passes_material_alpha(alpha - 1u, uv, vertex_alpha);
}
