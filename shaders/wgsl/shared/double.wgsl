// f64 by whole numbers, bit by bit that of the processor. An adapter's own f64 may round otherwise: a compiler may fuse
// products with sums, and quotients and roots need not be rounded correctly. Results are rounded to the nearest, ties to
// even, as IEEE 754 has it, down to the smallest. Nothing infinite is read back: callers see to it that nothing gets so large.

// ± mantissa · 2^exponent. The mantissa is 0, or has 53 bits; those of numbers below 2^-1022 end in zeros.
struct Double {
    // 1 below zero.
    sign: u32,
    exponent: i32,
    mantissa: u64,
}

const ZERO = Double(0u, 0, 0lu);
const ONE = Double(0u, -52, 0x10000000000000lu);
// The last bit of the smallest numbers is worth two to this power.
const LAST_POWER: i32 = -1074;
// Twice the steps by which an estimate is put right.
const MOST_STEPS: u32 = 4u;

// A number with 55 or 56 bits, the last of which is set if anything was cut off below it, rounded.
fn rounded(sign: u32, exponent: i32, bits: u64) -> Double {
    let short = bits < 0x80000000000000lu;
    let aligned = select(bits, bits << 1u, short);
    let lost = LAST_POWER - (exponent + select(3, 2, short));
    if lost > 0 {
        return rounded_small(sign, aligned, u32(lost) + 3u);
    }
    var mantissa = (aligned + 3lu + ((aligned >> 3u) & 1lu)) >> 3u;
    var power = exponent + select(3, 2, short);
    if mantissa == 0x20000000000000lu {
        mantissa >>= 1u;
        power += 1;
    }
    return Double(sign, power, mantissa);
}

// A number of 56 bits, of which so many lie below the last power.
fn rounded_small(sign: u32, bits: u64, below: u32) -> Double {
    if below > 57u {
        return Double(sign, 0, 0lu);
    }
    let half = (1lu << (below - 1u)) - 1lu;
    return normal_double(sign, LAST_POWER, (bits + half + ((bits >> below) & 1lu)) >> below);
}

// A number of up to 53 bits.
fn normal_double(sign: u32, exponent: i32, bits: u64) -> Double {
    if bits == 0lu {
        return Double(sign, 0, 0lu);
    }
    let up = leading_zeros(bits) - 11u;
    return Double(sign, exponent - i32(up), bits << up);
}

fn bit_if(is_set: bool) -> u64 {
    return select(0lu, 1lu, is_set);
}

fn leading_zeros(bits: u64) -> u32 {
    let high = u32(bits >> 32u);
    return select(countLeadingZeros(high), 32u + countLeadingZeros(u32(bits)), high == 0u);
}

// A finite f64, as its low and high word.
fn double_of(low: u32, high: u32) -> Double {
    let power = (high >> 20u) & 0x7ffu;
    let fraction = (u64(high & 0xfffffu) << 32u) | u64(low);
    if power == 0u {
        return normal_double(high >> 31u, LAST_POWER, fraction);
    }
    return Double(high >> 31u, i32(power) - 1075, fraction | 0x10000000000000lu);
}

// A finite f32, as its bits.
fn double_of_single(bits: u32) -> Double {
    let power = (bits >> 23u) & 0xffu;
    let fraction = bits & 0x7fffffu;
    if power == 0u {
        return normal_double(bits >> 31u, -149, u64(fraction));
    }
    return Double(bits >> 31u, i32(power) - 179, u64(fraction | 0x800000u) << 29u);
}

// The nearest f32, as its bits.
fn single_of(x: Double) -> u32 {
    let sign = x.sign << 31u;
    let power = x.exponent + 179;
    if x.mantissa == 0lu {
        return sign;
    }
    if power >= 255 {
        return sign | 0x7f800000u;
    }
    // Numbers below 2^-126 lose more bits.
    let shift = u32(29 + max(1 - power, 0));
    if shift > 54u {
        return sign;
    }
    let half = (1lu << (shift - 1u)) - 1lu;
    let fraction = u32((x.mantissa + half + ((x.mantissa >> shift) & 1lu)) >> shift);
    // The fraction's first bit, and one that rounding carried, count in the exponent.
    return sign | (select(0u, u32(power - 1) << 23u, power > 1) + fraction);
}

// The nearest f32.
fn to_single(x: Double) -> Double {
    return double_of_single(single_of(x));
}

fn negative(x: Double) -> Double {
    return Double(x.sign ^ 1u, x.exponent, x.mantissa);
}

fn product(x: Double, y: Double) -> Double {
    let sign = x.sign ^ y.sign;
    if x.mantissa == 0lu || y.mantissa == 0lu {
        return Double(sign, 0, 0lu);
    }
    // Of 106 bits, the upper half and what lies below it.
    let a = x.mantissa << 7u;
    let b = y.mantissa << 7u;
    let a_low = a & 0xfffffffflu;
    let b_low = b & 0xfffffffflu;
    let lowest = a_low * b_low;
    let middle = a_low * (b >> 32u) + (a >> 32u) * b_low + (lowest >> 32u);
    let upper = (a >> 32u) * (b >> 32u) + (middle >> 32u);
    let rest = bit_if((u32(middle) | u32(lowest)) != 0u);
    return rounded(sign, x.exponent + y.exponent + 50, upper | rest);
}

