//! Tests this project's servers and clients with the independent peers in `tests/peer`, which are written in Python from
//! the specifications only.
//!
//! The number of checks is asserted, so that a check that no longer runs is a failure too.

use std::fmt::Debug;
use std::io::{BufRead, BufReader, Read};
use std::net::SocketAddr;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::io::blocking::{Connection, Transport};
use bcap_core::rac::{Variable, VariableKind};
use bcap_core::storage::Storage;
use bcap_core::variant::{Variant, VariantBuf};
use bcap_sim::{Config, Controller, Profile};
use bcap_std::server::Limits;
use bcap_std::{Options, blocking};
use bcap_testkit::value::Value;
use bcap_tests::serial::SerialServer;
use bcap_tests::served::Served;

#[test]
fn checks_of_a_server_over_tcp() {
    assert_passes("tcp", 55, served().tcp);
}

#[test]
fn checks_of_a_server_over_udp() {
    assert_passes("udp", 57, served().udp);
}

#[test]
fn checks_of_a_server_over_serial_framing() {
    let server = SerialServer::start(Arc::new(Mutex::new(controller())));
    assert_passes("serial", 55, server.address);
}

#[test]
fn checks_of_a_server_of_rac() {
    assert_passes("rac", 10, served().rac);
}

#[test]
fn a_client_over_tcp() {
    let Some(server) = Peer::start("tcp") else { return };
    exercise(blocking::connect_tcp(server.address, &Options::default()).unwrap());
    server.assert_passes(7);
}

#[test]
fn a_client_over_udp() {
    let Some(server) = Peer::start("udp") else { return };
    let mut options = Options::default();
    // some attempts are lost on purpose
    options.udp.timing.attempt_timeout = Duration::from_millis(100);
    exercise(blocking::connect_udp(server.address, &options).unwrap());
    server.assert_passes(8);
}

#[test]
fn a_client_of_rac() {
    let Some(server) = Peer::start("rac") else { return };
    let mut client = blocking::connect_rac(server.address, &Options::default()).unwrap();
    let values = [
        (VariableKind::I, Value::I4(i32::MIN)),
        (VariableKind::F, Value::R4(0.1_f32.to_bits())),
        (VariableKind::D, Value::R8(f64::MIN_POSITIVE.to_bits())),
        (VariableKind::S, Value::text("a,b(c) 日本")),
        (VariableKind::P, Value::Array(4, (0..7_u8).map(|n| Value::R4(f32::from(n).to_bits())).collect())),
        (VariableKind::Io, Value::Bool(true)),
    ];
    for (index, (kind, value)) in (1..).zip(values) {
        let variable = Variable { kind, index };
        let held = VariantBuf::<256>::new(&value).unwrap();
        client.put(variable, held.as_variant()).unwrap();
        assert_eq!(Value::read(client.get(variable).unwrap()), value, "{kind:?}");
    }
    let unknown = client.get(Variable { kind: VariableKind::J, index: 99 }).unwrap_err();
    assert_eq!(unknown.hresult(), Some(HResult::E_HANDLE));
    drop(client);
    server.assert_passes(3);
}

/// Calls of each kind; every value must come back as it was written.
fn exercise<X: Transport<Error: Debug>, T: Storage, R: Storage>(mut client: Connection<X, T, R>) {
    client.call(call::service_start("WDT=400")).unwrap();
    let controller = client.call(call::controller_connect("b-CAP", "CaoProv.DENSO.VRC", "localhost", "")).unwrap();
    let variable = client.call(call::controller_get_variable(controller, "I1", "")).unwrap();
    for value in values() {
        client.call(call::variable_put_value(variable, &value)).unwrap();
        let read: Variant<'_> = client.call(call::variable_get_value(variable)).unwrap();
        assert_eq!(Value::read(read), value);
    }
    let refused = client.call(call::variable_get_value(call::VariableHandle(-7))).unwrap_err();
    assert_eq!(refused.hresult(), Some(HResult::E_HANDLE));
    let refused = client.call(call::controller_get_name(controller)).map(|_| ()).unwrap_err();
    assert_eq!(refused.hresult(), Some(HResult::E_NOTIMPL));
    client.call(call::variable_release(variable)).unwrap();
    client.call(call::controller_disconnect(controller)).unwrap();
    client.call(call::service_stop()).unwrap();
}

