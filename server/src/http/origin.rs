//! Which web pages may open a WebSocket here.
//!
//! Browsers let any page open a WebSocket to any host and send the page's origin along; without a check every page that
//! a user visits could drive a server on his own machine. Programs that are no browsers send no origin.

use axum::http::{HeaderMap, header};

/// Whether a request comes from no browser, from this server's own page, or from an allowed origin.
pub(super) fn is_allowed(headers: &HeaderMap, allowed: &[String]) -> bool {
    let Some(origin) = headers.get(header::ORIGIN) else { return true };
    let Ok(origin) = origin.to_str() else { return false };
    if allowed.iter().any(|allowed| allowed == "*" || allowed == origin) {
        return true;
    }
    let host = headers.get(header::HOST).and_then(|host| host.to_str().ok());
    // Scheme aside: a proxy may end TLS before us.
    let origin_host = origin.split_once("://").map(|(_, host)| host);
    match (origin_host, host) {
        (Some(origin_host), Some(host)) => origin_host.eq_ignore_ascii_case(host),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_own_page_and_allowed_origins_pass() {
        let headers = |origin: Option<&str>| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, "box:7171".parse().unwrap());
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, origin.parse().unwrap());
            }
            headers
        };
        assert!(is_allowed(&headers(None), &[]));
        assert!(is_allowed(&headers(Some("http://box:7171")), &[]));
        assert!(is_allowed(&headers(Some("https://BOX:7171")), &[]));
        for bad in ["http://evil.example", "http://box:7172", "http://box:7171.evil.example", "null", ""] {
            assert!(!is_allowed(&headers(Some(bad)), &[]), "{bad}");
        }
        assert!(is_allowed(&headers(Some("http://viewer")), &["http://viewer".into()]));
        assert!(is_allowed(&headers(Some("null")), &["*".into()]));
    }
}
