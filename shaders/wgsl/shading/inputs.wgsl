// What the passes that shade read, and what the mask and the G-buffer say about a pixel.
// `client/src/render/shade.rs` binds it.

#import "shading/view.wgsl"
#import "shading/lighting.wgsl"
#import "shared/mask.wgsl"

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> lighting: Lighting;
// The newest mask, plane after plane.
@group(0) @binding(2) var<storage, read> mask: array<u32>;
// Emitted light of every material, exposed.
@group(0) @binding(3) var<storage, read> emitted: array<vec4f>;
@group(0) @binding(4) var depth_picture: texture_depth_2d;
@group(0) @binding(5) var color_picture: texture_2d<f32>;
@group(0) @binding(6) var normal_material_picture: texture_2d<u32>;

// Whether light k reaches the surface in a pixel. Lights that the mask has no plane for reach everything.
fn lets_through(k: u32, pixel: vec2u) -> bool {
    if k >= view.mask_lights {
        return true;
    }
    let tiles_x = (view.width + TILE_PX - 1u) / TILE_PX;
    let tiles = tiles_x * ((view.height + TILE_PX - 1u) / TILE_PX);
    let tile = pixel.y / TILE_PX * tiles_x + pixel.x / TILE_PX;
    let bit = mask_bit(pixel % TILE_PX);
    return ((mask[mask_word(k, tiles, tile, bit)] >> (bit & 31u)) & 1u) == 1u;
}

// The point of the surface in a pixel, in local space.
fn surface_point(pixel: vec2u) -> vec3f {
    return view.origin + ray_of_pixel(view, pixel) * (view.near_m / textureLoad(depth_picture, pixel, 0));
}

// Light as its picture can hold it, whose 16-bit numbers end here: a surface close to a lamp would become infinitely
// bright, and black when it is shown.
fn kept(light: vec3f) -> vec3f {
    return min(light, vec3f(65504.0));
}
