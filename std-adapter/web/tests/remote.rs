//! A server that other computers can reach: TLS, the password, the cookie, the names.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::PathBuf;
use std::sync::Arc;

use bcap_web::{Config, Remote, Server};
use serde_json::json;
use tempfile::TempDir;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use tokio_tungstenite::tungstenite::client;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;

use crate::chromium::Browser;
use crate::states::begin_reload;
use crate::support::{LIMIT, Page, Sim, Web, access, until};

const PASSWORD: &str = "correct horse battery";

/// A connection of a client.
type Tls = StreamOwned<ClientConnection, TcpStream>;

/// A server at all addresses of this computer, with the name localhost.
struct Cell {
    sim: Sim,
    web: Web,
    host: String,
    files: TempDir,
}

impl Cell {
    fn start() -> Self {
        let (sim, files) = (Sim::start(), certificate());
        let folder = files.path().to_owned();
        let remote = move |config: &mut Config| {
            config.listen = "0.0.0.0:0".parse().unwrap();
            config.remote = Some(remote(&folder, PASSWORD, &["localhost"]));
        };
        let web = Web::with(&remote, &[("press", sim.address())], true);
        let host = web.url().strip_prefix("https://").unwrap().trim_end_matches('/').to_owned();
        Self { sim, web, host, files }
    }

    /// Connects over TLS.
    fn connect(&self) -> Tls {
        let mut roots = RootCertStore::empty();
        roots.add(CertificateDer::from_pem_file(self.files.path().join("cert.pem")).unwrap()).unwrap();
        let config = ClientConfig::builder_with_provider(Arc::new(default_provider()))
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(roots)
            .with_no_client_auth();
        let name = ServerName::try_from("localhost").unwrap();
        let stream = TcpStream::connect(("127.0.0.1", self.port())).unwrap();
        stream.set_read_timeout(Some(LIMIT)).unwrap();
        StreamOwned::new(ClientConnection::new(Arc::new(config), name).unwrap(), stream)
    }

    /// Sends a request over TLS, and returns the response.
    fn request(&self, first: &str, headers: &[(&str, &str)], body: &str) -> String {
        Self::exchange(self.connect(), first, headers, body)
    }

    fn exchange(mut stream: Tls, first: &str, headers: &[(&str, &str)], body: &str) -> String {
        let headers: String = headers.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
        let length = body.len();
        // in one piece, so that the server has all of it before it closes the connection
        let request =
            format!("{first} HTTP/1.1\r\n{headers}content-length: {length}\r\nconnection: close\r\n\r\n{body}");
        let _ = stream.write_all(request.as_bytes());
        let mut response = Vec::new();
        // the server may close without a farewell of TLS
        let _ = stream.read_to_end(&mut response);
        String::from_utf8_lossy(&response).into_owned()
    }

    fn port(&self) -> u16 {
        self.host.rsplit(':').next().unwrap().parse().unwrap()
    }

    /// Sends a request of the page itself.
    fn own(&self, first: &str, further: &[(&str, &str)], body: &str) -> String {
        let origin = format!("https://{}", self.host);
        self.request(first, &[&[("host", self.host.as_str()), ("origin", &origin)], further].concat(), body)
    }

    /// Opens a page.
    fn page(&self, cookie: &str) -> Page<Tls> {
        let mut request = format!("wss://{}/live", self.host).into_client_request().unwrap();
        for (name, value) in [("origin", &*format!("https://{}", self.host)), ("cookie", cookie), UPGRADE[4]] {
            request.headers_mut().insert(name, value.parse().unwrap());
        }
        Page::new(client(request, self.connect()).unwrap().0)
    }

    /// Logs in, and returns the cookie.
    fn log_in(&self) -> String {
        let response = self.own("POST /login", &[], PASSWORD);
        assert_eq!(status(&response), "204", "{response}");
        response.split("set-cookie: ").nth(1).unwrap().lines().next().unwrap().to_owned()
    }
}

/// Creates a certificate of localhost, and its key.
fn certificate() -> TempDir {
    let files = tempfile::tempdir().unwrap();
    let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    std::fs::write(files.path().join("cert.pem"), made.cert.pem()).unwrap();
    std::fs::write(files.path().join("key.pem"), made.signing_key.serialize_pem()).unwrap();
    files
}

fn remote(folder: &std::path::Path, password: &str, names: &[&str]) -> Remote {
    Remote {
        certificate: folder.join("cert.pem"),
        key: folder.join("key.pem"),
        password: password.into(),
        names: names.iter().map(|name| (*name).to_owned()).collect(),
    }
}

fn status(response: &str) -> &str {
    response.split(' ').nth(1).unwrap_or(response)
}

