//! Underflow: the six rows of the specification's table.

use bcap_core::hresult::HResult;

use crate::slave::{Rig, UNDERFLOW, limit};

#[test]
fn modes_0_and_2_underflow_in_motion_and_are_released() {
    for mode in [0x002, 0x202] {
        let mut rig = Rig::enter(mode);
        rig.j1(0.1);
        rig.j1(0.2);
        rig.cycles(2);
        assert!(rig.world.sim.is_moving());
        assert_eq!((rig.mode(), rig.errors()), (mode, vec![]), "the second is being moved to");
        rig.cycles(1);
        assert_eq!((rig.mode(), rig.errors()), (0, vec![UNDERFLOW]), "{mode:#x}");
        assert_eq!(rig.world.sim.slave_counters().underflows, 1);
        assert!(!rig.world.sim.is_moving() && !rig.world.sim.motor_is_on());
        assert_eq!(rig.here()[0], 0.2, "it stands where the last pose was");
        let at = rig.world.sim.errors().next().unwrap().at;
        assert_eq!(at, rig.world.now, "noticed in the third cycle");
    }
}

#[test]
fn modes_0_and_2_keep_still_without_poses() {
    for mode in [0x002, 0x202] {
        let mut rig = Rig::enter(mode);
        rig.cycles(1000);
        // the same pose twice is a stop
        for angle in [0.1, 0.2, 0.2] {
            assert!(rig.j1(angle).is_ok());
        }
        rig.cycles(1000);
        assert_eq!((rig.mode(), rig.errors(), rig.here()[0]), (mode, vec![], 0.2), "{mode:#x}");
        let counters = rig.world.sim.slave_counters();
        assert_eq!((counters.cycles, counters.taken, counters.held, counters.underflows), (2000, 3, 1997, 0));
    }
}

#[test]
fn mode_1_holds_its_position_in_motion_and_at_rest() {
    let mut rig = Rig::enter(0x102);
    rig.cycles(100);
    assert_eq!((rig.mode(), rig.errors()), (0x102, vec![]));
    rig.j1(0.2);
    rig.cycles(1);
    assert!(rig.world.sim.is_moving());
    rig.cycles(1);
    assert!(!rig.world.sim.is_moving(), "held");
    rig.cycles(100);
    assert_eq!((rig.mode(), rig.errors(), rig.here()[0]), (0x102, vec![], 0.2));
}

#[test]
fn mode_1_holding_out_of_fast_motion_is_too_hard_a_stop() {
    let mut rig = Rig::enter(0x102);
    let mut angle = 0.0;
    for n in 1..=4 {
        angle += 0.4 * f64::from(n);
        assert_eq!(rig.j1(angle), HResult::S_OK);
        rig.cycles(1);
    }
    assert_eq!(rig.errors(), []);
    // from 1.6 degrees a cycle, 200 degrees per second, to a stop: 25,000 per second squared
    rig.cycles(1);
    assert_eq!((rig.mode(), rig.errors()), (0, vec![limit(0x8420_4040, 1)]));
}
