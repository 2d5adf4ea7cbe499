//! Runs one stream for `play` and `cosine`: opens the sessions, streams the poses, and writes the report.

use std::sync::Arc;
use std::time::Duration;
use std::{fs, io, iter};

use bcap_core::bcap::call::{self, RobotHandle};
use bcap_core::hresult::HResult;
use bcap_core::procedure::{
    ArmOwner, Claim, Effects, Procedure, Provider, Reclaimed, StepCause, open_robot, reclaim, release_robot,
};
use bcap_core::slave::{
    AxisLimits, Cause, Config, Engine, Failure as NoReply, Fault, Format, Handles, Stats, StreamError,
};
use bcap_core::time::Instant;
use bcap_std::blocking::{self, Transport as Wire};
use bcap_std::slave::Realtime;
use bcap_std::{Address, ConnectError, NetworkAddress, Options, Protocol, RunError};
use bcap_stream::player::{Course, Player};
use bcap_stream::plot::plot;
use bcap_stream::report::{Report, text};
use bcap_stream::status::StreamStatus;

use super::progress::StreamMonitor;
use crate::commands::slave::args::StreamArgs;
use crate::failure::{AFTER_STREAM, Failure, cannot};
use crate::interrupt::Interrupt;
use crate::link::LinkArgs;
use crate::output::{note, print_block, print_json};
use crate::session::connect::{failed, not_connected, unrecorded};
use crate::session::traffic::taped;

/// The size of the buffer for slvMove, in bytes: a datagram.
const MOVE_ROOM: usize = 512;

/// The time limit for releasing the arm, the motor and the objects after the stream, even if the controller is silent.
const END: Duration = Duration::from_secs(5);

/// The parameters of a stream.
#[derive(Clone, Copy)]
pub(crate) struct Job<'a> {
    pub(crate) format: Format,
    pub(crate) args: &'a StreamArgs,
    pub(crate) link: &'a LinkArgs,
    pub(crate) json: bool,
    pub(crate) target: &'a Address,
    pub(crate) interrupt: &'a Interrupt,
}

