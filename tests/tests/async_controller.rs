//! `Controller` for tokio and its objects against the virtual controller, over real sockets and in memory.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind;
use bcap_core::slave::{
    AxisLimits, Cycle, Format, Mode, Next, Outputs, Pose, PoseType, ReceiveFormat, ReceivePose, SendFormat, SlaveMode,
    Trajectory,
};
use bcap_core::variant::{Variant, VariantBuf};
use bcap_sim::memory::Network;
use bcap_sim::{Config, Controller as Simulated, Profile, Scenario, TaskStatus};
use bcap_std::asynch::{Arm, Controller, Halted, Reading, State, Stopper};
use bcap_std::server::Limits;
use bcap_std::{Backoff, Error, Motion, Move, Pass, Position, Settings, StoppedTasks};
use bcap_testkit::network::Random;
use bcap_tests::proxy::{Cut, Relay};
use bcap_tests::real_time::repeated;
use bcap_tests::served::Served;
use bcap_tests::simulated::{Outcomes, quick, simulated, to};
use bcap_tests::slowed::{Slowed, inner};
use tokio::task::JoinSet;

const LIMIT: Duration = Duration::from_secs(30);

fn settings() -> Settings {
    Settings::rc8().reconnect(Backoff::default().min(Duration::from_millis(1)).max(Duration::from_millis(20)))
}

/// A motion of 20 s, so that it is running at the next line.
fn far() -> Move {
    to(150.0).speed_percent(2.0)
}

async fn connect(sim: &Served<Simulated>) -> Controller {
    Controller::connect(&sim.address(), &settings()).await.unwrap()
}

/// Connects, takes the arm and switches the motor on.
async fn ready(sim: &Served<Simulated>) -> (Controller, Arm) {
    let cell = connect(sim).await;
    let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
    arm.motor_on().await.unwrap();
    (cell, arm)
}

/// Waits until the simulated controller is in a state.
async fn until(sim: &Served<Simulated>, state: impl Fn(&Simulated) -> bool) {
    poll(|| sim.is(&state)).await;
}

