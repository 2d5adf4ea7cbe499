//! Streams of Slave Mode that block their thread.

use std::io;
use std::thread;

use bcap_core::bcap::call::{self, ControllerHandle, RobotHandle};
use bcap_core::bcap::slave::{Action, Channel, Config, ConfigError, Engine, Handles, MoveReply, RecoverError, Stats};
use bcap_core::time::Instant;

use super::{Run, StreamError, Trajectory, fault};
use crate::CallError;
use crate::blocking::{Connection, Transport};
use crate::clock::{now, until};

/// A connection of a stream: over TCP or UDP.
pub type Link<X> = Connection<X, Vec<u8>>;

/// Starts the service on a connection, and gets the handles of its controller and its first robot.
///
/// # Errors
///
/// A [`CallError`].
pub fn open<X: Transport<Error = io::Error>>(connection: &mut Link<X>, provider: &str) -> Result<Handles, CallError> {
    connection.call(call::service_start(super::SERVICE))?;
    let controller: ControllerHandle = connection.call(call::controller_connect("", provider, super::MACHINE, ""))?;
    let robot: RobotHandle = connection.call(call::controller_get_robot(controller, super::ROBOT, ""))?;
    Ok(Handles { controller, robot })
}

/// Releases what [`open`] has opened, and stops the service.
///
/// # Errors
///
/// A [`CallError`].
pub fn close<X: Transport<Error = io::Error>>(connection: &mut Link<X>, handles: Handles) -> Result<(), CallError> {
    connection.call(call::robot_release(handles.robot))?;
    connection.call(call::controller_disconnect(handles.controller))?;
    connection.call(call::service_stop())
}

/// A stream of Slave Mode over one connection that moves the robot, and perhaps another that watches.
///
/// # Examples
///
/// One degree about the first joint, there and back:
///
/// ```no_run
/// use bcap_std::blocking;
/// use bcap_std::core::bcap::slave::{AxisLimits, Config, Format, Mode, Pose, PoseType, ReceiveFormat, ReceivePose, SlaveMode};
/// use bcap_std::slave::{Cycle, Next, Realtime, blocking::{Stream, close, open}};
///
/// let mut motion = blocking::connect_udp("192.168.0.1:5007", &Default::default())?;
/// let mut watch = blocking::connect_tcp("192.168.0.1:5007", &Default::default())?;
/// let handles = open(&mut motion, "CaoProv.DENSO.VRC9")?;
/// let watching = open(&mut watch, "CaoProv.DENSO.VRC9")?;
///
/// let mode = SlaveMode { mode: Mode::Mode2, pose: PoseType::J };
/// let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
/// let limits = AxisLimits::uniform(100.0, 800.0);
/// let config = Config { watch: Some(watching), limits, ..Config::new(format, handles) };
/// let mut stream = Stream::new(config, motion, Some(watch))?;
///
/// Realtime { fifo: Some(80), lock_memory: true, core: Some(1) }.apply()?;
/// stream.run(&mut |cycle: &Cycle<'_>| {
///     let turn = f64::from(cycle.number) / 250.0;
///     if turn > 1.0 {
///         return Next::Finish;
///     }
///     let mut joints: [f64; 8] = cycle.start.numbers().try_into().unwrap_or_default();
///     joints[0] += 0.5 * (1.0 - (turn * std::f64::consts::TAU).cos());
///     Next::Pose(Pose::j(joints))
/// })?;
/// println!("{} cycles, {} late, round trip {} us", stream.stats().cycles, stream.stats().late, stream.stats().rtt.quantile(500));
/// let (mut motion, _) = stream.into_connections();
/// close(&mut motion, handles)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
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
    pub fn run(&mut self, trajectory: &mut impl Trajectory) -> Result<(), StreamError> {
        let mut run = Run::default();
        loop {
            let time = now();
            match self.engine.poll(time) {
                Action::Call(_, channel) => self.call(channel, trajectory),
                Action::Pose { due } => run.pose(&mut self.engine, trajectory, due, time),
                Action::Wait(at) => sleep_until(at),
                Action::Finished => return run.finished(),
                Action::Faulted => return fault(&self.engine),
            }
        }
    }

    fn call(&mut self, channel: Channel, trajectory: &mut impl Trajectory) {
        let Self { engine, motion, watch } = self;
        let moved = |reply: &MoveReply<'_>| trajectory.moved(reply, now());
        let error = match (channel, watch) {
            (Channel::Watch, Some(watch)) => watch.carry_out(engine, |_| {}),
            _ => motion.carry_out(engine, moved),
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
    pub fn give_up(&mut self) -> Result<(), StreamError> {
        self.engine.stop();
        self.run(&mut |_: &super::Cycle<'_>| super::Next::Stop)
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

/// Sleeps until a time has come.
fn sleep_until(at: Instant) {
    loop {
        let rest = until(at);
        if rest.is_zero() {
            return;
        }
        thread::sleep(rest);
    }
}
