//! A call that Slave Mode refuses ends Slave Mode.

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;

use crate::common::{Client, Reply, code, ok};
use crate::slave::{Rig, START};

/// A stream in mode 0x202, and a second client.
fn streaming() -> (Rig, Client) {
    let mut rig = Rig::new();
    let other = rig.world.client(2);
    assert_eq!(rig.execute("slvChangeMode", 0x202), ok(&()));
    (rig, other)
}

fn assert_ended(rig: &mut Rig, answer: Reply, what: &str) {
    assert_eq!(answer, code(HResult::E_SLVMODE_ON), "{what}");
    assert_eq!(rig.mode(), 0, "{what}");
    assert_eq!(rig.errors(), [HResult::E_SLVMODE_ON], "{what}");
    assert!(!rig.world.sim.is_moving(), "{what}");
    assert_eq!(rig.j1(0.0), HResult::E_SLVMODE_OFF, "{what}");
    assert_eq!(rig.errors(), [HResult::E_SLVMODE_OFF, HResult::E_SLVMODE_ON], "{what}");
    assert_eq!(rig.j1(0.0), HResult::E_SLVMODE_OFF, "{what}");
    assert_eq!(rig.errors().len(), 2, "the list has each code once: {what}");
}

#[test]
fn a_refused_call_of_any_client_ends_slave_mode() {
    for command in ["GetCurErrorCount", "GetCurErrorInfo", "SysState", "ClearError", "HandCurPos", "NoSuchCommand"] {
        for is_own in [true, false] {
            let (mut rig, other) = streaming();
            let client = if is_own { rig.client } else { other };
            let answer = rig.world.execute(client, command, ());
            assert_ended(&mut rig, answer, command);
        }
    }
    for command in ["TakeArm", "Motor", "ExtSpeed", "SetToolDef"] {
        let (mut rig, other) = streaming();
        let answer = rig.world.robot(other, command, 0);
        assert_ended(&mut rig, answer, command);
    }
    let (mut rig, other) = streaming();
    let answer = rig.world.call(other.peer, call::controller_get_task_names(other.controller, ""));
    assert_ended(&mut rig, answer, "Controller_GetTaskNames");
    let (mut rig, other) = streaming();
    let answer = rig.world.call(other.peer, call::controller_get_name(other.controller));
    assert_ended(&mut rig, answer, "Controller_GetName");
}

#[test]
fn allowed_calls_of_any_client_leave_slave_mode_on() {
    let (mut rig, other) = streaming();
    for client in [rig.client, other] {
        for command in ["CurJnt", "CurPos", "CurTool", "slvGetMode"] {
            assert_eq!(rig.world.robot(client, command, ()).0, HResult::S_OK, "{command}");
        }
        assert_eq!(rig.world.get(client, "@ERROR_CODE"), ok(&0));
        assert_eq!(rig.world.get(client, "I1"), ok(&0));
    }
    let late = rig.world.client(3);
    assert_eq!(rig.world.robot(late, "slvGetMode", ()), ok(&0x202));
    rig.world.call(late.peer, call::robot_release(late.robot));
    rig.world.call(late.peer, call::controller_disconnect(late.controller));
    assert_eq!((rig.mode(), rig.errors()), (0x202, vec![]));
    assert_eq!(rig.j1(0.0), HResult::S_OK);
}

#[test]
fn halt_and_an_unknown_handle_are_no_refusals_of_slave_mode() {
    let (mut rig, other) = streaming();
    let unknown = rig.world.call(other.peer, call::controller_get_name(call::ControllerHandle(0x5a17)));
    assert_eq!((unknown, rig.mode()), (code(HResult::E_HANDLE), 0x202));
    assert_eq!(rig.world.call(other.peer, call::robot_halt(other.robot, "")), code(HResult::S_OK));
    assert_eq!((rig.mode(), rig.errors()), (0, vec![]));
}

#[test]
fn recovery_is_clear_error_and_the_usual_order() {
    let (mut rig, other) = streaming();
    rig.world.execute(other, "SysState", ());
    assert_eq!(rig.execute("slvChangeMode", 0x202), code(HResult::E_ERROR_PRESENT));
    let client = rig.client;
    assert_eq!(rig.world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(rig.world.robot(client, "Motor", 1), ok(&()));
    assert_eq!(rig.execute("slvChangeMode", 0x202), ok(&()));
    assert_eq!(rig.slv_move(START).0, HResult::S_OK);
}
