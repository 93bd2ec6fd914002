//! Counts symbols over masks, and writes the prior probabilities and codes of the `tiles` codecs.
//!
//! ```text
//! cargo run --release -p gnomon-protocol --example train_tiles protocol/src/codec/tiles FRAME.body …
//! ```
//!
//! `gnomon-client --save-masks` writes such frames, in any codec. A frame is coded against the one before it if their
//! names differ only in the number. The output, `prior.bin`, `codes.bin` and `refine.bin`, is part of the protocol.

use std::{env, fs, path::PathBuf};

use gnomon_protocol::{
    codec::{Decoder, train_tiles},
    mask::{Mask, MaskShape},
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("give the output folder, then frames")?);
    let masks = arguments.map(|file| {
        let mut mask = Mask::new(MaskShape::new(1, 1, 1)?);
        Decoder::new().decode(&fs::read(&file)?, &mut mask)?;
        Ok((
            file.trim_end_matches(|letter: char| !letter.is_ascii_digit())
                .trim_end_matches(|letter: char| letter.is_ascii_digit())
                .to_owned(),
            mask,
        ))
    });
    let masks = masks.collect::<Result<Vec<_>, Box<dyn std::error::Error>>>()?;
    let before = |place: usize| masks[..place].last().filter(|(name, _)| *name == masks[place].0).map(|(_, mask)| mask);
    let [prior, codes, refine] = train_tiles(masks.iter().enumerate().map(|(place, (_, mask))| (mask, before(place))));
    for (name, bytes) in [("prior.bin", prior), ("codes.bin", codes), ("refine.bin", refine)] {
        fs::write(folder.join(name), bytes)?;
    }
    println!("{} masks", masks.len());
    Ok(())
}
