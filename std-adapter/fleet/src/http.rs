//! `/metrics` in the format of OpenMetrics, and `/healthz`.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::timeout;

use crate::scan::Shared;

/// The most connections at the same time.
const CONNECTIONS: usize = 16;

/// The time of a connection.
const LIMIT: Duration = Duration::from_secs(5);

/// The most bytes of a request.
const REQUEST: usize = 4096;

/// Serves until it is dropped.
pub(crate) async fn serve(listener: TcpListener, shared: Arc<Shared>) {
    let slots = Arc::new(Semaphore::new(CONNECTIONS));
    loop {
        let Ok(slot) = Arc::clone(&slots).acquire_owned().await else { return };
        let Ok((stream, _)) = listener.accept().await else {
            // the process has no more file descriptors
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        let shared = Arc::clone(&shared);
        tokio::spawn(async move {
            // a client that is slow or has gone gets no answer
            let _ = timeout(LIMIT, answer(stream, &shared)).await;
            drop(slot);
        });
    }
}

async fn answer(mut stream: TcpStream, shared: &Shared) -> std::io::Result<()> {
    let mut request = [0; REQUEST];
    let mut length = 0;
    while !request[..length].windows(4).any(|end| end == b"\r\n\r\n") {
        match stream.read(&mut request[length..]).await? {
            0 => return Ok(()),
            count => length += count,
        }
    }
    let line = request[..length].split(|byte| *byte == b'\r').next().unwrap_or_default();
    let mut words = line.split(|byte| *byte == b' ');
    let (status, kind, body) = match (words.next(), words.next()) {
        (Some(b"GET"), Some(b"/metrics")) => ("200 OK", OPEN_METRICS, metrics(shared)),
        (Some(b"GET"), Some(b"/healthz")) => health(shared),
        (Some(b"GET"), _) => ("404 Not Found", PLAIN, "/metrics and /healthz exist\n".into()),
        _ => ("405 Method Not Allowed", PLAIN, "only GET is allowed\n".into()),
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes()).await?;
    stream.write_all(body.as_bytes()).await?;
    stream.shutdown().await
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
