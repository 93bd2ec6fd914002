//! Bearer tokens: a TOML file of digests, each with an expiry and scopes. SIGHUP reloads it.
//!
//! ```toml
//! [[token]]
//! name = "alice"                       # for people: /sessions shows it, logs do not
//! sha256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
//! expires = 2027-01-31T00:00:00Z       # default: never
//! scopes = ["session"]                 # the default; "admin" reads /metrics and /sessions, and ends sessions
//! once = false                         # the default; true admits one session only
//! ```
//!
//! A session ends when its token is withdrawn from the file or expires. One that resumes needs the same token.
//!
//! The file contains no token, so reading it lets nobody connect. A token is 256 random bits, too many to guess from an
//! unsalted SHA-256. `sha256sum` makes the digest of an existing token; `gnomon-server token` makes both.

mod expiry;
pub(crate) mod file;
pub(crate) mod grant;
mod make;
pub(crate) mod scope;
pub(crate) mod store;

pub use self::{file::TokenError, make::make, scope::Scope};
