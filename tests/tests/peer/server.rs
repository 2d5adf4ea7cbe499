//! Facts of servers: values of every type, lengths, Slave Mode with IO, and RAC.

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{SocketAddr, TcpStream};

use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;
use bcap_testkit::text;
use bcap_testkit::value::{ARRAY, VARIANT, Value};
use bcap_testkit::wire::Link;

use super::session::{LIMIT, Session, on_every_link, served};
use super::values;

#[test]
fn a_tag_keeps_values_of_every_type() {
    on_every_link(|mut session| {
        let variable = session.variable("I1");
        for value in values() {
            session.ok(F::VARIABLE_PUT_TAG, &[variable.clone(), value.clone()]);
            assert_eq!(session.ok(F::VARIABLE_GET_TAG, std::slice::from_ref(&variable)), value);
        }
        session.stop();
    });
}

#[test]
fn strings_are_as_long_as_a_stream_carries() {
    let served = served();
    let mut session = Session::start(Link::Tcp, served.tcp);
    let variable = session.variable("S1");
    for count in [489, 16_383, 16_384, 20_000] {
        let text = Value::text(&"x".repeat(count));
        session.ok(F::VARIABLE_PUT_VALUE, &[variable.clone(), text.clone()]);
        assert_eq!(session.ok(F::VARIABLE_GET_VALUE, std::slice::from_ref(&variable)), text);
    }
    session.stop();
}

/// A datagram has 488 bytes (b-CAP specification, Table 6-1); the vendor's libraries accept 503.
#[test]
fn a_long_datagram_is_executed_and_a_longer_one_is_not() {
    let served = served();
    let mut session = Session::start(Link::Udp, served.udp);
    let variable = session.variable("I1");
    // 15 header, 14 handle, 4 + 6 array, 1 terminator
    let bytes = |size: usize| Value::Array(17, vec![Value::Ui1(7); size - 40]);
    for size in [488, 503] {
        session.ok(F::VARIABLE_PUT_TAG, &[variable.clone(), bytes(size)]);
    }
    session.ok(F::VARIABLE_PUT_TAG, &[variable.clone(), Value::I4(1)]);
    let serial = session.next_serial();
    session.send(serial, F::VARIABLE_PUT_TAG, &[variable.clone(), bytes(840)]);
    assert!(session.reply(serial).0.is_err());
    assert_eq!(session.ok(F::VARIABLE_GET_TAG, &[variable]), Value::I4(1));
    session.stop();
}

#[test]
fn over_tcp_a_repeated_serial_is_executed() {
    let served = served();
    let mut session = Session::start(Link::Tcp, served.tcp);
    let args = [session.controller.clone(), Value::text("I1"), Value::text("")];
    let serial = session.next_serial();
    let handles = [(); 3].map(|()| {
        session.send(serial, F::CONTROLLER_GET_VARIABLE, &args);
        session.reply(serial).1
    });
    assert!(handles[0] != handles[1] && handles[1] != handles[2], "{handles:?}");
    session.stop();
}

/// Returns VARTYPE and count of each part of a reply of slvMove.
fn shape(value: &Value) -> Vec<(u16, usize)> {
    let parts = match value {
        Value::Array(VARIANT, parts) => parts.as_slice(),
        other => std::slice::from_ref(other),
    };
    parts.iter().map(|part| (part.vartype(), if let Value::Array(_, items) = part { items.len() } else { 1 })).collect()
}

/// Returns the parts of a receive format in the order (b-CAP specification, Table 5-1).
fn expected(receive: i32) -> Vec<(u16, usize)> {
    let doubles = [7, 8, 10, 15, 18][(receive & 0xf) as usize - 1];
    let parts = [
        (receive & 0x010, (3, 1)),
        (1, (ARRAY | 5, doubles)),
        (receive & 0x100, (3, 1)),
        (receive & 0x200, (ARRAY | 17, 2)),
        (receive & 0x020, (3, 1)),
        (receive & 0x040, (ARRAY | 5, 8)),
    ];
    parts.into_iter().filter(|(has, _)| *has != 0).map(|(_, part)| part).collect()
}

/// Enters mode 1 with these formats; returns the joints.
fn enter(session: &mut Session, send: i32, receive: i32) -> Value {
    session.robot("slvSendFormat", Value::I4(send));
    session.robot("slvRecvFormat", Value::I4(receive));
    let joints = session.robot("CurJnt", Value::Empty);
    session.robot("slvChangeMode", Value::I4(0x102));
    assert_eq!(session.robot("slvGetMode", Value::Empty), Value::I4(0x102));
    joints
}

