//! The diagnosis of a fault.

use super::*;

#[test]
fn an_underflow_is_reported_by_its_first_cause() {
    for (mode, watch) in [(Mode::Mode0, None), (Mode::Mode2, Some(WATCH))] {
        let late = |rig: &mut Rig| rig.now = rig.now + Duration::from_millis(60);
        let rig = disturbed(Config { watch, ..config(mode) }, 30, late);
        let fault = rig.fault();
        // the reply to slvMove only says that Slave Mode is off
        assert_eq!((fault.step, fault.cause), (Step::Move, Cause::Refused(HResult::E_SLVMODE_OFF)));
        assert_eq!(fault.code(), Some(HResult::E_COMMAND_BUFFER_EMPTY));
        assert_eq!(fault.errors()[0].text(), "Position command buffer is empty");
        assert_eq!((fault.released, fault.emergency_stop), (Released::Yes, Some(false)));
        assert!(fault.to_string().contains("0x84201482 (E_COMMAND_BUFFER_EMPTY) Position command"), "{fault}");
        assert_eq!((rig.engine.stats().underflows, rig.engine.stats().late), (1, 1));
        // the errors are read over the second connection, if there is one
        let channel = if watch.is_some() { Channel::Watch } else { Channel::Motion };
        assert!(rig.controller.log.contains(&(channel, "GetCurErrorInfo".into())));
        assert!(rig.controller.log.contains(&(Channel::Motion, "slvGetMode".into())));
        assert!(!rig.controller.log.iter().any(|(_, name)| name == "ClearError"));
    }
}

/// A text that does not fit.
const LONG: &str = concat!(
    "J3 command accel limit over, J3 command accel limit over, J3 command accel limit over, ",
    "J3 command accel limit over, J3 command accel limit over, J3 command accel limit over"
);

#[test]
fn the_oldest_errors_are_read_first_up_to_the_maximum() {
    let rig = disturbed(config(Mode::Mode2), 10, |rig| {
        rig.controller.fail(HResult::from_u32(0x8420_4043), LONG);
        for _ in 0..6 {
            rig.controller.fail(HResult::E_COMMAND_BUFFER_EMPTY, "");
        }
    });
    let fault = rig.fault();
    assert_eq!(fault.errors().len(), ERRORS_MAX);
    assert_eq!(fault.code().and_then(HResult::axis), Some(3));
    let text = fault.errors()[0].text();
    assert!(text.starts_with("J3 command accel limit over, J3") && text.ends_with('…') && text.len() >= 158, "{text}");
    assert_eq!(rig.names().iter().filter(|name| **name == "GetCurErrorInfo").count(), ERRORS_MAX);
}

#[test]
fn a_lost_connection_is_diagnosed_over_the_other_one() {
    let mut rig = Rig::new(Config { watch: Some(WATCH), ..config(Mode::Mode0) }, &[0.0; 8]);
    rig.failures.push((20, Failure::Lost));
    rig.fault_at(0, |_| {});
    let fault = rig.fault();
    assert_eq!((fault.cause, fault.released), (Cause::Failed(Failure::Lost), Released::Yes));
    let after: Vec<_> = rig.controller.log.iter().skip_while(|(channel, _)| *channel == Channel::Motion).collect();
    assert!(after.iter().all(|(channel, _)| *channel == Channel::Watch));
    assert_eq!(after[0].1, "slvGetMode");
    assert_eq!(after[1].1, "slvChangeMode");
    assert_eq!(rig.engine.recover(), Err(RecoverError::Lost));
    // the motor stays on, and the arm taken
    rig.engine.stop();
    assert_eq!(rig.engine.poll(rig.now), EngineAction::Faulted);
}

#[test]
fn without_a_connection_the_state_is_unknown() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    rig.failures.push((20, Failure::Lost));
    assert_eq!(rig.run(trajectory(100)), EngineAction::Faulted);
    let fault = rig.fault();
    assert_eq!((fault.released, fault.emergency_stop, fault.code()), (Released::Unknown, None, None));
    assert_eq!(fault.to_string(), "slvMove: the connection is lost");
    let effects = rig.engine.effects();
    assert!(effects.moving && effects.streaming);
    rig.engine.stop();
    assert_eq!((rig.engine.poll(rig.now), rig.engine.effects()), (EngineAction::Faulted, effects));
}

#[test]
fn a_call_without_a_reply_ends_slave_mode() {
    let mut rig = Rig::new(config(Mode::Mode1), &[0.0; 8]);
    rig.failures.push((20, Failure::Timeout));
    assert_eq!(rig.run(trajectory(100)), EngineAction::Faulted);
    let fault = rig.fault();
    assert_eq!((fault.cause, fault.released), (Cause::Failed(Failure::Timeout), Released::Yes));
    assert_eq!(rig.controller.mode, 0);
    assert_eq!(rig.names()[7..9], ["slvGetMode", "slvChangeMode"]);
    assert_eq!(rig.moves, 20);
}

#[test]
fn a_reply_of_another_format_ends_the_stream() {
    let mut rig = Rig::new(config(Mode::Mode0), &[0.0; 8]);
    rig.controller.script.push(("slvMove", ok(&[0.0; 7])));
    assert_eq!(rig.run(trajectory(10)), EngineAction::Faulted);
    let kind = MoveReplyErrorKind::Length { expected: 8, found: 7 };
    assert_eq!(rig.fault().cause, Cause::Reply(MoveReplyError { part: ReplyPart::Pose, kind }));
    assert_eq!((rig.controller.mode, rig.moves), (0, 1));
}
