//! `gnomon-server sessions`: lists the sessions of a running server, or ends one, through its admin address.

use std::{
    io::Read as _,
    net::{Ipv4Addr, Ipv6Addr, SocketAddr},
    path::{Path, PathBuf},
    time::Duration,
};

use http_body_util::Full;
use hyper::{
    Request, StatusCode,
    body::Bytes,
    header::{AUTHORIZATION, HOST, HeaderValue},
};
use serde_json::Value;
use thiserror::Error;

use super::{
    http::{SendError, exchange},
    logs::escape::{self, Form},
};
use crate::{config::AdminAddress, files, limits::MAX_SESSIONS};

const TIMEOUT: Duration = Duration::from_secs(5);

/// Longest list: 1 KiB for each session.
const MAX_LIST_BYTES: usize = MAX_SESSIONS * 1024;

const MAX_SECRET_BYTES: u64 = 4096;

#[derive(Debug, Error)]
pub enum SessionsError {
    #[error("which server? pass --admin [ADDR:]PORT, as the server has it")]
    NoAddress,
    #[error("cannot read the secret from {path}: {reason}")]
    Secret { path: PathBuf, reason: std::io::Error },
    #[error("the secret in {0} is no token: it must be one line, the first that `gnomon-server token` printed")]
    NoToken(PathBuf),
    #[error("no answer from the admin address {address}: {reason}; does the server run, with --admin?")]
    Send { address: SocketAddr, reason: Box<dyn std::error::Error + Send + Sync> },
    #[error("{address} requires a token with the scope admin: pass its secret as --secret FILE")]
    Unauthorized { address: SocketAddr },
    #[error("{address} says: {what}")]
    Refused { address: SocketAddr, what: String },
    #[error("{address} gave an answer that is no list of sessions: is it a gnomon-server?")]
    Answer { address: SocketAddr },
    #[error("cannot start the runtime: {0}")]
    Runtime(std::io::Error),
}

/// Returns a table of the sessions, or what happened to the session `end`. Blocks.
///
/// # Errors
/// Says what is missing, or what the server refused.
pub fn run(admin: Option<AdminAddress>, secret: Option<&Path>, end: Option<u64>) -> Result<String, SessionsError> {
    let address = reachable(admin.and_then(AdminAddress::address).ok_or(SessionsError::NoAddress)?);
    let secret = secret.map(read_secret).transpose()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(SessionsError::Runtime)?;
    let request = match end {
        Some(id) => Request::post(format!("/sessions/{id}/end")),
        None => Request::get("/sessions"),
    };
    let (status, body) = runtime.block_on(ask(address, request, secret))?;
    let text = String::from_utf8_lossy(&body);
    match (status, end) {
        (StatusCode::UNAUTHORIZED, _) => Err(SessionsError::Unauthorized { address }),
        (status, Some(_)) if status.is_success() => Ok(one_line(&text)),
        (status, None) if status.is_success() => table(&text).ok_or(SessionsError::Answer { address }),
        (_, _) => Err(SessionsError::Refused { address, what: one_line(&text) }),
    }
}

async fn ask(
    address: SocketAddr,
    request: hyper::http::request::Builder,
    secret: Option<HeaderValue>,
) -> Result<(StatusCode, Bytes), SessionsError> {
    let failed = |reason: SendError| SessionsError::Send { address, reason: reason.into() };
    let mut request =
        request.header(HOST, address.to_string()).body(Full::default()).map_err(|error| failed(error.into()))?;
    if let Some(secret) = secret {
        request.headers_mut().insert(AUTHORIZATION, secret);
    }
    let (status, body) = exchange(address, request, TIMEOUT, MAX_LIST_BYTES).await.map_err(failed)?;
    Ok((status, body.ok_or(SessionsError::Answer { address })?))
}

/// A server that listens on every address is on loopback, too.
fn reachable(address: SocketAddr) -> SocketAddr {
    let ip = match address.ip() {
        ip if !ip.is_unspecified() => ip,
        ip if ip.is_ipv4() => Ipv4Addr::LOCALHOST.into(),
        _ => Ipv6Addr::LOCALHOST.into(),
    };
    SocketAddr::new(ip, address.port())
}

