//! The robot's side of a gateway: one connection, which is opened and closed as the gateway wants it.

use bcap_core::bcap;
use bcap_core::io::asynch::Transport;
use bcap_core::time::Instant;
use embassy_futures::select::{Either, select};
use embassy_net::{IpEndpoint, Stack};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Timer;

use super::Shared;
use crate::clock::{now, ticks};
use crate::net::{NetError, Options, TcpTransport, UdpTransport};

/// A transport that can be opened and closed again and again: a [`TcpRobot`], or a [`UdpTransport`].
pub trait Link: Transport<Error = NetError> {
    /// Opens a connection.
    ///
    /// # Errors
    ///
    /// A [`NetError`] that says why there is none.
    fn open(&mut self) -> impl Future<Output = Result<(), NetError>>;

    /// Ends the connection at once.
    fn close(&mut self);
}

/// The robot behind TCP.
#[derive(Debug)]
pub struct TcpRobot<'s> {
    transport: TcpTransport<'s>,
    peer: IpEndpoint,
}

impl<'s> TcpRobot<'s> {
    /// Makes a link that is not open; `rx` and `tx` are the socket's memory.
    #[must_use]
    pub fn new(
        stack: Stack<'s>,
        rx: &'s mut [u8],
        tx: &'s mut [u8],
        options: Options,
        peer: impl Into<IpEndpoint>,
    ) -> Self {
        Self { transport: TcpTransport::new(stack, rx, tx, options), peer: peer.into() }
    }
}

impl Transport for TcpRobot<'_> {
    type Error = NetError;

    fn now(&self) -> Instant {
        now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, NetError> {
        self.transport.send(bytes, until).await
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, NetError> {
        self.transport.receive(buffer, until).await
    }

    async fn sleep_until(&mut self, at: Instant) {
        self.transport.sleep_until(at).await;
    }
}

impl Link for TcpRobot<'_> {
    async fn open(&mut self) -> Result<(), NetError> {
        self.transport.connect(self.peer).await
    }

    fn close(&mut self) {
        self.transport.socket().abort();
    }
}

/// The robot behind UDP; the gateway's configuration must say [`Link::Datagram`](bcap::Link::Datagram) as well.
///
/// Datagrams need no connection; whether the robot is there shows when it answers.
impl Link for UdpTransport<'_> {
    async fn open(&mut self) -> Result<(), NetError> {
        Ok(())
    }

    fn close(&mut self) {}
}

/// Keeps the connection to the robot, and the gateway's time, for ever.
///
/// `frame` is memory for the bytes on their way: at least a datagram of 505 bytes over UDP, any length over TCP.
///
/// # Cancel safety
///
/// When the future is dropped, the connection is closed and the gateway learns it. The next run opens another one.
pub async fn run_robot<L: Link, M: RawMutex, const N: usize>(
    link: &mut L,
    frame: &mut [u8],
    shared: &Shared<'_, M, N>,
) -> ! {
    let mut robot = Robot { link, shared, open: false };
    loop {
        shared.step();
        let wanted = shared.view(|gateway| gateway.robot_wanted()).unwrap_or_default();
        let went_on = match (robot.open, wanted) {
            (false, true) => robot.link.open().await.map(|()| {
                robot.open = true;
                shared.with(|inner| inner.gateway.robot_opened(now()));
            }),
            (true, false) => {
                robot.close();
                Ok(())
            }
            (true, true) => transfer(robot.link, frame, shared).await,
            (false, false) => {
                select(Timer::at(ticks(shared.due())), shared.wait_for_robot()).await;
                Ok(())
            }
        };
        if let Err(cause) = went_on {
            robot.open = false;
            robot.link.close();
            shared.with(|inner| inner.robot_lost(cause));
        }
    }
}

/// The connection to the robot, which ends with the task that keeps it.
struct Robot<'a, 'm, L: Link, M: RawMutex, const N: usize> {
    link: &'a mut L,
    shared: &'a Shared<'m, M, N>,
    open: bool,
}

impl<L: Link, M: RawMutex, const N: usize> Robot<'_, '_, L, M, N> {
    fn close(&mut self) {
        self.open = false;
        self.link.close();
        self.shared.with(|inner| inner.gateway.robot_closed(now()));
    }
}

impl<L: Link, M: RawMutex, const N: usize> Drop for Robot<'_, '_, L, M, N> {
    fn drop(&mut self) {
        if self.open {
            self.close();
        }
    }
}

/// Moves bytes when some can be moved; otherwise waits until it is time for something.
async fn transfer<L: Link, M: RawMutex, const N: usize>(
    link: &mut L,
    frame: &mut [u8],
    shared: &Shared<'_, M, N>,
) -> Result<(), NetError> {
    let due = shared.due();
    let to_send = shared.with(|inner| {
        let mut count = 0;
        for (to, from) in frame.iter_mut().zip(inner.gateway.robot_transmit()) {
            *to = *from;
            count += 1;
        }
        count
    });
    let to_send = frame.get(..to_send.unwrap_or_default()).unwrap_or_default();
    if !to_send.is_empty() {
        if let Some(sent) = link.send(to_send, due).await? {
            shared.with(|inner| inner.gateway.robot_transmitted(sent));
        }
        return Ok(());
    }
    // nobody but this task puts bytes there, so the room is still there when they have come
    let room = shared.with(|inner| inner.gateway.robot_receive_buffer().len()).unwrap_or_default();
    let len = room.min(frame.len());
    let room = frame.get_mut(..len).unwrap_or_default();
    match select(link.receive(room, due), shared.wait_for_robot()).await {
        Either::First(Ok(Some(count))) => received(frame.get(..count).unwrap_or_default(), shared),
        Either::First(Ok(None)) | Either::Second(()) => Ok(()),
        Either::First(Err(error)) => Err(error),
    }
}

/// Gives the robot's bytes to the gateway.
fn received<M: RawMutex, const N: usize>(bytes: &[u8], shared: &Shared<'_, M, N>) -> Result<(), NetError> {
    let ended = shared.with(|inner| {
        if let Some(room) = inner.gateway.robot_receive_buffer().get_mut(..bytes.len()) {
            room.copy_from_slice(bytes);
            inner.gateway.robot_received(bytes.len());
        }
        bytes.is_empty() && inner.gateway.config().client.link == bcap::Link::Stream
    });
    match ended {
        Some(true) => Err(NetError::Reset),
        _ => Ok(()),
    }
}
