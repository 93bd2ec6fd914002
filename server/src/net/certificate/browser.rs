//! The browsers' certificates: the current one and the next.
//!
//! The next one is made when the current one starts, so a page that knows both hashes can connect for 6.5 days,
//! whenever the server renews. Both stay in a file: a restart keeps them, and `--check-config` can tell their hashes.

use std::{
    fs::File,
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use parking_lot::Mutex;
use rcgen::date_time_ymd;
use rustls::{crypto::CryptoProvider, sign::CertifiedKey};
use serde::{Deserialize, Serialize};

use super::{error::CertificateError, pem};
use crate::{files, limits};

/// Beside the permanent certificate. Its reader can impersonate the server to browsers for two weeks.
pub(super) const FILE: &str = "browser-certificates.json";

/// Browsers refuse pinned certificates that are valid for more than 14 days.
const LIFE: Duration = Duration::from_secs(13 * 24 * 3600);

/// Tolerates browsers whose clocks are slow.
const BACKDATE: Duration = Duration::from_secs(3600);

/// SHA-256 of both certificates, in hexadecimal.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct BrowserHashes {
    pub(crate) current: String,
    pub(crate) next: String,
}

#[derive(Debug)]
pub(super) struct BrowserCertificates {
    pair: Mutex<Pair>,
    file: PathBuf,
    provider: Arc<CryptoProvider>,
}

#[derive(Debug, Clone)]
struct Pair {
    current: Certificate,
    next: Certificate,
}

#[derive(Debug, Clone)]
struct Certificate {
    key: Arc<CertifiedKey>,
    sha256: String,
    kept: Kept,
}

/// A certificate in the file.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Kept {
    /// When it becomes the current one, in seconds since 1970. It is valid a little earlier.
    starts_at_s: u64,
    /// Certificate and key.
    pem: String,
}

impl BrowserCertificates {
    /// Takes the certificates from the folder's file, or makes new ones. They stay in memory if the folder cannot be
    /// written. Errors if the system's clock is before 1970.
    pub(super) fn open(
        folder: &Path,
        now: SystemTime,
        provider: Arc<CryptoProvider>,
    ) -> Result<Self, CertificateError> {
        let file = folder.join(FILE);
        let pair = Pair::renewed(&file, None, now, &provider)?;
        Ok(Self { pair: Mutex::new(pair), file, provider })
    }

    /// The certificate for a handshake now. Renews both certificates when it is time.
    pub(super) fn key(&self, now: SystemTime) -> Arc<CertifiedKey> {
        self.at(now, |pair| Arc::clone(&pair.current.key))
    }

    pub(super) fn hashes(&self, now: SystemTime) -> BrowserHashes {
        self.at(now, Pair::hashes)
    }

    fn at<T>(&self, now: SystemTime, take: impl FnOnce(&Pair) -> T) -> T {
        let mut pair = self.pair.lock();
        if !pair.current.serves(now) {
            match Pair::renewed(&self.file, Some(&pair), now, &self.provider) {
                Ok(renewed) => {
                    *pair = renewed;
                    let BrowserHashes { current, next } = pair.hashes();
                    tracing::info!(sha256 = current, next_sha256 = next, "browser certificate renewed");
                }
                // The old one stays valid for days, and the next handshake retries.
                Err(error) => tracing::error!(%error, "cannot renew the browsers' certificate"),
            }
        }
        take(&pair)
    }
}

/// The hashes in a folder's file, if its certificates are in use now. Changes nothing.
pub(super) fn kept_hashes(folder: &Path, now: SystemTime, provider: &CryptoProvider) -> Option<BrowserHashes> {
    Pair::read(&folder.join(FILE), provider).filter(|pair| pair.current.serves(now)).map(|pair| pair.hashes())
}

impl Pair {
    /// Another server with the same folder may have renewed already, so that the file goes first.
    fn renewed(
        file: &Path,
        own: Option<&Self>,
        now: SystemTime,
        provider: &CryptoProvider,
    ) -> Result<Self, CertificateError> {
        // Without the lock, as on a file system that has none, two servers may each show certificates of their own.
        let lock = lock(file);
        let kept = Self::read(file, provider);
        if let Some(kept) = kept.as_ref().filter(|kept| kept.current.serves(now)) {
            return Ok(kept.clone());
        }
        let announced = kept.iter().chain(own).find(|pair| pair.next.serves(now)).map(|pair| pair.next.clone());
        let current = match announced {
            Some(announced) => announced,
            None => Certificate::make(now, provider)?,
        };
        let next = Certificate::make(current.ends_at(), provider)?;
        let pair = Self { current, next };
        let text = serde_json::to_vec(&[&pair.current.kept, &pair.next.kept]);
        let kept = text.map_err(std::io::Error::from).and_then(|text| files::replace_private(file, &text));
        if let Err(reason) = kept {
            tracing::info!(file = %file.display(), %reason, "browser certificates not kept: a restart makes new ones");
        }
        drop(lock);
        Ok(pair)
    }

    /// `None` if there is no file, or a damaged one: pages ask for the new hashes then.
    fn read(file: &Path, provider: &CryptoProvider) -> Option<Self> {
        let text = files::read_small(file, limits::MAX_SMALL_FILE_BYTES).ok()?;
        let [current, next] = serde_json::from_slice::<[Kept; 2]>(&text).ok()?;
        Some(Self { current: Certificate::of(current, provider).ok()?, next: Certificate::of(next, provider).ok()? })
    }

    fn hashes(&self) -> BrowserHashes {
        BrowserHashes { current: self.current.sha256.clone(), next: self.next.sha256.clone() }
    }
}

