//! Known servers: the last ones visited, newest first, and the certificate of every server that was trusted once.

use std::{
    fs::{self, File},
    io::{self, Write as _},
    path::{self, Path, PathBuf},
    time::{Duration, Instant},
};

use etcetera::BaseStrategy as _;
use gnomon_settings::files::read_small;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use url::form_urlencoded;

use crate::link::url::ServerUrl;

/// Servers that a window offers. What was trusted is kept beyond that.
const MAX_SERVERS: usize = 16;

/// Pins are never evicted: without its pin, another server could take its place. Beyond this, no new one is made.
const MAX_PINS: usize = 4096;

/// Room for [`MAX_PINS`] URLs with several certificates each.
const MAX_FILE_BYTES: u64 = 8 << 20;

/// How long another client may hold the list.
const LOCK_TIMEOUT: Duration = Duration::from_secs(5);

#[derive(Debug, Clone, Default)]
pub struct KnownServers {
    file: Option<PathBuf>,
    lists: Lists,
    /// Why the file cannot be used.
    damage: Option<String>,
}

#[derive(Debug, Clone, Default, PartialEq)]
struct Lists {
    /// Newest first.
    servers: Vec<ServerUrl>,
    /// One for each endpoint, oldest first.
    pins: Vec<ServerUrl>,
}

#[derive(Debug, Default, Serialize, Deserialize)]
struct Stored {
    /// URLs with certificates, newest first.
    servers: Vec<String>,
    /// URLs with certificates. Lists of earlier versions have none: their servers are the pins.
    #[serde(default)]
    pins: Vec<String>,
}

/// Why a server's certificate is not known, or cannot be kept.
#[derive(Debug, Error)]
pub enum PinError {
    #[error("no folder of this user is known: set HOME or XDG_STATE_HOME")]
    NoFolder,
    #[error("{}: {reason}: mend it, or delete it to trust every server anew", file.display())]
    Damaged { file: PathBuf, reason: String },
    #[error("{} has {MAX_PINS} servers: delete those that you do not visit any more", .0.display())]
    Full(PathBuf),
    #[error("cannot write {}: {source}", file.display())]
    Write { file: PathBuf, source: io::Error },
}

impl KnownServers {
    /// Loads the list from the platform's state directory.
    #[must_use]
    pub fn load() -> Self {
        let Ok(strategy) = etcetera::choose_base_strategy() else { return Self::default() };
        let folder = strategy.state_dir().unwrap_or_else(|| strategy.data_dir());
        Self::load_from(&folder.join("gnomon").join("servers.json"))
    }

    /// Loads the list from `file`. One that cannot be read offers no server, and trusts none.
    #[must_use]
    pub fn load_from(file: &Path) -> Self {
        let (lists, damage) = match read(file) {
            Ok(lists) => (lists, None),
            Err(reason) => (Lists::default(), Some(reason)),
        };
        Self { file: Some(file.to_owned()), lists, damage }
    }

    /// Returns the servers, newest first.
    #[must_use]
    pub fn servers(&self) -> &[ServerUrl] {
        &self.lists.servers
    }

    /// Returns the URL of this host, port and transport with the certificates that were trusted, if any were.
    ///
    /// # Errors
    /// Errors if the list cannot be read: then nobody knows whether this is the first visit.
    pub fn pinned(&self, url: &ServerUrl) -> Result<Option<&ServerUrl>, PinError> {
        match (&self.file, &self.damage) {
            (Some(file), Some(reason)) => Err(PinError::Damaged { file: file.clone(), reason: reason.clone() }),
            _ => Ok(self.lists.pins.iter().find(|known| same_endpoint(known, url))),
        }
    }

    /// Keeps the certificates of a server. They are on the disk when this returns.
    ///
    /// # Errors
    /// Errors if they cannot be kept.
    pub fn pin(&mut self, url: &ServerUrl) -> Result<(), PinError> {
        self.change(|lists, file| lists.pin(url, file))
    }

    /// Puts a server first, and keeps its certificates. A failure to save the list is only logged.
    pub fn remember(&mut self, url: &ServerUrl) {
        let saved = self.change(|lists, file| {
            lists.servers.retain(|known| !same_endpoint(known, url));
            lists.servers.insert(0, url.clone());
            lists.servers.truncate(MAX_SERVERS);
            if url.certificates.is_empty() { Ok(()) } else { lists.pin(url, file) }
        });
        if let Err(error) = saved {
            tracing::debug!(%error, "cannot save the list of servers");
        }
    }

