//! The PLCs' side of the gateway: a listener, and a task for each connection.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::{Framed, LineFramer, Response};
use bcap_core::variant::Writer;
use socket2::{SockRef, TcpKeepalive};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Notify, watch};
use tokio::task::JoinSet;
use tokio::task::coop::consume_budget;
use tokio::time::{Instant, sleep, sleep_until, timeout};

use super::audit::Record;
use super::{Shared, must_wait};

/// How long a line may take to arrive once its first byte has, and a client to accept a response.
const LINE: Duration = Duration::from_secs(30);

/// The silence after which the operating system probes whether a client is still there: it has a seat.
const KEEP_ALIVE: Duration = Duration::from_secs(60);

/// How long a client without a seat has for its first line, and how many are told so at once.
const REFUSAL: Duration = Duration::from_secs(2);
const REFUSALS: usize = 16;

/// Accepts connections until the command ends.
pub(super) async fn listen(listener: TcpListener, shared: Arc<Shared>, mut stopped: watch::Receiver<()>) {
    let mut tasks = JoinSet::new();
    let mut refused = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = tasks.join_next() => continue,
            Some(_) = refused.join_next() => continue,
            _ = stopped.changed() => break,
        };
        match accepted {
            Ok((stream, address)) => match seat(&shared, address) {
                Some((peer, wake)) => {
                    tasks.spawn(serve(stream, peer, wake, Arc::clone(&shared), stopped.clone()));
                }
                None if refused.len() < REFUSALS => {
                    refused.spawn(refuse(stream));
                }
                None => {}
            },
            // what one connection does wrong is not the listener's end; out of files is over when some are closed
            Err(_) => sleep(Duration::from_millis(50)).await,
        }
    }
    refused.shutdown().await;
    while tasks.join_next().await.is_some() {}
}

/// Seats a client, and logs whether it got a slot.
fn seat(shared: &Shared, address: SocketAddr) -> Option<(PeerId, Arc<Notify>)> {
    let mut inner = shared.lock();
    let seated = inner.open(address);
    match seated {
        Some(_) => inner.log_client(address, |client| Record::Connected { client }),
        None => inner.log_client(address, |client| Record::TurnedAway { client }),
    }
    seated
}

/// Answers the first line of a client without a seat with E_MAX_CONNECT.
async fn refuse(mut stream: TcpStream) {
    let answer = async {
        let mut framer: LineFramer = LineFramer::new();
        while framer.poll().is_none_or(|framed| matches!(framed, Framed::TooLong)) {
            match stream.read(framer.receive_buffer()).await? {
                0 => return Ok(()),
                count => framer.received(count),
            }
        }
        let mut line = [0; 16];
        let mut out = Writer::new(&mut line);
        let response = Response { result: HResult::E_MAX_CONNECT, value: None };
        response.write_line(&mut out).map_err(io::Error::other)?;
        stream.write_all(out.as_bytes()).await?;
        stream.shutdown().await
    };
    // it is to be turned away, one way or another
    let _ = timeout(REFUSAL, answer).await;
}

/// Serves a client until it goes, or the command ends.
async fn serve(
    stream: TcpStream,
    peer: PeerId,
    wake: Arc<Notify>,
    shared: Arc<Shared>,
    mut stopped: watch::Receiver<()>,
) {
    // a socket that cannot be set up is gone already, and shows it when it is read
    let _ = set_up(&stream);
    tokio::select! {
        _ = converse(&stream, peer, &wake, &shared) => {}
        _ = stopped.changed() => {}
    }
    shared.lock().close(peer);
}

/// Sets a socket up for short messages, and for peers that vanish without a word.
fn set_up(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let probes = TcpKeepalive::new().with_time(KEEP_ALIVE).with_interval(KEEP_ALIVE / 6);
    SockRef::from(stream).set_tcp_keepalive(&probes)
}

/// Moves lines and responses until the client goes, or loses its slot.
async fn converse(stream: &TcpStream, peer: PeerId, wake: &Notify, shared: &Shared) -> io::Result<()> {
    // when the line or the response began that is under way
    let mut since = None;
    loop {
        // readiness costs nothing, so who sends and reads without a pause would have the thread to himself
        consume_budget().await;
        shared.step();
        // there may be something to send, or another time to wake up at
        shared.robot.notify_one();
        let (sends, receives, partial) = {
            let inner = &mut shared.lock();
            if !inner.clients.contains_key(&peer) {
                return Ok(());
            }
            let gateway = &mut inner.gateway;
            let sends = !gateway.transmit(peer).is_empty();
            (sends, !gateway.receive_buffer(peer).is_empty(), gateway.is_receiving(peer))
        };
        since = (sends || partial).then(|| since.unwrap_or_else(Instant::now));
        let late = since.map(|since: Instant| since + LINE);
        tokio::select! {
            ready = stream.writable(), if sends => {
                ready?;
                let mut inner = shared.lock();
                let sent = stream.try_write(inner.gateway.transmit(peer));
                if !must_wait(&sent) {
                    inner.gateway.transmitted(peer, sent?);
                    inner.moved(peer);
                    // it reads, and a line was whole: what there is of another has only just come
                    since = None;
                }
            }
            ready = stream.readable(), if receives => {
                ready?;
                let mut inner = shared.lock();
                let room = inner.gateway.receive_buffer(peer);
                if room.is_empty() {
                    // another task has let the gateway take a line that was here already
                    continue;
                }
                let received = stream.try_read(room);
                if !must_wait(&received) {
                    match received? {
                        0 => return Ok(()),
                        count => {
                            inner.gateway.received(peer, count);
                            inner.moved(peer);
                        }
                    }
                }
            }
            () = wake.notified() => {}
            () = sleep_until(late.unwrap_or_else(Instant::now)), if late.is_some() => {
                return Err(io::ErrorKind::TimedOut.into());
            }
        }
    }
}