/// Values of every VARTYPE, with extremes, empty arrays, and arrays in arrays.
fn values() -> Vec<Value> {
    let scalars = vec![
        Value::I2(i16::MIN),
        Value::I4(i32::MIN),
        Value::R4(f32::MAX.to_bits()),
        Value::R8((-0.0_f64).to_bits()),
        Value::Cy(i64::MIN),
        Value::Date((-1.25_f64).to_bits()),
        Value::text("日本語 \u{1f916} \0"),
        Value::text(""),
        Value::Error(HResult::E_FAIL.0),
        Value::Bool(true),
        Value::Ui1(u8::MAX),
        Value::Ui2(u16::MAX),
        Value::Ui4(u32::MAX),
        Value::I8(i64::MIN),
        Value::Ui8(u64::MAX),
    ];
    let mut values: Vec<_> =
        scalars.iter().map(|value| Value::Array(value.vartype(), vec![value.clone(); 3])).collect();
    values.extend(scalars.iter().map(|value| Value::Array(value.vartype(), Vec::new())));
    let nested = Value::Array(12, scalars.clone());
    values.push(Value::Array(12, vec![nested.clone(), Value::Array(12, Vec::new()), Value::Empty, Value::Null]));
    values.extend([nested, Value::Empty, Value::Null]);
    values.extend(scalars);
    values
}

fn controller() -> Controller {
    Controller::new(Config::new(Profile::Rc8))
}

fn served() -> Served<Controller> {
    Served::of(controller(), Limits::default())
}

/// Runs the checks of one link against a server.
fn assert_passes(link: &str, checks: usize, address: SocketAddr) {
    let Some(mut python) = python("check.py") else { return };
    let output = python.args([link, &address.to_string()]).output().expect("python3 runs");
    let told = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert_verdict(&told, link, checks);
}

/// Asserts what the last line says; the lines of failed checks are shown otherwise.
fn assert_verdict(told: &str, link: &str, checks: usize) {
    let verdict = format!("{checks} checks over {link}: {checks} passed, 0 failed");
    let failed: Vec<_> = told.lines().filter(|line| !line.starts_with("ok ")).collect();
    assert_eq!(failed, [verdict.as_str()], "{}", failed.join("\n"));
    println!("{verdict}");
}

/// Returns the command of a program in `tests/peer`, or says that it cannot run.
fn python(program: &str) -> Option<Command> {
    let path = format!("{}/peer/{program}", env!("CARGO_MANIFEST_DIR"));
    if !Command::new("python3").arg("--version").output().is_ok_and(|output| output.status.success()) {
        println!("skipped: there is no python3, which runs {path}");
        return None;
    }
    let mut command = Command::new("python3");
    // no compiled files in the source tree
    command.arg("-B").arg(path);
    Some(command)
}

/// The Python server; it ends with its one client, or with this.
struct Peer {
    link: &'static str,
    address: SocketAddr,
    process: Child,
    output: BufReader<ChildStdout>,
}

impl Peer {
    fn start(link: &'static str) -> Option<Self> {
        let mut process = python("server.py")?.arg(link).stdout(Stdio::piped()).spawn().expect("python3 runs");
        let mut output = BufReader::new(process.stdout.take().expect("a pipe"));
        let mut line = String::new();
        output.read_line(&mut line).expect("the server starts");
        let address = line.trim().strip_prefix("ready ").and_then(|address| address.parse().ok());
        let address = address.unwrap_or_else(|| panic!("the server says {line:?}"));
        Some(Self { link, address, process, output })
    }

    fn assert_passes(mut self, checks: usize) {
        let mut told = String::new();
        self.output.read_to_string(&mut told).expect("the server ends with its client");
        assert_verdict(&told, self.link, checks);
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        _ = self.process.kill();
        _ = self.process.wait();
    }
}
