// Pixels that need more work than most are put off: a second dispatch does them, in which every invocation has such a
// pixel. Invocations run side by side, so otherwise a few would hold up many. Importers declare `put_off`.
// Host: `render::put_off`.

struct PutOff {
    // Rows of workgroups that the second dispatch needs.
    rows: atomic<u32>,
    // Number of pixels. 0 in a pass that does every pixel itself.
    count: atomic<u32>,
    // Column, and row times 2^16.
    pixels: array<u32>,
}

// Workgroups in a row of the second dispatch, and invocations of a workgroup. Twin: `put_off::COLUMNS`.
const COLUMNS: u32 = 16u;
const TOGETHER: u32 = 64u;

fn put_off_pixel(pixel: vec2u) {
    let place = atomicAdd(&put_off.count, 1u);
    put_off.pixels[place] = pixel.x | (pixel.y << 16u);
    if place % (COLUMNS * TOGETHER) == 0u {
        atomicMax(&put_off.rows, place / (COLUMNS * TOGETHER) + 1u);
    }
}

// The pixel of an invocation: one that was put off, or its own if none was. Outside the picture if there is none.
fn pixel_put_off(id: vec2u, group: vec2u, place_in_group: u32) -> vec2u {
    let count = atomicLoad(&put_off.count);
    if count == 0u {
        return id;
    }
    let place = (group.y * COLUMNS + group.x) * TOGETHER + place_in_group;
    if place >= count {
        return vec2u(0xffffffffu);
    }
    let packed = put_off.pixels[place];
    return vec2u(packed & 0xffffu, packed >> 16u);
}
