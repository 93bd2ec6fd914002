// Takes what moves out of a shadow map again (`render/predict/eraser.rs`).

#import "shading/view.wgsl"

@group(0) @binding(0) var resting: texture_depth_2d;

// Its depth is 0: nothing is there.
@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return covering_triangle(index);
}

@fragment
fn put_back(@builtin(position) place: vec4f) -> @builtin(frag_depth) f32 {
    return textureLoad(resting, vec2u(place.xy), 0);
}
