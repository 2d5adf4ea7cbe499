//! The users of a server that other computers can reach: a password, a limit of attempts, and the cookie of a session.

use std::collections::{BTreeMap, VecDeque};
use std::future::pending;
use std::net::IpAddr;
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

use axum::http::header::COOKIE;
use axum::http::{HeaderMap, StatusCode};
use tokio::sync::watch;
use tokio::time::{Instant, timeout_at};

use crate::secret::{Bucket, Refused, is_same, only, secret};
use crate::threads::lock;

/// The prefix of the cookie's name. With this prefix a browser accepts the cookie only over TLS and only for this host. The
/// port follows, because all servers of a host share its cookies.
const NAME: &str = "__Host-bcap-";

/// The lifetime of a session.
const LIFETIME: Duration = Duration::from_secs(12 * 3600);

/// The maximum number of sessions. A further one ends the oldest.
const SESSIONS: usize = 64;

/// The maximum number of hosts whose attempts are counted one by one. Further hosts share one count.
const HOSTS: usize = 1024;

/// Minimum length of a password, in characters.
pub(crate) const SHORTEST: usize = 12;

/// A password, and the sessions of its users.
pub(crate) struct Login {
    password: String,
    /// The name of the cookie.
    name: String,
    sessions: Mutex<VecDeque<Session>>,
    attempts: Mutex<BTreeMap<Option<IpAddr>, Bucket>>,
}

/// A session of a user. Its drop ends its pages.
struct Session {
    id: String,
    since: Instant,
    open: watch::Sender<()>,
}

/// The session of a request.
pub(crate) struct Open {
    since: Instant,
    open: watch::Receiver<()>,
}

impl Open {
    /// Waits for the end of a session. Waits forever on a server without a login.
    pub(crate) async fn ended(session: Option<Self>) {
        let Some(Self { since, mut open }) = session else { return pending().await };
        // no value is sent: the sender is dropped
        let _ = timeout_at(since + LIFETIME, open.changed()).await;
    }
}

impl Login {
    pub(crate) fn new(password: String, port: u16) -> Self {
        Self { password, name: format!("{NAME}{port}"), sessions: Mutex::default(), attempts: Mutex::default() }
    }

    fn sessions(&self) -> MutexGuard<'_, VecDeque<Session>> {
        let mut sessions = lock(&self.sessions);
        sessions.retain(|session| session.since.elapsed() < LIFETIME);
        sessions
    }

    /// Begins a session, and returns its cookie. A host may try 5 times, and then every 10 seconds.
    pub(crate) fn log_in(&self, host: IpAddr, password: &[u8]) -> Result<String, Refused> {
        if !self.may_try(host) {
            return Err((StatusCode::TOO_MANY_REQUESTS, "too many attempts; try again in 10 s"));
        }
        if !is_same(password, self.password.as_bytes()) {
            return Err((StatusCode::UNAUTHORIZED, "the password is wrong"));
        }
        let id = secret().map_err(|_| (StatusCode::INTERNAL_SERVER_ERROR, "the system has no random numbers"))?;
        let cookie = self.cookie(&id, LIFETIME.as_secs());
        let mut sessions = self.sessions();
        sessions.push_front(Session { id, since: Instant::now(), open: watch::Sender::new(()) });
        sessions.truncate(SESSIONS);
        Ok(cookie)
    }

    fn may_try(&self, host: IpAddr) -> bool {
        let mut attempts = lock(&self.attempts);
        // a socket at [::] shows 192.168.0.1 as ::ffff:192.168.0.1; one subscriber has 2^64 addresses of IPv6
        let host = match host.to_canonical() {
            IpAddr::V6(host) => IpAddr::V6((u128::from(host) >> 64 << 64).into()),
            host => host,
        };
        if attempts.len() >= HOSTS {
            attempts.retain(|_, bucket| !bucket.is_full());
        }
        let is_known = attempts.len() < HOSTS || attempts.contains_key(&Some(host));
        attempts.entry(is_known.then_some(host)).or_insert_with(|| Bucket::new(5, Duration::from_secs(10))).take()
    }

    /// Refuses a request without the cookie of a session.
    pub(crate) fn check(&self, headers: &HeaderMap) -> Result<Open, Refused> {
        let sessions = self.sessions();
        let session = self.find(&sessions, headers).and_then(|found| sessions.get(found)).ok_or(LOG_IN)?;
        Ok(Open { since: session.since, open: session.open.subscribe() })
    }

    /// Ends the session of a request, and returns the cookie that replaces its cookie.
    pub(crate) fn log_out(&self, headers: &HeaderMap) -> Result<String, Refused> {
        let mut sessions = self.sessions();
        self.find(&sessions, headers).and_then(|found| sessions.remove(found)).ok_or(LOG_IN)?;
        Ok(self.cookie("", 0))
    }

    fn cookie(&self, id: &str, seconds: u64) -> String {
        format!("{}={id}; Path=/; Secure; HttpOnly; SameSite=Strict; Max-Age={seconds}", self.name)
    }

    /// Returns the place of the session whose cookie a request has.
    fn find(&self, sessions: &VecDeque<Session>, headers: &HeaderMap) -> Option<usize> {
        let cookies = only(headers, COOKIE.as_str()).unwrap_or_default().split(';');
        let mut ids = cookies.filter_map(|cookie| cookie.trim().strip_prefix(self.name.as_str())?.strip_prefix('='));
        ids.find_map(|id| sessions.iter().position(|session| is_same(id.as_bytes(), session.id.as_bytes())))
    }
}

