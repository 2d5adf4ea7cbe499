//! Clients: our own clients pass, and every planted fault of a small client is caught by the case named with it.

use std::net::SocketAddr;
use std::thread;
use std::time::Duration;

use bcap_conform::{ClientJudge, Link, Report, Verdict, client_cases};
use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;
use bcap_std::blocking::Controller;
use bcap_std::{Error, Settings};
use bcap_testkit::frame::TestFrame;
use bcap_testkit::judge::TCP;
use bcap_testkit::value::Value;
use bcap_testkit::wire::{Received, Wire};

/// Judges `client` in this number of sessions.
fn judged(link: Link, sessions: usize, client: impl FnOnce(SocketAddr) + Send + 'static) -> Report {
    let judge = ClientJudge::bind(link, "127.0.0.1:0".parse().unwrap()).unwrap();
    let address = judge.address().unwrap();
    let client = thread::spawn(move || client(address));
    let report = judge.run(sessions, Duration::from_secs(20)).unwrap();
    let _ = client.join();
    report
}

/// A program with our client: every kind of provocation happens to a call that reads. After the end of its connection the
/// program connects again.
fn program(address: &str) -> Result<(), Error> {
    let mut cell = Controller::connect(address, &Settings::rc8())?;
    for _ in 0..20 {
        match cell.read::<i32>("I1") {
            // the provocations
            Ok(_) | Err(Error::Refused { code: HResult::E_FAIL, .. } | Error::NoReply { .. }) => {}
            Err(Error::NotConnected { .. }) => {
                drop(cell);
                return program(address);
            }
            Err(error) => return Err(error),
        }
    }
    cell.write("I2", 5)?;
    cell.close()
}

fn assert_all_pass(report: &Report, skipped: &[&str]) {
    for result in &report.results {
        println!("{}", result.text());
    }
    assert_eq!(report.failures().collect::<Vec<_>>(), [""; 0]);
    let left = report.results.iter().filter(|result| result.verdict == Verdict::Skip);
    assert_eq!(left.map(|result| result.name.as_str()).collect::<Vec<_>>(), skipped);
}

#[test]
fn our_client_passes_over_tcp() {
    let report = judged(Link::Tcp, 2, |address| program(&format!("tcp:{address}")).unwrap());
    assert_all_pass(
        &report,
        &[
            "client/marker",
            "client/datagram-size",
            "client/retry-after-loss",
            "client/retry-has-a-new-serial",
            "client/retry-is-the-same-call",
            "client/foreign-datagram-ignored",
        ],
    );
}

#[test]
fn our_client_passes_over_udp() {
    let report = judged(Link::Udp, 1, |address| program(&format!("udp:{address}")).unwrap());
    assert_all_pass(
        &report,
        &[
            "client/reserved-0",
            "client/reply-in-pieces",
            "client/two-replies-in-a-segment",
            "client/keep-alive-and-a-part",
            "client/close-noticed",
        ],
    );
}

#[test]
fn there_are_cases_for_clients() {
    assert!(client_cases().count() >= 20);
}

/// A small client with a fault.
struct Small {
    wire: Wire,
    link: Link,
    serial: u16,
    fault: &'static str,
    /// The option of Service_Start.
    option: &'static str,
    /// The time limit of an attempt. Over UDP the client then repeats the call, over TCP it continues with its next call.
    attempt: Duration,
}

impl Small {
    /// Connects a client whose attempts take longer than any pause of the judge.
    fn connect(address: SocketAddr, link: Link, fault: &'static str) -> Self {
        let wire = Wire::connect(link, address, Duration::from_secs(5)).unwrap();
        let serial = if fault == "serial-not-0" { 0 } else { 1 };
        let option = if fault == "wdt-option" { "WDT=10" } else { "WDT=400" };
        Self { wire, link, serial, fault, option, attempt: Duration::from_millis(1500) }
    }

    fn is(&self, fault: &str) -> bool {
        self.fault == fault
    }

    /// Sends a call; `first` is the serial of its first attempt.
    fn send(&mut self, function: F, args: &[Value], first: Option<u16>) -> u16 {
        // this fault is a retransmission with the serial of the first attempt
        let serial = first.filter(|_| self.is("retry-has-a-new-serial")).unwrap_or(self.serial);
        let marker = if self.link == Link::Udp { first.unwrap_or(serial) } else { 0 };
        let reserved = if self.is("reserved-0") { serial } else { marker };
        let frame = TestFrame { serial, reserved, code: function.0, args: args.to_vec() };
        let mut bytes = frame.to_wire(false);
        if self.is("valid-frames") && function == F::VARIABLE_GET_VALUE {
            *bytes.last_mut().unwrap() = 9;
        }
        if !self.is("serials-ascend") {
            self.serial = serial.wrapping_add(1);
        }
        // fails if the judge has closed the connection; the missing reply then ends the call
        let _ = self.wire.send(&bytes);
        serial
    }

