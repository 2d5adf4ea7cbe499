//! Checks of requests: only a page of this server, opened with its token, may ask for anything but the files of the page.
//!
//! A page of another site can send requests to this server from the user's browser. It cannot read the token, its `Origin`
//! is another one, and after DNS rebinding its `Host` is the name of that site.

use std::net::SocketAddr;

use axum::http::header::{HOST, ORIGIN};
use axum::http::{HeaderMap, StatusCode};

/// The header with the token of a request.
pub(crate) const TOKEN: &str = "x-bcap-token";

/// The token and the names of this server.
#[derive(Debug)]
pub(crate) struct Guard {
    token: String,
    hosts: [String; 2],
}

/// A refused request: the status and why.
pub(crate) type Refused = (StatusCode, &'static str);

impl Guard {
    /// Draws the token of a server.
    pub(crate) fn new(address: SocketAddr) -> Result<Self, getrandom::Error> {
        let mut bytes = [0; 24];
        getrandom::fill(&mut bytes)?;
        let token = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { token, hosts: [address.to_string(), format!("localhost:{}", address.port())] })
    }

    pub(crate) fn token(&self) -> &str {
        &self.token
    }

    /// Refuses a request for another host: a name of another site may have been bound to this address.
    pub(crate) fn check_host(&self, headers: &HeaderMap) -> Result<(), Refused> {
        let host = only(headers, HOST.as_str()).unwrap_or_default();
        if self.hosts.iter().any(|known| known.eq_ignore_ascii_case(host)) {
            return Ok(());
        }
        Err((
            StatusCode::MISDIRECTED_REQUEST,
            "this is not the host of the page; open the address that bcap web printed",
        ))
    }

    /// Refuses a request of a page of another origin, and one without an origin.
    pub(crate) fn check_origin(&self, headers: &HeaderMap) -> Result<(), Refused> {
        let host = only(headers, ORIGIN.as_str()).and_then(|origin| origin.strip_prefix("http://"));
        // of the same host: a page of localhost is not one of 127.0.0.1
        if host.is_some() && host == only(headers, HOST.as_str()) {
            return Ok(());
        }
        Err((StatusCode::FORBIDDEN, "the request is not from a page of this server"))
    }

    /// Refuses a request without the token.
    pub(crate) fn check_token(&self, token: Option<&str>) -> Result<(), Refused> {
        if token.is_some_and(|token| is_same(token.as_bytes(), self.token.as_bytes())) {
            return Ok(());
        }
        Err((StatusCode::UNAUTHORIZED, "the token is missing or wrong; open the address that bcap web printed"))
    }
}

/// Returns the value of a header that a request has once.
pub(crate) fn only<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    let mut values = headers.get_all(name).iter();
    let value = values.next()?.to_str().ok();
    if values.next().is_some() { None } else { value }
}

/// Compares in a time that does not depend on the content.
fn is_same(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |different, (a, b)| different | (a ^ b)) == 0
}

/// A token bucket: a burst, and then a rate.
#[derive(Debug)]
pub(crate) struct Bucket {
    left: f64,
    filled: tokio::time::Instant,
}

impl Bucket {
    const BURST: f64 = 40.0;
    const PER_SECOND: f64 = 20.0;

    pub(crate) fn new() -> Self {
        Self { left: Self::BURST, filled: tokio::time::Instant::now() }
    }

    /// Takes one, if one is left.
    pub(crate) fn take(&mut self) -> bool {
        let now = tokio::time::Instant::now();
        self.left = (self.left + (now - self.filled).as_secs_f64() * Self::PER_SECOND).min(Self::BURST);
        self.filled = now;
        let is_left = self.left >= 1.0;
        if is_left {
            self.left -= 1.0;
        }
        is_left
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_bucket_has_a_burst_and_a_rate() {
        let mut bucket = Bucket::new();
        assert_eq!((0..100).filter(|_| bucket.take()).count(), 40);
        tokio::time::advance(Duration::from_secs(1)).await;
        assert_eq!((0..100).filter(|_| bucket.take()).count(), 20);
    }

    #[test]
    fn a_header_that_comes_twice_is_none() {
        let mut headers = HeaderMap::new();
        headers.append(HOST, "a".parse().unwrap());
        assert_eq!(only(&headers, "host"), Some("a"));
        headers.append(HOST, "a".parse().unwrap());
        assert_eq!(only(&headers, "host"), None);
    }
}
