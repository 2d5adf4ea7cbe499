//! `move_and_wait` against robots that arrive, stop, fail, start late or never.

use super::*;

const HANDLES: Handles = Handles { controller: ControllerHandle(7), robot: RobotHandle(9) };
const MOVE: Expected = Expected {
    call: "Robot_Move(9, 1, \"@E P1\", \"NEXT\")",
    undo: "Robot_Halt(9, \"\")",
    undo_unknown: "Robot_Halt(9, \"\")",
};
const DESTINATION: &str = "Robot_Execute(9, \"DestJnt\", EMPTY)";
const STATE: &str = "Controller_Execute(7, \"SysState\", EMPTY)";
const POSITION: &str = "Robot_Execute(9, \"CurJnt\", EMPTY)";
const COUNT: &str = "Controller_Execute(7, \"GetCurErrorCount\", EMPTY)";
const HALT: &str = "Robot_Halt(9, \"\")";
const MOVING: i32 = 0b11 << 20;

fn motion(config: MotionConfig) -> impl Procedure<Output = Motion, Error = StepError> {
    move_and_wait(HANDLES, MotionStart::Move { interpolation: 1, pose: "@E P1", option: "NEXT" }, config)
}

fn within(millis: u64) -> MotionConfig {
    MotionConfig::within(Duration::from_millis(millis))
}

fn at(angle: f64) -> Answer {
    Answer::value(&[angle, 0.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0])
}

/// Lets a robot move to 10 degrees; `position` says where its first joint is, and `state` what SysState reports, by the
/// milliseconds since the start.
fn moved(config: MotionConfig, position: impl Fn(u64) -> f64, state: impl Fn(u64) -> i32) -> Run<Motion> {
    run(motion(config), |_, call, now| {
        let millis = now.as_micros() / 1000;
        match call {
            DESTINATION => at(10.0),
            STATE => Answer::value(&state(millis)),
            POSITION => at(position(millis)),
            _ => Answer::Empty,
        }
    })
}

/// Moves at 0.1 degrees a millisecond.
fn ramp(millis: u64) -> f64 {
    (millis as f64 / 10.0).min(10.0)
}

#[test]
fn a_motion_that_ends_at_its_destination_has_arrived() {
    let done = moved(within(1000), ramp, |_| 0);
    assert_eq!(done.result, Ok(Motion::Arrived));
    assert_eq!(done.calls[..5], [MOVE.call, DESTINATION, STATE, POSITION, STATE]);
    assert!(!done.calls.iter().any(|call| call == HALT));
    // at rest for one look, and not merely near
    assert!((100..=150).contains(&(done.now.as_micros() / 1000)), "{:?}", done.now);
    // passing through the tolerance is no arrival
    let through = moved(MotionConfig { tolerance: 3.0, ..within(1000) }, ramp, |_| 0);
    assert!(through.now.as_micros() / 1000 >= 100, "{:?}", through.now);
}

#[test]
fn an_arrival_is_detected_while_the_motion_bit_stays_set() {
    assert_eq!(moved(within(1000), ramp, |_| MOVING).result, Ok(Motion::Arrived));
}

#[test]
fn a_motion_that_ends_where_it_began_has_arrived_when_the_controller_reports_no_motion() {
    // out and back within 300 ms, and the start is slow
    let circle = |millis: u64| if (100..300).contains(&millis) { 12.0 + millis as f64 / 100.0 } else { 10.0 };
    let done = moved(within(1000), circle, |millis| if millis < 300 { MOVING } else { 0 });
    assert_eq!(done.result, Ok(Motion::Arrived));
    assert!(done.now.as_micros() / 1000 >= 300, "{:?}", done.now);
    // at its destination from the start, it has arrived at once
    let done = moved(within(1000), |_| 10.0, |_| 0);
    assert_eq!(done.result, Ok(Motion::Arrived));
    assert!(done.now.as_micros() / 1000 < 50);
}

#[test]
fn a_robot_at_rest_elsewhere_was_halted() {
    let done = moved(within(10_000), |millis| ramp(millis.min(40)), |_| 0);
    assert_eq!(done.result, Ok(Motion::Halted));
    assert!(!done.calls.iter().any(|call| call == HALT), "it stands already");
    // five looks at rest
    assert!((120..250).contains(&(done.now.as_micros() / 1000)), "{:?}", done.now);
}

