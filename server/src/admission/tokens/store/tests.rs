//! Token files and stores.

use std::{sync::Arc, time::SystemTime};

use super::*;
use crate::{
    admission::{
        end_reason::EndReason,
        tokens::{grant::Grant, make},
    },
    hex,
};

fn store(text: &str) -> Result<(tempfile::TempDir, Arc<TokenStore>), String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tokens.toml");
    std::fs::write(&path, text).unwrap();
    let store = TokenStore::read(&path).map_err(|error| error.to_string())?;
    Ok((folder, Arc::new(store)))
}

fn entry(token: &str, more: &str) -> String {
    format!("[[token]]\nsha256 = \"{}\"\n{more}\n", hex::encode(&sha256(token.as_bytes())))
}

#[test]
fn only_listed_tokens_are_admitted() {
    let text =
        entry("first", "name = \"staff\"") + &entry("second", "") + "# " + &entry("third", "").replace('\n', "\n# ");
    let (_folder, store) = store(&text).unwrap();
    for (token, expected) in [
        (Some("first"), Ok(())),
        (Some("second"), Ok(())),
        (Some("third"), Err(TokenRejection::Unknown)),
        (Some("firs"), Err(TokenRejection::Unknown)),
        (Some(""), Err(TokenRejection::Unknown)),
        (None, Err(TokenRejection::Missing)),
    ] {
        assert_eq!(store.admit(token, Scope::Session), expected, "{token:?}");
    }
    // The digest in the file is not a token: reading the file lets nobody connect.
    let digest = hex::encode(&sha256(b"first"));
    assert_eq!(store.admit(Some(&digest), Scope::Session), Err(TokenRejection::Unknown));
}

#[test]
fn a_token_expires_and_grants_only_its_scopes() {
    let text = entry("a", "expires = 2030-01-01T01:00:00+01:00") + &entry("b", "scopes = [\"admin\"]");
    let (_folder, store) = store(&text).unwrap();
    // 2030-01-01T00:00:00Z
    let end = 1_893_456_000;
    let examine = |token, scope, now| store.state.lock().examine(Some(token), scope, now).map(drop);
    assert_eq!(examine("a", Scope::Session, end - 1), Ok(()));
    assert_eq!(examine("a", Scope::Session, end), Err(TokenRejection::Expired));
    assert_eq!(examine("a", Scope::Admin, 0), Err(TokenRejection::Scope));
    assert_eq!(examine("b", Scope::Session, 0), Err(TokenRejection::Scope));
    assert_eq!(examine("b", Scope::Admin, 0), Ok(()));
    assert!(store.has(Scope::Admin));
}

#[test]
fn a_spent_token_stays_spent_across_reloads() {
    let (folder, store) = store(&(entry("a", "once = true") + &entry("b", ""))).unwrap();
    let path = folder.path().join("tokens.toml");
    let refused = |token, resumes| Grant::claim(&store, Some(token), resumes).map(drop).unwrap_err();
    // A refused client gives it back.
    drop(Grant::claim(&store, Some("a"), false).unwrap());
    assert_eq!(store.admit(Some("a"), Scope::Session), Ok(()));
    assert_eq!(store.admit(Some("a"), Scope::Session), Err(TokenRejection::Spent));
    assert_eq!(refused("a", false), TokenRejection::Spent);
    // A client that resumes its session does not spend it again, and gives nothing back.
    drop(Grant::claim(&store, Some("a"), true).unwrap());
    assert_eq!(refused("a", false), TokenRejection::Spent);
    assert_eq!(store.reload().unwrap(), 2);
    assert_eq!(store.admit(Some("a"), Scope::Session), Err(TokenRejection::Spent));
    std::fs::write(&path, entry("c", "")).unwrap();
    assert_eq!(store.reload().unwrap(), 1);
    assert!(store.state.lock().spent.is_empty(), "digests that are no longer listed are dropped");
    assert_eq!(store.admit(Some("b"), Scope::Session), Err(TokenRejection::Unknown), "withdrawn");
    // A broken file changes nothing.
    std::fs::write(&path, "[[token]]\n").unwrap();
    store.reload().unwrap_err();
    assert_eq!(store.admit(Some("c"), Scope::Session), Ok(()));
}

