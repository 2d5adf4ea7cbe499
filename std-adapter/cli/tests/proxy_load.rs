//! `bcap proxy` with many connections, and between a stream of Slave Mode and the robot.

use std::path::Path;
use std::time::Duration;

use crate::common::running::Running;
use crate::common::{Run, bcap};
use bcap_sim::{Config, Controller, Profile};
use bcap_std::Settings;
use bcap_std::blocking;
use bcap_std::server::Limits;
use bcap_tests::real_time::repeated;
use bcap_tests::served::Served;
use bcap_tests::slowed::Slowed;
use serde_json::Value;

/// Starts a proxy that records to a file with this name; returns it and the file.
fn proxy(robot: &str, name: &str) -> (Running, String) {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name).to_str().unwrap().to_owned();
    (Running::start(&["proxy", "--listen", "127.0.0.1:0", "--quiet", "--write", &file, "--robot", robot]), file)
}

/// Streams a cosine through a proxy; returns the run of the command and its report.
fn slave(proxy: &Running, seconds: u32) -> (Run, Value) {
    let report = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("proxied-{seconds}.json"));
    let (robot, seconds) = (format!("tcp:{}", proxy.bcap), seconds.to_string());
    let args = ["slave", "cosine", "--amplitude", "-4", "--yes", "--robot", &robot, "--seconds", &seconds];
    let run = bcap(&[&args[..], &["--report", report.to_str().unwrap()]].concat());
    let report = std::fs::read_to_string(report).unwrap_or_else(|error| panic!("{error}: {run:?}"));
    (run, serde_json::from_str(&report).unwrap())
}

#[test]
fn a_hundred_connections_are_forwarded_and_recorded() {
    let sim = Running::sim(&[]);
    let (proxy, file) = proxy(&format!("tcp:{}", sim.bcap), "hundred.pcapng");
    let address = format!("tcp:{}", proxy.bcap);
    let mut clients: Vec<_> =
        (0..100).map(|_| blocking::Controller::connect(&address, &Settings::rc8()).unwrap()).collect();
    for round in 0..3 {
        for (client, index) in clients.iter_mut().zip(0..) {
            client.write(&format!("I{index}"), 1000 * round + index).unwrap();
        }
        // each client reads the variable that the next client has written
        for (client, index) in clients.iter_mut().zip(0..) {
            let next = (index + 1) % 100;
            assert_eq!(client.read::<i32>(&format!("I{next}")).unwrap(), 1000 * round + next);
        }
    }
    clients.into_iter().for_each(|client| client.close().unwrap());
    assert_eq!(proxy.interrupt().code, 0);
    let count = |filter: &str| bcap(&["decode", &file, "--function", filter]).out.lines().count();
    assert_eq!((count("Variable_PutValue"), count("Variable_GetValue")), (300, 300));
}

#[test]
fn slave_mode_through_a_proxy_lacks_no_pose() {
    repeated(|| {
        // a controller with a slow clock, whose mode 2 paces the command: a pose that the proxy delays by a cycle is an underflow, and a
        // busy machine is not
        let config = Config { motor_on_delay: Duration::from_millis(1), ..Config::new(Profile::Rc8) };
        let sim: Served<Slowed> = Served::of(Slowed(Controller::new(config)), Limits::default());
        let (proxy, file) = proxy(&format!("tcp:{}", sim.tcp), "slave.pcapng");
        let (run, report) = slave(&proxy, 2);
        assert_eq!((run.code, &report["underflows"], &report["refused"]), (0, &0.into(), &0.into()), "{run:?}");
        assert_eq!(proxy.interrupt().code, 0);
        let controller = &sim.application().0;
        assert_eq!((controller.errors().count(), controller.slave_mode(), controller.arm_owner()), (0, 0, None));
        let lowest = controller.slave_record().map(|cycle| cycle.axes[0]).fold(0.0, f64::min);
        assert!((lowest + 4.0).abs() < 1e-3, "{lowest}");
        let recorded = bcap(&["decode", &file, "--stats"]);
        assert_eq!(recorded.code, 0, "{recorded:?}");
    });
}

/// Streams in real time through a proxy that records: `just proxy-slave`.
#[test]
#[ignore = "takes an hour on a quiet machine: `just proxy-slave`"]
fn slave_mode_through_a_proxy_in_real_time() {
    let minutes: u32 = std::env::var("MINUTES").map_or(60, |text| text.parse().expect("MINUTES is a number"));
    let sim = Running::sim(&[]);
    let (proxy, _) = proxy(&format!("tcp:{}", sim.bcap), "hour.pcapng");
    let (run, report) = slave(&proxy, 60 * minutes);
    println!("{minutes} minutes through bcap proxy: {report}");
    assert_eq!((run.code, &report["underflows"]), (0, &0.into()), "{run:?}");
}