fn leave(session: &mut Session) {
    session.robot("slvChangeMode", Value::I4(0));
    assert_eq!(session.robot("slvGetMode", Value::Empty), Value::I4(0));
}

/// Each send format with receive formats.
#[test]
fn slave_mode_has_all_formats() {
    const RECEIVE: [i32; 11] = [0x001, 0x002, 0x003, 0x004, 0x005, 0x012, 0x032, 0x134, 0x174, 0x202, 0x272];
    on_every_link(|mut session| {
        session.take_arm();
        for (send, receive) in
            [0, 0x20, 0x100, 0x120, 0x200, 0x220].into_iter().flat_map(|send| RECEIVE.map(|receive| (send, receive)))
        {
            let mut parts = vec![enter(&mut session, send, receive)];
            let io = Value::Array(17, vec![Value::Ui1(0xa5), Value::Ui1(0x5a)]);
            if send & 0x100 != 0 {
                parts.push(Value::I4(0x0005_0000));
            }
            if send & 0x200 != 0 {
                parts.extend([Value::I4(128), Value::I4(16), io.clone()]);
            }
            if receive & 0x200 != 0 {
                parts.extend([Value::I4(128), Value::I4(16)]);
            }
            if send & 0x20 != 0 {
                parts.push(Value::I4(0x0001_0000));
            }
            let pose = if parts.len() == 1 { parts.remove(0) } else { Value::Array(VARIANT, parts) };
            let reply = session.robot("slvMove", pose);
            assert_eq!(shape(&reply), expected(receive), "formats 0x{send:x}, 0x{receive:x}");
            if send & receive & 0x200 != 0 {
                assert!(matches!(&reply, Value::Array(_, parts) if parts.contains(&io)), "{reply:?}");
            }
            leave(&mut session);
        }
        session.stop();
    });
}

#[test]
fn outputs_of_slave_mode_are_io_variables() {
    on_every_link(|mut session| {
        session.take_arm();
        let pose = enter(&mut session, 0x200, 0x002);
        let io = [Value::I4(136), Value::I4(8), Value::Array(17, vec![Value::Ui1(0x81)])];
        session.robot("slvMove", Value::Array(VARIANT, [&[pose][..], &io].concat()));
        leave(&mut session);
        let outputs = (136..144).map(|number| session.get(&format!("IO{number}")));
        assert_eq!(
            outputs.collect::<Vec<_>>(),
            [true, false, false, false, false, false, false, true].map(Value::Bool)
        );
        session.stop();
    });
}

/// In mode 2 the fourth reply waits for a cycle of 8 ms.
#[test]
fn time_stamps_count_milliseconds_or_microseconds() {
    on_every_link(|mut session| {
        session.take_arm();
        for (unit, cycle) in [(0, 8), (1, 8000)] {
            session.robot("slvRecvFormat", Value::Array(3, vec![Value::I4(0x012), Value::I4(unit)]));
            let joints = session.robot("CurJnt", Value::Empty);
            session.robot("slvChangeMode", Value::I4(0x202));
            let stamps: Vec<_> = (0..8)
                .map(|_| match session.robot("slvMove", joints.clone()) {
                    Value::Array(VARIANT, parts) => parts[0].as_f64().unwrap() as i64,
                    other => panic!("{other:?}"),
                })
                .collect();
            assert!((cycle..1250 * cycle).contains(&(stamps[7] - stamps[0])), "unit {unit}: {stamps:?}");
            leave(&mut session);
        }
        session.stop();
    });
}

/// After an underflow in motion Slave Mode is off, and the error is shown (b-CAP specification, Table 5-6).
#[test]
fn an_underflow_in_motion_ends_slave_mode() {
    on_every_link(|mut session| {
        session.take_arm();
        session.robot("slvRecvFormat", Value::I4(2));
        let Value::Array(5, joints) = session.robot("CurJnt", Value::Empty) else { panic!("no joints") };
        session.robot("slvChangeMode", Value::I4(0x002));
        let ahead = |steps: u8| {
            let mut pose = joints.clone();
            pose[0] = Value::R8((pose[0].as_f64().unwrap() + 0.01 * f64::from(steps)).to_bits());
            Value::Array(5, pose)
        };
        (1..4).for_each(|steps| drop(session.robot_command("slvMove", ahead(steps))));
        let began = std::time::Instant::now();
        while session.robot("slvGetMode", Value::Empty) != Value::I4(0) {
            assert!(began.elapsed() < LIMIT, "Slave Mode stays on without poses");
        }
        assert_eq!(session.robot_command("slvMove", ahead(0)).0, HResult::from_u32(0x8350_0121));
        let args = [session.controller.clone(), Value::text("GetCurErrorCount"), Value::Empty];
        assert!(session.ok(F::CONTROLLER_EXECUTE, &args).as_f64() > Some(0.0));
        session.stop();
    });
}

