//! The core never allocates: each operation runs under an allocator that counts, and must count 0.

use bcap_core::endpoint::{Endpoint, Serve};
use std::pin::pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use bcap_core::bcap::call::{self, Call, ControllerHandle, Reply, RobotHandle, VariableHandle};
use bcap_core::bcap::client::{self, Client};
use bcap_core::bcap::{Decoder, FrameWriter, FunctionId, Header, server};
use bcap_core::error::EncodeError;
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::io::{asynch, blocking};
use bcap_core::limits::{Limits, Strictness};
use bcap_core::rac::{self, Variable, VariableKind};
use bcap_core::slave::{
    AxisLimits, Channel, Config, Engine, EngineAction, Format, Handles, Mode, Pose, PoseType, ReceiveFormat,
    ReceivePose, SlaveMode, Step,
};
use bcap_core::time::Instant;
use bcap_core::variant::{Variant, VariantBuf};
use bcap_testkit::vectors::frames;
use bcap_tests::allocation::{Counting, allocations};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Runs `body` and fails when it allocates.
#[track_caller]
fn without<T>(body: impl FnOnce() -> T) -> T {
    let (result, count) = allocations(body);
    assert_eq!(count, 0, "allocations");
    result
}

#[test]
fn the_counter_counts() {
    let (text, count) = allocations(|| String::from("counted"));
    assert_eq!((text.as_str(), count), ("counted", 1));
    let (_, count) = allocations(|| {
        let mut grown = Vec::with_capacity(1);
        grown.extend([1_u8, 2]);
        grown
    });
    assert_eq!(count, 2, "a Vec that grows asks twice");
}

/// Reads every value and every value inside it; returns how many there were.
fn walk(value: Variant<'_>) -> usize {
    match value {
        Variant::Array(array) => 1 + array.iter().map(walk).sum::<usize>(),
        Variant::Nested(inner) => 1 + walk(inner.value()),
        Variant::Bstr(text) => text.to_str(&mut [0; 256]).map_or(0, |_| 1),
        _ => 1,
    }
}

#[test]
fn decoding_and_reading_frames() {
    for vector in frames() {
        for strictness in [Strictness::Strict, Strictness::Lenient] {
            let read = without(|| {
                let frame = Decoder::TCP.strictness(strictness).decode_datagram(&vector.bytes).ok()?;
                Some(frame.args.iter().map(walk).sum::<usize>())
            });
            assert!(read.is_some_and(|count| count >= vector.count), "{}", vector.name);
        }
        for cut in 0..vector.bytes.len() {
            assert!(without(|| Decoder::UDP.decode_datagram(&vector.bytes[..cut]).is_err()), "{}", vector.name);
        }
    }
}

#[test]
fn encoding_frames() {
    let mut buffer = [0; 512];
    for vector in frames() {
        let bytes = without(|| -> Result<&[u8], EncodeError> {
            let frame = Decoder::TCP.decode_datagram(&vector.bytes).map_err(|_| EncodeError::Full)?;
            let mut writer = FrameWriter::new(&mut buffer)?;
            frame.args.iter().try_for_each(|value| writer.argument(&value))?;
            writer.finish(frame.serial, frame.reserved, frame.code)
        });
        assert_eq!(bytes, Ok(&vector.bytes[..]), "{}", vector.name);
    }
}

#[test]
fn owned_values() {
    let pose = [1.5_f64; 8];
    let owned = without(|| VariantBuf::<256>::new(&(pose, "text", true, ())));
    let owned = owned.unwrap();
    assert_eq!(without(|| walk(owned.as_variant())), 13);
    let copy = without(|| VariantBuf::<256>::decode(owned.as_bytes(), &Limits::STREAM, Strictness::Strict));
    assert_eq!(copy.unwrap(), owned);
    without(|| VariantBuf::<16>::new(&"this is too long for it")).unwrap_err();
}

