//! The draws of a trial: all of them follow from the seed and the number of the trial.

use std::time::Duration;

use bcap_sim::Profile;
use bcap_testkit::network::Random;
use serde::{Deserialize, Serialize};

use crate::proxy::Cut;

/// The program whose end is tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Program {
    /// A process with the blocking library.
    Blocking,
    /// A process with the library for tokio.
    Tokio,
    /// `bcap move`.
    Move,
    /// `bcap run FILE`.
    Run,
    /// `bcap shell` with the lines on its standard input.
    Shell,
    /// `bcap slave cosine`.
    Slave,
}

impl Program {
    /// Returns whether the program is the command `bcap`.
    #[must_use]
    pub(super) const fn is_command(self) -> bool {
        matches!(self, Self::Move | Self::Run | Self::Shell | Self::Slave)
    }
}

/// A motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum Way {
    /// Point to point to a destination as text.
    Joint(String),
    /// Along a line to a destination as text.
    Line(String),
    /// Point to point to numbers.
    Numbers([f64; 6]),
    /// Turns axes by degrees.
    DriveBy(Vec<(u8, f64)>),
    /// To this many mm before the variable P10.
    Approach(f64),
    /// Back by this many mm.
    Depart(f64),
}

/// A motion with its pass and speed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Leg {
    /// Where it goes.
    pub(super) way: Way,
    /// Whether the next motion may begin before this one has ended.
    pub(super) near: bool,
    /// In percent.
    pub(super) speed: f64,
}

/// The work of the program with the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum Job {
    /// One motion that is waited for.
    Move(Leg),
    /// Motions that follow each other without a stop.
    Chain(Vec<Leg>),
    /// A stream of Slave Mode.
    Stream {
        /// The number of poses.
        cycles: u32,
        /// The distance of joint 1 from its start at the end.
        degrees: f64,
    },
}

/// A signal for the process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Signal {
    Int,
    Term,
    Hup,
    Tstp,
    Kill,
}

/// How a trial ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Ending {
    /// The program runs to its end.
    Completes,
    /// The time limit of the motion passes.
    TimeLimit,
    /// `?` out of main during the motion.
    Question,
    /// A panic in main.
    Panic,
    /// A panic in the thread or the task that owns the arm.
    PanicTask,
    /// A panic in the trajectory.
    PanicTrajectory,
    /// The drop of the future, by a timeout.
    DropFuture,
    /// The drop of the `Moving`.
    DropMoving,
    /// The drop of the `Arm` during a motion.
    DropArm,
    /// The drop of all objects during a motion.
    DropController,
    /// The drop of the runtime while a task moves the robot.
    DropRuntime,
    /// The end of the task that moves the robot, by `abort`.
    AbortTask,
    /// A halt by a `Stopper` of the same process.
    Stopper,
    /// `std::process::abort`.
    Abort,
    /// `std::process::exit`.
    Exit,
    /// A halt by another client.
    SecondClient,
    /// The emergency stop.
    EmergencyStop,
    /// An error of the controller.
    Error(u32),
    /// The controller dies: its connections are reset. It starts again with a new state, or keeps its state.
    Killed {
        /// Whether the state is new.
        reset: bool,
    },
    /// The link is cut.
    Cut(Cut),
    /// The process gets a signal.
    Signal(Signal),
}

impl Ending {
    /// Returns the row of the table.
    #[must_use]
    pub(super) const fn row(self) -> &'static str {
        match self {
            Self::Completes => "runs to its end",
            Self::TimeLimit => "time limit",
            Self::Question => "? out of main",
            Self::Panic => "panic in main",
            Self::PanicTask => "panic in a task",
            Self::PanicTrajectory => "panic in the trajectory",
            Self::DropFuture => "drop of the future",
            Self::DropMoving => "drop of Moving",
            Self::DropArm => "drop of Arm",
            Self::DropController => "drop of Controller",
            Self::DropRuntime => "drop of the runtime",
            Self::AbortTask => "abort of the task",
            Self::Stopper => "Stopper",
            Self::SecondClient => "halt by another client",
            Self::EmergencyStop => "emergency stop",
            Self::Error(_) => "error of the controller",
            Self::Killed { reset: true } => "killed controller",
            Self::Killed { reset: false } => "killed, state is kept",
            Self::Signal(Signal::Int) => "SIGINT",
            Self::Signal(Signal::Term) => "SIGTERM",
            Self::Signal(Signal::Hup) => "SIGHUP",
            Self::Signal(Signal::Tstp) => "SIGTSTP",
            Self::Signal(Signal::Kill) => "SIGKILL",
            Self::Abort => "abort of the process",
            Self::Exit => "exit of the process",
            Self::Cut(Cut::Fin | Cut::Reset) => "link closed",
            Self::Cut(_) => "link cut silently",
        }
    }

    /// Returns whether the program or its link cannot act any more, so that the rest is left to the controller's watchdog.
    #[must_use]
    pub(super) const fn is_apart(self) -> bool {
        matches!(
            self,
            Self::Abort | Self::Exit | Self::Cut(_) | Self::Killed { reset: false } | Self::Signal(Signal::Kill)
        )
    }

    /// Returns whether the program itself causes the ending.
    #[must_use]
    pub(super) const fn is_inside(self) -> bool {
        !matches!(
            self,
            Self::SecondClient
                | Self::EmergencyStop
                | Self::Error(_)
                | Self::Killed { .. }
                | Self::Cut(_)
                | Self::Signal(_)
        )
    }
}

