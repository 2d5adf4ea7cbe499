//! The three modes and their buffers.

use bcap_core::bcap::server::Handler as _;
use bcap_core::handler::Outcome;
use bcap_core::hresult::HResult;
use bcap_sim::slave::CYCLE;

use crate::common::{code, doubles, ok, value};
use crate::slave::{Rig, START, assert_close, j1};

#[test]
fn mode_0_tells_when_the_buffer_is_full_and_stores_nothing_more() {
    let mut rig = Rig::enter(0x002);
    assert_eq!(rig.slv_move(j1(0.1)), ok(&START), "the answer is where the robot is");
    assert_eq!(rig.j1(0.2), HResult::S_OK);
    // the third fills it, and has a value as well
    assert_eq!(rig.slv_move(j1(0.3)), (HResult::S_BUF_FULL, value(&START)));
    assert_eq!(rig.slv_move(j1(9.0)), code(HResult::E_BUF_FULL), "no value");
    assert_eq!(rig.world.sim.slave_counters().refused, 1);
    // each cycle takes one out
    rig.cycles(1);
    assert_eq!(rig.j1(0.4), HResult::S_BUF_FULL);
    assert_eq!(rig.j1(9.0), HResult::E_BUF_FULL);
    rig.cycles(2);
    assert_eq!((rig.j1(0.5), rig.j1(0.5), rig.j1(9.0)), (HResult::S_OK, HResult::S_BUF_FULL, HResult::E_BUF_FULL));
    rig.cycles(5);
    assert_close(&rig.here(), &j1(0.5), 1e-12);
    assert_eq!((rig.mode(), rig.errors()), (0x002, vec![]));
    let taken: Vec<_> = rig.world.sim.slave_record().map(|c| (c.cycle, c.took, c.axes[0])).collect();
    let expected = [(1, true, 0.1), (2, true, 0.2), (3, true, 0.3), (4, true, 0.4), (5, true, 0.5), (6, true, 0.5)];
    assert_eq!(taken, expected);
    assert!(!rig.world.sim.error_log().any(|e| e.code == HResult::E_BUF_FULL), "no error of the controller");
}

#[test]
fn mode_1_takes_the_newest_of_each_cycle() {
    let mut rig = Rig::enter(0x102);
    for angle in [0.05, 9.0, 90.0, 0.1] {
        assert_eq!(rig.slv_move(j1(angle)), ok(&START));
    }
    rig.cycles(2);
    assert_close(&rig.here(), &j1(0.1), 1e-12);
    let counters = rig.world.sim.slave_counters();
    assert_eq!((counters.cycles, counters.taken, counters.held, counters.overwritten), (2, 1, 1, 3));
    assert_eq!(counters.refused + counters.withheld + counters.underflows, 0);
}

#[test]
fn mode_2_answers_when_the_pose_is_stored() {
    let mut rig = Rig::enter(0x202);
    let entered = rig.world.now;
    for angle in [0.1, 0.2, 0.3] {
        assert_eq!(rig.slv_move(j1(angle)), ok(&START));
    }
    // the fourth waits for the next cycle, which begins 8 ms after slave mode was entered
    rig.world.pass(3);
    assert_eq!(rig.withheld(j1(0.4)), entered + CYCLE);
    rig.world.pass(4);
    assert_eq!(rig.again(j1(0.4)).0, Outcome::Wait(entered + CYCLE));
    rig.world.pass(1);
    assert_eq!(rig.again(j1(0.4)), (Outcome::Done(HResult::S_OK), value(&START)));
    // the buffer is full again
    assert_eq!(rig.withheld(j1(0.4)), entered + CYCLE * 2);
    // polled late, it answers with the position of the robot at that time
    rig.world.pass(12);
    let (outcome, answer) = rig.again(j1(0.4));
    assert_eq!(outcome, Outcome::Done(HResult::S_OK));
    assert_close(&doubles(&answer), &j1(0.15), 1e-12);
    assert_eq!(rig.world.sim.slave_counters().withheld, 2);
    rig.cycles(10);
    assert_eq!((rig.mode(), rig.errors(), rig.here()[0]), (0x202, vec![], 0.4));
}

#[test]
fn a_withheld_pose_is_dropped_when_no_call_waits_for_it() {
    let mut rig = Rig::enter(0x202);
    for angle in [0.1, 0.2, 0.2] {
        assert_eq!(rig.j1(angle), HResult::S_OK);
    }
    rig.withheld(j1(0.3));
    rig.world.sim.abandoned(rig.client.peer, rig.world.now);
    rig.cycles(10);
    assert_eq!((rig.here()[0], rig.errors()), (0.2, vec![]));
}

#[test]
fn the_axes_move_evenly_from_pose_to_pose() {
    let mut rig = Rig::enter(0x002);
    rig.j1(0.4);
    rig.j1(0.8);
    rig.j1(0.8);
    let mut way = Vec::new();
    for _ in 0..14 {
        rig.world.pass(2);
        way.push((rig.here()[0] * 1000.0).round() / 1000.0);
    }
    assert_eq!(way, [0.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.8, 0.8]);
    assert!(!rig.world.sim.is_moving());
}