/// Writes a call and reads a reply to it.
fn exchange<C: Call>(call: &C, reply: &Variant<'_>, check: impl FnOnce(<C::Reply as Reply>::Value<'_>) -> bool) {
    let mut buffer = [0; 512];
    let right = without(|| -> Option<bool> {
        let mut frame = FrameWriter::new(&mut buffer).ok()?;
        call.arguments(&mut frame).ok()?;
        let request = frame.finish(1, 0, call.function().0).ok()?;
        let sent = Decoder::TCP.decode_datagram(request).ok()?.function();
        let mut frame = FrameWriter::new(&mut buffer).ok()?;
        frame.argument(reply).ok()?;
        let bytes = frame.finish(1, 0, 0).ok()?;
        let frame = Decoder::TCP.decode_datagram(bytes).ok()?;
        Some(sent == call.function() && check(C::Reply::read(frame.args).ok()?))
    });
    assert_eq!(right, Some(true), "{}", call.function());
}

#[test]
fn typed_calls_and_their_replies() {
    exchange(&call::variable_get_value(VariableHandle(3)), &Variant::R8(2.5), |v| v == Variant::R8(2.5));
    exchange(&call::robot_execute(RobotHandle(3), "slvMove", [1.0_f64; 8]), &Variant::Empty, |v| v == Variant::Empty);
    exchange(&call::controller_get_robot(ControllerHandle(2), "Arm", ""), &Variant::I4(7), |h| h == RobotHandle(7));
    let raw = call::RawCall { function: FunctionId(137), arguments: &[&3_i32, &"text", &[1_i16, 2]] };
    exchange(&raw, &Variant::Bool(true), |v| v == Some(Variant::Bool(true)));
}

/// A controller that answers every request with a value.
struct Answer;

impl server::Handler for Answer {
    fn call(
        &mut self,
        peer: PeerId,
        request: &server::Request<'_>,
        reply: &mut ReplyValue<'_>,
        now: Instant,
    ) -> Outcome {
        match request.function {
            FunctionId::ROBOT_HALT => Outcome::Wait(now),
            _ => self.resume(peer, request, reply, now),
        }
    }

    fn resume(&mut self, _: PeerId, request: &server::Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let set = match request.function.opens() {
            Some(_) => reply.set(&7_i32),
            // no stream runs
            None if request.text(1) == "slvGetMode" => reply.set(&0_i32),
            None => reply.set(&([1.5_f64; 8], "text")),
        };
        set.map_or(HResult::E_FAIL, |()| HResult::S_OK).into()
    }
}

impl rac::server::Handler for Answer {
    fn call(&mut self, _: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let set = match request {
            rac::Request::Get(_) => reply.set(&[1.5_f32; 7]),
            rac::Request::Put(..) => Ok(()),
        };
        set.map_or(HResult::E_FAIL, |()| HResult::S_OK).into()
    }
}

/// Copies what one end has to send into the other's memory.
fn carry(from: &[u8], to: &mut [u8]) -> usize {
    let count = from.len().min(to.len());
    to[..count].copy_from_slice(&from[..count]);
    count
}

type BoardClient = Client<[u8; 512]>;
type BoardSession = server::Session<[u8; 512]>;

/// Lets a client call a server; returns whether the reply had a value.
fn served<C: Call>(client: &mut BoardClient, session: &mut BoardSession, call: &C, now: Instant) -> bool {
    client.start(call, client.timing(), now).unwrap();
    let count = carry(client.transmit(), session.receive_buffer());
    client.transmitted(count);
    session.received(count);
    for millis in 0..5 {
        while session.run(&mut Answer, PeerId(1), now + Duration::from_millis(millis)).is_some() {}
    }
    let count = carry(session.transmit(), client.receive_buffer());
    session.transmitted(count);
    client.received(count);
    let replied = client.poll_event(now) == Some(client::Event::Replied(HResult::S_OK));
    replied && client.reply().is_some_and(|frame| frame.args.iter().map(walk).sum::<usize>() > 0)
}

