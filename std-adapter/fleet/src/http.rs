//! `/metrics` in the format of OpenMetrics, and `/healthz`.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{AbortHandle, JoinSet};
use tokio::time::timeout;

use crate::scan::Shared;

/// The maximum number of connections at the same time. A further connection ends the oldest, so that idle connections do not
/// block others.
const CONNECTIONS: usize = 16;

/// The time until the end of a request's header.
const HEADER: Duration = Duration::from_secs(1);

/// The time of a connection.
const LIMIT: Duration = Duration::from_secs(5);

/// The maximum size of a request in bytes.
const REQUEST: usize = 4096;

/// Serves until it is dropped.
pub(crate) async fn serve(listener: TcpListener, shared: Arc<Shared>) {
    let mut connections = JoinSet::new();
    let mut open: VecDeque<AbortHandle> = VecDeque::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = connections.join_next() => continue,
        };
        let Ok((stream, _)) = accepted else {
            // the process has no more file descriptors
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        open.retain(|connection| !connection.is_finished());
        if open.len() >= CONNECTIONS
            && let Some(oldest) = open.pop_front()
        {
            oldest.abort();
        }
        let shared = Arc::clone(&shared);
        open.push_back(connections.spawn(async move {
            // a client that is slow or has gone gets no answer
            let _ = timeout(LIMIT, answer(stream, &shared)).await;
        }));
    }
}

async fn answer(mut stream: TcpStream, shared: &Shared) -> std::io::Result<()> {
    let mut request = [0; REQUEST];
    let length = timeout(HEADER, header(&mut stream, &mut request)).await??;
    let line = request[..length].split(|byte| *byte == b'\r').next().unwrap_or_default();
    let mut words = line.split(|byte| *byte == b' ');
    let (method, target) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    // a query does not change the answer
    let path = target.split(|byte| *byte == b'?').next().unwrap_or_default();
    let (status, kind, mut body) = match (method, path) {
        (b"GET" | b"HEAD", b"/metrics") => ("200 OK", OPEN_METRICS, metrics(shared)),
        (b"GET" | b"HEAD", b"/healthz") => health(shared),
        (b"GET" | b"HEAD", _) => ("404 Not Found", PLAIN, "/metrics and /healthz exist\n".into()),
        _ => ("405 Method Not Allowed\r\nAllow: GET, HEAD", PLAIN, "only GET and HEAD are allowed\n".into()),
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    if method == b"HEAD" {
        body.clear();
    }
    stream.write_all(head.as_bytes()).await?;
    stream.write_all(body.as_bytes()).await?;
    stream.shutdown().await
}

/// Reads up to the end of a header; returns the number of bytes.
async fn header(stream: &mut TcpStream, request: &mut [u8]) -> std::io::Result<usize> {
    let mut length = 0;
    while !request[..length].windows(4).any(|end| end == b"\r\n\r\n") {
        match stream.read(&mut request[length..]).await? {
            // the stream has ended, or the header is too long
            0 => return Err(std::io::ErrorKind::UnexpectedEof.into()),
            count => length += count,
        }
    }
    Ok(length)
}

const PLAIN: &str = "text/plain; charset=utf-8";
const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

fn metrics(shared: &Shared) -> String {
    let names = shared.config.controllers.iter().map(|cell| cell.name.as_str());
    shared.metrics.text(names, shared.queue.len())
}

/// The process is healthy while it runs and has the broker; robots may disconnect and return.
fn health(shared: &Shared) -> (&'static str, &'static str, String) {
    if shared.metrics.broker_up.load(Ordering::Relaxed) {
        ("200 OK", PLAIN, "ok\n".into())
    } else {
        ("503 Service Unavailable", PLAIN, "no connection to the broker\n".into())
    }
}
