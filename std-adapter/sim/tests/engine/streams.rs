//! Streams that arrive, stop, or are not begun.

use bcap_core::hresult::HResult;
use bcap_core::slave::{AxisLimits, Cause, EngineAction, Mode, PoseType, Released, Step};
use bcap_sim::Config;

use crate::engine::wire::{LINKS, Link};
use crate::engine::{MODES, Rig, format, from_start, smooth};

#[test]
fn a_trajectory_arrives_without_an_error_in_every_mode() {
    for (mode, link) in MODES.into_iter().flat_map(|mode| LINKS.map(|link| (mode, link))) {
        let mut rig = Rig::new(link, format(mode, PoseType::J));
        let mut count = 0;
        let end = rig.run(|rig| {
            count += 1;
            (count <= 500).then(|| from_start(rig, 0, 30.0 * smooth(count, 500)))
        });
        assert_eq!((end, rig.errors()), (EngineAction::Finished, vec![]), "{mode:?}");
        assert!((rig.world.sim.axes()[0] - rig.engine.start_pose().unwrap().as_slice()[0] - 30.0).abs() < 1e-9);
        let (stats, counters) = (rig.engine.stats(), rig.world.sim.slave_counters());
        assert_eq!((stats.underflows, stats.late, stats.refused), (0, 0, 0), "{mode:?}");
        assert_eq!(u64::from(stats.cycles), counters.taken, "{mode:?}");
        assert!(stats.least_margin.is_none_or(|least| least.as_millis() >= 8), "{mode:?}: {:?}", stats.least_margin);
    }
}

#[test]
fn a_stop_in_motion_is_within_the_controllers_own_limits() {
    for (mode, link) in MODES.into_iter().flat_map(|mode| LINKS.map(|link| (mode, link))) {
        let limits = AxisLimits::uniform(100.0, 400.0);
        let mut rig = Rig::with(link, format(mode, PoseType::J), Config::default(), |config| config.limits = limits);
        let (mut speed, mut at, mut count) = (0.0, 0.0, 0);
        let end = rig.run(|rig| {
            count += 1;
            speed = f64::min(speed + 0.02, 0.6);
            at += speed;
            if count == 60 {
                rig.engine.stop();
            }
            (count < 60).then(|| from_start(rig, 0, at))
        });
        assert_eq!((end, rig.errors()), (EngineAction::Finished, vec![]), "{mode:?}");
        let axes: Vec<f64> = rig.world.sim.slave_record().map(|cycle| cycle.axes[0]).collect();
        let speeds: Vec<f64> = axes.windows(2).map(|pair| (pair[1] - pair[0]) / 0.008).collect();
        assert!(speeds.iter().any(|speed| *speed > 70.0) && speeds.last().is_some_and(|speed| speed.abs() < 1e-9));
        let hardest = speeds.windows(2).map(|pair| ((pair[1] - pair[0]) / 0.008).abs()).fold(0.0, f64::max);
        assert!(hardest <= 400.0, "{mode:?}: {hardest}");
    }
}

#[test]
fn the_controllers_refusals_name_the_step() {
    let mut rig =
        Rig::with(Link::Tcp, format(Mode::Mode1, PoseType::J), Config::default(), |config| config.motor = false);
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
    let fault = rig.engine.fault().unwrap();
    assert_eq!((fault.step, fault.released), (Step::Enter, Released::Yes));
    assert!(matches!(fault.cause, Cause::Refused(_)), "{fault}");

    let mut rig = Rig::with(Link::Tcp, format(Mode::Mode1, PoseType::J), Config::default(), |config| config.arm = None);
    assert_eq!(rig.run(|_| panic!("no pose is wanted")), EngineAction::Faulted);
    assert_eq!(rig.engine.fault().unwrap().code(), Some(HResult::E_ARM_NOT_TAKEN));
}