#[test]
fn calls_of_a_client_answered_by_a_server() {
    for (client, server) in [
        (client::Config::TCP, server::Config::TCP),
        (client::Config::UDP, server::Config::UDP),
        (client::Config::SERIAL, server::Config::SERIAL),
    ] {
        let now = Instant::from_millis(1);
        let (mut client, mut session) =
            without(|| (BoardClient::new(client, [0; 512], [0; 512]), BoardSession::new(server, [0; 512], [0; 512])));
        without(|| {
            served(&mut client, &mut session, &call::service_start("WDT=400"), now);
            assert!(served(&mut client, &mut session, &call::controller_connect("", "", "", ""), now));
            assert!(served(
                &mut client,
                &mut session,
                &call::controller_get_robot(ControllerHandle(7), "Arm", ""),
                now
            ));
            assert!(served(&mut client, &mut session, &call::robot_execute(RobotHandle(7), "slvMove", [1.0; 8]), now));
            // a call for which the handler is called twice
            served(&mut client, &mut session, &call::robot_halt(RobotHandle(7), ""), now);
            client.start(&call::service_stop(), client.timing(), now).unwrap();
            while client.handle_timeout(now + client.timing().deadline).is_some() {}
            session.close(&mut Answer, PeerId(1), now);
        });
    }
}

#[test]
fn text_of_values_both_ways() {
    for text in ["3,-123", "8196,1,2,3,4,5,6,-1", "5,1e-300", "8204,(8,Sample),(8200,a,b),(7,2026/11/21 04:00:00)"] {
        let same = without(|| {
            let value = VariantBuf::<256>::parse_text(text.as_bytes());
            value.is_ok_and(|value| value.as_variant().to_text(&mut [0; 256]) == Ok(text))
        });
        assert!(same, "{text}");
    }
    assert!(without(|| VariantBuf::<256>::parse_text(b"8204,(8,Sample").is_err()));
}

#[test]
fn lines_of_rac_both_ways() {
    let now = Instant::from_millis(1);
    without(|| {
        let mut client = rac::client::Client::new(Default::default(), [0; 256]);
        let mut session = rac::server::Session::new(Default::default(), [0; 256]);
        let variable = rac::Variable::new(rac::VariableKind::P, 10);
        let pose = VariantBuf::<64>::new(&[1.5_f32; 7]).unwrap();
        for request in [rac::Request::Get(variable), rac::Request::Put(variable, pose.as_variant())] {
            client.start(&request, now).unwrap();
            let count = carry(client.transmit(), session.receive_buffer());
            client.transmitted(count);
            session.received(count);
            while session.run(&mut Answer, PeerId(1), now).is_some() {}
            let count = carry(session.transmit(), client.receive_buffer());
            session.transmitted(count);
            client.received(count);
            assert_eq!(client.poll_event(now), Some(rac::client::Event::Replied(HResult::S_OK)));
            assert_eq!(client.reply().and_then(|reply| reply.value).is_some(), matches!(request, rac::Request::Get(_)));
        }
    });
}

/// A transport with the server at its other end.
struct Behind<S>(S);

/// Implements both kinds of [`Transport`](blocking::Transport) over a session of this type.
macro_rules! transport {
    ($session:ty) => {
        impl blocking::Transport for Behind<$session> {
            type Error = std::convert::Infallible;

            fn now(&self) -> Instant {
                Instant::from_millis(1)
            }

            fn send(&mut self, bytes: &[u8], _: Instant) -> Result<Option<usize>, Self::Error> {
                let count = carry(bytes, self.0.receive_buffer());
                self.0.received(count);
                Ok(Some(count))
            }

            fn receive(&mut self, buffer: &mut [u8], _: Instant) -> Result<Option<usize>, Self::Error> {
                while self.0.run(&mut Answer, PeerId(1), Instant::from_millis(1)).is_some() {}
                let count = carry(self.0.transmit(), buffer);
                self.0.transmitted(count);
                Ok((count > 0).then_some(count))
            }

            fn sleep_until(&mut self, _: Instant) {}
        }

        impl asynch::Transport for Behind<$session> {
            type Error = std::convert::Infallible;

            fn now(&self) -> Instant {
                Instant::from_millis(1)
            }

            async fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, Self::Error> {
                blocking::Transport::send(self, bytes, until)
            }

            async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, Self::Error> {
                blocking::Transport::receive(self, buffer, until)
            }

            async fn sleep_until(&mut self, _: Instant) {}
        }
    };
}
transport!(BoardSession);
transport!(rac::server::Session<[u8; 512]>);

