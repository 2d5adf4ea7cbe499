//! `bcap replay`: makes the calls of a capture again, and prints the replies that differ.

use std::path::PathBuf;

use bcap_capture::CallName;
use bcap_capture::decode::events;
use bcap_capture::proxy::Robot;
use bcap_capture::replay::{Options, Plan};
use bcap_core::limits::Strictness;
use clap::Args;

use crate::commands::robot::halt::halt_now;
use crate::commands::robot_ports::{self, RobotPorts};
use crate::failure::Failure;
use crate::interrupt::{Interrupt, State};
use crate::link::LinkArgs;
use crate::output::{print_block, print_json, print_result};
use crate::session::{Session, traffic};

/// Makes the calls of a capture again, and compares the replies
///
/// Every connection of the capture is opened again, and its calls are made at their times. A call is sent only after every call
/// that was answered before it in the capture has been answered. Handles are replaced by those that the robot gives now; a call
/// is not sent if its object is not open in the replay. The retries of calls over UDP are not repeated. A reply that differs is
/// printed with the recorded one, and the exit code is then 1. A call that had no reply is made, but not compared. At most 1024
/// connections are replayed. When the output is closed, such as by `head`, no more calls are made. The end of a connection and
/// Ctrl-C halt the robot, switch the motor off and give the arm back if the replayed calls require that. If the connection is
/// lost, the command does this over a new connection. If this fails, the command says so.
///
/// Functions and commands that may move the robot or write must be allowed by name (`bcap call --list --effects`). Without
/// that nothing is sent.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap replay session.pcapng --robot 192.168.0.1
  bcap replay session.pcapng --fast --allow Variable_PutValue --allow Robot_Execute/TakeArm
  bcap replay session.pcapng --volatile @CURRENT_TIME --volatile Robot_Execute/slvMove --allow Robot_Execute")]
pub(crate) struct Replay {
    /// The capture: a file of `--write`, of Wireshark or of tcpdump
    pub(crate) file: PathBuf,

    /// Makes each call as soon as the replies before it have arrived, instead of at its time
    #[arg(long)]
    pub(crate) fast: bool,

    /// Allows a function that may move or write: FUNCTION[/COMMAND], or PUT of RAC
    #[arg(long, value_name = "FUNCTION[/COMMAND]")]
    pub(crate) allow: Vec<CallName>,

    /// Does not compare the value of these replies, only whether they succeed: FUNCTION[/COMMAND], or an object such as @MODE
    #[arg(long, value_name = "NAME")]
    pub(crate) volatile: Vec<String>,

    #[command(flatten)]
    pub(crate) robot: RobotPorts,
}

/// Runs `bcap replay`.
pub(crate) fn replay(args: &Replay, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let (events, read) = events(&args.file, Strictness::Lenient);
    read?;
    let plan = Plan::new(events)?;
    plan.check(&args.allow)?;
    let robot = robot_ports::resolve(&args.robot, link)?;
    let mut options = Options::new(link.timeout());
    options.fast = args.fast;
    options.volatile.clone_from(&args.volatile);
    options.recorder = traffic::recorder().cloned();
    options.is_interrupted = Some(|| Interrupt::of_process().is_some_and(|interrupt| interrupt.is_interrupted()));
    // its end closes the session that halts, unless a shell has opened that one
    let mut signals = Session::new(link);
    let interrupt = signals.handle_signals()?;
    if !plan.is_harmless() {
        // a call may wait for the end of a motion
        // over a session that begins with the signal: the capture has the connections of the replay
        let link = link.for_halt();
        interrupt.prepare(|| Ok(Some(Box::new(move || halt_now(&link).map(drop)))))?;
        interrupt.enter(State::Moving);
    }
    let done = made(&plan, &robot, &options, json);
    interrupt.enter(State::Stepping);
    if matches!(done, Err(Failure::Unfit { .. })) {
        // even after a signal: the effects on the robot may not have been ended
        return done;
    }
    let left = if plan.is_harmless() { "" } else { ": its effects on the robot were ended" };
    interrupt.check(&format!("interrupted{left}"))?;
    done
}

/// Makes the calls, and reports the differences.
fn made(plan: &Plan, robot: &Robot, options: &Options, json: bool) -> Result<(), Failure> {
    let totals = plan.run(robot, options, |outcome| match outcome.is_different {
        true if json => print_json(&outcome.to_json()),
        true => print_block(&outcome.to_string()),
        false => Ok(()),
    })?;
    print_result(json, &totals, &totals.to_string())?;
    match totals.differences {
        0 => Ok(()),
        different => {
            let total = totals.compared;
            Err(Failure::Reported(format!("{different} of {total} replies differ from the recorded ones")))
        }
    }
}