const LOG_IN: Refused = (StatusCode::UNAUTHORIZED, "log in first: open the page again");

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;

    fn headers(cookie: &str) -> HeaderMap {
        let id = cookie.split(';').next().unwrap();
        HeaderMap::from_iter([(COOKIE, format!("other=1; {id}").parse().unwrap())])
    }

    #[tokio::test(start_paused = true)]
    async fn attempts_are_limited_and_sessions_end() {
        let login = Login::new("correct horse battery".into(), 8011);
        let host = |last| IpAddr::V4(Ipv4Addr::new(192, 168, 0, last));
        let status =
            |host, password: &str| login.log_in(host, password.as_bytes()).map_err(|(status, _)| status.as_u16());
        let cookie = status(host(1), "correct horse battery").unwrap();
        assert!(cookie.ends_with("; Path=/; Secure; HttpOnly; SameSite=Strict; Max-Age=43200"), "{cookie}");
        let open = login.check(&headers(&cookie)).unwrap();
        assert_eq!(
            login.check(&headers("__Host-bcap-8011=")).map(drop).map_err(|(status, _)| status.as_u16()),
            Err(401)
        );
        for _ in 0..4 {
            assert_eq!(status(host(1), "correct horse batterz"), Err(401));
        }
        assert_eq!(status(host(1), "correct horse battery"), Err(429), "also with the right one");
        assert!(status(host(2), "correct horse battery").is_ok(), "another host is not locked out");
        tokio::time::advance(Duration::from_secs(10)).await;
        assert!(status(host(1), "correct horse battery").is_ok());
        // the pages of a session also end when its lifetime ends
        let start = Instant::now();
        Open::ended(Some(open)).await;
        assert_eq!(start.elapsed(), LIFETIME - Duration::from_secs(10));
        assert!(login.check(&headers(&cookie)).is_err());
    }

    #[tokio::test(start_paused = true)]
    async fn a_host_is_an_address_of_ipv4_or_a_network_of_ipv6() {
        let login = Login::new("correct horse battery".into(), 8011);
        let may_try = |host: &str| login.may_try(host.parse().unwrap());
        for host in ["::ffff:192.168.0.1", "2001:db8::1"] {
            assert!((0..5).all(|_| may_try(host)), "{host}");
            assert!(!may_try(host), "{host}");
        }
        assert!(may_try("::ffff:192.168.0.2"), "another host is not locked out");
        assert!(!may_try("192.168.0.1"), "the same host");
        assert!(!may_try("2001:db8::ffff:2"), "the same network");
        assert!(may_try("2001:db8:0:1::1"), "another network");
    }

    #[tokio::test(start_paused = true)]
    async fn hosts_that_tried_long_ago_are_forgotten() {
        let login = Login::new("correct horse battery".into(), 8011);
        let host = |number: usize| IpAddr::V4(Ipv4Addr::from_bits(number as u32));
        assert!((0..HOSTS).all(|number| login.may_try(host(number))));
        tokio::time::advance(Duration::from_secs(10)).await;
        assert_eq!((0..6).filter(|_| login.may_try(host(HOSTS))).count(), 5);
        assert!(login.may_try(host(HOSTS + 1)), "another host is not locked out");
    }
}
