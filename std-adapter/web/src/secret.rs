//! Secrets, headers and rates: what the checks of requests need.

use std::time::Duration;

use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use tokio::time::Instant;

/// A refused request: the status and why.
pub(crate) type Refused = (StatusCode, &'static str);

/// The response to a request that was not refused.
pub(crate) type Checked = Result<Response, Refused>;

/// Returns the value of a header that a request has once.
pub(crate) fn only<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    let mut values = headers.get_all(name).iter();
    let value = values.next()?.to_str().ok();
    if values.next().is_some() { None } else { value }
}

/// Draws 192 bits, as hexadecimal.
pub(crate) fn secret() -> Result<String, getrandom::Error> {
    let mut bytes = [0; 24];
    getrandom::fill(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Compares in a time that does not depend on the content.
pub(crate) fn is_same(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |different, (a, b)| different | (a ^ b)) == 0
}

/// A token bucket: a burst, and then a rate.
pub(crate) struct Bucket {
    burst: u32,
    interval: Duration,
    /// When all tokens are back.
    full_at: Instant,
}

impl Bucket {
    /// Returns a full bucket, which gets a token back after each interval.
    pub(crate) fn new(burst: u32, interval: Duration) -> Self {
        Self { burst, interval, full_at: Instant::now() }
    }

    /// Returns whether all tokens are there.
    pub(crate) fn is_full(&self) -> bool {
        self.full_at <= Instant::now()
    }

    /// Takes a token, if one is left.
    pub(crate) fn take(&mut self) -> bool {
        let now = Instant::now();
        let full_at = self.full_at.max(now) + self.interval;
        let is_left = full_at - now <= self.interval * self.burst;
        if is_left {
            self.full_at = full_at;
        }
        is_left
    }
}

#[cfg(test)]
mod tests {
    use axum::http::header::HOST;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_bucket_has_a_burst_and_a_rate() {
        let mut bucket = Bucket::new(40, Duration::from_millis(50));
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
