//! Data that meshoptimizer 1.3 encoded (crate meshopt 0.7.0, all levels and versions), as hexadecimal digits.

use super::*;

/// 40 vertices of 12 bytes: two 16-bit integers, a float, and four bytes.
fn vertices() -> Vec<u8> {
    let vertex = |at: u32| {
        let [a, b] = [at * 37 % 1000, 1000_u32.wrapping_sub(at * at) & 0xffff].map(|v| u16::try_from(v).unwrap());
        let float = f32::from(u16::try_from(at).unwrap()) * 0.25 + 1.0;
        let last =
            [at / 8, 7, if at % 13 == 5 { 200 } else { at % 3 }, at * 91 % 256].map(|v| u8::try_from(v).unwrap());
        [&a.to_le_bytes()[..], &b.to_le_bytes(), &float.to_le_bytes(), &last].concat()
    };
    (0..40).flat_map(vertex).collect()
}

const ATTRIBUTES: [&str; 5] = [
    "a01f004a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a7a4a4a4affff00004a4a4a4a4a4a4a4a15000200\
         08002000c005080000001f000105090d1115191d2125292d3135393d4145494d5155595d6165696d717579ffff00007d8185\
         898d91959914400100404041000000002f004040404020202020202020201010101010101010101010101010101008080888\
         888888000000000500800000000000801500008000800080008000000000152bbebaeb037170030303afbaebaf7372030303\
         036ffaeb0000740303031f00b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6ffff0000b6b6b6\
         b6b6b6b6b600000000000000000000000000000000000000000000e8030000803f00070000",
    "a1555a590f004a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a7a4a4a4aff004a4a4a4a4a4a4a4a008040\
         0202201002050400020f000105090d1115191d2125292d3135393d4145494d5155595d6165696d717579ff007d8185898d91\
         959914000040010040404100002f004040404020202020202020201010101010101010101010101010101008080888888888\
         000000000010000200100200000000010201010202010002152bbebaeb037170030303afbaebaf7372030303036ffaeb0000\
         740303030f00b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6ff00b6b6b6b6b6b6b6b6000000\
         0000000000000000e8030000803f00070000000000",
    "a1373ad9004a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a7a4a4a4a4a4a4a4a4a4a4a4a008040020220\
         100205040002000105090d1115191d2125292d3135393d4145494d5155595d6165696d7175797d8185898d91959928400100\
         4040410000004040404020202020202020201010101010101010101010101010101008080808080808080808080510000200\
         10020000010201010202010002152bbebaeb037170030303afbaebaf7372030303036ffaeb00007403030300b6b6b6b6b6b6\
         b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b60000000000000000000000e8030000803f\
         00070000000000",
    "a1b3bad9004a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a854a4a4a4a4a4a4a4a4a4a4a040010070001\
         05090d1115191d2125292d3135393d4145494d5155595d6165696d7175797d8185898d919599004040404020202020202020\
         201010101010101010101010101010101008080808080808080808080000010201010202010002152bbebaeb037170030303\
         afbaebaf7372030303036ffaeb00007403030300b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6b6\
         b6b6b6b6b6b6b6b6b60000000000000000000000e8030000803f00070000010100",
    "a1b368d9004a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a854a4a4a4a4a4a4a4a4a4a4a040010070001\
         05090d1115191d2125292d3135393d4145494d5155595d6165696d7175797d8185898d9195990110001f1a08f8f4c4f4c4f2\
         6218f81c3ce262f262e262f1311e7edddd000007030f030000010101010301010007191e7de79e03c9c803030313ff321321\
         32132fcac9c8e79e0000ca0303005beda77dabe55fa5ebbd67addb65afe5bb6da7dd6ba5ffa56bdda76dbbe5af65dbad67bd\
         eba55f0000000000000000000000e8030000803f00070000016202",
];

const TRIANGLES: [&str; 2] = [
    "e0fe1f100f100f100fcf1f160f150f140fcf1f140f140f140fffffff0f0a0202020202020202020202020202efa20155ff71\
         02025f22a401007687566778a9866589689801690000",
    "e1fe1e100e100e100ece1e160e150e140ece1e140e140e140efffeff0f0aefa2015500ff4ba20102007687566778a9866589\
         689801690000",
];

const SEQUENCES: [&str; 2] = ["d00004040ca11f0506049dec10050600000000", "d10004040ca11f0506049dec10050600000000"];

fn bytes(digits: &str) -> Vec<u8> {
    let pair = |at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap();
    (0..digits.len()).step_by(2).map(pair).collect()
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks(4).map(|word| u32::from_le_bytes(word.try_into().unwrap())).collect()
}

/// Three rows of four cells, and triangles that jump.
fn triangles() -> Vec<u32> {
    let cells = (0..3).flat_map(|y| (0..4).map(move |x| y * 5 + x));
    let mut indices: Vec<u32> = cells.flat_map(|at| [at, at + 1, at + 5, at + 1, at + 6, at + 5]).collect();
    indices.extend([100, 3, 57, 0, 1, 2, 19, 100, 101]);
    indices
}

#[test]
fn attributes_of_every_version_and_level() {
    for digits in ATTRIBUTES {
        let decoded = decode(Mode::Attributes(Filter::None), &bytes(digits), 40, 12);
        assert_eq!(decoded.unwrap(), vertices(), "{digits}");
    }
}

