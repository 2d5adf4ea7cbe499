//! Runs one stream for `play` and `cosine`: opens the sessions, streams the poses, and writes the report.

use std::fs;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::procedure::{Provider, StepCause, open_robot, release_robot};
use bcap_core::slave::{
    AxisLimits, Cause, Config, Cycle, Engine, Failure as NoReply, Fault, Format, Handles, MOVE_FRAME, Mode, MoveReply,
    Next, Pose, PoseType, ReceiveFormat, ReceivePose, SlaveMode, Stats, StreamError, Trajectory,
};
use bcap_core::time::Instant;
use bcap_std::blocking::{self, Transport as Wire};
use bcap_std::slave::Realtime;
use bcap_std::{CallError, ConnectError, Options, RunError};

use super::monitor::{Monitor, StreamStatus, signals};
use super::report::{Report, StreamTimes, text};
use super::sample::Sample;
use crate::args::{LinkArgs, StreamArgs};
use crate::connection::{failed, not_connected};
use crate::error::Failure;
use crate::output::{print_block, print_json};
use crate::record::taped;
use bcap_std::{Address, Protocol};

/// The attempts of a call over UDP, which share the time limit.
const UDP_ATTEMPTS: u8 = 5;

/// The path of the robot.
pub(crate) enum Course {
    /// A sequence of poses, played `loops` times.
    Poses {
        /// One pose per cycle.
        poses: Vec<Pose>,
        /// The number of repetitions.
        loops: u32,
        /// The speed of a motion to the first pose before the stream, in percent; `None` without such a motion.
        approach: Option<f64>,
    },
    /// One period of a cosine from the current pose.
    Cosine {
        /// The period in cycles.
        cycles: u32,
        /// The distance to the turning point, in degrees or mm.
        amplitude: f64,
    },
}

impl Course {
    /// Returns the number of cycles.
    pub(crate) fn cycles(&self) -> u32 {
        match self {
            Self::Poses { poses, loops, .. } => u32::try_from(poses.len()).unwrap_or(u32::MAX).saturating_mul(*loops),
            Self::Cosine { cycles, .. } => *cycles,
        }
    }

    fn pose(&self, cycle: &Cycle<'_>) -> Option<Pose> {
        match self {
            _ if cycle.number >= self.cycles() => None,
            Self::Poses { poses, .. } => poses.get(cycle.number as usize % poses.len().max(1)).copied(),
            Self::Cosine { cycles, amplitude } => {
                let part = f64::from(cycle.number + 1) / f64::from(*cycles);
                let by = amplitude / 2.0 * (1.0 - (part * std::f64::consts::TAU).cos());
                let mut numbers = cycle.start.numbers().to_vec();
                let kind = cycle.start.shape().pose;
                // joint 1, or Z
                if let Some(number) = numbers.get_mut(if kind == PoseType::J { 0 } else { 2 }) {
                    *number += by;
                }
                Pose::from_numbers(kind, &numbers)
            }
        }
    }

    /// Returns the pose where the stream starts; `None` for the current pose.
    fn start(&self) -> Option<Pose> {
        match self {
            Self::Poses { poses, .. } => poses.first().copied(),
            Self::Cosine { .. } => None,
        }
    }
}

/// The trajectory of a running stream.
struct Player {
    course: Course,
    status: Arc<StreamStatus>,
    kind: PoseType,
    commanded: [f64; 10],
    began: Option<Instant>,
    times: StreamTimes,
    /// The cycles for the plot. It never grows beyond its initial capacity, so recording does not allocate.
    samples: Vec<Sample>,
}

impl Trajectory for Player {
    fn next(&mut self, cycle: &Cycle<'_>) -> Next {
        self.times.follow(cycle.stats);
        self.status.update(cycle.number, cycle.stats.late, cycle.stats.refused, cycle.margin);
        if self.status.is_stopped() {
            return Next::Stop;
        }
        match self.course.pose(cycle) {
            Some(pose) => {
                self.commanded = padded(pose.numbers());
                Next::Pose(pose)
            }
            None => Next::Finish,
        }
    }

