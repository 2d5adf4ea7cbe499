//! The PLCs' side of a gateway: listeners, and a task for each connection.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use bcap_core::handler::PeerId;
use socket2::SockRef;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Notify, watch};
use tokio::task::JoinSet;
use tokio::task::coop::consume_budget;
use tokio::time::{Instant, sleep, sleep_until, timeout};

use super::front::{Front, Map, must_wait, refuse};
use super::limits::Limits;
use super::report::Ended;
use super::shared::{GatewayState, ipv4};
use super::traffic::{Ends, Moved};
use crate::connect::set_up_tcp;
use crate::server::REFUSALS;

/// The time to wait when a connection cannot be accepted, such as without a free file descriptor.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// Accepts connections until the gateway stops, then waits until running requests are answered.
pub(super) async fn listen(
    listener: TcpListener,
    map: Map,
    shared: Arc<GatewayState>,
    limits: Limits,
    mut stopped: watch::Receiver<()>,
) {
    let (slots, drain) = {
        let gateway = &shared.lock().gateway;
        (limits.slots(gateway.capacity()), gateway.config().request_timeout)
    };
    let (mut tasks, mut refused) = (JoinSet::new(), JoinSet::new());
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = tasks.join_next() => continue,
            Some(_) = refused.join_next() => continue,
            _ = stopped.changed() => break,
        };
        let Ok((stream, address)) = accepted else {
            // the error of one connection is not the end of the listener
            sleep(ACCEPT_PAUSE).await;
            continue;
        };
        // before slots are looked at, so that such a client takes the slot of no other
        if !shared.lock().admits(address) {
            reset(stream);
            continue;
        }
        let opened = shared.lock().open(&slots, address);
        if let Some((peer, wake)) = opened {
            let slot = Slot { peer, shared: Arc::clone(&shared), front: Front::new(map, ipv4(address)), ended: None };
            tasks.spawn(serve(stream, slot, wake, limits, stopped.clone()));
        } else if refused.len() < REFUSALS {
            refused.spawn(refuse(stream, map));
        }
    }
    drop(listener);
    refused.shutdown().await;
    let drained = timeout(drain, async { while tasks.join_next().await.is_some() {} });
    if drained.await.is_err() {
        tasks.shutdown().await;
    }
}

/// Closes a connection with a reset.
fn reset(stream: TcpStream) {
    // a socket that cannot be set up is closed already
    let _ = SockRef::from(&stream).set_linger(Some(Duration::ZERO));
}

/// The slot of a client, which is freed however its task ends.
struct Slot {
    peer: PeerId,
    shared: Arc<GatewayState>,
    front: Front,
    ended: Option<Ended>,
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.shared.lock().close(self.peer, self.ended);
    }
}

/// Serves a client until its connection ends or the gateway stops.
async fn serve(stream: TcpStream, mut slot: Slot, wake: Arc<Notify>, limits: Limits, stopped: watch::Receiver<()>) {
    // a socket that cannot be set up is closed already, and its first read tells so
    let _ = set_up_tcp(SockRef::from(&stream), limits.keep_alive);
    let ended = converse(&stream, &mut slot, &wake, limits, stopped).await;
    slot.shared.lock().tap.show(|| ends(&stream), Moved::Closed);
    slot.ended = Some(ended.unwrap_or_else(|error| Ended::Failed(error.kind())));
}

/// Returns the ends of a client's connection.
fn ends(stream: &TcpStream) -> io::Result<Ends> {
    Ok((true, stream.peer_addr()?, stream.local_addr()?))
}

/// The possible next steps of a client's task.
struct State {
    sends: bool,
    receives: bool,
    is_running: bool,
    /// Whether part of a line has arrived.
    is_receiving: bool,
}

impl State {
    /// Returns the state of a client; `None` when it has lost its slot.
    fn of(slot: &Slot) -> Option<Self> {
        let inner = &mut *slot.shared.lock();
        if !inner.is_open(slot.peer) {
            return None;
        }
        let (gateway, front) = (&mut inner.gateway, &slot.front);
        Some(Self {
            sends: !front.transmit(gateway, slot.peer).is_empty(),
            receives: front.has_room(gateway, slot.peer),
            is_running: front.is_running(gateway, slot.peer),
            is_receiving: front.is_receiving(gateway, slot.peer),
        })
    }