    /// Receives the reply to an attempt since this one; `None` when the client abandons the call.
    fn reply(&mut self, serial: u16) -> Result<(HResult, Option<Value>), Received> {
        // this fault is that a part of a reply is taken for the whole reply
        let limit = if self.is("reply-in-pieces") { Duration::from_millis(1) } else { self.attempt };
        loop {
            let bytes = match self.wire.receive(limit) {
                Received::Packet(bytes) => bytes,
                Received::Silence if self.is("reply-in-pieces") => continue,
                end => return Err(end),
            };
            let Some(reply) = TCP.decode_packet(&bytes) else { return Err(Received::Closed) };
            let code = HResult(reply.code);
            if code == HResult::S_EXECUTING && self.is("keep-alive-and-a-part") {
                // the rest of the segment is lost
                let _ = self.wire.receive(Duration::from_millis(1));
            }
            let takes_serial = (serial..self.serial.max(serial + 1)).contains(&reply.serial)
                || self.is("other-serial-ignored")
                || self.is("late-reply-dropped");
            let takes_code = code != HResult::S_EXECUTING || self.is("waits-while-executing");
            if takes_serial && takes_code {
                return Ok((code, reply.args.into_iter().next()));
            }
        }
    }

    /// Makes a call, and returns its value; `None` when the client abandons the call.
    fn call(&mut self, function: F, args: &[Value]) -> Option<Value> {
        let first = self.send(function, args, None);
        loop {
            return match self.reply(first) {
                Ok((HResult::E_FAIL, _)) if self.is("refusal-survived") => None,
                Ok((_, value)) => Some(value.unwrap_or(Value::Empty)),
                Err(Received::Silence) if self.link == Link::Udp && !self.is("retry-after-loss") => {
                    self.send(function, args, Some(first));
                    continue;
                }
                Err(Received::Silence) => Some(Value::Empty),
                Err(_) => self.is("close-noticed").then_some(Value::Empty),
            };
        }
    }

    /// A session with one variable; `None` when the client abandons the call.
    fn session(&mut self) -> Option<()> {
        let text = Value::text;
        if !self.is("start-first") {
            self.call(F::SERVICE_START, &[text(self.option)])?;
        }
        let mut connect = vec![text(""), text("CaoProv.DENSO.VRC"), text("localhost"), text("")];
        if self.is("argument-count") {
            connect.pop();
        }
        if self.is("argument-types") {
            connect[0] = Value::R8(1.5_f64.to_bits());
        }
        let controller = self.call(F::CONTROLLER_CONNECT, &connect)?;
        let variable = self.call(F::CONTROLLER_GET_VARIABLE, &[controller.clone(), text("I1"), text("")])?;
        if self.is("known-functions") {
            self.call(F(200), &[])?;
        }
        for _ in 0..10 {
            let handle = match self.fault {
                "handles-of-the-kind" => controller.clone(),
                "handles-are-i4" => Value::R8(2.0_f64.to_bits()),
                "handles-are-open" => Value::I4(4711),
                _ => variable.clone(),
            };
            if self.is("one-at-a-time") {
                let first = self.send(F::VARIABLE_GET_VALUE, std::slice::from_ref(&handle), None);
                self.call(F::CONTROLLER_GET_NAME, std::slice::from_ref(&controller));
                let _ = first;
            } else {
                self.call(F::VARIABLE_GET_VALUE, &[handle])?;
            }
        }
        if !self.is("objects-released") {
            self.call(F::VARIABLE_RELEASE, std::slice::from_ref(&variable))?;
            self.call(F::CONTROLLER_DISCONNECT, &[controller])?;
        }
        if !self.is("stop-at-the-end") {
            self.call(F::SERVICE_STOP, &[])?;
        }
        if self.is("nothing-after-stop") {
            self.call(F::VARIABLE_GET_VALUE, &[variable])?;
        }
        Some(())
    }
}

/// Runs the small client with a fault in this number of sessions.
fn small(fault: &'static str, sessions: usize) -> Report {
    judged(Link::Tcp, sessions, move |address| {
        for _ in 0..sessions {
            let _ = Small::connect(address, Link::Tcp, fault).session();
        }
    })
}

fn failures(report: &Report) -> Vec<&str> {
    report.failures().collect()
}

