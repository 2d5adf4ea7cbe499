//! A small HTTP server, for pages such as the health of a board.
//!
//! It answers one request a connection, from a buffer of the caller: GET and HEAD of pages ([`HttpListener::run`]), and POST
//! for a [`Site`], which accepts or answers a request by its head before the body is received. picoserve has routes and all
//! headers; its MSRV (1.93) is above this crate's.
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

mod request;
mod status;

use core::fmt::{self, Write};
use core::time::Duration;

use bcap_core::io::asynch::Transport;
use bcap_core::time::Instant;
use embassy_futures::select::{Either, select};
use embassy_net::{IpEndpoint, Stack};
use embassy_time::Timer;

use self::request::head_len;
pub use self::request::{Method, Request};
pub use self::status::Status;
use crate::net::{Options, TcpTransport, evicted};

/// The memory for the head of a response in bytes, and for the path of a request.
const RESPONSE_HEAD: usize = 192;
const PATH: usize = 23;

/// Time limit of a request, from the connection to its end, and of sending the response.
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

/// The pages of a server whose requests may have a body.
pub trait Site<'s> {
    /// A page, or the refusal of a request.
    type Page;

    /// Returns whether a client may connect.
    fn admits(&self, client: Option<IpEndpoint>) -> bool;

    /// Accepts or answers a request by its head; the body is received only if the site accepts it.
    fn decide(&self, request: &Request<'_>) -> Decision<Self::Page>;

    /// Takes a body: the first `len` bytes of the listener's memory, which it gives back.
    ///
    /// A listener whose future is dropped during this call loses its memory, and answers no more requests.
    fn take(&self, memory: &'s mut [u8], len: usize) -> impl Future<Output = (&'s mut [u8], Self::Page)>;

    /// Writes a page; `None` means that there is no such page.
    fn write(&self, page: Self::Page, out: &mut Body<'_>) -> Option<(Status, Content)>;
}

/// A decision on the head of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Decision<P> {
    /// Answer with this page.
    Answer(P),
    /// Receive the body.
    Receive,
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

    /// Answers GET and HEAD forever.
    ///
    /// `admits` returns whether a client may connect. `answer` writes the page of a path, without its query, and returns its
    /// type; `None` means that there is no such page.
    pub async fn run(
        &mut self,
        admits: impl Fn(Option<IpEndpoint>) -> bool,
        answer: impl Fn(&str, &mut dyn Write) -> Option<Content>,
    ) -> ! {
        self.run_site(&ReadOnly { admits, answer }).await
    }

    /// Answers the requests for a site forever.
    pub async fn run_site(&mut self, site: &impl Site<'s>) -> ! {
        loop {
            let Ok(place) = self.transport.accept(self.port).await else {
                Timer::after_millis(PAUSE_MS).await;
                continue;
            };
            let client = self.transport.socket().remote_endpoint();
            if !site.admits(client) {
                self.transport.reset().await;
                continue;
            }
            let received = select(receive(&mut self.transport, self.page, site, client), evicted(place.as_ref())).await;
            let (page, has_body) = match received {
                Either::First(Ok(Some(Received::Page { page, has_body }))) => (page, has_body),
                Either::First(Ok(Some(Received::Body { len }))) => {
                    // not within a `select`, which could drop the memory
                    let (memory, page) = site.take(core::mem::take(&mut self.page), len).await;
                    self.page = memory;
                    (Ok(page), true)
                }
                // a client that sends nothing or does not read its page gets no other answer
                Either::First(_) => {
                    self.transport.close().await;
                    continue;
                }
                Either::Second(()) => {
                    self.transport.reset().await;
                    continue;
                }
            };
            let response = async {
                let _ = respond(&mut self.transport, self.page, site, page, has_body).await;
                self.transport.close().await;
            };
            if let Either::Second(()) = select(response, evicted(place.as_ref())).await {
                self.transport.reset().await;
            }
        }
    }
}

