//! Who may ask: pages of this server, and programs on behalf of whoever started it.
//!
//! A page of another site can make a browser send requests here. Its `Origin` gives it away; and where it has pointed a
//! name of its own at this address, so that the origins are the same, the `Host` is that name. So a host is `localhost`
//! or an address in numbers, with our port, and an origin, where there is one, is that host.

use std::net::{Ipv4Addr, Ipv6Addr};

use axum::http::header::{HOST, ORIGIN};
use axum::http::{HeaderMap, HeaderValue};

/// Whether a request with these headers is for us and from us; the host if so.
pub(crate) fn check(headers: &HeaderMap, port: u16) -> Result<String, String> {
    let text = |value: &HeaderValue| value.to_str().unwrap_or_default().to_owned();
    // Two hosts are no host: which one counts would be a matter of opinion.
    let mut hosts = headers.get_all(HOST).iter();
    let host = match (hosts.next().map(text), hosts.next()) {
        (Some(host), None) if is_ours(&host, port) => host,
        (host, _) => {
            let host = host.unwrap_or_else(|| "none".into());
            return Err(format!("host {host}, expected localhost:{port} or the address in numbers\n"));
        }
    };
    for origin in headers.get_all(ORIGIN).iter().map(text) {
        if !origin.eq_ignore_ascii_case(&format!("http://{host}")) {
            return Err(format!("origin {origin}, expected http://{host}\n"));
        }
    }
    Ok(host)
}

fn is_ours(host: &str, port: u16) -> bool {
    const DEFAULT_PORT: u16 = 80;
    let (name, given) = match host.rsplit_once(':') {
        // The colons of an IPv6 address are within brackets.
        Some((name, digits)) if !digits.ends_with(']') => (name, digits.parse().ok()),
        _ => (host, Some(DEFAULT_PORT)),
    };
    let is_address = || match name.strip_prefix('[').and_then(|name| name.strip_suffix(']')) {
        Some(inner) => inner.parse::<Ipv6Addr>().is_ok(),
        None => name.parse::<Ipv4Addr>().is_ok(),
    };
    given == Some(port) && (name.eq_ignore_ascii_case("localhost") || is_address())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(host: &[&str], origin: Option<&str>) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for host in host {
            headers.append(HOST, host.parse().unwrap());
        }
        if let Some(origin) = origin {
            headers.insert(ORIGIN, origin.parse().unwrap());
        }
        headers
    }

    #[test]
    fn hosts_are_localhost_or_numbers_with_our_port() {
        for host in ["localhost:8642", "LOCALHOST:8642", "127.0.0.1:8642", "[::1]:8642", "192.168.0.7:8642"] {
            assert_eq!(check(&headers(&[host], None), 8642).as_deref(), Ok(host));
        }
        for host in [
            "localhost",
            "localhost:80",
            "localhost:8643",
            "evil.example:8642",
            "127.0.0.1.evil.example:8642",
            "localhost.evil.example:8642",
            "[::1]",
            "[::1]x:8642",
            "::1:8642",
            "user@localhost:8642",
            ":8642",
            "",
        ] {
            assert!(check(&headers(&[host], None), 8642).is_err(), "{host}");
        }
        assert!(check(&headers(&[], None), 8642).is_err());
        assert!(check(&headers(&["localhost:8642", "evil.example"], None), 8642).is_err());
        assert!(check(&headers(&["localhost"], None), 80).is_ok());
    }

    #[test]
    fn an_origin_is_the_host() {
        let host = "127.0.0.1:8642";
        assert!(check(&headers(&[host], Some("http://127.0.0.1:8642")), 8642).is_ok());
        for origin in [
            "null",
            "http://evil.example",
            "http://127.0.0.1:8643",
            "https://127.0.0.1:8642",
            "http://localhost:8642",
            "http://127.0.0.1:8642.evil.example",
        ] {
            assert!(check(&headers(&[host], Some(origin)), 8642).is_err(), "{origin}");
        }
    }
}