fn sum(x: Double, y: Double) -> Double {
    if y.mantissa == 0lu {
        return Double(select(x.sign, x.sign & y.sign, x.mantissa == 0lu), x.exponent, x.mantissa);
    }
    if x.mantissa == 0lu {
        return y;
    }
    let swapped = x.exponent < y.exponent || (x.exponent == y.exponent && x.mantissa < y.mantissa);
    var large = x;
    var small = y;
    if swapped {
        large = y;
        small = x;
    }
    let shift = min(u32(large.exponent - small.exponent), 60u);
    let a = large.mantissa << 3u;
    let whole = small.mantissa << 3u;
    let b = (whole >> shift) | bit_if((whole & ((1lu << shift) - 1lu)) != 0lu);
    let exponent = large.exponent - 3;
    if x.sign == y.sign {
        let all = a + b;
        let long = all >= 0x100000000000000lu;
        return rounded(large.sign, exponent + i32(long), select(all, (all >> 1u) | (all & 1lu), long));
    }
    let rest = a - b;
    if rest == 0lu {
        return ZERO;
    }
    let up = leading_zeros(rest) - 8u;
    return rounded(large.sign, exponent - i32(up), rest << up);
}

fn difference(x: Double, y: Double) -> Double {
    return sum(x, negative(y));
}

// Digits of 18, 19 and 18 bits are estimated in f32, which leaves less than a quarter of the last bit's worth of error to
// each, and the remainder, which is exact, puts the whole right: by one step, or two. By zero, it is zero.
fn quotient(x: Double, y: Double) -> Double {
    let sign = x.sign ^ y.sign;
    if x.mantissa == 0lu || y.mantissa == 0lu {
        return Double(sign, 0, 0lu);
    }
    let by = i64(y.mantissa);
    let share = 1.0 / f32(by);
    var rest = i64(x.mantissa);
    var bits = 0li;
    for (var digit = 0u; digit < 3u; digit++) {
        let width = select(18u, 19u, digit == 1u);
        let estimate = i64(i32(f32(rest) * share * f32(1u << width)));
        bits = (bits << width) + estimate;
        // What leaves the word above is the same on both sides.
        rest = (rest << width) - estimate * by;
    }
    for (var step = 0u; step < MOST_STEPS; step++) {
        if rest < 0li {
            bits -= 1li;
            rest += by;
        } else if rest >= by {
            bits += 1li;
            rest -= by;
        }
    }
    return rounded(sign, x.exponent - y.exponent - 55, u64(bits) | bit_if(rest != 0li));
}

// x is not negative. The root's first 24 bits are estimated in f32, then 21 and 10 more from what its square lacks, which
// is exact and puts the whole right: by two steps at most.
fn root(x: Double) -> Double {
    if x.mantissa == 0lu {
        return x;
    }
    let odd = u32(x.exponent & 1);
    let square = i64(x.mantissa << odd);
    var bits = i64(sqrt(f32(square)) * 0.125);
    // Of the square times 2^-6, 2^36 and 2^56.
    var rest = square - ((bits * bits) << 6u);
    let second = i64(f32(rest) * 16384.0 / f32(bits));
    bits = (bits << 21u) + second;
    rest = (square << 36u) - bits * bits;
    let third = i64(f32(rest) * 512.0 / f32(bits));
    bits = (bits << 10u) + third;
    rest = (square << 56u) - bits * bits;
    for (var step = 0u; step < MOST_STEPS; step++) {
        if rest < 0li {
            bits -= 1li;
            rest += 2li * bits + 1li;
        } else if rest > 2li * bits {
            rest -= 2li * bits + 1li;
            bits += 1li;
        }
    }
    return rounded(0u, (x.exponent - i32(odd)) / 2 - 28, u64(bits) | bit_if(rest != 0li));
}

// Of numbers that are not negative.
fn is_greater(x: Double, y: Double) -> bool {
    if x.mantissa == 0lu || y.mantissa == 0lu {
        return x.mantissa > y.mantissa;
    }
    return x.exponent > y.exponent || (x.exponent == y.exponent && x.mantissa > y.mantissa);
}

struct Double3 {
    x: Double,
    y: Double,
    z: Double,
}

fn double3_of_singles(bits: vec3u) -> Double3 {
    return Double3(double_of_single(bits.x), double_of_single(bits.y), double_of_single(bits.z));
}

fn singles_of(v: Double3) -> vec3u {
    return vec3u(single_of(v.x), single_of(v.y), single_of(v.z));
}

fn sum3(a: Double3, b: Double3) -> Double3 {
    return Double3(sum(a.x, b.x), sum(a.y, b.y), sum(a.z, b.z));
}

fn difference3(a: Double3, b: Double3) -> Double3 {
    return Double3(difference(a.x, b.x), difference(a.y, b.y), difference(a.z, b.z));
}

fn scaled(v: Double3, by: Double) -> Double3 {
    return Double3(product(v.x, by), product(v.y, by), product(v.z, by));
}

fn dot3(a: Double3, b: Double3) -> Double {
    return sum(sum(product(a.x, b.x), product(a.y, b.y)), product(a.z, b.z));
}

fn cross3(a: Double3, b: Double3) -> Double3 {
    return Double3(
        difference(product(a.y, b.z), product(b.y, a.z)),
        difference(product(a.z, b.x), product(b.z, a.x)),
        difference(product(a.x, b.y), product(b.x, a.y)),
    );
}