/// Some retries arrive while the judge waits, others cross its reply.
#[test]
fn a_client_that_retries_early_is_right() {
    for attempt in [10, 50, 100] {
        let report = judged(Link::Udp, 1, move |address| {
            let small = Small::connect(address, Link::Udp, "");
            let done = Small { attempt: Duration::from_millis(attempt), ..small }.session();
            assert_eq!(done, Some(()));
        });
        assert_eq!(failures(&report), [""; 0], "{attempt} ms: {:?}", report.results);
        let passed = |name: &str| report.results.iter().any(|r| r.name == name && r.verdict == Verdict::Pass);
        for case in ["other-serial-ignored", "foreign-datagram-ignored", "retry-after-loss", "late-reply-dropped"] {
            assert!(passed(&format!("client/{case}")), "{attempt} ms: {case}: {:?}", report.results);
        }
    }
}

/// Runs the small client over UDP with a fault.
fn small_over_udp(fault: &'static str) -> Report {
    judged(Link::Udp, 1, move |address| {
        let _ = Small::connect(address, Link::Udp, fault).session();
    })
}

/// After a client abandons a call without a reply, its next call is not a retransmission.
#[test]
fn a_client_that_does_not_retry_fails_for_this_alone() {
    let report = small_over_udp("retry-after-loss");
    assert_eq!(failures(&report), ["client/retry-after-loss"], "{:?}", report.results);
}

#[test]
fn a_retry_with_the_serial_of_the_first_attempt_fails() {
    let report = small_over_udp("retry-has-a-new-serial");
    assert!(failures(&report).contains(&"client/retry-has-a-new-serial"), "{:?}", report.results);
    assert!(!failures(&report).contains(&"client/retry-after-loss"), "{:?}", report.results);
}

#[test]
fn a_second_session_on_one_connection_needs_a_stop_too() {
    for (fault, failing) in [("", &[][..]), ("stop-at-the-end", &["client/stop-at-the-end"][..])] {
        let report = judged(Link::Tcp, 1, move |address| {
            let mut small = Small::connect(address, Link::Tcp, "");
            assert_eq!(small.session(), Some(()));
            small.fault = fault;
            assert_eq!(small.session(), Some(()));
        });
        assert_eq!(failures(&report), failing, "{:?}", report.results);
    }
}

#[test]
fn every_form_of_the_option_wdt_is_judged() {
    for (option, verdict) in [
        ("WDT=(400)", Verdict::Pass),
        ("WDT=0x190", Verdict::Pass),
        ("wdt=10", Verdict::Fail),
        ("WDT = 10", Verdict::Fail),
        (" wdt = [ 0x190 ] , WDT=10", Verdict::Pass),
        ("Other=400,WDT=<0x10>", Verdict::Fail),
        ("InvokeTimeout=180000", Verdict::Skip),
    ] {
        let report = judged(Link::Tcp, 1, move |address| {
            let _ = Small { option, ..Small::connect(address, Link::Tcp, "") }.session();
        });
        let result = report.results.iter().find(|result| result.name == "client/wdt-option").unwrap();
        assert_eq!(result.verdict, verdict, "{option}: {}", result.text());
    }
}

/// A request that precedes the reply is one fault: the request is answered later, and the rest of the session is correct.
#[test]
fn a_request_before_the_reply_is_the_only_failure() {
    let report = small("waits-while-executing", 1);
    let caused = ["client/one-at-a-time", "client/waits-while-executing", "client/keep-alive-and-a-part"];
    assert_eq!(failures(&report), caused, "{:?}", report.results);
}

#[test]
fn faults_after_which_a_client_may_connect_again_are_caught() {
    let report = small("", 2);
    assert_eq!(failures(&report), [""; 0], "{:?}", report.results);
    for case in ["keep-alive-and-a-part", "late-reply-dropped", "close-noticed"] {
        let result = report.results.iter().find(|result| result.name.ends_with(case)).unwrap();
        assert_eq!(result.verdict, Verdict::Pass, "{}", result.text());
        let report = small(case, 2);
        assert!(failures(&report).contains(&result.name.as_str()), "{case}: {:?}", failures(&report));
    }
}

#[test]
fn every_fault_of_a_client_is_caught_by_its_case() {
    assert_eq!(failures(&small("", 1)), [""; 0]);
    let faults = [
        "valid-frames",
        "serial-not-0",
        "serials-ascend",
        "reserved-0",
        "one-at-a-time",
        "start-first",
        "known-functions",
        "argument-count",
        "argument-types",
        "handles-are-i4",
        "handles-are-open",
        "handles-of-the-kind",
        "wdt-option",
        "objects-released",
        "stop-at-the-end",
        "nothing-after-stop",
        "waits-while-executing",
        "other-serial-ignored",
        "reply-in-pieces",
        "refusal-survived",
    ];
    for fault in faults {
        let (report, case) = (small(fault, 1), format!("client/{fault}"));
        assert!(failures(&report).contains(&&*case), "{fault}: {:?}", failures(&report));
    }
}