impl Certificate {
    fn make(starts_at: SystemTime, provider: &CryptoProvider) -> Result<Self, CertificateError> {
        let starts_at = starts_at.duration_since(UNIX_EPOCH).ok().filter(|since_epoch| *since_epoch > BACKDATE);
        let starts_at = starts_at.ok_or_else(|| CertificateError::Make("the system's clock is at 1970".to_owned()))?;
        let pem = pem::make(|params| {
            params.not_before = date_time_ymd(1970, 1, 1) + (starts_at - BACKDATE);
            params.not_after = params.not_before + LIFE;
        })?;
        Self::of(Kept { starts_at_s: starts_at.as_secs(), pem }, provider).map_err(CertificateError::Make)
    }

    fn of(kept: Kept, provider: &CryptoProvider) -> Result<Self, String> {
        let key = pem::certified(kept.pem.as_bytes(), kept.pem.as_bytes(), provider)?;
        Ok(Self { sha256: pem::leaf_sha256(&key), key: Arc::new(key), kept })
    }

    /// From the start of its validity, so that a clock that is set back a little changes nothing, until its half.
    fn serves(&self, now: SystemTime) -> bool {
        (self.starts_at() - BACKDATE..self.ends_at()).contains(&now)
    }

    fn starts_at(&self) -> SystemTime {
        UNIX_EPOCH + Duration::from_secs(self.kept.starts_at_s)
    }

    fn ends_at(&self) -> SystemTime {
        self.starts_at() + LIFE / 2
    }
}

/// Excludes other servers until it is dropped. Does not wait long, since a stopped server may hold it.
fn lock(file: &Path) -> Option<File> {
    let lock = File::options().create(true).truncate(false).write(true).open(file.with_extension("lock")).ok()?;
    for _ in 0..20 {
        match lock.try_lock() {
            Ok(()) => return Some(lock),
            Err(std::fs::TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(5)),
            Err(std::fs::TryLockError::Error(_)) => return None,
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY: Duration = Duration::from_secs(24 * 3600);

    fn provider() -> Arc<CryptoProvider> {
        Arc::new(rustls::crypto::ring::default_provider())
    }

    fn open(folder: &Path, now: SystemTime) -> BrowserCertificates {
        BrowserCertificates::open(folder, now, provider()).unwrap()
    }

    #[test]
    fn the_next_certificate_is_known_before_it_is_used() {
        let folder = tempfile::tempdir().unwrap();
        let start = SystemTime::now();
        let certificates = open(folder.path(), start);
        let mut known = certificates.hashes(start);
        let mut renewals = 0;
        for hour in 1..30 * 24 {
            let now = start + Duration::from_secs(hour * 3600);
            let hashes = certificates.hashes(now);
            assert_ne!(hashes.current, hashes.next);
            if hashes != known {
                assert_eq!(hashes.current, known.next, "hour {hour}");
                known = hashes;
                renewals += 1;
            }
        }
        assert_eq!(renewals, 4, "after 6.5, 13, 19.5 and 26 days");
        assert!(LIFE <= 14 * DAY, "browsers refuse longer lives");
    }

    #[test]
    fn only_small_steps_of_the_clock_are_tolerated() {
        let folder = tempfile::tempdir().unwrap();
        let start = SystemTime::now();
        let certificates = open(folder.path(), start);
        let first = certificates.key(start);
        assert!(Arc::ptr_eq(&first, &certificates.key(start - BACKDATE / 2)));
        // A browser would find it not valid yet.
        let earlier = certificates.key(start - 6 * BACKDATE);
        assert!(!Arc::ptr_eq(&first, &earlier));
        // Longer asleep than even the next one lives.
        let hashes = certificates.hashes(start);
        let late = certificates.hashes(start + 20 * DAY);
        assert!(![&hashes.current, &hashes.next].contains(&&late.current));
    }

    #[test]
    fn a_restart_keeps_them_and_two_servers_agree() {
        let folder = tempfile::tempdir().unwrap();
        let start = SystemTime::now();
        assert_eq!(kept_hashes(folder.path(), start, &provider()), None);
        let [one, two] = [open(folder.path(), start), open(folder.path(), start + DAY)];
        assert_eq!(one.hashes(start), two.hashes(start + DAY));
        for now in [start + 7 * DAY, start + 14 * DAY, start + 40 * DAY, start - DAY] {
            let hashes = one.hashes(now);
            assert_eq!(two.hashes(now), hashes);
            assert_eq!(kept_hashes(folder.path(), now, &provider()), Some(hashes));
        }
        assert_eq!(kept_hashes(folder.path(), start + 40 * DAY, &provider()), None);
    }

    #[test]
    fn a_damaged_file_is_replaced_and_a_folder_that_cannot_be_written_is_no_error() {
        let folder = tempfile::tempdir().unwrap();
        let now = SystemTime::now();
        std::fs::write(folder.path().join(FILE), "[{}]").unwrap();
        let replaced = open(folder.path(), now).hashes(now);
        assert_eq!(open(folder.path(), now).hashes(now), replaced);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            let mode = std::fs::metadata(folder.path().join(FILE)).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
        }
        let nowhere = open(Path::new("/proc/nowhere"), now);
        let hashes = nowhere.hashes(now);
        assert_eq!(nowhere.hashes(now + 7 * DAY).current, hashes.next);
    }

    #[test]
    fn a_stopped_server_that_holds_the_lock_holds_up_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let now = SystemTime::now();
        let held = lock(&folder.path().join(FILE)).unwrap();
        open(folder.path(), now);
        drop(held);
    }
}