/// From when the time of the ending counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Since {
    /// From the start: of the process for the command, of the job for a program of the library.
    Start,
    /// From when the controller has accepted the first motion, or has entered Slave Mode.
    Motion,
}

/// A trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Trial {
    /// The seed of all trials.
    pub(super) seed: u64,
    /// The number of the trial, from 0.
    pub(super) number: u64,
    /// The model, an index of [`Profile::ALL`].
    pub(super) model: usize,
    /// Whether the link is UDP.
    pub(super) udp: bool,
    /// The program.
    pub(super) program: Program,
    /// The work of the program.
    pub(super) job: Job,
    /// How it ends.
    pub(super) ending: Ending,
    /// From when `at_us` counts.
    pub(super) since: Since,
    /// When it ends, in microseconds.
    pub(super) at_us: u64,
    /// How long no new connection is accepted after the ending, in ms.
    pub(super) heal_ms: u64,
    /// The delay of the reply to a call that starts a motion, in ms.
    pub(super) delay_ms: u64,
    /// The time that the motor takes to switch on, in ms.
    pub(super) motor_ms: u64,
    /// Whether the motor was on before.
    pub(super) motor_before: bool,
}

const INSIDE: [Ending; 3] = [Ending::Completes, Ending::TimeLimit, Ending::Stopper];
const STOPPED: [Ending; 8] = [
    Ending::Question,
    Ending::Panic,
    Ending::PanicTask,
    Ending::DropMoving,
    Ending::DropArm,
    Ending::DropController,
    Ending::Abort,
    Ending::Exit,
];
const TOKIO: [Ending; 3] = [Ending::DropFuture, Ending::DropRuntime, Ending::AbortTask];
const STREAMS: [Ending; 2] = [Ending::PanicTrajectory, Ending::Stopper];
const SIGNALS: [Signal; 5] = [Signal::Int, Signal::Term, Signal::Hup, Signal::Tstp, Signal::Kill];
const CUTS: [Cut; 5] = [Cut::Silent, Cut::Up, Cut::Down, Cut::Fin, Cut::Reset];
/// Errors of the levels 1 and 4.
const ERRORS: [u32; 2] = [0x8150_1003, 0x8420_4043];

fn one<T: Copy>(random: &mut Random, list: &[T]) -> T {
    list[random.below(list.len() as u64) as usize]
}

fn between(random: &mut Random, least: f64, most: f64) -> f64 {
    let part = random.below(10_001) as f64 / 10_000.0;
    // a hundredth, so that a printed draw can be read
    ((least + part * (most - least)) * 100.0).round() / 100.0
}

impl Trial {
    /// Draws a trial.
    #[must_use]
    pub(super) fn draw(seed: u64, number: u64, with_command: bool) -> Self {
        let mut random = Random(seed.wrapping_mul(0x1_0000_0001).wrapping_add(number.wrapping_mul(977)));
        let random = &mut random;
        let programs = [Program::Blocking, Program::Tokio, Program::Move, Program::Slave, Program::Run, Program::Shell];
        let library = !with_command || random.happens(550);
        let program = if library { one(random, &programs[..2]) } else { one(random, &programs[2..]) };
        let job = job(random, program);
        let udp = random.happens(300);
        let ending = match ending(random, program, &job, udp) {
            // datagrams have no connection that could be closed
            Ending::Cut(Cut::Fin | Cut::Reset) if udp => Ending::Cut(Cut::Silent),
            ending => ending,
        };
        let range = if random.happens(250) { 50_000 } else { 2_000_000 };
        Self {
            seed,
            number,
            model: (number % Profile::ALL.len() as u64) as usize,
            udp,
            program,
            job,
            ending,
            since: if random.happens(500) { Since::Motion } else { Since::Start },
            at_us: random.below(range),
            heal_ms: random.below(1500),
            delay_ms: if random.happens(350) { random.below(1501) } else { 0 },
            motor_ms: random.below(300),
            motor_before: random.happens(150),
        }
    }