/// Runs a future that never waits.
fn at_once<T>(future: impl Future<Output = T>) -> T {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(result) => result,
        Poll::Pending => panic!("it waits"),
    }
}

#[test]
fn blocking_and_async_loops() {
    let of_bcap = || {
        let client = BoardClient::new(client::Config::TCP, [0; 512], [0; 512]);
        (Behind(BoardSession::new(server::Config::TCP, [0; 512], [0; 512])), client)
    };
    let of_rac = || {
        let client = rac::client::Client::new(rac::client::Config::TCP, [0; 512]);
        (Behind(rac::server::Session::new(rac::server::Config::TCP, [0; 512])), client)
    };
    let variable = Variable::new(VariableKind::P, 7);
    without(|| {
        let (behind, client) = of_bcap();
        let mut client = blocking::Connection::new(behind, client);
        client.call(call::service_start("")).unwrap();
        let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
        let robot = client.call(call::controller_get_robot(controller, "Arm", "")).unwrap();
        assert!(walk(client.call(call::robot_execute(robot, "slvMove", [1.0; 8])).unwrap()) > 1);
        assert!(client.call(call::robot_release(RobotHandle(9))).is_err());

        let (behind, client) = of_rac();
        let mut client = blocking::RacConnection::new(behind, client);
        client.put(variable, Variant::I4(5)).unwrap();
        assert!(walk(client.get(variable).unwrap()) > 1);
    });
    without(|| {
        at_once(async {
            let (behind, client) = of_bcap();
            let mut client = asynch::Connection::new(behind, client);
            client.call(call::service_start("")).await.unwrap();
            let controller = client.call(call::controller_connect("", "", "", "")).await.unwrap();
            let robot = client.call(call::controller_get_robot(controller, "Arm", "")).await.unwrap();
            assert!(walk(client.call(call::robot_execute(robot, "slvMove", [1.0; 8])).await.unwrap()) > 1);
            assert!(client.call(call::robot_release(RobotHandle(9))).await.is_err());

            let (behind, client) = of_rac();
            let mut client = asynch::RacConnection::new(behind, client);
            client.put(variable, Variant::I4(5)).await.unwrap();
            assert!(walk(client.get(variable).await.unwrap()) > 1);
        });
    });
}

#[test]
fn a_gateway_between_lines_and_frames() {
    let now = Instant::from_millis(1);
    without(|| {
        let mut memory = bcap_gateway::Memory::<2, 1>::new();
        let rules = bcap_gateway::Rules { put: &bcap_gateway::Allow::EVERYTHING, ..Default::default() };
        let mut gateway =
            bcap_gateway::Gateway::new(bcap_gateway::Config { rules, ..bcap_gateway::Config::RC8 }, &mut memory);
        let mut robot = BoardSession::new(server::Config::TCP, [0; 512], [0; 512]);
        let plc = gateway.open().unwrap();
        gateway.robot_opened(now);
        // the second variable evicts the handle of the first
        for line in ["", "GET:RC8:1:P:\r", "PUT:RC8:2:I:3,5\r", "nonsense\r", "PUT:RC8:2:I:4,5\r"] {
            let count = carry(line.as_bytes(), gateway.receive_buffer(plc));
            gateway.received(plc, count);
            loop {
                while gateway.poll_event(now).is_some() {}
                let count = carry(gateway.robot_transmit(), robot.receive_buffer());
                if count == 0 {
                    break;
                }
                gateway.robot_transmitted(count);
                robot.received(count);
                while robot.run(&mut Answer, PeerId(1), now).is_some() {}
                let count = carry(robot.transmit(), gateway.robot_receive_buffer());
                robot.transmitted(count);
                gateway.robot_received(count);
            }
            let count = gateway.transmit(plc).len();
            gateway.transmitted(plc, count);
        }
        let counters = gateway.counters();
        // the answers are arrays of VARIANT, which have a text
        assert_eq!((counters.served.count(), counters.failed.count(), counters.refused), (2, 0, 2));
        gateway.robot_closed(now);
        assert!(gateway.poll_event(now).is_some());
    });
}

