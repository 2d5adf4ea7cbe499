//! The example plant of docs/fleet.md: `bcap sim`, `bcap put`, `bcap-fleet` and Mosquitto, as processes.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::common::{fleet, fleet_program};
use bcap_tests::mosquitto::Mosquitto;
use bcap_tests::process::{Signal, send};
use rumqttc::{Client, MqttOptions, Packet, QoS};

#[test]
fn the_demo_plant_of_the_page_runs() {
    // the script starts another broker
    let Some(broker) = Mosquitto::open() else { return };
    let port = broker.port;
    drop(broker);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/plant/run");
    let mut command = Command::new(script);
    command.arg(port.to_string()).env("BCAP", env!("CARGO_BIN_EXE_bcap")).env("BCAP_FLEET", fleet_program());
    command.stdout(Stdio::piped());
    let mut plant = command.spawn().unwrap();
    let mut lines = BufReader::new(plant.stdout.take().unwrap()).lines().map(Result::unwrap);
    let config = lines.find_map(|line| line.strip_prefix("config ").map(str::to_owned)).unwrap();
    lines.find(|line| line.starts_with("ready controllers=3 ")).unwrap();
    // a pipe that is full would stop the script
    let rest = std::thread::spawn(move || lines.count());

    let mut options = MqttOptions::new("test", ("127.0.0.1", port));
    options.set_max_packet_size(1 << 20, 1 << 20);
    let (client, mut connection) = Client::builder(options).capacity(10).build();
    client.subscribe("bcap/demo/#", QoS::AtLeastOnce).unwrap();
    let mut waiting: Vec<_> = ["I1", "tasks"].into_iter().flat_map(|name| (1..=3).map(move |n| (n, name))).collect();
    let messages = connection.iter().filter_map(|event| match event.unwrap() {
        rumqttc::Event::Incoming(Packet::Publish(publish)) => Some(publish),
        _ => None,
    });
    for publish in messages {
        let json: serde_json::Value = serde_json::from_slice(&publish.payload).unwrap();
        let is_counted = json["value"].as_i64() >= Some(2);
        let has_tasks = json["value"]["Pro1"] == "ready";
        waiting.retain(|(n, name)| publish.topic != format!("bcap/demo/cell{n}/{name}") || !(is_counted || has_tasks));
        if waiting.is_empty() {
            break;
        }
    }
    let check = fleet(&[&config, "--check"]);
    assert_eq!(check.code, 0, "{check:?}");
    let rows = |name: &str| check.out.lines().filter(|line| line.split_whitespace().nth(1) == Some(name)).count();
    assert_eq!((check.out.lines().count(), rows("I1"), rows("tasks")), (1 + 3 * 7, 3, 3), "{}", check.out);

    send(Signal::TERM, &plant);
    assert_eq!(plant.wait().unwrap().code(), Some(0));
    // all of its processes have ended, so that the pipe is closed
    rest.join().unwrap();
    assert!(!Path::new(&config).exists());
}