    /// Changes the list on the disk. Other clients may have changed it meanwhile, and wait for this change.
    fn change(&mut self, change: impl FnOnce(&mut Lists, &Path) -> Result<(), PinError>) -> Result<(), PinError> {
        let file = self.file.as_deref().ok_or(PinError::NoFolder)?;
        let failed = |source| PinError::Write { file: file.to_owned(), source };
        if let Some(folder) = file.parent() {
            fs::create_dir_all(folder).map_err(failed)?;
        }
        let lock = File::create(file.with_extension("json.lock")).map_err(failed)?;
        wait_for(&lock).map_err(failed)?;
        let mut lists = read(file).map_err(|reason| PinError::Damaged { file: file.to_owned(), reason })?;
        change(&mut lists, file)?;
        save(&lists, file).map_err(failed)?;
        self.lists = lists;
        Ok(())
    }
}

impl Lists {
    fn pin(&mut self, url: &ServerUrl, file: &Path) -> Result<(), PinError> {
        match self.pins.iter().position(|known| same_endpoint(known, url)) {
            Some(place) => self.pins[place].clone_from(url),
            None if self.pins.len() >= MAX_PINS => return Err(PinError::Full(file.to_owned())),
            None => self.pins.push(url.clone()),
        }
        Ok(())
    }
}

/// Reads the lists. A missing file has none. A server that cannot be parsed is left out; a pin that cannot be parsed
/// might be the one that matters.
fn read(file: &Path) -> Result<Lists, String> {
    let bytes = match read_small(file, MAX_FILE_BYTES) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Lists::default()),
        Err(error) => return Err(error.to_string()),
    };
    let stored: Stored = serde_json::from_slice(&bytes).map_err(|error| error.to_string())?;
    let servers: Vec<ServerUrl> = stored.servers.iter().filter_map(|text| text.parse().ok()).collect();
    let pins: Result<Vec<ServerUrl>, _> = stored.pins.iter().map(|text| text.parse()).collect();
    let mut pins = pins.map_err(|error| error.to_string())?;
    for server in servers.iter().filter(|server| !server.certificates.is_empty()) {
        if !pins.iter().any(|known| same_endpoint(known, server)) {
            pins.push(server.clone());
        }
    }
    Ok(Lists { servers: servers.into_iter().take(MAX_SERVERS).collect(), pins })
}

/// Replaces the file by renaming: a crash leaves the old list or the new one.
fn save(lists: &Lists, file: &Path) -> io::Result<()> {
    let urls = |urls: &[ServerUrl]| urls.iter().map(to_url).collect();
    let stored = Stored { servers: urls(&lists.servers), pins: urls(&lists.pins) };
    let complete = file.with_extension("json.new");
    let mut new = File::create(&complete)?;
    new.write_all(&serde_json::to_vec_pretty(&stored)?)?;
    new.sync_all()?;
    fs::rename(&complete, file)
}

fn wait_for(lock: &File) -> io::Result<()> {
    let deadline = Instant::now() + LOCK_TIMEOUT;
    loop {
        match lock.try_lock() {
            Ok(()) => return Ok(()),
            Err(fs::TryLockError::WouldBlock) if Instant::now() < deadline => {
                std::thread::sleep(Duration::from_millis(10));
            }
            Err(error) => return Err(error.into()),
        }
    }
}

fn same_endpoint(one: &ServerUrl, other: &ServerUrl) -> bool {
    one.host.eq_ignore_ascii_case(&other.host) && (one.port, one.transport) == (other.port, other.transport)
}

/// Returns the URL with its certificates or the absolute path of its authorities, if that path is valid UTF-8.
pub(crate) fn to_url(url: &ServerUrl) -> String {
    let mut query = form_urlencoded::Serializer::new(String::new());
    for digest in &url.certificates {
        query.append_pair("cert", &hex(digest));
    }
    if let Some(ca) = url.ca.as_deref().and_then(|ca| path::absolute(ca).ok()?.into_os_string().into_string().ok()) {
        query.append_pair("ca", &ca);
    }
    let query = query.finish();
    if query.is_empty() { url.to_string() } else { format!("{url}/?{query}") }
}