async fn poll(is_there: impl Fn() -> bool) {
    for _ in 0..30_000 {
        if is_there() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    panic!("the controller did not get there");
}

#[tokio::test]
async fn variables_are_read_and_written_by_many_tasks() {
    let sim = simulated();
    for address in [sim.address(), format!("udp:{}", sim.udp)] {
        let cell = Controller::connect(&address, &settings()).await.unwrap();
        let tasks: Vec<_> = (1..=8)
            .map(|index| {
                let cell = cell.clone();
                tokio::spawn(async move {
                    let name = format!("I{index}");
                    cell.write(&name, index * 10).await.unwrap();
                    cell.read::<i32>(&name).await.unwrap()
                })
            })
            .collect();
        for (task, index) in tasks.into_iter().zip(1..) {
            assert_eq!(task.await.unwrap(), index * 10);
        }
        let position = Position::new([400.0, 0.0, 300.0], [180.0, 0.0, 180.0]).figure(5);
        cell.write("P1", position).await.unwrap();
        let [count, there] = cell.read_all(["I3", "P1"]).await.unwrap();
        assert_eq!((count.convert(), there.convert()), (Ok(30), Ok(position)));
        let each = cell.read_each(&["I3", "I99999", "P1"]).await.unwrap();
        let [(first, count), (second, missing), (third, there)] = each.as_slice() else { panic!("{each:?}") };
        assert_eq!((count.as_ref().unwrap().convert(), there.as_ref().unwrap().convert()), (Ok(30), Ok(position)));
        assert!(missing.is_err() && first <= second && second <= third);
        let controller = cell.handle().await.unwrap();
        let names = cell.call(call::controller_get_robot_names(controller, "")).await.unwrap();
        assert_eq!(names.convert::<Vec<String>>().unwrap(), ["Arm0"]);
        assert!(!cell.robot().await.unwrap().read::<bool>("@SERVO_ON").await.unwrap());
        let statistics = cell.statistics();
        assert!(statistics.operations >= 19 && statistics.connections == 1, "{statistics:?}");
        cell.close().await.unwrap();
        sim.assert_left();
    }
}

#[tokio::test]
async fn a_handle_of_a_closed_controller_says_so() {
    let sim = simulated();
    let cell = connect(&sim).await;
    let other = cell.clone();
    cell.close().await.unwrap();
    assert!(matches!(other.read::<i32>("I1").await, Err(Error::Closed)));
    assert_eq!(other.state(), State::Closed);
    assert!(other.subscribe(&["I1"], LIMIT).next().await.is_none());
    assert!(matches!(other.connected().await, Err(Error::Closed)));
}

#[tokio::test]
async fn other_calls_are_made_while_the_robot_moves() {
    let sim = simulated();
    let (cell, mut arm) = ready(&sim).await;
    arm.set_speed(100.0).await.unwrap();
    let reads = async {
        until(&sim, Simulated::is_moving).await;
        let mut reads = 0;
        while sim.application().is_moving() {
            cell.read::<i32>("I1").await.unwrap();
            reads += 1;
        }
        reads
    };
    let (motion, reads) = tokio::join!(arm.move_to(&to(20.0).speed_percent(2.0), LIMIT), reads);
    assert_eq!(motion.unwrap(), Motion::Arrived);
    assert!((arm.robot().joints().await.unwrap().degrees[0] - 20.0).abs() < 0.05);
    assert!(reads > 1, "{reads} reads during the motion");
    arm.give().await.unwrap();
    cell.close().await.unwrap();
    sim.assert_left();
}

#[tokio::test]
async fn a_motion_that_is_dropped_halts_the_robot() {
    let sim = simulated();
    let (cell, mut arm) = ready(&sim).await;
    tokio::select! {
        ended = arm.move_to(&far(), LIMIT) => panic!("{ended:?}"),
        () = until(&sim, Simulated::is_moving) => {}
    }
    until(&sim, |sim| !sim.is_moving()).await;
    let there = arm.robot().joints().await.unwrap().degrees[0];
    assert!(there < 149.0, "it went on to {there}");
    // the arm still has its robot, after ClearError
    assert!(arm.move_to(&to(there + 1.0), LIMIT).await.unwrap_err().code() == Some(HResult::E_ERROR_PRESENT));
    cell.execute::<()>("ClearError", ()).await.unwrap();
    assert_eq!(arm.move_to(&to(there + 1.0), LIMIT).await.unwrap(), Motion::Arrived);
    drop(arm);
    until(&sim, |sim| sim.arm_owner().is_none() && !sim.motor_is_on()).await;
}

#[tokio::test]
async fn a_stopper_halts_a_motion_and_its_caller_is_told() {
    let sim = simulated();
    let cell = connect(&sim).await;
    let stopper = cell.stopper().await.unwrap();
    assert_eq!(stopper.halt().await.unwrap(), Halted::NothingMoved);
    let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
    arm.motor_on().await.unwrap();
    let halt = async {
        until(&sim, Simulated::is_moving).await;
        stopper.halt().await.unwrap()
    };
    let (motion, halted) = tokio::join!(arm.move_to(&far(), LIMIT), halt);
    assert_eq!((motion.unwrap(), halted), (Motion::Halted, Halted::Halted));
}

#[tokio::test]
async fn a_stopper_stops_the_task_that_moves_the_robot() {
    let task = "[controller]\nmotor = true
        [[task]]\nname = 'Mover'\nstart = 2\nsteps = [
            { move = 'J(60, 45, 90, 0, 45, 0)' },
            { move = 'J(-60, 45, 90, 0, 45, 0)' },
        ]";
    let mut sim = Simulated::new(quick(Profile::Rc8));
    sim.play(Scenario::parse(task).unwrap());
    let sim = Served::of(sim, Limits::default());
    let stopper = connect(&sim).await.stopper().await.unwrap();
    until(&sim, Simulated::is_moving).await;
    assert_eq!(stopper.halt().await.unwrap(), Halted::TasksStopped(StoppedTasks::All));
    assert!(!sim.application().is_moving());
    assert_eq!(sim.application().task("Mover").unwrap().0, TaskStatus::Ready);
    assert_eq!(stopper.halt().await.unwrap(), Halted::NothingMoved);
}

/// Asserts that the robot rests, and does not begin to move later.
async fn assert_rests(sim: &Served<Simulated>, arm: &mut Arm) {
    let rest = sim.application().joints()[0];
    let asked = arm.robot().joints().await.unwrap().degrees[0];
    assert!((asked - rest).abs() < 0.001, "it moved on from {rest} to {asked}");
}

/// The reported outcome of a motion agrees with the position of the robot, however and whenever it is stopped.
#[tokio::test]
async fn no_stopped_motion_is_reported_as_arrived() {
    let sim = simulated();
    let (cell, mut arm) = ready(&sim).await;
    let stopper = cell.stopper().await.unwrap();
    let (mut random, mut outcomes) = (Random(11), Outcomes::default());
    for trial in 0..Outcomes::trials() {
        let degrees = if trial % 2 == 0 { 10.0 } else { 0.0 };
        let delay = Duration::from_micros(random.below(200_000));
        let ended = if trial % 3 == 0 {
            // the stop button of a `select!`
            tokio::select! {
                ended = arm.move_to(&to(degrees), LIMIT) => Some(ended),
                () = tokio::time::sleep(delay) => None,
            }
        } else {
            let halt = async {
                tokio::time::sleep(delay).await;
                stopper.halt().await.unwrap()
            };
            Some(tokio::join!(arm.move_to(&to(degrees), LIMIT), halt).0)
        };
        until(&sim, |sim| !sim.is_moving()).await;
        if ended.is_none() {
            assert_rests(&sim, &mut arm).await;
        }
        outcomes.count(&sim, ended.map(Result::unwrap), [degrees, 0.0]);
    }
    outcomes.assert_stopped();
}

#[tokio::test]
async fn motions_follow_each_other_and_other_calls_are_made() {
    let sim = simulated();
    let (cell, mut arm) = ready(&sim).await;
    let motions = async {
        // motions whose beginning is seen even on a loaded machine
        let mut moving = arm.start(&to(90.0).pass(Pass::Near), LIMIT).await.unwrap();
        for degrees in [150.0, 70.0, 140.0] {
            moving = moving.then(&to(degrees).pass(Pass::Near)).await.unwrap();
        }
        assert!(moving.robot().joints().await.unwrap().degrees[0] > 5.0);
        moving.wait().await.unwrap()
    };
    let reads = async {
        until(&sim, Simulated::is_moving).await;
        let mut reads = 0;
        while sim.application().is_moving() {
            cell.read::<i32>("I1").await.unwrap();
            reads += 1;
        }
        reads
    };
    let (motion, reads) = tokio::join!(motions, reads);
    assert_eq!(motion, Motion::Arrived);
    assert!((sim.application().joints()[0] - 140.0).abs() < 0.05);
    assert!(reads > 1, "{reads} reads during the motions");
}

/// The controller has the motion already, so its time limit must not wait until all other callers have had their turn.
#[tokio::test]
async fn the_time_limit_of_a_running_motion_does_not_wait_for_a_full_queue() {
    const READS: usize = 20_000;
    let sim = simulated();
    let (cell, mut arm) = ready(&sim).await;
    let moving = arm.start(&far(), Duration::from_millis(500)).await.unwrap();
    let (mut reads, begun) = (JoinSet::new(), Arc::new(AtomicUsize::new(0)));
    for _ in 0..READS {
        let (cell, begun) = (cell.clone(), Arc::clone(&begun));
        reads.spawn(async move {
            begun.fetch_add(1, Ordering::Relaxed);
            cell.read::<i32>("I1").await
        });
    }
    while begun.load(Ordering::Relaxed) < READS {
        tokio::task::yield_now().await;
    }
    assert_eq!(moving.wait().await.unwrap(), Motion::TimedOut);
    while reads.try_join_next().is_some() {}
    assert!(!reads.is_empty(), "all {READS} reads were made before");
}

#[tokio::test]
async fn motions_that_are_dropped_halt_the_robot() {
    let sim = simulated();
    let (_cell, mut arm) = ready(&sim).await;
    // between two motions
    drop(arm.start(&far(), LIMIT).await.unwrap());
    until(&sim, |sim| !sim.is_moving()).await;
    assert!(sim.application().joints()[0] < 149.0);
    sim.clear();
    // while one motion waits for another, and while the end is waited for
    let moving = arm.start(&far(), LIMIT).await.unwrap();
    assert!(tokio::time::timeout(Duration::from_millis(20), moving.then(&to(0.0))).await.is_err());
    until(&sim, |sim| !sim.is_moving()).await;
    sim.clear();
    let moving = arm.start(&far(), LIMIT).await.unwrap();
    assert!(tokio::time::timeout(Duration::from_millis(20), moving.wait()).await.is_err());
    until(&sim, |sim| !sim.is_moving()).await;
    sim.clear();
    assert_eq!(arm.start(&far(), LIMIT).await.unwrap().halt().await.unwrap(), Halted::Halted);
    let rest = sim.application().joints()[0];
    assert!(rest < 149.0, "{rest}");
    sim.clear();
    // an error of a later motion halts those before it
    let moving = arm.start(&far(), LIMIT).await.unwrap();
    assert!(moving.then(&Move::joint("P(")).await.unwrap_err().code().is_some());
    assert!(!sim.application().is_moving());
    sim.clear();
    // a leaked motion is halted before the next, which is refused because of that
    std::mem::forget(arm.start(&far(), LIMIT).await.unwrap());
    assert!(arm.move_to(&to(rest), LIMIT).await.is_err());
    sim.clear();
    assert_eq!(arm.move_to(&to(rest), LIMIT).await.unwrap(), Motion::Arrived);
    drop(arm);
    until(&sim, |sim| sim.arm_owner().is_none() && !sim.motor_is_on()).await;
}

/// The reported outcome of three motions agrees with the position of the robot, however and whenever they are stopped.
#[tokio::test]
async fn no_stopped_queue_is_reported_as_arrived() {
    let sim = simulated();
    let (cell, mut arm) = ready(&sim).await;
    let stopper = cell.stopper().await.unwrap();
    let (mut random, mut outcomes) = (Random(29), Outcomes::default());
    for trial in 0..Outcomes::trials() {
        let end = if trial % 2 == 0 { 12.0 } else { 0.0 };
        let pass = if trial % 5 < 3 { Pass::Near } else { Pass::Commanded };
        let delay = Duration::from_micros(random.below(400_000));
        let motions = async {
            let moving = arm.start(&to(20.0 + end).pass(pass), LIMIT).await.unwrap();
            let queued = match moving.then(&to(5.0).pass(pass)).await {
                Ok(moving) => moving.then(&to(end)).await,
                refused => refused,
            };
            match queued {
                Ok(moving) => moving.wait().await.unwrap(),
                // the halt arrived before the last motion was queued
                Err(Error::Refused { code: HResult::E_ERROR_PRESENT, .. }) => Motion::Halted,
                Err(error) => panic!("trial {trial}: {error}"),
            }
        };
        let ended = if trial % 3 == 0 {
            tokio::select! {
                ended = motions => Some(ended),
                () = tokio::time::sleep(delay) => None,
            }
        } else {
            let halt = async {
                tokio::time::sleep(delay).await;
                stopper.halt().await.unwrap()
            };
            Some(tokio::join!(motions, halt).0)
        };
        until(&sim, |sim| !sim.is_moving()).await;
        if ended.is_none() {
            assert_rests(&sim, &mut arm).await;
        }
        outcomes.count(&sim, ended, [end, 0.0]);
    }
    outcomes.assert_stopped();
}

/// Swings the first joint by 4 degrees, in `cycles` cycles.
fn swing(cycles: u32) -> impl FnMut(&Cycle<'_>) -> Next + Send + 'static {
    move |cycle: &Cycle<'_>| {
        let mut joints: [f64; 8] = cycle.start.numbers().try_into().unwrap_or_default();
        let part = f64::from(cycle.number + 1) / f64::from(cycles);
        joints[0] += 2.0 * (1.0 - (part * std::f64::consts::TAU).cos());
        if cycle.number < cycles { Next::Pose(Pose::j(joints)) } else { Next::Finish }
    }
}

/// A trajectory that sets two outputs of the hand.
struct WithHand<T>(T);

impl<T: Trajectory> Trajectory for WithHand<T> {
    fn next(&mut self, cycle: &Cycle<'_>) -> Next {
        self.0.next(cycle)
    }

    fn outputs(&mut self) -> Option<Outputs<'_>> {
        Some(Outputs { hand_io: 0x5_0000, ..Outputs::default() })
    }
}

