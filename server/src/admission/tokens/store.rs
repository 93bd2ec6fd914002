//! The bearer tokens that admit a client: a TOML file of their digests, with an end and scopes each. It is read again on SIGHUP.
//!
//! ```toml
//! [[token]]
//! name = "alice"                       # for people; it is in no log
//! sha256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
//! expires = 2027-01-31T00:00:00Z       # without it: never
//! scopes = ["session"]                 # the default; "admin" reads /metrics and /sessions
//! once = false                         # the default; true admits one session, and then nobody
//! ```
//!
//! The file holds no token, so whoever reads it cannot connect. A token is 256 random bits, so its plain SHA-256 cannot be guessed back;
//! `sha256sum` makes the same digest of a token that comes from elsewhere. `gnomon-server token` makes both.

use std::{
    collections::HashSet,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::{SystemTime, UNIX_EPOCH},
};

use gnomon_protocol::limits::MAX_TOKEN_BYTES;
use ring::{
    digest,
    rand::{SecureRandom as _, SystemRandom},
};
use serde::{Deserialize, Serialize};
use subtle::ConstantTimeEq as _;
use thiserror::Error;
use time::{Date, Month, Time, UtcOffset};

use crate::{clock, files, limits};

/// SHA-256 of a token.
type Digest = [u8; 32];

/// What a token is good for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Scope {
    /// To open sessions.
    Session,
    /// To read the metrics and the list of sessions.
    Admin,
}

/// A token's line in the file.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    #[serde(default, skip_serializing_if = "String::is_empty")]
    name: String,
    sha256: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    expires: Option<toml::value::Datetime>,
    #[serde(default = "session_only")]
    scopes: Vec<Scope>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    once: bool,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    token: Vec<Entry>,
}

fn session_only() -> Vec<Scope> {
    vec![Scope::Session]
}

/// A listed token, checked.
#[derive(Debug, Clone)]
pub(crate) struct Listed {
    digest: Digest,
    expires_unix_s: Option<i64>,
    scopes: Vec<Scope>,
    once: bool,
}

/// Why a token admits nobody. A client hears none of this, the log does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub(crate) enum TokenProblem {
    #[error("no token")]
    Missing,
    #[error("an unknown token")]
    Unknown,
    #[error("an expired token")]
    Expired,
    #[error("a token without this scope")]
    Scope,
    #[error("a token for one use, used before")]
    Spent,
}

/// Why a token file cannot be used.
#[derive(Debug, Error)]
pub enum TokenError {
    /// It cannot be read.
    #[error("cannot read the token file {path}: {reason}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: std::io::Error,
    },
    /// It is no TOML, or an entry is wrong. No token is quoted: an old file may have bare ones.
    #[error("token file {path}: {reason}; `gnomon-server token` makes entries")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        reason: String,
    },
    /// It lists no token for sessions, so nobody could ever connect.
    #[error(
        "{0} lists no token with the scope session: make one with `gnomon-server token`, or leave out --token-file to \
         admit everybody"
    )]
    Empty(PathBuf),
    /// The system has no random numbers.
    #[error("the system gives no random numbers")]
    Random,
}

/// The listed tokens, and which of those for one use are spent.
#[derive(Debug)]
pub(crate) struct TokenStore {
    path: PathBuf,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    listed: Vec<Listed>,
    /// Digests of listed tokens; others are forgotten, so the file's size bounds it.
    spent: HashSet<Digest>,
}

impl TokenStore {
    /// Reads a token file.
    ///
    /// # Errors
    /// When it cannot be read, has a malformed entry, or lists no token for sessions.
    pub(crate) fn read(path: &Path) -> Result<Self, TokenError> {
        let state = Mutex::new(State { listed: read(path)?, spent: HashSet::new() });
        Ok(Self { path: path.to_owned(), state })
    }

