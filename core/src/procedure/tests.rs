//! The procedures against a scripted peer, under a simulated clock: the calls that they make, and their results.
#![expect(clippy::arithmetic_side_effects, reason = "a test in which a sum overflows fails, as it should")]
#![allow(clippy::as_conversions, reason = "small whole numbers")]

extern crate std;

use core::time::Duration;
use std::format;
use std::string::{String, ToString};
use std::vec;
use std::vec::Vec;

use super::*;
use crate::bcap::call::Call;
use crate::bcap::call::{ControllerHandle, FileHandle, ReplyError, RobotHandle, VariableHandle};
use crate::bcap::client::Timing;
use crate::bcap::{Decoder, FrameWriter, FunctionId, Link, Object};
use crate::hresult::HResult;
use crate::position::{Joints, Position, Transform};
use crate::time::Instant;
use crate::variant::{Encode, VarType, Variant, VariantBuf};

mod halt;
mod motion;
mod queue;
mod reclaim;
mod recover;

/// The reaction of the peer to a call.
#[derive(Clone, Debug)]
enum Answer {
    Value(VariantBuf<192>),
    Empty,
    Refused(HResult),
    Failed(Failure),
}

impl Answer {
    fn value(value: &dyn Encode) -> Self {
        Self::Value(VariantBuf::new(value).unwrap())
    }
}

/// The record of a procedure: its result, its calls as text, and the time at the end.
struct Run<T, E = StepError> {
    result: Result<T, E>,
    calls: Vec<String>,
    now: Instant,
}

/// How long a call takes.
const CALL: Duration = Duration::from_millis(1);

/// Runs a procedure against a peer, which is given the number of the call, its text, and the time of the reply.
fn run<T, E>(
    procedure: impl Procedure<Output = T, Error = E>,
    peer: impl FnMut(usize, &str, Instant) -> Answer,
) -> Run<T, E> {
    run_from(Instant::ZERO, procedure, peer)
}

/// Like [`run`], from this time on.
fn run_from<T, E>(
    mut now: Instant,
    mut procedure: impl Procedure<Output = T, Error = E>,
    mut peer: impl FnMut(usize, &str, Instant) -> Answer,
) -> Run<T, E> {
    let mut calls = Vec::new();
    let timing = procedure.timing(Link::Stream, Timing::TCP);
    assert_eq!(timing, Timing::TCP, "these procedures use the connection's timing");
    loop {
        assert!(procedure.request().is_none(), "no call before poll, none after a reply");
        match procedure.poll(now) {
            Action::Done(result) => return Run { result, calls, now },
            Action::Wait(until) => {
                assert!(until > now, "a wait that does not end");
                now = until;
            }
            Action::Call(channel) => {
                assert_eq!(channel, Channel::Motion);
                let again = procedure.poll(now);
                assert!(matches!(again, Action::Call(Channel::Motion)), "until a reply, the call is repeated");
                now = now.saturating_add(CALL);
                let call = text_of(&procedure.request().unwrap());
                let answer = peer(calls.len(), &call, now);
                calls.push(call);
                hand_in(&mut procedure, &answer, now);
                assert!(calls.len() < 10_000, "it never ends");
            }
        }
    }
}

fn hand_in(procedure: &mut impl Procedure, answer: &Answer, now: Instant) {
    let mut buffer = [0; 512];
    let mut frame = FrameWriter::new(&mut buffer).unwrap();
    let code = match answer {
        Answer::Failed(failure) => return procedure.handle_failure(*failure, now),
        Answer::Refused(code) => *code,
        Answer::Empty => HResult::S_OK,
        Answer::Value(value) => {
            frame.argument(value).unwrap();
            HResult::S_OK
        }
    };
    let bytes = frame.finish(1, 0, code.0).unwrap();
    procedure.handle_reply(&Decoder::TCP.decode_datagram(bytes).unwrap(), now);
}

