//! Tests the HTTP server over two embassy-net stacks connected by a simulated cable.

use std::fmt::Write;

use crate::common::{address, between};
use bcap_embassy::http::{Body, Content, Decision, HttpListener, Method, Request, Site, Status};
use bcap_embassy::net::{Backlog, Options};
use bcap_test_support::frames;
use embassy_futures::join::join;
use embassy_futures::select::{Either, select};
use embassy_net::tcp::TcpSocket;
use embassy_net::{IpEndpoint, Stack};
use embassy_time::{Duration, Timer, with_timeout};

/// Sends bytes on a new connection and returns all that is sent back.
async fn exchange(stack: Stack<'_>, request: &[u8]) -> String {
    let [mut rx, mut tx] = [[0; 512]; 2];
    let mut socket = TcpSocket::new(stack, &mut rx, &mut tx);
    while socket.connect((address(1), 80)).await.is_err() {
        Timer::after_millis(1).await;
    }
    for part in request.chunks(100) {
        let mut sent = 0;
        while sent < part.len() {
            sent += socket.write(&part[sent..]).await.unwrap();
        }
    }
    let mut response = Vec::new();
    loop {
        let mut bytes = [0; 64];
        match socket.read(&mut bytes).await {
            Ok(count @ 1..) => response.extend_from_slice(&bytes[..count]),
            Ok(0) => return String::from_utf8(response).unwrap(),
            Err(_) => return "reset".to_owned(),
        }
    }
}

fn answer(path: &str, page: &mut dyn Write) -> Option<Content> {
    match path {
        "/" => write!(page, "<p>up").ok().map(|()| Content::Html),
        "/long" => write!(page, "{}", "x".repeat(1000)).ok().map(|()| Content::Text),
        "/too-long" => write!(page, "{}", "x".repeat(1001)).ok().map(|()| Content::Text),
        _ => None,
    }
}

fn response(status: &str, rest: &str) -> String {
    format!("HTTP/1.1 {status}\r\nConnection: close\r\nCache-Control: no-store\r\n{rest}")
}

#[test]
fn pages_are_read_and_nothing_else_is_possible() {
    between(|_, clients, board| async move {
        let ([mut rx, mut tx], mut page) = ([[0; 512]; 2], [0; 1192]);
        let mut listener = HttpListener::new(board, 80, [&mut rx, &mut tx], &mut page, Options::default());
        let test = with_timeout(Duration::from_secs(60), async {
            let html = "Content-Type: text/html; charset=utf-8\r\nContent-Length: 5\r\n\r\n";
            let get = exchange(clients, b"GET / HTTP/1.1\r\nHost: board\r\n\r\n").await;
            assert_eq!(get, response("200 OK", &format!("{html}<p>up")));
            assert_eq!(exchange(clients, b"HEAD / HTTP/1.1\r\n\r\n").await, response("200 OK", html));
            let long = exchange(clients, b"GET /long HTTP/1.1\r\n\r\n").await;
            assert!(long.contains("Content-Length: 1000\r\n") && long.ends_with(&"x".repeat(1000)), "{long}");
            for (request, status) in [
                (&b"GET /too-long HTTP/1.1\r\n\r\n"[..], "500 Internal Server Error"),
                (b"GET /other HTTP/1.1\r\n\r\n", "404 Not Found"),
                (b"PUT / HTTP/1.1\r\n\r\n", "405 Method Not Allowed\r\nAllow: GET, HEAD"),
                (b"POST / HTTP/1.1\r\nContent-Length: 0\r\n\r\n", "405 Method Not Allowed\r\nAllow: GET, HEAD"),
                (b"GET:RC8:1:I:\r\n\r\n", "400 Bad Request"),
            ] {
                assert_eq!(exchange(clients, request).await, response(status, "Content-Length: 0\r\n\r\n"));
            }
            let large = [&b"GET / HTTP/1.1\r\nCookie: "[..], &[b'x'; 1200]].concat();
            assert!(exchange(clients, &large).await.starts_with("HTTP/1.1 431 "));
        });
        let ended = select(listener.run(|_| true, answer), test).await;
        assert!(matches!(ended, Either::Second(Ok(()))), "it hangs");
    });
}

