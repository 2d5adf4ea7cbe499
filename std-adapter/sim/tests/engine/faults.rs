//! Scenarios in the middle of a stream: how the engine ends, which poses it has sent, and that nothing moved
//! afterwards.

use bcap_core::hresult::HResult;
use bcap_core::slave::{Cause, EngineAction, Failure, Fault, Mode, PoseType, RecoverError, Released, Step};
use bcap_core::time::Instant;
use bcap_sim::Scenario;

use crate::engine::wire::{LINKS, Link};
use crate::engine::{MODES, Rig, format, from_start, smooth};

const UNDERFLOW: HResult = HResult::E_COMMAND_BUFFER_EMPTY;

/// Cycles of the trajectory: 20 degrees of J1, at rest at both ends.
const CYCLES: u16 = 300;

/// Every link with every mode.
fn each() -> impl Iterator<Item = (Link, Mode)> {
    LINKS.into_iter().flat_map(|link| MODES.map(|mode| (link, mode)))
}

/// Streams the trajectory through a scenario.
fn play(link: Link, mode: Mode, text: &str) -> (Rig, EngineAction) {
    let mut rig = Rig::new(link, format(mode, PoseType::J));
    rig.world.sim.play(Scenario::parse(text).unwrap());
    let end = trajectory(&mut rig);
    (rig, end)
}

fn trajectory(rig: &mut Rig) -> EngineAction {
    let mut count = 0;
    rig.run(|rig| {
        count += 1;
        (count <= CYCLES).then(|| from_start(rig, 0, smooth(count, CYCLES) * 20.0))
    })
}

/// Where J1 was commanded to, cycle by cycle, without repeats.
fn way(rig: &Rig) -> Vec<f64> {
    let mut way: Vec<f64> = rig.world.sim.slave_record().map(|cycle| cycle.axes[0]).collect();
    way.dedup();
    way
}

/// The path of a stream without a fault.
fn whole_way(mode: Mode) -> Vec<f64> {
    let (rig, end) = play(Link::Tcp, mode, "");
    assert_eq!(end, EngineAction::Finished);
    way(&rig)
}

/// Lets two seconds pass, and checks that the robot does not move and executes no further cycle of slave mode.
fn nothing_moves_afterwards(rig: &mut Rig) {
    let (axes, record) = (rig.world.sim.axes(), rig.world.sim.slave_record().count());
    assert!(!rig.world.sim.is_moving());
    rig.world.pass(2000);
    assert_eq!((rig.world.sim.axes(), rig.world.sim.slave_record().count()), (axes, record), "it has moved");
    assert!(!rig.world.sim.is_moving());
}

/// Returns the calls after the failed call, without repetitions: there may be several errors to read.
fn sent_after(rig: &Rig, failed: Step) -> Vec<Step> {
    let steps: Vec<Step> = rig.sent.iter().map(|(_, step)| *step).collect();
    let at = steps.iter().rposition(|step| *step == failed).unwrap();
    let mut steps = steps[at + 1..].to_vec();
    steps.dedup();
    steps
}

/// The calls of the diagnosis, which change nothing.
const DIAGNOSIS: [Step; 4] = [Step::GetMode, Step::ErrorCount, Step::ErrorInfo, Step::SystemState];

fn fault(rig: &Rig) -> &Fault {
    rig.engine.fault().unwrap()
}

// --- a storm of E_BUF_FULL

#[test]
fn a_storm_of_full_buffers_that_the_buffer_bridges_loses_no_pose() {
    let text = "[[fault]]\nwhen = { call = 100, to = 101, of = 'slvMove' }\nthen = { refuse = 'E_BUF_FULL' }";
    for link in LINKS {
        for mode in [Mode::Mode0, Mode::Mode2] {
            let (mut rig, end) = play(link, mode, text);
            assert_eq!((end, rig.errors()), (EngineAction::Finished, vec![]), "{link:?}, {mode:?}");
            assert_eq!((rig.engine.stats().refused, rig.engine.stats().underflows), (2, 0));
            assert_eq!(rig.sent(Step::Move), rig.moves as usize + 2, "each that was refused was sent again");
            assert_eq!(way(&rig), whole_way(mode), "no pose is lost, none comes twice");
            nothing_moves_afterwards(&mut rig);
        }
    }
}

