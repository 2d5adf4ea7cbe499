//! Everything of b-CAP: reads frames from standard input, decodes, reads, checks and writes them again.
//!
//! The input is unknown to the compiler, so it cannot compute any of this at build time. The decoded frames are encoded again
//! to standard output.
#![no_std]
#![no_main]

use bcap_core::bcap::call::{self, Call, Reply};
use bcap_core::bcap::client::{self, Client};
use bcap_core::bcap::server::{self, Handler, Request, Session};
use bcap_core::bcap::{Decoder, Frame, FrameWriter, FunctionId, Progress};
use bcap_core::endpoint::{Endpoint, Serve, ServerEndpoint};
use bcap_core::error::EncodeError;
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::limits::{Limits, Strictness};
use bcap_core::time::Instant;
use bcap_core::variant::{Bstr, Variant, VariantBuf};
use no_panic_image::{entry, loops, read_all, slave, write_all};

entry!(main);

fn main() -> i32 {
    let mut input = [0; 16 * 1024];
    let input = read_all(&mut input);
    #[cfg(feature = "planted")]
    let input = &input[input[0] as usize..];
    let mut seen = 0_u32;
    for decoder in [Decoder::TCP, Decoder::UDP, Decoder::SERIAL] {
        for strictness in [Strictness::Strict, Strictness::Lenient] {
            let echo = decoder == Decoder::TCP && strictness == Strictness::Strict;
            seen = seen.wrapping_add(stream(decoder.strictness(strictness), input, echo));
        }
    }
    seen = seen.wrapping_add(calls(input).unwrap_or(0));
    for (client, server) in [
        (client::Config::TCP, server::Config::TCP),
        (client::Config::UDP, server::Config::UDP),
        (client::Config::SERIAL, server::Config::SERIAL),
    ] {
        let mut client = Client::new(client, [0; 512], [0; 512]);
        let mut session = Session::<_, _, 8>::new(server, [0; 512], [0; 512]);
        seen = seen.wrapping_add(converse(&mut client, &mut session, input));
    }
    seen = seen.wrapping_add(slave::stream(input));
    seen = seen.wrapping_add(loops::binary(input));
    i32::from(seen == 0)
}

/// Decodes a stream to its end and returns how many values were in it.
fn stream(decoder: Decoder, mut bytes: &[u8], echo: bool) -> u32 {
    let mut values = 0_u32;
    loop {
        let used = match decoder.decode(bytes) {
            Ok(Progress::Complete(frame, used)) => {
                values = frame.args.iter().fold(values, |sum, value| sum.wrapping_add(read(value)));
                values = values.wrapping_add(replies(&frame));
                let mut buffer = [0; 1024];
                if let Ok(copy) = copy(&frame, decoder.crc, &mut buffer)
                    && echo
                {
                    write_all(copy);
                }
                used
            }
            Ok(Progress::NeedMore(_)) => return values,
            Err(_) => decoder.resync(bytes),
        };
        let Some(rest) = bytes.get(used..).filter(|_| used > 0) else { return values };
        bytes = rest;
    }
}

/// Encodes a frame anew, each value by way of an owned copy.
fn copy<'b>(frame: &Frame<'_>, crc: bool, buffer: &'b mut [u8]) -> Result<&'b [u8], EncodeError> {
    let mut writer = FrameWriter::new(buffer)?.with_crc(crc);
    for value in frame.args {
        match VariantBuf::<128>::new(&value) {
            Ok(owned) => writer.argument(&owned)?,
            Err(_) => writer.argument(&value)?,
        }
    }
    writer.finish(frame.serial, frame.reserved, frame.code)
}

/// Reads a value by every accessor, and those inside it; returns how many there were.
fn read(value: Variant<'_>) -> u32 {
    let mut buffer = [0; 64];
    let numbers = [value.as_i64().is_some(), value.as_i32().is_some(), value.as_bool().is_some()];
    let number = value.as_f64().is_some_and(f64::is_finite);
    let one = u32::from(numbers.contains(&true) || number || value.is_empty() || value.vartype().is_known());
    let inner = match value {
        Variant::Bstr(text) => u32::from(text.to_str(&mut buffer).is_some() || text.eq_ignore_ascii_case("slvMove")),
        Variant::Date(date) => u32::from(date.to_civil().is_some()),
        Variant::Nested(_) => read(value.flatten()),
        Variant::Array(array) => {
            let items = (array.items::<f64>(), array.items::<i32>());
            let pose = items.0.and_then(|i| i.to_array::<8>()).is_some_and(|pose| pose.contains(&1.0));
            let last = items.1.and_then(|i| i.get(i.len().wrapping_sub(1))).is_some();
            let texts = array.strings().map_or(0, |texts| texts.filter(|text| text.is_unicode()).count());
            let middle = array.get(array.len() / 2) == array.iter().nth(array.len() / 2);
            let sum = array.iter().fold(0_u32, |sum, element| sum.wrapping_add(read(element)));
            sum.wrapping_add(u32::from(pose || last || middle || texts > 0))
        }
        _ => 0,
    };
    one.wrapping_add(inner)
}

/// Reads a frame as the reply to calls of every kind; returns how many fit.
fn replies(frame: &Frame<'_>) -> u32 {
    let fits = [
        call::Int::read(frame.args).is_ok(),
        call::Text::read(frame.args).is_ok(),
        call::Any::read(frame.args).is_ok(),
        call::Maybe::read(frame.args).is_ok(),
        call::RobotHandle::read(frame.args).is_ok(),
        frame
            .function()
            .signature()
            .is_some_and(|s| s.arguments.iter().zip(frame.args).all(|(kind, value)| kind.accepts(&value))),
        frame.hresult().is_err(),
        frame.function().opens().is_some(),
    ];
    fits.iter().fold(0, |sum, fit| sum.wrapping_add(u32::from(*fit)))
}

