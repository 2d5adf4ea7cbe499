//! The examples of bcap-std against the virtual controller.

use std::net::Ipv4Addr;
use std::sync::mpsc;
use std::time::Duration;
use std::{iter, thread};

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::hresult::HResult;
use bcap_core::rac::{Variable, VariableKind};
use bcap_core::variant::Variant;
use bcap_sim::memory::Network;
use bcap_sim::{Config, Profile, Scenario, TaskStatus};
use bcap_std::blocking::Controller;
use bcap_std::server::Limits;
use bcap_std::{Motion, Settings};
use bcap_tests::hooked::Hooked;
use bcap_tests::real_time::repeated;
use bcap_tests::served::Served;
use bcap_tests::simulated::{quick, simulated};
use tokio::net::TcpListener;
use tokio::sync::oneshot;

macro_rules! examples {
    ($($name:ident $path:literal;)*) => {$(
        #[path = $path]
        #[expect(dead_code, reason = "an example has a main function")]
        mod $name;
    )*};
}

examples! {
    device_server "../../std-adapter/examples/device_server.rs";
    gateway "../../std-adapter/examples/gateway.rs";
    move_and_stop "../../std-adapter/examples/move_and_stop.rs";
    read_write "../../std-adapter/examples/read_write.rs";
    reconnecting_fleet "../../std-adapter/examples/reconnecting_fleet.rs";
    scan "../../std-adapter/examples/scan.rs";
    slave_cosine "../../std-adapter/examples/slave_cosine.rs";
    tasks "../../std-adapter/examples/tasks.rs";
    test_without_robot "../../std-adapter/examples/test_without_robot.rs";
}

#[test]
fn read_write_runs() {
    let sim = simulated();
    read_write::run(&sim.address()).unwrap();
    sim.assert_left();
}

/// A virtual RC8 whose calls can be held back or refused.
type HookedSim = Served<Hooked<bcap_sim::Controller>>;

fn hooked(config: Config) -> (HookedSim, String) {
    let sim = Served::of(Hooked::new(bcap_sim::Controller::new(config)), Limits::default());
    let address = format!("tcp:{}", sim.tcp);
    (sim, address)
}

/// The configuration of a robot that needs a minute for the motion of an example.
fn slow() -> Config {
    Config { speed: 1.0, ..quick(Profile::Rc8) }
}

#[test]
fn move_and_stop_runs() {
    let sim = simulated();
    move_and_stop::run(&sim.address(), iter::empty()).unwrap();
    assert!((sim.application().joints()[0] - 20.0).abs() < 0.05);
    sim.assert_left();
}

