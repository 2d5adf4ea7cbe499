//! `bcap slave record`: records the pose of the robot periodically, in a file that `bcap slave play` reads.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::time::{Duration, Instant};

use bcap_capture::value::describe;
use bcap_core::bcap::FunctionId;
use bcap_core::slave::PoseType;
use bcap_core::variant::OwnedVariant as Value;
use bcap_std::ObjectPath;
use bcap_terminal::progress::Progress;

use crate::commands::slave::args::Record;
use crate::failure::{Failure, cannot};
use crate::interrupt::Interrupt;
use crate::link::LinkArgs;
use crate::output::print_result;
use crate::session::{Session, with_session};

/// Runs `bcap slave record`.
pub(crate) fn record(args: &Record, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let kind = args.pose;
    let lines = with_session(link, |session| {
        let interrupt = session.handle_signals()?;
        let robot = session.object(&"robot".parse::<ObjectPath>()?)?;
        // reads one pose first, so that an error does not overwrite an existing file
        position(session, robot, kind)?;
        let cannot_write = cannot("write", &args.file);
        let mut file = BufWriter::new(File::create(&args.file).map_err(&cannot_write)?);
        let recorded = match writeln!(file, "t,{}", kind.columns().join(",")) {
            Ok(()) => poses(session, robot, args, &mut file, &interrupt),
            Err(error) => Err(cannot_write(error)),
        };
        // after an error too, the file keeps the recorded poses
        file.flush().map_err(cannot_write)?;
        recorded
    })?;
    let line = format!("{lines} poses in {}", args.file.display());
    Ok(print_result(json, &serde_json::json!({ "poses": lines }), &line)?)
}

/// Records poses until the time is over or a signal arrives, and returns their number.
fn poses(
    session: &mut Session,
    robot: i32,
    args: &Record,
    file: &mut impl Write,
    interrupt: &Interrupt,
) -> Result<u32, Failure> {
    let start = Instant::now();
    let mut progress = Progress::default();
    let mut lines = 0_u32;
    loop {
        session.restart_budget();
        let before = start.elapsed();
        let numbers = position(session, robot, args.pose)?;
        // the middle of the round trip
        let at = (before + start.elapsed()).as_secs_f64() / 2.0;
        write(file, at, &numbers).map_err(cannot("write", &args.file))?;
        lines += 1;
        progress.show(|_| format!("{lines} poses, {at:.1} s; Ctrl-C ends"));
        // relative to the start, so that a slow round does not delay the following ones
        let next = Duration::from_secs_f64(f64::from(lines) / args.hz);
        if args.seconds.is_some_and(|seconds| next.as_secs_f64() > seconds) {
            break;
        }
        if interrupt.sleep(next.saturating_sub(start.elapsed())).is_err() {
            break;
        }
    }
    Ok(lines)
}

/// Reads the current pose of the robot.
fn position(session: &mut Session, robot: i32, kind: PoseType) -> Result<Vec<f64>, Failure> {
    let command = match kind {
        PoseType::J => "CurJnt",
        PoseType::P => "CurPos",
        PoseType::T => "CurTrn",
    };
    let (code, value) = session.execute(FunctionId::ROBOT_EXECUTE, robot, command, Value::default())?;
    if code.is_err() {
        return Err(Failure::Refused { doing: command.into(), code });
    }
    let array = value.as_ref().and_then(|value| value.as_variant().as_array());
    let numbers: Option<Vec<f64>> = array.map(|array| array.iter().filter_map(|number| number.as_f64()).collect());
    numbers.filter(|numbers| numbers.len() == kind.len()).ok_or_else(|| Failure::Connection {
        message: format!("{command}: the reply carries {} instead of {} numbers", describe(value.as_ref()), kind.len()),
        hint: "check that the other end is a robot controller".into(),
    })
}

fn write(file: &mut impl Write, at: f64, numbers: &[f64]) -> io::Result<()> {
    write!(file, "{at:.6}")?;
    numbers.iter().try_for_each(|number| write!(file, ",{number}"))?;
    writeln!(file)
}