/// Pages that only show something.
struct ReadOnly<A, W> {
    admits: A,
    answer: W,
}

impl<'s, A, W> Site<'s> for ReadOnly<A, W>
where
    A: Fn(Option<IpEndpoint>) -> bool,
    W: Fn(&str, &mut dyn Write) -> Option<Content>,
{
    /// The path, whose request is overwritten; without one the method is not allowed.
    type Page = Option<([u8; PATH], u8)>;

    fn admits(&self, client: Option<IpEndpoint>) -> bool {
        (self.admits)(client)
    }

    fn decide(&self, request: &Request<'_>) -> Decision<Self::Page> {
        if request.method == Method::Post {
            return Decision::Answer(None);
        }
        let mut path = [0; PATH];
        // a longer path has no page, as an empty one
        let len = path.get_mut(..request.path.len()).map_or(0, |path| {
            path.copy_from_slice(request.path.as_bytes());
            u8::try_from(request.path.len()).unwrap_or_default()
        });
        Decision::Answer(Some((path, len)))
    }

    async fn take(&self, memory: &'s mut [u8], _: usize) -> (&'s mut [u8], Self::Page) {
        (memory, None)
    }

    fn write(&self, page: Self::Page, out: &mut Body<'_>) -> Option<(Status, Content)> {
        let Some((path, len)) = page else { return Some((Status::MethodNotAllowed, Content::Text)) };
        let path = core::str::from_utf8(path.get(..len.into())?).ok()?;
        Some((Status::Ok, (self.answer)(path, out)?))
    }
}

/// A received request.
enum Received<P> {
    Page {
        page: Result<P, Status>,
        /// Whether the response has a body: not after HEAD.
        has_body: bool,
    },
    /// The first bytes of the memory are a body.
    Body { len: usize },
}

/// Receives a request; `None` when the time is over. All memory belongs to the page, so that the future stays small.
async fn receive<'s, X: Transport, S: Site<'s>>(
    transport: &mut X,
    memory: &mut [u8],
    site: &S,
    client: Option<IpEndpoint>,
) -> Result<Option<Received<S::Page>>, X::Error> {
    let until = transport.now().saturating_add(RECEIVE);
    let Some(received) = receive_until(transport, memory, 0, until, |bytes| head_len(bytes).is_some()).await? else {
        return Ok(None);
    };
    let bytes = memory.get(..received).unwrap_or_default();
    let request = match Request::parse(bytes, client) {
        Ok(request) => request,
        Err(status) => return Ok(Some(Received::Page { page: Err(status), has_body: false })),
    };
    let len = match site.decide(&request) {
        Decision::Answer(page) => {
            return Ok(Some(Received::Page { page: Ok(page), has_body: request.method != Method::Head }));
        }
        Decision::Receive => request.body_len(memory.len()),
    };
    let len = match len {
        Ok(len) => len,
        Err(status) => return Ok(Some(Received::Page { page: Err(status), has_body: false })),
    };
    // over the head, so that all memory is for the body
    let head = head_len(bytes).unwrap_or_default();
    memory.copy_within(head..received, 0);
    let body = memory.get_mut(..len).unwrap_or_default();
    let received = received.saturating_sub(head).min(len);
    Ok(receive_until(transport, body, received, until, |_| false).await?.map(|len| Received::Body { len }))
}

