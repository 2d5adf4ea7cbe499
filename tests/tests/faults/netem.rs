//! The same over the loopback of a network namespace whose faults the kernel's netem injects.

use std::process::{Command, Output};
use std::time::Duration;

use bcap_core::bcap::call;
use bcap_std::{Options, blocking};
use bcap_testkit::network::answer_to;
use bcap_tests::served::Served;

use crate::faults::datagrams::{call_over_udp, limits};

/// One datagram in ten is lost, one in ten doubled, one in four overtakes others; each takes up to 200 ms.
const BAD: &[&str] = &["loss", "10%", "duplicate", "10%", "delay", "100ms", "100ms", "reorder", "25%", "50%"];

/// A network namespace, which goes when this does.
struct Namespace(String);

impl Namespace {
    /// Makes a namespace whose loopback is a bad link; says why not where that cannot be.
    fn new() -> Result<Self, String> {
        let name = format!("bcap-tests-{}", std::process::id());
        run(Command::new("ip").args(["netns", "add", &name]))?;
        let namespace = Self(name);
        run(namespace.inside("ip").args(["link", "set", "lo", "up"]))?;
        run(namespace.inside("tc").args(["qdisc", "add", "dev", "lo", "root", "netem"]).args(BAD))?;
        Ok(namespace)
    }

    fn inside(&self, program: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.0, program]);
        command
    }
}

impl Drop for Namespace {
    fn drop(&mut self) {
        let _ = Command::new("ip").args(["netns", "del", &self.0]).status();
    }
}

/// Runs a command, or says why it did not work.
fn run(command: &mut Command) -> Result<Output, String> {
    let output = command.output().map_err(|error| format!("{:?}: {error}", command.get_program()))?;
    if output.status.success() {
        return Ok(output);
    }
    let said = String::from_utf8_lossy(&output.stderr);
    Err(format!("{command:?}: {}", said.lines().next().unwrap_or("it failed")))
}

#[test]
fn a_bad_link_of_the_kernel_carries_every_call_once() {
    let namespace = match Namespace::new() {
        Ok(namespace) => namespace,
        Err(why) => return println!("skipped, there is no netem here: {why}"),
    };
    let program = std::env::current_exe().unwrap();
    let mut command = namespace.inside(program.to_str().expect("a path of text"));
    let output = run(command.args(["--exact", "faults::netem::on_this_link", "--ignored", "--nocapture"])).unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    print!("{said}");
    assert!(said.contains("1 passed"), "the test that runs there has another name");
}

/// Calls over UDP and TCP on the link that is there, in a namespace that the test above has made.
#[test]
#[ignore = "a_bad_link_of_the_kernel_carries_every_call_once runs it in a namespace"]
fn on_this_link() {
    let server = Served::start(limits());
    let mut client = blocking::connect_tcp(server.tcp, &Options::default().timeout(Duration::from_secs(30))).unwrap();
    client.call(call::service_start("")).unwrap();
    let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
    for token in -20..0 {
        let answer = client.call(call::controller_execute(controller, "token", [token, 0])).unwrap();
        assert_eq!(answer.as_i32(), Some(answer_to(token)));
    }
    drop(client);
    let address = server.udp;
    let (done, failed) = call_over_udp(server, address, 1000, Duration::from_millis(400));
    println!("behind netem: {done} calls done and executed once, {failed} given up and executed at most once");
    assert!(done > 900, "{failed} of 1000 given up");
}