#[test]
fn a_client_that_is_not_admitted_gets_a_reset() {
    between(|_, clients, board| async move {
        let ([mut rx, mut tx], mut page) = ([[0; 512]; 2], [0; 400]);
        let mut listener = HttpListener::new(board, 80, [&mut rx, &mut tx], &mut page, Options::default());
        let test = with_timeout(Duration::from_secs(60), async {
            assert_eq!(exchange(clients, b"GET / HTTP/1.1\r\n\r\n").await, "reset");
        });
        let ended = select(listener.run(|client| client.is_none(), answer), test).await;
        assert!(matches!(ended, Either::Second(Ok(()))), "it hangs");
    });
}

/// Creates the frame that begins a connection to the page, from a machine that does not exist.
fn syn(number: u8) -> Vec<u8> {
    frames::syn([2, 0, 0, 0, 0, 1], address(100 + number), address(1), [50_000, 80])
}

/// Runs a test with two listeners, whose handshakes have no time limit.
async fn with_two_listeners(board: Stack<'static>, backlog: &'static Backlog, test: impl Future<Output = ()>) {
    let memory = &mut [([[0; 512]; 2], [0; 1192]); 2];
    let options = Options { connect_timeout: Duration::from_secs(3600), backlog: Some(backlog), ..Options::default() };
    let [mut first, mut second] =
        memory.each_mut().map(|([rx, tx], page)| HttpListener::new(board, 80, [rx, tx], page, options));
    let listeners = join(first.run(|_| true, answer), second.run(|_| true, answer));
    let ended = select(listeners, with_timeout(Duration::from_secs(60), test)).await;
    assert!(matches!(ended, Either::Second(Ok(()))), "it hangs");
}

const GET: &[u8] = b"GET / HTTP/1.1\r\n\r\n";

#[test]
fn half_open_connections_leave_a_listener_free() {
    static BACKLOG: Backlog = Backlog::new();
    between(|cable, clients, board| async move {
        let test = async {
            for round in 0..10 {
                for number in 0..6 {
                    cable.send(1, syn(10 * round + number));
                    Timer::after_millis(2).await;
                }
                assert!(exchange(clients, GET).await.ends_with("<p>up"));
            }
        };
        with_two_listeners(board, &BACKLOG, test).await;
    });
}

#[test]
fn a_handshake_that_does_not_end_is_given_up() {
    between(|cable, clients, board| async move {
        let ([mut rx, mut tx], mut page) = ([[0; 512]; 2], [0; 400]);
        let options = Options { connect_timeout: Duration::from_millis(200), ..Options::default() };
        let mut listener = HttpListener::new(board, 80, [&mut rx, &mut tx], &mut page, options);
        let test = with_timeout(Duration::from_secs(60), async {
            cable.send(1, syn(0));
            assert!(exchange(clients, GET).await.ends_with("<p>up"));
        });
        let ended = select(listener.run(|_| true, answer), test).await;
        assert!(matches!(ended, Either::Second(Ok(()))), "it hangs");
    });
}

#[test]
fn the_oldest_unfinished_request_makes_room_for_a_new_client() {
    static BACKLOG: Backlog = Backlog::new();
    between(|_, clients, board| async move {
        let test = async {
            let mut memory = [[[0; 512]; 2]; 2];
            let mut slow = memory.each_mut().map(|[rx, tx]| TcpSocket::new(clients, rx, tx));
            for round in 0..20 {
                let client = &mut slow[round % 2];
                client.abort();
                // waits until the reset is sent
                let _ = client.flush().await;
                while client.connect((address(1), 80)).await.is_err() {
                    Timer::after_millis(1).await;
                }
                client.write(b"GET / HT").await.unwrap();
                assert!(exchange(clients, GET).await.ends_with("<p>up"), "round {round}");
            }
        };
        with_two_listeners(board, &BACKLOG, test).await;
    });
}

/// A site that takes bodies from clients with the header `Authorization: yes`, and shows the last body.
#[derive(Default)]
struct Note(std::cell::RefCell<String>);

