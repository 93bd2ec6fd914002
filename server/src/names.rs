//! Names and URLs that the operator gives and clients get. They are checked at the start, since clients would stumble
//! over them much later.

use url::{Host, Url};

/// Checks `HOST[:PORT]`: a name, an IPv4 address, or an IPv6 address with or without brackets.
pub(crate) fn advertised(text: &str) -> Result<String, String> {
    let text = word(text)?;
    let (host, port) = split_port(&text);
    if let Some(port) = port {
        port.parse::<u16>().ok().filter(|port| *port > 0).ok_or_else(|| format!("{port} is no port"))?;
    }
    is_host(host).then_some(()).ok_or_else(|| format!("{host:?} is neither a host name nor an address"))?;
    Ok(text)
}

/// Checks the URL of another server: `gnomon://HOST:PORT/?cert=SHA256`, with one or several certificates. Clients
/// follow no other.
pub(crate) fn alternative(text: &str) -> Result<String, String> {
    let text = word(text)?;
    let as_printed = "use the URL that the other server prints, gnomon://HOST:PORT/?cert=SHA256";
    let wrong = |what: &str| format!("{what}: {as_printed}");
    let url = Url::parse(&text).map_err(|_| wrong("it is no URL"))?;
    if url.scheme() != "gnomon" {
        return Err(wrong("it does not begin with gnomon://"));
    }
    if !url.host_str().is_some_and(is_host) {
        return Err(wrong("it has no host"));
    }
    if url.port().is_none_or(|port| port == 0) {
        return Err(wrong("it has no port"));
    }
    let more = !url.username().is_empty() || url.password().is_some() || url.fragment().is_some();
    if more || !matches!(url.path(), "" | "/") {
        return Err(wrong("it has a part that clients do not know"));
    }
    let mut certificates = 0;
    for (key, value) in url.query_pairs() {
        if key != "cert" {
            return Err(wrong("it has a part that clients do not know"));
        }
        if value.len() != 64 || !value.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Err(wrong("cert is no SHA-256 of 64 hexadecimal digits"));
        }
        certificates += 1;
    }
    if certificates == 0 {
        return Err(wrong("it lacks ?cert=SHA256"));
    }
    Ok(text)
}

/// Text for a URL or a message.
fn word(text: &str) -> Result<String, String> {
    let most = gnomon_protocol::limits::MAX_TEXT_BYTES;
    if text.is_empty() || text.len() > most || text.chars().any(|c| c.is_whitespace() || c.is_control()) {
        return Err(format!("must be 1 to {most} bytes without spaces"));
    }
    Ok(text.to_owned())
}

/// Separates the port from `HOST[:PORT]`. A bare IPv6 address has none.
fn split_port(text: &str) -> (&str, Option<&str>) {
    if text.parse::<std::net::Ipv6Addr>().is_ok() {
        return (text, None);
    }
    match text.rsplit_once(':') {
        Some((host, port)) if !port.contains(']') => (host, Some(port)),
        _ => (text, None),
    }
}

fn is_host(text: &str) -> bool {
    if text.parse::<std::net::Ipv6Addr>().is_ok() {
        return true;
    }
    match Host::parse(text) {
        Ok(Host::Domain(name)) => {
            let name = name.strip_suffix('.').unwrap_or(&name);
            let is_label =
                |label: &str| (1..=63).contains(&label.len()) && !label.starts_with('-') && !label.ends_with('-');
            name.len() <= 253 && name.split('.').all(is_label)
        }
        Ok(Host::Ipv4(_) | Host::Ipv6(_)) => true,
        Err(_) => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_advertised_host_is_a_name_or_an_address() {
        for good in [
            "edge",
            "edge.example",
            "edge.example.",
            "edge.example:99",
            "größe.example",
            "192.0.2.7",
            "192.0.2.7:1",
            "2001:db8::1",
            "[2001:db8::1]",
            "[2001:db8::1]:65535",
        ] {
            assert_eq!(advertised(good).as_deref(), Ok(good));
        }
        for (bad, why) in [
            ("", "without spaces"),
            ("a b", "without spaces"),
            ("edge:0", "0 is no port"),
            ("edge:99999", "99999 is no port"),
            ("edge:https", "https is no port"),
            ("edge:", "is no port"),
            (":4433", "neither a host name"),
            ("gnomon://edge:1", "neither a host name"),
            ("edge/scene", "neither a host name"),
            ("edge..example", "neither a host name"),
            ("-edge", "neither a host name"),
            ("256.0.0.1", "neither a host name"),
            ("[::1", "neither a host name"),
            ("1::2::3", "neither a host name"),
            ("user@edge", "neither a host name"),
        ] {
            let error = advertised(bad).unwrap_err();
            assert!(error.contains(why), "{bad:?}: {error}");
        }
    }

    #[test]
    fn an_alternative_is_what_clients_follow() {
        let cert = "0f".repeat(32);
        for good in [
            format!("gnomon://edge.example:4433/?cert={cert}"),
            format!("gnomon://192.0.2.7:1?cert={cert}&cert={cert}"),
            format!("gnomon://[2001:db8::1]:4433/?cert={}", cert.to_uppercase()),
        ] {
            assert_eq!(alternative(&good), Ok(good));
        }
        for (bad, why) in [
            ("edge:4433".to_owned(), "does not begin with gnomon://"),
            ("edge".to_owned(), "no URL"),
            (format!("https://edge:1/?cert={cert}"), "does not begin"),
            (format!("gnomon+lab-udp://127.0.0.1:1/?cert={cert}"), "does not begin"),
            (format!("gnomon://edge/?cert={cert}"), "no port"),
            (format!("gnomon://edge:0/?cert={cert}"), "no port"),
            (format!("gnomon:///?cert={cert}"), "no host"),
            (format!("gnomon://edge:1/scene?cert={cert}"), "clients do not know"),
            (format!("gnomon://me@edge:1/?cert={cert}"), "clients do not know"),
            (format!("gnomon://edge:1/?cert={cert}#x"), "clients do not know"),
            ("gnomon://edge:1/?ca=/dev/zero".to_owned(), "clients do not know"),
            ("gnomon://edge:1/?cert=first-use".to_owned(), "no SHA-256"),
            ("gnomon://edge:1/?cert=0f".to_owned(), "no SHA-256"),
            ("gnomon://edge:1/".to_owned(), "lacks ?cert=SHA256"),
        ] {
            let error = alternative(&bad).unwrap_err();
            assert!(error.contains(why) && error.contains("prints"), "{bad:?}: {error}");
        }
    }
}