/// Writes a call as its peer receives it: the function and its arguments.
fn text_of(call: &impl Call) -> String {
    let mut buffer = [0; 512];
    let mut frame = FrameWriter::new(&mut buffer).unwrap();
    call.arguments(&mut frame).unwrap();
    let bytes = frame.finish(1, 0, call.function().0).unwrap();
    let frame = Decoder::TCP.decode_datagram(bytes).unwrap();
    let arguments: Vec<String> = frame.args.iter().map(|value| argument(&value)).collect();
    format!("{}({})", frame.function(), arguments.join(", "))
}

fn argument(value: &Variant<'_>) -> String {
    match value {
        Variant::I4(n) => n.to_string(),
        Variant::Bstr(text) => format!("{:?}", text.to_string()),
        other => format!("{other:?}"),
    }
}

/// The calls after a failed one: its own undo call if it has one, then the undo calls of the calls before it.
#[derive(Clone, Copy)]
struct Expected {
    /// The call.
    call: &'static str,
    /// The call that undoes it after a success, or an empty text.
    undo: &'static str,
    /// The call that undoes it when it has no reply.
    undo_unknown: &'static str,
}

const fn step(call: &'static str) -> Expected {
    Expected { call, undo: "", undo_unknown: "" }
}

const fn opens(call: &'static str, undo: &'static str) -> Expected {
    Expected { call, undo, undo_unknown: "" }
}

/// Returns the function of a call.
fn function_of(call: &str) -> FunctionId {
    let name = call.split('(').next().unwrap();
    FunctionId::all().find(|function| function.to_string() == name).unwrap()
}

/// Lets each call of a procedure fail in every way, and checks the calls after it and the error.
///
/// `normal` answers the calls of a run that succeeds; `expected` are those calls, without the way back at its end.
fn fail_each<T, P: Procedure<Output = T, Error = StepError>>(
    make: impl Fn() -> P,
    normal: impl Fn(&str) -> Answer,
    expected: &[Expected],
    may_recover: impl Fn(&str) -> bool,
) {
    const REFUSAL: HResult = HResult::E_ACCESSDENIED;
    let failures = [
        Answer::Refused(REFUSAL),
        Answer::Failed(Failure::Timeout),
        Answer::Failed(Failure::NotSent),
        Answer::Failed(Failure::Lost),
        Answer::Failed(Failure::Closed),
    ];
    for (at, failing) in expected.iter().enumerate() {
        for failure in &failures {
            if matches!(failure, Answer::Refused(_)) && may_recover(failing.call) {
                continue;
            }
            let done = run(make(), |number, call, _| if number == at { failure.clone() } else { normal(call) });
            let cause = match failure {
                Answer::Failed(failure) => StepCause::Failed(*failure),
                _ => StepCause::Refused(REFUSAL),
            };
            let error = done.result.err().unwrap();
            assert_eq!((error.function, error.cause), (function_of(failing.call), cause), "{failure:?}");
            let unknown = matches!(failure, Answer::Failed(Failure::Timeout | Failure::Lost));
            let own = if unknown { failing.undo_unknown } else { "" };
            let before = expected[..at].iter().rev().map(|step| step.undo);
            let undo = core::iter::once(own).chain(before).filter(|call| !call.is_empty());
            let lost = matches!(failure, Answer::Failed(Failure::Lost | Failure::Closed));
            assert_eq!(error.undone, !lost || undo.clone().count() == 0, "{} {failure:?}", failing.call);
            let forward = expected[..=at].iter().map(|step| step.call);
            let calls: Vec<&str> = forward.chain(undo.filter(|_| !lost)).collect();
            assert_eq!(done.calls, calls, "{} {failure:?}", failing.call);
        }
        // a failure on the way back changes neither the rest of it nor the reported error
        let done = run(make(), |number, call, _| match number {
            _ if number == at => Answer::Failed(Failure::Timeout),
            _ if number > at => Answer::Refused(HResult::E_UNEXPECTED),
            _ => normal(call),
        });
        let own = failing.undo_unknown;
        let before = expected[..at].iter().rev().map(|step| step.undo);
        let undo = core::iter::once(own).chain(before).filter(|call| !call.is_empty()).count();
        assert_eq!(done.calls.len(), at + 1 + undo, "{}", failing.call);
        assert_eq!(done.result.err().map(|error| error.cause), Some(StepCause::Failed(Failure::Timeout)));
    }
}

