//! b-CAP over TCP: a listener, and a task for each connection.

use std::collections::HashMap;
use std::io;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use bcap_core::bcap::server::{Config, Handler, Session};
use bcap_core::bcap::{Decoder, Progress};
use bcap_core::peers::{Admission, Holder, REFUSAL, Slots, refusal};
use socket2::SockRef;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::{Id, JoinError, JoinSet};
use tokio::time::timeout;

use super::activity::Activity;
use super::limits::{Limits, is_same_host};
use super::memory::{Buffer, Pool};
use super::shared::ServerState;
use super::stream;
use crate::clock::now;
use crate::connect::set_up_tcp;

/// The maximum number of open handles of one peer.
const OBJECTS: usize = 1000;
/// The maximum number of simultaneous connections over the limit that are answered E_MAX_CONNECT; further ones are closed
/// immediately.
pub(crate) const REFUSALS: usize = 32;
/// The time limit for the first request of a connection over the limit.
pub(crate) const REFUSAL_TIME: Duration = Duration::from_secs(2);

type StreamSession = Session<Buffer, Buffer, OBJECTS>;

/// Accepts connections until the server stops.
pub(super) async fn listen<H: Handler + Send + 'static>(
    listener: TcpListener,
    shared: Arc<ServerState<H>>,
    pool: Pool,
    limits: Limits,
    stopped: watch::Receiver<()>,
) -> io::Result<()> {
    accept(listener, limits, stopped, refuse, |stream, activity| {
        let mut config = Config { invoke_timeout_max: limits.call, ..Config::TCP };
        config.limits.frame = limits.frame;
        let session = StreamSession::new(config, pool.buffer(), pool.buffer());
        stream::serve(stream, session, shared.next_peer(), Arc::clone(&shared), limits, activity)
    })
    .await
}

/// Accepts connections, serves those that get a slot, and refuses the others.
pub(super) async fn accept<S, R>(
    listener: TcpListener,
    limits: Limits,
    mut stopped: watch::Receiver<()>,
    refuse: impl Fn(TcpStream) -> R,
    mut serve: impl FnMut(TcpStream, Arc<Activity>) -> S,
) -> io::Result<()>
where
    S: Future<Output = ()> + Send + 'static,
    R: Future<Output = ()> + Send + 'static,
{
    let mut served = Served { slots: limits.connection_slots(), tasks: JoinSet::new(), holders: HashMap::new() };
    let mut refused = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            _ = stopped.changed() => break,
            () = served.ended(), if !served.tasks.is_empty() => continue,
            _ = refused.join_next(), if !refused.is_empty() => continue,
        };
        // connections that have ended hold no slot, even if `select!` has not returned them yet
        served.free_slots();
        while refused.try_join_next().is_some() {}
        match accepted {
            Ok((stream, address)) => {
                if let Err(error) = set_up_tcp(SockRef::from(&stream), limits.keep_alive) {
                    tracing::debug!(%address, %error, "the new connection is closed already");
                } else if let Some(activity) = served.admit(address.ip()) {
                    served.spawn(address.ip(), &activity, serve(stream, Arc::clone(&activity)));
                } else if refused.len() < REFUSALS {
                    tracing::warn!(%address, limit = limits.connections, "too many connections");
                    refused.spawn(refuse(stream));
                }
            }
            // an error of one connection does not end the listener; "too many open files" ends when some are closed
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection");
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }
    }
    refused.abort_all();
    served.stop();
    while served.tasks.join_next().await.is_some() {}
    Ok(())
}

/// The served connections.
struct Served {
    slots: Slots,
    tasks: JoinSet<()>,
    /// The connections by their tasks. An evicted one holds no slot, even before it ends.
    holders: HashMap<Id, (IpAddr, Arc<Activity>)>,
}

impl Served {
    /// Finds a slot for a connection, and evicts the connection that loses it; `None` if there is no slot.
    fn admit(&mut self, address: IpAddr) -> Option<Arc<Activity>> {
        let holders = self.holders.iter().filter(|(_, (_, activity))| !activity.is_evicted());
        let taken = holders.map(|(id, (holder, activity))| Holder {
            key: *id,
            is_same_host: is_same_host(*holder, address),
            state: activity.state(),
        });
        match self.slots.admit(taken, now()) {
            Admission::Free => {}
            Admission::Instead(id) => {
                if let Some((address, activity)) = self.holders.get(&id) {
                    tracing::info!(%address, "an idle connection is evicted: another needs its slot");
                    activity.evict();
                }
            }
            Admission::Refused => return None,
        }
        Some(Arc::new(Activity::new(now())))
    }

    fn spawn(&mut self, address: IpAddr, activity: &Arc<Activity>, task: impl Future<Output = ()> + Send + 'static) {
        let id = self.tasks.spawn(task).id();
        self.holders.insert(id, (address, Arc::clone(activity)));
    }

    /// Ends all connections: the server stops.
    fn stop(&self) {
        self.holders.values().for_each(|(_, activity)| activity.stop());
    }

    /// Waits until a connection has ended, and frees its slot.
    async fn ended(&mut self) {
        if let Some(ended) = self.tasks.join_next_with_id().await {
            self.free(ended);
        }
    }

    /// Frees the slots of all connections that have ended.
    fn free_slots(&mut self) {
        while let Some(ended) = self.tasks.try_join_next_with_id() {
            self.free(ended);
        }
    }

    fn free(&mut self, ended: Result<(Id, ()), JoinError>) {
        let id = ended.map_or_else(|error| error.id(), |(id, ())| id);
        self.holders.remove(&id);
    }
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
        stream.write_all(refusal(serial, &mut [0; REFUSAL])).await.ok()?;
        stream.shutdown().await.ok()
    };
    let _ = timeout(REFUSAL_TIME, answer).await;
}