/// Writes typed calls with arguments from the input.
fn calls(input: &[u8]) -> Option<u32> {
    let mut text = [0; 32];
    let name = Bstr::from_utf16le(input.get(..16)?)?.to_str(&mut text).unwrap_or("Arm");
    let number = i32::from_le_bytes(*input.first_chunk()?);
    let pose = [f64::from(number); 8];
    let mut sum = send(&call::service_start(name))?;
    sum = sum.wrapping_add(send(&call::controller_connect(name, "CaoProv.DENSO.VRC9", name, ""))?);
    sum = sum.wrapping_add(send(&call::controller_get_robot(call::ControllerHandle(number), name, ""))?);
    sum = sum.wrapping_add(send(&call::variable_put_value(call::VariableHandle(number), (pose, name, number)))?);
    sum = sum.wrapping_add(send(&call::robot_execute(call::RobotHandle(number), "slvMove", &pose))?);
    sum = sum.wrapping_add(send(&call::robot_accelerate(call::RobotHandle(number), -1, 50.0, 25.0))?);
    let raw = call::RawCall { function: FunctionId::parse(name)?, arguments: &[&number, &name] };
    sum = sum.wrapping_add(send(&raw)?);
    let value = Variant::decode(input, &Limits::STREAM, Strictness::Lenient).map_or(Variant::Empty, |v| v);
    Some(sum.wrapping_add(send(&call::variable_put_value(call::VariableHandle(number), value))?))
}

fn send<C: Call>(call: &C) -> Option<u32> {
    let mut buffer = [0; 256];
    let mut writer = FrameWriter::new(&mut buffer).ok()?;
    call.arguments(&mut writer).ok()?;
    let bytes = writer.finish(1, 0, call.function().0).ok()?;
    u32::try_from(bytes.len()).ok()
}

/// A controller that echoes the request.
struct Echo;

impl Handler for Echo {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        if request.int(1) == 1 { Outcome::Wait(now) } else { self.resume(peer, request, reply, now) }
    }

    fn resume(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let numbers = request.float(2) > 1.0 || request.text(1).is_unicode();
        let set = if request.function.opens().is_some() || numbers {
            reply.set(&request.handle())
        } else {
            reply.set(&request.value(1))
        };
        match set {
            Ok(()) => bcap_core::hresult::HResult::S_OK.into(),
            Err(_) => bcap_core::hresult::HResult::E_TOO_MUCH_DATA.into(),
        }
    }
}

type BoardClient = Client<[u8; 512]>;
type BoardSession = Session<[u8; 512], [u8; 512], 8>;

/// Lets a client call a server, with garbage from the input in between; returns how many calls had a reply.
fn converse(client: &mut BoardClient, session: &mut BoardSession, input: &[u8]) -> u32 {
    let mut replies = 0_u32;
    let mut text = [0; 32];
    let name = input.get(..16).and_then(Bstr::from_utf16le).and_then(|name| name.to_str(&mut text)).unwrap_or("");
    let mut rest = input;
    for millis in 0..200_u64 {
        let (now, number) = (Instant::from_millis(millis.wrapping_mul(100)), i32::try_from(millis % 8).unwrap_or(0));
        let started = match millis % 5 {
            0 => client.start(&call::service_start("WDT=400"), client.timing(), now),
            1 => client.start(&call::controller_connect(name, name, name, ""), client.timing(), now),
            2 => client.start(&call::controller_get_robot(call::ControllerHandle(0), name, ""), client.timing(), now),
            3 => client.start(&call::variable_put_value(call::VariableHandle(number), [1.5; 8]), client.timing(), now),
            _ => client.start(&call::service_stop(), client.timing(), now),
        };
        replies = replies.wrapping_add(u32::from(started.is_err()));
        let sent = carry(client.transmit(), session.receive_buffer());
        client.transmitted(sent);
        session.received(sent);
        while session.run(&mut Echo, PeerId(1), now).is_some() {
            let sent = carry(session.transmit(), client.receive_buffer());
            session.transmitted(sent);
            client.received(sent);
            while let Some(event) = client.poll_event(now) {
                let value = client.value::<call::Any>().is_ok() && client.value::<call::Int>().is_ok();
                replies = replies.wrapping_add(u32::from(matches!(event, client::Event::Replied(_)) && value));
            }
        }
        // garbage goes to both ends, at lengths that the input itself gives
        let (garbage, behind) =
            rest.split_at_checked(usize::from(rest.first().copied().unwrap_or(0))).unwrap_or_default();
        rest = behind;
        let count = carry(garbage, session.receive_buffer());
        session.received(count);
        let count = carry(garbage, client.receive_buffer());
        client.received(count);
        while client.poll_event(now).is_some() {}
        if client.poll_timeout().is_some_and(|at| at <= now) && client.handle_timeout(now).is_some() {
            client.abandon();
        }
        if session.is_finished() || client.is_closed() {
            session.close(&mut Echo, PeerId(1), now);
            *session = Session::new(server::Config::TCP, [0; 512], [0; 512]);
            client.reset();
        }
    }
    replies
}

/// Copies what fits from one end to the other.
fn carry(from: &[u8], to: &mut [u8]) -> usize {
    let count = from.len().min(to.len());
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
    count
}
