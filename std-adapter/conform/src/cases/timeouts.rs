//! Pauses within frames, and keep-alives.

use std::time::{Duration, Instant};

use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;
use bcap_testkit::value::Value;

use crate::bench::{Bench, Stop, fail, skip, value_of};
use crate::case::Arg::{H, I, S, V};
use crate::case::{Run, Slot, Want};
use crate::reply::{Came, request_text};
/// The cases of `timeouts.cases` that are functions.
pub(super) const FUNCTIONS: &[(&str, Run)] = &[
    ("pause-within-the-header", |bench| paused(bench, 7)),
    ("pause-within-an-argument", |bench| paused(bench, 30)),
    ("pause-between-frames", pause_between),
    ("pause-of-another-client", unfinished_frame_of_another),
    ("quick-call-without-keep-alive", no_keep_alive),
    ("silence-after-a-reply", silence),
    ("keep-alives-of-a-motion", keep_alives),
    ("no-keep-alive-without-wdt", no_keep_alives_without_wdt),
    ("others-during-a-motion", others_during_a_motion),
];

/// A pause that is longer than the poll interval of known servers.
const PAUSE: Duration = Duration::from_millis(500);

/// The time for the device to read a part of a frame, before another client calls.
const PART_PAUSE: Duration = Duration::from_millis(100);

/// The number of comparisons of two clients: a busy machine may delay an answer once, but a faulty device always does.
const ATTEMPTS: usize = 3;

/// The external speed, acceleration and deceleration of long motions, in percent.
const SLOWEST: &str = "8196,1,1,1";

/// The shortest motion that shows whether a device sends keep-alives, or serves other clients, during a motion.
const SHORTEST: Duration = Duration::from_millis(400);

/// The time limit for reading replies that have arrived already.
const ARRIVED: Duration = Duration::from_millis(50);

fn paused(bench: &mut Bench<'_>, at: usize) -> Result<(), Stop> {
    let (serial, bytes) = bench.request(F::SERVICE_START, &[Value::text("WDT=400")]);
    bench.send(&bytes[..at], "the start of Service_Start")?;
    if let came @ (Came::Reply(_) | Came::Invalid(_) | Came::Closed) = bench.receive_within(PAUSE) {
        return fail("silence until the frame is complete", came.text());
    }
    bench.send(&bytes[at..], "the rest")?;
    let reply = bench.reply(F::SERVICE_START, serial)?;
    if reply.result().is_ok() { Ok(()) } else { fail("success", reply.text()) }
}

fn pause_between(bench: &mut Bench<'_>) -> Result<(), Stop> {
    std::thread::sleep(Duration::from_secs(1));
    bench.want(F::CONTROLLER_GET_VARIABLE, &[H(Slot::Controller), S("I1"), S("")], Want::Type(3)).map(drop)
}

fn unfinished_frame_of_another(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let usual = time_of_call(bench)?;
    // a device that waits for the rest of the frame waits at least `PAUSE`, as other cases require
    let limit = usual + bench.options.quiet;
    let mut took = usual;
    for _ in 0..ATTEMPTS {
        // this connection stays open until the call has its answer
        let mut other = Bench::new(bench.options, bench.link);
        other.connect()?;
        other.send(&[1, 44, 0, 0, 0, 1], "the start of a frame")?;
        std::thread::sleep(PART_PAUSE);
        took = time_of_call(bench)?;
        if took <= limit {
            return Ok(());
        }
    }
    let expected = format!("an answer within {} ms while a frame of another client is unfinished", limit.as_millis());
    fail(expected, format!("an answer after {} ms", took.as_millis()))
}

/// Returns the duration of a call that every device refuses immediately.
fn time_of_call(bench: &mut Bench<'_>) -> Result<Duration, Stop> {
    let began = Instant::now();
    bench.must(F(65_999), &[], Want::Refused)?;
    Ok(began.elapsed())
}

fn no_keep_alive(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let (serial, bytes) = bench.request(F::SERVICE_START, &[Value::text("WDT=400")]);
    bench.send(&bytes, "Service_Start(WDT=400)")?;
    match bench.receive() {
        Came::Reply(reply)
            if reply.serial == serial && reply.result().is_ok() && reply.result() != HResult::S_EXECUTING =>
        {
            Ok(())
        }
        came => fail("the reply itself", came.text()),
    }
}

fn silence(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.must(F(65_999), &[], Want::Refused)?;
    match bench.receive_within(bench.options.quiet) {
        Came::Nothing => Ok(()),
        came => fail("silence", came.text()),
    }
}

/// Sends a motion that takes about a second, and returns its serial. After an interruption it skips the case.
fn start_motion(bench: &mut Bench<'_>) -> Result<u16, Stop> {
    if bench.was_interrupted() {
        return skip("interrupted");
    }
    if bench.handle(Slot::B) == 0 {
        bench.way_back = Some(present_angle(bench)?);
    }
    // the axis turns by 5 degrees and back, slowly
    let pair = if bench.handle(Slot::B) == 0 { "8204,(8195,6,5)" } else { "8204,(8195,6,-5)" };
    bench.set_handle(Slot::B, 1 - bench.handle(Slot::B));
    let args = [H(Slot::Robot), S("DriveEx"), V(pair)];
    let args = args.iter().map(|arg| bench.argument(arg)).collect::<Result<Vec<_>, _>>()?;
    let (serial, bytes) = bench.request(F::ROBOT_EXECUTE, &args);
    bench.send(&bytes, &request_text(serial, F::ROBOT_EXECUTE, &args))?;
    Ok(serial)
}