const UPGRADE: [(&str, &str); 5] = [
    ("connection", "upgrade"),
    ("upgrade", "websocket"),
    ("sec-websocket-version", "13"),
    ("sec-websocket-key", "dGhlIHNhbXBsZSBub25jZQ=="),
    ("sec-websocket-protocol", "bcap.live, token.0123456789"),
];

#[test]
fn a_user_needs_tls_the_password_the_cookie_and_the_name() {
    let cell = Cell::start();
    assert!(!cell.web.url().contains("token"), "{}", cell.web.url());
    assert_eq!(status(&cell.own("GET /session", &[], "")), "401");
    assert_eq!(status(&cell.own("POST /halt/0", &[], "")), "401");
    assert_eq!(status(&cell.own("GET /live", &UPGRADE, "")), "401", "a token does not suffice");
    let cookie = cell.log_in();
    let name = format!("__Host-bcap-{}=", cell.port());
    for part in [name.as_str(), "; Path=/", "; Secure", "; HttpOnly", "; SameSite=Strict"] {
        assert!(cookie.contains(part), "{cookie}");
    }
    let cookie = ("cookie", cookie.split(';').next().unwrap());
    assert_eq!(status(&cell.own("GET /session", &[cookie], "")), "204");
    let halted = cell.own("POST /halt/0", &[cookie], "");
    assert!(status(&halted) == "200" && halted.contains("the robot was at rest"), "{halted}");
    // the cookie of the user's browser does not help the page of another site, nor a name that is bound to this address
    let other = [("host", cell.host.as_str()), ("origin", "https://evil.example"), cookie];
    assert_eq!(status(&cell.request("POST /halt/0", &other, "")), "403");
    let plain = format!("http://{}", cell.host);
    assert_eq!(status(&cell.request("POST /halt/0", &[other[0], ("origin", &plain), cookie], "")), "403");
    let rebound = format!("evil.example:{}", cell.port());
    assert_eq!(status(&cell.request("GET /", &[("host", &rebound)], "")), "421");
    assert_eq!(status(&cell.request("GET /", &[("host", "127.0.0.1")], "")), "421");
    // the last cookie belongs to a server at another port
    let other = cookie.1.replace(&name, "__Host-bcap-1=");
    for wrong in [name.clone(), format!("{name}0000"), "bcap=1".into(), other] {
        assert_eq!(status(&cell.own("GET /session", &[("cookie", &wrong)], "")), "401", "{wrong}");
    }
    let lines = cell.web.lines();
    assert!(lines.contains(&"server: 127.0.0.1: logs in: done".to_owned()), "{lines:?}");
}

/// Logs out during a jog, and returns why the jog has ended. The page of another user shows who has the control.
fn jog_until_logout(cell: &Cell, cookie: &str, other: &mut Page<Tls>) -> String {
    let mut page = cell.page(cookie);
    page.until_state("ready, motor off");
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    page.order("show", json!({ "robot": 0, "screen": "jog" })).unwrap();
    let mut stream = cell.connect();
    stream.conn.complete_io(&mut stream.sock).unwrap();
    // it must read within 10 s
    other.until("tiles", |tiles| tiles[0]["holder"] == "Anna");
    let ended = cell.web.ended_jogs();
    page.order("grip", json!({ "robot": 0, "name": "press" })).unwrap();
    // the section may still be the one of the last jog
    page.until("jog", |jog| jog["phase"] == "ready" || cell.web.ended_jogs() > ended);
    page.send("press", json!({ "robot": 0, "axis": "J1", "by": 1.0, "percent": 1.0 }));
    let response = std::thread::scope(|scope| {
        let logout = scope.spawn(|| {
            let origin = format!("https://{}", cell.host);
            let headers = [("host", cell.host.as_str()), ("origin", &origin), ("cookie", cookie)];
            Cell::exchange(stream, "POST /logout", &headers, "")
        });
        // the page answers its pulses until the server closes it
        while page.receive().is_some() {}
        logout.join().unwrap()
    });
    assert_eq!(status(&response), "204", "{response}");
    let cleared = format!("set-cookie: __Host-bcap-{}=; Path=/;", cell.port());
    assert!(response.contains(&cleared) && response.contains("Max-Age=0"), "{response}");
    // a jog begins with a line, and ends with one
    let jogs = || {
        cell.web
            .lines()
            .into_iter()
            .filter(|line| line.ends_with("begins a jog: done") || line.contains("the jog ends"))
    };
    until("the jog has ended", || jogs().count() % 2 == 0);
    jogs().next_back().unwrap()
}

