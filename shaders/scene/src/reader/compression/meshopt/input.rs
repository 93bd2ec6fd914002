//! What the codecs share: their version, and bytes that are read one after another.

/// Returns a codec's version.
/// Errors if the first byte is not the codec's, or the version is later than `newest`.
pub(super) fn version(data: &[u8], header: u8, newest: u8) -> Result<u8, &'static str> {
    match data.first().copied().unwrap_or_default() {
        byte if byte & 0xf0 != header => Err("it was encoded by another codec"),
        byte if byte & 0x0f > newest => Err("it has a later version than is known"),
        byte => Ok(byte & 0x0f),
    }
}

pub(super) fn unzigzag(value: u32) -> u32 {
    (value >> 1) ^ 0_u32.wrapping_sub(value & 1)
}

/// Bytes, and how far they have been read.
pub(super) struct Input<'a> {
    pub(super) data: &'a [u8],
    pub(super) at: usize,
}

impl<'a> Input<'a> {
    pub(super) fn left(&self) -> usize {
        self.data.len() - self.at
    }

    pub(super) fn take(&mut self, count: usize) -> Result<&'a [u8], &'static str> {
        let taken = self.data.get(self.at..).and_then(|left| left.get(..count)).ok_or("it is cut")?;
        self.at += count;
        Ok(taken)
    }

    pub(super) fn byte(&mut self) -> Result<u8, &'static str> {
        let byte = self.data.get(self.at).copied().ok_or("it is cut")?;
        self.at += 1;
        Ok(byte)
    }

    /// An integer of up to five bytes, seven bits each.
    pub(super) fn varint(&mut self) -> Result<u32, &'static str> {
        let mut value = 0;
        for shift in [0, 7, 14, 21, 28] {
            let byte = self.byte()?;
            value |= u32::from(byte & 127) << shift;
            if byte < 128 {
                break;
            }
        }
        Ok(value)
    }

    /// An index, as a difference from another.
    pub(super) fn index(&mut self, from: u32) -> Result<u32, &'static str> {
        Ok(from.wrapping_add(unzigzag(self.varint()?)))
    }
}
