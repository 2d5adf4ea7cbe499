//! `reclaim` on a robot that another client uses, and on a free one.

use super::*;

const ROBOT: RobotHandle = RobotHandle(9);
const MODE: &str = "Robot_Execute(9, \"slvGetMode\", EMPTY)";
const LEAVE: &str = "Robot_Execute(9, \"slvChangeMode\", 0)";
const TAKE: &str = "Robot_Execute(9, \"TakeArm\", I4[0, 1])";
const HALT: &str = "Robot_Halt(9, \"\")";
const OFF: &str = "Robot_Execute(9, \"Motor\", I4[0, 0])";
const GIVE: &str = "Robot_Execute(9, \"GiveArm\", EMPTY)";

const DESTINATION: &str = "Robot_Execute(9, \"DestJnt\", EMPTY)";

const ALL: Effects = Effects { moving: true, destination: None, streaming: true, motor: true, claim: Claim::Unknown };
const MOVED: Effects = Effects { streaming: false, ..ALL };
const MOTOR: Effects = Effects { moving: false, ..MOVED };

/// Runs it while the mode is `mode` and the call `refused` has this answer.
fn reclaimed(effects: Effects, mode: i32, refused: (&str, HResult)) -> Run<Reclaimed> {
    run(reclaim(ROBOT, effects), |_, call, _| match call {
        _ if call == refused.0 => Answer::Refused(refused.1),
        MODE => Answer::value(&mode),
        _ => Answer::Empty,
    })
}

const NONE: (&str, HResult) = ("", HResult::S_OK);

fn strings(calls: &[&str]) -> Vec<String> {
    calls.iter().map(ToString::to_string).collect()
}

#[test]
fn a_free_arm_is_taken_before_the_robot_is_halted() {
    for (effects, off) in [(MOVED, Some(true)), (Effects { motor: false, ..MOVED }, None), (MOTOR, Some(true))] {
        let done = reclaimed(effects, 0, NONE);
        let expected = Reclaimed { owner: ArmOwner::Free, halted: Some(true), motor_off: off };
        assert_eq!(done.result, Ok(expected));
        let calls = [MODE, TAKE, HALT].into_iter().chain(off.map(|_| OFF)).chain([GIVE]);
        assert_eq!(done.calls, calls.collect::<Vec<_>>());
    }
}

#[test]
fn a_robot_of_another_client_is_left_alone() {
    let other = Reclaimed { owner: ArmOwner::Other, halted: None, motor_off: None };
    let done = reclaimed(MOVED, 0, (TAKE, HResult::E_ARM_NOT_TAKEN));
    assert_eq!((done.result, done.calls), (Ok(other), vec![MODE.to_string(), TAKE.to_string()]));
    // a task owns the arm, so the motion is not the silent session's either
    for claim in [Claim::Unknown, Claim::Silent] {
        let done = reclaimed(Effects { claim, ..MOVED }, 0, (TAKE, HResult::from_u32(0x8350_0079)));
        assert_eq!((done.result, done.calls), (Ok(other), vec![MODE.to_string(), TAKE.to_string()]), "{claim:?}");
    }
    // TakeArm would end its stream
    let done = reclaimed(ALL, 0x102, NONE);
    assert_eq!((done.result, done.calls), (Ok(other), vec![MODE.to_string()]));
}

#[test]
fn a_session_that_still_owns_the_arm_is_not_asked_for_it() {
    let ended = Reclaimed { owner: ArmOwner::Unknown, halted: Some(true), motor_off: Some(true) };
    let done = reclaimed(Effects { claim: Claim::Lost, ..MOVED }, 0, NONE);
    assert_eq!((done.result, done.calls.as_slice()), (Ok(ended), [MODE, HALT, OFF].map(String::from).as_slice()));
    let done = reclaimed(Effects { claim: Claim::Lost, ..ALL }, 0x102, (LEAVE, HResult::E_ARM_NOT_TAKEN));
    assert_eq!(
        (done.result, done.calls.as_slice()),
        (Ok(ended), [MODE, LEAVE, HALT, OFF].map(String::from).as_slice())
    );
    let done = reclaimed(Effects { claim: Claim::Lost, ..MOTOR }, 0, NONE);
    assert_eq!(done.calls, [MODE, OFF]);
    // a session without a stream has not started the running stream
    let done = reclaimed(Effects { claim: Claim::Lost, ..MOVED }, 0x102, NONE);
    assert_eq!(done.calls, [MODE]);
}