const START: Expected = opens("Service_Start(\"WDT=400\")", "Service_Stop()");
const CONNECT: Expected =
    opens("Controller_Connect(\"\", \"CaoProv.DENSO.VRC9\", \"localhost\", \"\")", "Controller_Disconnect(7)");
const NAMES: Expected = step("Controller_GetRobotNames(7, \"\")");
const ROBOT: Expected = opens("Controller_GetRobot(7, \"Arm0\", \"\")", "Robot_Release(9)");
const LISTED: Expected = opens("Controller_GetRobot(7, \"Arm1\", \"\")", "Robot_Release(9)");

/// A controller with the handle 7 and robots of the names Arm1 and Arm2, which get the handle 9; variables get 11.
fn controller(call: &str) -> Answer {
    match call.split('(').next().unwrap() {
        "Controller_Connect" => Answer::value(&7),
        "Controller_GetRobotNames" => Answer::value(&["Arm1", "Arm2"]),
        "Controller_GetRobot" => Answer::value(&9),
        "Controller_GetVariable" | "Robot_GetVariable" => Answer::value(&11),
        "Variable_GetValue" => Answer::value(&42),
        _ => Answer::Empty,
    }
}

fn calls(expected: &[Expected]) -> Vec<&'static str> {
    expected.iter().map(|step| step.call).collect()
}

fn succeed<T>(procedure: impl Procedure<Output = T, Error = StepError>) -> (T, Vec<String>) {
    let done = run(procedure, |_, call, _| controller(call));
    (done.result.unwrap(), done.calls)
}

#[test]
fn a_session_is_opened_and_closed_again_after_any_failure() {
    assert_eq!(succeed(open(Provider::RC9)).1, calls(&[START, CONNECT]));
    assert_eq!(succeed(open(Provider::RC9)).0, ControllerHandle(7));
    fail_each(|| open(Provider::RC9), controller, &[START, CONNECT], |_| false);
    let provider = Provider { service: "", name: "n", provider: "P", machine: "m", option: "o" };
    assert_eq!(succeed(open(provider)).1, ["Service_Start(\"\")", "Controller_Connect(\"n\", \"P\", \"m\", \"o\")"]);
}

#[test]
fn a_robot_without_a_name_is_opened_by_the_name_of_the_samples() {
    let handles = Handles { controller: ControllerHandle(7), robot: RobotHandle(9) };
    let all = [START, CONNECT, ROBOT];
    let (opened, made) = succeed(open_robot(Provider::RC9, None));
    assert_eq!((opened, made), (handles, calls(&all).into_iter().map(String::from).collect()));
    fail_each(|| open_robot(Provider::RC9, None), controller, &all, |call| call.starts_with("Controller_GetRobot("));
    let named = [START, CONNECT, LISTED];
    assert_eq!(succeed(open_robot(Provider::RC9, Some("Arm1"))).1, calls(&named));
    fail_each(|| open_robot(Provider::RC9, Some("Arm1")), controller, &named, |_| false);
}

/// A controller without a robot Arm0.
fn refuses_arm0(call: &str) -> Answer {
    if call.contains("Arm0") { Answer::Refused(HResult::E_CAO_OBJECT_NOTFOUND) } else { controller(call) }
}

