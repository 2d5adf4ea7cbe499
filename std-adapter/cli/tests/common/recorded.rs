//! A session of variables, motion, Slave Mode, errors and RAC with a virtual controller, captured by tcpdump.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use bcap_core::bcap::server::{Handler, Request};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::rac;
use bcap_core::time;
use bcap_core::variant::{OwnedVariant, Variant};
use bcap_sim::{Controller, Profile};
use bcap_std::server::Limits;
use bcap_tests::served::Served;
use bcap_tests::slowed::Slowed;
use bcap_tests::tools;

use serde_json::Value;

use crate::common::capture::unhex;
use crate::common::running::Running;
use crate::common::{Run, bcap, bcap_with};

/// A call that a server saw: the function, the encoded arguments and the result.
pub(crate) type Seen = (String, Vec<Vec<u8>>, i64);

/// A captured session.
pub(crate) struct Recorded {
    pub(crate) file: PathBuf,
    pub(crate) seen: Vec<Seen>,
    // removes the file
    _folder: tempfile::TempDir,
}

/// The path of a session that was captured once, for golden files.
pub(crate) fn committed() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/session.pcap")
}

/// A virtual controller that records the calls it has completed.
pub(crate) struct Recording {
    controller: Slowed,
    seen: Vec<Seen>,
}

impl Recording {
    fn record(&mut self, function: &str, arguments: &[Variant<'_>], outcome: Outcome) -> Outcome {
        if let Outcome::Done(code) = outcome {
            let arguments = arguments.iter().map(|value| OwnedVariant::new(value).unwrap().as_bytes().to_vec());
            self.seen.push((function.to_owned(), arguments.collect(), code.0.into()));
        }
        outcome
    }
}

impl Handler for Recording {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: time::Instant) -> Outcome {
        let outcome = Handler::call(&mut self.controller, peer, request, reply, now);
        let arguments: Vec<_> = request.args.iter().collect();
        self.record(&request.function.to_string(), &arguments, outcome)
    }

    fn resume(
        &mut self,
        peer: PeerId,
        request: &Request<'_>,
        reply: &mut ReplyValue<'_>,
        now: time::Instant,
    ) -> Outcome {
        let outcome = Handler::resume(&mut self.controller, peer, request, reply, now);
        let arguments: Vec<_> = request.args.iter().collect();
        self.record(&request.function.to_string(), &arguments, outcome)
    }

    fn release(&mut self, peer: PeerId, request: &Request<'_>, now: time::Instant) {
        Handler::release(&mut self.controller, peer, request, now);
    }

    fn abandoned(&mut self, peer: PeerId, now: time::Instant) {
        Handler::abandoned(&mut self.controller, peer, now);
    }

    fn left(&mut self, peer: PeerId, now: time::Instant) {
        Handler::left(&mut self.controller, peer, now);
    }
}

impl rac::server::Handler for Recording {
    fn call(
        &mut self,
        peer: PeerId,
        request: &rac::Request<'_>,
        reply: &mut ReplyValue<'_>,
        now: time::Instant,
    ) -> Outcome {
        let outcome = rac::server::Handler::call(&mut self.controller, peer, request, reply, now);
        match request.value() {
            Some(value) => self.record("PUT", &[value], outcome),
            None => self.record("GET", &[], outcome),
        }
    }
}

/// A running tcpdump, which ends with the test, even if the test fails.
struct Dump(Child);

