//! Streams of Slave Mode on a board: the core's [`Engine`] with embassy's clock and timer, and any transport.
//!
//! ```text
//!   Trajectory ──pose──► Engine ──call──► motion connection ──► controller
//!                          │  └──call──► watch connection, if the board has room for one
//!                          └ waits for times, not for durations: a late cycle does not shift the next
//! ```
//!
//! It does what `bcap_std::slave` does: an orderly end, a ramp on request, the controller's first error after a fault, and
//! recovery only on request and never after an emergency stop.

use core::fmt;

use bcap_core::bcap::call::{self, ControllerHandle, RobotHandle};
use bcap_core::bcap::slave::{
    Action, Channel, Config, ConfigError, Engine, Handles, MOVE_FRAME, MoveReply, PoseError, RecoverError, Stats,
};
pub use bcap_core::bcap::slave::{Cycle, Next, Trajectory};
use bcap_core::io::CallError;
use bcap_core::io::asynch::{Connection, Transport};
use bcap_core::storage::Storage;
use embassy_time::Timer;

use crate::clock::{now, ticks};

/// Starts the service on a connection, and gets the handles of its controller and its first robot.
///
/// # Errors
///
/// A [`CallError`].
///
/// # Cancel safety
///
/// When the future is dropped, what was opened stays open until the connection ends.
pub async fn open<X: Transport, T: Storage, R: Storage>(
    connection: &mut Connection<X, T, R>,
    provider: &str,
) -> Result<Handles, CallError<X::Error>> {
    connection.call(call::service_start("WDT=400")).await?;
    let controller: ControllerHandle = connection.call(call::controller_connect("", provider, "localhost", "")).await?;
    let robot: RobotHandle = connection.call(call::controller_get_robot(controller, "Arm0", "")).await?;
    Ok(Handles { controller, robot })
}

/// Why a stream has not gone to its end.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum StreamError {
    /// A call has failed; [`Engine::fault`] says which and why.
    Fault,
    /// The trajectory gave a pose that may not be sent; the robot was stopped in an orderly way and the arm given back.
    Pose {
        /// Poses that were given before it.
        number: u32,
        /// What is wrong with it.
        error: PoseError,
    },
}

impl fmt::Display for StreamError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fault => f.write_str("the stream has failed"),
            Self::Pose { number, error } => write!(f, "pose {number}: {error}"),
        }
    }
}

impl core::error::Error for StreamError {}

/// A stream of Slave Mode over one connection that moves the robot, and perhaps another that watches.
///
/// `N` is the room for the frame of slvMove. The memory of the connections is the caller's.
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::slave::{Config, Format, Mode, PoseType, ReceiveFormat, ReceivePose, SlaveMode};
/// use bcap_core::io::asynch::{Connection, Transport};
/// use bcap_embassy::slave::{Cycle, Next, Stream, open};
///
/// /// Holds the robot where it stands, for a second.
/// async fn hold<X: Transport>(link: &mut Connection<X, &mut [u8]>) -> Option<u32> {
///     let handles = open(link, "CaoProv.DENSO.VRC9").await.ok()?;
///     let mode = SlaveMode { mode: Mode::Mode2, pose: PoseType::J };
///     let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
///     let mut stream = Stream::<_, _, _>::new(Config::new(format, handles), link, None).ok()?;
///     let mut still = |cycle: &Cycle<'_>| if cycle.number < 125 { Next::Pose(*cycle.start) } else { Next::Finish };
///     stream.run(&mut still).await.ok()?;
///     Some(stream.stats().late)
/// }
/// ```
#[derive(Debug)]
pub struct Stream<'c, X, T, R = T, const N: usize = MOVE_FRAME> {
    engine: Engine<N>,
    motion: &'c mut Connection<X, T, R>,
    watch: Option<&'c mut Connection<X, T, R>>,
}

impl<'c, X: Transport, T: Storage, R: Storage, const N: usize> Stream<'c, X, T, R, N> {
    /// Makes a stream; nothing is sent yet.
    ///
    /// The handles of the configuration are those of these connections; without `watch` the controller's errors are read
    /// over the first connection.
    ///
    /// # Errors
    ///
    /// When the configuration contradicts itself, or `N` bytes do not hold the frame of slvMove.
    pub fn new(
        config: Config,
        motion: &'c mut Connection<X, T, R>,
        watch: Option<&'c mut Connection<X, T, R>>,
    ) -> Result<Self, ConfigError> {
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
    /// trajectory return [`Next::Stop`].
    pub async fn run(&mut self, trajectory: &mut impl Trajectory) -> Result<(), StreamError> {
        let (mut given, mut refused) = (0_u32, None);
        loop {
            let time = now();
            match self.engine.poll(time) {
                Action::Call(_, channel) => self.call(channel, trajectory).await,
                Action::Pose { due } => match self.engine.supply(trajectory, given, due, time) {
                    Ok(()) => given = given.saturating_add(1),
                    Err(error) => refused = Some(StreamError::Pose { number: given, error }),
                },
                Action::Wait(at) => Timer::at(ticks(at)).await,
                Action::Finished => return refused.map_or(Ok(()), Err),
                Action::Faulted => return Err(StreamError::Fault),
            }
        }
    }

    async fn call(&mut self, channel: Channel, trajectory: &mut impl Trajectory) {
        let Self { engine, motion, watch } = self;
        let moved = |reply: &MoveReply<'_>| trajectory.moved(reply, now());
        // the engine knows of a call without a reply, and goes on from there
        let _lost = match (channel, watch) {
            (Channel::Watch, Some(watch)) => watch.carry_out(engine, |_| {}).await,
            _ => motion.carry_out(engine, moved).await,
        };
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
    ///
    /// # Cancel safety
    ///
    /// When the future is dropped the arm may still be taken; it is free when the connection ends.
    pub async fn give_up(&mut self) -> Result<(), StreamError> {
        self.engine.stop();
        self.run(&mut |_: &Cycle<'_>| Next::Stop).await
    }

    /// Returns the figures so far; they go on over a recovery.
    #[must_use]
    pub const fn stats(&self) -> &Stats {
        self.engine.stats()
    }

    /// Returns the engine.
    #[must_use]
    pub const fn engine(&self) -> &Engine<N> {
        &self.engine
    }
}