impl Job<'_> {
    /// Streams a course and reports the result.
    pub(crate) fn stream(self, course: Course) -> Result<(), Failure> {
        let mut options = Options::default().timeout(self.link.timeout());
        for lossy in [&mut options.udp.timing, &mut options.serial.timing] {
            lossy.attempts = self.link.attempts();
            // they share the time limit
            lossy.attempt_timeout = (self.link.timeout() / u32::from(lossy.attempts)).max(Duration::from_millis(1));
        }
        match self.target {
            Address::Serial(line) => {
                unrecorded(self.target)?;
                self.run(course, || blocking::connect_serial(line, &options))
            }
            Address::Network(NetworkAddress { protocol: Protocol::Udp, host, port }) => {
                self.run(course, || blocking::connect_udp((host.as_str(), *port), &options).map(taped))
            }
            _ => {
                let NetworkAddress { host, port, .. } = self.link.network_target()?;
                self.run(course, || blocking::connect_tcp((host.as_str(), port), &options).map(taped))
            }
        }
    }

    fn run<X: Wire<Error = io::Error>>(
        self,
        course: Course,
        connect: impl Fn() -> Result<blocking::Connection<X, Vec<u8>>, ConnectError>,
    ) -> Result<(), Failure> {
        let connect = || {
            let (transport, client) = connect().map_err(|error| not_connected(&error, self.target))?.into_parts();
            Ok::<_, Failure>(blocking::Connection::new(Limited { transport, end: None }, client))
        };
        let mut motion = connect()?;
        // a serial line carries one session
        let has_second = !matches!(self.target, Address::Serial(_));
        let mut watch = has_second.then(&connect).transpose()?;
        let machine = self.link.machine();
        let provider =
            Provider { machine: &machine, option: self.link.option(), ..Provider::new(self.link.provider()) };
        let handles = motion.run(open_robot(provider, None)).map_err(|error| self.not_opened(&error))?;
        let watching = watch.as_mut().map(|watch| watch.run(open_robot(provider, None))).transpose();
        let (watching, streamed) = match watching {
            Ok(watching) => (watching, self.run_open(course, &mut motion, watch.as_mut(), handles, watching)),
            Err(error) => (None, Err(self.not_opened(&error))),
        };
        // the report may have taken longer
        limit_end(&mut motion, watch.as_mut());
        let _ = motion.run(release_robot(handles));
        if let Some((watch, handles)) = watch.as_mut().zip(watching) {
            let _ = watch.run(release_robot(handles));
        }
        streamed
    }

    /// Streams over open sessions.
    fn run_open<X: Wire<Error = io::Error>>(
        self,
        course: Course,
        motion: &mut Connection<X>,
        mut watch: Option<&mut Connection<X>>,
        handles: Handles,
        watching: Option<Handles>,
    ) -> Result<(), Failure> {
        let Self { format, args, .. } = self;
        // a motor that was on before stays on
        let motor_off = !(args.keep_motor || motor_is_on(motion, handles.robot));
        let (start, limits) = (course.start(), limits(args));
        let config = Config { watch: watching, start, limits, motor_off, ..Config::new(format, handles) };
        let mut engine = Engine::<MOVE_ROOM>::new(config).map_err(|error| Failure::Input(error.to_string()))?;
        let monitor = StreamMonitor::start(self.link, self.interrupt.clone(), course.cycles())?;
        // after all other threads have started, so that they do not inherit the real-time settings
        let realtime = Realtime::default().fifo(args.fifo).lock_memory(args.lock_memory).core(args.core);
        realtime.apply().map_err(|error| Failure::Input(error.to_string()))?;
        let room = |wanted: bool| if wanted { course.cycles() as usize + 500 } else { 0 };
        let status = Arc::clone(&monitor.status);
        let (samples, replies) = (room(args.plot.is_some()), room(args.format.received.is_some()));
        let mut player = Player::new(course, &format)
            .with_outputs(args.format.outputs())
            .with_status(Arc::clone(&status))
            .keeping_samples(samples)
            .keeping_replies(replies);
        let ended = run_watched(motion, watch.as_deref_mut(), engine.stream(&mut player));
        let ended = ended.map_err(|error| error.error);
        limit_end(motion, watch.as_deref_mut());
        let fault = engine.fault().cloned();
        if fault.is_some() {
            // the fault is reported below; what is left on the robot is ended next
            let _ = run_watched(motion, watch.as_deref_mut(), engine.give_up());
        }
        drop(monitor);
        // the monitor may have waited for a halt for longer
        limit_end(motion, watch.as_deref_mut());
        let stats = engine.stats().clone();
        player.times.follow(&stats);
        end_left(engine.effects(), fault.as_ref(), watch.zip(watching));
        let reported = self.report(&stats, &player);
        self.end(ended, fault.as_ref(), &status)?;
        reported
    }

    /// Converts the error of opening a session.
    fn not_opened(&self, error: &RunError) -> Failure {
        let doing = error.error.function.to_string();
        match (error.error.cause, &error.call) {
            (StepCause::Refused(code), _) => Failure::Refused { doing, code },
            (_, Some(call)) => failed(call, self.target, self.link.timeout(), &doing),
            (cause, None) => Failure::Connection {
                message: format!("{doing}: {cause}"),
                hint: format!("check that {} is a b-CAP server", self.target),
            },
        }
    }

    /// Writes and prints the results.
    fn report(&self, stats: &Stats, player: &Player) -> Result<(), Failure> {
        let report = Report::of(stats, &player.times).to_json();
        if let Some(path) = &self.args.report {
            fs::write(path, format!("{report}\n")).map_err(cannot("write the report", path))?;
        }
        if let Some(path) = &self.args.format.received {
            player.received.write(path).map_err(cannot("write", path))?;
        }
        if let Some(path) = self.args.plot.as_ref().filter(|_| stats.cycles > 1) {
            plot(path, self.format.mode.pose, &player.samples).map_err(Failure::Input)?;
        }
        if self.json {
            print_json(&report)?;
        } else if stats.cycles > 0 {
            print_block(&text(stats, &player.times))?;
        }
        Ok(())
    }

    fn end(&self, ended: Result<(), StreamError>, fault: Option<&Fault>, status: &StreamStatus) -> Result<(), Failure> {
        match (ended, fault) {
            _ if status.was_halted() => Err(Failure::Interrupted("interrupted twice: the robot was halted".into())),
            (Ok(()), _) if status.is_stopped() => {
                Err(Failure::Interrupted("interrupted: the robot has stopped and the arm is released".into()))
            }
            (Ok(()), _) => Ok(()),
            (Err(StreamError::Fault { .. }), Some(fault)) => Err(self.fault(fault)),
            (Err(error), _) => Err(Failure::Input(format!("{error}; the robot was stopped and the arm released"))),
        }
    }

    /// Converts a fault of the stream.
    fn fault(&self, fault: &Fault) -> Failure {
        let mut message = fault.to_string();
        if let Some(meaning) = fault.code().and_then(HResult::meaning).filter(|_| fault.errors().is_empty()) {
            message += &format!(": {}", meaning.trim_end_matches('.'));
        }
        if fault.emergency_stop == Some(true) {
            message += "; the emergency stop is pressed";
        }
        match fault.cause {
            Cause::Failed(NoReply::Timeout) => Failure::Timeout {
                message: format!("{}: {message}", self.target),
                hint: "check the network and the controller with `bcap doctor`".into(),
            },
            Cause::Failed(_) => Failure::Connection {
                message: format!("{}: {message}", self.target),
                hint: "check the network and the controller with `bcap doctor`".into(),
            },
            Cause::Occupied(_) => Failure::Unfit {
                message: format!("{message}; nothing was moved"),
                code: Some(HResult::E_SLVMODE_ON),
                hint: Some(AFTER_STREAM.into()),
            },
            Cause::NotAtStart { .. } => Failure::unfit(
                message,
                match self.target {
                    Address::Serial(_) => {
                        "move the robot to the first pose before the stream, for example with `bcap move`"
                    }
                    _ => "give --approach to move the robot to the first pose before the stream",
                },
            ),
            _ => Failure::Unfit { message, code: fault.code(), hint: None },
        }
    }
}