impl<'s> Site<'s> for Note {
    type Page = (Status, &'static str);

    fn admits(&self, client: Option<IpEndpoint>) -> bool {
        client.is_some()
    }

    fn decide(&self, request: &Request<'_>) -> Decision<Self::Page> {
        match (request.method, request.authorization) {
            (Method::Post, Some("yes")) if request.client.is_some() => Decision::Receive,
            (Method::Post, _) => Decision::Answer((Status::Unauthorized, "no")),
            _ => Decision::Answer((Status::Ok, "")),
        }
    }

    async fn take(&self, memory: &'s mut [u8], len: usize) -> (&'s mut [u8], Self::Page) {
        // as long as another task does
        Timer::after_millis(20).await;
        *self.0.borrow_mut() = std::str::from_utf8(&memory[..len]).unwrap().to_owned();
        (memory, (Status::Ok, "taken: "))
    }

    fn write(&self, (status, text): Self::Page, out: &mut Body<'_>) -> Option<(Status, Content)> {
        let note = self.0.borrow();
        let note = if status == Status::Ok { &note } else { "" };
        write!(out, "{text}{note}").ok().map(|()| (status, Content::Text))
    }
}

/// Runs a test of a client with a board that has one listener, with 1,000 bytes for a request.
fn with_notes(test: impl AsyncFnOnce(Stack<'_>)) {
    between(|_, clients, board| async move {
        let ([mut rx, mut tx], mut page) = ([[0; 256]; 2], [0; 1000]);
        let mut listener = HttpListener::new(board, 80, [&mut rx, &mut tx], &mut page, Options::default());
        let site = Note::default();
        let test = with_timeout(Duration::from_secs(60), test(clients));
        let ended = select(listener.run_site(&site), test).await;
        assert!(matches!(ended, Either::Second(Ok(()))), "it hangs");
    });
}

fn post(body: &str) -> Vec<u8> {
    format!("POST /n HTTP/1.1\r\nAuthorization: yes\r\nContent-Length: {}\r\n\r\n{body}", body.len()).into()
}

fn text(status: &str, body: &str) -> String {
    response(
        status,
        &format!("Content-Type: text/plain; charset=utf-8\r\nContent-Length: {}\r\n\r\n{body}", body.len()),
    )
}

#[test]
fn a_body_is_received_if_the_site_wants_it_and_all_memory_is_for_it() {
    with_notes(async |clients| {
        // with its head in one segment, and in many
        for len in [0, 1, 30, 250, 793] {
            let body = "x".repeat(len);
            assert_eq!(exchange(clients, &post(&body)).await, text("200 OK", &format!("taken: {body}")), "{len}");
            let shown = if len > 0 { text("200 OK", &body) } else { response("200 OK", NO_BODY) };
            assert_eq!(exchange(clients, GET).await, shown, "{len}");
        }
        // bytes after the body are not a part of it
        let more = [&post("abc")[..], b"def"].concat();
        assert!(exchange(clients, &more).await.ends_with("taken: abc"));
        // the body fits, but not the page with it
        assert_eq!(exchange(clients, &post(&"y".repeat(1000))).await, response("500 Internal Server Error", NO_BODY));
        // refused by its head
        let long = &post(&"y".repeat(1001))[..80];
        assert_eq!(exchange(clients, long).await, response("413 Content Too Large", NO_BODY));
        let without = "401 Unauthorized\r\nWWW-Authenticate: Basic realm=\"board\"";
        assert_eq!(exchange(clients, b"POST /n HTTP/1.1\r\nContent-Length: 3\r\n\r\nabc").await, text(without, "no"));
        for (length, status) in [
            ("", "411 Length Required"),
            ("Content-Length: x\r\n", "400 Bad Request"),
            ("Content-Length: 1\r\nContent-Length: 1\r\n", "400 Bad Request"),
            ("Transfer-Encoding: chunked\r\n", "411 Length Required"),
        ] {
            let request = format!("POST /n HTTP/1.1\r\nAuthorization: yes\r\n{length}\r\nabc");
            assert_eq!(exchange(clients, request.as_bytes()).await, response(status, NO_BODY), "{length}");
        }
    });
}

const NO_BODY: &str = "Content-Length: 0\r\n\r\n";

#[test]
fn a_body_that_does_not_end_is_given_up() {
    with_notes(async |clients| {
        let [mut rx, mut tx] = [[0; 512]; 2];
        let mut slow = TcpSocket::new(clients, &mut rx, &mut tx);
        slow.connect((address(1), 80)).await.unwrap();
        let request = post("abcdef");
        slow.write(&request[..request.len() - 1]).await.unwrap();
        // the next client waits until the time of this one is over
        assert_eq!(exchange(clients, GET).await, response("200 OK", NO_BODY));
        let mut byte = [0];
        assert_eq!(slow.read(&mut byte).await, Ok(0), "closed without an answer");
    });
}