#[test]
fn poses_are_streamed_and_a_dropped_stream_stops() {
    repeated(|| tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(streamed()));
}

async fn streamed() {
    let sim: Served<Slowed> = Served::of(Slowed(Simulated::new(quick(Profile::Rc8))), Limits::default());
    let until = async |reached: &dyn Fn(&Simulated) -> bool| {
        let is_there = || {
            let controller = &mut sim.application().0;
            controller.advance(inner(bcap_std::now()));
            reached(controller)
        };
        poll(is_there).await;
    };
    let cell = Controller::connect(&format!("udp:{}", sim.udp), &settings()).await.unwrap();
    let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
    arm.motor_on().await.unwrap();
    let mode = SlaveMode { mode: Mode::Mode2, pose: PoseType::J };
    let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
    let limits = AxisLimits::uniform(100.0, 800.0);
    let hand = Format { send: SendFormat { hand_io: true, ..format.send }, ..format };
    let stats = arm.stream(hand, limits, WithHand(swing(100))).await.unwrap_or_else(|error| panic!("{error}"));
    assert!(stats.cycles >= 100, "{stats:?}");
    assert!(sim.application().0.slave_record().any(|cycle| cycle.axes[0] > 3.9));
    let outputs = [64, 65, 66].map(|index| sim.application().0.variable::<16>(VariableKind::Io, index).unwrap());
    assert_eq!(outputs.each_ref().map(VariantBuf::as_variant), [true, false, true].map(Variant::Bool));
    tokio::select! {
        ended = arm.stream(format, limits, swing(100_000)) => panic!("{ended:?}"),
        () = until(&|sim| sim.slave_mode() != 0 && sim.slave_counters().cycles > 120) => {}
    }
    // the next call waits until Slave Mode has ended
    let there = arm.robot().joints().await.unwrap().degrees[0];
    {
        let sim = &sim.application().0;
        let errors: Vec<HResult> = sim.errors().map(|error| error.code).collect();
        assert_eq!((sim.slave_mode(), errors), (0, vec![]));
    }
    assert_eq!(arm.move_to(&to(there + 5.0), LIMIT).await.unwrap(), Motion::Arrived);
    let wrong = arm.stream(format, limits, |cycle: &Cycle<'_>| {
        let mut joints: [f64; 8] = cycle.start.numbers().try_into().unwrap_or_default();
        joints[0] += 20.0;
        Next::Pose(Pose::j(joints))
    });
    assert!(matches!(wrong.await, Err(Error::Stream(_))));
    drop(arm);
    until(&|sim| sim.arm_owner().is_none() && !sim.motor_is_on()).await;
}