/// Returns the argument of DriveAEx for the current angle of axis 6.
fn present_angle(bench: &mut Bench<'_>) -> Result<Value, Stop> {
    let reply = bench.robot_command("CurJnt", "0,")?;
    let angle = match reply.value() {
        Some(Value::Array(_, joints)) => joints.get(5).and_then(Value::as_f64),
        _ => None,
    };
    match angle {
        Some(angle) if reply.result().is_ok() => value_of(&format!("8204,(8197,6,{angle})")),
        _ => skip(format!("CurJnt: {}", reply.text())),
    }
}

/// Turns the axis back.
fn move_back(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let serial = start_motion(bench)?;
    let (_, code) = count_keep_alives(bench, serial)?;
    if code.is_err() {
        return fail("success of the motion back", code.to_string());
    }
    bench.way_back = None;
    Ok(())
}

/// Sets the interval of keep-alives in a separate session, because the arm is lost with the session.
fn with_wdt(bench: &mut Bench<'_>, option: &'static str) -> Result<(), Stop> {
    bench.must(F::SERVICE_STOP, &[], Want::NoValue)?;
    bench.must(F::SERVICE_START, &[S(option)], Want::NoValue)?;
    bench.open_controller()?;
    bench.open(Slot::Robot, F::CONTROLLER_GET_ROBOT, &[H(Slot::Controller), S("Arm"), S("")])?;
    bench.take_arm(SLOWEST)
}

/// Returns the number of keep-alives before the reply, and the reply's result.
fn count_keep_alives(bench: &mut Bench<'_>, serial: u16) -> Result<(usize, HResult), Stop> {
    match keep_alives_within(bench, serial, Duration::from_secs(60))? {
        (count, Some(code)) => Ok((count, code)),
        (_, None) => fail("S_EXECUTING or the reply", Came::Nothing.text()),
    }
}

/// Returns the number of keep-alives within a time limit, and the result of the reply if it arrives by then.
fn keep_alives_within(bench: &mut Bench<'_>, serial: u16, limit: Duration) -> Result<(usize, Option<HResult>), Stop> {
    let until = Instant::now() + limit;
    let mut count = 0;
    loop {
        match bench.receive_within(until.saturating_duration_since(Instant::now())) {
            Came::Reply(reply) if reply.serial != serial => return fail(format!("the serial {serial}"), reply.text()),
            Came::Reply(reply) if reply.result() == HResult::S_EXECUTING && reply.args.is_empty() => count += 1,
            Came::Reply(reply) if reply.result() == HResult::S_EXECUTING => {
                return fail("S_EXECUTING without a value", reply.text());
            }
            Came::Reply(reply) => return Ok((count, Some(reply.result()))),
            Came::Nothing => return Ok((count, None)),
            came => return fail("S_EXECUTING or the reply", came.text()),
        }
    }
}

fn moved(code: HResult) -> Result<(), Stop> {
    match code.is_err() {
        true => skip(format!("the motion of axis 6 ended with {code}; an arm of four axes has no axis 6")),
        false => Ok(()),
    }
}

/// Skips the case if a motion was too short for it.
fn long_enough(took: Duration) -> Result<(), Stop> {
    match took < SHORTEST {
        true => skip(format!(
            "the motion of axis 6 takes {} ms; the case needs {} ms",
            took.as_millis(),
            SHORTEST.as_millis()
        )),
        false => Ok(()),
    }
}

fn keep_alives(bench: &mut Bench<'_>) -> Result<(), Stop> {
    with_wdt(bench, "WDT=100")?;
    let serial = start_motion(bench)?;
    let began = Instant::now();
    let (count, code) = count_keep_alives(bench, serial)?;
    moved(code)?;
    let took = began.elapsed();
    move_back(bench)?;
    long_enough(took)?;
    let tenths = took.as_millis() / 100;
    // timers and networks delay them, so half of them must arrive
    let least = usize::try_from(tenths / 2).unwrap_or(usize::MAX);
    let most = usize::try_from(tenths + 2).unwrap_or(usize::MAX);
    match (least..=most).contains(&count) {
        true => Ok(()),
        false => fail(format!("{least} to {most} keep-alives in {tenths} intervals"), format!("{count}")),
    }
}

fn no_keep_alives_without_wdt(bench: &mut Bench<'_>) -> Result<(), Stop> {
    // the usual speed ends the motion before the first keep-alive of a faulty device
    let slow = bench.robot_command("ExtSpeed", SLOWEST)?;
    if slow.result().is_err() {
        return skip(format!("ExtSpeed: {}", slow.text()));
    }
    let serial = start_motion(bench)?;
    let began = Instant::now();
    let (count, code) = count_keep_alives(bench, serial)?;
    moved(code)?;
    let took = began.elapsed();
    move_back(bench)?;
    if count == 0 { long_enough(took) } else { fail("no keep-alive", format!("{count}")) }
}

fn others_during_a_motion(bench: &mut Bench<'_>) -> Result<(), Stop> {
    with_wdt(bench, "WDT=100")?;
    let mut other = bench.another()?;
    let mut way_back = Duration::ZERO;
    for _ in 0..ATTEMPTS {
        let serial = start_motion(bench)?;
        other.must(F(65_999), &[], Want::Refused)?;
        other.must(F::CONTROLLER_GET_NAME, &[I(1)], Want::Refused)?;
        let (_, early) = keep_alives_within(bench, serial, ARRIVED)?;
        let code = match early {
            Some(code) => code,
            None => count_keep_alives(bench, serial)?.1,
        };
        moved(code)?;
        let began = Instant::now();
        move_back(bench)?;
        if early.is_none() {
            return Ok(());
        }
        way_back = began.elapsed();
    }
    long_enough(way_back)?;
    fail("the other client is answered during the motion", "the reply to the motion came first")
}
