//! `bcap slave`: streams poses in Slave Mode and reports the timing.

pub(crate) mod args;
mod format;
mod progress;
mod record;
mod stream;

use std::time::Duration;

use bcap_core::slave::{ExtendedAxes, Format, Pose, PoseType, ReceivePose, SlaveMode};
use bcap_std::Address;
use bcap_stream::line_speed;
use bcap_stream::player::Course;
use bcap_stream::poses::Poses;
use bcap_stream::sample::CYCLE;
use stream::Job;

use crate::commands::robot::motion::{self, MotionArgs, MoveArgs};
use crate::commands::slave::args::{Cosine, Play, Slave, SlaveCommand, StreamArgs};
use crate::failure::Failure;
use crate::interrupt::{Interrupt, State};
use crate::link::LinkArgs;
use crate::session::Session;
use crate::session::confirm::Question;

/// Maximum time of the motion to the start of a stream.
const APPROACH: Duration = Duration::from_secs(180);

/// Runs `bcap slave`.
pub(crate) fn slave(args: &Slave, session: &mut Session, json: bool) -> Result<(), Failure> {
    match &args.command {
        SlaveCommand::Play(args) => play(args, session, json),
        SlaveCommand::Cosine(args) => cosine(args, session, json),
        SlaveCommand::Record(args) => record::record(args, session.link(), json),
    }
}

fn play(args: &Play, session: &mut Session, json: bool) -> Result<(), Failure> {
    let link = &session.link().untraced()?.clone();
    if args.approach.is_some() {
        check_can_halt("--approach", link)?;
    }
    let poses =
        Poses::read(&args.file, args.stream.pose, args.stream.format.extended, args.hz).map_err(Failure::Input)?;
    let format = checked_format(&args.stream, poses.kind, link)?;
    let invalid = |problem: String| Failure::Input(format!("{}: {problem}", args.file.display()));
    args.stream.format.check_poses(&poses).map_err(invalid)?;
    let outputs = poses.each_outputs(CYCLE);
    let course = Course::Poses { poses: poses.each_cycle(CYCLE), outputs, loops: args.loops };
    course.check(&stream::limits(&args.stream)).map_err(invalid)?;
    let approach = match args.approach.zip(poses.first()) {
        Some((percent, first)) => Some((start_text(&first)?, percent)),
        None => None,
    };
    let mode = args.stream.mode;
    let first = poses.first().map(|pose| format!("{pose:?}")).unwrap_or_default();
    let what = format!(
        "{} plays {} in {mode:?}: {} poses in {:.1} s, from {first}{}",
        link.target()?,
        args.file.display(),
        course.cycles(),
        f64::from(course.cycles()) * CYCLE,
        args.approach.map(|percent| format!(", and first moves there at {percent} %")).unwrap_or_default(),
    );
    let (target, interrupt) = (&link.target()?, &confirm(&what, session, args.stream.yes)?);
    run(course, approach, Job { format, args: &args.stream, link, json, target, interrupt })
}

fn cosine(args: &Cosine, session: &mut Session, json: bool) -> Result<(), Failure> {
    let link = &session.link().untraced()?.clone();
    if args.from.is_some() {
        check_can_halt("--from", link)?;
    }
    let cycles = (args.seconds / CYCLE).round();
    if cycles > f64::from(u32::MAX) {
        let most = f64::from(u32::MAX) * CYCLE;
        return Err(Failure::Input(format!("--seconds {} is too long; the maximum is {most:.0} s", args.seconds)));
    }
    // the range was checked above
    let course = Course::Cosine { cycles: (cycles as u32).max(1), amplitude: args.amplitude };
    let kind = args.stream.pose.unwrap_or(PoseType::J);
    let format = checked_format(&args.stream, kind, link)?;
    let (along, unit) = if kind == PoseType::J { ("joint 1", "degrees") } else { ("Z", "mm") };
    let (target, mode) = (link.target()?, args.stream.mode);
    let first = args.from.as_ref().map(|from| format!("first moves to {from} at {} %, then ", args.speed));
    let what = format!(
        "{target} {}moves {along} by {} {unit} and back within {} s, in {mode:?}",
        first.unwrap_or_default(),
        args.amplitude,
        args.seconds
    );
    let (target, interrupt) = (&target, &confirm(&what, session, args.stream.yes)?);
    let start = args.from.clone().map(|from| (from, args.speed));
    run(course, start, Job { format, args: &args.stream, link, json, target, interrupt })
}

