//! Leaving: the buffer is emptied, then the call is answered.

use bcap_core::bcap::call;
use bcap_core::bcap::server::Handler as _;
use bcap_core::handler::Outcome;
use bcap_core::hresult::HResult;
use bcap_sim::slave::CYCLE;

use crate::common::ok;
use crate::slave::{Rig, assert_close, j1, limit, moving};

#[test]
fn leaving_does_what_is_buffered_and_then_answers() {
    let mut rig = Rig::enter(0x002);
    let entered = rig.world.now;
    for angle in [0.2, 0.4, 0.4] {
        rig.j1(angle);
    }
    let client = rig.client;
    let leave = call::robot_execute(client.robot, "slvChangeMode", 0);
    let (outcome, _) = rig.world.poll(client.peer, &leave, false);
    assert_eq!(outcome, Outcome::Wait(entered + CYCLE));
    assert_eq!(rig.mode(), 0x002, "not yet");
    assert_eq!(rig.world.run_again(client.peer, &leave), ok(&()));
    // three cycles begin; the third does not move
    assert_eq!(rig.world.now, entered + CYCLE * 3);
    assert_eq!((rig.mode(), rig.here()[0], rig.errors()), (0, 0.4, vec![]));
}

#[test]
fn leaving_without_a_stop_stops_at_the_last_pose_if_that_is_not_too_hard() {
    let mut rig = moving(0x002);
    assert_eq!(rig.world.robot(rig.client, "slvChangeMode", 0), ok(&()));
    assert_close(&rig.here(), &j1(0.6), 1e-12);
    assert_eq!((rig.mode(), rig.errors()), (0, vec![]));

    let mut rig = Rig::enter(0x002);
    for angle in [0.4, 1.2, 2.0] {
        rig.j1(angle);
    }
    assert_eq!(rig.world.robot(rig.client, "slvChangeMode", 0).0, limit(0x8420_4040, 1));
    assert_eq!((rig.mode(), rig.errors()), (0, vec![limit(0x8420_4040, 1)]));
}

#[test]
fn slv_move_while_leaving_comes_too_late() {
    let mut rig = moving(0x002);
    let leave = call::robot_execute(rig.client.robot, "slvChangeMode", 0);
    rig.world.begin(rig.client.peer, &leave);
    rig.world.sim.abandoned(rig.client.peer, rig.world.now);
    assert_eq!(rig.j1(0.8), HResult::E_SLVMODE_OFF);
    rig.cycles(3);
    assert_eq!((rig.mode(), rig.errors()), (0, vec![HResult::E_SLVMODE_OFF]));
}