#[test]
fn a_controller_that_refuses_the_name_is_asked_for_its_list() {
    let done = run(open_robot(Provider::RC9, None), |_, call, _| refuses_arm0(call));
    assert_eq!(done.result.map(|handles| handles.robot), Ok(RobotHandle(9)));
    assert_eq!(done.calls, calls(&[START, CONNECT, step(ROBOT.call), NAMES, LISTED]));
    // in Slave Mode, and with an invalid handle, the list does not help
    for code in [HResult::E_SLVMODE_ON, HResult::E_HANDLE] {
        let done = run(open_robot(Provider::RC9, None), |_, call, _| match call.contains("Arm0") {
            true => Answer::Refused(code),
            false => controller(call),
        });
        assert_eq!(done.result.map_err(|error| error.cause), Err(StepCause::Refused(code)));
        assert!(!done.calls.iter().any(|call| call.contains("Names")), "{:?}", done.calls);
    }
}

/// Runs a procedure in which the call of this function is answered with another value; returns the error and the calls
/// after it.
fn with_wrong<T>(
    procedure: impl Procedure<Output = T, Error = StepError>,
    function: &str,
    answer: &Answer,
) -> (StepCause, Vec<String>) {
    let usual = if function.contains("Names") { refuses_arm0 } else { controller };
    let done = run(procedure, |_, call, _| if call.starts_with(function) { answer.clone() } else { usual(call) });
    let at = done.calls.iter().position(|call| call.starts_with(function)).unwrap();
    let error = done.result.err().unwrap();
    assert_eq!(error.function, function_of(&done.calls[at]));
    (error.cause, done.calls[at + 1..].to_vec())
}

#[test]
fn a_reply_of_another_type_is_an_error_and_what_was_opened_is_released() {
    let robot = || open_robot(Provider::RC9, None);
    let handle = |found| StepCause::Reply(ReplyError { expected: "a handle", found });
    let names = |found| StepCause::Reply(ReplyError { expected: "an array of names", found: Some(found) });
    let text = Answer::value(&"seven");
    assert_eq!(
        with_wrong(robot(), "Controller_Connect", &text),
        (handle(Some(VarType::BSTR)), vec!["Service_Stop()".into()])
    );
    let way_back: Vec<String> = vec!["Controller_Disconnect(7)".into(), "Service_Stop()".into()];
    assert_eq!(with_wrong(robot(), "Controller_GetRobot(", &Answer::Empty), (handle(None), way_back.clone()));
    let wrong_names: [(&dyn Encode, VarType); 3] = [
        (&"Arm0", VarType::BSTR),
        (&[1, 2], VarType::array_of(VarType::I4)),
        (&[""; 0], VarType::array_of(VarType::BSTR)),
    ];
    for (value, found) in wrong_names {
        let answer = Answer::value(value);
        assert_eq!(with_wrong(robot(), "Controller_GetRobotNames", &answer), (names(found), way_back.clone()));
    }
    let long = ["x"; 65].concat();
    let answer = Answer::value(&[long.as_str()]);
    assert_eq!(with_wrong(robot(), "Controller_GetRobotNames", &answer), (StepCause::TooLarge, way_back));
}

#[test]
fn a_path_is_opened_step_by_step() {
    let path = [PathStep { object: Object::Robot, name: None }, PathStep::variable("@SERVO_ON")];
    let make = || open_path(ControllerHandle(7), &path).unwrap();
    let expected = [ROBOT, opens("Robot_GetVariable(9, \"@SERVO_ON\", \"\")", "Variable_Release(11)")];
    let (opened, made) = succeed(make());
    assert_eq!(made, calls(&expected));
    assert_eq!(opened[..], [(Object::Robot, 9), (Object::Variable, 11)]);
    fail_each(make, controller, &expected, |call| call == ROBOT.call);

    let (_, released) = succeed(release(&opened));
    assert_eq!(released, ["Variable_Release(11)", "Robot_Release(9)"]);
}

