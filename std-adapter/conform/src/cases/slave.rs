//! Slave Mode. The poses that are sent are the robot's own position, so it does not move.

use std::borrow::Cow;

use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;
use bcap_testkit::value::Value;
use bcap_testkit::wire::Link;

use crate::bench::{Bench, Stop, fail, skip};
use crate::case::Arg::{H, S, V};
use crate::case::Setup::{Arm, Robot};
use crate::case::{Body, Case, Group, Level, Run, Setup, Slot, Step, Want, case, steps};
use crate::device::Refusals;
use crate::reply::{Reply, request_text};

const R: Slot = Slot::Robot;

const fn slave(
    name: &'static str,
    source: &'static str,
    rule: &'static str,
    setup: Setup,
    table: &'static [Step],
) -> Case {
    case(Group::Slave, name, source, rule, setup, steps(table))
}

const fn run(
    name: &'static str,
    source: &'static str,
    rule: &'static str,
    run: fn(&mut Bench<'_>) -> Result<(), Stop>,
) -> Case {
    case(Group::Slave, name, source, rule, Arm, Body::Run(run)).at(Level::Motion)
}

macro_rules! command {
    ($command:literal, $value:literal, $want:expr) => {
        Step::Call(F::ROBOT_EXECUTE, &[H(R), S($command), V($value)], $want)
    };
}

pub(super) const CASES: &[Case] = &[
    slave(
        "mode-at-rest",
        "b-CAP specification, Table 5-1",
        "without Slave Mode slvGetMode returns 0",
        Robot,
        &[command!("slvGetMode", "0,", Want::Value("3,0"))],
    ),
    slave(
        "command-in-lower-case",
        "b-CAP specification, section 4.3.2",
        "the case of a command does not matter",
        Robot,
        &[command!("slvgetmode", "0,", Want::Value("3,0"))],
    ),
    case(
        Group::Slave,
        "move-outside",
        "b-CAP specification, section 5.1",
        "slvMove outside of Slave Mode is refused",
        Robot,
        Body::Run(move_outside),
    )
    .at(Level::Motion),
    case(
        Group::Slave,
        "enter-without-arm",
        "b-CAP specification, Table 5-1",
        "Slave Mode needs the arm authority",
        Robot,
        Body::Run(enter_without_arm),
    )
    .at(Level::Motion),
    slave(
        "unknown-mode-4",
        "b-CAP specification, Table 5-1",
        "mode 0x004 does not exist",
        Arm,
        &[command!("slvChangeMode", "3,4", Want::Refused)],
    )
    .at(Level::Motion),
    slave(
        "unknown-mode-200",
        "b-CAP specification, Table 5-1",
        "mode 0x200 does not exist",
        Arm,
        &[command!("slvChangeMode", "3,512", Want::Refused)],
    )
    .at(Level::Motion),
    slave(
        "unknown-mode-301",
        "b-CAP specification, Table 5-1",
        "mode 0x301 does not exist",
        Arm,
        &[command!("slvChangeMode", "3,769", Want::Refused)],
    )
    .at(Level::Motion),
    slave(
        "unknown-send-format",
        "b-CAP specification, Table 5-1",
        "send format 0x0001 does not exist",
        Arm,
        &[command!("slvSendFormat", "3,1", Want::Refused)],
    )
    .at(Level::Motion),
    slave(
        "unknown-receive-format",
        "b-CAP specification, Table 5-1",
        "receive format 0x0006 does not exist",
        Arm,
        &[command!("slvRecvFormat", "3,6", Want::Refused)],
    )
    .at(Level::Motion),
    run("enter-0-p", "b-CAP specification, Table 5-1", "mode 0x001 is entered and left", |bench| {
        enter(bench, 0x001, 'P')
    }),
    run("enter-0-j", "b-CAP specification, Table 5-1", "mode 0x002 is entered and left", |bench| {
        enter(bench, 0x002, 'J')
    }),
    run("enter-0-t", "b-CAP specification, Table 5-1", "mode 0x003 is entered and left", |bench| {
        enter(bench, 0x003, 'T')
    }),
    run("enter-1-p", "b-CAP specification, Table 5-1", "mode 0x101 is entered and left", |bench| {
        enter(bench, 0x101, 'P')
    }),
    run("enter-1-j", "b-CAP specification, Table 5-1", "mode 0x102 is entered and left", |bench| {
        enter(bench, 0x102, 'J')
    }),
    run("enter-1-t", "b-CAP specification, Table 5-1", "mode 0x103 is entered and left", |bench| {
        enter(bench, 0x103, 'T')
    }),
    run("enter-2-p", "b-CAP specification, Table 5-1", "mode 0x201 is entered and left", |bench| {
        enter(bench, 0x201, 'P')
    }),
    run("enter-2-j", "b-CAP specification, Table 5-1", "mode 0x202 is entered and left", |bench| {
        enter(bench, 0x202, 'J')
    }),
    run("enter-2-t", "b-CAP specification, Table 5-1", "mode 0x203 is entered and left", |bench| {
        enter(bench, 0x203, 'T')
    }),
    run(
        "buffer-fills-in-mode-0",
        "b-CAP specification, section 5.3.1",
        "the pose that fills the buffer is answered S_BUF_FULL",
        buffer_fills,
    )
    .over(Link::Tcp),
    run(
        "buffer-overflows-in-mode-0",
        "b-CAP specification, section 5.3.1",
        "a pose for which there is no room is answered E_BUF_FULL",
        buffer_overflows,
    )
    .over(Link::Tcp),
    run(
        "buffer-waits-in-mode-2",
        "b-CAP specification, section 5.3.2",
        "in mode 2 a reply waits for room, and no pose is refused",
        |bench| never_full(bench, 0x202),
    )
    .over(Link::Tcp),
    run(
        "buffer-overwritten-in-mode-1",
        "b-CAP specification, section 5.3.1",
        "in mode 1 no pose is refused",
        |bench| never_full(bench, 0x102),
    )
    .over(Link::Tcp),
    run(
        "underflow-at-rest",
        "b-CAP specification, Table 5-6",
        "without poses a robot at rest stays in Slave Mode",
        underflow_at_rest,
    ),
    run(
        "other-commands",
        "b-CAP specification, section 5.1",
        "in Slave Mode other commands are refused",
        other_commands,
    ),
    run("short-pose", "b-CAP specification, section 5.4", "a pose of 3 elements is refused", short_pose),
];

/// The receive formats, and the number of doubles of the pose.
const POSES: [(&str, &str, usize); 5] =
    [("p", "3,1", 7), ("j", "3,2", 8), ("t", "3,3", 10), ("p-and-j", "3,4", 15), ("t-and-j", "3,5", 18)];

/// Receive formats with more than the pose.
const MORE: [(&str, &str, usize); 4] =
    [("time", "3,0x12", 2), ("current", "3,0x42", 2), ("mini-io", "3,0x102", 2), ("hand-io", "3,0x22", 2)];

/// Returns the cases of the formats of slvMove (b-CAP specification, section 5.2).
pub(super) fn formats() -> impl Iterator<Item = Case> {
    let made = |name: &str, run: Body| Case {
        name: Cow::Owned(format!("receive-{name}")),
        ..case(
            Group::Slave,
            "",
            "b-CAP specification, Table 5-3",
            "the reply of slvMove has the values of the receive format",
            Arm,
            run,
        )
        .at(Level::Motion)
    };
    let functions: [Run; 9] = [
        |bench| received(bench, 0),
        |bench| received(bench, 1),
        |bench| received(bench, 2),
        |bench| received(bench, 3),
        |bench| received(bench, 4),
        |bench| received(bench, 5),
        |bench| received(bench, 6),
        |bench| received(bench, 7),
        |bench| received(bench, 8),
    ];
    POSES.iter().chain(&MORE).zip(functions).map(move |((name, ..), run)| made(name, Body::Run(run)))
}

fn received(bench: &mut Bench<'_>, index: usize) -> Result<(), Stop> {
    let table: Vec<_> = POSES.iter().chain(&MORE).copied().collect();
    let (_, format, count) = table[index];
    let set = bench.robot_command("slvRecvFormat", format)?;
    if index >= POSES.len() && set.code == HResult::E_INVALIDARG {
        return skip("the device does not have this IO");
    }
    bench.check(F::ROBOT_EXECUTE, &set, Want::NoValue, Refusals::Skip)?;
    change(bench, 0x202)?;
    let pose = pose(bench, 'J')?;
    let reply = slv_move(bench, &pose)?;
    let want = if index < POSES.len() { Want::Array(5, count) } else { Want::Array(12, count) };
    bench.check(F::ROBOT_EXECUTE, &reply, want, Refusals::Fail)
}

/// Returns the present position of the robot as a pose.
fn pose(bench: &mut Bench<'_>, kind: char) -> Result<Value, Stop> {
    // the robot of another connection, because Slave Mode refuses these commands
    let mut other = bench.another()?;
    other.open_controller()?;
    other.open(R, F::CONTROLLER_GET_ROBOT, &[H(Slot::Controller), S("Arm"), S("")])?;
    let command = match kind {
        'P' => "CurPos",
        'T' => "CurTrn",
        _ => "CurJnt",
    };
    let reply = other.robot_command(command, "0,")?;
    if reply.code.is_err() {
        return skip(format!("{command}: {}", reply.text()));
    }
    match reply.args.into_iter().next() {
        Some(pose) => Ok(pose),
        None => fail(format!("{command}: a pose"), "no value"),
    }
}

fn execute(bench: &mut Bench<'_>, command: &str, value: Value) -> Result<Reply, Stop> {
    let handle = bench.argument(&H(R))?;
    bench.exchange(F::ROBOT_EXECUTE, vec![handle, Value::text(command), value])
}

fn slv_move(bench: &mut Bench<'_>, pose: &Value) -> Result<Reply, Stop> {
    execute(bench, "slvMove", pose.clone())
}

/// Enters Slave Mode, or skips the case if the controller has no licence for it.
fn change(bench: &mut Bench<'_>, mode: i32) -> Result<(), Stop> {
    let reply = execute(bench, "slvChangeMode", Value::I4(mode))?;
    match reply.code {
        HResult::E_NO_LICENSE | HResult::E_CAO_PROV_NO_LICENSE => skip(format!("Slave Mode: {}", reply.code)),
        _ => bench.check(F::ROBOT_EXECUTE, &reply, Want::NoValue, Refusals::Skip),
    }
}

fn mode(bench: &mut Bench<'_>, wanted: i32) -> Result<(), Stop> {
    let reply = bench.robot_command("slvGetMode", "0,")?;
    match reply.value() {
        Some(Value::I4(mode)) if *mode == wanted => Ok(()),
        _ => fail(format!("slvGetMode: I4({wanted})"), reply.text()),
    }
}

/// Enters a mode, sends the present pose twice, and leaves.
fn enter(bench: &mut Bench<'_>, number: i32, kind: char) -> Result<(), Stop> {
    let pose = pose(bench, kind)?;
    change(bench, number)?;
    mode(bench, number)?;
    for _ in 0..2 {
        let reply = slv_move(bench, &pose)?;
        bench.check(F::ROBOT_EXECUTE, &reply, Want::Array(5, 0), Refusals::Fail)?;
    }
    change(bench, 0)?;
    mode(bench, 0)
}

/// Sends `count` poses in one write, and returns the codes of the replies.
fn burst(bench: &mut Bench<'_>, number: i32, count: usize) -> Result<Vec<HResult>, Stop> {
    let pose = pose(bench, 'J')?;
    change(bench, number)?;
    let args = vec![bench.argument(&H(R))?, Value::text("slvMove"), pose];
    let serials: Vec<u16> = (0..count).map(|_| bench.next_serial()).collect();
    let bytes: Vec<u8> = serials.iter().flat_map(|serial| bench.encode(*serial, 0, F::ROBOT_EXECUTE, &args)).collect();
    bench.send(&bytes, &format!("{count} x {}", request_text(serials[0], F::ROBOT_EXECUTE, &args)))?;
    let codes = serials.iter().map(|serial| bench.reply(F::ROBOT_EXECUTE, *serial).map(|reply| reply.code));
    let codes = codes.collect::<Result<Vec<_>, _>>()?;
    change(bench, 0)?;
    Ok(codes)
}

fn text(codes: &[HResult]) -> String {
    codes.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

fn buffer_fills(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let codes = burst(bench, 0x002, 8)?;
    match (codes.first(), codes.contains(&HResult::S_BUF_FULL)) {
        (Some(&HResult::S_OK), true) => Ok(()),
        _ => fail("S_OK for the first of 8 poses at once, and S_BUF_FULL for a later one", text(&codes)),
    }
}

fn buffer_overflows(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let codes = burst(bench, 0x002, 12)?;
    let known = [HResult::S_OK, HResult::S_BUF_FULL, HResult::E_BUF_FULL];
    match codes.contains(&HResult::E_BUF_FULL) && codes.iter().all(|code| known.contains(code)) {
        true => Ok(()),
        false => fail("S_OK, S_BUF_FULL and then E_BUF_FULL for 12 poses at once", text(&codes)),
    }
}

fn never_full(bench: &mut Bench<'_>, number: i32) -> Result<(), Stop> {
    let codes = burst(bench, number, 12)?;
    match codes.iter().all(|code| *code == HResult::S_OK) {
        true => Ok(()),
        false => fail("S_OK for each of 12 poses at once", text(&codes)),
    }
}

fn underflow_at_rest(bench: &mut Bench<'_>) -> Result<(), Stop> {
    change(bench, 0x202)?;
    std::thread::sleep(bench.options.quiet);
    mode(bench, 0x202)
}

fn other_commands(bench: &mut Bench<'_>) -> Result<(), Stop> {
    change(bench, 0x202)?;
    let reply = bench.robot_command("CurSpd", "0,")?;
    bench.check(F::ROBOT_EXECUTE, &reply, Want::Refused, Refusals::Fail)?;
    mode(bench, 0x202)
}

/// Sends the present position: a device that accepts it does not jump.
fn move_outside(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let pose = pose(bench, 'J')?;
    let reply = slv_move(bench, &pose)?;
    bench.check(F::ROBOT_EXECUTE, &reply, Want::Refused, Refusals::Skip)
}

fn enter_without_arm(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let entered = bench.robot_command("slvChangeMode", "3,514");
    if !matches!(&entered, Ok(reply) if reply.code.is_err()) {
        // immediately, even if the reply is wrong
        let args = [H(R), S("slvChangeMode"), V("3,0")].map(|arg| bench.argument(&arg));
        let args = args.into_iter().collect::<Result<Vec<_>, _>>()?;
        bench.attempt(F::ROBOT_EXECUTE, args, bench.options.timeout);
    }
    bench.check(F::ROBOT_EXECUTE, &entered?, Want::Refused, Refusals::Skip)
}

/// Sends the first three elements of the present position.
fn short_pose(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let pose = pose(bench, 'J')?;
    let Value::Array(element, joints) = pose else { return fail("a pose", "another value") };
    let short = Value::Array(element, joints.into_iter().take(3).collect());
    change(bench, 0x202)?;
    let reply = slv_move(bench, &short)?;
    bench.check(F::ROBOT_EXECUTE, &reply, Want::Refused, Refusals::Fail)
}
