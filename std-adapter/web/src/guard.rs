//! Checks of requests: only a page of this server, opened with its token, may request anything but the files of the page.
//!
//! A page of another site can send requests to this server from the user's browser. It cannot read the token, its `Origin`
//! differs, and after DNS rebinding its `Host` is the name of that site.

use std::net::SocketAddr;

use axum::http::header::{HOST, ORIGIN};
use axum::http::{HeaderMap, StatusCode};

use crate::config::Remote;
use crate::login::{Login, Open};
use crate::secret::{Refused, is_same, only, secret};

const OTHER_HOST: Refused =
    (StatusCode::MISDIRECTED_REQUEST, "this is not the host of the page; open the address that bcap web printed");

/// The header with the token of a request.
pub(crate) const TOKEN: &str = "x-bcap-token";

/// The token and the names of this server.
pub(crate) struct Guard {
    token: String,
    /// The names with which a request may reach this server.
    hosts: Vec<String>,
    /// The beginning of an origin.
    scheme: &'static str,
    /// The users of a server that other computers can reach. The token is not enough there.
    pub(crate) login: Option<Login>,
}

impl Guard {
    /// Draws the token of a server. The first host is printed.
    pub(crate) fn new(address: SocketAddr, remote: Option<Remote>) -> Result<Self, getrandom::Error> {
        let (token, port) = (secret()?, address.port());
        let (names, scheme, default_port, login) = match remote {
            None => (vec!["localhost".into()], "http://", 80, None),
            Some(Remote { names, password, .. }) => (names, "https://", 443, Some(Login::new(password, port))),
        };
        let named = names.iter().map(|name| format!("{name}:{port}"));
        let mut hosts: Vec<_> = match login {
            None => std::iter::once(address.to_string()).chain(named).collect(),
            Some(_) => named.chain((!address.ip().is_unspecified()).then(|| address.to_string())).collect(),
        };
        if port == default_port {
            // browsers leave it out
            let short = |host: &String| host.strip_suffix(&format!(":{port}")).map(str::to_owned);
            hosts.extend(hosts.iter().filter_map(short).collect::<Vec<_>>());
        }
        Ok(Self { token, hosts, scheme, login })
    }

    /// Returns the address of the page. Without a login it has the token.
    pub(crate) fn url(&self) -> String {
        let host = self.hosts.first().map(String::as_str).unwrap_or_default();
        match self.login {
            // after `#`, the token is in no request, and so in no log
            None => format!("{}{host}/#token={}", self.scheme, self.token),
            Some(_) => format!("{}{host}/", self.scheme),
        }
    }

    /// Refuses a request for another host: a name of another site may have been bound to this address.
    pub(crate) fn check_host(&self, headers: &HeaderMap) -> Result<(), Refused> {
        let host = only(headers, HOST.as_str()).unwrap_or_default();
        let is_own = self.hosts.iter().any(|known| known.eq_ignore_ascii_case(host));
        is_own.then_some(()).ok_or(OTHER_HOST)
    }

    /// Refuses a request of a page of another origin, and one without an origin.
    pub(crate) fn check_origin(&self, headers: &HeaderMap) -> Result<(), Refused> {
        let host = only(headers, ORIGIN.as_str()).and_then(|origin| origin.strip_prefix(self.scheme));
        // of the same host: a page of localhost is not one of 127.0.0.1
        let is_own = host.is_some() && host == only(headers, HOST.as_str());
        is_own.then_some(()).ok_or((StatusCode::FORBIDDEN, "the request is not from a page of this server"))
    }

    /// Refuses a request without the token; of a server with a password, a request without the cookie of a login.
    pub(crate) fn check_user(&self, headers: &HeaderMap, token: Option<&str>) -> Result<Option<Open>, Refused> {
        if let Some(login) = &self.login {
            return login.check(headers).map(Some);
        }
        if token.is_some_and(|token| is_same(token.as_bytes(), self.token.as_bytes())) {
            return Ok(None);
        }
        Err((StatusCode::UNAUTHORIZED, "the token is missing or wrong; open the address that bcap web printed"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_browser_leaves_out_the_default_port() {
        let allowed = |guard: &Guard, host: &str| {
            guard.check_host(&HeaderMap::from_iter([(HOST, host.parse().unwrap())])).is_ok()
        };
        let guard = Guard::new("127.0.0.1:80".parse().unwrap(), None).unwrap();
        assert_eq!(
            ["127.0.0.1", "localhost", "127.0.0.1:80", "cell"].map(|host| allowed(&guard, host)),
            [true, true, true, false]
        );
        let remote =
            || Remote { certificate: "c".into(), key: "k".into(), password: "p".into(), names: vec!["cell".into()] };
        let guard = Guard::new("192.168.0.9:443".parse().unwrap(), Some(remote())).unwrap();
        assert_eq!(
            ["192.168.0.9", "cell", "cell:443", "localhost"].map(|host| allowed(&guard, host)),
            [true, true, true, false]
        );
        assert_eq!(guard.url(), "https://cell:443/");
        let guard = Guard::new("192.168.0.9:8011".parse().unwrap(), Some(remote())).unwrap();
        assert_eq!(["cell:8011", "cell"].map(|host| allowed(&guard, host)), [true, false]);
    }
}