#[test]
fn a_robot_that_has_not_begun_to_move_was_not_halted() {
    // it rests for 500 ms, and SysState reports no motion
    let late = |millis: u64| ramp(millis.saturating_sub(500));
    let done = moved(within(10_000), late, |_| 0);
    assert_eq!(done.result, Ok(Motion::Arrived));
    // one that never begins is halted after `start`, so that it does not begin later
    let done = moved(within(10_000), |_| 0.0, |_| 0);
    assert_eq!((done.result, done.calls.last().unwrap().as_str()), (Ok(Motion::Halted), HALT));
    assert!((1000..1100).contains(&(done.now.as_micros() / 1000)), "{:?}", done.now);
    // while SysState reports a motion, only the time limit ends it
    let done = moved(within(3000), |_| 0.0, |_| MOVING);
    assert_eq!((done.result, done.calls.last().unwrap().as_str()), (Ok(Motion::TimedOut), HALT));
}

#[test]
fn a_slow_motion_is_not_mistaken_for_rest() {
    // 0.05 degrees a second: a thousandth of a degree between two looks
    let creep = |millis: u64| ramp(50) + (millis.saturating_sub(50) as f64) * 0.00005;
    let position = |millis: u64| if millis < 50 { ramp(millis) } else { creep(millis) };
    let done = moved(within(2000), position, |_| 0);
    assert_eq!(done.result, Ok(Motion::TimedOut));
    // nor is a motion on hold, which SysState reports
    let done = moved(within(2000), |millis| ramp(millis.min(40)), |_| MOVING);
    assert_eq!(done.result, Ok(Motion::TimedOut));
}

#[test]
fn the_time_limit_halts_the_robot() {
    let config = MotionConfig { interval: Duration::from_secs(60), ..within(100) };
    let done = moved(config, |millis| millis as f64 / 1000.0, |_| 0);
    assert_eq!((done.result, done.calls.last().unwrap().as_str()), (Ok(Motion::TimedOut), HALT));
    assert_eq!(done.calls.iter().filter(|call| *call == HALT).count(), 1);
    // a long pause ends at the limit
    assert!((100..110).contains(&(done.now.as_micros() / 1000)), "{:?}", done.now);
    // a halt that is refused is an error, and is tried once more
    let done = run(motion(within(0)), |_, call, now| match call {
        DESTINATION => at(10.0),
        STATE => Answer::value(&0),
        POSITION => at(now.as_micros() as f64),
        HALT => Answer::Refused(HResult::E_FAIL),
        _ => Answer::Empty,
    });
    let error = StepError { function: FunctionId::ROBOT_HALT, cause: StepCause::Refused(HResult::E_FAIL) };
    assert_eq!(done.result.err(), Some(error));
    assert_eq!(done.calls[done.calls.len() - 2..], [HALT, HALT]);
}

/// Lets the robot fail at the first look; `info` is the answer to GetCurErrorInfo.
fn failed(state: i32, count: i32, info: &Answer) -> Run<Motion> {
    run(motion(within(1000)), |_, call, _| match call {
        DESTINATION => at(10.0),
        STATE => Answer::value(&state),
        COUNT => Answer::value(&count),
        _ if call.contains("GetCurErrorInfo") => info.clone(),
        _ => Answer::Empty,
    })
}

#[test]
fn a_failed_motion_reports_the_first_error_which_is_the_last_of_the_list() {
    let code = 0x8420_4043_u32;
    let values: [&dyn Encode; 4] = [&code.cast_signed(), &code, &HResult::from_u32(code), &i64::from(code)];
    for value in values {
        for state in [1 << 1, 1 << 10, 1 << 1 | 1 << 10 | MOVING] {
            let info = Answer::value(&ValueThen(value));
            let done = failed(state, 3, &info);
            assert_eq!(done.result, Ok(Motion::Failed(HResult::from_u32(code))));
            let asked =
                ["Controller_Execute(7, \"GetCurErrorCount\", EMPTY)", "Controller_Execute(7, \"GetCurErrorInfo\", 2)"];
            assert_eq!(done.calls[done.calls.len() - 2..], asked);
        }
    }
    // an emergency stop without an entry, and an entry without a code
    assert_eq!(failed(1 << 10, 0, &Answer::Empty).result, Ok(Motion::Failed(HResult::E_FAIL)));
    assert_eq!(failed(1 << 1, 1, &Answer::value(&"?")).result, Ok(Motion::Failed(HResult::E_FAIL)));
}

