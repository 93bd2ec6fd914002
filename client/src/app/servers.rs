//! The servers that this client has been to, the last one first, each with the certificate that it had the first time.

use std::{
    fs,
    io::Read as _,
    path::{self, Path, PathBuf},
};

use etcetera::BaseStrategy as _;
use serde::{Deserialize, Serialize};
use url::form_urlencoded;

use crate::link::url::ServerUrl;

/// Servers that are remembered.
const MOST: usize = 16;

/// Largest file that is read, in bytes.
const MAX_FILE_BYTES: u64 = 64 << 10;

/// The list, and its file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct KnownServers {
    file: Option<PathBuf>,
    servers: Vec<ServerUrl>,
}

#[derive(Debug, Default, Serialize, Deserialize)]
struct Stored {
    /// URLs with certificates, the last one first.
    servers: Vec<String>,
}

impl KnownServers {
    /// Those in the platform's place for state. A list that cannot be read is none.
    #[must_use]
    pub fn load() -> Self {
        let Ok(strategy) = etcetera::choose_base_strategy() else { return Self::default() };
        let folder = strategy.state_dir().unwrap_or_else(|| strategy.data_dir());
        Self::load_from(&folder.join("gnomon").join("servers.json"))
    }

    /// Those in a file.
    #[must_use]
    pub fn load_from(file: &Path) -> Self {
        let read = || {
            let mut text = String::new();
            fs::File::open(file).ok()?.take(MAX_FILE_BYTES).read_to_string(&mut text).ok()?;
            serde_json::from_str::<Stored>(&text).ok()
        };
        let stored = read().unwrap_or_default();
        let servers = stored.servers.iter().filter_map(|text| text.parse().ok()).take(MOST).collect();
        Self { file: Some(file.to_owned()), servers }
    }

    /// The servers, the last one first.
    #[must_use]
    pub fn servers(&self) -> &[ServerUrl] {
        &self.servers
    }

    /// The certificate that the server at this place had the first time.
    #[must_use]
    pub fn certificate_of(&self, url: &ServerUrl) -> Option<[u8; 32]> {
        self.servers.iter().find(|known| same_place(known, url)).and_then(|known| known.certificate)
    }

    /// Puts a server that this client has just been to first. It is no error when that cannot be kept.
    pub fn remember(&mut self, url: &ServerUrl) {
        self.servers.retain(|known| !same_place(known, url));
        self.servers.insert(0, url.clone());
        self.servers.truncate(MOST);
        if let Some(file) = &self.file
            && let Err(error) = self.save(file)
        {
            tracing::debug!(%error, file = %file.display(), "servers are not remembered");
        }
    }

    /// A file that breaks off would be no list, so the new one takes the old one's place when it is whole.
    fn save(&self, file: &Path) -> std::io::Result<()> {
        if let Some(folder) = file.parent() {
            fs::create_dir_all(folder)?;
        }
        let stored = Stored { servers: self.servers.iter().map(full).collect() };
        let whole = file.with_extension("json.new");
        fs::write(&whole, serde_json::to_vec_pretty(&stored)?)?;
        fs::rename(&whole, file)
    }
}

fn same_place(one: &ServerUrl, other: &ServerUrl) -> bool {
    (&one.host, one.port, one.transport) == (&other.host, other.port, other.transport)
}

/// The URL with whatever the server is known by, wherever this client is started from the next time. A path that is no text
/// cannot stand in a URL.
fn full(url: &ServerUrl) -> String {
    let mut query = form_urlencoded::Serializer::new(String::new());
    if let Some(digest) = url.certificate {
        query.append_pair("cert", &digest.iter().map(|byte| format!("{byte:02x}")).collect::<String>());
    }
    if let Some(ca) = url.ca.as_deref().and_then(|ca| path::absolute(ca).ok()?.into_os_string().into_string().ok()) {
        query.append_pair("ca", &ca);
    }
    let query = query.finish();
    if query.is_empty() { url.to_string() } else { format!("{url}/?{query}") }
}

/// The first bytes of a certificate's SHA-256, as people compare them.
#[must_use]
pub fn fingerprint(digest: &[u8; 32]) -> String {
    digest[..8].chunks(2).map(|pair| format!("{:02x}{:02x}", pair[0], pair[1])).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn server(port: u16, digit: char) -> ServerUrl {
        format!("gnomon://edge.example:{port}/?cert={}", String::from(digit).repeat(64)).parse().unwrap()
    }

    #[test]
    fn the_last_server_comes_first_and_each_comes_once() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("state/servers.json");
        let mut known = KnownServers::load_from(&file);
        assert!(known.servers().is_empty());
        (1..30).for_each(|port| known.remember(&server(port, 'a')));
        known.remember(&server(20, 'b'));
        let again = KnownServers::load_from(&file);
        assert_eq!(again, known);
        assert_eq!(again.servers().len(), MOST);
        assert_eq!(again.servers()[..2], [server(20, 'b'), server(29, 'a')]);
        assert!(!again.servers()[1..].contains(&server(20, 'a')));
        let first_use = |port: u16| format!("gnomon://edge.example:{port}/?cert=first-use").parse().unwrap();
        assert_eq!(again.certificate_of(&first_use(20)), Some([0xbb; 32]));
        assert_eq!(again.certificate_of(&first_use(443)), None);
    }

    #[test]
    fn a_server_with_an_authority_keeps_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("servers.json");
        let remembered = |text: &str| {
            KnownServers::load_from(&file).remember(&text.parse().unwrap());
            KnownServers::load_from(&file).servers()[0].clone()
        };
        let url = "gnomon://edge.example:1/?ca=%2Fetc%2Four+own%2Fca%26b.pem";
        assert_eq!(remembered(url), url.parse().unwrap());
        let ca = remembered("gnomon://edge.example:2/?ca=ca.pem").ca.unwrap();
        assert!(ca.is_absolute() && ca.ends_with("ca.pem"), "{}", ca.display());
        let lab = "gnomon+lab-tcp://localhost:8/";
        assert_eq!(remembered(lab), lab.parse().unwrap());
    }

    #[test]
    fn a_file_of_something_else_is_an_empty_list() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("servers.json");
        for text in ["", "[1, 2]", "{\"servers\": [\"http://x:1\", \"gnomon://a:1\"]}"] {
            fs::write(&file, text).unwrap();
            assert!(KnownServers::load_from(&file).servers().is_empty(), "{text}");
        }
    }

    #[test]
    fn a_fingerprint_is_short() {
        assert_eq!(fingerprint(&[0xab; 32]), "abab abab abab abab");
    }
}
