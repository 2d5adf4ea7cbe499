//! A small HTTP server for pages that only show something, such as the health of a board.
//!
//! It answers GET and HEAD, one request a connection, from a buffer of the caller, and uses nothing of a request but its path.
//! picoserve has routes, headers and request bodies; its MSRV (1.93) is above this crate's, and a page needs none of them.
//!
//! # Examples
//!
//! ```
//! use core::fmt::Write;
//!
//! use bcap_embassy::http::{Content, HttpListener};
//! use bcap_embassy::net::Options;
//! use embassy_net::Stack;
//!
//! async fn serve(stack: Stack<'_>) -> ! {
//!     let ([mut rx, mut tx], mut page) = ([[0; 512]; 2], [0; 1024]);
//!     let mut listener = HttpListener::new(stack, 80, [&mut rx, &mut tx], &mut page, Options::default());
//!     let answer = |path: &str, page: &mut dyn Write| match path {
//!         "/" => write!(page, "up").is_ok().then_some(Content::Text),
//!         _ => None,
//!     };
//!     listener.run(|_client| true, answer).await
//! }
//! ```

use core::fmt::{self, Write};
use core::time::Duration;

use bcap_core::io::asynch::Transport;
use bcap_core::time::Instant;
use embassy_futures::select::{Either, select};
use embassy_net::{IpEndpoint, Stack};
use embassy_time::Timer;

use crate::net::{Options, TcpTransport, evicted};

/// The memory for the head of a response in bytes, and for the path of a request.
const RESPONSE_HEAD: usize = 192;
const PATH: usize = 32;

/// How long a request may take from the connection to its end, and the response to be sent.
const RECEIVE: Duration = Duration::from_secs(5);
const SEND: Duration = Duration::from_secs(5);

/// The pause before listening again after listening failed.
const PAUSE_MS: u64 = 100;

/// The type of a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Content {
    /// Plain text.
    Text,
    /// HTML.
    Html,
    /// JSON.
    Json,
}

impl Content {
    const fn name(self) -> &'static str {
        match self {
            Self::Text => "text/plain; charset=utf-8",
            Self::Html => "text/html; charset=utf-8",
            Self::Json => "application/json",
        }
    }
}

/// A TCP listener that answers one request at a time.
///
/// With several on one port and a [`Backlog`](crate::net::Backlog), the oldest unfinished request makes room for a new client.
#[derive(Debug)]
pub struct HttpListener<'s> {
    transport: TcpTransport<'s>,
    port: u16,
    page: &'s mut [u8],
}

impl<'s> HttpListener<'s> {
    /// Creates a listener; `rx` and `tx` are its socket's buffers. `page` is memory for the head of a request, and after
    /// that for the longest page and 192 bytes; browsers send heads of about 500 bytes.
    #[must_use]
    pub fn new(stack: Stack<'s>, port: u16, [rx, tx]: [&'s mut [u8]; 2], page: &'s mut [u8], options: Options) -> Self {
        Self { transport: TcpTransport::new(stack, rx, tx, options), port, page }
    }

    /// Answers requests forever.
    ///
    /// `admits` tells whether a client may connect. `answer` writes the page of a path, without its query, and returns its type;
    /// `None` means that there is no such page.
    pub async fn run(
        &mut self,
        admits: impl Fn(Option<IpEndpoint>) -> bool,
        answer: impl Fn(&str, &mut dyn Write) -> Option<Content>,
    ) -> ! {
        loop {
            let Ok(place) = self.transport.accept(self.port).await else {
                Timer::after_millis(PAUSE_MS).await;
                continue;
            };
            if !admits(self.transport.socket().remote_endpoint()) {
                self.transport.reset().await;
                continue;
            }
            let request = async {
                // a client that sends nothing or does not read its page gets no other answer
                let _ = serve(&mut self.transport, self.page, &answer).await;
                self.transport.close().await;
            };
            if let Either::Second(()) = select(request, evicted(place.as_ref())).await {
                self.transport.reset().await;
            }
        }
    }
}

