//! The examples of bcap-std against the virtual controller.

use std::net::Ipv4Addr;
use std::time::Duration;

use bcap_core::hresult::HResult;
use bcap_core::rac::{Variable, VariableKind};
use bcap_core::variant::Variant;
use bcap_std::Settings;
use bcap_std::blocking::Controller;
use bcap_std::server::Limits;
use bcap_tests::real_time::repeated;
use bcap_tests::served::Served;
use bcap_tests::simulated::simulated;
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

#[test]
fn move_and_stop_runs() {
    let sim = simulated();
    move_and_stop::run(&sim.address()).unwrap();
    assert!((sim.application().joints()[0] - 20.0).abs() < 0.05);
    sim.assert_left();
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
    tasks::run(&sim.address()).unwrap();
    sim.assert_left();
}

#[test]
fn test_without_robot_runs() {
    test_without_robot::run().unwrap();
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
