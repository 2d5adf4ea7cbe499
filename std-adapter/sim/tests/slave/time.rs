//! Time: steps of any size give the same cycles.

use bcap_core::time::Instant;
use bcap_sim::{Config, SlaveConfig};

use crate::slave::Rig;

#[test]
fn steps_of_any_size_give_the_same_cycles() {
    let run = |step: u64| {
        let mut rig = Rig::enter(0x002);
        for n in [1.0, 2.0, 2.0] {
            rig.j1(n * 0.1);
        }
        let end = rig.world.now.as_micros() + 800_000;
        while rig.world.now.as_micros() < end {
            rig.world.now = Instant::from_micros((rig.world.now.as_micros() + step).min(end));
            rig.world.sim.advance(rig.world.now);
        }
        let record: Vec<_> = rig.world.sim.slave_record().collect();
        (record, rig.world.sim.slave_counters(), rig.here())
    };
    let expected = run(1000);
    assert_eq!(expected.1.cycles, 100);
    for step in [137, 7_999, 8_000, 8_001, 800_000] {
        assert_eq!(run(step), expected, "{step}");
    }
}

#[test]
fn years_and_the_end_of_time_pass_quickly() {
    let mut rig = Rig::enter(0x002);
    rig.world.sim.advance(Instant::from_millis(1000 * 86_400 * 3650));
    assert_eq!(rig.mode(), 0x002);
    rig.world.sim.advance(Instant::FAR_FUTURE);
    rig.world.sim.advance(Instant::FAR_FUTURE);
    assert_eq!((rig.mode(), rig.errors()), (0x002, vec![]));
}

#[test]
fn the_record_keeps_as_much_as_it_shall() {
    let slave = SlaveConfig { record: 3, ..SlaveConfig::default() };
    let mut rig = Rig::with(Config { slave, ..Config::default() });
    rig.execute("slvChangeMode", 0x102);
    for n in 1..=5 {
        rig.j1(f64::from(n) * 0.1);
        rig.cycles(1);
    }
    let cycles: Vec<_> = rig.world.sim.slave_record().map(|c| c.cycle).collect();
    assert_eq!(cycles, [3, 4, 5]);
}
