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

const POSE: &str = "Robot_Execute(9, \"CurPos\", EMPTY)";
const FRAME: &str = "Robot_Execute(9, \"CurTrn\", EMPTY)";

fn motion(config: MotionConfig) -> impl Procedure<Output = Motion, Error = StepError> {
    motion_to(joints(10.0), config)
}

fn motion_to(target: Target, config: MotionConfig) -> impl Procedure<Output = Motion, Error = StepError> {
    move_and_wait(HANDLES, MotionStart::Move { interpolation: 1, pose: "@E P1", option: "NEXT" }, target, config)
}

fn joints(angle: f64) -> Target {
    Target::joints(Joints::new([angle, 0.0, 90.0, 0.0, 45.0, 0.0]), 6)
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
    moved_to(joints(10.0), config, position, state)
}

fn moved_to(
    target: Target,
    config: MotionConfig,
    position: impl Fn(u64) -> f64,
    state: impl Fn(u64) -> i32,
) -> Run<Motion> {
    run(motion_to(target, config), |_, call, now| {
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
    assert_eq!(done.calls[..5], [POSITION, MOVE.call, STATE, POSITION, STATE]);
    assert!(!done.calls.iter().any(|call| call == HALT));
    // at rest for one look, and not merely near
    assert!((100..=150).contains(&(done.now.as_micros() / 1000)), "{:?}", done.now);
    // passing through the tolerance does not count as arrival
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
    let moving = |millis: u64| if millis < 300 { MOVING } else { 0 };
    let done = moved_to(joints(10.0).with_loop(), within(1000), circle, moving);
    assert_eq!(done.result, Ok(Motion::Arrived));
    assert!(done.now.as_micros() / 1000 >= 300, "{:?}", done.now);
    // a loop that no poll saw may have been halted at its start
    let done = moved_to(joints(10.0).with_loop(), within(3000), |_| 10.0, |_| 0);
    assert_eq!((done.result, done.calls.last().unwrap().as_str()), (Ok(Motion::Unknown), HALT));
    // at its destination from the start, it arrives immediately
    let done = moved(within(1000), |_| 10.0, |_| 0);
    assert_eq!(done.result, Ok(Motion::Arrived));
    assert!(done.now.as_micros() / 1000 < 50);
}

#[test]
fn a_motion_shorter_than_the_tolerance_has_arrived_after_the_robot_has_moved() {
    // it rests for 300 ms, and SysState reports no motion
    let late = |by: f64| move |millis: u64| if millis < 300 { 10.0 - by } else { 10.0 };
    let large = MotionConfig { tolerance: 1.0, ..within(10_000) };
    for (config, by) in [(within(10_000), 0.03), (large, 0.8)] {
        let done = moved(config, late(by), |_| 0);
        assert_eq!(done.result, Ok(Motion::Arrived));
        assert!((300..400).contains(&(done.now.as_micros() / 1000)), "{:?}", done.now);
        assert!(!done.calls.iter().any(|call| call == HALT));
    }
    let position = Target::position(Position::new([10.0, 0.0, 300.0], [180.0, 0.0, 180.0]));
    let done = run(motion_to(position, within(10_000)), |_, call, now| {
        let x = late(0.08)(now.as_micros() / 1000);
        match call {
            DESTINATION | POSITION => at(x),
            STATE => Answer::value(&0),
            POSE => Answer::value(&[x, 0.0, 300.0, 180.0, 0.0, 180.0, 5.0]),
            _ => Answer::Empty,
        }
    });
    assert_eq!(done.result, Ok(Motion::Arrived));
    assert!((300..400).contains(&(done.now.as_micros() / 1000)), "{:?}", done.now);
    // one that never begins
    let done = moved(within(10_000), |_| 9.97, |_| 0);
    assert_eq!(done.result, Ok(Motion::Arrived));
    assert!((1000..1100).contains(&(done.now.as_micros() / 1000)), "{:?}", done.now);
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
    let error = done.result.err().unwrap();
    assert_eq!((error.function, error.cause), (FunctionId::ROBOT_HALT, StepCause::Refused(HResult::E_FAIL)));
    assert_eq!(done.calls[done.calls.len() - 2..], [HALT, HALT]);
}

/// Lets the robot fail at the first look; `info` is the answer to GetCurErrorInfo.
fn failed(state: i32, count: i32, info: &Answer) -> Run<Motion> {
    run(motion(within(1000)), |_, call, _| match call {
        POSITION => at(0.0),
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
            let asked = [COUNT, "Controller_Execute(7, \"GetCurErrorInfo\", 2)", HALT];
            assert_eq!(done.calls[done.calls.len() - 3..], asked);
        }
    }
    // an emergency stop without an entry or with the stopped motion alone, and an entry without a code
    let stopped = Ok(Motion::Failed(HResult::from_u32(0x8150_101A)));
    assert_eq!(failed(1 << 10, 0, &Answer::Empty).result, stopped);
    let motion = Answer::value(&(HResult::E_MOTION_STOPPED.0, "message"));
    assert_eq!(failed(1 << 1 | 1 << 10, 1, &motion).result, stopped);
    assert_eq!(failed(1 << 1, 0, &Answer::Empty).result, Ok(Motion::Failed(HResult::E_FAIL)));
    assert_eq!(failed(1 << 1, 1, &Answer::value(&"?")).result, Ok(Motion::Failed(HResult::E_FAIL)));
}

/// A motion to 10 degrees with an error from 50 ms on; `position` says where the first joint is, and `halt` answers Robot_Halt.
fn failing(position: impl Fn(u64) -> f64, halt: Answer) -> Run<Motion> {
    let error = Answer::value(&ValueThen(&0x8150_1003_u32));
    run(motion(within(10_000)), |_, call, now| {
        let millis = now.as_micros() / 1000;
        match call {
            DESTINATION => at(10.0),
            STATE => Answer::value(&if millis >= 50 { 1 << 1 } else { 0 }),
            POSITION => at(position(millis)),
            COUNT => Answer::value(&1),
            HALT => halt.clone(),
            _ if call.contains("GetCurErrorInfo") => error.clone(),
            _ => Answer::Empty,
        }
    })
}

/// A warning does not stop the robot.
#[test]
fn a_failed_motion_leaves_nothing_moving() {
    let failed = Ok(Motion::Failed(HResult::from_u32(0x8150_1003)));
    for position in [ramp as fn(u64) -> f64, |_| 0.0] {
        let done = failing(position, Answer::Empty);
        assert_eq!((done.result, done.calls.last().unwrap().as_str()), (failed, HALT));
        assert!(done.now.as_micros() / 1000 < 80, "{:?}", done.now);
    }
}

#[test]
fn a_refused_halt_of_a_failed_motion_is_not_taken_for_rest() {
    let refusal = Answer::Refused(HResult::E_ERROR_PRESENT);
    let failed = Ok(Motion::Failed(HResult::from_u32(0x8150_1003)));
    let halts = |done: &Run<Motion>| done.calls.iter().filter(|call| *call == HALT).count();
    // it brakes for the error itself
    let done = failing(|millis| ramp(millis.min(80)), refusal.clone());
    assert_eq!((done.result, halts(&done)), (failed, 1));
    assert!(done.now.as_micros() / 1000 >= 80 + 5 * 20, "{:?}", done.now);
    // it continues
    let done = failing(|millis| millis as f64 / 100.0, refusal);
    let error = done.result.unwrap_err();
    assert_eq!((error.function, error.hresult()), (FunctionId::ROBOT_HALT, Some(HResult::E_ERROR_PRESENT)));
    assert_eq!(halts(&done), 3, "the last one is on the way back");
    assert!((1000..1200).contains(&(done.now.as_micros() / 1000)), "{:?}", done.now);
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
    for (number, call) in [POSITION, MOVE.call, STATE, POSITION].into_iter().enumerate() {
        for (failure, cause) in [
            (Answer::Refused(HResult::E_HANDLE), StepCause::Refused(HResult::E_HANDLE)),
            // the controller has abandoned the call, and may still execute it
            (Answer::Refused(HResult::E_TIMEOUT), StepCause::Refused(HResult::E_TIMEOUT)),
            (Answer::Failed(Failure::Timeout), StepCause::Failed(Failure::Timeout)),
            (Answer::Failed(Failure::NotSent), StepCause::Failed(Failure::NotSent)),
            (Answer::Failed(Failure::Lost), StepCause::Failed(Failure::Lost)),
            (Answer::Failed(Failure::Closed), StepCause::Failed(Failure::Closed)),
        ] {
            let done = run(motion(within(1000)), |n, text, _| if n == number { failure.clone() } else { normal(text) });
            let error = done.result.err().unwrap();
            assert_eq!((error.function, error.cause), (function_of(call), cause));
            let lost = matches!(cause, StepCause::Failed(Failure::Lost | Failure::Closed));
            // a motion may be running that was not halted
            let may_move = number > 1 || (number == 1 && cause == StepCause::Failed(Failure::Lost));
            assert_eq!(error.undone, !(lost && may_move), "{call} {cause:?}");
            // before the motion, refused or never sent, it has not started
            let given_up =
                matches!(cause, StepCause::Failed(Failure::Timeout) | StepCause::Refused(HResult::E_TIMEOUT));
            let halts = !lost && (number > 1 || (number == 1 && given_up));
            assert_eq!(done.calls.len(), number + 1 + usize::from(halts), "{call} {cause:?}");
            assert_eq!(done.calls.last().unwrap() == HALT, halts, "{call} {cause:?}");
        }
    }
}

/// A motion whose SysState is refused, and whose halt is answered so.
fn undone(halt: impl Fn(u64) -> Answer) -> Run<Motion> {
    run(motion(within(60_000)), |_, call, now| match call {
        DESTINATION | POSITION => at(0.0),
        STATE => Answer::Refused(HResult::E_HANDLE),
        HALT => halt(now.as_micros() / 1000),
        _ => Answer::Empty,
    })
}

#[test]
fn a_halt_on_the_way_back_counts_only_if_it_was_carried_out() {
    for (answer, is_undone) in [
        (Answer::Empty, true),
        (Answer::Failed(Failure::Lost), false),
        (Answer::Failed(Failure::Timeout), false),
        (Answer::Failed(Failure::NotSent), false),
        (Answer::Refused(HResult::E_FAIL), false),
        (Answer::Refused(HResult::E_TIMEOUT), false),
    ] {
        let done = undone(|_| answer.clone());
        let error = done.result.err().unwrap();
        assert_eq!(error.cause, StepCause::Refused(HResult::E_HANDLE));
        assert_eq!(
            (error.undone, error.had_no_effect(), error.unsettled),
            (is_undone, is_undone, !is_undone),
            "{answer:?}"
        );
        assert_eq!(done.calls.iter().filter(|call| *call == HALT).count(), 1, "{answer:?}");
    }
}

#[test]
fn a_halt_on_the_way_back_is_repeated_while_the_controller_is_busy() {
    let busy = Answer::Refused(HResult::E_BUSY_PROC);
    let done = undone(|millis| if millis < 300 { busy.clone() } else { Answer::Empty });
    assert!(done.result.err().unwrap().undone);
    assert!((300..400).contains(&(done.now.as_micros() / 1000)), "{:?}", done.now);
    // for a limited time
    let done = undone(|_| busy.clone());
    assert!(!done.result.err().unwrap().undone);
    assert!((4900..5100).contains(&(done.now.as_micros() / 1000)), "{:?}", done.now);
}

#[test]
fn an_invalid_position_is_an_error_and_halts_the_robot() {
    let wrong: [&dyn Encode; 6] = [&"here", &5_i32, &[0.0_f64; 0], &["a"; 8], &[f64::NAN; 8], &[f64::INFINITY; 8]];
    for value in wrong {
        for (before, call) in [(2, DESTINATION), (2, POSITION)] {
            let done = run(motion_to(Target::UNKNOWN, within(1000)), |n, text, _| match text {
                _ if text == call && n >= before => Answer::value(value),
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
    // before the motion there is nothing to halt
    let done = run(motion(within(1000)), |_, _, _| Answer::value(&"here"));
    assert_eq!((done.calls.as_slice(), done.result.is_err()), ([POSITION.to_string()].as_slice(), true));
    let state = run(motion(within(1000)), |_, text, _| match text {
        POSITION => at(0.0),
        STATE => Answer::value(&"?"),
        _ => Answer::Empty,
    });
    assert!(matches!(state.result.err().unwrap().cause, StepCause::Reply(_)));
    assert_eq!(state.calls.last().unwrap(), HALT);
}

/// A robot of one joint and a tool at [angle, 0, 300], pointing down, that moves to 10 degrees unless it is halted before.
struct Mover {
    /// The angle at which it stops, and the shift of CurPos and CurTrn from then on.
    stops_at: f64,
    shift: f64,
    rotation: [f64; 3],
    /// Whether DestJnt is where the robot stops, even while it moves.
    forgets: bool,
    /// The values of the variable 5.
    variable: Answer,
}

const MOVER: Mover =
    Mover { stops_at: 10.0, shift: 0.0, rotation: [180.0, 0.0, 180.0], forgets: false, variable: Answer::Empty };

impl Mover {
    fn run(&self, target: Target) -> Run<Motion> {
        let mut begun = None;
        run(motion_to(target, within(5000)), |_, call, now| {
            let elapsed = begun.map_or(0, |begun| now.as_micros() / 1000 - begun);
            let angle = (elapsed as f64 / 10.0).min(self.stops_at);
            let moves = begun.is_some() && angle < self.stops_at;
            let x = angle + if moves { 0.0 } else { self.shift };
            match call {
                DESTINATION => at(if moves && !self.forgets { 10.0 } else { self.stops_at }),
                STATE => Answer::value(&if moves { MOVING } else { 0 }),
                POSITION => at(angle),
                POSE => {
                    let [rx, ry, rz] = self.rotation;
                    Answer::value(&[x, 0.0, 300.0, rx, ry, rz, 5.0])
                }
                FRAME => Answer::value(&[x, 0.0, 300.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 5.0]),
                _ if call == MOVE.call => {
                    begun = Some(now.as_micros() / 1000);
                    Answer::Empty
                }
                "Variable_GetValue(5)" => self.variable.clone(),
                _ => Answer::Empty,
            }
        })
    }
}

/// All targets of a motion to 10 degrees.
fn targets() -> [(Target, Answer); 12] {
    let none = Answer::Empty;
    let position = Position::new([10.0, 0.0, 300.0], [180.0, 0.0, -180.0]);
    let frame = Transform::new([10.0, 0.0, 300.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]);
    let variable = Target::variable(VariableHandle(5));
    let deeper = Position { xyz_mm: [10.0, 0.0, 250.0], ..position };
    let mut to = [None; 8];
    to[0] = Some(10.0);
    [
        (joints(10.0), none.clone()),
        (Target::joints(Joints::new([10.0]), 1), none.clone()),
        (Target::position(position), none.clone()),
        (Target::transform(frame), none.clone()),
        (Target::position(deeper).back(50.0), none.clone()),
        (Target::transform(Transform { xyz_mm: [10.0, 0.0, 250.0], ..frame }).back(50.0), none.clone()),
        (Target::drive_by(Joints::new([10.0])), none.clone()),
        (Target::drive_to(to), none),
        (variable, Answer::value(&position)),
        (variable, Answer::value(&Joints::new([10.0, 0.0, 90.0, 0.0, 45.0]))),
        (variable, Answer::value(&frame)),
        (variable.back(50.0), Answer::value(&deeper)),
    ]
}

#[test]
fn every_target_is_compared_with_the_reading_that_fits_it() {
    for (target, variable) in targets() {
        let done = Mover { variable: variable.clone(), ..MOVER }.run(target);
        assert_eq!(done.result, Ok(Motion::Arrived), "{target:?} {:?}", done.calls);
        assert!(!done.calls.iter().any(|call| call == HALT));
        // halted on the way, even when DestJnt follows the halt immediately
        for forgets in [false, true] {
            for stops_at in [0.2, 3.0, 9.0] {
                let done = Mover { variable: variable.clone(), stops_at, forgets, ..MOVER }.run(target);
                // or DestJnt says that the motion ends there, and the position belongs to another tool
                let is_unknown = forgets && done.calls.iter().any(|call| call == DESTINATION) && stops_at > 1.0;
                let expected = if is_unknown { Motion::Unknown } else { Motion::Halted };
                assert_eq!(done.result, Ok(expected), "{target:?} {stops_at}");
            }
        }
    }
}

/// The case that this rule covers: the motion is accepted, the robot is halted, and only then its destination is read.
#[test]
fn a_halt_before_the_first_poll_is_no_arrival() {
    for (target, variable) in targets() {
        let done = Mover { variable, stops_at: 0.0, forgets: true, ..MOVER }.run(target);
        assert_eq!((done.result, done.calls.last().unwrap().as_str()), (Ok(Motion::Halted), HALT), "{target:?}");
    }
    let done = Mover { stops_at: 0.0, forgets: true, ..MOVER }.run(Target::UNKNOWN.with_loop());
    assert_eq!(done.result, Ok(Motion::Unknown));
}

#[test]
fn a_motion_to_where_the_robot_stands_has_arrived_at_once() {
    let there = Position::new([0.0, 0.0, 300.0], [180.0, 0.0, 180.0]);
    for target in [joints(0.0), Target::position(there), Target::drive_by(Joints::new([0.0]))] {
        let done = Mover { stops_at: 0.0, ..MOVER }.run(target);
        assert_eq!(done.result, Ok(Motion::Arrived), "{target:?}");
        assert!(done.now.as_micros() / 1000 < 50, "{:?}", done.now);
    }
}

#[test]
fn an_end_that_cannot_be_compared_counts_only_if_it_was_seen_during_the_motion() {
    assert_eq!(MOVER.run(Target::UNKNOWN).result, Ok(Motion::Arrived));
    assert_eq!(Mover { stops_at: 5.0, ..MOVER }.run(Target::UNKNOWN).result, Ok(Motion::Halted));
    // the motion ends before two polls
    assert_eq!(Mover { stops_at: 1.5, ..MOVER }.run(Target::UNKNOWN).result, Ok(Motion::Unknown));
    // a value that is not a position
    let done = Mover { variable: Answer::value(&1), stops_at: 5.0, ..MOVER }.run(Target::variable(VariableHandle(5)));
    assert_eq!(done.result, Ok(Motion::Halted));
    let refused = Answer::Refused(HResult::E_CAO_OBJECT_NOTFOUND);
    let done = Mover { variable: refused, ..MOVER }.run(Target::variable(VariableHandle(5)));
    assert_eq!(done.result, Ok(Motion::Arrived));
}

#[test]
fn a_position_that_does_not_fit_the_destination_of_the_motion_is_unknown() {
    let position = Target::position(Position::new([10.0, 0.0, 300.0], [180.0, 0.0, 180.0]));
    let frame = Target::transform(Transform::new([10.0, 0.0, 300.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]));
    for target in [position, frame] {
        // the tool was changed during the motion
        assert_eq!(Mover { shift: 20.0, ..MOVER }.run(target).result, Ok(Motion::Unknown));
        assert_eq!(Mover { shift: 20.0, stops_at: 5.0, ..MOVER }.run(target).result, Ok(Motion::Halted));
    }
    for rotation in [[0.0, 180.0, 0.0], [-180.0, 0.0, 180.0], [180.0, 360.0, 180.02]] {
        assert_eq!(Mover { rotation, ..MOVER }.run(position).result, Ok(Motion::Arrived), "{rotation:?}");
    }
    for rotation in [[0.0, 0.0, 0.0], [180.0, 0.0, 179.0], [180.0, 90.0, 180.0]] {
        assert_eq!(Mover { rotation, ..MOVER }.run(position).result, Ok(Motion::Unknown), "{rotation:?}");
    }
    let pole = Target::position(Position::new([10.0, 0.0, 300.0], [30.0, 90.0, 10.0]));
    for (rotation, outcome) in [([120.0, 90.0, 100.0], Motion::Arrived), ([30.0, 90.0, 12.0], Motion::Unknown)] {
        assert_eq!(Mover { rotation, ..MOVER }.run(pole).result, Ok(outcome), "{rotation:?}");
    }
}

#[test]
fn the_error_that_a_halt_leaves_is_a_halt() {
    let done = failed(1 << 1, 1, &Answer::value(&(HResult::E_MOTION_STOPPED.0, "message")));
    assert_eq!(done.result, Ok(Motion::Halted));
}

#[test]
fn a_dropped_run_halts_the_robot_when_it_is_run_again() {
    let mut procedure = motion(within(1000));
    for call in [POSITION, MOVE.call] {
        assert!(matches!(procedure.poll(Instant::ZERO), Action::Call(Channel::Motion)));
        let answer = if call == POSITION { at(0.0) } else { Answer::Empty };
        hand_in(&mut procedure, &answer, Instant::ZERO);
    }
    assert!(matches!(procedure.poll(Instant::ZERO), Action::Call(Channel::Motion)));
    procedure.handle_failure(Failure::Timeout, Instant::ZERO);
    let done = run(&mut procedure, |_, _, _| Answer::Empty);
    assert_eq!(done.calls, [HALT]);
    assert_eq!(done.result.err().unwrap().cause, StepCause::Failed(Failure::Timeout));
}
