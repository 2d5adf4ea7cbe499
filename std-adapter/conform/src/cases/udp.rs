//! Copies of calls over UDP: a retransmission gets the first reply again, and nothing is executed twice.

use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;
use bcap_core::limits::UDP_SEND_MAX;
use bcap_testkit::value::Value;
use bcap_testkit::wire::Link;

use crate::bench::{Bench, Stop, fail, skip};
use crate::case::Arg::{H, S};
use crate::case::{Run, Slot, Want};
use crate::device::Refusals;
use crate::reply::Came;

const C: Slot = Slot::Controller;
const A: Slot = Slot::A;
const B: Slot = Slot::B;
/// The cases of `udp.cases` that are functions.
pub(super) const FUNCTIONS: &[(&str, Run)] = &[
    ("same-serial-other-function", same_serial_other_function),
    ("late-copy-is-not-executed", late_copy),
    ("reserved-0-means-serial", no_marker),
    ("first-serial-65535", wrapping_markers),
    ("another-port-is-another-client", another_port),
    ("reply-of-488-bytes", large_reply),
];

/// Sends a request with this serial and marker.
fn send(bench: &mut Bench<'_>, serial: u16, marker: u16, function: F, args: &[crate::case::Arg]) -> Result<(), Stop> {
    let args = args.iter().map(|arg| bench.argument(arg)).collect::<Result<Vec<_>, _>>()?;
    let bytes = bench.encode(serial, marker, function, &args);
    let text = crate::reply::request_text(serial, function, &args);
    bench.send(&bytes, &format!("{text} with the marker {marker}"))
}

fn same_serial_other_function(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    let before = bench.must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Ok)?;
    bench.open(B, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    let opened = Value::I4(bench.handle(B));
    if before.value() == Some(&opened) {
        return skip("the value of I1 equals the reply of the call before");
    }
    let last = bench.serial - 1;
    let serial = bench.next_serial();
    send(bench, serial, last, F::VARIABLE_GET_VALUE, &[H(A)])?;
    let reply = bench.reply(F::VARIABLE_GET_VALUE, serial)?;
    // the value itself may change at any time
    let vartype = before.value().map(Value::vartype);
    match reply.value() {
        Some(value) if reply.result().is_ok() && *value != opened && Some(value.vartype()) == vartype => Ok(()),
        _ => fail("the value of I1, not the reply of the call before", reply.text()),
    }
}

fn late_copy(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    bench.must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue)?;
    let old = bench.serial - 1;
    bench.open(B, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    // a repeated release: if executed, it would return E_HANDLE, or release an object that got the same handle
    send(bench, old, old, F::VARIABLE_RELEASE, &[H(A)])?;
    match bench.receive_within(bench.options.quiet) {
        Came::Nothing => {}
        Came::Reply(reply) if reply.result() == HResult::S_OK => {}
        came => return fail("silence, or the old reply", came.text()),
    }
    bench.must(F::VARIABLE_GET_VALUE, &[H(B)], Want::Ok).map(drop)
}

fn no_marker(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let serial = bench.next_serial();
    let arguments = [H(C), S("I1"), S("")];
    send(bench, serial, 0, F::CONTROLLER_GET_VARIABLE, &arguments)?;
    let first = bench.reply(F::CONTROLLER_GET_VARIABLE, serial)?;
    bench.check(F::CONTROLLER_GET_VARIABLE, &first, Want::Ok, Refusals::Skip)?;
    let copy = bench.next_serial();
    send(bench, copy, serial, F::CONTROLLER_GET_VARIABLE, &arguments)?;
    let again = bench.reply(F::CONTROLLER_GET_VARIABLE, copy)?;
    let same = first.code == again.code && first.value() == again.value();
    if same { Ok(()) } else { fail(format!("the first reply again: {}", first.text()), again.text()) }
}

fn wrapping_markers(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.serial = 0xffff;
    // far above the earlier markers, so this case uses a separate session
    bench.must(F::SERVICE_START, &[S("")], Want::NoValue)?;
    bench.open_controller()?;
    bench.open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    bench.must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue).map(drop)
}

fn another_port(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut other = bench.another()?;
    bench.serial = other.serial;
    bench.open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    // the same serial as the previous call, from another port
    other.set_handle(A, bench.handle(A));
    other.must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Code(&[HResult::E_HANDLE])).map(drop)
}

fn large_reply(bench: &mut Bench<'_>) -> Result<(), Stop> {
    // the names of all variables of a controller do not fit a datagram, so it may answer with an error
    let reply = bench.call(F::CONTROLLER_GET_VARIABLE_NAMES, &[H(C), S("")])?;
    if reply.result() == HResult::E_NOTIMPL {
        return skip(format!("Controller_GetVariableNames: {}", reply.result()));
    }
    // a valid frame is as long as its canonical encoding
    let length = reply.to_wire(false).len();
    match bench.link == Link::Udp && length > UDP_SEND_MAX {
        true => fail(format!("a reply of at most {UDP_SEND_MAX} bytes"), format!("{length} bytes: {}", reply.text())),
        false => Ok(()),
    }
}