/// A logout ends the motions and the control of the pages of this session only.
#[test]
fn a_user_who_logs_out_holds_nothing() {
    let cell = Cell::start();
    let log_in = || cell.log_in().split(';').next().unwrap().to_owned();
    let (mut anna, bob) = (log_in(), log_in());
    // another page, and a request without the session, log no user out
    assert_eq!(status(&cell.own("GET /logout", &[("cookie", &anna)], "")), "405");
    let evil = [("host", cell.host.as_str()), ("origin", "https://evil.example"), ("cookie", &anna)];
    assert_eq!(status(&cell.request("POST /logout", &evil, "")), "403");
    assert_eq!(status(&cell.own("POST /logout", &[], "")), "401");
    assert_eq!(status(&cell.own("POST /logout", &[("cookie", "__Host-bcap-1=")], "")), "401");
    assert_eq!(status(&cell.own("GET /session", &[("cookie", &anna)], "")), "204", "still logged in");
    let expected = "press: Anna: the jog ends: the page is closed; the robot rests, and the arm is free: done";
    let mut other = cell.page(&bob);
    let mut ended = jog_until_logout(&cell, &anna, &mut other);
    // a machine under load may lose a heartbeat before the logout, and the halt leaves an error
    for _ in 0..5 {
        if ended != expected {
            cell.sim.lock().clear_errors(bcap_std::now());
            (anna, other) = (log_in(), cell.page(&bob));
            ended = jog_until_logout(&cell, &anna, &mut other);
        }
    }
    assert_eq!(ended, expected);
    other.until("tiles", |tiles| tiles[0]["holder"].is_null());
    let lines = cell.web.lines();
    assert!(lines.contains(&"press: Anna: the page is closed, the control is free: done".to_owned()), "{lines:?}");
    assert!(!cell.sim.lock().is_moving() && !cell.sim.lock().motor_is_on());
    // the old cookie gives no access
    let cookie = ("cookie", anna.as_str());
    for first in ["GET /session", "POST /halt/0", "POST /logout", "POST /packets/0"] {
        assert_eq!(status(&cell.own(first, &[cookie], "")), "401", "{first}");
    }
    assert_eq!(status(&cell.own("GET /live", &[&UPGRADE[..], &[cookie]].concat(), "")), "401");
    // another user is not affected
    assert_eq!(status(&cell.own("GET /session", &[("cookie", &bob)], "")), "204");
    assert_eq!(other.order("take", json!({ "robot": 0, "name": "Bob" })), Ok(json!(null)));
}

#[test]
fn attempts_are_limited_and_plain_http_gets_nothing() {
    let cell = Cell::start();
    assert_eq!(status(&cell.own("GET /login", &[], "")), "405", "no login by GET");
    let other = [("host", cell.host.as_str()), ("origin", "https://evil.example")];
    assert_eq!(status(&cell.request("POST /login", &other, PASSWORD)), "403");
    assert_eq!(status(&cell.own("POST /login", &[], &"x".repeat(2000))), "413");
    for _ in 0..5 {
        assert_eq!(status(&cell.own("POST /login", &[], "wrong")), "401");
    }
    let refused = cell.own("POST /login", &[], PASSWORD);
    assert!(status(&refused) == "429" && refused.contains("too many attempts; try again in 10 s"), "{refused}");
    let mut plain = TcpStream::connect(("127.0.0.1", cell.port())).unwrap();
    plain.set_read_timeout(Some(LIMIT)).unwrap();
    // the server may close the connection at the first byte
    let _ = write!(plain, "GET / HTTP/1.1\r\nhost: {}\r\n\r\n", cell.host);
    let mut bytes = Vec::new();
    let _ = plain.read_to_end(&mut bytes);
    assert!(!bytes.windows(5).any(|part| part == b"HTTP/"), "an alert of TLS at most");
}

#[tokio::test]
async fn a_server_without_all_of_it_does_not_start() {
    let files = certificate();
    let robot = || vec![("press".to_owned(), access("127.0.0.1:1".parse().unwrap()))];
    let bind = async |remote: Remote| {
        let config = Config { remote: Some(remote), ..Config::new("0.0.0.0:0".parse().unwrap(), robot()) };
        Server::bind(config, |_| {}).await.unwrap_err().to_string()
    };
    let short = bind(remote(files.path(), "short", &["localhost"])).await;
    assert_eq!(short, "the password has 5 characters; it needs at least 12");
    let nameless = bind(remote(files.path(), PASSWORD, &[])).await;
    assert!(nameless.contains("give --name with the name in the certificate"), "{nameless}");
    let mut no_key = remote(files.path(), PASSWORD, &["localhost"]);
    no_key.key = PathBuf::from("/no/such/key.pem");
    let no_key = bind(no_key).await;
    assert!(no_key.starts_with("TLS: /no/such/key.pem: "), "{no_key}");
    let mut swapped = remote(files.path(), PASSWORD, &["localhost"]);
    std::mem::swap(&mut swapped.certificate, &mut swapped.key);
    let swapped = bind(swapped).await;
    assert!(swapped.contains("key.pem: there is no certificate in PEM"), "{swapped}");
}