#[test]
fn a_path_that_cannot_be_opened_is_refused_before_any_call() {
    let error = |owner: Owner, path: &[PathStep<'_>]| open_path(owner, path).err();
    let file = PathStep { object: Object::File, name: Some("a") };
    let robot = PathStep { object: Object::Robot, name: Some("Arm0") };
    assert_eq!(error(FileHandle(3).into(), &[file; PATH_MAX]), None);
    assert_eq!(error(FileHandle(3).into(), &[file; PATH_MAX + 1]), Some(PathError::TooLong));
    assert_eq!(
        error(RobotHandle(3).into(), &[robot]),
        Some(PathError::NoSuchObject { owner: Object::Robot, object: Object::Robot })
    );
    assert_eq!(
        error(ControllerHandle(3).into(), &[robot, file]),
        Some(PathError::NoSuchObject { owner: Object::Robot, object: Object::File })
    );
    let nameless = PathStep { object: Object::Variable, name: None };
    assert_eq!(error(ControllerHandle(3).into(), &[nameless]), Some(PathError::NoName(Object::Variable)));
    assert_eq!(
        error(ControllerHandle(3).into(), &[nameless]).unwrap().to_string(),
        "an object of the kind Variable needs a name"
    );
    // the deepest path opens and is released
    let done =
        run(open_path(FileHandle(3), &[file; PATH_MAX]).unwrap(), |number, _, _| Answer::value(&(number as i32)));
    let opened = done.result.unwrap();
    assert_eq!((opened.len(), done.calls.len()), (PATH_MAX, PATH_MAX));
    assert_eq!(succeed(release(&opened)).1.len(), PATH_MAX);
}

#[test]
fn objects_are_released_in_reverse_order_even_if_the_controller_refuses() {
    let handles = Handles { controller: ControllerHandle(7), robot: RobotHandle(9) };
    let all = ["Robot_Release(9)", "Controller_Disconnect(7)", "Service_Stop()"];
    assert_eq!(succeed(release_robot(handles)).1, all);
    assert_eq!(succeed(release_controller(ControllerHandle(7))).1, all[1..]);
    for answer in [
        Answer::Refused(HResult::E_HANDLE),
        Answer::Failed(Failure::Timeout),
        Answer::Failed(Failure::NotSent),
        Answer::value(&"a value that it should not carry"),
    ] {
        let done = run(release_robot(handles), |_, _, _| answer.clone());
        assert_eq!((done.result, done.calls), (Ok(()), all.map(String::from).to_vec()), "{answer:?}");
    }
    let done = run(release_robot(handles), |_, _, _| Answer::Failed(Failure::Lost));
    assert_eq!((done.result, done.calls), (Ok(()), all[..1].iter().copied().map(String::from).collect()));
}

const VARIABLE: Expected = opens("Controller_GetVariable(7, \"I1\", \"\")", "Variable_Release(11)");

#[test]
fn a_variable_is_read_and_its_handle_released() {
    let make = || read_variable(ControllerHandle(7), "I1", |value| value.as_i32()).unwrap();
    let expected = [VARIABLE, step("Variable_GetValue(11)")];
    let (value, made) = succeed(make());
    assert_eq!(value, Some(42));
    assert_eq!(made, ["Controller_GetVariable(7, \"I1\", \"\")", "Variable_GetValue(11)", "Variable_Release(11)"]);
    fail_each(make, controller, &expected, |_| false);
    // a reply without a value stands for EMPTY
    let read = read_variable(RobotHandle(9), "@X", |value| value.is_empty()).unwrap();
    let done = run(read, |_, call, _| if call.contains("GetValue") { Answer::Empty } else { controller(call) });
    assert_eq!(done.result, Ok(true));
    // the value is returned even if the release fails
    for answer in [Answer::Refused(HResult::E_HANDLE), Answer::Failed(Failure::Lost)] {
        let done = run(make(), |_, call, _| if call.contains("Release") { answer.clone() } else { controller(call) });
        assert_eq!(done.result, Ok(Some(42)), "{answer:?}");
    }
    let owner = Owner::from(FileHandle(3));
    assert!(read_variable(owner, "V", |value| value.is_empty()).is_ok());
}

#[test]
fn a_variable_is_written_once_and_its_handle_released() {
    let make = || write_variable(ControllerHandle(7), "I1", &5_i32).unwrap();
    let expected = [VARIABLE, step("Variable_PutValue(11, 5)")];
    assert_eq!(
        succeed(make()).1,
        ["Controller_GetVariable(7, \"I1\", \"\")", "Variable_PutValue(11, 5)", "Variable_Release(11)"]
    );
    fail_each(make, controller, &expected, |_| false);
}

const TAKE: Expected = Expected {
    call: "Robot_Execute(9, \"TakeArm\", I4[0, 1])",
    undo: "Robot_Execute(9, \"GiveArm\", EMPTY)",
    undo_unknown: "Robot_Execute(9, \"GiveArm\", EMPTY)",
};

#[test]
fn a_robot_is_prepared_and_the_arm_given_back_after_a_failure() {
    let make = |motor| prepare_robot(RobotHandle(9), [0, 1], motor);
    let motor = Expected {
        call: "Robot_Execute(9, \"Motor\", I4[1, 0])",
        undo: "",
        undo_unknown: "Robot_Execute(9, \"Motor\", I4[0, 0])",
    };
    assert_eq!(succeed(make(true)).1, calls(&[TAKE, motor]));
    assert_eq!(succeed(make(false)).1, calls(&[TAKE]));
    fail_each(|| make(true), controller, &[TAKE, motor], |_| false);
    assert_eq!(succeed(give_arm(RobotHandle(9))).1, [TAKE.undo]);
    fail_each(|| give_arm(RobotHandle(9)), controller, &[step(TAKE.undo)], |_| false);
}

#[test]
fn a_run_that_was_dropped_undoes_what_it_did() {
    // the loops pass in Timeout for the call that was in flight
    let mut procedure = open_robot(Provider::RC9, Some("Arm1"));
    let mut calls = Vec::new();
    for answer in [controller("Service_Start("), controller("Controller_Connect(")] {
        assert!(matches!(procedure.poll(Instant::ZERO), Action::Call(Channel::Motion)));
        hand_in(&mut procedure, &answer, Instant::ZERO);
    }
    assert!(matches!(procedure.poll(Instant::ZERO), Action::Call(Channel::Motion)));
    procedure.handle_failure(Failure::Timeout, Instant::ZERO);
    let done = run(&mut procedure, |_, call, _| {
        calls.push(call.to_string());
        Answer::Empty
    });
    assert_eq!(calls, ["Controller_Disconnect(7)", "Service_Stop()"]);
    let cause = StepCause::Failed(Failure::Timeout);
    assert_eq!(
        done.result.err(),
        Some(StepError { function: FunctionId::CONTROLLER_GET_ROBOT, cause, undone: true, unsettled: false })
    );
    // an unexpected reply changes nothing
    hand_in(&mut procedure, &Answer::value(&1), Instant::ZERO);
    assert!(procedure.request().is_none());
}

#[test]
fn errors_say_which_call_failed_and_why() {
    let error =
        |cause| StepError { function: FunctionId::ROBOT_MOVE, cause, undone: true, unsettled: false }.to_string();
    assert_eq!(error(StepCause::Failed(Failure::Timeout)), "Robot_Move: no reply in time");
    assert_eq!(error(StepCause::Failed(Failure::NotSent)), "Robot_Move: could not be sent");
    assert_eq!(error(StepCause::Failed(Failure::Lost)), "Robot_Move: the connection is lost");
    let closed = "Robot_Move: the connection was lost before the call was sent";
    assert_eq!(error(StepCause::Failed(Failure::Closed)), closed);
    assert_eq!(error(StepCause::TooLarge), "Robot_Move: the reply is longer than expected");
    assert!(error(StepCause::Refused(HResult::E_MOTOR_OFF)).contains("E_MOTOR_OFF"));
    let cause = StepCause::Refused(HResult::E_MOTOR_OFF);
    let refused = StepError { function: FunctionId::ROBOT_MOVE, cause, undone: true, unsettled: false };
    assert_eq!(refused.hresult(), Some(HResult::E_MOTOR_OFF));
}