/// Returns how far the first joint turns if a line of the input halts the robot while the controller delays a call.
fn turned_after_a_stop_during(call: impl Fn(&Request<'_>) -> bool + Send + 'static) -> f64 {
    let (sim, address) = hooked(slow());
    let before = sim.application().inner.joints()[0];
    let (release, released) = mpsc::channel();
    let held = sim.application().hold(call, released);
    let mut is_entered = false;
    let lines = iter::from_fn(move || {
        if is_entered {
            // the halt of the first line has returned
            release.send(()).unwrap();
            return None;
        }
        is_entered = true;
        held.recv().unwrap();
        Some(Vec::new())
    });
    move_and_stop::run(&address, lines).unwrap();
    let sim = &sim.application().inner;
    assert_eq!((sim.arm_owner(), sim.motor_is_on(), sim.is_moving()), (None, false, false));
    (sim.joints()[0] - before).abs()
}

#[test]
fn a_stop_before_the_motion_prevents_it() {
    for command in ["TakeArm", "Motor"] {
        let turned = turned_after_a_stop_during(move |request| {
            request.function == FunctionId::ROBOT_EXECUTE && request.text(1).eq_ignore_ascii_case(command)
        });
        assert!(turned < 1e-6, "a stop during {command}: the first joint turned by {turned} degrees");
    }
}

#[test]
fn a_stop_while_the_motion_is_sent_halts_it() {
    let turned = turned_after_a_stop_during(|request| request.function == FunctionId::ROBOT_MOVE);
    assert!(turned < 15.0, "the first joint turned by {turned} degrees");
}

#[test]
fn move_and_stop_fails_unless_the_robot_arrives_or_is_halted() {
    let sim = Served::of(bcap_sim::Controller::new(slow()), Limits::default());
    let (enter, entered) = mpsc::channel();
    let address = sim.address();
    let halted = thread::spawn(move || move_and_stop::run(&address, entered.into_iter()).is_ok());
    sim.until(bcap_sim::Controller::is_moving);
    enter.send(Vec::new()).unwrap();
    assert!(halted.join().unwrap(), "it was halted");
    sim.clear();

    let address = sim.address();
    let failed = thread::spawn(move || move_and_stop::run(&address, iter::empty()).is_err());
    sim.until(bcap_sim::Controller::is_moving);
    sim.application().emergency_stop(true, bcap_std::now());
    assert!(failed.join().unwrap(), "the emergency stop ended the motion");
    assert!(sim.application().joints()[0] < 19.0);
}

#[test]
fn slave_cosine_runs() {
    repeated(|| {
        let sim = simulated();
        let before = sim.application().joints()[0];
        slave_cosine::run(&format!("udp:{}", sim.udp), 250).unwrap_or_else(|error| panic!("{error}"));
        assert!((sim.application().joints()[0] - before).abs() < 0.01, "it ends where it began");
        sim.assert_left();
    });
}

#[test]
fn tasks_runs() {
    let sim = simulated();
    tasks::run(&sim.address(), Duration::from_secs(60)).unwrap();
    sim.assert_left();
}

#[test]
fn tasks_stops_its_task_before_it_returns_an_error() {
    let (sim, address) = hooked(quick(Profile::Rc8));
    sim.application().set(|request| {
        let is_status = request.function == FunctionId::TASK_EXECUTE && request.text(1) == "GetStatus";
        is_status.then_some(HResult::E_FAIL)
    });
    tasks::run(&address, Duration::from_secs(60)).unwrap_err();
    let end = bcap_std::now() + Duration::from_secs(10);
    while is_running(&sim) {
        assert!(bcap_std::now() < end, "Pro1 runs after the end of the program");
        thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn tasks_does_not_wait_forever_for_its_task() {
    let (sim, address) = hooked(quick(Profile::Rc8));
    let mut is_ignored = true;
    // the first stop has no effect
    sim.application().set(move |request| {
        let is_stop = request.function == FunctionId::TASK_STOP;
        (is_stop && std::mem::take(&mut is_ignored)).then_some(HResult::S_OK)
    });
    let (sender, ended) = mpsc::channel();
    thread::spawn(move || sender.send(tasks::run(&address, Duration::from_millis(100)).is_err()));
    assert_eq!(ended.recv_timeout(Duration::from_secs(30)), Ok(true), "it ends, with an error");
    assert!(!is_running(&sim));
}

fn is_running(sim: &HookedSim) -> bool {
    let sim = &mut sim.application().inner;
    sim.advance(bcap_std::now());
    sim.task("Pro1").unwrap().0 == TaskStatus::Running
}

#[test]
fn test_without_robot_runs() {
    test_without_robot::run().unwrap();
}

#[test]
fn test_without_robot_counts_only_motions_that_arrive() {
    // the motion needs more than its time limit
    let network = Network::new(Config { speed: 1.0, ..Config::new(Profile::Rc8) });
    let mut cell = Controller::over(network.connect(), &Settings::rc8()).unwrap();
    assert_eq!(test_without_robot::program(&mut cell).unwrap(), Motion::TimedOut);
    assert_eq!(cell.read::<i32>("I1").unwrap(), 0);
}

#[test]
fn test_without_robot_reports_an_arm_that_is_not_given_back() {
    let network = Network::new(Config::new(Profile::Rc8));
    let text = "[[fault]]\nwhen = { call = 1, of = 'GiveArm' }\nthen = { refuse = 'E_FAIL' }";
    network.controller().play(Scenario::parse(text).unwrap());
    let mut cell = Controller::over(network.connect(), &Settings::rc8()).unwrap();
    assert_eq!(test_without_robot::program(&mut cell).unwrap_err().code(), Some(HResult::E_FAIL));
}

#[tokio::test]
async fn scan_runs() {
    let sim = simulated();
    scan::run(&sim.address(), 2).await.unwrap();
    sim.assert_left();
}

#[tokio::test]
async fn reconnecting_fleet_runs() {
    let (first, second) = (simulated(), simulated());
    let counted = async {
        for sim in [&first, &second] {
            let mut rac = bcap_std::asynch::connect_rac(sim.rac, &Default::default()).await.unwrap();
            while rac.get(Variable::new(VariableKind::I, 1)).await.unwrap() != Variant::I4(1) {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        }
    };
    reconnecting_fleet::run(&[first.address(), second.address()], counted).await.unwrap();
    assert!(reconnecting_fleet::run(&["robot".into()], async {}).await.is_err());
}

#[tokio::test]
async fn gateway_runs() {
    let sim = simulated();
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
    let plc = listener.local_addr().unwrap();
    let (end, ended) = oneshot::channel::<()>();
    let robot = (sim.tcp.ip().to_string(), sim.tcp.port());
    let gateway = tokio::spawn(gateway::run(listener, robot, async { drop(ended.await) }));
    let mut rac = bcap_std::asynch::connect_rac(plc, &Default::default()).await.unwrap();
    let count = Variable::new(VariableKind::I, 1);
    // until the gateway has its robot, it refuses
    while rac.put(count, Variant::I4(7)).await.is_err() {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    assert_eq!(rac.get(count).await.unwrap(), Variant::I4(7));
    assert!(rac.put(Variable::new(VariableKind::I, 100), Variant::I4(7)).await.is_err(), "no rule permits it");
    drop(end);
    gateway.await.unwrap().unwrap();
}

#[test]
fn a_device_of_a_table_is_a_controller() {
    let served = Served::of(device_server::device(), Limits::default());
    let mut cell = Controller::connect(&format!("tcp:{}", served.tcp), &Settings::rc9()).unwrap();
    assert_eq!(cell.read::<i32>("I1").unwrap(), 0);
    cell.write("F1", 0.5_f32).unwrap();
    let refused = cell.write("I1", 1).unwrap_err();
    assert_eq!(refused.code(), Some(HResult::E_ACCESSDENIED));
    let mut rac = bcap_std::blocking::connect_rac(served.rac, &Default::default()).unwrap();
    assert_eq!(rac.get(Variable::new(VariableKind::F, 1)).unwrap(), Variant::R4(0.5));
    cell.close().unwrap();
}