/// After a long silence the lost session may still own the arm, which a refused TakeArm does not reveal.
#[test]
fn a_motion_that_may_be_the_silent_sessions_is_halted() {
    let to = |first: f64| Target::joints(Joints::new([first, 45.0, 90.0, 0.0, 45.0, 0.0]), 6);
    let other = Reclaimed { owner: ArmOwner::Other, halted: None, motor_off: None };
    let halted = Reclaimed { owner: ArmOwner::Unknown, halted: Some(true), motor_off: None };
    let silent = Effects { claim: Claim::Silent, ..MOVED };
    let dest = |answer: Option<[f64; 8]>, effects: Effects| {
        let done = run(reclaim(ROBOT, effects), |_, call, _| match (call, answer) {
            (MODE, _) => Answer::value(&0),
            (TAKE, _) => Answer::Refused(HResult::E_ARM_NOT_TAKEN),
            (DESTINATION, Some(joints)) => Answer::value(&joints),
            (DESTINATION, None) => Answer::Refused(HResult::E_FAIL),
            _ => Answer::Empty,
        });
        (done.result.unwrap(), done.calls[2..].to_vec())
    };
    let at = [60.01, 45.0, 90.0, 0.0, 45.0, 0.0, 7.0, 8.0];
    let calls = strings;
    let known = |first: f64| Effects { destination: Some(to(first)), ..silent };
    // the same destination proves whose motion it is
    let ours = Reclaimed { motor_off: Some(true), ..halted };
    assert_eq!(dest(Some(at), known(60.0)), (ours, calls(&[DESTINATION, HALT, OFF])));
    assert_eq!(dest(Some(at), known(61.0)), (other, calls(&[DESTINATION])));
    // it is unclear whose motion it is
    assert_eq!(dest(None, known(60.0)), (halted, calls(&[DESTINATION, HALT])));
    assert_eq!(dest(Some([f64::NAN; 8]), known(60.0)), (halted, calls(&[DESTINATION, HALT])));
    for destination in [None, Some(Target::UNKNOWN), Some(Target::drive_by(Joints::new([60.0])))] {
        assert_eq!(dest(Some(at), Effects { destination, ..silent }), (halted, calls(&[HALT])));
    }
    // without a motion nothing is done, nor after the controller has ended the session
    assert_eq!(dest(Some(at), Effects { moving: false, ..known(60.0) }), (other, vec![]));
    assert_eq!(dest(Some(at), Effects { claim: Claim::Unknown, ..known(60.0) }), (other, vec![]));
    // a stream that runs now is another client's, and a free arm is taken as after any loss
    assert_eq!(reclaimed(Effects { claim: Claim::Silent, ..ALL }, 0x102, NONE).calls, [MODE]);
    assert_eq!(reclaimed(silent, 0, NONE).calls, [MODE, TAKE, HALT, OFF, GIVE]);
}

#[test]
fn a_refusal_keeps_nothing_moving() {
    let done = reclaimed(MOVED, 0, (TAKE, HResult::E_ERROR_PRESENT));
    assert_eq!(done.calls, [MODE, TAKE, HALT, OFF]);
    assert_eq!(done.result.unwrap().owner, ArmOwner::Unknown);
    let done = reclaimed(MOTOR, 0, (TAKE, HResult::E_ERROR_PRESENT));
    assert_eq!(done.calls, [MODE, TAKE, OFF]);
    let done = reclaimed(MOVED, 0, (HALT, HResult::E_FAIL));
    assert_eq!(done.calls, [MODE, TAKE, HALT, OFF, GIVE]);
    assert_eq!(done.result, Ok(Reclaimed { owner: ArmOwner::Free, halted: Some(false), motor_off: Some(true) }));
    let done = reclaimed(MOVED, 0, (GIVE, HResult::E_FAIL));
    assert_eq!(done.result.unwrap().owner, ArmOwner::Unknown);
    // another client was seen to own the arm, and the refused question has left the error
    let done = reclaimed(Effects { claim: Claim::Other, ..MOVED }, 0, (TAKE, HResult::E_ERROR_PRESENT));
    assert_eq!(done.calls, [MODE, TAKE]);
    // a stream may run
    let done = reclaimed(ALL, 0, (MODE, HResult::E_FAIL));
    assert_eq!(done.calls, [MODE, HALT]);
}