/// A connection that speaks RAC.
struct Lines(BufReader<TcpStream>);

impl Lines {
    fn connect(address: SocketAddr) -> Self {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(LIMIT)).unwrap();
        Self(BufReader::new(stream))
    }

    /// Sends bytes, and returns the next response.
    fn ask(&mut self, bytes: &[u8]) -> (i32, Option<Value>) {
        self.0.get_mut().write_all(bytes).unwrap();
        let mut response = Vec::new();
        self.0.read_until(b'\r', &mut response).unwrap();
        text::response(response.strip_suffix(b"\r").unwrap()).unwrap_or_else(|| panic!("{response:?}"))
    }

    fn put_and_get(&mut self, variable: &str, value: &str) -> Option<Value> {
        assert_eq!(self.ask(format!("PUT:RC8:{variable}:{value}\r").as_bytes()), (0, None), "{variable} {value}");
        self.ask(format!("GET:RC8:{variable}:\r").as_bytes()).1
    }
}

#[test]
fn values_of_rac_are_read_back() {
    let served = served();
    let (mut line, mut other) = (Lines::connect(served.rac), Lines::connect(served.rac));
    let double = |number: f64| Some(Value::R8(number.to_bits()));
    for (variable, value, read) in [
        ("20:IO", "11,-1", Some(Value::Bool(true))),
        ("20:IO", "11,1", Some(Value::Bool(true))),
        ("20:IO", "11,0", Some(Value::Bool(false))),
        ("12:F", "4,16777216", Some(Value::R4(16_777_216_f32.to_bits()))),
        ("12:D", "5,0.30000000000000004", double(0.300_000_000_000_000_04)),
        ("12:D", "5,1e308", double(1e308)),
        ("12:D", "5,-5e-324", double(-5e-324)),
        ("12:S", "8,日本 a,b(c)", Some(Value::text("日本 a,b(c)"))),
        ("12:I", " 3, 123", Some(Value::I4(123))),
    ] {
        assert_eq!(line.put_and_get(variable, value), read, "{variable} {value}");
        assert_eq!(other.ask(format!("GET:RC8:{variable}:\r").as_bytes()).1, read, "over another connection");
    }
    assert_eq!(line.ask(&b"GET:RC8:12:I:\r".repeat(20)), (0, Some(Value::I4(123))));
    (0..19).for_each(|_| assert_eq!(line.ask(b""), (0, Some(Value::I4(123)))));
}

/// The codes of Table 2-3 of the RAC specification; a line has at most 256 bytes with its CR (section 2.1.1).
#[test]
fn refused_lines_have_their_codes_and_change_nothing() {
    let served = served();
    let mut line = Lines::connect(served.rac);
    let long = |count: usize| [b"PUT:RC8:13:S:8,".to_vec(), vec![b'x'; count - 16], b"\r".to_vec()].concat();
    assert_eq!(line.ask(&long(256)), (0, None));
    let before = line.ask(b"GET:RC8:13:S:\r");
    for (wrong, code) in [
        (&b"DEL:RC8:1:I:\r"[..], HResult::E_INVALIDCOMMAND),
        (b"PUT:RC8:1:I:3,12x\r", HResult::E_INVALIDARGTYPE),
        (b"GET:RC8:x:I:\r", HResult::E_INVALIDARG),
        (&long(258), HResult::E_PACKETSIZEOVER),
        (&long(5000), HResult::E_PACKETSIZEOVER),
    ] {
        assert_eq!(line.ask(wrong), (code.0, None), "{}", wrong.escape_ascii());
    }
    for binary in [&(14..=255).chain([13]).collect::<Vec<u8>>()[..], b"PUT:RC8:13:S:8,\xff\xfe\r"] {
        assert!(HResult(line.ask(binary).0).is_err(), "{}", binary.escape_ascii());
    }
    assert_eq!(line.ask(b"GET:RC8:13:S:\r"), before);
}
