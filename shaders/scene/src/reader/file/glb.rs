//! Splits a `.glb` into its chunks (glTF 2.0, §4.4). Chunks may have any length: not all exporters pad the last one.

use crate::limits::MAX_JSON_BYTES;

const MAGIC: &[u8; 4] = b"glTF";
const CHUNK_JSON: u32 = u32::from_le_bytes(*b"JSON");
const CHUNK_BIN: u32 = u32::from_le_bytes(*b"BIN\0");

/// A scene file's parts. Only a `.glb` has a binary chunk.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Container<'a> {
    pub(crate) json: &'a [u8],
    pub(crate) bin: Option<&'a [u8]>,
}

/// Splits a scene file into its chunks. A file that does not start with `glTF` is JSON.
/// Errors with a sentence if the container is malformed.
pub(crate) fn split(bytes: &[u8]) -> Result<Container<'_>, String> {
    let container = if bytes.starts_with(MAGIC) { split_glb(bytes)? } else { Container { json: bytes, bin: None } };
    if container.json.len() as u64 > MAX_JSON_BYTES {
        return Err(format!("its JSON has {} bytes, at most {MAX_JSON_BYTES} are read", container.json.len()));
    }
    Ok(container)
}

fn split_glb(bytes: &[u8]) -> Result<Container<'_>, String> {
    let version = u32_at(bytes, 4).ok_or("the GLB header is cut short")?;
    let length = u32_at(bytes, 8).ok_or("the GLB header is cut short")? as usize;
    if version != 2 {
        return Err(format!("its GLB version is {version}, not 2"));
    }
    // Bytes after the end are ignored, as Khronos' validator does.
    let bytes = bytes
        .get(..length)
        .ok_or_else(|| format!("its GLB header says {length} bytes, but the file has {}", bytes.len()))?;
    let mut container = Container { json: &[], bin: None };
    let mut at = 12;
    for chunk in 0_usize.. {
        if at == bytes.len() {
            break;
        }
        let cut = || format!("GLB chunk {chunk} at byte {at} is cut short");
        let chunk_bytes = u32_at(bytes, at).ok_or_else(cut)? as usize;
        let kind = u32_at(bytes, at + 4).ok_or_else(cut)?;
        let start = at + 8;
        let data = start.checked_add(chunk_bytes).and_then(|end| bytes.get(start..end)).ok_or_else(|| {
            format!("GLB chunk {chunk} at byte {at} says {chunk_bytes} bytes, but {} are left", bytes.len() - start)
        })?;
        match (chunk, kind) {
            (0, CHUNK_JSON) => container.json = data,
            (0, _) => return Err(format!("its first GLB chunk has type {kind:#010x}, not JSON")),
            (1, CHUNK_BIN) => container.bin = Some(data),
            (_, CHUNK_JSON | CHUNK_BIN) => {
                return Err(format!("GLB chunk {chunk} of type {kind:#010x} is in the wrong place"));
            }
            // Unknown chunks are ignored (§4.4.3.1).
            _ => {}
        }
        at = start + chunk_bytes;
    }
    if container.json.is_empty() { Err("it has no JSON chunk".to_owned()) } else { Ok(container) }
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    let quad = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(quad.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn glb(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
        let mut body = Vec::new();
        for (kind, data) in chunks {
            body.extend(u32::try_from(data.len()).unwrap().to_le_bytes());
            body.extend(*kind);
            body.extend(*data);
        }
        let mut bytes = b"glTF\x02\0\0\0".to_vec();
        bytes.extend(u32::try_from(body.len() + 12).unwrap().to_le_bytes());
        bytes.extend(body);
        bytes
    }

    #[test]
    fn chunks_are_found_and_unknown_ones_skipped() {
        let mut trailing = glb(&[(b"JSON", b"{}")]);
        trailing.extend(b"more");
        assert_eq!(split(&trailing), Ok(Container { json: b"{}", bin: None }));
        let bytes = glb(&[(b"JSON", b"{}  "), (b"BIN\0", b"1234"), (b"WHAT", b"")]);
        assert_eq!(split(&bytes), Ok(Container { json: b"{}  ", bin: Some(b"1234") }));
        assert_eq!(split(b"{}"), Ok(Container { json: b"{}", bin: None }));
    }

    #[test]
    fn broken_containers_say_what_is_wrong() {
        let good = glb(&[(b"JSON", b"{}  "), (b"BIN\0", b"1234")]);
        for cut in 4..good.len() {
            assert!(split(&good[..cut]).is_err(), "cut at {cut}");
        }
        let fault = |bytes: &[u8]| split(bytes).unwrap_err();
        assert!(fault(&glb(&[(b"BIN\0", b"1234")])).contains("not JSON"));
        assert!(fault(&glb(&[(b"JSON", b"{}  "), (b"JSON", b"{}  ")])).contains("wrong place"));
        assert!(fault(&glb(&[])).contains("no JSON"));
        let mut version = good;
        version[4] = 1;
        assert!(fault(&version).contains("version is 1"));
    }
}