/// E_TIMEOUT: the controller has abandoned TakeArm, and may still execute it.
#[test]
fn an_arm_that_may_be_taken_later_is_given_back() {
    let given_up = (TAKE, HResult::E_TIMEOUT);
    let other = Effects { claim: Claim::Other, ..MOVED };
    for (effects, calls) in
        [(MOVED, &[MODE, TAKE, HALT, OFF, GIVE][..]), (MOTOR, &[MODE, TAKE, OFF, GIVE]), (other, &[MODE, TAKE, GIVE])]
    {
        let done = reclaimed(effects, 0, given_up);
        assert_eq!((done.result.unwrap().owner, done.calls), (ArmOwner::Free, strings(calls)));
    }
    // even if a later call gets no reply
    let done = run(reclaim(ROBOT, MOVED), |_, call, _| match call {
        MODE => Answer::value(&0),
        TAKE => Answer::Refused(HResult::E_TIMEOUT),
        HALT => Answer::Failed(Failure::Timeout),
        _ => Answer::Empty,
    });
    assert_eq!((done.result.is_err(), done.calls), (true, strings(&[MODE, TAKE, HALT, GIVE])));
}

#[test]
fn calls_are_repeated_while_the_controller_is_busy() {
    // it executes the Motor of the lost session for 300 ms
    let Run { result, mut calls, .. } = run(reclaim(ROBOT, MOTOR), |_, call, now| match call {
        _ if now < Instant::from_millis(300) => Answer::Refused(HResult::E_BUSY_PROC),
        MODE => Answer::value(&0),
        _ => Answer::Empty,
    });
    calls.dedup();
    let ended = Reclaimed { owner: ArmOwner::Free, halted: Some(true), motor_off: Some(true) };
    assert_eq!((result, calls), (Ok(ended), strings(&[MODE, TAKE, HALT, OFF, GIVE])));
    // for a limited time
    let done = run(reclaim(ROBOT, MOTOR), |_, _, _| Answer::Refused(HResult::E_BUSY_PROC));
    let unknown = Reclaimed { owner: ArmOwner::Unknown, halted: None, motor_off: None };
    assert_eq!(done.result, Ok(unknown));
    assert!((4900..5100).contains(&(done.now.as_micros() / 1000)), "{:?}", done.now);
}

#[test]
fn each_failure_gives_the_arm_back_and_says_whether_something_was_done() {
    let calls = [MODE, TAKE, HALT, OFF, GIVE];
    for (at, call) in calls.into_iter().enumerate() {
        for failure in [Failure::Timeout, Failure::NotSent, Failure::Lost, Failure::Closed] {
            let done = run(reclaim(ROBOT, MOVED), |number, call, _| match call {
                _ if number == at => Answer::Failed(failure),
                MODE => Answer::value(&0),
                _ => Answer::Empty,
            });
            let error = done.result.err().unwrap();
            assert_eq!((error.function, error.cause), (function_of(call), StepCause::Failed(failure)));
            let lost = matches!(failure, Failure::Lost | Failure::Closed);
            let sent = matches!(failure, Failure::Lost | Failure::Timeout);
            let gives = !lost && (at > 1 || (at == 1 && sent));
            assert_eq!(done.calls.last().unwrap() == GIVE, gives || at == 4, "{call} {failure:?}");
            let was_taken = at > 1 || (at == 1 && sent);
            assert_eq!(error.had_no_effect(), !sent && at < 3 && !(lost && was_taken), "{call} {failure:?}");
        }
    }
}