/// Reads a request and sends its response; `None` when the time is over. All memory belongs to the page, so that the
/// future stays small.
async fn serve<X: Transport>(
    transport: &mut X,
    page: &mut [u8],
    answer: impl Fn(&str, &mut dyn Write) -> Option<Content>,
) -> Result<Option<()>, X::Error> {
    let until = transport.now().saturating_add(RECEIVE);
    let Some(len) = receive(transport, page, until).await? else { return Ok(None) };
    let (head_len, body_len) = respond(page, len, answer);
    let (head, body) = page.split_at_mut_checked(RESPONSE_HEAD).unwrap_or_default();
    let until = transport.now().saturating_add(SEND);
    if send(transport, head.get(..head_len).unwrap_or_default(), until).await?.is_none() {
        return Ok(None);
    }
    send(transport, body.get(..body_len).unwrap_or_default(), until).await
}

/// Writes the response to the request in the first `len` bytes over it. Returns the length of its head, and of the body that
/// begins after [`RESPONSE_HEAD`].
fn respond(page: &mut [u8], len: usize, answer: impl Fn(&str, &mut dyn Write) -> Option<Content>) -> (usize, usize) {
    let mut path = [0; PATH];
    let request = request(page.get(..len).unwrap_or_default()).map(|request| {
        // the request is overwritten; a longer path has no page
        let path = path.get_mut(..request.path.len()).map(|path| {
            path.copy_from_slice(request.path.as_bytes());
            &*path
        });
        (path.and_then(|path| core::str::from_utf8(path).ok()), request.has_body)
    });
    let (head, body) = page.split_at_mut_checked(RESPONSE_HEAD).unwrap_or_default();
    let mut body = Page { buffer: body, len: 0, is_full: false };
    let (status, content, has_body) = match request {
        Ok((path, has_body)) => match path.and_then(|path| answer(path, &mut body)) {
            _ if body.is_full => (Status::InternalServerError, None, false),
            Some(content) => (Status::Ok, Some(content), has_body),
            None => (Status::NotFound, None, false),
        },
        Err(status) => (status, None, false),
    };
    let body_len = if content.is_some() { body.len } else { 0 };
    let mut out = Page { buffer: head, len: 0, is_full: false };
    // there is room for every head
    let _ = write_head(&mut out, status, content, body_len);
    (out.len, if has_body { body_len } else { 0 })
}

/// Receives the head of a request, up to the empty line or the size of the buffer, and returns the number of bytes; `None` when
/// the time is over.
async fn receive<X: Transport>(
    transport: &mut X,
    buffer: &mut [u8],
    until: Instant,
) -> Result<Option<usize>, X::Error> {
    let mut len: usize = 0;
    loop {
        let room = buffer.get_mut(len..).unwrap_or_default();
        if room.is_empty() {
            return Ok(Some(len));
        }
        match transport.receive(room, until).await? {
            Some(count @ 1..) => len = len.saturating_add(count),
            _ => return Ok(None),
        }
        if is_complete(buffer.get(..len).unwrap_or_default()) {
            return Ok(Some(len));
        }
    }
}

/// Tells whether a head ends with its empty line.
fn is_complete(head: &[u8]) -> bool {
    head.windows(4).any(|end| end == b"\r\n\r\n")
}

async fn send<X: Transport>(transport: &mut X, mut bytes: &[u8], until: Instant) -> Result<Option<()>, X::Error> {
    while !bytes.is_empty() {
        match transport.send(bytes, until).await? {
            Some(count) => bytes = bytes.get(count..).unwrap_or_default(),
            None => return Ok(None),
        }
    }
    Ok(Some(()))
}

/// The status of a response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Status {
    Ok,
    BadRequest,
    NotFound,
    MethodNotAllowed,
    HeaderTooLarge,
    InternalServerError,
}

impl Status {
    const fn line(self) -> &'static str {
        match self {
            Self::Ok => "200 OK",
            Self::BadRequest => "400 Bad Request",
            Self::NotFound => "404 Not Found",
            Self::MethodNotAllowed => "405 Method Not Allowed\r\nAllow: GET, HEAD",
            Self::HeaderTooLarge => "431 Request Header Fields Too Large",
            Self::InternalServerError => "500 Internal Server Error",
        }
    }
}

