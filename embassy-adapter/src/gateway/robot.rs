//! The robot's side of a gateway: one connection, which is opened and closed as the gateway requests.

use bcap_core::bcap;
use bcap_core::io::asynch::Transport;
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Timer;

use super::SharedGateway;
use crate::clock::{now, ticks};
use crate::error::NetError;

/// A transport to the robot that can be reopened, with any error: `TcpRobot` and `UdpTransport` over embassy-net, `SerialRobot`
/// over a serial line.
pub trait RobotLink: Transport {
    /// Opens a connection.
    ///
    /// # Errors
    ///
    /// An error when the connection cannot be opened.
    fn open(&mut self) -> impl Future<Output = Result<(), Self::Error>>;

    /// Closes the connection without waiting.
    fn close(&mut self);

    /// Returns the text of an error for the log.
    fn cause(error: Self::Error) -> NetError;
}

/// Runs the connection to the robot and polls the gateway at its deadlines, forever.
///
/// `frame` is memory for the bytes on their way: at least a datagram of 505 bytes over UDP, any length over TCP.
///
/// # Cancel safety
///
/// When the future is dropped, the connection is closed, and the gateway is notified. The next run opens another one.
pub async fn run_robot<L: RobotLink, M: RawMutex, const N: usize>(
    link: &mut L,
    frame: &mut [u8],
    shared: &SharedGateway<'_, M, N>,
) -> ! {
    let mut robot = Robot { link, shared, open: false };
    loop {
        shared.poll();
        let wanted = shared.view(|gateway| gateway.robot_wanted()).unwrap_or_default();
        let result = match (robot.open, wanted) {
            (false, true) => robot.link.open().await.map_err(L::cause).map(|()| {
                robot.open = true;
                shared.with(|inner| inner.gateway.robot_opened(now()));
            }),
            (true, false) => {
                robot.close();
                Ok(())
            }
            (true, true) => transfer(robot.link, frame, shared).await,
            (false, false) => {
                select(Timer::at(ticks(shared.next_poll())), shared.wait_for_robot()).await;
                Ok(())
            }
        };
        if let Err(cause) = result {
            robot.open = false;
            robot.link.close();
            shared.with(|inner| inner.robot_failed(cause));
        }
    }
}

/// The connection to the robot, which ends with the task that keeps it.
struct Robot<'a, 'm, L: RobotLink, M: RawMutex, const N: usize> {
    link: &'a mut L,
    shared: &'a SharedGateway<'m, M, N>,
    open: bool,
}

impl<L: RobotLink, M: RawMutex, const N: usize> Robot<'_, '_, L, M, N> {
    fn close(&mut self) {
        self.open = false;
        self.link.close();
        self.shared.with(|inner| inner.gateway.robot_closed(now()));
    }
}

impl<L: RobotLink, M: RawMutex, const N: usize> Drop for Robot<'_, '_, L, M, N> {
    fn drop(&mut self) {
        if self.open {
            self.close();
        }
    }
}

/// Moves bytes when some can be moved; otherwise waits until it is time for something.
async fn transfer<L: RobotLink, M: RawMutex, const N: usize>(
    link: &mut L,
    frame: &mut [u8],
    shared: &SharedGateway<'_, M, N>,
) -> Result<(), NetError> {
    let until = shared.next_poll();
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
        if let Some(sent) = link.send(to_send, until).await.map_err(L::cause)? {
            shared.with(|inner| inner.gateway.robot_transmitted(sent));
        }
        return Ok(());
    }
    // only this task writes to that buffer, so the room is still free when bytes arrive
    let room = shared.with(|inner| inner.gateway.robot_receive_buffer().len()).unwrap_or_default();
    let len = room.min(frame.len());
    let room = frame.get_mut(..len).unwrap_or_default();
    match select(link.receive(room, until), shared.wait_for_robot()).await {
        Either::First(Ok(Some(count))) => received(frame.get(..count).unwrap_or_default(), shared),
        Either::First(Ok(None)) | Either::Second(()) => Ok(()),
        Either::First(Err(error)) => Err(L::cause(error)),
    }
}

/// Passes bytes from the robot to the gateway.
fn received<M: RawMutex, const N: usize>(bytes: &[u8], shared: &SharedGateway<'_, M, N>) -> Result<(), NetError> {
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
