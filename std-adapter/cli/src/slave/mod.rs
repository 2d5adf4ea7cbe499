//! `bcap slave`: streams poses in Slave Mode and reports the timing.

mod monitor;
mod plot;
mod poses;
mod record;
mod report;
mod sample;
mod stream;

use bcap_core::slave::PoseType;

use crate::args::{Cosine, LinkArgs, Play, Slave, SlaveCommand};
use crate::confirm;
use crate::error::Failure;
use poses::Poses;
pub(crate) use poses::columns;
use sample::CYCLE;
use stream::{Course, stream};

/// Runs `bcap slave`.
pub(crate) fn slave(args: &Slave, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    match &args.command {
        SlaveCommand::Play(args) => play(args, link.untraced()?, json),
        SlaveCommand::Cosine(args) => cosine(args, link.untraced()?, json),
        SlaveCommand::Record(args) => record::record(args, link, json),
    }
}

fn play(args: &Play, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let poses = Poses::read(&args.file, args.stream.pose.map(PoseType::from), args.hz)?;
    let kind = poses.kind;
    let course = Course::Poses { poses: poses.each_cycle(CYCLE), loops: args.loops, approach: args.approach };
    let mode = args.stream.mode;
    let first = poses.first().map(|pose| format!("{pose:?}")).unwrap_or_default();
    let what = format!(
        "{} plays {} in {mode:?}: {} poses in {:.1} s, from {first}{}",
        link.network_target()?,
        args.file.display(),
        course.cycles(),
        f64::from(course.cycles()) * CYCLE,
        args.approach.map(|percent| format!(", and first moves there at {percent} %")).unwrap_or_default(),
    );
    confirm(&what, args.stream.yes)?;
    stream(course, kind, &args.stream, link, json)
}

fn cosine(args: &Cosine, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let cycles = (args.seconds / CYCLE).round();
    if cycles > f64::from(u32::MAX) {
        let most = f64::from(u32::MAX) * CYCLE;
        return Err(Failure::Input(format!("--seconds {} is too long; the maximum is {most:.0} s", args.seconds)));
    }
    // the range was checked above
    let course = Course::Cosine { cycles: (cycles as u32).max(1), amplitude: args.amplitude };
    let kind = args.stream.pose.map_or(PoseType::J, PoseType::from);
    let (along, unit) = if kind == PoseType::J { ("joint 1", "degrees") } else { ("Z", "mm") };
    let (target, mode) = (link.network_target()?, args.stream.mode);
    let what =
        format!("{target} moves {along} by {} {unit} and back within {} s, in {mode:?}", args.amplitude, args.seconds);
    confirm(&what, args.stream.yes)?;
    stream(course, kind, &args.stream, link, json)
}

/// Asks for confirmation before the robot moves.
fn confirm(what: &str, yes: bool) -> Result<(), Failure> {
    confirm::confirm(what, "The robot will move.", "the robot was not moved", yes)
}