/// Returns a SHA-256 as URLs have it.
#[must_use]
pub fn hex(digest: &[u8; 32]) -> String {
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
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
        assert_eq!(reloaded.lists, known.lists);
        assert_eq!(reloaded.servers().len(), MAX_SERVERS);
        assert_eq!(reloaded.servers()[..2], [server(20, 'b'), server(29, 'a')]);
        assert!(!reloaded.servers()[1..].contains(&server(20, 'a')));
        assert_eq!(pins(&reloaded, 20), [[0xbb; 32]]);
        assert_eq!(pins(&reloaded, 443), [[0; 32]; 0]);
    }

    fn pins(known: &KnownServers, port: u16) -> Vec<[u8; 32]> {
        let first_use = format!("gnomon://Edge.example:{port}/?cert=first-use").parse().unwrap();
        known.pinned(&first_use).unwrap().map(|url| url.certificates.clone()).unwrap_or_default()
    }

    #[test]
    fn a_pin_is_kept_whatever_is_visited_later() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("servers.json");
        let mut known = KnownServers::load_from(&file);
        known.pin(&server(1, 'a')).unwrap();
        (2..60).for_each(|port| known.remember(&server(port, 'b')));
        let reloaded = KnownServers::load_from(&file);
        assert!(!reloaded.servers().contains(&server(1, 'a')));
        assert_eq!((pins(&reloaded, 1), pins(&reloaded, 2)), (vec![[0xaa; 32]], vec![[0xbb; 32]]));
        // Both certificates of a server that announced a spare.
        let spare = format!("gnomon://edge.example:1/?cert={}&cert={}", "a".repeat(64), "c".repeat(64));
        known.remember(&spare.parse().unwrap());
        assert_eq!(pins(&KnownServers::load_from(&file), 1), [[0xaa; 32], [0xcc; 32]]);
    }

    #[test]
    fn two_clients_keep_each_others_pins() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("servers.json");
        std::thread::scope(|scope| {
            for first in [100, 200, 300] {
                let file = &file;
                scope.spawn(move || {
                    // Loaded before the others have written.
                    let mut known = KnownServers::load_from(file);
                    (first..first + 20).for_each(|port| known.pin(&server(port, 'a')).unwrap());
                });
            }
        });
        assert_eq!(KnownServers::load_from(&file).lists.pins.len(), 60);
    }

    #[test]
    fn the_list_of_pins_is_bounded() {
        let mut lists = Lists::default();
        let one = server(1, 'a');
        lists.pins = (0..MAX_PINS).map(|place| ServerUrl { host: format!("h{place}"), ..one.clone() }).collect();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("servers.json");
        save(&lists, &file).unwrap();
        let mut known = KnownServers::load_from(&file);
        assert_eq!(known.lists.pins.len(), MAX_PINS);
        assert!(matches!(known.pin(&one), Err(PinError::Full(_))));
        let again = ServerUrl { host: "h7".to_owned(), ..server(1, 'b') };
        known.pin(&again).unwrap();
        assert_eq!(KnownServers::load_from(&file).pinned(&again).unwrap(), Some(&again));
    }

    #[test]
    fn a_list_of_an_earlier_version_has_pins() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("servers.json");
        fs::write(&file, format!("{{\"servers\": [\"{}\"]}}", to_url(&server(7, 'a')))).unwrap();
        assert_eq!(pins(&KnownServers::load_from(&file), 7), [[0xaa; 32]]);
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
    fn an_invalid_file_offers_no_server_and_trusts_none() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("servers.json");
        for text in ["", "[1, 2]", "{\"servers\": [\"http://x:1\", \"gnomon://a:1\"]}"] {
            fs::write(&file, text).unwrap();
            assert!(KnownServers::load_from(&file).servers().is_empty(), "{text}");
        }
        let long = "[".repeat(usize::try_from(MAX_FILE_BYTES).unwrap() + 1);
        for text in ["", "[1, 2]", "{\"servers\": [], \"pins\": [\"gnomon://a:1\"]}", &long] {
            fs::write(&file, text).unwrap();
            let mut known = KnownServers::load_from(&file);
            for error in [known.pinned(&server(1, 'a')).unwrap_err(), known.pin(&server(1, 'a')).unwrap_err()] {
                assert!(matches!(error, PinError::Damaged { .. }), "{error}");
            }
            known.remember(&server(1, 'a'));
            assert!(fs::read_to_string(&file).unwrap() == text, "a damaged list is not overwritten");
        }
        assert!(matches!(KnownServers::default().pin(&server(1, 'a')), Err(PinError::NoFolder)));
    }

    #[test]
    fn a_fingerprint_is_short() {
        assert_eq!(fingerprint(&[0xab; 32]), "abab abab abab abab");
    }
}
