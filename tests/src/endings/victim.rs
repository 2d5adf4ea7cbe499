//! The programs of the library that end in every way. Each runs in a separate process, which the harness starts with
//! [`ARGUMENT`] and a [`Script`] as JSON, and prints `go` before its job and `outcome NAME` when it has one.

use std::error::Error as StdError;
use std::io::Write as _;
use std::process::ExitCode;
use std::thread;
use std::time::Duration;

use bcap_core::slave::{AxisLimits, Cycle, Format, Mode, Next, Pose, PoseType, ReceiveFormat, ReceivePose, SlaveMode};
use bcap_std::{Error, Interpolation, Joints, Motion, Move, Pass, Settings, asynch, blocking};
use serde::{Deserialize, Serialize};
use tokio::runtime::Runtime;

use super::draw::{Ending, Job, Leg, Program, Trial, Way};

/// The first argument of such a process.
pub(super) const ARGUMENT: &str = "ending-victim";

/// The orders for a program.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Script {
    /// The address of the controller.
    pub(super) address: String,
    /// The draws.
    pub(super) trial: Trial,
}

type Failure = Box<dyn StdError + Send + Sync>;

/// Runs the program that the arguments of this process request, if any, and returns the exit code for `main`.
#[must_use]
pub fn run_if_asked() -> Option<ExitCode> {
    let mut arguments = std::env::args().skip(1);
    if arguments.next().as_deref() != Some(ARGUMENT) {
        return None;
    }
    let script = serde_json::from_str::<Script>(&arguments.next().unwrap_or_default());
    let ended = script.map_err(Failure::from).and_then(|script| match script.trial.program {
        Program::Tokio => run_tokio(script),
        _ => run_blocking(script),
    });
    // as a `main` that returns a `Result` does
    if let Err(error) = &ended {
        eprintln!("Error: {error}");
    }
    Some(if ended.is_ok() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Returns the settings for the model of a trial.
#[must_use]
pub(super) fn settings(trial: &Trial) -> Settings {
    match trial.profile() {
        bcap_sim::Profile::Rc9 | bcap_sim::Profile::CobottaPro => Settings::rc9(),
        bcap_sim::Profile::Cobotta => Settings::cobotta(),
        _ => Settings::rc8(),
    }
}

/// Returns the motion.
fn motion(leg: &Leg) -> Move {
    let motion = match &leg.way {
        Way::Joint(text) => Move::joint(text.as_str()),
        Way::Line(text) => Move::line(text.as_str()),
        Way::Numbers(numbers) => Move::joint(Joints::new(*numbers)),
        Way::DriveBy(axes) => Move::drive_by(axes.iter().copied()),
        Way::Approach(mm) => Move::approach(Interpolation::Line, "P10", *mm),
        Way::Depart(mm) => Move::depart(Interpolation::Line, *mm),
    };
    let motion = motion.speed_percent(leg.speed);
    if leg.near { motion.pass(Pass::Near) } else { motion }
}

fn say(line: &str) {
    let mut out = std::io::stdout().lock();
    // without the harness there is no reader
    let _ = writeln!(out, "{line}").and_then(|()| out.flush());
}

/// Prints how a motion has ended.
fn tell(ended: Result<Motion, Error>) -> Result<(), Failure> {
    match &ended {
        Ok(Motion::Arrived) => say("outcome arrived"),
        Ok(Motion::Halted) => say("outcome halted"),
        Ok(Motion::Failed(_)) => say("outcome failed"),
        Ok(Motion::TimedOut) => say("outcome timed-out"),
        Ok(_) => say("outcome unknown"),
        Err(error) => say(&format!("outcome error {error}")),
    }
    ended.map(drop).map_err(Into::into)
}

fn limit(trial: &Trial) -> Duration {
    if trial.ending == Ending::TimeLimit { trial.at().max(Duration::from_millis(1)) } else { Duration::from_secs(20) }
}

fn format() -> Format {
    Format::new(SlaveMode { mode: Mode::Mode0, pose: PoseType::J }, ReceiveFormat::pose(ReceivePose::J))
}

/// Returns a smooth trajectory of joint 1, which panics at the time of the ending if the ending is a panic.
fn swing(trial: &Trial) -> impl FnMut(&Cycle<'_>) -> Next + Send + 'static {
    let (cycles, degrees) = match trial.job {
        Job::Stream { cycles, degrees } => (cycles, degrees),
        _ => (0, 0.0),
    };
    let panics = (trial.ending == Ending::PanicTrajectory).then(|| u32::try_from(trial.at_us / 8000).unwrap_or(0));
    move |cycle| {
        assert!(Some(cycle.number) != panics, "the trajectory panics");
        let mut joints: [f64; 8] = cycle.start.numbers().try_into().unwrap_or_default();
        let part = f64::from(cycle.number + 1) / f64::from(cycles.max(1));
        joints[0] += degrees * (1.0 - (part * std::f64::consts::PI).cos()) / 2.0;
        if cycle.number < cycles { Next::Pose(Pose::j(joints)) } else { Next::Finish }
    }
}

fn limits() -> AxisLimits {
    AxisLimits::uniform(200.0, 2000.0)
}

/// Returns the motions of a chain, or the single motion.
fn legs(job: &Job) -> &[Leg] {
    match job {
        Job::Move(leg) => std::slice::from_ref(leg),
        Job::Chain(legs) => legs,
        Job::Stream { .. } => &[],
    }
}

/// Ends the process at its time, if that is the ending.
fn end_process_at(trial: &Trial) {
    let (ending, at) = (trial.ending, trial.at());
    if matches!(ending, Ending::Abort | Ending::Exit) {
        thread::spawn(move || {
            thread::sleep(at);
            if ending == Ending::Abort { std::process::abort() } else { std::process::exit(3) }
        });
    }
}

fn run_blocking(script: Script) -> Result<(), Failure> {
    if script.trial.ending == Ending::PanicTask {
        // the thread owns the arm, and drops it
        return thread::spawn(move || work(&script)).join().unwrap_or_else(|_| Err("the thread panicked".into()));
    }
    work(&script)
}

fn work(Script { address, trial }: &Script) -> Result<(), Failure> {
    let mut cell = blocking::Controller::connect(address, &settings(trial))?;
    let stopper = (trial.ending == Ending::Stopper).then(|| cell.stopper()).transpose()?;
    let mut arm = cell.robot()?.take_arm()?;
    arm.motor_on()?;
    say("go");
    end_process_at(trial);
    if let Some(stopper) = stopper {
        let at = trial.at();
        thread::spawn(move || {
            thread::sleep(at);
            stopper.halt()
        });
    }
    if let Job::Stream { .. } = trial.job {
        let ended = arm.stream(format(), limits(), &mut swing(trial));
        return tell(ended.map(|_| Motion::Arrived));
    }
    if trial.ending.stops_while_it_moves() {
        return leave(cell_moves(&mut arm, trial)?, trial);
    }
    let ended = match legs(&trial.job) {
        [leg] => arm.move_to(&motion(leg), limit(trial)),
        legs => follow(&mut arm, legs, limit(trial)),
    };
    tell(ended)?;
    Ok(arm.give()?)
}

fn follow(arm: &mut blocking::Arm<'_>, legs: &[Leg], limit: Duration) -> Result<Motion, Error> {
    let [first, rest @ ..] = legs else { return Ok(Motion::Arrived) };
    let mut moving = arm.start(&motion(first), limit)?;
    for leg in rest {
        moving = moving.then(&motion(leg))?;
    }
    moving.wait()
}

/// Starts the first motion and waits until the time of the ending.
fn cell_moves<'a>(arm: &'a mut blocking::Arm<'_>, trial: &Trial) -> Result<blocking::Moving<'a>, Error> {
    let begun = std::time::Instant::now();
    let leg = legs(&trial.job).first().map(motion).unwrap_or_else(|| Move::joint("J10"));
    let moving = arm.start(&leg, limit(trial))?;
    thread::sleep(trial.at().saturating_sub(begun.elapsed()));
    Ok(moving)
}

fn leave(moving: blocking::Moving<'_>, trial: &Trial) -> Result<(), Failure> {
    match trial.ending {
        Ending::Question => Err("the program gives up".into()),
        Ending::Panic | Ending::PanicTask => panic!("the program panics"),
        _ => {
            // the others are dropped by the caller, in the order of their owners
            drop(moving);
            Ok(())
        }
    }
}

impl Ending {
    /// Returns whether this ending happens between `start` and `wait` in a blocking program.
    const fn stops_while_it_moves(self) -> bool {
        matches!(
            self,
            Self::Question | Self::Panic | Self::PanicTask | Self::DropMoving | Self::DropArm | Self::DropController
        )
    }
}

fn run_tokio(Script { address, trial }: Script) -> Result<(), Failure> {
    let runtime = Runtime::new()?;
    let at = trial.at();
    if trial.ending == Ending::DropRuntime {
        let (going, goes) = std::sync::mpsc::channel();
        runtime.spawn(async move {
            let _ = work_async(&address, &trial, Some(going)).await;
        });
        // without a message the task has failed
        let _ = goes.recv();
        thread::sleep(at);
        drop(runtime);
        return Ok(());
    }
    runtime.block_on(async move {
        if !matches!(trial.ending, Ending::PanicTask | Ending::AbortTask) {
            return work_async(&address, &trial, None).await;
        }
        let (going, goes) = std::sync::mpsc::channel();
        let aborts = trial.ending == Ending::AbortTask;
        let task = tokio::spawn(async move { work_async(&address, &trial, Some(going)).await });
        if aborts {
            let _ = tokio::task::spawn_blocking(move || goes.recv()).await;
            tokio::time::sleep(at).await;
            task.abort();
        }
        task.await.unwrap_or_else(|error| Err(error.into()))
    })
}

async fn work_async(address: &str, trial: &Trial, going: Option<std::sync::mpsc::Sender<()>>) -> Result<(), Failure> {
    let cell = asynch::Controller::connect(address, &settings(trial)).await?;
    let stopper = if trial.ending == Ending::Stopper { Some(cell.stopper().await?) } else { None };
    let mut arm = cell.robot().await?.take_arm().await?;
    arm.motor_on().await?;
    say("go");
    if let Some(going) = going {
        // without a receiver the task is not awaited
        let _ = going.send(());
    }
    end_process_at(trial);
    let at = trial.at();
    if let Some(stopper) = stopper {
        tokio::spawn(async move {
            tokio::time::sleep(at).await;
            stopper.halt().await
        });
    }
    if matches!(trial.ending, Ending::DropMoving | Ending::DropArm | Ending::DropController) {
        let leg = legs(&trial.job).first().map(motion).unwrap_or_else(|| Move::joint("J10"));
        let begun = tokio::time::Instant::now();
        let moving = arm.start(&leg, limit(trial)).await?;
        tokio::time::sleep_until(begun + at).await;
        drop(moving);
        if trial.ending == Ending::DropController {
            return Ok(());
        }
        drop(arm);
        return Ok(cell.close().await?);
    }
    let ended = tokio::select! {
        ended = job_async(&mut arm, trial) => ended,
        () = tokio::time::sleep(at), if trial.ending.interrupts() => match trial.ending {
            Ending::Question => return Err("the program gives up".into()),
            Ending::Panic | Ending::PanicTask => panic!("the program panics"),
            _ => {
                // the future of the motion is dropped; the arm is given back
                arm.give().await?;
                return Ok(cell.close().await?);
            }
        },
    };
    tell(ended)?;
    arm.give().await?;
    Ok(cell.close().await?)
}

impl Ending {
    /// Returns whether an async program stops waiting for its motion.
    const fn interrupts(self) -> bool {
        matches!(self, Self::Question | Self::Panic | Self::PanicTask | Self::DropFuture)
    }
}

async fn job_async(arm: &mut asynch::Arm, trial: &Trial) -> Result<Motion, Error> {
    let legs = match &trial.job {
        Job::Stream { .. } => return arm.stream(format(), limits(), swing(trial)).await.map(|_| Motion::Arrived),
        Job::Move(leg) => return arm.move_to(&motion(leg), limit(trial)).await,
        Job::Chain(legs) => legs,
    };
    let [first, rest @ ..] = legs.as_slice() else { return Ok(Motion::Arrived) };
    let mut moving = arm.start(&motion(first), limit(trial)).await?;
    for leg in rest {
        moving = moving.then(&motion(leg)).await?;
    }
    moving.wait().await
}
