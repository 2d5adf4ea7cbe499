//! Clients: our own pass, and every planted fault of a small client is caught by the case that is named with it.

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

/// Judges what `client` does, in this number of sessions.
fn judged(link: Link, sessions: usize, client: impl FnOnce(SocketAddr) + Send + 'static) -> Report {
    let judge = ClientJudge::bind(link, "127.0.0.1:0".parse().unwrap()).unwrap();
    let address = judge.address().unwrap();
    let client = thread::spawn(move || client(address));
    let report = judge.run(sessions, Duration::from_secs(20)).unwrap();
    let _ = client.join();
    report
}

/// A program with our client: every kind of provocation meets a reading call.
fn program(address: &str) -> Result<(), Error> {
    let mut cell = Controller::connect(address, &Settings::rc8())?;
    for index in 0..20 {
        match cell.read::<i32>("I1") {
            Ok(_) => {}
            // the provocation
            Err(error) => assert!(error.to_string().contains("E_FAIL"), "{index}: {error}"),
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
    let report = judged(Link::Tcp, 2, |address| {
        program(&format!("tcp:{address}")).unwrap();
        program(&format!("tcp:{address}")).unwrap();
    });
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
    assert_all_pass(&report, &["client/reserved-0", "client/reply-in-pieces", "client/two-replies-in-a-segment"]);
}

#[test]
fn there_are_cases_for_clients() {
    assert!(client_cases().count() >= 20);
}

/// A small client with a fault.
struct Small {
    wire: Wire,
    serial: u16,
    fault: &'static str,
}

impl Small {
    fn is(&self, fault: &str) -> bool {
        self.fault == fault
    }

    fn send(&mut self, function: F, args: &[Value]) -> u16 {
        let serial = self.serial;
        let reserved = if self.is("reserved-0") { serial } else { 0 };
        let frame = TestFrame { serial, reserved, code: function.0, args: args.to_vec() };
        let mut bytes = frame.to_wire(false);
        if self.is("valid-frames") && function == F::VARIABLE_GET_VALUE {
            *bytes.last_mut().unwrap() = 9;
        }
        if !self.is("serials-ascend") {
            self.serial = serial.wrapping_add(1);
        }
        self.wire.send(&bytes).unwrap();
        serial
    }

    /// Receives a reply; `None` when the client gives up.
    fn reply(&mut self, serial: u16) -> Option<(HResult, Option<Value>)> {
        // this fault is that a part of a reply is taken for all of it
        let limit = Duration::from_millis(if self.is("reply-in-pieces") { 1 } else { 5000 });
        loop {
            let bytes = match self.wire.receive(limit) {
                Received::Packet(bytes) => bytes,
                Received::Silence if self.is("reply-in-pieces") => continue,
                Received::Silence | Received::Closed => return None,
            };
            let reply = TCP.decode_packet(&bytes)?;
            let code = HResult(reply.code);
            let takes_serial = reply.serial == serial || self.is("other-serial-ignored");
            let takes_code = code != HResult::S_EXECUTING || self.is("waits-while-executing");
            if takes_serial && takes_code {
                return Some((code, reply.args.into_iter().next()));
            }
        }
    }

    fn call(&mut self, function: F, args: &[Value]) -> Option<Value> {
        let serial = self.send(function, args);
        let (code, value) = self.reply(serial)?;
        if self.is("refusal-survived") && code == HResult::E_FAIL {
            return None;
        }
        Some(value.unwrap_or(Value::Empty))
    }

    /// A session with one variable; `None` when the client gives up.
    fn session(&mut self) -> Option<()> {
        let text = Value::text;
        if !self.is("start-first") {
            let option = if self.is("wdt-option") { "WDT=10" } else { "WDT=400" };
            self.call(F::SERVICE_START, &[text(option)])?;
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
                let first = self.send(F::VARIABLE_GET_VALUE, std::slice::from_ref(&handle));
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

/// Runs the small client with a fault.
fn small(fault: &'static str) -> Report {
    judged(Link::Tcp, 1, move |address| {
        let wire = Wire::connect(Link::Tcp, address, Duration::from_secs(5)).unwrap();
        let serial = if fault == "serial-not-0" { 0 } else { 1 };
        let _ = Small { wire, serial, fault }.session();
    })
}

#[test]
fn every_fault_of_a_client_is_caught_by_its_case() {
    assert_eq!(small("").failures().collect::<Vec<_>>(), [""; 0]);
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
        let report = small(fault);
        let case = format!("client/{fault}");
        assert!(report.failures().any(|name| name == case), "{fault}: {:?}", report.failures().collect::<Vec<_>>());
    }
}
