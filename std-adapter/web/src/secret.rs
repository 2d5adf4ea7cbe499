//! Secrets, headers and rates: what the checks of requests need.

use axum::http::{HeaderMap, StatusCode};

/// A refused request: the status and why.
pub(crate) type Refused = (StatusCode, &'static str);

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
#[derive(Debug)]
pub(crate) struct Bucket {
    burst: f64,
    per_second: f64,
    left: f64,
    filled: tokio::time::Instant,
}

impl Bucket {
    /// Returns the bucket of the orders of a page.
    pub(crate) fn new() -> Self {
        Self::with(40.0, 20.0)
    }

    pub(crate) fn with(burst: f64, per_second: f64) -> Self {
        Self { burst, per_second, left: burst, filled: tokio::time::Instant::now() }
    }

    /// Takes one, if one is left.
    pub(crate) fn take(&mut self) -> bool {
        let now = tokio::time::Instant::now();
        self.left = (self.left + (now - self.filled).as_secs_f64() * self.per_second).min(self.burst);
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

    use axum::http::header::HOST;

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