    fn moved(&mut self, reply: &MoveReply<'_>, now: Instant) {
        if self.samples.len() == self.samples.capacity() {
            return;
        }
        let began = *self.began.get_or_insert(now);
        let mut actual = [0.0; 10];
        for (slot, number) in actual.iter_mut().zip(reply.pose().iter().take(self.kind.len())) {
            *slot = number;
        }
        let at = now.saturating_since(began).as_secs_f64();
        self.samples.push(Sample { at, commanded: self.commanded, actual });
    }
}

fn padded(numbers: &[f64]) -> [f64; 10] {
    let mut out = [0.0; 10];
    for (slot, number) in out.iter_mut().zip(numbers) {
        *slot = *number;
    }
    out
}

/// Streams a course and reports the result.
pub(crate) fn stream(
    course: Course,
    kind: PoseType,
    args: &StreamArgs,
    link: &LinkArgs,
    json: bool,
) -> Result<(), Failure> {
    let realtime = Realtime::default().fifo(args.fifo).lock_memory(args.lock_memory).core(args.core);
    let server = link.network_target()?;
    let mut options = Options::default().timeout(link.timeout());
    options.udp.timing.attempts = UDP_ATTEMPTS;
    options.udp.timing.attempt_timeout = (link.timeout() / u32::from(UDP_ATTEMPTS)).max(Duration::from_millis(1));
    let (peer, target) = ((server.host.as_str(), server.port), Address::Network(server.clone()));
    match server.protocol {
        Protocol::Tcp => {
            let connect = || blocking::connect_tcp(peer, &options).map(taped);
            Job { course, kind, args, link, json, realtime, target: &target }.run(connect)
        }
        Protocol::Udp => {
            let connect = || blocking::connect_udp(peer, &options).map(taped);
            Job { course, kind, args, link, json, realtime, target: &target }.run(connect)
        }
    }
}

/// The parameters of a stream.
struct Job<'a> {
    course: Course,
    kind: PoseType,
    args: &'a StreamArgs,
    link: &'a LinkArgs,
    json: bool,
    realtime: Realtime,
    target: &'a Address,
}