#[test]
fn a_storm_of_full_buffers_that_outlasts_the_buffer_is_an_underflow() {
    let text = "[[fault]]\nwhen = { call = 100, to = 120, of = 'slvMove' }\nthen = { refuse = 'E_BUF_FULL' }";
    for link in LINKS {
        let (mut rig, end) = play(link, Mode::Mode0, text);
        assert_eq!((end, fault(&rig).code()), (EngineAction::Faulted, Some(UNDERFLOW)), "{link:?}");
        assert_eq!((fault(&rig).released, rig.errors().last()), (Released::Yes, Some(&UNDERFLOW)));
        assert_eq!(sent_after(&rig, Step::Move), DIAGNOSIS);
        let whole = whole_way(Mode::Mode0);
        assert_eq!(way(&rig)[..], whole[..way(&rig).len()], "as far as it went");
        nothing_moves_afterwards(&mut rig);
    }
}

#[test]
fn a_buffer_that_stays_full_at_rest_is_given_up() {
    let text = "[[fault]]\nwhen = { call = 1, to = 100000, of = 'slvMove' }\nthen = { refuse = 'E_BUF_FULL' }";
    for link in LINKS {
        let (mut rig, end) = play(link, Mode::Mode0, text);
        assert_eq!((end, fault(&rig).cause), (EngineAction::Faulted, Cause::Stalled), "{link:?}");
        assert_eq!((fault(&rig).code(), fault(&rig).released, rig.errors()), (None, Released::Yes, vec![]));
        // slave mode was on, so it is left
        assert_eq!(sent_after(&rig, Step::Move), [Step::GetMode, Step::Leave, Step::ErrorCount, Step::SystemState]);
        let (first, last) = (rig.sent[0].0, rig.world.now);
        assert!((900..2500).contains(&(last.saturating_since(first).as_millis())), "a second, and the motor's start");
        assert_eq!(way(&rig), [] as [f64; 0]);
        nothing_moves_afterwards(&mut rig);
    }
}

// --- the link is lost

#[test]
fn a_link_that_is_lost_for_good_ends_the_stream_and_the_robot_stands() {
    let text = "[[fault]]\nwhen = { cycle = 150 }\nthen = { link_loss_ms = 0 }";
    for (link, mode) in each() {
        let (mut rig, end) = play(link, mode, text);
        assert_eq!((end, fault(&rig).step), (EngineAction::Faulted, Step::Move), "{link:?}, {mode:?}");
        assert_eq!(fault(&rig).cause, Cause::Failed(Failure::Timeout));
        // the controller could not be queried
        assert_eq!((fault(&rig).released, fault(&rig).emergency_stop), (Released::Unknown, None));
        assert_eq!(fault(&rig).errors(), []);
        assert!(sent_after(&rig, Step::Move).iter().all(|step| DIAGNOSIS.contains(step)), "{:?}", rig.sent);
        assert_eq!(rig.engine.recover(), Err(RecoverError::Lost));
        // modes 0 and 2 ran out of poses, mode 1 holds its position
        let expected = if mode == Mode::Mode1 { vec![] } else { vec![UNDERFLOW] };
        assert_eq!(rig.errors(), expected, "{mode:?}");
        assert_eq!(rig.world.sim.slave_counters().underflows, u64::from(mode != Mode::Mode1));
        let last = rig.world.sim.slave_record().filter(|cycle| cycle.took).last().unwrap().cycle;
        assert!((149..=153).contains(&last), "no more than the buffer held: cycle {last}");
        nothing_moves_afterwards(&mut rig);
    }
}

#[test]
fn a_link_that_comes_back_tells_the_first_cause() {
    let text = "[[fault]]\nwhen = { cycle = 150 }\nthen = { link_loss_ms = 4000 }";
    for (link, mode) in each() {
        let (mut rig, end) = play(link, mode, text);
        assert_eq!(end, EngineAction::Faulted, "{link:?}, {mode:?}");
        assert_eq!(fault(&rig).cause, Cause::Failed(Failure::Timeout));
        if link == Link::Tcp {
            let expected = if mode == Mode::Mode1 { None } else { Some(UNDERFLOW) };
            assert_eq!((fault(&rig).code(), fault(&rig).emergency_stop), (expected, Some(false)), "{mode:?}");
        }
        assert!(!sent_after(&rig, Step::Move).contains(&Step::ClearError), "nothing is cleared unasked");
        nothing_moves_afterwards(&mut rig);
    }
}

