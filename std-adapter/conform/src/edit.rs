//! Frames with deliberate errors, and the permitted reactions.

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_testkit::frame::field;
use bcap_testkit::value::Value;
use bcap_testkit::wire::Link;

use crate::bench::{Bench, Stop, fail, skip};
use crate::language::{Arg, Edit, Reaction, Want};
use crate::reply::{Came, describe};

impl Bench<'_> {
    /// Sends Service_Start with changes, checks the reaction, and checks that the device serves another session.
    pub(crate) fn edited(&mut self, edits: &[Edit], reaction: Reaction) -> Result<(), Stop> {
        if self.link == Link::Serial {
            return skip("a case of a network: with a wrong CRC a frame is noise");
        }
        let (mut serial, mut bytes) = self.request(FunctionId::SERVICE_START, &[Value::text("WDT=400")]);
        for edit in edits {
            apply(edit, &mut bytes);
            if let Edit::Serial(number) = edit {
                serial = *number;
            }
        }
        // a device may close the connection before it has received a large frame; `receive` reports that
        let _ = self.send(&bytes, &format!("edited {edits:?}: {}", describe(&bytes)));
        // a device may drop an invalid datagram
        let is_dropped = self.link == Link::Udp && reaction != Reaction::Served;
        let came = self.receive_within(if is_dropped { self.options.quiet } else { self.options.timeout });
        self.judge(reaction, serial, &came)?;
        if reaction != Reaction::Served {
            // the device must serve a new connection as if nothing had happened
            self.connect()?;
            self.must(FunctionId::SERVICE_START, &[Arg::S("")], Want::NoValue)?;
        }
        Ok(())
    }

    fn judge(&mut self, reaction: Reaction, serial: u16, came: &Came) -> Result<(), Stop> {
        let is_udp = self.link == Link::Udp;
        match (reaction, came) {
            (Reaction::Served, Came::Reply(reply)) if reply.serial == serial && reply.result().is_ok() => Ok(()),
            (Reaction::Served, came) => fail(format!("success with the serial {serial}"), came.text()),
            (Reaction::Ends | Reaction::Resync, Came::Reply(reply)) if reply.result().is_ok() => {
                match reply.serial == serial {
                    true => Ok(()),
                    false => fail(
                        format!("a reply with the serial {serial}, an error, or the end of the connection"),
                        came.text(),
                    ),
                }
            }
            (_, Came::Reply(reply)) if reply.result().is_err() => self.ends(reply.result()),
            (_, Came::Closed) => Ok(()),
            (_, Came::Nothing) if is_udp => Ok(()),
            (_, came) => fail("an error, or the end of the connection", came.text()),
        }
    }

    /// After E_INVALIDRCPACKET the device closes the connection (RAC specification, Table 2-3).
    fn ends(&mut self, code: HResult) -> Result<(), Stop> {
        if self.link == Link::Udp || code != HResult::E_INVALIDRCPACKET {
            return Ok(());
        }
        match self.receive() {
            Came::Closed => Ok(()),
            came => fail("the end of the connection after E_INVALIDRCPACKET", came.text()),
        }
    }
}

fn apply(edit: &Edit, bytes: &mut Vec<u8>) {
    match *edit {
        Edit::Function(function) => bytes[field::CODE].copy_from_slice(&function.0.to_le_bytes()),
        Edit::Length(length) => bytes[field::LENGTH].copy_from_slice(&length.to_le_bytes()),
        Edit::Count(count) => bytes[field::COUNT].copy_from_slice(&count.to_le_bytes()),
        Edit::Reserved(marker) => bytes[field::RESERVED].copy_from_slice(&marker.to_le_bytes()),
        Edit::Serial(serial) => bytes[field::SERIAL].copy_from_slice(&serial.to_le_bytes()),
        Edit::Byte(at, value) => bytes[at] = value,
        Edit::Longer(by) => {
            let length = u32::try_from(bytes.len()).unwrap_or(u32::MAX).wrapping_add_signed(by);
            bytes[field::LENGTH].copy_from_slice(&length.to_le_bytes());
        }
        Edit::Last(value) => {
            if let Some(last) = bytes.last_mut() {
                *last = value;
            }
        }
        Edit::Body(count, body) => replace_body(bytes, count, body),
        Edit::Nested(depth) => replace_body(bytes, 1, &nested(depth)),
        Edit::Before(noise) => drop(bytes.splice(..0, noise.iter().copied())),
        Edit::After(noise) => bytes.extend_from_slice(noise),
        Edit::Cut(length) => bytes.truncate(length),
    }
}

/// Replaces the arguments, and adjusts the length.
fn replace_body(bytes: &mut Vec<u8>, count: u16, body: &[u8]) {
    bytes.truncate(field::COUNT.start);
    bytes.extend_from_slice(&count.to_le_bytes());
    bytes.extend_from_slice(body);
    bytes.push(bcap_core::bcap::EOT);
    let length = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
    bytes[field::LENGTH].copy_from_slice(&length.to_le_bytes());
}

/// An argument: arrays of one VARIANT inside each other, with EMPTY inside the last.
fn nested(depth: usize) -> Vec<u8> {
    let mut value = [0x0c, 0x20, 1, 0, 0, 0].repeat(depth);
    value.extend_from_slice(&[0, 0, 1, 0, 0, 0]);
    let mut argument = u32::try_from(value.len()).unwrap_or(u32::MAX).to_le_bytes().to_vec();
    argument.append(&mut value);
    argument
}

#[cfg(test)]
mod tests {
    use bcap_sim::{Config, Controller, Profile};
    use bcap_std::server::Limits;
    use bcap_tests::served::Served;

    use super::*;
    use crate::device::{Options, Target};

    /// The connection takes no bytes, as after a device has closed it in the middle of a large frame.
    #[test]
    fn a_frame_that_the_connection_does_not_take_is_refused() {
        let served = Served::of(Controller::new(Config::new(Profile::Rc8)), Limits::default());
        let options = Options::new(Target { bcap: Some((Link::Tcp, served.tcp)), rac: None });
        let mut bench = Bench::new(&options, Link::Tcp);
        bench.connect().unwrap();
        bench.wire.as_ref().unwrap().finish().unwrap();
        let judged = bench.edited(&[Edit::Nested(150_000)], Reaction::Refused);
        assert!(judged.is_ok(), "{judged:?}");
    }
}
