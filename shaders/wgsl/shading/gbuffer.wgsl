// The G-buffer: the nearest OPAQUE or MASK surface of every pixel, as `server/src/visibility/mod.rs` defines it.

#import "shading/view.wgsl"
#import "shading/surface.wgsl"

@group(0) @binding(0) var<uniform> view: View;

// 32 bytes of attachments, WebGPU's default limit.
struct Written {
    // Linear base colour, which the target encodes as sRGB; occlusion.
    @location(0) color: vec4f,
    // See `packed_surface`. 0 where there is no surface.
    @location(1) surface: vec4u,
    // Light that the surface emits, exposed; shading adds to it.
    @location(2) emitted: vec4f,
}

@vertex
fn transform(vertex: Vertex) -> Varying {
    return projected(vertex, view.clip_from_local, view.origin);
}

@vertex
fn transform_more(vertex: Vertex, more: MoreOfVertex) -> MoreVarying {
    return projected_more(vertex, more, view.clip_from_local, view.origin);
}

// Four words: shading normal; plane normal and material (`view.wgsl`); roughness, metallic, and the lacquer's strength
// and roughness; and what the finish (`finish.wgsl`) says: the lacquer's normal, a tint, or the normal without normal
// map and the lean.
fn packed_surface(surface: Surface) -> vec4u {
    var last = pack_smooth(surface.smooth_normal, surface.lean);
    if has(COAT_NORMAL) || (has(NORMAL) && material.coat > 0.0) {
        last = pack_normal(surface.coat_normal);
    } else if has(TINT) {
        last = pack4x8unorm(surface.tint);
    }
    return vec4u(
        pack_normal(surface.normal),
        pack_material(material.index, surface.plane_normal),
        pack4x8unorm(vec4f(surface.roughness, surface.metallic, surface.coat, surface.coat_roughness)),
        last,
    );
}

fn written(surface: Surface) -> Written {
    return Written(
        vec4f(surface.color.rgb, surface.occlusion),
        packed_surface(surface),
        // Halved: shading adds no more than that to it.
        vec4f(min(surface.emitted, vec3f(32752.0)), 1.0),
    );
}

fn masked_point(point: Point, front: bool) -> Written {
    let seen = written(surface_of(point, front));
    var alpha = mask_alpha(point.uv);
    if has(COLORS) {
        alpha *= vertex_alpha(point.color.a);
    }
    if alpha < material.alpha_cutoff {
        discard;
    }
    return seen;
}

@fragment
fn opaque(input: Varying, @builtin(front_facing) front: bool) -> Written {
    return written(surface_of(point_of(input), front));
}

@fragment
fn opaque_more(input: MoreVarying, @builtin(front_facing) front: bool) -> Written {
    return written(surface_of(point_of_more(input), front));
}

@fragment
fn masked(input: Varying, @builtin(front_facing) front: bool) -> Written {
    return masked_point(point_of(input), front);
}

@fragment
fn masked_more(input: MoreVarying, @builtin(front_facing) front: bool) -> Written {
    return masked_point(point_of_more(input), front);
}