#[test]
fn single_answers_that_are_lost_or_broken_cost_a_datagram_link_nothing() {
    for then in ["drop", "wrong_serial", "corrupt"] {
        let text = format!("[[fault]]\nwhen = {{ call = 100, of = 'slvMove' }}\nthen = '{then}'");
        for mode in MODES {
            let (mut rig, end) = play(Link::Udp, mode, &text);
            assert_eq!(
                (end, rig.errors()),
                (EngineAction::Finished, vec![]),
                "{then}, {mode:?}: {:?}",
                rig.engine.fault()
            );
            assert!(rig.wires[0].requests as usize > rig.sent.len(), "it was asked again");
            // the repetition was not carried out once more
            assert_eq!(u64::from(rig.moves), rig.world.sim.slave_counters().taken, "{then}, {mode:?}");
            assert_eq!(way(&rig), whole_way(mode), "{then}, {mode:?}");
            nothing_moves_afterwards(&mut rig);
        }
    }
}

#[test]
fn a_connection_that_is_closed_leaves_the_watch_to_ask() {
    let text = "[[fault]]\nwhen = { call = 100, of = 'slvMove' }\nthen = 'disconnect'";
    for mode in MODES {
        let (mut rig, end) = play(Link::Tcp, mode, text);
        assert_eq!((end, fault(&rig).cause), (EngineAction::Faulted, Cause::Failed(Failure::Lost)));
        let watched = sent_after(&rig, Step::Move);
        assert!(watched.starts_with(&[Step::GetMode]) && !watched.contains(&Step::ClearError), "{watched:?}");
        assert_eq!(fault(&rig).emergency_stop, Some(false), "the second connection has answered");
        assert_eq!(rig.engine.recover(), Err(RecoverError::Lost));
        rig.world.pass(100);
        nothing_moves_afterwards(&mut rig);
    }
}

// --- an error at a cycle

#[test]
fn an_error_at_any_cycle_ends_the_stream_there() {
    // of level 2, after which the motor stays on, and of level 3
    for (number, (link, mode)) in [0x8220_0001, 0x8350_0001].into_iter().flat_map(|n| each().map(move |on| (n, on))) {
        let code = HResult::from_u32(number);
        for cycle in [1, 2, 3, 50, 150, 299] {
            let text = format!("[[fault]]\nwhen = {{ cycle = {cycle} }}\nthen = {{ error = '{number:#x}' }}");
            let (mut rig, end) = play(link, mode, &text);
            assert_eq!((end, fault(&rig).code()), (EngineAction::Faulted, Some(code)), "{link:?}, {mode:?}, {cycle}");
            assert_eq!(rig.world.sim.motor_is_on(), code.level() == Some(2));
            // the engine found that Slave Mode is off, or the error itself if its answer was withheld
            let refused = [HResult::E_SLVMODE_OFF, code].map(Cause::Refused);
            assert!(refused.contains(&fault(&rig).cause), "{}", fault(&rig));
            assert_eq!((fault(&rig).released, fault(&rig).emergency_stop), (Released::Yes, Some(false)));
            assert_eq!(sent_after(&rig, Step::Move), DIAGNOSIS);
            // each cycle took a pose, three more are in the buffer, one is refused
            let sent = rig.sent(Step::Move);
            assert!((cycle..=cycle + 4).contains(&sent), "{sent} poses by cycle {cycle}");
            let last = rig.world.sim.slave_record().last().map_or(0, |cycle| cycle.cycle);
            assert!(last < cycle as u64, "cycle {last} began after the error of {cycle}");
            assert!(way(&rig).iter().zip(whole_way(mode)).all(|(went, whole)| *went == whole), "as far as it went");
            nothing_moves_afterwards(&mut rig);
        }
    }
}