    /// Reads the file again. Sessions that are open stay; a file that cannot be used changes nothing. Says how many it lists.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub(crate) fn reload(&self) -> Result<usize, TokenError> {
        let listed = read(&self.path)?;
        let mut state = self.state();
        state.spent.retain(|digest| listed.iter().any(|token| token.digest == *digest));
        state.listed = listed;
        Ok(state.listed.len())
    }

    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether a token of that scope is listed.
    pub(crate) fn has(&self, scope: Scope) -> bool {
        self.state().listed.iter().any(|token| token.scopes.contains(&scope))
    }

    /// Whether the token is good for `scope` now; one for one use is spent by this.
    ///
    /// # Errors
    /// Says why it is not.
    pub(crate) fn admit(&self, token: Option<&str>, scope: Scope) -> Result<(), TokenProblem> {
        self.examine(token, scope, unix_s(clock::wall()), true)
    }

    /// As [`Self::admit`], but spends nothing.
    ///
    /// # Errors
    /// Says why it is not good.
    pub(crate) fn check(&self, token: Option<&str>, scope: Scope) -> Result<(), TokenProblem> {
        self.examine(token, scope, unix_s(clock::wall()), false)
    }

    fn examine(&self, token: Option<&str>, scope: Scope, now_unix_s: i64, spend: bool) -> Result<(), TokenProblem> {
        let digest = sha256(token.ok_or(TokenProblem::Missing)?.as_bytes());
        let mut state = self.state();
        // Every entry is compared, each in constant time, so that the time tells nothing about which one was near.
        let found = state
            .listed
            .iter()
            .fold(None, |found, listed| if bool::from(listed.digest.ct_eq(&digest)) { Some(listed) } else { found });
        let found = found.ok_or(TokenProblem::Unknown)?;
        if found.expires_unix_s.is_some_and(|expires| now_unix_s >= expires) {
            return Err(TokenProblem::Expired);
        }
        if !found.scopes.contains(&scope) {
            return Err(TokenProblem::Scope);
        }
        let once = found.once;
        if once && (state.spent.contains(&digest) || spend && !state.spent.insert(digest)) {
            return Err(TokenProblem::Spent);
        }
        Ok(())
    }
}

fn read(path: &Path) -> Result<Vec<Listed>, TokenError> {
    let bytes = files::read_small(path, limits::MAX_TOKEN_FILE_BYTES)
        .map_err(|reason| TokenError::Read { path: path.to_owned(), reason })?;
    parse(path, bytes)
}

/// The tokens that these bytes of a file list.
///
/// # Errors
/// When they are malformed, or list no token for sessions.
pub(crate) fn parse(path: &Path, bytes: Vec<u8>) -> Result<Vec<Listed>, TokenError> {
    let malformed = |reason: String| TokenError::Malformed { path: path.to_owned(), reason };
    let text = String::from_utf8(bytes).map_err(|_| malformed("it is no UTF-8".to_owned()))?;
    // The parser quotes what it cannot read, which may be a bare token: only the place is told.
    let file: File = toml::from_str(&text).map_err(|error| malformed(gnomon_settings::line_of(error.span(), &text)))?;
    if file.token.len() > limits::MAX_TOKENS {
        return Err(malformed(format!("{} tokens; at most {} are read", file.token.len(), limits::MAX_TOKENS)));
    }
    let check = |(index, entry): (usize, Entry)| {
        let wrong = |what: &str| malformed(format!("token {}: {what}", index + 1));
        let digest = digest_of_hex(&entry.sha256).ok_or_else(|| wrong("sha256 has 64 hexadecimal digits"))?;
        let expires =
            entry.expires.map(|at| expiry_unix_s(&at).ok_or_else(|| wrong("expires has a date, a time and an offset")));
        Ok(Listed { digest, expires_unix_s: expires.transpose()?, scopes: entry.scopes, once: entry.once })
    };
    let listed: Vec<_> = file.token.into_iter().enumerate().map(check).collect::<Result<_, _>>()?;
    let usable = listed.iter().any(|token| token.scopes.contains(&Scope::Session));
    if usable { Ok(listed) } else { Err(TokenError::Empty(path.to_owned())) }
}

