// Positions and normals as the host computes them: `Placement::vertex` and `triangle_normal` in gnomon-scene.

#import "visibility/pose.wgsl"
#import "shared/double.wgsl"

// An affine transform, by its columns.
struct Transform {
    x: Double3,
    y: Double3,
    z: Double3,
    w: Double3,
}

fn number(word: u32) -> Double {
    return double_of(placements[word], placements[word + 1u]);
}

fn numbers(word: u32) -> Double3 {
    return Double3(number(word), number(word + 2u), number(word + 4u));
}

// A vertex's transform where its piece is rigid.
fn world_from_piece(placement: u32) -> Transform {
    return Transform(numbers(placement), numbers(placement + 6u), numbers(placement + 12u), numbers(placement + 18u));
}

// That of normals, without a last column.
fn normals_of_piece(placement: u32) -> Transform {
    let first = placement + NORMALS_AT;
    return Transform(numbers(first), numbers(first + 6u), numbers(first + 12u), Double3(ZERO, ZERO, ZERO));
}

// A position in the scene's local space, as bits of f32.
fn position_bits(by: Transform, own: Double3, origin: Double3) -> vec3u {
    var there = scaled(by.x, own.x);
    there = sum3(scaled(by.y, own.y), there);
    there = sum3(scaled(by.z, own.z), there);
    there = sum3(by.w, there);
    return singles_of(difference3(there, origin));
}

// As f32, whose sums and products round an f64's: that has more than twice their digits.
fn single_unit(v: Double3) -> vec3u {
    let x = to_single(product(v.x, v.x));
    let y = to_single(product(v.y, v.y));
    let z = to_single(product(v.z, v.z));
    let length = to_single(root(to_single(sum(to_single(sum(x, y)), z))));
    return singles_of(scaled(v, to_single(quotient(ONE, length))));
}

// A unit normal, as bits of f32. A transform may leave none: then it is the piece's own.
fn normal_bits(by: Transform, normal: Double3, own: vec3u) -> vec3u {
    var there = scaled(by.x, normal.x);
    there = sum3(there, scaled(by.y, normal.y));
    there = sum3(there, scaled(by.z, normal.z));
    let squared = dot3(there, there);
    if squared.mantissa == 0lu {
        return own;
    }
    let unit = scaled(there, quotient(ONE, root(squared)));
    return single_unit(Double3(to_single(unit.x), to_single(unit.y), to_single(unit.z)));
}

// 1e-7 and 1e-16, as f64.
const MIN_HEIGHT_RATIO = Double(0u, -76, 0x1ad7f29abcaf48lu);
const MIN_DOUBLE_AREA_M2 = Double(0u, -106, 0x1cd2b297d889bclu);

fn larger(x: Double, y: Double) -> Double {
    if is_greater(y, x) {
        return y;
    }
    return x;
}

// A triangle's unit normal, as bits of f32: zero without an area.
fn plane(corners: array<vec3u, 3>) -> vec3u {
    let a = double3_of_singles(corners[0]);
    let b = double3_of_singles(corners[1]);
    let c = double3_of_singles(corners[2]);
    let ab = difference3(b, a);
    let ac = difference3(c, a);
    let bc = difference3(c, b);
    let across = cross3(ab, ac);
    let squared = dot3(across, across);
    if squared.mantissa == 0lu {
        return vec3u(0u);
    }
    let double_area = root(squared);
    let longest_squared = larger(larger(dot3(ab, ab), dot3(ac, ac)), dot3(bc, bc));
    let least = product(MIN_HEIGHT_RATIO, longest_squared);
    if !is_greater(double_area, least) || !is_greater(double_area, MIN_DOUBLE_AREA_M2) {
        return vec3u(0u);
    }
    return vec3u(
        single_of(quotient(across.x, double_area)),
        single_of(quotient(across.y, double_area)),
        single_of(quotient(across.z, double_area)),
    );
}
