//! Sparkplug B with a host of another make: pysparkplug, a package of PyPI, which the test installs.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, ChildStdin, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use crate::common::{Robot, Running};
use bcap_fleet::{CommandResult, Event};
use bcap_tests::mosquitto::Mosquitto;
use bcap_tests::python::Python;
use bcap_tests::tools;
use serde_json::{Value, json};

const PACKAGES: [&str; 2] = ["pysparkplug==0.6.1", "paho-mqtt==1.6.1"];

/// The host as a process.
struct Host {
    child: Child,
    input: ChildStdin,
    lines: Receiver<Value>,
}

impl Drop for Host {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Host {
    /// Starts the host, and waits until it is connected and has subscribed.
    fn start(python: &Python, port: u16) -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/host.py");
        let mut child = python
            .command()
            .arg(script)
            .arg(port.to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (input, output) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                drop(sender.send(serde_json::from_str(&line).unwrap()));
            }
        });
        let host = Self { child, input, lines };
        host.find(|message| message.get("type").is_none());
        host
    }

    /// Waits for a message that a function accepts.
    fn find(&self, accept: impl Fn(&Value) -> bool) -> Value {
        loop {
            let message = self.lines.recv_timeout(Duration::from_secs(30)).expect("no message arrived in time");
            if accept(&message) {
                return message;
            }
        }
    }

    fn send(&mut self, line: &str) {
        writeln!(self.input, "{line}").unwrap();
    }
}

fn config(port: u16, robot: &Robot) -> String {
    format!(
        "group = \"plant\"\nnode = \"edge1\"\nformat = \"sparkplug\"\n[broker]\nhost = \"127.0.0.1\"\nport = {port}\n\
         [commands]\nallow = [\"I/1=-10..10\"]\n[[controller]]\nname = \"cell1\"\naddress = \"tcp:{}\"\n\
         [[controller.publish]]\nnames = [\"I1\", \"P1\", \"IO128\", \"S1\"]\ninterval_ms = 10\n",
        robot.address
    )
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pysparkplug_reads_births_and_data_and_writes_an_allowed_value() {
    let Some(broker) = Mosquitto::open() else { return };
    let python = match Python::with(&PACKAGES, "pysparkplug", Path::new(env!("CARGO_TARGET_TMPDIR"))) {
        Ok(python) => python,
        Err(why) => return tools::missing(&why),
    };
    let mut robot = Robot::start().await;
    robot.set(1, -5);
    let mut host = Host::start(&python, broker.port);
    let fleet = Running::start(&config(broker.port, &robot)).await;

    let node = host.find(|message| message["type"] == "NBIRTH");
    let bd_seq = node["metrics"]["bdSeq"].clone();
    assert_eq!((&bd_seq["type"], bd_seq["value"].is_u64()), (&json!("INT64"), true));
    let birth = host.find(|message| message["type"] == "DBIRTH");
    let metrics = &birth["metrics"];
    assert_eq!(metrics["I1"], json!({"value": -5, "type": "INT32", "historical": false}));
    assert_eq!((&metrics["P1/X"]["type"], &metrics["P1/X"]["value"]), (&json!("FLOAT"), &json!(0.0)));
    assert_eq!([&metrics["IO128"]["type"], &metrics["S1"]["type"]], ["BOOLEAN", "STRING"]);

    robot.set(1, 6);
    // by its alias, which the library resolves
    let i1 = |message: &Value, value| message["type"] == "DDATA" && message["metrics"]["I1"]["value"] == value;
    host.find(|message| i1(message, 6));

    fleet.accepts_commands().await;
    host.send("write cell1 I1 11");
    host.send("write cell1 I1 9");
    host.find(|message| i1(message, 9));
    assert_eq!(robot.get(1), 9);

    robot.kill().await;
    host.find(|message| message["type"] == "DDEATH" && message["device"] == "cell1");
    robot.restart().await;
    host.find(|message| message["type"] == "DBIRTH" && message["metrics"]["I1"]["value"] == 9);
    host.send("rebirth");
    assert_eq!(host.find(|message| message["type"] == "NBIRTH")["metrics"]["bdSeq"], bd_seq);
    host.find(|message| message["type"] == "DBIRTH");

    let results: Vec<_> = (fleet.stop().await.into_iter())
        .filter_map(|event| match event {
            Event::Command { result, .. } => Some(result),
            _ => None,
        })
        .collect();
    assert_eq!(results, [CommandResult::Refused, CommandResult::Done]);
    assert_eq!(host.find(|message| message["type"] == "NDEATH")["metrics"]["bdSeq"], bd_seq);
}