/// A new token, and its entry for the file.
///
/// # Errors
/// When the system has no random numbers.
pub fn make(name: &str, days: Option<u32>, scopes: &[Scope], once: bool) -> Result<(String, String), TokenError> {
    let mut secret = [0; 32];
    SystemRandom::new().fill(&mut secret).map_err(|_| TokenError::Random)?;
    let token = hex(&secret);
    let expires = days.and_then(|days| datetime(unix_s(clock::wall()) + i64::from(days) * 24 * 3600));
    let entry =
        Entry { name: name.to_owned(), sha256: hex(&sha256(token.as_bytes())), expires, scopes: scopes.to_vec(), once };
    debug_assert!(token.len() <= MAX_TOKEN_BYTES);
    Ok((token, entry.toml()))
}

impl Entry {
    /// As the file has it. By hand, because the parser's crate is built without its writer.
    fn toml(&self) -> String {
        let name: String = self.name.chars().filter(|c| !c.is_control() && !"\"\\".contains(*c)).collect();
        let scopes: Vec<_> = self
            .scopes
            .iter()
            .map(|scope| match scope {
                Scope::Session => "\"session\"",
                Scope::Admin => "\"admin\"",
            })
            .collect();
        let expires = self.expires.map(|at| format!("expires = {at}\n")).unwrap_or_default();
        let once = if self.once { "once = true\n" } else { "" };
        format!(
            "[[token]]\nname = \"{name}\"\nsha256 = \"{}\"\n{expires}scopes = [{}]\n{once}",
            self.sha256,
            scopes.join(", ")
        )
    }
}

fn sha256(bytes: &[u8]) -> Digest {
    let mut found = Digest::default();
    found.copy_from_slice(digest::digest(&digest::SHA256, bytes).as_ref());
    found
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn digest_of_hex(text: &str) -> Option<Digest> {
    let mut digest = Digest::default();
    let digits = text.as_bytes();
    if digits.len() != 2 * digest.len() || !digits.iter().all(u8::is_ascii_hexdigit) {
        return None;
    }
    for (byte, pair) in digest.iter_mut().zip(digits.chunks_exact(2)) {
        *byte = u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()?;
    }
    Some(digest)
}

fn unix_s(at: SystemTime) -> i64 {
    let seconds = at.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
    i64::try_from(seconds).unwrap_or(i64::MAX)
}

/// Seconds since 1970; `None` for a date without a time or an offset, which would mean another moment on another machine.
fn expiry_unix_s(at: &toml::value::Datetime) -> Option<i64> {
    let (date, time, offset) = (at.date?, at.time?, at.offset?);
    let date = Date::from_calendar_date(date.year.into(), Month::try_from(date.month).ok()?, date.day).ok()?;
    let time = Time::from_hms(time.hour, time.minute, time.second.unwrap_or(0).min(59)).ok()?;
    let minutes = match offset {
        toml::value::Offset::Z => 0,
        toml::value::Offset::Custom { minutes } => minutes,
    };
    let offset = UtcOffset::from_whole_seconds(i32::from(minutes) * 60).ok()?;
    Some(date.with_time(time).assume_offset(offset).unix_timestamp())
}

fn datetime(at_unix_s: i64) -> Option<toml::value::Datetime> {
    let at = time::OffsetDateTime::from_unix_timestamp(at_unix_s).ok()?;
    let (date, time) = (at.date(), at.time());
    format!(
        "{:04}-{:02}-{:02}T{:02}:{:02}:{:02}Z",
        date.year(),
        u8::from(date.month()),
        date.day(),
        time.hour(),
        time.minute(),
        time.second()
    )
    .parse()
    .ok()
}

#[cfg(test)]
mod tests;
