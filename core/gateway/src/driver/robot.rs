//! The robot's side of a gateway: one connection, which is opened and closed as the gateway requests.

use core::pin::pin;

use bcap_core::bcap;
use bcap_core::io::asynch::Transport;

use super::notify::unless;
use super::{Platform, SharedGateway};

/// A link to the robot, whose transport can be reopened.
pub trait RobotLink {
    /// The transport.
    type Transport: Transport;
    /// The reported part of an error.
    type Cause;

    /// Returns the transport, to move bytes while it is open, and to wait at any time.
    fn transport(&mut self) -> &mut Self::Transport;

    /// Opens a connection.
    ///
    /// # Errors
    ///
    /// When the connection cannot be opened.
    fn open(&mut self) -> impl Future<Output = Result<(), LinkError<Self>>>;

    /// Closes the connection without waiting.
    fn close(&mut self);

    /// Returns the reported part of an error; `None` stands for a connection that the robot has closed.
    fn cause(error: Option<LinkError<Self>>) -> Self::Cause;
}

/// The error of a link's transport.
type LinkError<L> = <<L as RobotLink>::Transport as Transport>::Error;

/// Runs the connection to the robot and polls the gateway at its deadlines, forever.
///
/// `frame` is memory for the bytes on their way: at least a datagram of 505 bytes over UDP, any length over TCP.
///
/// # Cancel safety
///
/// When the future is dropped, the connection is closed and the gateway is notified. The next run opens another connection.
pub async fn run_robot<L: RobotLink, P: Platform<Cause = L::Cause>>(
    link: &mut L,
    frame: &mut [u8],
    shared: &SharedGateway<'_, P>,
) -> ! {
    let mut robot = Robot { link, shared, open: false };
    loop {
        shared.poll();
        let wanted = shared.view(|gateway| gateway.robot_wanted()).unwrap_or_default();
        let result = match (robot.open, wanted) {
            (false, true) => robot.link.open().await.map_err(|error| L::cause(Some(error))).map(|()| {
                robot.open = true;
                shared.with(|shared| shared.gateway.robot_opened(P::now()));
            }),
            (true, false) => {
                robot.close();
                Ok(())
            }
            (true, true) => transfer(robot.link, frame, shared).await,
            (false, false) => {
                let sleep = robot.link.transport().sleep_until(shared.next_poll());
                unless(pin!(shared.wait_for_robot()), pin!(sleep)).await;
                Ok(())
            }
        };
        if let Err(cause) = result {
            robot.open = false;
            robot.link.close();
            shared.with(|shared| shared.robot_failed(cause));
        }
    }
}

/// The connection to the robot. Dropping it closes the connection.
struct Robot<'a, 'm, L: RobotLink, P: Platform> {
    link: &'a mut L,
    shared: &'a SharedGateway<'m, P>,
    open: bool,
}

impl<L: RobotLink, P: Platform> Robot<'_, '_, L, P> {
    fn close(&mut self) {
        self.open = false;
        self.link.close();
        self.shared.with(|shared| shared.gateway.robot_closed(P::now()));
    }
}

impl<L: RobotLink, P: Platform> Drop for Robot<'_, '_, L, P> {
    fn drop(&mut self) {
        if self.open {
            self.close();
        }
    }
}

/// Moves bytes if possible; otherwise waits until then, or until the next deadline.
async fn transfer<L: RobotLink, P: Platform>(
    link: &mut L,
    frame: &mut [u8],
    shared: &SharedGateway<'_, P>,
) -> Result<(), L::Cause> {
    let until = shared.next_poll();
    let copy = |gateway: &crate::Gateway<'_>, frame: &mut [u8]| {
        frame.iter_mut().zip(gateway.robot_transmit()).map(|(to, from)| *to = *from).count()
    };
    let to_send = shared.with(|shared| copy(&shared.gateway, frame)).unwrap_or_default();
    if to_send > 0 {
        let to_send = frame.get(..to_send).unwrap_or_default();
        if let Some(sent) = link.transport().send(to_send, until).await.map_err(|error| L::cause(Some(error)))? {
            shared.with(|shared| shared.gateway.robot_transmitted(sent));
        }
        return Ok(());
    }
    // only this task writes to that buffer, so the room is still free when bytes arrive
    let room = shared.with(|shared| shared.gateway.robot_receive_buffer().len()).unwrap_or_default();
    let len = room.min(frame.len());
    let room = frame.get_mut(..len).unwrap_or_default();
    let moved = unless(pin!(shared.wait_for_robot()), pin!(link.transport().receive(room, until))).await;
    match moved {
        Some(Ok(Some(count))) => received::<L, P>(frame.get(..count).unwrap_or_default(), shared),
        Some(Ok(None)) | None => Ok(()),
        Some(Err(error)) => Err(L::cause(Some(error))),
    }
}

/// Passes bytes from the robot to the gateway.
fn received<L: RobotLink, P: Platform>(bytes: &[u8], shared: &SharedGateway<'_, P>) -> Result<(), L::Cause> {
    let ended = shared.with(|shared| {
        if let Some(room) = shared.gateway.robot_receive_buffer().get_mut(..bytes.len()) {
            room.copy_from_slice(bytes);
            shared.gateway.robot_received(bytes.len());
        }
        bytes.is_empty() && shared.gateway.config().client.link == bcap::Link::Stream
    });
    match ended {
        Some(true) => Err(L::cause(None)),
        _ => Ok(()),
    }
}