/// An entry of the list of errors: the code and a message.
struct ValueThen<'a>(&'a dyn Encode);

impl Encode for ValueThen<'_> {
    fn encode(&self, out: &mut crate::variant::Writer<'_>) -> Result<(), crate::error::EncodeError> {
        (self.0, "message").encode(out)
    }
}

#[test]
fn each_failure_halts_the_robot_once_it_may_move() {
    let normal = |call: &str| match call {
        DESTINATION | POSITION => at(10.0),
        STATE => Answer::value(&0),
        _ => Answer::Empty,
    };
    let look = Expected { undo: "", undo_unknown: HALT, call: DESTINATION };
    for (number, call) in [MOVE.call, DESTINATION, STATE, POSITION].into_iter().enumerate() {
        for (failure, cause) in [
            (Answer::Refused(HResult::E_HANDLE), StepCause::Refused(HResult::E_HANDLE)),
            (Answer::Failed(Failure::Timeout), StepCause::Failed(Failure::Timeout)),
            (Answer::Failed(Failure::NotSent), StepCause::Failed(Failure::NotSent)),
            (Answer::Failed(Failure::Lost), StepCause::Failed(Failure::Lost)),
        ] {
            let done = run(motion(within(1000)), |n, text, _| if n == number { failure.clone() } else { normal(text) });
            let error = done.result.err().unwrap();
            assert_eq!((error.function, error.cause), (function_of(call), cause));
            let lost = cause == StepCause::Failed(Failure::Lost);
            // refused or never sent, the motion has not started
            let halts = !lost && (number > 0 || cause == StepCause::Failed(Failure::Timeout));
            assert_eq!(done.calls.len(), number + 1 + usize::from(halts), "{call} {cause:?}");
            assert_eq!(done.calls.last().unwrap() == look.undo_unknown, halts, "{call} {cause:?}");
        }
    }
}

#[test]
fn an_invalid_position_is_an_error_and_halts_the_robot() {
    let wrong: [&dyn Encode; 5] = [&"here", &5_i32, &[0.0_f64; 0], &["a"; 8], &[f64::NAN; 8]];
    for value in wrong {
        for call in [DESTINATION, POSITION] {
            let done = run(motion(within(1000)), |_, text, _| match text {
                _ if text == call => Answer::value(value),
                DESTINATION | POSITION => at(0.0),
                STATE => Answer::value(&0),
                _ => Answer::Empty,
            });
            let error = done.result.err().unwrap();
            assert!(
                matches!(error.cause, StepCause::Reply(ReplyError { expected: "an array of joints", .. })),
                "{error}"
            );
            assert_eq!(done.calls[done.calls.len() - 2..], [call, HALT]);
        }
    }
    let infinite = run(motion(within(1000)), |_, text, _| match text {
        DESTINATION => Answer::value(&[f64::INFINITY; 8]),
        _ => Answer::Empty,
    });
    assert!(infinite.result.is_err());
    let state = run(motion(within(1000)), |_, text, _| match text {
        DESTINATION => at(0.0),
        STATE => Answer::value(&"?"),
        _ => Answer::Empty,
    });
    assert!(matches!(state.result.err().unwrap().cause, StepCause::Reply(_)));
    assert_eq!(state.calls.last().unwrap(), HALT);
}

#[test]
fn a_dropped_run_halts_the_robot_when_it_is_run_again() {
    let mut procedure = motion(within(1000));
    for call in [MOVE.call, DESTINATION] {
        assert!(matches!(procedure.poll(Instant::ZERO), Action::Call(Channel::Motion)));
        let answer = if call == DESTINATION { at(10.0) } else { Answer::Empty };
        hand_in(&mut procedure, &answer, Instant::ZERO);
    }
    assert!(matches!(procedure.poll(Instant::ZERO), Action::Call(Channel::Motion)));
    procedure.handle_failure(Failure::Timeout, Instant::ZERO);
    let done = run(&mut procedure, |_, _, _| Answer::Empty);
    assert_eq!(done.calls, [HALT]);
    assert_eq!(done.result.err().unwrap().cause, StepCause::Failed(Failure::Timeout));
}