#[test]
fn streaming_in_slave_mode() {
    let mode = SlaveMode { mode: Mode::Mode0, pose: PoseType::J };
    let format = Format::new(mode, ReceiveFormat { mini_io: true, ..ReceiveFormat::pose(ReceivePose::J) });
    let handles = Handles { controller: ControllerHandle(2), robot: RobotHandle(3) };
    let config = Config { limits: AxisLimits::uniform(100.0, 800.0), ..Config::new(format, handles) };
    let mut request = [0; 256];
    let mut reply = [0; 256];
    let (moved, underflows) = without(|| {
        let mut engine = Engine::<256>::new(config).ok()?;
        let mut client = Client::new(client::Config::TCP, [0; 512], [0; 512]);
        let (mut now, mut poses, mut moved) = (Instant::ZERO, 0_u32, 0_u32);
        loop {
            match engine.poll(now) {
                EngineAction::Pose { .. } => {
                    poses += 1;
                    engine.push(&Pose::j([f64::from(poses) * 1e-3; 8])).ok()?;
                }
                EngineAction::Wait(until) => now = until,
                EngineAction::Call(step, Channel::Motion) => {
                    client.start(&engine.request()?, client.timing(), now).ok()?;
                    let sent = client.transmit().len();
                    request.get_mut(..sent)?.copy_from_slice(client.transmit());
                    client.transmitted(sent);
                    // the buffer runs empty after 200 poses, and errors are looked into
                    let code = match step {
                        Step::Move if moved == 200 => HResult::E_COMMAND_BUFFER_EMPTY,
                        Step::Move => HResult::S_BUF_FULL,
                        _ => HResult::S_OK,
                    };
                    let mut frame = FrameWriter::new(&mut reply).ok()?;
                    let error = (HResult::E_COMMAND_BUFFER_EMPTY.0, "Position command buffer is empty");
                    match step {
                        Step::Move => frame.argument(&([0.0; 8], 3_i32)),
                        Step::Position => frame.argument(&[0.0; 8]),
                        Step::ErrorCount => frame.argument(&1_i32),
                        Step::ErrorInfo => frame.argument(&error),
                        _ => frame.argument(&0_i32),
                    }
                    .ok()?;
                    let serial = Header::read(&request)?.serial;
                    let bytes = frame.finish(serial, 0, code.0).ok()?;
                    client.receive_buffer().get_mut(..bytes.len())?.copy_from_slice(bytes);
                    client.received(bytes.len());
                    while client.poll_event(now).is_some() {}
                    moved += u32::from(engine.handle_reply(&client.reply()?, now).is_some());
                }
                EngineAction::Call(..) | EngineAction::Finished => return None,
                EngineAction::Faulted => return Some((moved, engine.stats().underflows)),
            }
        }
    })
    .expect("the stream runs until the error");
    assert_eq!((moved, underflows), (200, 1));
}

/// A typed read of a variable that is open, over a socket: the session of the blocking objects.
#[test]
fn a_typed_read_of_a_controller_does_not_allocate() {
    let config = bcap_sim::Config::new(bcap_sim::Profile::Rc8);
    let sim = bcap_tests::served::Served::of(bcap_sim::Controller::new(config), bcap_std::server::Limits::default());
    for address in [format!("tcp:{}", sim.tcp), format!("udp:{}", sim.udp)] {
        let mut cell = bcap_std::blocking::Controller::connect(&address, &bcap_std::Settings::rc8()).unwrap();
        cell.write("I1", 7).unwrap();
        cell.write("P1", [1.0_f32, 2.0, 3.0, 0.0, 0.0, 0.0, 5.0]).unwrap();
        // opened by the first use
        cell.read::<[f32; 7]>("P1").unwrap();
        for _ in 0..10 {
            assert_eq!(without(|| cell.read::<i32>("I1").unwrap()), 7);
            assert_eq!(without(|| cell.read::<[f32; 7]>("P1").unwrap())[1], 2.0);
            without(|| cell.write("I1", 7).unwrap());
        }
    }
}