#[tokio::test]
async fn a_panic_of_the_user_leaves_nothing() {
    let sim = simulated();
    let cell = connect(&sim).await;
    let task = tokio::spawn(async move {
        let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
        arm.motor_on().await.unwrap();
        panic!("in user code");
    });
    assert!(task.await.unwrap_err().is_panic());
    until(&sim, |sim| sim.open_objects() == 0).await;
    sim.assert_left();
}

#[tokio::test]
async fn one_arm_at_a_time() {
    let sim = simulated();
    let cell = connect(&sim).await;
    let robot = cell.robot().await.unwrap();
    let arm = robot.clone().take_arm().await.unwrap();
    assert!(matches!(robot.clone().take_arm().await, Err(Error::ArmTaken)));
    let other = connect(&sim).await;
    let taken = other.robot().await.unwrap().take_arm().await.unwrap_err();
    assert_eq!(taken.code(), Some(HResult::E_ARM_NOT_TAKEN));
    sim.clear();
    drop(arm);
    drop(robot.take_arm().await.unwrap());
    // a future that is dropped before it ends does not leave the arm taken either
    let robot = cell.robot().await.unwrap();
    tokio::select! {
        biased;
        arm = robot.take_arm() => drop(arm),
        () = tokio::task::yield_now() => {}
    }
    cell.read::<i32>("I1").await.unwrap();
    until(&sim, |sim| sim.arm_owner().is_none()).await;
}