impl Drop for Dump {
    fn drop(&mut self) {
        // it may have ended already
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts tcpdump and waits until it captures; `None`, after [`tools::missing`], if it cannot.
fn tcpdump(file: &Path, ports: [u16; 3]) -> Option<Dump> {
    let [tcp, udp, rac] = ports;
    // with the protocols: another test may have a TCP server on the number of the UDP port
    let filter = format!("tcp port {tcp} or udp port {udp} or tcp port {rac}");
    // in immediate mode the kernel reserves the snap length for each packet: with the defaults it has room for 8
    let mut child = Command::new(tools::find("tcpdump")?)
        .args(["-i", "lo", "-U", "--immediate-mode", "--snapshot-length", "4096", "--buffer-size", "32768"])
        .args(["-Z", "root", "-w"])
        .arg(file)
        .arg(filter)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = String::new();
    let mut lines = BufReader::new(child.stderr.take().unwrap());
    while lines.read_line(&mut said).is_ok_and(|count| count > 0) {
        if said.contains("listening on") {
            // tcpdump must be able to write its last words
            std::thread::spawn(move || std::io::copy(&mut lines, &mut std::io::sink()));
            return Some(Dump(child));
        }
    }
    child.wait().unwrap();
    tools::missing(&format!("tcpdump cannot capture: {}", said.trim_end().replace('\n', "; ")));
    None
}

/// The values of calls as bytes, in hexadecimal digits.
fn encoded(values: &[String]) -> Vec<String> {
    let run = bcap_with(&["decode", "--reverse", "--variant", "-"], values.join("\n").as_bytes());
    assert_eq!(run.code, 0, "{run:?}");
    run.out.lines().map(str::to_owned).collect()
}

/// Asserts that `bcap decode` finds exactly the calls that the server received.
pub(crate) fn assert_as_seen(recorded: &Recorded) {
    let run = bcap(&["decode", recorded.file.to_str().unwrap(), "--json"]);
    assert_eq!(run.code, 0, "{run:?}");
    let lines: Vec<Value> = run.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let notes: Vec<_> = lines.iter().filter(|line| line.get("note").is_some()).collect();
    assert!(notes.is_empty(), "{notes:?}");
    let calls: Vec<_> = lines.iter().filter(|line| line.get("function").is_some()).collect();
    let values = calls.iter().flat_map(|call| call["args"].as_array().unwrap());
    let values: Vec<_> = values.filter_map(|argument| Some(argument.get("value")?.to_string())).collect();
    let mut values = encoded(&values).into_iter();
    let unanswered: Vec<_> = calls.iter().filter(|call| call["code"].is_null()).collect();
    assert!(unanswered.is_empty(), "{unanswered:?}");
    let call = |call: &&Value| -> Seen {
        let arguments = call["args"].as_array().unwrap().iter().filter(|argument| argument.get("value").is_some());
        let arguments = arguments.map(|_| unhex(&values.next().unwrap())).collect();
        (call["function"].as_str().unwrap().to_owned(), arguments, call["code"].as_i64().unwrap())
    };
    let (mut found, mut seen): (Vec<_>, _) = (calls.iter().map(call).collect(), recorded.seen.clone());
    // the two connections of `bcap slave` have no common order
    found.sort();
    seen.sort();
    assert!(seen.len() > 60, "{}", seen.len());
    for (found, seen) in found.iter().zip(&seen) {
        assert_eq!(found, seen);
    }
    assert_eq!(found.len(), seen.len());
    println!("{} calls, all as the server saw them", found.len());
}

/// Serves a virtual controller that records its calls.
pub(crate) fn serve() -> Served<Recording> {
    let config = bcap_sim::Config { motor_on_delay: Duration::from_millis(1), ..bcap_sim::Config::new(Profile::Rc8) };
    let controller: Slowed = Slowed(Controller::new(config));
    Served::of(Recording { controller, seen: Vec::new() }, Limits::default())
}

fn start_proxy(served: &Served<Recording>, file: &Path, options: &[&str]) -> Running {
    let [tcp, udp, rac] = [&served.tcp, &served.udp, &served.rac].map(ToString::to_string);
    let robot = ["--robot", &tcp, "--robot-udp", &udp, "--robot-rac", &rac, "--write", file.to_str().unwrap()];
    Running::start(
        &[&["proxy", "--listen", "127.0.0.1:0", "--listen-rac", "127.0.0.1:0"], &robot[..], options].concat(),
    )
}

/// Runs a session through `bcap proxy`, which records it.
pub(crate) fn proxied(options: &[&str]) -> (Recorded, Run) {
    let served = serve();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("session.pcapng");
    let proxy = start_proxy(&served, &file, options);
    run(&format!("tcp:{}", proxy.bcap), &format!("udp:{}", proxy.udp), &proxy.rac);
    let printed = proxy.interrupt();
    let seen = served.application().seen.clone();
    (Recorded { file, seen, _folder: folder }, printed)
}

/// Waits until tcpdump has written the last request of the session.
fn wait_for_the_end(file: &Path) {
    let until = Instant::now() + Duration::from_secs(30);
    while !bcap(&["decode", file.to_str().unwrap(), "--object", "S9"]).out.contains("S_OK") {
        assert!(Instant::now() < until, "tcpdump has not written the end of the session");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Runs a session through `bcap proxy` while tcpdump captures between the proxy and the server; returns the files of both.
pub(crate) fn proxied_under_tcpdump(folder: &Path) -> Option<[PathBuf; 2]> {
    let served = serve();
    let [proxied, dumped] = ["proxy.pcapng", "tcpdump.pcap"].map(|name| folder.join(name));
    let dump = tcpdump(&dumped, [served.tcp.port(), served.udp.port(), served.rac.port()])?;
    let proxy = start_proxy(&served, &proxied, &["--quiet"]);
    run(&format!("tcp:{}", proxy.bcap), &format!("udp:{}", proxy.udp), &proxy.rac);
    assert_eq!(proxy.interrupt().code, 0);
    wait_for_the_end(&dumped);
    drop(dump);
    Some([proxied, dumped])
}

/// Runs a session under tcpdump; `None` if tcpdump cannot capture.
pub(crate) fn session() -> Option<Recorded> {
    let served = serve();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("session.pcap");
    let dump = tcpdump(&file, [served.tcp.port(), served.udp.port(), served.rac.port()])?;
    run(&format!("tcp:{}", served.tcp), &format!("udp:{}", served.udp), &served.rac.to_string());
    wait_for_the_end(&file);
    drop(dump);
    let seen = served.application().seen.clone();
    Some(Recorded { file, seen, _folder: folder })
}

fn run(tcp: &str, udp: &str, rac: &str) {
    let pose = "400,0,300,180,0,180,5";
    for (robot, args, codes) in [
        (tcp, &["get", "I1", "P1", "robot/@CURRENT_POSITION"][..], &[0][..]),
        (tcp, &["put", "P1", pose], &[0]),
        (tcp, &["exec", "robot", "CurJnt"], &[0]),
        (tcp, &["exec", "robot", "Nonsense"], &[1]),
        (tcp, &["call", "Robot_Move", "robot", "3,2", "8,@E P1", "8,"], &[1]),
        // a busy machine may let the controller's buffer run empty; the calls are then others, and compared as well
        (tcp, &["slave", "cosine", "--seconds", "0.1", "--amplitude", "-1", "--yes"], &[0, 1]),
        (udp, &["put", "I1", "7"], &[0]),
        (udp, &["get", "I1", "robot/@CURRENT_ANGLE"], &[0]),
        (rac, &["rac", "get", "P1"], &[0]),
        (rac, &["rac", "put", "I1", "text"], &[2]),
        (rac, &["rac", "put", "S9", "the end"], &[0]),
    ] {
        let run = bcap(&[args, &["--robot", robot]].concat());
        assert!(codes.contains(&run.code), "{args:?}: {run:?}");
    }
}