impl Job<'_> {
    fn run<X: Wire<Error = io::Error>>(
        self,
        connect: impl Fn() -> Result<blocking::Connection<X, Vec<u8>>, ConnectError>,
    ) -> Result<(), Failure> {
        // install the signal handlers first: the user may press Ctrl-C right after confirming
        let signals = signals()?;
        let mut motion = connect().map_err(|error| not_connected(&error, self.target))?;
        let mut watch = connect().map_err(|error| not_connected(&error, self.target))?;
        let provider = Provider {
            machine: self.link.machine(),
            option: self.link.option(),
            ..Provider::new(self.link.provider())
        };
        let opened = |error: RunError| self.not_opened(&error);
        let handles = motion.run(open_robot(provider, None)).map_err(opened)?;
        let watching = watch.run(open_robot(provider, None)).map_err(opened)?;
        let config = self.config(handles, watching);
        if let Course::Poses { poses, approach: Some(percent), .. } = &self.course
            && let Some(first) = poses.first()
        {
            self.approach(&mut motion, handles, first, *percent)?;
        }
        let monitor = Monitor::start(self.link, signals, self.course.cycles())?;
        let mut engine = Engine::<MOVE_FRAME>::new(config).map_err(|error| Failure::Input(error.to_string()))?;
        // after all other threads have started, so that they do not inherit the real-time settings
        self.realtime.apply().map_err(|error| Failure::Input(error.to_string()))?;
        let room = if self.args.plot.is_some() { self.course.cycles() as usize + 500 } else { 0 };
        let Self { course, kind, .. } = self;
        let mut player = Player {
            course,
            status: Arc::clone(&monitor.status),
            kind,
            commanded: [0.0; 10],
            began: None,
            times: StreamTimes::new(),
            samples: Vec::with_capacity(room),
        };
        let ended = motion.run_beside(&mut watch, engine.stream(&mut player)).map_err(|error| error.error);
        let fault = engine.fault().cloned();
        if fault.is_some() {
            // the fault is reported below; a failure to release the arm adds no information
            let _ = motion.run_beside(&mut watch, engine.give_up());
        }
        let status = Arc::clone(&monitor.status);
        monitor.end();
        let stats = engine.stats().clone();
        player.times.follow(&stats);
        let _ = motion.run(release_robot(handles));
        let _ = watch.run(release_robot(watching));
        let job = Outcome { args: self.args, json: self.json, target: self.target };
        let reported = job.report(&stats, kind, &player);
        job.end(ended, fault.as_ref(), &status)?;
        reported
    }

    fn config(&self, motion: Handles, watch: Handles) -> Config {
        let mode = SlaveMode { mode: Mode::from(self.args.mode), pose: self.kind };
        let receive = match self.kind {
            PoseType::J => ReceivePose::J,
            PoseType::P => ReceivePose::P,
            PoseType::T => ReceivePose::T,
        };
        let limit = |limit: Option<f64>| limit.unwrap_or(f64::INFINITY);
        Config {
            watch: Some(watch),
            start: self.course.start(),
            limits: AxisLimits::uniform(limit(self.args.max_speed), limit(self.args.max_acceleration)),
            ..Config::new(Format::new(mode, ReceiveFormat::pose(receive)), motion)
        }
    }

    /// Moves the robot to a pose by an ordinary motion, which ends exactly there (`@E`).
    fn approach<X: Wire<Error = io::Error>>(
        &self,
        motion: &mut blocking::Connection<X, Vec<u8>>,
        handles: Handles,
        pose: &Pose,
        percent: f64,
    ) -> Result<(), Failure> {
        let numbers: Vec<String> = pose.numbers().iter().map(f64::to_string).collect();
        let to = format!("@E {:?}({})", self.kind, numbers.join(","));
        let robot = handles.robot;
        let mut execute = |command: &str, parameter: [i32; 2]| {
            let done = motion.call(call::robot_execute(robot, command, parameter)).map(drop);
            done.map_err(|error| self.not_called(&error, command))
        };
        execute("TakeArm", [0, 1])?;
        execute("Motor", [1, 0])?;
        let moved = motion.call(call::robot_move(robot, 1, to.as_str(), format!("SPEED={percent}").as_str()));
        let moved = moved.map(drop).map_err(|error| self.not_called(&error, &format!("Robot_Move {to}")));
        let released = motion.call(call::robot_execute(robot, "GiveArm", ())).map(drop);
        moved?;
        released.map_err(|error| self.not_called(&error, "GiveArm"))
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

    /// Converts the error of a call.
    fn not_called(&self, error: &CallError, doing: &str) -> Failure {
        match error.hresult() {
            Some(code) => Failure::Refused { doing: doing.into(), code },
            None => failed(error, self.target, self.link.timeout(), doing),
        }
    }
}

/// Reports a stream that has ended.
struct Outcome<'a> {
    args: &'a StreamArgs,
    json: bool,
    target: &'a Address,
}

impl Outcome<'_> {
    fn report(&self, stats: &Stats, kind: PoseType, player: &Player) -> Result<(), Failure> {
        let report = Report::of(stats, &player.times).to_json();
        if let Some(path) = &self.args.report {
            fs::write(path, format!("{report}\n"))
                .map_err(|error| Failure::Input(format!("cannot write the report {}: {error}", path.display())))?;
        }
        if let Some(path) = self.args.plot.as_ref().filter(|_| stats.cycles > 1) {
            super::plot::plot(path, kind, &player.samples)?;
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
            Cause::NotAtStart { .. } => Failure::Unfit {
                message,
                code: None,
                hint: Some("give --approach to move the robot to the first pose before the stream".into()),
            },
            _ => Failure::Unfit { message, code: fault.code(), hint: None },
        }
    }
}