    /// Returns the model.
    #[must_use]
    pub(super) fn profile(&self) -> Profile {
        Profile::ALL[self.model % Profile::ALL.len()]
    }

    /// Returns when it ends.
    #[must_use]
    pub(super) const fn at(&self) -> Duration {
        Duration::from_micros(self.at_us)
    }
}

fn job(random: &mut Random, program: Program) -> Job {
    let stream = |random: &mut Random| Job::Stream {
        cycles: 100 + random.below(200) as u32,
        degrees: between(random, -3.0, 3.0),
    };
    match program {
        Program::Slave => stream(random),
        Program::Move | Program::Run | Program::Shell => Job::Move(leg(random, true)),
        _ => match random.below(10) {
            0..5 => Job::Move(leg(random, false)),
            5..8 => Job::Chain((0..2 + random.below(3)).map(|_| leg(random, false)).collect()),
            _ => stream(random),
        },
    }
}

/// The destinations are absolute or begin at the home position; `P10` and `J10` are 5 to 50 mm and some degrees from it, and
/// `P11` has its position with another figure.
fn leg(random: &mut Random, is_command: bool) -> Leg {
    let home = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0];
    let numbers = |random: &mut Random| {
        let mut numbers = home;
        for _ in 0..1 + random.below(3) {
            numbers[random.below(6) as usize] += between(random, -25.0, 25.0);
        }
        numbers
    };
    let text = |numbers: [f64; 6]| format!("J({})", numbers.map(|number| format!("{number:.2}")).join(", "));
    let way = match random.below(if is_command { 6 } else { 10 }) {
        0 => Way::Joint(text(numbers(random))),
        1 => Way::Joint("J10".into()),
        2 => Way::Joint("P10".into()),
        3 => Way::Line("P10".into()),
        // its current position
        4 => Way::Joint(text(home)),
        // the wrist turns by 180 degrees
        5 => {
            let way = Way::Joint("P11".into());
            return Leg { way, near: random.happens(500), speed: between(random, 40.0, 100.0) };
        }
        6 => Way::Numbers(numbers(random)),
        7 => Way::DriveBy(vec![(1 + random.below(6) as u8, between(random, -20.0, 20.0))]),
        8 => Way::Approach(between(random, 2.0, 30.0)),
        _ => Way::Depart(between(random, 2.0, 30.0)),
    };
    // mostly slow, so that the motion lasts until its ending
    let most = if random.happens(750) { 8.0 } else { 100.0 };
    Leg { way, near: random.happens(500), speed: between(random, 5.0, most) }
}

fn ending(random: &mut Random, program: Program, job: &Job, udp: bool) -> Ending {
    let killed = |random: &mut Random| Ending::Killed { reset: udp || random.happens(500) };
    if program.is_command() {
        return match random.below(20) {
            0..3 => Ending::Completes,
            3..13 => Ending::Signal(one(random, &SIGNALS)),
            13..15 => Ending::SecondClient,
            15 => Ending::EmergencyStop,
            16 => Ending::Error(one(random, &ERRORS)),
            17 => killed(random),
            _ => Ending::Cut(one(random, &CUTS)),
        };
    }
    match random.below(20) {
        0..4 if matches!(job, Job::Stream { .. }) => one(random, &STREAMS),
        0..4 => one(random, &INSIDE),
        4..10 if matches!(job, Job::Stream { .. }) => one(random, &[Ending::Completes, Ending::Abort, Ending::Exit]),
        4..7 if program == Program::Tokio => one(random, &TOKIO),
        4..10 => one(random, &STOPPED),
        10..14 => Ending::SecondClient,
        14 => Ending::EmergencyStop,
        15 => Ending::Error(one(random, &ERRORS)),
        16 => killed(random),
        17 => Ending::Signal(Signal::Kill),
        _ => Ending::Cut(one(random, &CUTS)),
    }
}