#[test]
fn of_two_errors_the_first_is_the_cause() {
    let text = "[[fault]]\nwhen = { cycle = 100 }\nthen = { error = '0x84204043' }
                [[fault]]\nwhen = { cycle = 100 }\nthen = { error = 'E_SLVMODE_OFF' }";
    for (link, mode) in each() {
        let (mut rig, end) = play(link, mode, text);
        let codes: Vec<_> = fault(&rig).errors().iter().map(|error| error.code).collect();
        assert_eq!((end, codes), (EngineAction::Faulted, vec![HResult::from_u32(0x8420_4043), HResult::E_SLVMODE_OFF]));
        assert_eq!(fault(&rig).code(), Some(HResult::from_u32(0x8420_4043)));
        nothing_moves_afterwards(&mut rig);
    }
}

#[test]
fn after_an_error_the_stream_goes_on_only_when_it_is_told_to() {
    for (link, mode) in each() {
        let text = "[[fault]]\nwhen = { cycle = 150 }\nthen = { error = '0x83500001' }";
        let (mut rig, end) = play(link, mode, text);
        assert_eq!(end, EngineAction::Faulted);
        nothing_moves_afterwards(&mut rig);
        let stood = rig.world.sim.axes()[0];
        assert!(stood > 1.0 && !rig.world.sim.motor_is_on() && rig.sent(Step::ClearError) == 0);
        rig.engine.recover().unwrap();
        assert_eq!((trajectory(&mut rig), rig.errors()), (EngineAction::Finished, vec![]), "{link:?}, {mode:?}");
        assert!((rig.world.sim.axes()[0] - stood - 20.0).abs() < 1e-6, "from where it stood");
        assert_eq!(rig.sent(Step::ClearError), 1);
    }
}

// --- the emergency stop

#[test]
fn an_emergency_stop_ends_the_stream_for_good() {
    for (link, mode) in each() {
        let text = "[[fault]]\nwhen = { cycle = 150 }\nthen = { emergency_stop = true }";
        let (mut rig, end) = play(link, mode, text);
        assert_eq!(
            (end, fault(&rig).code()),
            (EngineAction::Faulted, Some(HResult::E_COMMAND_POSITION_GEN_STOPPED)),
            "{link:?}, {mode:?}"
        );
        assert_eq!((fault(&rig).released, fault(&rig).emergency_stop), (Released::Yes, Some(true)));
        assert_eq!(sent_after(&rig, Step::Move), DIAGNOSIS);
        assert_eq!(rig.world.sim.slave_record().last().map(|cycle| cycle.cycle), Some(149));
        assert_eq!(rig.engine.recover(), Err(RecoverError::EmergencyStop));
        assert_eq!(rig.engine.poll(rig.world.now), EngineAction::Faulted);
        nothing_moves_afterwards(&mut rig);
        assert!(!rig.world.sim.motor_is_on());
        // even when the stop is released and another client has cleared the error, the engine does not continue by itself
        let now: Instant = rig.world.now;
        rig.world.sim.emergency_stop(false, now);
        assert_eq!(rig.engine.recover(), Err(RecoverError::EmergencyStop));
        nothing_moves_afterwards(&mut rig);
        let calls = rig.sent.len();
        rig.engine.stop();
        assert_eq!(trajectory(&mut rig), EngineAction::Finished);
        assert_eq!(
            rig.sent[calls..].iter().map(|(_, step)| *step).collect::<Vec<_>>(),
            [Step::Halt, Step::MotorOff, Step::GiveArm]
        );
    }
}

#[test]
fn an_emergency_stop_between_fault_and_recovery_is_seen_before_anything_is_cleared() {
    let text = "[[fault]]\nwhen = { cycle = 150 }\nthen = { error = '0x83500001' }";
    let (mut rig, end) = play(Link::Tcp, Mode::Mode0, text);
    assert_eq!(end, EngineAction::Faulted);
    let now = rig.world.now;
    rig.world.sim.emergency_stop(true, now);
    rig.engine.recover().unwrap();
    assert_eq!(trajectory(&mut rig), EngineAction::Faulted);
    assert_eq!((fault(&rig).cause, fault(&rig).emergency_stop), (Cause::EmergencyStop, Some(true)));
    assert_eq!((rig.sent(Step::ClearError), rig.sent(Step::Motor)), (0, 1), "the motor was switched on at the start");
    assert_eq!(rig.engine.recover(), Err(RecoverError::EmergencyStop));
    nothing_moves_afterwards(&mut rig);
}