/// Sends the response with a page, which is written over the request.
async fn respond<'s, X: Transport, S: Site<'s>>(
    transport: &mut X,
    memory: &mut [u8],
    site: &S,
    page: Result<S::Page, Status>,
    has_body: bool,
) -> Result<Option<()>, X::Error> {
    let (head, body) = memory.split_at_mut_checked(RESPONSE_HEAD).unwrap_or_default();
    let mut body = Body::new(body);
    let (status, content) = match page.map(|page| site.write(page, &mut body)) {
        _ if body.is_full => (Status::InternalServerError, None),
        Ok(Some((status, content))) => (status, Some(content)),
        Ok(None) => (Status::NotFound, None),
        Err(status) => (status, None),
    };
    let len = if content.is_some() { body.len } else { 0 };
    let mut out = Body::new(head);
    // there is room for every head
    let _ = write_head(&mut out, status, content.filter(|_| len > 0), len);
    let head_len = out.len;
    let until = transport.now().saturating_add(SEND);
    if send(transport, head.get(..head_len).unwrap_or_default(), until).await?.is_none() || !has_body {
        return Ok(None);
    }
    send(transport, body.buffer.get(..len).unwrap_or_default(), until).await
}

/// Receives bytes after the first `len` ones until they are complete or the memory is full, and returns their number; `None`
/// when the time is over.
async fn receive_until<X: Transport>(
    transport: &mut X,
    memory: &mut [u8],
    mut len: usize,
    until: Instant,
    is_complete: impl Fn(&[u8]) -> bool,
) -> Result<Option<usize>, X::Error> {
    loop {
        if len >= memory.len() || is_complete(memory.get(..len).unwrap_or_default()) {
            return Ok(Some(len));
        }
        match transport.receive(memory.get_mut(len..).unwrap_or_default(), until).await? {
            Some(count @ 1..) => len = len.saturating_add(count),
            _ => return Ok(None),
        }
    }
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

fn write_head(out: &mut Body<'_>, status: Status, content: Option<Content>, len: usize) -> fmt::Result {
    write!(out, "HTTP/1.1 {}\r\nConnection: close\r\nCache-Control: no-store\r\n", status.line())?;
    if let Some(content) = content {
        write!(out, "Content-Type: {}\r\n", content.name())?;
    }
    write!(out, "Content-Length: {len}\r\n\r\n")
}

/// The body of a response, in the memory of a listener.
#[derive(Debug)]
pub struct Body<'a> {
    buffer: &'a mut [u8],
    len: usize,
    /// Whether something did not fit.
    is_full: bool,
}

impl<'a> Body<'a> {
    const fn new(buffer: &'a mut [u8]) -> Self {
        Self { buffer, len: 0, is_full: false }
    }

    /// Writes a row of a list, if there is room for all of it and for `rest` bytes after it.
    ///
    /// # Errors
    ///
    /// When there is no room; the body is then as before.
    pub fn row(&mut self, rest: usize, write: impl FnOnce(&mut Self) -> fmt::Result) -> fmt::Result {
        let before = (self.len, self.is_full);
        let written = write(self);
        if written.is_ok() && self.buffer.len().saturating_sub(self.len) >= rest {
            return Ok(());
        }
        (self.len, self.is_full) = before;
        Err(fmt::Error)
    }
}

impl Write for Body<'_> {
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
    fn a_row_without_room_for_it_and_the_end_leaves_the_body_as_it_was() {
        let mut memory = [0; 10];
        let mut body = Body::new(&mut memory);
        assert_eq!(body.row(4, |body| body.write_str("first ")), Ok(()));
        for row in ["x", "longer than the memory"] {
            assert_eq!(body.row(4, |body| body.write_str(row)), Err(fmt::Error), "{row}");
        }
        assert_eq!((body.write_str("end."), body.len, body.is_full), (Ok(()), 10, false));
        assert_eq!(memory, *b"first end.");
    }

    #[test]
    fn the_longest_head_fits_its_memory() {
        let statuses = [
            Status::Ok,
            Status::Unauthorized,
            Status::MethodNotAllowed,
            Status::HeaderTooLarge,
            Status::InternalServerError,
        ];
        for status in statuses {
            let mut memory = [0; RESPONSE_HEAD];
            let mut out = Body::new(&mut memory);
            assert_eq!(write_head(&mut out, status, Some(Content::Text), usize::MAX), Ok(()), "{status:?}");
        }
    }
}
