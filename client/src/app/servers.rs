//! Known servers: the last ones visited, newest first, with the certificates of the first visits.

use std::{
    fs,
    io::Read as _,
    path::{self, Path, PathBuf},
};

use etcetera::BaseStrategy as _;
use serde::{Deserialize, Serialize};
use url::form_urlencoded;

use crate::link::url::ServerUrl;

const MAX_SERVERS: usize = 16;

const MAX_FILE_BYTES: u64 = 64 << 10;

#[derive(Debug, Clone, Default, PartialEq)]
pub struct KnownServers {
    file: Option<PathBuf>,
    servers: Vec<ServerUrl>,
}

#[derive(Debug, Default, Serialize, Deserialize)]
struct Stored {
    /// URLs with certificates, newest first.
    servers: Vec<String>,
}

impl KnownServers {
    /// Loads the list from the platform's state directory. A list that cannot be read counts as empty.
    #[must_use]
    pub fn load() -> Self {
        let Ok(strategy) = etcetera::choose_base_strategy() else { return Self::default() };
        let folder = strategy.state_dir().unwrap_or_else(|| strategy.data_dir());
        Self::load_from(&folder.join("gnomon").join("servers.json"))
    }

    /// Loads the list from `file`. A list that cannot be read counts as empty.
    #[must_use]
    pub fn load_from(file: &Path) -> Self {
        let read = || {
            let mut text = String::new();
            fs::File::open(file).ok()?.take(MAX_FILE_BYTES).read_to_string(&mut text).ok()?;
            serde_json::from_str::<Stored>(&text).ok()
        };
        let stored = read().unwrap_or_default();
        let servers = stored.servers.iter().filter_map(|text| text.parse().ok()).take(MAX_SERVERS).collect();
        Self { file: Some(file.to_owned()), servers }
    }

    /// Returns the servers, newest first.
    #[must_use]
    pub fn servers(&self) -> &[ServerUrl] {
        &self.servers
    }

    /// Returns the SHA-256 of the certificate pinned for this host, port and transport.
    #[must_use]
    pub fn certificate_of(&self, url: &ServerUrl) -> Option<[u8; 32]> {
        self.servers.iter().find(|known| same_endpoint(known, url)).and_then(|known| known.certificate)
    }

    /// Puts a server first. A failure to save the list is only logged.
    pub fn remember(&mut self, url: &ServerUrl) {
        self.servers.retain(|known| !same_endpoint(known, url));
        self.servers.insert(0, url.clone());
        self.servers.truncate(MAX_SERVERS);
        if let Some(file) = &self.file
            && let Err(error) = self.save(file)
        {
            tracing::debug!(%error, file = %file.display(), "cannot save the list of servers");
        }
    }

    /// Replaces the file by renaming: a crash leaves the old list or the new one.
    fn save(&self, file: &Path) -> std::io::Result<()> {
        if let Some(folder) = file.parent() {
            fs::create_dir_all(folder)?;
        }
        let stored = Stored { servers: self.servers.iter().map(to_url).collect() };
        let complete = file.with_extension("json.new");
        fs::write(&complete, serde_json::to_vec_pretty(&stored)?)?;
        fs::rename(&complete, file)
    }
}

fn same_endpoint(one: &ServerUrl, other: &ServerUrl) -> bool {
    (&one.host, one.port, one.transport) == (&other.host, other.port, other.transport)
}

/// Returns the URL with its certificate or the absolute path of its authorities, if that path is valid UTF-8.
fn to_url(url: &ServerUrl) -> String {
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

/// Returns the first 8 bytes of a certificate's SHA-256, for people to compare.
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
    fn the_newest_server_is_first_and_none_is_listed_twice() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("state/servers.json");
        let mut known = KnownServers::load_from(&file);
        assert!(known.servers().is_empty());
        (1..30).for_each(|port| known.remember(&server(port, 'a')));
        known.remember(&server(20, 'b'));
        let reloaded = KnownServers::load_from(&file);
        assert_eq!(reloaded, known);
        assert_eq!(reloaded.servers().len(), MAX_SERVERS);
        assert_eq!(reloaded.servers()[..2], [server(20, 'b'), server(29, 'a')]);
        assert!(!reloaded.servers()[1..].contains(&server(20, 'a')));
        let first_use = |port: u16| format!("gnomon://edge.example:{port}/?cert=first-use").parse().unwrap();
        assert_eq!(reloaded.certificate_of(&first_use(20)), Some([0xbb; 32]));
        assert_eq!(reloaded.certificate_of(&first_use(443)), None);
    }

    #[test]
    fn the_path_of_the_authority_is_kept() {
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
    fn an_invalid_file_counts_as_empty() {
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
