//! Counts anew what the `tiles` codecs know before they have seen anything.
//!
//! ```text
//! cargo run --release -p gnomon-protocol --example train_tiles protocol/src/codec/tiles FRAME.body …
//! ```
//!
//! The frames are as `gnomon-client --save-masks` writes them, in any codec. The files, `prior.bin` and `codes.bin`, are
//! part of the protocol.

use std::{env, fs, path::PathBuf};

use gnomon_protocol::{
    codec::{Decoder, train_tiles},
    mask::{Mask, MaskShape},
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("give the folder to write into, and frames")?);
    let masks = arguments.map(|file| {
        let mut mask = Mask::new(MaskShape::new(1, 1, 1)?);
        Decoder::new().decode(&fs::read(file)?, &mut mask)?;
        Ok(mask)
    });
    let masks = masks.collect::<Result<Vec<_>, Box<dyn std::error::Error>>>()?;
    let [prior, codes] = train_tiles(&masks);
    fs::write(folder.join("prior.bin"), prior)?;
    fs::write(folder.join("codes.bin"), codes)?;
    println!("{} masks", masks.len());
    Ok(())
}
