//! `gnomon-server token`: makes a token and its entry for the file.

use gnomon_protocol::limits::MAX_TOKEN_BYTES;
use ring::rand::{SecureRandom as _, SystemRandom};

use super::{
    expiry,
    file::{Entry, TokenError, sha256},
    scope::Scope,
};
use crate::{clock, hex};

/// Returns a new token, and its entry for the file.
///
/// # Errors
/// If the system has no random numbers.
pub fn make(name: &str, days: Option<u32>, scopes: &[Scope], once: bool) -> Result<(String, String), TokenError> {
    let mut secret = [0; 32];
    SystemRandom::new().fill(&mut secret).map_err(|_| TokenError::Random)?;
    let token = hex::encode(&secret);
    let now = expiry::unix_s(clock::wall());
    let expires = days.and_then(|days| expiry::to_toml(now + i64::from(days) * 24 * 3600));
    let sha256 = hex::encode(&sha256(token.as_bytes()));
    let entry = Entry { name: name.to_owned(), sha256, expires, scopes: scopes.to_vec(), once };
    debug_assert!(token.len() <= MAX_TOKEN_BYTES);
    Ok((token, toml(&entry)))
}

/// Written by hand, because the `toml` crate is built without its writer.
fn toml(entry: &Entry) -> String {
    let name: String = entry.name.chars().filter(|c| !c.is_control() && !"\"\\".contains(*c)).collect();
    let scopes: Vec<_> = entry
        .scopes
        .iter()
        .map(|scope| match scope {
            Scope::Session => "\"session\"",
            Scope::Edit => "\"edit\"",
            Scope::Admin => "\"admin\"",
        })
        .collect();
    let expires = entry.expires.map(|at| format!("expires = {at}\n")).unwrap_or_default();
    let once = if entry.once { "once = true\n" } else { "" };
    format!(
        "[[token]]\nname = \"{name}\"\nsha256 = \"{}\"\n{expires}scopes = [{}]\n{once}",
        entry.sha256,
        scopes.join(", ")
    )
}