    /// Returns what is limited in this state: the reason to end, and the time until then.
    fn limit(&self, limits: &Limits) -> Option<(Ended, Duration)> {
        if self.sends {
            Some((Ended::ReplyNotRead, limits.send))
        } else if self.is_running {
            None
        } else if self.is_receiving {
            Some((Ended::RequestTooSlow, limits.receive))
        } else {
            limits.idle.map(|idle| (Ended::Idle, idle))
        }
    }
}

/// Moves lines and answers until the connection ends.
async fn converse(
    stream: &TcpStream,
    slot: &mut Slot,
    wake: &Notify,
    limits: Limits,
    mut stopped: watch::Receiver<()>,
) -> io::Result<Ended> {
    let mut stopping = false;
    // the limited operation, and its start
    let mut limited: Option<(Ended, Instant)> = None;
    loop {
        // a ready socket does not wait, so a client that sends without a pause would keep the thread
        consume_budget().await;
        slot.shared.step();
        // there may be bytes for the robot, or another deadline
        slot.shared.robot.notify_one();
        if exchange(slot) {
            continue;
        }
        let Some(state) = State::of(slot) else { return Ok(Ended::Evicted) };
        if slot.front.is_broken() {
            return Ok(Ended::NotModbus);
        }
        if stopping && !state.sends && !state.is_running {
            return Ok(Ended::Stopped);
        }
        let limit = state.limit(&limits);
        limited = limit.map(|(reason, _)| match limited {
            Some((before, since)) if before == reason => (reason, since),
            _ => (reason, Instant::now()),
        });
        let late = limited.zip(limit).map(|((reason, since), (_, limit))| (reason, since + limit));
        tokio::select! {
            ready = stream.writable(), if state.sends => {
                ready?;
                if send(stream, slot)? {
                    limited = None;
                }
            }
            ready = stream.readable(), if state.receives && !stopping => {
                ready?;
                if receive(stream, slot)? {
                    return Ok(Ended::Closed);
                }
            }
            () = wake.notified() => {}
            _ = stopped.changed(), if !stopping => stopping = true,
            () = sleep_until(late.map_or_else(Instant::now, |(_, at)| at)), if late.is_some() => {
                return Ok(late.map_or(Ended::Idle, |(reason, _)| reason));
            }
        }
    }
}

/// Moves lines and replies of a client that speaks Modbus; after `true` the gateway must be polled.
fn exchange(slot: &mut Slot) -> bool {
    let inner = &mut *slot.shared.lock();
    if !inner.is_open(slot.peer) {
        return false;
    }
    let moved = slot.front.exchange(&mut inner.gateway, slot.peer);
    inner.exchanged(slot.peer, &slot.front);
    moved
}

/// Sends a part of an answer; `false` when the socket takes nothing.
fn send(stream: &TcpStream, slot: &mut Slot) -> io::Result<bool> {
    let inner = &mut *slot.shared.lock();
    let bytes = slot.front.transmit(&inner.gateway, slot.peer);
    let sent = stream.try_write(bytes);
    if must_wait(&sent) {
        return Ok(false);
    }
    let count = sent?;
    inner.tap.show(|| ends(stream), Moved::Reply(bytes.get(..count).unwrap_or(bytes)));
    slot.front.transmitted(&mut inner.gateway, slot.peer, count);
    inner.moved(slot.peer, &slot.front);
    Ok(true)
}

/// Receives the bytes that have arrived; `true` when the client has closed the connection.
fn receive(stream: &TcpStream, slot: &mut Slot) -> io::Result<bool> {
    let inner = &mut *slot.shared.lock();
    let tap = &mut inner.tap;
    let show = |bytes: &[u8]| tap.show(|| ends(stream), Moved::Request(bytes));
    // without room, the step of another task has started a request of this client
    let Some(count) = slot.front.receive(stream, &mut inner.gateway, slot.peer, show)? else { return Ok(false) };
    inner.moved(slot.peer, &slot.front);
    Ok(count == 0)
}