#[tokio::test]
async fn subscriptions_share_one_scan_and_report_changes() {
    let sim = simulated();
    let cell = connect(&sim).await;
    cell.write("I1", 5).await.unwrap();
    let interval = Duration::from_millis(2);
    let mut first = cell.subscribe(&["I1"], interval);
    let mut second = cell.subscribe(&["I1"], Duration::from_secs(3600));
    let mut wrong = cell.subscribe(&["NoSuchVariable"], interval);
    let value = |reading: Option<Reading>| reading.unwrap().value.unwrap().convert::<i32>().unwrap();
    assert_eq!((value(first.next().await), value(second.next().await)), (5, 5));
    let error = wrong.next().await.unwrap().value.unwrap_err();
    assert!(error.to_string().contains("NoSuchVariable"), "{error}");
    let other = connect(&sim).await;
    other.write("I1", 6).await.unwrap();
    assert_eq!((value(first.next().await), value(second.next().await)), (6, 6));
    // one I1 for each of the two sessions
    assert_eq!(sim.application().open_objects(), 4);
    drop((first, second, wrong));
    cell.close().await.unwrap();
}

#[tokio::test]
async fn a_subscription_of_many_variables_reports_each_change_with_its_name_and_time() {
    let sim = simulated();
    let cell = connect(&sim).await;
    let begun = std::time::Instant::now();
    let names: Vec<String> = (1..=50).map(|index| format!("I{index}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut changes = cell.subscribe(&names, Duration::from_millis(1));
    let mut first = Vec::new();
    for _ in &names {
        let reading = changes.next().await.unwrap();
        assert_eq!(reading.value.unwrap().convert(), Ok(0));
        assert!(begun <= reading.at && reading.at <= std::time::Instant::now());
        first.push(reading.name.to_string());
    }
    first.sort_by_key(|name| name[1..].parse::<u32>().unwrap());
    assert_eq!(first, names);
    // no value is taken in the meantime, so only the last values remain
    for value in 1..=3 {
        cell.write("I7", value).await.unwrap();
        cell.write("I9", value * 10).await.unwrap();
        cell.read_until("I50", |_: &i32| true, LIMIT).await.unwrap();
    }
    let mut last = std::collections::BTreeMap::new();
    while last.get("I7") != Some(&3) || last.get("I9") != Some(&30) {
        let reading = changes.next().await.unwrap();
        last.insert(reading.name.to_string(), reading.value.unwrap().convert::<i32>().unwrap());
    }
    assert_eq!(last.len(), 2, "{last:?}");
    cell.close().await.unwrap();
    assert!(changes.next().await.is_none());
}

#[tokio::test]
async fn a_value_is_waited_for_with_a_time_limit() {
    let sim = simulated();
    let cell = connect(&sim).await;
    let other = cell.clone();
    let writer = tokio::spawn(async move {
        for value in 1..=5 {
            other.write("I1", value).await.unwrap();
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    });
    let at_least = |bound| move |value: &i32| *value >= bound;
    assert!(cell.read_until("I1", at_least(5), Duration::MAX).await.unwrap() >= 5);
    writer.await.unwrap();
    let missed = cell.read_until("I1", at_least(6), Duration::from_millis(30)).await.unwrap_err();
    assert_eq!(missed.to_string(), "I1 did not meet the condition within 30ms; its last value was I4(5)");
    let wrong = cell.read_until("P1", at_least(0), LIMIT).await.unwrap_err();
    assert!(matches!(wrong, Error::Value { .. }), "{wrong}");
}

#[tokio::test]
async fn a_call_has_its_own_time_limit_and_the_connection_stays_usable() {
    let sim = simulated();
    let cell = connect(&sim).await;
    assert_eq!(cell.read::<i32>("I1").await.unwrap(), 0);
    let slow = "[[fault]]\nwhen = { every = 1, of = \"Variable_GetValue\" }\nthen = { delay_ms = 2000 }\n";
    sim.application().play(Scenario::parse(slow).unwrap());
    let short = cell.within(Duration::from_millis(20));
    let late = short.read::<i32>("I1").await.unwrap_err();
    assert!(matches!(late, Error::NoReply { .. }) && !late.is_lost(), "{late:?}");
    assert_eq!(cell.read::<i32>("I1").await.unwrap(), 0);
}

#[tokio::test]
async fn a_path_names_a_variable_of_an_object_everywhere() {
    let sim = simulated();
    let cell = connect(&sim).await;
    let interval = Duration::from_millis(2);
    let mut motor = cell.subscribe(&["robot/@SERVO_ON"], interval);
    let mut wrong = cell.subscribe(&["robot/task:Pro1/@STATUS"], interval);
    assert_eq!(motor.next().await.unwrap().value.unwrap().convert(), Ok(false));
    let error = wrong.next().await.unwrap().value.unwrap_err();
    assert!(matches!(*error, Error::Path(_)), "{error}");
    cell.write("robot/@SERVO_ON", true).await.unwrap();
    assert_eq!(motor.next().await.unwrap().value.unwrap().convert(), Ok(true));
    assert!(cell.read::<bool>("robot/@SERVO_ON").await.unwrap());
    let [all] = cell.read_all(["robot/@SERVO_ON"]).await.unwrap();
    let each = cell.read_each(&["robot/@SERVO_ON", "task/x", "I1"]).await.unwrap();
    let [(_, motor_on), (_, refused), (_, count)] = each.as_slice() else { panic!("{each:?}") };
    assert_eq!((all.convert(), motor_on.as_ref().unwrap().convert()), (Ok(true), Ok(true)));
    assert!(matches!(refused, Err(Error::Path(_))), "{refused:?}");
    assert_eq!(count.as_ref().unwrap().convert(), Ok(0));
    cell.write("robot/@SERVO_ON", false).await.unwrap();
    cell.close().await.unwrap();
    sim.assert_left();
}

#[tokio::test]
async fn in_memory_a_long_motion_takes_no_time() {
    let network = Network::new(Config::new(Profile::Rc8));
    let cell = Controller::over(network.connect(), &settings()).await.unwrap();
    assert!(matches!(cell.stopper().await, Err(Error::NoAddress)));
    let stopper = Stopper::over(network.connect(), &settings()).await.unwrap();
    assert_eq!(stopper.halt().await.unwrap(), Halted::NothingMoved);
    let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
    arm.motor_on().await.unwrap();
    let begun = network.now();
    assert_eq!(arm.move_to(&to(80.0).speed_percent(1.0), LIMIT * 10).await.unwrap(), Motion::Arrived);
    let seconds = network.now().saturating_since(begun).as_secs();
    assert!(seconds > 20, "{seconds} s");
    let mut counts = cell.subscribe(&["I1"], Duration::from_secs(1));
    assert_eq!(counts.next().await.unwrap().value.unwrap().convert::<i32>().unwrap(), 0);
    arm.give().await.unwrap();
    cell.close().await.unwrap();
    assert_eq!(network.controller().arm_owner(), None);
}

#[tokio::test]
async fn a_lost_session_ends_the_arm_and_a_new_one_begins() {
    let sim = simulated();
    // a relay, because a server has no function to close one connection
    let relay = Relay::tcp(sim.tcp);
    let cell = Controller::spawn(&format!("tcp:{}", relay.tcp), &settings()).unwrap();
    cell.connected().await.unwrap();
    let mut states = cell.states();
    assert_eq!(states.next().await, Some(State::Connected));
    let mut counts = cell.subscribe(&["I1"], Duration::from_millis(1));
    assert_eq!(counts.next().await.unwrap().value.unwrap().convert::<i32>(), Ok(0));
    let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
    arm.motor_on().await.unwrap();
    let lost = async {
        until(&sim, Simulated::is_moving).await;
        relay.cut(Cut::Fin);
    };
    let (motion, ()) = tokio::join!(arm.move_to(&far(), LIMIT), lost);
    assert!(matches!(motion, Err(Error::NoReply { .. } | Error::NotConnected { .. })), "{motion:?}");
    let error = counts.next().await.unwrap().value.unwrap_err();
    assert!(matches!(*error, Error::NotConnected { .. } | Error::NoReply { .. }), "{error}");
    let Some(State::Disconnected { reason, retry_in }) = states.next().await else { panic!("{:?}", cell.state()) };
    assert!(!reason.is_empty() && retry_in <= Duration::from_millis(20), "{reason} {retry_in:?}");
    assert!(matches!(cell.read::<i32>("I1").await, Err(Error::NotConnected { .. })));
    relay.heal();
    cell.connected().await.unwrap();
    assert!(matches!(arm.motor_on().await, Err(Error::ArmLost)));
    assert!(matches!(arm.move_to(&to(1.0), LIMIT).await, Err(Error::ArmLost)));
    assert_eq!(cell.read::<i32>("I1").await.unwrap(), 0);
    loop {
        // the value is reported again, because it was unknown in between
        if let Ok(value) = counts.next().await.unwrap().value {
            assert_eq!(value.convert::<i32>(), Ok(0));
            break;
        }
    }
    let statistics = cell.statistics();
    assert_eq!((statistics.connections, statistics.losses), (2, 1));
    drop(arm);
    cell.close().await.unwrap();
    until(&sim, |sim| sim.open_objects() == 0).await;
}
