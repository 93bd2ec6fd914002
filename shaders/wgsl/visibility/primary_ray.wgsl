// The rays from the camera through the pixels. Imported by the kernels of primary rays, which declare `view`.

#import "shared/traced_scene.wgsl"

// The direction through a place in the picture, in pixels from its upper left corner.
fn picture_direction(place: vec2f) -> vec3f {
    let x = 2.0 * place.x / f32(view.width) - 1.0;
    let y = 1.0 - 2.0 * place.y / f32(view.height);
    return view.forward + x * view.right + y * view.up;
}

// The direction through a pixel's centre.
fn pixel_direction(pixel: vec2u) -> vec3f {
    return picture_direction(vec2f(pixel) + 0.5);
}
