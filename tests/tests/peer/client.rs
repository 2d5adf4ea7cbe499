//! Facts of clients: a small server of frames or lines keeps what they write, and gives it back.

use std::collections::HashMap;
use std::fmt::Debug;
use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{SocketAddr, TcpListener};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::io::blocking::{Connection, Transport};
use bcap_core::rac::{Variable, VariableKind};
use bcap_core::storage::Storage;
use bcap_core::variant::{Variant, VariantBuf};
use bcap_std::{Options, blocking};
use bcap_testkit::frame::TestFrame;
use bcap_testkit::judge::TCP;
use bcap_testkit::value::Value;
use bcap_testkit::wire::{Link, Listener, Received};

use super::session::LIMIT;
use super::values;

/// Serves one client, until it stops the service. Other packets precede every second reply: S_EXECUTING, and replies to other
/// calls. Over UDP the first attempt of every third call is lost, in turn before and after it is executed.
fn keeper(link: Link) -> (SocketAddr, JoinHandle<()>) {
    let listener = Listener::bind(link, "127.0.0.1:0".parse().unwrap()).unwrap();
    let address = listener.address().unwrap();
    let thread = thread::spawn(move || {
        let mut wire = listener.accept(LIMIT).unwrap().expect("a client");
        let (mut kept, mut calls) = (Value::Empty, HashMap::new());
        while let Received::Packet(bytes) = wire.receive(LIMIT) {
            let request = TCP.decode_packet(&bytes).unwrap_or_else(|| panic!("malformed: {bytes:02x?}"));
            let marker = if link == Link::Udp { request.reserved } else { request.serial };
            let number = calls.len();
            let is_lost = link == Link::Udp && number.is_multiple_of(3) && !calls.contains_key(&marker);
            let call = calls.entry(marker).or_insert(None);
            if is_lost && number.is_multiple_of(2) {
                continue;
            }
            let (code, value) = call.get_or_insert_with(|| answer(&request, &mut kept)).clone();
            if is_lost {
                continue;
            }
            let reply =
                |serial, code: HResult, args| TestFrame { serial, reserved: 0, code: code.0, args }.to_wire(false);
            let other = request.serial.wrapping_add(40_000);
            let mut packets = vec![
                reply(request.serial, HResult::S_EXECUTING, vec![]),
                reply(other, HResult::S_OK, vec![Value::I4(666)]),
                reply(request.serial, code, value.into_iter().collect()),
            ];
            if request.serial.is_multiple_of(2) {
                packets.drain(..2);
            }
            // over TCP all in one segment
            let packets = if link == Link::Tcp { vec![packets.concat()] } else { packets };
            packets.iter().for_each(|packet| wire.send(packet).unwrap());
            if request.code == 2 {
                break;
            }
        }
    });
    (address, thread)
}

/// Executes a call; the only variable keeps any value.
fn answer(request: &TestFrame, kept: &mut Value) -> (HResult, Option<Value>) {
    match (request.code, request.args.as_slice()) {
        (1 | 2 | 4 | 111, _) => (HResult::S_OK, None),
        (3, _) => (HResult::S_OK, Some(Value::I4(1))),
        (9, _) => (HResult::S_OK, Some(Value::I4(2))),
        (101, [Value::I4(2)]) => (HResult::S_OK, Some(kept.clone())),
        (102, [Value::I4(2), value]) => {
            *kept = value.clone();
            (HResult::S_OK, None)
        }
        (101, _) => (HResult::E_HANDLE, None),
        _ => (HResult::E_NOTIMPL, None),
    }
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

#[test]
fn values_of_every_type_go_over_tcp() {
    let (address, server) = keeper(Link::Tcp);
    exercise(blocking::connect_tcp(address, &Options::default()).unwrap());
    server.join().unwrap();
}

#[test]
fn values_of_every_type_go_over_udp_with_losses() {
    let (address, server) = keeper(Link::Udp);
    let mut options = Options::default();
    options.udp.timing.attempt_timeout = Duration::from_millis(100);
    exercise(blocking::connect_udp(address, &options).unwrap());
    server.join().unwrap();
}

/// A server of RAC that keeps texts. Its responses come byte by byte, with the blank of the samples (RAC specification, section 4.1).
fn lines() -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        let mut client = BufReader::new(listener.accept().unwrap().0);
        let (mut kept, mut line) = (HashMap::new(), Vec::new());
        while client.read_until(b'\r', &mut line).is_ok_and(|count| count > 0) {
            assert!(line.len() <= 256, "{} bytes", line.len());
            let text = String::from_utf8(std::mem::take(&mut line)).unwrap();
            let fields: Vec<_> = text.trim_end_matches('\r').splitn(5, ':').map(str::to_owned).collect();
            let [verb, "RC8", index, kind, value] = [0, 1, 2, 3, 4].map(|at| fields[at].as_str()) else {
                panic!("{text:?}")
            };
            let response = match verb {
                "PUT" => {
                    kept.insert((index.to_owned(), kind.to_owned()), value.to_owned());
                    "0\r".to_owned()
                }
                _ => {
                    assert_eq!((verb, value), ("GET", ""), "{text:?}");
                    let kept = kept.get(&(index.to_owned(), kind.to_owned()));
                    kept.map_or(format!("{}\r", HResult::E_HANDLE.0), |value| format!("0, {value}\r"))
                }
            };
            response.bytes().for_each(|byte| client.get_mut().write_all(&[byte]).unwrap());
        }
    });
    address
}

#[test]
fn values_go_over_rac() {
    let mut client = blocking::connect_rac(lines(), &Options::default()).unwrap();
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
}
