//! Properties of the parsers of URLs, from people and from peers. Each function panics if its property fails. Only the
//! fuzz targets (`tests/fuzz`) and the test below call them.

use gnomon_protocol::text::PeerText;

use crate::{
    app::servers::to_url,
    link::{
        alternative::alternative,
        url::{ServerUrl, Transport},
    },
};

/// Accepts any URL, or refuses it in one line. What a peer may name is pinned, names no file, and is what a person
/// could have written.
pub fn url(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let of_person = text.parse::<ServerUrl>();
    match &of_person {
        Ok(url) if url.ca.is_none() && !url.is_first_use() => assert_eq!(to_url(url).parse().as_ref(), Ok(url)),
        Ok(_) => {}
        Err(error) => assert!(!error.to_string().contains(char::is_control), "{error}"),
    }
    let of_peer = PeerText::from(text.as_ref());
    for transport in [Transport::Quic, Transport::LabUdp, Transport::LabTcp] {
        if let Ok(url) = alternative(&of_peer, transport) {
            assert!(url.ca.is_none() && !url.is_first_use() && url.transport == transport, "{url:?}");
            assert_eq!(of_person.as_ref(), Ok(&url));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tries valid URLs and damaged ones. `GNOMON_FUZZ_SEEDS=FOLDER` writes the valid ones there, as seeds.
    #[test]
    fn urls() {
        let cert = "00ff".repeat(16);
        let seeds = [
            format!("gnomon://edge.example:4433/?cert={cert}"),
            format!("gnomon://[2001:db8::7]:1?cert={cert}&cert={cert}"),
            "gnomon://[fe80::1%25eth0]:5/?cert=first-use".to_owned(),
            "gnomon://10.0.0.1:4433/?ca=%2Fetc%2Fca.pem".to_owned(),
            "gnomon+lab-udp://127.0.0.1:7/".to_owned(),
        ];
        for (index, seed) in seeds.iter().enumerate() {
            if let Some(folder) = std::env::var_os("GNOMON_FUZZ_SEEDS") {
                let folder = std::path::Path::new(&folder).join("url");
                std::fs::create_dir_all(&folder).unwrap();
                std::fs::write(folder.join(index.to_string()), seed).unwrap();
            }
            url(seed.as_bytes());
            let mut state = 7_u32;
            let mut below = |most: usize| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as usize % most.max(1)
            };
            for _ in 0..10_000 {
                let mut bytes = seed.clone().into_bytes();
                for _ in 0..=below(3) {
                    let place = below(bytes.len());
                    match below(4) {
                        0 => bytes.truncate(place + 1),
                        1 => bytes.insert(place, below(256).to_le_bytes()[0]),
                        2 => bytes.insert(place, b"[]%:/?&=.@"[below(10)]),
                        _ => bytes[place] ^= 1 << below(8),
                    }
                }
                url(&bytes);
            }
        }
    }
}
