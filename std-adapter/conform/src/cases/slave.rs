//! Slave Mode. The poses that are sent are the robot's own position, so it does not move.

use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::value::Value;

use crate::bench::{Bench, Stop, fail, skip};
use crate::case::Arg::{H, S, V};
use crate::case::{Run, Slot, Want};
use crate::device::Refusals;
use crate::reply::request_text;

const R: Slot = Slot::Robot;
/// The cases of `slave.cases` that are functions.
pub(super) const FUNCTIONS: &[(&str, Run)] = &[
    ("move-outside", move_outside),
    ("enter-without-arm", enter_without_arm),
    ("enter-0-p", |bench| enter(bench, 0x1, 'P')),
    ("enter-0-j", |bench| enter(bench, 0x2, 'J')),
    ("enter-0-t", |bench| enter(bench, 0x3, 'T')),
    ("enter-1-p", |bench| enter(bench, 0x101, 'P')),
    ("enter-1-j", |bench| enter(bench, 0x102, 'J')),
    ("enter-1-t", |bench| enter(bench, 0x103, 'T')),
    ("enter-2-p", |bench| enter(bench, 0x201, 'P')),
    ("enter-2-j", |bench| enter(bench, 0x202, 'J')),
    ("enter-2-t", |bench| enter(bench, 0x203, 'T')),
    ("buffer-fills-in-mode-0", buffer_fills),
    ("buffer-overflows-in-mode-0", buffer_overflows),
    ("buffer-waits-in-mode-2", |bench| never_full(bench, 0x202)),
    ("buffer-overwritten-in-mode-1", |bench| never_full(bench, 0x102)),
    ("underflow-at-rest", underflow_at_rest),
    ("other-commands", other_commands),
    ("short-pose", short_pose),
    ("receive-p", |bench| received(bench, "3,1", Want::Array(5, 7))),
    ("receive-j", |bench| received(bench, "3,2", Want::Array(5, 8))),
    ("receive-t", |bench| received(bench, "3,3", Want::Array(5, 10))),
    ("receive-p-and-j", |bench| received(bench, "3,4", Want::Array(5, 15))),
    ("receive-t-and-j", |bench| received(bench, "3,5", Want::Array(5, 18))),
    ("receive-time", |bench| received(bench, "3,0x12", Want::Array(12, 2))),
    ("receive-current", |bench| received(bench, "3,0x42", Want::Array(12, 2))),
    ("receive-mini-io", |bench| received(bench, "3,0x102", Want::Array(12, 2))),
    ("receive-hand-io", |bench| received(bench, "3,0x22", Want::Array(12, 2))),
];

/// Sends a pose, whose reply has the values of a receive format.
fn received(bench: &mut Bench<'_>, format: &'static str, want: Want) -> Result<(), Stop> {
    let set = bench.robot_command("slvRecvFormat", format)?;
    if matches!(want, Want::Array(12, _)) && set.result() == HResult::E_INVALIDARG {
        return skip("the device does not have this IO");
    }
    bench.check(F::ROBOT_EXECUTE, &set, Want::NoValue, Refusals::Skip)?;
    change(bench, 0x202)?;
    let pose = pose(bench, 'J')?;
    let reply = slv_move(bench, &pose)?;
    bench.check(F::ROBOT_EXECUTE, &reply, want, Refusals::Fail)
}

/// Returns the current position of the robot as a pose.
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
    if reply.result().is_err() {
        return skip(format!("{command}: {}", reply.text()));
    }
    match reply.args.into_iter().next() {
        Some(pose) => Ok(pose),
        None => fail(format!("{command}: a pose"), "no value"),
    }
}

fn execute(bench: &mut Bench<'_>, command: &str, value: Value) -> Result<TestFrame, Stop> {
    let handle = bench.argument(&H(R))?;
    bench.exchange(F::ROBOT_EXECUTE, vec![handle, Value::text(command), value])
}

fn slv_move(bench: &mut Bench<'_>, pose: &Value) -> Result<TestFrame, Stop> {
    execute(bench, "slvMove", pose.clone())
}

/// Enters Slave Mode, or skips the case if the controller has no licence for it.
fn change(bench: &mut Bench<'_>, mode: i32) -> Result<(), Stop> {
    let reply = execute(bench, "slvChangeMode", Value::I4(mode))?;
    match reply.result() {
        HResult::E_NO_LICENSE | HResult::E_CAO_PROV_NO_LICENSE => skip(format!("Slave Mode: {}", reply.result())),
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

/// Enters a mode, sends the current pose twice, and leaves.
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
    let codes = serials.iter().map(|serial| bench.reply(F::ROBOT_EXECUTE, *serial).map(|reply| reply.result()));
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
    bench.check(F::ROBOT_EXECUTE, &reply, Want::Refused, Refusals::Fail)
}

/// Sends the current position: a device that accepts it does not jump.
fn move_outside(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let pose = pose(bench, 'J')?;
    let reply = slv_move(bench, &pose)?;
    bench.check(F::ROBOT_EXECUTE, &reply, Want::Refused, Refusals::Skip)
}

fn enter_without_arm(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let entered = bench.robot_command("slvChangeMode", "3,514");
    if !matches!(&entered, Ok(reply) if reply.result().is_err()) {
        // immediately, even if the reply is wrong
        let args = [H(R), S("slvChangeMode"), V("3,0")].map(|arg| bench.argument(&arg));
        let args = args.into_iter().collect::<Result<Vec<_>, _>>()?;
        bench.attempt(F::ROBOT_EXECUTE, args, bench.options.timeout);
    }
    bench.check(F::ROBOT_EXECUTE, &entered?, Want::Refused, Refusals::Skip)
}

/// Sends the first three elements of the current position.
fn short_pose(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let pose = pose(bench, 'J')?;
    let Value::Array(element, joints) = pose else { return fail("a pose", "another value") };
    let short = Value::Array(element, joints.into_iter().take(3).collect());
    change(bench, 0x202)?;
    let reply = slv_move(bench, &short)?;
    bench.check(F::ROBOT_EXECUTE, &reply, Want::Refused, Refusals::Fail)
}