/// A valid request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Request<'a> {
    path: &'a str,
    /// Whether the response has a body: not after HEAD.
    has_body: bool,
}

/// Parses the head of a request.
fn request(head: &[u8]) -> Result<Request<'_>, Status> {
    let line = head.split(|byte| *byte == b'\r').next().unwrap_or_default();
    let line = core::str::from_utf8(line).map_err(|_| Status::BadRequest)?;
    let mut words = line.split(' ');
    let (Some(method), Some(target), Some(version), None) = (words.next(), words.next(), words.next(), words.next())
    else {
        return Err(Status::BadRequest);
    };
    if !version.starts_with("HTTP/1.") || !target.starts_with('/') {
        return Err(Status::BadRequest);
    }
    if !is_complete(head) {
        return Err(Status::HeaderTooLarge);
    }
    let path = target.split('?').next().unwrap_or_default();
    match method {
        "GET" => Ok(Request { path, has_body: true }),
        "HEAD" => Ok(Request { path, has_body: false }),
        _ => Err(Status::MethodNotAllowed),
    }
}

fn write_head(out: &mut Page<'_>, status: Status, content: Option<Content>, len: usize) -> fmt::Result {
    write!(out, "HTTP/1.1 {}\r\nConnection: close\r\nCache-Control: no-store\r\n", status.line())?;
    if let Some(content) = content {
        write!(out, "Content-Type: {}\r\n", content.name())?;
    }
    write!(out, "Content-Length: {len}\r\n\r\n")
}

/// A page in a buffer.
struct Page<'a> {
    buffer: &'a mut [u8],
    len: usize,
    /// Whether something did not fit.
    is_full: bool,
}

impl Write for Page<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        match self.buffer.get_mut(self.len..).and_then(|room| room.get_mut(..text.len())) {
            Some(room) => {
                room.copy_from_slice(text.as_bytes());
                self.len = self.len.saturating_add(text.len());
                Ok(())
            }
            None => {
                self.is_full = true;
                Err(fmt::Error)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_parsed_or_refused() {
        let get = |path, has_body| Ok(Request { path, has_body });
        for (head, expected) in [
            ("GET / HTTP/1.1\r\n\r\n", get("/", true)),
            ("GET /health.json?x=1 HTTP/1.0\r\nHost: a\r\n\r\n", get("/health.json", true)),
            ("HEAD / HTTP/1.1\r\n\r\n", get("/", false)),
            ("POST / HTTP/1.1\r\n\r\n", Err(Status::MethodNotAllowed)),
            ("PUT /settings HTTP/1.1\r\n\r\n", Err(Status::MethodNotAllowed)),
            ("GET / HTTP/1.1\r\nCookie: ...", Err(Status::HeaderTooLarge)),
            ("GET / HTTP/2\r\n\r\n", Err(Status::BadRequest)),
            ("GET  / HTTP/1.1\r\n\r\n", Err(Status::BadRequest)),
            ("GET http://a/ HTTP/1.1\r\n\r\n", Err(Status::BadRequest)),
            ("GET:RC8:1:I:\r\n\r\n", Err(Status::BadRequest)),
            ("", Err(Status::BadRequest)),
        ] {
            assert_eq!(request(head.as_bytes()), expected, "{head:?}");
        }
        assert_eq!(request(b"GET /\xff HTTP/1.1\r\n\r\n"), Err(Status::BadRequest));
    }

    #[test]
    fn the_longest_head_fits_its_memory() {
        let statuses = [
            Status::Ok,
            Status::BadRequest,
            Status::NotFound,
            Status::MethodNotAllowed,
            Status::HeaderTooLarge,
            Status::InternalServerError,
        ];
        for status in statuses {
            let mut memory = [0; RESPONSE_HEAD];
            let mut out = Page { buffer: &mut memory, len: 0, is_full: false };
            assert_eq!(write_head(&mut out, status, Some(Content::Text), usize::MAX), Ok(()), "{status:?}");
        }
    }
}