#[test]
fn indices_of_every_version() {
    for digits in TRIANGLES {
        let decoded = words(&decode(Mode::Triangles, &bytes(digits), 81, 4).unwrap());
        // The encoder may begin a triangle at another corner.
        for (decoded, expected) in decoded.chunks(3).zip(triangles().chunks(3)) {
            assert!((0..3).any(|turn| (0..3).all(|at| decoded[(at + turn) % 3] == expected[at])), "{decoded:?}");
        }
    }
    for digits in SEQUENCES {
        let expected = [0, 1, 2, 5, 1000, 1001, 3, 4, 70000, 70001, 2];
        assert_eq!(words(&decode(Mode::Indices, &bytes(digits), 11, 4).unwrap()), expected);
        let halves = decode(Mode::Indices, &bytes(digits), 11, 2).unwrap();
        assert_eq!(halves[16..18], (70000_u32 % 65536).to_le_bytes()[..2]);
    }
}

/// Applies a filter to what the encoder's filter made.
fn filtered(filter: impl Fn(&mut [u8]), digits: &str) -> Vec<u8> {
    let mut data = bytes(digits);
    filter(&mut data);
    data
}

fn shorts(bytes: &[u8]) -> Vec<i16> {
    bytes.chunks(2).map(|pair| i16::from_le_bytes(pair.try_into().unwrap())).collect()
}

#[test]
fn filters_give_what_the_reference_decoder_gives() {
    let octahedral = filtered(filters::octahedral::<1>, "2c237f7f7f7f7f00b7367f4049817f7f");
    let octahedral: Vec<i8> = octahedral.into_iter().map(|byte| i8::from_le_bytes([byte])).collect();
    assert_eq!(octahedral, [76, 60, 82, 127, 0, 0, -127, 0, -102, 76, 0, 64, 0, -76, -102, 127]);
    let octahedral =
        filtered(filters::octahedral::<2>, "ca023b02ff07ff7fff07ff07ff0700006efb6d03ff070040920401f8ff07ff7f");
    let expected = [19658, 15721, 20979, 32767, 0, 0, -32767, 0, -26219, 19653, 0, 16384, 0, -19653, -26219, 32767];
    assert_eq!(shorts(&octahedral), expected);
    let quaternions = filtered(filters::quaternion, "a705a705a705fc07000037f90000ff07dffe16f8dffefd07000000000000fc07");
    let expected = [16399, 16378, 16378, 16378, 0, -19661, 0, 26213, -3271, 22943, -3271, -22932, 32767, 0, 0, 0];
    assert_eq!(shorts(&quaternions), expected);
    let color = filtered(filters::color::<1>, "407fc1ff66cd00e6ff000080000000c0");
    assert_eq!(color, [254, 1, 0, 255, 51, 102, 153, 204, 255, 255, 255, 0, 0, 0, 0, 128]);
    let color = filtered(filters::color::<2>, "0004ff0701fcff0f6606cdfc0000660eff0f000000000008000000000000000c");
    let color: Vec<u16> = shorts(&color).into_iter().map(i16::cast_unsigned).collect();
    let expected = [65519, 16, 0, 65535, 13107, 26214, 39321, 52428, 65535, 65535, 65535, 0, 0, 0, 0, 32776];
    assert_eq!(color, expected);
    let floats = filtered(
        filters::exponential,
        "004000f200b0fff3007d00fb004000efd47d00e20090fff4000000ef814a001300a0fff2666600ee666600efcd4c00f0",
    );
    let expected: [u32; 12] = [
        1_065_353_216,
        3_223_322_624,
        1_148_846_080,
        1_040_187_392,
        939_239_424,
        3_235_905_536,
        0,
        1_343_554_048,
        3_217_031_168,
        1_036_831_744,
        1_045_220_352,
        1_050_253_824,
    ];
    assert_eq!(words(&floats), expected);
}

#[test]
fn broken_data_are_errors() {
    let all = ATTRIBUTES.iter().map(|digits| (Mode::Attributes(Filter::None), *digits, 40, 12));
    let all = all.chain(TRIANGLES.iter().map(|digits| (Mode::Triangles, *digits, 81, 4)));
    let all = all.chain(SEQUENCES.iter().map(|digits| (Mode::Indices, *digits, 11, 4)));
    for (mode, digits, count, stride) in all {
        let data = bytes(digits);
        for end in 0..data.len() {
            assert!(decode(mode, &data[..end], count, stride).is_err(), "{mode:?} cut at {end}");
        }
        assert!(decode(mode, &[&data[..], &[0]].concat(), count, stride).is_err());
        for count in [count + 3000, count / 3] {
            assert!(decode(mode, &data, count, stride).is_err(), "{mode:?} of {count}");
        }
        assert!(decode(mode, &data, 1 << 40, stride).unwrap_err().contains("beyond"));
        for stride in [0, 1, 3, 6, 260] {
            assert!(decode(mode, &data, count, stride).is_err(), "stride {stride}");
        }
        let mut other = data.clone();
        other[0] ^= 0x10;
        assert!(decode(mode, &other, count, stride).unwrap_err().contains("another codec"));
        other[0] = data[0] | 2;
        assert!(decode(mode, &other, count, stride).unwrap_err().contains("later version"));
    }
    assert!(decode(Mode::Triangles, &bytes(TRIANGLES[1]), 80, 4).is_err());
    assert!(Mode::new("TRIANGLES", Some("OCTAHEDRAL")).is_err() && Mode::new("POINTS", None).is_err());
    assert_eq!(Mode::new("ATTRIBUTES", Some("COLOR")), Ok(Mode::Attributes(Filter::Color)));
}
