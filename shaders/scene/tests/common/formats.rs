//! Small inputs of the compressed formats.
#![allow(dead_code, reason = "each test file uses what it needs")]

use draco_core::{
    DataType, EncoderBuffer, EncoderOptions, FaceIndex, GeometryAttributeType, Mesh, MeshEncoder, PointAttribute,
    PointIndex,
};
use image::{ImageFormat, RgbaImage};

/// A picture of a few texels in every format that is read.
pub(crate) fn pictures() -> Vec<(&'static str, Vec<u8>)> {
    let blocks = [[200, 100, 50, 255], [1, 2, 3, 128], [255, 0, 0, 0], [0, 255, 0, 255]];
    vec![
        ("png", encoded(ImageFormat::Png)),
        ("jpeg", encoded(ImageFormat::Jpeg)),
        ("webp", encoded(ImageFormat::WebP)),
        ("uastc", uastc(7, 8, &blocks, false)),
        ("uastc-zstd", uastc(7, 8, &blocks, true)),
    ]
}

/// Texels of a picture of 9 × 5, all different. WebP is without loss.
pub(crate) fn texels(alpha: bool) -> RgbaImage {
    RgbaImage::from_fn(9, 5, |x, y| {
        let [x, y] = [x, y].map(|at| u8::try_from(at).unwrap());
        image::Rgba([x * 20, y * 40, x ^ y, if alpha { x * y } else { 255 }])
    })
}

pub(crate) fn encoded(format: ImageFormat) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    if format == ImageFormat::Jpeg {
        image::DynamicImage::ImageRgba8(texels(false)).into_rgb8().write_to(&mut bytes, format).unwrap();
    } else {
        texels(true).write_to(&mut bytes, format).unwrap();
    }
    bytes.into_inner()
}

/// A KTX2 picture of UASTC blocks of one colour each (mode 8).
pub(crate) fn uastc(width: u32, height: u32, blocks: &[[u8; 4]], zstandard: bool) -> Vec<u8> {
    let block = |color: &[u8; 4]| (0x17_u128 | u128::from(u32::from_le_bytes(*color)) << 5).to_le_bytes();
    let raw: Vec<u8> = blocks.iter().flat_map(block).collect();
    let length = u8::try_from(raw.len()).unwrap();
    // A frame of one block that is not compressed: descriptor, content size, block header.
    let frame = [&[0x28, 0xb5, 0x2f, 0xfd, 0x20, length][..], &(u32::from(length) << 3 | 1).to_le_bytes()[..3], &raw];
    let data = if zstandard { frame.concat() } else { raw.clone() };
    let word = |value: u32| value.to_le_bytes();
    let mut file = b"\xabKTX 20\xbb\r\n\x1a\n".to_vec();
    let scheme = if zstandard { 2 } else { 0 };
    file.extend([0, 1, width, height, 0, 0, 1, 1, scheme, 104, 44, 0, 0, 0, 0, 0, 0].into_iter().flat_map(word));
    file.extend([160, data.len() as u64, raw.len() as u64].into_iter().flat_map(u64::to_le_bytes));
    // The format's description: UASTC with sRGB transfer, blocks of 4 × 4, one sample of RGBA.
    let model = 166 | 1 << 8 | 2 << 16;
    file.extend(
        [44, 0, 2 | 40 << 16, model, 3 | 3 << 8, 16, 0, 127 << 16 | 3 << 24, 0, 0, u32::MAX].into_iter().flat_map(word),
    );
    file.resize(160, 0);
    file.extend(data);
    file
}

/// Side of [`draco`]'s grid, in vertices.
pub(crate) const GRID: u32 = 5;

/// A grid in x and y with normals along z and texture coordinates, compressed by Draco. Positions are multiples of 1/4,
/// which 11 bits hold exactly.
pub(crate) fn draco() -> Vec<u8> {
    let vertices = || (0..GRID * GRID).map(|at| [(at % GRID) as f32 / 4.0, (at / GRID) as f32 / 4.0]);
    let mut mesh = Mesh::new();
    let mut attribute = |kind, components: u8, values: Vec<f32>| {
        let mut attribute = PointAttribute::new();
        attribute.init(kind, components, DataType::Float32, false, (GRID * GRID) as usize);
        let bytes: Vec<u8> = values.into_iter().flat_map(f32::to_le_bytes).collect();
        attribute.buffer_mut().write(0, &bytes);
        mesh.add_attribute(attribute);
    };
    attribute(GeometryAttributeType::Position, 3, vertices().flat_map(|[x, y]| [x, y, 0.0]).collect());
    attribute(GeometryAttributeType::Normal, 3, vertices().flat_map(|_| [0.0, 0.0, 1.0]).collect());
    attribute(GeometryAttributeType::TexCoord, 2, vertices().flatten().collect());
    let cells = (0..GRID * GRID).filter(|at| at % GRID + 1 < GRID && at / GRID + 1 < GRID);
    let faces: Vec<[u32; 3]> =
        cells.flat_map(|at| [[at, at + 1, at + GRID], [at + 1, at + GRID + 1, at + GRID]]).collect();
    mesh.set_num_faces(faces.len());
    for (number, face) in (0..).zip(faces) {
        mesh.set_face(FaceIndex(number), face.map(PointIndex));
    }
    let mut encoder = MeshEncoder::new();
    encoder.set_mesh(mesh);
    let mut out = EncoderBuffer::new();
    encoder.encode(&EncoderOptions::new(), &mut out).unwrap();
    out.data().to_vec()
}

/// Data of meshopt's codecs, after what `fuzzing::meshopt` asks for.
pub(crate) fn meshopt() -> Vec<(&'static str, Vec<u8>)> {
    let bytes = |digits: &str| -> Vec<u8> {
        (0..digits.len()).step_by(2).map(|at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap()).collect()
    };
    let seed = |head: [u8; 4], digits| [&head[..], &bytes(digits)].concat();
    vec![
        ("attributes", seed([0, 6, 40, 0], ATTRIBUTES)),
        ("triangles", seed([5, 2, 81, 0], TRIANGLES)),
        ("indices", seed([6, 2, 11, 0], INDICES)),
    ]
}

/// Encoded by meshoptimizer: 40 vertices of 12 bytes, 81 corners, and 11 indices.
pub(crate) const ATTRIBUTES: &str = "\
     a1b368d9004a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a4a854a4a4a4a4a4a4a4a4a4a4a040010070001\
     05090d1115191d2125292d3135393d4145494d5155595d6165696d7175797d8185898d9195990110001f1a08f8f4c4f4c4f2\
     6218f81c3ce262f262e262f1311e7edddd000007030f030000010101010301010007191e7de79e03c9c803030313ff321321\
     32132fcac9c8e79e0000ca0303005beda77dabe55fa5ebbd67addb65afe5bb6da7dd6ba5ffa56bdda76dbbe5af65dbad67bd\
     eba55f0000000000000000000000e8030000803f00070000016202";
pub(crate) const TRIANGLES: &str = "\
     e1fe1e100e100e100ece1e160e150e140ece1e140e140e140efffeff0f0aefa2015500ff4ba20102007687566778a9866589\
     689801690000";
pub(crate) const INDICES: &str = "d10004040ca11f0506049dec10050600000000";
