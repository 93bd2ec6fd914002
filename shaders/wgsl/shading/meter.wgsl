// Meters the picture: counts evenly spread pixels by their luminance, in quarter stops, once for surfaces and once for
// what lies behind them. Twin: `render::meter`.

#import "shading/view.wgsl"

const COLUMNS: u32 = 128u;
const ROWS: u32 = 80u;
// Bins of one histogram. The first begins at 2^-16, the last ends at 2^16.
const BINS: u32 = 128u;

@group(0) @binding(0) var light_picture: texture_2d<f32>;
@group(0) @binding(1) var normal_material_picture: texture_2d<u32>;
@group(0) @binding(2) var<storage, read_write> counts: array<atomic<u32>, 256>;

var<workgroup> together: array<atomic<u32>, 256>;

@compute @workgroup_size(16, 16)
fn meter(@builtin(global_invocation_id) id: vec3u, @builtin(local_invocation_index) index: u32) {
    let size = vec2f(textureDimensions(light_picture));
    let pixel = vec2u((vec2f(id.xy) + 0.5) / vec2f(f32(COLUMNS), f32(ROWS)) * size);
    let luminance = dot(textureLoad(light_picture, pixel, 0).rgb, vec3f(0.2126, 0.7152, 0.0722));
    let stop = (log2(max(luminance, 1e-6)) + 16.0) * 4.0;
    let behind = material_plus_1(textureLoad(normal_material_picture, pixel, 0).y) == 0u;
    atomicAdd(&together[u32(clamp(stop, 0.0, f32(BINS - 1u))) + select(0u, BINS, behind)], 1u);
    workgroupBarrier();
    let counted = atomicLoad(&together[index]);
    if counted != 0u {
        atomicAdd(&counts[index], counted);
    }
}