fn read_secret(path: &Path) -> Result<HeaderValue, SessionsError> {
    let wrong = |reason| SessionsError::Secret { path: path.to_owned(), reason };
    let bytes = if path == Path::new("-") {
        let mut bytes = Vec::new();
        std::io::stdin().take(MAX_SECRET_BYTES).read_to_end(&mut bytes).map_err(wrong)?;
        bytes
    } else {
        files::read_small(path, MAX_SECRET_BYTES).map_err(wrong)?
    };
    let text = String::from_utf8(bytes).ok();
    let secret = text.as_deref().map(str::trim).filter(|text| !text.is_empty());
    let mut header = secret.and_then(|secret| HeaderValue::try_from(format!("Bearer {secret}")).ok());
    if let Some(header) = &mut header {
        header.set_sensitive(true);
    }
    header.ok_or_else(|| SessionsError::NoToken(path.to_owned()))
}

fn one_line(text: &str) -> String {
    escape::escaped(text.trim(), Form::Text)
}

const HEADINGS: [&str; 10] =
    ["ID", "TOKEN", "ADDRESS", "CLIENT", "SIZE", "CODEC", "RATE", "DEVICE", "NETWORK", "SINCE"];

/// `None` if the text is no list of sessions.
fn table(text: &str) -> Option<String> {
    let list: Value = serde_json::from_str(text).ok()?;
    let rows: Vec<[String; 10]> = list["sessions"].as_array()?.iter().map(row).collect();
    if rows.is_empty() {
        return Some("no sessions".to_owned());
    }
    let rows: Vec<_> = std::iter::once(HEADINGS.map(str::to_owned)).chain(rows).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: [usize; 10] = std::array::from_fn(width);
    let line = |row: &[String; 10]| {
        let cells = row.iter().zip(widths).map(|(cell, width)| format!("{cell:<width$}"));
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    Some(rows.iter().map(line).collect::<Vec<_>>().join("\n"))
}

fn row(session: &Value) -> [String; 10] {
    let text = |key: &str| match &session[key] {
        Value::String(text) => escape::escaped(text, Form::Text),
        Value::Null => "-".to_owned(),
        other => other.to_string(),
    };
    let number = |key: &str| session[key].as_f64().unwrap_or_default();
    let rate = match session["declared_hz"].as_f64() {
        Some(declared) => format!("{:.0} of {declared:.0}/s", number("poses_per_s")),
        None => format!("{:.0}/s", number("poses_per_s")),
    };
    [
        text("id"),
        text("token"),
        text("peer"),
        text("client"),
        format!("{}x{}", session["size_px"][0], session["size_px"][1]),
        text("codec"),
        rate,
        format!("{:.1} ms/s", number("device_ms_per_s")),
        format!("{:.1} kB/s", number("bytes_per_s") / 1e3),
        text("since"),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_becomes_a_table() {
        let list = r#"{"sessions":[
            {"id":7,"token":"alice","peer":"192.0.2.7:5","client":"a\u001b[2Jb","size_px":[1280,720],
             "codec":"tiles-fast","declared_hz":60,"poses_per_s":59.6,"device_ms_per_s":12.34,"bytes_per_s":1234567.0,
             "since":"2026-11-29T18:00:00Z"},
            {"id":12,"token":null,"peer":"[::1]:5","client":"c","size_px":[64,36],"codec":"planes-lz4",
             "declared_hz":null,"poses_per_s":0,"device_ms_per_s":0,"bytes_per_s":0,"since":"2026-11-29T18:00:01Z"}]}"#;
        let expected = "\
ID  TOKEN  ADDRESS      CLIENT       SIZE      CODEC       RATE        DEVICE     NETWORK      SINCE
7   alice  192.0.2.7:5  a\\u{1b}[2Jb  1280x720  tiles-fast  60 of 60/s  12.3 ms/s  1234.6 kB/s  2026-11-29T18:00:00Z
12  -      [::1]:5      c            64x36     planes-lz4  0/s         0.0 ms/s   0.0 kB/s     2026-11-29T18:00:01Z";
        assert_eq!(table(list).unwrap(), expected);
        assert_eq!(table("{\"sessions\":[]}").unwrap(), "no sessions");
        assert_eq!(table("<html>"), None);
    }

    #[test]
    fn a_server_on_every_address_is_asked_on_loopback() {
        for (address, expected) in [("0.0.0.0:7", "127.0.0.1:7"), ("[::]:7", "[::1]:7"), ("192.0.2.7:7", "192.0.2.7:7")]
        {
            assert_eq!(reachable(address.parse().unwrap()), expected.parse().unwrap());
        }
    }
}
