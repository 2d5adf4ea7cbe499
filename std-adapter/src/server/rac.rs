//! RAC over TCP: a listener, and a task for each connection.

use std::io;
use std::sync::Arc;

use bcap_core::hresult::HResult;
use bcap_core::rac::server::{Config, Handler, Session};
use bcap_core::rac::{Framed, LineFramer, Response};
use bcap_core::variant::Writer;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::time::timeout;

use super::limits::Limits;
use super::shared::ServerState;
use super::stream;
use super::tcp::{REFUSAL_TIME, accept};

/// Accepts connections until the server stops.
pub(super) async fn listen<H: Handler + Send + 'static>(
    listener: TcpListener,
    shared: Arc<ServerState<H>>,
    limits: Limits,
    stopped: watch::Receiver<()>,
) -> io::Result<()> {
    accept(listener, limits, stopped, refuse, |stream, activity| {
        let session = Session::<Vec<u8>>::new(Config::TCP, Vec::new());
        stream::serve(stream, session, shared.next_peer(), Arc::clone(&shared), limits, activity)
    })
    .await
}

/// Answers the first line of a connection over the limit with E_MAX_CONNECT.
async fn refuse(mut stream: TcpStream) {
    let answer = async {
        let mut framer: LineFramer = LineFramer::new();
        while framer.poll().is_none_or(|framed| matches!(framed, Framed::TooLong)) {
            match stream.read(framer.receive_buffer()).await.ok()? {
                0 => return None,
                count => framer.received(count),
            }
        }
        let mut line = [0; 16];
        let mut out = Writer::new(&mut line);
        Response { result: HResult::E_MAX_CONNECT, value: None }.write_line(&mut out).ok()?;
        stream.write_all(out.as_bytes()).await.ok()?;
        stream.shutdown().await.ok()
    };
    let _ = timeout(REFUSAL_TIME, answer).await;
}
