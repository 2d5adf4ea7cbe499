//! Streams of Slave Mode that are awaited, under tokio.
//!
//! Timers of tokio have the resolution of a millisecond and never fire early, so that poses of modes 0 and 1 go out one
//! to two milliseconds after their time: a jitter that does not add up, and that a buffer of 24 ms (mode 0) does not feel.
//! Mode 2 knows no timer; for mode 1 [`blocking`](super::blocking) keeps time better.

use std::io;

use bcap_core::bcap::call::{self, ControllerHandle, RobotHandle};
use bcap_core::bcap::slave::{Action, Channel, Config, ConfigError, Engine, Handles, MoveReply, RecoverError, Stats};

use super::{Run, StreamError, Trajectory, fault};
use crate::CallError;
use crate::asynch::{Connection, Transport};
use crate::clock::{now, until};

/// A connection of a stream: over TCP or UDP.
pub type Link<X> = Connection<X, Vec<u8>>;

/// Starts the service on a connection, and gets the handles of its controller and its first robot.
///
/// # Errors
///
/// A [`CallError`].
pub async fn open<X: Transport<Error = io::Error>>(
    connection: &mut Link<X>,
    provider: &str,
) -> Result<Handles, CallError> {
    connection.call(call::service_start(super::SERVICE)).await?;
    let controller: ControllerHandle =
        connection.call(call::controller_connect("", provider, super::MACHINE, "")).await?;
    let robot: RobotHandle = connection.call(call::controller_get_robot(controller, super::ROBOT, "")).await?;
    Ok(Handles { controller, robot })
}

/// Releases what [`open`] has opened, and stops the service.
///
/// # Errors
///
/// A [`CallError`].
pub async fn close<X: Transport<Error = io::Error>>(
    connection: &mut Link<X>,
    handles: Handles,
) -> Result<(), CallError> {
    connection.call(call::robot_release(handles.robot)).await?;
    connection.call(call::controller_disconnect(handles.controller)).await?;
    connection.call(call::service_stop()).await
}

/// A stream of Slave Mode over one connection that moves the robot, and perhaps another that watches.
///
/// # Examples
///
/// ```no_run
/// use bcap_std::asynch;
/// use bcap_std::core::bcap::slave::{Config, Format, Mode, PoseType, ReceiveFormat, ReceivePose, SlaveMode};
/// use bcap_std::slave::{Cycle, Next, asynch::{Stream, close, open}};
///
/// # async fn f() -> Result<(), Box<dyn std::error::Error>> {
/// let mut motion = asynch::connect_tcp("192.168.0.1:5007", &Default::default()).await?;
/// let handles = open(&mut motion, "CaoProv.DENSO.VRC9").await?;
/// let mode = SlaveMode { mode: Mode::Mode1, pose: PoseType::P };
/// let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::P));
/// let mut stream = Stream::<_>::new(Config::new(format, handles), motion, None)?;
/// // stands where it is for a second
/// let mut hold = |cycle: &Cycle<'_>| if cycle.number < 125 { Next::Pose(*cycle.start) } else { Next::Finish };
/// stream.run(&mut hold).await?;
/// let (mut motion, _) = stream.into_connections();
/// close(&mut motion, handles).await?;
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Stream<X, W = X> {
    engine: Engine,
    motion: Link<X>,
    watch: Option<Link<W>>,
}

impl<X, W> Stream<X, W>
where
    X: Transport<Error = io::Error>,
    W: Transport<Error = io::Error>,
{
    /// Makes a stream; nothing is sent yet.
    ///
    /// The handles of the configuration are those of these connections; without `watch` the controller's errors are read
    /// over the first connection.
    ///
    /// # Errors
    ///
    /// When the configuration contradicts itself.
    pub fn new(config: Config, motion: Link<X>, watch: Option<Link<W>>) -> Result<Self, ConfigError> {
        let watched = config.watch.filter(|_| watch.is_some());
        Ok(Self { engine: Engine::new(Config { watch: watched, ..config })?, motion, watch })
    }

    /// Starts Slave Mode, streams a trajectory, and leaves: until the robot stands and the arm is given back.
    ///
    /// # Errors
    ///
    /// A [`StreamError`]. After a fault the arm is still taken: [`recover`](Self::recover) and run again, or
    /// [`give_up`](Self::give_up).
    ///
    /// # Cancel safety
    ///
    /// None: when the future is dropped the poses end, and a robot in motion stops by an error. To end early, let the
    /// trajectory return [`Next::Stop`](super::Next::Stop).
    pub async fn run(&mut self, trajectory: &mut impl Trajectory) -> Result<(), StreamError> {
        let mut run = Run::default();
        loop {
            let time = now();
            match self.engine.poll(time) {
                Action::Call(_, channel) => self.call(channel, trajectory).await,
                Action::Pose { due } => run.pose(&mut self.engine, trajectory, due, time),
                Action::Wait(at) => tokio::time::sleep(until(at)).await,
                Action::Finished => return run.finished(),
                Action::Faulted => return fault(&self.engine),
            }
        }
    }

    async fn call(&mut self, channel: Channel, trajectory: &mut impl Trajectory) {
        let Self { engine, motion, watch } = self;
        let moved = |reply: &MoveReply<'_>| trajectory.moved(reply, now());
        let error = match (channel, watch) {
            (Channel::Watch, Some(watch)) => watch.carry_out(engine, |_| {}).await,
            _ => motion.carry_out(engine, moved).await,
        };
        if let Some(error) = error {
            tracing::debug!(%error, ?channel, "a call of the stream has no reply");
        }
    }

    /// Prepares to start anew after a fault: the next [`run`](Self::run) clears the controller's errors, switches the motor
    /// on and enters Slave Mode where the robot stands.
    ///
    /// # Errors
    ///
    /// After an emergency stop, without a connection, or without a fault.
    pub fn recover(&mut self) -> Result<(), RecoverError> {
        self.engine.recover()
    }

    /// Gives the arm back after a fault.
    ///
    /// # Errors
    ///
    /// The fault of doing so.
    pub async fn give_up(&mut self) -> Result<(), StreamError> {
        self.engine.stop();
        self.run(&mut |_: &super::Cycle<'_>| super::Next::Stop).await
    }

    /// Returns the figures so far; they go on over a recovery.
    #[must_use]
    pub const fn stats(&self) -> &Stats {
        self.engine.stats()
    }

    /// Returns the engine.
    #[must_use]
    pub const fn engine(&self) -> &Engine {
        &self.engine
    }

    /// Gives the connections back.
    #[must_use]
    pub fn into_connections(self) -> (Link<X>, Option<Link<W>>) {
        (self.motion, self.watch)
    }
}