/// A connection of the stream.
type Connection<X> = blocking::Connection<Limited<X>, Vec<u8>>;

/// A transport that fails from a point of time on.
struct Limited<X> {
    transport: X,
    end: Option<Instant>,
}

impl<X: Wire<Error = io::Error>> Limited<X> {
    fn end_within(&mut self, time: Duration) {
        self.end = Some(self.transport.now() + time);
    }

    /// Returns the earlier of `until` and the end.
    fn limited(&self, until: Instant) -> io::Result<Instant> {
        match self.end {
            Some(end) if end <= self.transport.now() => Err(io::ErrorKind::TimedOut.into()),
            end => Ok(end.map_or(until, |end| end.min(until))),
        }
    }
}

impl<X: Wire<Error = io::Error>> Wire for Limited<X> {
    type Error = io::Error;

    fn now(&self) -> Instant {
        self.transport.now()
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        let until = self.limited(until)?;
        self.transport.send(bytes, until)
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        let until = self.limited(until)?;
        self.transport.receive(buffer, until)
    }

    fn sleep_until(&mut self, at: Instant) {
        self.transport.sleep_until(self.end.map_or(at, |end| end.min(at)));
    }
}

/// Limits the calls from now on, which end the stream.
fn limit_end<X: Wire<Error = io::Error>>(motion: &mut Connection<X>, watch: Option<&mut Connection<X>>) {
    for connection in iter::once(motion).chain(watch) {
        connection.transport().end_within(END);
    }
}

