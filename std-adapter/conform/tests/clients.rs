//! Clients: our own pass, and every planted fault of a small client is caught by the case that is named with it.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::thread;
use std::time::Duration;

use bcap_conform::{ClientJudge, Link, Report, Verdict, client_cases};
use bcap_core::bcap::{Decoder, FrameWriter, FunctionId as F, Progress};
use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant;
use bcap_std::blocking::Controller;
use bcap_std::{Error, Settings};

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
    stream: TcpStream,
    serial: u16,
    fault: &'static str,
    received: Vec<u8>,
}

impl Small {
    fn is(&self, fault: &str) -> bool {
        self.fault == fault
    }

    fn send(&mut self, function: F, args: &[OwnedVariant]) -> u16 {
        let is_read = function == F::VARIABLE_GET_VALUE;
        let mut buffer = [0; 512];
        let mut frame = FrameWriter::new(&mut buffer).unwrap();
        args.iter().for_each(|value| frame.argument(&value.as_variant()).unwrap());
        let serial = self.serial;
        let reserved = if self.is("reserved-0") { serial } else { 0 };
        let mut bytes = frame.finish(serial, reserved, function.0).unwrap().to_vec();
        if self.is("valid-frames") && is_read {
            *bytes.last_mut().unwrap() = 9;
        }
        if !self.is("serials-ascend") {
            self.serial = serial.wrapping_add(1);
        }
        self.stream.write_all(&bytes).unwrap();
        serial
    }

    /// Receives a reply; `None` when the client gives up.
    fn reply(&mut self, serial: u16) -> Option<(HResult, Option<OwnedVariant>)> {
        loop {
            if let Ok(Progress::Complete(frame, used)) = Decoder::TCP.decode(&self.received) {
                let value = frame.value().map(|value| OwnedVariant::new(&value).unwrap());
                let (found, code) = (frame.serial, frame.hresult());
                self.received.drain(..used);
                let takes_serial = found == serial || self.is("other-serial-ignored");
                let takes_code = code != HResult::S_EXECUTING || self.is("waits-while-executing");
                if takes_serial && takes_code {
                    return Some((code, value));
                }
                continue;
            }
            if self.is("reply-in-pieces") && !self.received.is_empty() {
                return None;
            }
            let mut buffer = [0; 512];
            let count = self.stream.read(&mut buffer).ok().filter(|count| *count > 0)?;
            self.received.extend_from_slice(&buffer[..count]);
        }
    }

    fn call(&mut self, function: F, args: &[OwnedVariant]) -> Option<OwnedVariant> {
        let serial = self.send(function, args);
        let (code, value) = self.reply(serial)?;
        if self.is("refusal-survived") && code == HResult::E_FAIL {
            return None;
        }
        Some(value.unwrap_or_default())
    }

    /// A session with one variable; `None` when the client gives up.
    fn session(&mut self) -> Option<()> {
        let text = |text: &str| OwnedVariant::new(text).unwrap();
        if !self.is("start-first") {
            let option = if self.is("wdt-option") { "WDT=10" } else { "WDT=400" };
            self.call(F::SERVICE_START, &[text(option)])?;
        }
        let mut connect = vec![text(""), text("CaoProv.DENSO.VRC"), text("localhost"), text("")];
        if self.is("argument-count") {
            connect.pop();
        }
        if self.is("argument-types") {
            connect[0] = OwnedVariant::new(&1.5_f64).unwrap();
        }
        let controller = self.call(F::CONTROLLER_CONNECT, &connect)?;
        let variable = self.call(F::CONTROLLER_GET_VARIABLE, &[controller.clone(), text("I1"), text("")])?;
        if self.is("known-functions") {
            self.call(F(200), &[])?;
        }
        for _ in 0..10 {
            let handle = match self.fault {
                "handles-of-the-kind" => controller.clone(),
                "handles-are-i4" => OwnedVariant::new(&2.0_f64).unwrap(),
                "handles-are-open" => OwnedVariant::new(&4711).unwrap(),
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
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let serial = if fault == "serial-not-0" { 0 } else { 1 };
        let _ = Small { stream, serial, fault, received: Vec::new() }.session();
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