#[test]
fn an_unusable_file_is_refused_without_quoting_it() {
    for (text, part) in [
        (String::new(), "lists no token with the scope session"),
        (entry("a", "scopes = [\"admin\"]"), "lists no token with the scope session"),
        ("open-sesame\n".to_owned(), "line 1"),
        ("# ok\n[[token]]\nsha256 = \"00\"\n".to_owned(), "token 1: sha256 has 64"),
        (entry("a", "expires = 2030-01-01"), "token 1: expires has a date, a time and an offset"),
        (entry("a", "expires = 2030-01-01T00:00:00"), "token 1: expires"),
        (entry("a", "scopes = [\"root\"]"), "line 3"),
        (entry("a", "secret = \"open-sesame\""), "line 3"),
    ] {
        let message = store(&text).map(|_| ()).unwrap_err();
        assert!(
            message.contains(part) && !message.contains("sesame") && !message.contains('\n'),
            "{text:?} gives {message}"
        );
    }
    assert!(TokenStore::read(Path::new("/nowhere/tokens")).unwrap_err().to_string().contains("/nowhere/tokens"));
}

#[test]
fn a_made_token_is_admitted() {
    let (token, text) = make("al\"ice\n", Some(30), &[Scope::Session, Scope::Admin], true).unwrap();
    let (other, _) = make("", None, &[Scope::Session], false).unwrap();
    assert!(token != other && token.len() == 64 && !text.contains(&token), "{text}");
    let (_folder, store) = store(&text).unwrap();
    let day = 24 * 3600;
    let now = unix_s(SystemTime::now());
    assert_eq!(Grant::claim_at(&store, Some(&token), false, now + 31 * day).unwrap_err(), TokenRejection::Expired);
    let mut grant = Grant::claim_at(&store, Some(&token), false, now + 29 * day).unwrap();
    assert_eq!(grant.name(), "alice");
    grant.keep();
    drop(grant);
    assert_eq!(Grant::claim_at(&store, Some(&token), false, now).unwrap_err(), TokenRejection::Spent);
}

#[tokio::test]
async fn a_grant_ends_with_its_token() {
    let far_ahead = "expires = 2999-01-01T00:00:00Z";
    let all = entry("keeps", "") + &entry("leaves", "") + &entry("expires", far_ahead) + &entry("once", "once = true");
    let (folder, store) = store(&all).unwrap();
    let path = folder.path().join("tokens.toml");
    let [mut keeps, mut leaves, mut expires, mut once] =
        ["keeps", "leaves", "expires", "once"].map(|token| Grant::claim(&store, Some(token), false).unwrap());
    once.keep();
    std::fs::write(
        &path,
        entry("keeps", "") + &entry("expires", "expires = 2001-01-01T00:00:00Z") + &entry("once", "once = true"),
    )
    .unwrap();
    store.reload().unwrap();
    // What was claimed before the reload learns of it afterwards, whenever it asks.
    assert_eq!(leaves.ended().await, EndReason::TokenWithdrawn);
    assert_eq!(expires.ended().await, EndReason::TokenExpired);
    for stays in [&mut keeps, &mut once] {
        let ended = tokio::time::timeout(std::time::Duration::from_millis(50), stays.ended()).await;
        assert!(ended.is_err(), "{ended:?}");
    }
    // Without the scope it admits no session.
    std::fs::write(&path, entry("keeps", "scopes = [\"admin\"]") + &entry("once", "once = true")).unwrap();
    store.reload().unwrap();
    assert_eq!(keeps.ended().await, EndReason::TokenWithdrawn);
    // An unusable file withdraws nothing.
    std::fs::write(&path, "").unwrap();
    store.reload().unwrap_err();
    assert!(tokio::time::timeout(std::time::Duration::from_millis(50), once.ended()).await.is_err());
}