/// Returns the limits of the command line.
pub(super) fn limits(args: &StreamArgs) -> AxisLimits {
    let limit = |limit: Option<f64>| limit.unwrap_or(f64::INFINITY);
    AxisLimits::uniform(limit(args.max_speed), limit(args.max_acceleration))
}

/// Ends, over the second connection, the effects of a stream whose first one is lost, and reports those that may remain.
fn end_left<X: Wire<Error = io::Error>>(
    left: Effects,
    fault: Option<&Fault>,
    watch: Option<(&mut blocking::Connection<X, Vec<u8>>, Handles)>,
) {
    if !(left.moving || left.streaming || left.motor) {
        return;
    }
    // if the connection was closed, and is not merely silent, the controller ends the session, too
    let is_closed = matches!(fault.map(|fault| fault.cause), Some(Cause::Failed(NoReply::Lost | NoReply::Closed)));
    let claim = if is_closed { Claim::Unknown } else { Claim::Lost };
    let done = watch.map(|(watch, handles)| watch.run(reclaim(handles.robot, Effects { claim, ..left })));
    let problem = match done {
        Some(Ok(Reclaimed { owner: ArmOwner::Other, .. })) => "another client uses the robot".to_owned(),
        Some(Ok(Reclaimed { halted, motor_off, .. }))
            if halted != Some(false) && motor_off == left.motor.then_some(true) =>
        {
            return;
        }
        Some(Ok(_)) => "the controller refused the calls that end it".to_owned(),
        Some(Err(error)) => error.to_string(),
        None => "the connection is lost".to_owned(),
    };
    note(&format!(
        "the robot may still move, or its motor be on: {problem}; `bcap halt` halts it, `bcap get robot/@SERVO_ON` tells"
    ));
}

/// Returns whether the motor is on; false if the controller does not answer.
fn motor_is_on<X: Wire<Error = io::Error>>(motion: &mut blocking::Connection<X, Vec<u8>>, robot: RobotHandle) -> bool {
    let Ok(variable) = motion.call(call::robot_get_variable(robot, "@SERVO_ON", "")) else { return false };
    let is_on = motion.call(call::variable_get_value(variable)).is_ok_and(|value| value.as_bool() == Some(true));
    // a variable that cannot be released is released with the session
    let _ = motion.call(call::variable_release(variable));
    is_on
}

/// Runs a procedure with a second connection, if there is one.
fn run_watched<X: Wire<Error = io::Error>, P: Procedure>(
    motion: &mut blocking::Connection<X, Vec<u8>>,
    watch: Option<&mut blocking::Connection<X, Vec<u8>>>,
    procedure: P,
) -> Result<P::Output, RunError<P::Error>> {
    match watch {
        Some(watch) => motion.run_watched(watch, procedure),
        None => motion.run(procedure),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A silent controller: every wait lasts as long as it may.
    struct Silent(Instant);

    impl Wire for Silent {
        type Error = io::Error;

        fn now(&self) -> Instant {
            self.0
        }

        fn send(&mut self, bytes: &[u8], _until: Instant) -> io::Result<Option<usize>> {
            Ok(Some(bytes.len()))
        }

        fn receive(&mut self, _buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
            self.0 = self.0.max(until);
            Ok(None)
        }

        fn sleep_until(&mut self, at: Instant) {
            self.0 = self.0.max(at);
        }
    }

    #[test]
    fn all_calls_after_the_stream_share_one_time_limit() {
        let client = bcap_core::bcap::Client::new(Options::default().tcp, vec![0; 512], vec![0; 512]);
        let transport = Limited { transport: Silent(Instant::ZERO), end: None };
        let mut connection = blocking::Connection::new(transport, client);
        connection.transport().end_within(END);
        for _ in 0..10 {
            connection.call(call::robot_execute(RobotHandle(1), "Motor", [0, 0])).unwrap_err();
            connection.transport().sleep_until(Instant::ZERO + END * 2);
        }
        assert_eq!(connection.transport().now(), Instant::ZERO + END);
    }
}