/// Refuses a motion to the start over a serial line, because it could not be halted: the line's only session waits for the end
/// of the motion.
fn check_can_halt(option: &str, link: &LinkArgs) -> Result<(), Failure> {
    if link.is_serial() {
        return Err(Failure::Input(format!(
            "{option}: a serial line carries one session, so Ctrl-C could not halt the motion to the start; leave {option} out \
             and move the robot there first, or use TCP or UDP"
        )));
    }
    Ok(())
}

/// Moves the robot to the start, if that is wanted, and streams.
fn run(course: Course, start: Option<(String, f64)>, job: Job<'_>) -> Result<(), Failure> {
    let (link, interrupt) = (&Session::settled(job.link)?, job.interrupt);
    if let Some((to, percent)) = start {
        approach(to, percent, link)?;
    }
    // from now on a signal stops the stream; an earlier one prevents it
    interrupt.enter(State::Streaming);
    let streamed =
        interrupt.check("interrupted: nothing was streamed").and_then(|()| Job { link, ..job }.stream(course));
    interrupt.enter(State::Stepping);
    streamed
}

/// Moves the robot by an ordinary motion, as `bcap move` does.
fn approach(to: String, percent: f64, link: &LinkArgs) -> Result<(), Failure> {
    let motion = MoveArgs {
        to,
        line: false,
        no_wait: false,
        how: MotionArgs { speed: percent, tool: None, work: None, within: APPROACH, prepare: false, yes: true },
        step: None,
    };
    let mut session = Session::new(link);
    if motion::go(&motion, &mut session)? { Ok(()) } else { Err(Failure::Interrupted("interrupted".into())) }
}

/// Writes the first pose of a stream as the destination of a motion.
fn start_text(pose: &Pose) -> Result<String, Failure> {
    let layout = pose.layout();
    if layout.extended != ExtendedAxes::None && layout.pose != PoseType::J {
        return Err(Failure::Input(format!(
            "--approach cannot move the extended joints to a pose of type {:?}; move them first, for example with `bcap move`",
            layout.pose
        )));
    }
    let numbers: Vec<String> = pose.numbers().iter().map(f64::to_string).collect();
    Ok(format!("{:?}({})", layout.pose, numbers.join(",")))
}

/// Returns the format of a stream, if the options fit each other and the line is fast enough.
fn checked_format(args: &StreamArgs, kind: PoseType, link: &LinkArgs) -> Result<Format, Failure> {
    let format = args.format.format(SlaveMode { mode: args.mode, pose: kind });
    let is_contained = match kind {
        PoseType::P => matches!(format.receive.pose, ReceivePose::P | ReceivePose::PJ),
        PoseType::J => matches!(format.receive.pose, ReceivePose::J | ReceivePose::PJ | ReceivePose::TJ),
        PoseType::T => matches!(format.receive.pose, ReceivePose::T | ReceivePose::TJ),
    };
    if args.plot.is_some() && !is_contained {
        return Err(Failure::Input(format!("--plot needs the type of the stream in --recv-format: write {kind:?}")));
    }
    args.format.check_options().map_err(Failure::Input)?;
    if let Address::Serial(line) = link.target()? {
        line_speed::check(&line, &format).map_err(Failure::Input)?;
    }
    Ok(format)
}

/// Asks for confirmation before the robot moves. A signal at the question prevents the stream.
fn confirm(what: &str, session: &mut Session, yes: bool) -> Result<Interrupt, Failure> {
    let interrupt = session.handle_signals()?;
    let question = Question { what, warning: "The robot will move.", refused: "the robot was not moved" };
    question.confirm(session, yes)?;
    interrupt.check("interrupted: the robot was not moved")?;
    Ok(interrupt)
}
