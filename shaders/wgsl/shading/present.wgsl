// Shows the picture: texel for texel if it has the screen's size, otherwise scaled to fit at its aspect ratio.

#import "shading/view.wgsl"

@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var between: sampler;
// Size of the screen, in pixels.
@group(0) @binding(2) var<uniform> screen_px: vec4f;

@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return covering_triangle(index);
}

@fragment
fn present(@builtin(position) place: vec4f) -> @location(0) vec4f {
    let size = vec2f(textureDimensions(picture));
    if all(size == screen_px.xy) {
        return textureLoad(picture, vec2u(place.xy), 0);
    }
    let scale = min(screen_px.x / size.x, screen_px.y / size.y);
    let at = ((place.xy - 0.5 * screen_px.xy) / scale + 0.5 * size) / size;
    let shown = textureSampleLevel(picture, between, at, 0.0);
    return select(vec4f(0.0, 0.0, 0.0, 1.0), shown, all(at >= vec2f(0.0)) && all(at <= vec2f(1.0)));
}
