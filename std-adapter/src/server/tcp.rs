//! b-CAP over TCP: a listener, and a task for each connection.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use bcap_core::bcap::server::{Config, Handler, Session};
use bcap_core::bcap::{Decoder, FrameWriter, Progress};
use bcap_core::hresult::HResult;
use socket2::SockRef;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::timeout;

use super::Limits;
use super::memory::{Buffer, Pool};
use super::shared::Shared;
use super::stream;
use crate::connect::set_up_tcp;

/// Handles that one peer can have open.
const OBJECTS: usize = 1000;
/// Connections over the limit that are told so at the same time; more are closed without a word.
const REFUSALS: usize = 32;
/// How long a connection over the limit has for its first request.
pub(super) const REFUSAL_TIME: Duration = Duration::from_secs(2);

type StreamSession = Session<Buffer, Buffer, OBJECTS>;

/// Accepts connections until the server stops.
pub(super) async fn listen<H: Handler + Send + 'static>(
    listener: TcpListener,
    shared: Arc<Shared<H>>,
    pool: Pool,
    limits: Limits,
    stopped: watch::Receiver<()>,
) -> io::Result<()> {
    accept(listener, limits, stopped.clone(), refuse, |stream| {
        let mut config = Config { invoke_timeout_max: limits.call, ..Config::TCP };
        config.limits.frame = limits.frame;
        let session = StreamSession::new(config, pool.buffer(), pool.buffer());
        stream::serve(stream, session, shared.next_peer(), Arc::clone(&shared), limits, stopped.clone())
    })
    .await
}

/// Accepts connections, serves as many as the limit allows and refuses the others.
pub(super) async fn accept<S, R>(
    listener: TcpListener,
    limits: Limits,
    mut stopped: watch::Receiver<()>,
    refuse: impl Fn(TcpStream) -> R,
    mut serve: impl FnMut(TcpStream) -> S,
) -> io::Result<()>
where
    S: Future<Output = ()> + Send + 'static,
    R: Future<Output = ()> + Send + 'static,
{
    let mut served = JoinSet::new();
    let mut refused = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            _ = stopped.changed() => break,
            _ = served.join_next(), if !served.is_empty() => continue,
            _ = refused.join_next(), if !refused.is_empty() => continue,
        };
        // those that have ended hold no place, whichever of the two came first
        while served.try_join_next().is_some() || refused.try_join_next().is_some() {}
        match accepted {
            Ok((stream, address)) => {
                if let Err(error) = set_up_tcp(SockRef::from(&stream), limits.keep_alive) {
                    tracing::debug!(%address, %error, "the connection was gone at once");
                } else if served.len() < limits.connections {
                    served.spawn(serve(stream));
                } else if refused.len() < REFUSALS {
                    tracing::warn!(%address, limit = limits.connections, "too many connections");
                    refused.spawn(refuse(stream));
                }
            }
            // what one connection does wrong is not the listener's end; out of files is over when some are closed
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection");
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }
    }
    refused.abort_all();
    while served.join_next().await.is_some() {}
    Ok(())
}

/// Answers the first request of a connection over the limit with E_MAX_CONNECT.
async fn refuse(mut stream: TcpStream) {
    let answer = async {
        let mut buffer = [0; 512];
        let mut len = 0;
        let serial = loop {
            let count = stream.read(buffer.get_mut(len..)?).await.ok()?;
            len += count;
            match Decoder::TCP.decode(buffer.get(..len)?) {
                Ok(Progress::Complete(frame, _)) => break frame.serial,
                Ok(Progress::NeedMore(_)) if count > 0 => {}
                _ => return None,
            }
        };
        let mut reply = [0; 16];
        let reply = FrameWriter::new(&mut reply).ok()?.finish(serial, 0, HResult::E_MAX_CONNECT.0).ok()?;
        stream.write_all(reply).await.ok()?;
        stream.shutdown().await.ok()
    };
    let _ = timeout(REFUSAL_TIME, answer).await;
}
