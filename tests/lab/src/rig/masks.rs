//! Masks saved by a client's `--save-masks`: one frame body per file, named by frame number.

use std::{collections::BTreeMap, fs, path::Path};

use anyhow::{Context, Result, bail};
use gnomon_protocol::{
    codec::Decoder,
    mask::{Mask, MaskShape},
};

/// Reads every `frame_NUMBER.body` in a folder; any other file is an error.
pub fn read(folder: &Path) -> Result<BTreeMap<u32, Mask>> {
    let mut masks = BTreeMap::new();
    for entry in fs::read_dir(folder).with_context(|| format!("listing {}", folder.display()))? {
        let path = entry?.path();
        let number = path
            .file_name()
            .and_then(|name| name.to_str()?.strip_prefix("frame_")?.strip_suffix(".body")?.parse::<u32>().ok());
        let Some(number) = number else { bail!("{} is no saved mask", path.display()) };
        let body = fs::read(&path).with_context(|| format!("reading {}", path.display()))?;
        let mut mask = Mask::new(MaskShape::new(1, 1, 1)?);
        Decoder::new().decode(&body, &mut mask).with_context(|| format!("decoding {}", path.display()))?;
        masks.insert(number, mask);
    }
    Ok(masks)
}

#[cfg(test)]
mod tests {
    use gnomon_protocol::codec::{CodecId, EncodedFrame, Encoder};

    use super::*;

    #[test]
    fn saved_bodies_are_found_by_number_and_anything_else_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let mut mask = Mask::new(MaskShape::new(20, 9, 3).unwrap());
        mask.set(2, 19, 8, true);
        let mut body = EncodedFrame::default();
        Encoder::new(CodecId::PlanesLz4).encode(&mask, &mut body).unwrap();
        fs::write(folder.path().join("frame_000012.body"), body.body()).unwrap();
        assert_eq!(read(folder.path()).unwrap(), BTreeMap::from([(12, mask)]));
        fs::write(folder.path().join("frame_000013.body"), &body[1..]).unwrap();
        assert!(read(folder.path()).unwrap_err().to_string().contains("frame_000013.body"));
        fs::rename(folder.path().join("frame_000013.body"), folder.path().join("frame_13.png")).unwrap();
        assert!(read(folder.path()).unwrap_err().to_string().contains("no saved mask"));
    }
}
