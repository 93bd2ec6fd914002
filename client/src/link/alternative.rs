//! URLs from the wire. A server names another one for its clients, and must not reach further than that.
//!
//! The grammar is `gnomon://HOST:PORT/?cert=SHA256`, with more `&cert=` if the other server has a spare: no file of
//! this machine, no zone, no first visit. A lab server, which is on loopback and not encrypted, may name one of its own
//! kind.

use std::net::{Ipv4Addr, Ipv6Addr};

use gnomon_protocol::text::PeerText;
use thiserror::Error;

use super::url::{MAX_PINS, ServerUrl, Transport, digest, is_loopback};

/// Longest name of the DNS, in bytes.
const MAX_NAME_BYTES: usize = 253;

/// Why a server's URL is not used. It repeats nothing of what the server wrote.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum AlternativeError {
    #[error("it does not begin with {0}://")]
    Scheme(&'static str),
    #[error("it has no HOST:PORT")]
    Address,
    #[error("its host is neither a name nor an address")]
    Host,
    #[error("its port is not a number from 1 to 65535")]
    Port,
    #[error("a lab transport works on loopback only")]
    NotLoopback,
    #[error("something other than cert= follows its address")]
    Query,
    #[error("a cert= has not 64 hexadecimal digits")]
    Certificate,
    #[error("it names more than {MAX_PINS} certificates")]
    TooManyPins,
}

/// Returns the server that a server on `transport` names.
///
/// # Errors
/// Errors if the text is not exactly of the grammar above.
pub fn alternative(text: &PeerText, transport: Transport) -> Result<ServerUrl, AlternativeError> {
    let scheme = transport.scheme();
    let rest = text.unescaped().strip_prefix(scheme).and_then(|rest| rest.strip_prefix("://"));
    let rest = rest.ok_or(AlternativeError::Scheme(scheme))?;
    let (address, query) = rest.split_once('?').unwrap_or((rest, ""));
    let address = address.strip_suffix('/').unwrap_or(address);
    let (host, port) = address.rsplit_once(':').ok_or(AlternativeError::Address)?;
    let host = checked_host(host).ok_or(AlternativeError::Host)?;
    let port = checked_port(port).ok_or(AlternativeError::Port)?;
    let mut certificates = Vec::new();
    match transport {
        Transport::Quic => {
            for pair in query.split('&') {
                let value = pair.strip_prefix("cert=").ok_or(AlternativeError::Query)?;
                if certificates.len() == MAX_PINS {
                    return Err(AlternativeError::TooManyPins);
                }
                certificates.push(digest(value).ok_or(AlternativeError::Certificate)?);
            }
        }
        Transport::LabUdp | Transport::LabTcp if !is_loopback(&host) => return Err(AlternativeError::NotLoopback),
        Transport::LabUdp | Transport::LabTcp if !query.is_empty() => return Err(AlternativeError::Query),
        Transport::LabUdp | Transport::LabTcp => {}
    }
    Ok(ServerUrl { transport, host, port, certificates, ca: None })
}

fn checked_host(host: &str) -> Option<String> {
    if let Some(address) = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')) {
        let address = address.parse::<Ipv6Addr>().ok().filter(|address| !address.is_unicast_link_local())?;
        return Some(address.to_string());
    }
    if let Ok(address) = host.parse::<Ipv4Addr>() {
        return Some(address.to_string());
    }
    let is_label = |label: &str| {
        (1..=63).contains(&label.len())
            && label.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_".contains(&byte))
    };
    // A name of digits alone would be read as an address (`127.1`, `2130706433`).
    let names_something = host.bytes().any(|byte| byte.is_ascii_alphabetic());
    let is_name = host.len() <= MAX_NAME_BYTES && host.strip_suffix('.').unwrap_or(host).split('.').all(is_label);
    (is_name && names_something).then(|| host.to_owned())
}