/// The server starts again with its robots in another order, and later without one of them.
#[test]
fn an_open_page_finds_its_robot_after_a_restart() {
    let (sims, files) = ([Sim::start(), Sim::start()], certificate());
    let start = |port: u16, robots: &[(&str, usize)]| {
        let configure = |config: &mut Config| {
            config.listen = ([0, 0, 0, 0], port).into();
            config.remote = Some(remote(files.path(), PASSWORD, &["localhost"]));
        };
        let robots: Vec<_> = robots.iter().map(|(name, sim)| (*name, sims[*sim].address())).collect();
        Web::with(&configure, &robots, true)
    };
    let web = start(0, &[("press", 0), ("welder", 1)]);
    let port = web.url().rsplit(':').next().unwrap().trim_end_matches('/').parse().unwrap();
    let Some(mut browser) = Browser::with(&["--ignore-certificate-errors"]) else { return };
    let tabs = [browser.open_page(), browser.open_page()];
    browser.turn_to(&tabs[0]);
    browser.open(web.url());
    let log_in = |browser: &mut Browser| {
        browser.until("document.getElementById('password') !== null");
        browser.enter("#password", PASSWORD);
        browser.until("document.getElementById('password') === null");
        browser.until_text("#state", "ready, motor off");
    };
    log_in(&mut browser);
    browser.turn_to(&tabs[1]);
    browser.open(web.url());
    browser.click(".tile:nth-child(2) .head + * ~ button");
    browser.until_text("#halt-robot", "welder");
    browser.turn_to(&tabs[0]);
    browser.click(".tile:nth-child(2) .head + * ~ button");
    browser.until_text("#halt-robot", "welder");
    let shown = "[...document.getElementById('robots').options].map((option) => option.text).join() + ': ' + document.getElementById('robots').selectedOptions[0].text";
    assert_eq!(browser.eval(shown), "press,welder: welder");
    browser.click("[data-id=variables]");
    drop(web);
    let web = start(port, &[("welder", 1), ("press", 0)]);
    log_in(&mut browser);
    browser.until(&format!("({shown}) === 'welder,press: welder'"));
    browser.until_text("#halt-robot", "welder");
    browser.click("#halt");
    browser.until_text("#notice", "welder: the robot was at rest");
    until("HALT is in the audit", || web.lines().iter().any(|line| line.starts_with("welder: a page: HALT")));
    // the other tab, which has the numbers of the first server, is logged in with this one
    browser.turn_to(&tabs[1]);
    browser.click("#login-halt");
    until("HALT is in the audit again", || {
        web.lines().iter().filter(|line| line.contains(": a page: HALT")).count() == 2
    });
    assert!(!web.lines().iter().any(|line| line.starts_with("press: a page: HALT")), "{:?}", web.lines());
    browser.turn_to(&tabs[0]);
    drop(web);
    let web = start(port, &[("press", 0)]);
    log_in(&mut browser);
    browser.until_text("header .alerts", "welder is no longer a robot of bcap web: this page shows press");
    assert_eq!(browser.eval(shown), "press: press");
    drop(web);
}

/// A person logs in, works and reloads the page.
#[test]
fn a_browser_logs_in_and_stays_logged_in() {
    let cell = Cell::start();
    let Some(mut browser) = Browser::with(&["--ignore-certificate-errors"]) else { return };
    browser.open(cell.web.url());
    browser.until("document.getElementById('password') !== null");
    assert_eq!(browser.eval("document.activeElement.id"), "password");
    browser.click("#login-halt");
    browser.until_text("#login-why", "NOT HALTED, use the emergency stop: log in first");
    browser.enter("#password", "wrong");
    browser.until_text("#login-why", "the password is wrong");
    browser.enter("#password", PASSWORD);
    browser.until_text("#state", "ready, motor off");
    assert_eq!(browser.eval("document.cookie"), "", "scripts do not see the cookie");
    begin_reload(&mut browser);
    browser.until_text("#state", "ready, motor off");
    browser.click("#halt");
    browser.until_text("#notice", "press: the robot was at rest");
    browser.click("[data-id=session]");
    browser.until("!document.getElementById('log-out').hidden");
    browser.click("#log-out");
    browser.until("document.getElementById('password') !== null");
    browser.enter("#password", PASSWORD);
    browser.until_text("#state", "ready, motor off");
}