fn checked_port(port: &str) -> Option<u16> {
    let digits = (1..=5).contains(&port.len()) && port.bytes().all(|byte| byte.is_ascii_digit());
    if digits { port.parse().ok().filter(|port| *port != 0) } else { None }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const CERT: &str = "00ff00ff00ff00ff00ff00ff00ff00ff00ff00ff00ff00ff00ff00ff00ff00ff";

    fn quic(text: &str) -> Result<ServerUrl, AlternativeError> {
        alternative(&text.into(), Transport::Quic)
    }

    #[test]
    fn a_url_that_a_server_prints_is_read_as_a_person_would() {
        for text in [
            format!("gnomon://edge.example:4433/?cert={CERT}"),
            format!("gnomon://127.0.0.1:4433?cert={CERT}"),
            format!("gnomon://[2001:db8::7]:1/?cert={CERT}&cert={CERT}"),
            format!("gnomon://b_1-a:65535/?cert={CERT}"),
        ] {
            assert_eq!(quic(&text), Ok(text.parse().unwrap()), "{text}");
        }
    }

    #[test]
    fn nothing_else_is_read() {
        use AlternativeError as E;
        for (text, error) in [
            ("gnomon://edge:1/?ca=/dev/zero".to_owned(), E::Query),
            (format!("gnomon://edge:1/?cert={CERT}&ca=/etc/passwd"), E::Query),
            (format!("gnomon://edge:1/?CERT={CERT}"), E::Query),
            (format!("gnomon://edge:1/?cert={CERT}&"), E::Query),
            (format!("gnomon://edge:1/?cert={CERT}#x"), E::Certificate),
            (format!("gnomon://edge:1/scene?cert={CERT}"), E::Port),
            ("gnomon://edge:1/?cert=first-use".to_owned(), E::Certificate),
            ("gnomon://edge:1/".to_owned(), E::Query),
            ("gnomon://edge:1/?cert=".to_owned() + &CERT[1..], E::Certificate),
            (format!("gnomon+lab-tcp://127.0.0.1:1/?cert={CERT}"), E::Scheme("gnomon")),
            (format!("GNOMON://edge:1/?cert={CERT}"), E::Scheme("gnomon")),
            (format!(" gnomon://edge:1/?cert={CERT}"), E::Scheme("gnomon")),
            (format!("gnomon://edge/?cert={CERT}"), E::Address),
            (format!("gnomon://me@edge:1/?cert={CERT}"), E::Host),
            (format!("gnomon://:1/?cert={CERT}"), E::Host),
            (format!("gnomon://[fe80::1%25eth0]:1/?cert={CERT}"), E::Host),
            (format!("gnomon://127.1:1/?cert={CERT}"), E::Host),
            (format!("gnomon://2130706433:1/?cert={CERT}"), E::Host),
            (format!("gnomon://edge\x1b[2J:1/?cert={CERT}"), E::Host),
            (format!("gnomon://{}:1/?cert={CERT}", "a.".repeat(127)), E::Host),
            (format!("gnomon://edge:+1/?cert={CERT}"), E::Port),
            (format!("gnomon://edge:0/?cert={CERT}"), E::Port),
            (format!("gnomon://edge:65536/?cert={CERT}"), E::Port),
            (format!("gnomon://edge:1/?{}", vec![format!("cert={CERT}"); MAX_PINS + 1].join("&")), E::TooManyPins),
        ] {
            assert_eq!(quic(&text), Err(error), "{text}");
        }
    }

    #[test]
    fn a_lab_server_names_its_own_kind_on_loopback() {
        let lab = |text: &str| alternative(&text.into(), Transport::LabTcp);
        let text = "gnomon+lab-tcp://127.0.0.1:7/";
        assert_eq!(lab(text), Ok(text.parse().unwrap()));
        assert_eq!(lab("gnomon+lab-tcp://10.0.0.1:7/"), Err(AlternativeError::NotLoopback));
        assert_eq!(lab("gnomon+lab-tcp://127.0.0.1:7/?ca=/dev/zero"), Err(AlternativeError::Query));
        assert_eq!(lab("gnomon+lab-udp://127.0.0.1:7/"), Err(AlternativeError::Scheme("gnomon+lab-tcp")));
    }

    proptest! {
        /// Whatever a server writes: what is accepted names no file, has a pin, and is what a person's parser reads.
        #[test]
        fn what_is_accepted_is_pinned_and_names_no_file(
            address in "[a-z0-9.-]{1,9}|\\[[0-9a-f:%]{2,9}\\]|.{0,9}",
            port in "[0-9]{1,5}|.{0,5}",
            query in "/?\\?cert=[0-9a-f]{64}(&cert=[0-9a-f]{64}|&ca=.{0,5}|&.{0,9})?|.{0,70}",
        ) {
            let text = format!("gnomon://{address}:{port}{query}");
            if let Ok(url) = quic(&text) {
                prop_assert!(url.ca.is_none() && !url.certificates.is_empty() && !url.is_first_use());
                prop_assert_eq!(text.parse::<ServerUrl>().ok(), Some(url));
            }
        }
    }
}
