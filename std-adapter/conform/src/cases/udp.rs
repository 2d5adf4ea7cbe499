//! Copies of calls over UDP: a retransmission gets the first reply again, and nothing is executed twice.

use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;
use bcap_testkit::value::Value;
use bcap_testkit::wire::Link;

use crate::bench::{Bench, Stop, fail};
use crate::case::Arg::{H, S, V};
use crate::case::Setup::{Connected, Controller};
use crate::case::{Body, Case, Group, Level, Setup, Slot, Step, Want, case, steps};
use crate::reply::Came;

const C: Slot = Slot::Controller;
const A: Slot = Slot::A;
const B: Slot = Slot::B;
const COPY: Step = Step::Copy { renumbered: true };
const DUPLICATE: Step = Step::Copy { renumbered: false };

const fn udp(name: &'static str, rule: &'static str, setup: Setup, table: &'static [Step]) -> Case {
    case(Group::Udp, name, "b-CAP specification, Table 6-1", rule, setup, steps(table)).over(Link::Udp)
}

const fn run(name: &'static str, rule: &'static str, run: fn(&mut Bench<'_>) -> Result<(), Stop>) -> Case {
    case(Group::Udp, name, "b-CAP specification, Table 6-1", rule, Controller, Body::Run(run)).over(Link::Udp)
}

pub(super) const CASES: &[Case] = &[
    udp(
        "copy-of-start",
        "a retransmitted Service_Start gets its reply again",
        Connected,
        &[Step::Must(F::SERVICE_START, &[S("")], Want::NoValue), COPY],
    ),
    udp("copy-of-connect", "a retransmission gets the same handle", Controller, &[COPY]),
    udp(
        "copy-of-open",
        "a retransmission opens no second object",
        Controller,
        &[Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]), COPY],
    ),
    udp(
        "three-copies-of-open",
        "every retransmission gets the first reply",
        Controller,
        &[Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]), COPY, COPY, COPY],
    ),
    udp(
        "duplicate-of-open",
        "a datagram that the network duplicates opens no second object",
        Controller,
        &[Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]), DUPLICATE],
    ),
    udp(
        "copy-of-release",
        "a retransmitted release is not executed again, which would be E_HANDLE",
        Controller,
        &[
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            Step::Must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue),
            COPY,
        ],
    ),
    udp(
        "duplicate-of-release",
        "a duplicated release is not executed again",
        Controller,
        &[
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            Step::Must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue),
            DUPLICATE,
        ],
    ),
    udp(
        "copy-of-a-refusal",
        "a retransmission of a refused call is refused with the same code",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(C), S("NoSuchVariable"), S("")], Want::Refused), COPY],
    ),
    udp(
        "copy-of-get",
        "a retransmission of a reading call gets the same value",
        Controller,
        &[
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Type(3)),
            COPY,
        ],
    ),
    udp(
        "copy-of-disconnect",
        "a retransmitted Controller_Disconnect is not executed again",
        Controller,
        &[Step::Must(F::CONTROLLER_DISCONNECT, &[H(C)], Want::NoValue), COPY],
    ),
    udp(
        "copy-of-put",
        "a retransmitted write gets its reply again",
        Controller,
        &[
            Step::Save("I"),
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), crate::case::Arg::Scratch("I"), S("")]),
            Step::Call(F::VARIABLE_PUT_VALUE, &[H(A), V("3,77")], Want::NoValue),
            COPY,
            Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Value("3,77")),
        ],
    )
    .at(Level::Write),
    udp(
        "next-call-after-a-copy",
        "after a retransmission the next call is executed",
        Controller,
        &[
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            COPY,
            Step::Open(B, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            Step::Differ(A, B),
        ],
    ),
    run(
        "same-serial-other-function",
        "a call with the marker of the last call, but another function, is no copy",
        same_serial_other_function,
    ),
    run("late-copy-is-not-executed", "a copy of an older call is not executed", late_copy),
    run("reserved-0-means-serial", "a request without a marker has its serial as marker", no_marker),
    run("first-serial-65535", "markers wrap", wrapping_markers),
    run("another-port-is-another-client", "two ports are two clients, also with the same serials", another_port),
    run("reply-of-488-bytes", "a packet over UDP has at most 488 bytes", large_reply),
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
    let last = bench.serial - 1;
    let serial = bench.next_serial();
    send(bench, serial, last, F::VARIABLE_GET_VALUE, &[H(A)])?;
    let reply = bench.reply(F::VARIABLE_GET_VALUE, serial)?;
    match reply.value() {
        Some(value) if reply.code.is_ok() && *value != Value::I4(bench.handle(A)) => Ok(()),
        _ => fail("the value of I1, not the reply of the call before", reply.text()),
    }
}

fn late_copy(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    bench.must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue)?;
    let old = bench.serial - 1;
    bench.open(B, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    // the release again: executed, it would be E_HANDLE, or release an object that got the same handle
    send(bench, old, old, F::VARIABLE_RELEASE, &[H(A)])?;
    match bench.receive_within(bench.options.quiet) {
        Came::Nothing => {}
        Came::Reply(reply) if reply.code == HResult::S_OK => {}
        came => return fail("silence, or the old reply", came.text()),
    }
    bench.must(F::VARIABLE_GET_VALUE, &[H(B)], Want::Ok).map(drop)
}

fn no_marker(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let serial = bench.next_serial();
    let arguments = [H(C), S("I1"), S("")];
    send(bench, serial, 0, F::CONTROLLER_GET_VARIABLE, &arguments)?;
    let first = bench.reply(F::CONTROLLER_GET_VARIABLE, serial)?;
    let copy = bench.next_serial();
    send(bench, copy, serial, F::CONTROLLER_GET_VARIABLE, &arguments)?;
    let again = bench.reply(F::CONTROLLER_GET_VARIABLE, copy)?;
    let same = first.code == again.code && first.value() == again.value();
    if same { Ok(()) } else { fail(format!("the first reply again: {}", first.text()), again.text()) }
}

fn wrapping_markers(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.serial = 0xffff;
    // far above the markers so far, so this case uses a separate session
    bench.must(F::SERVICE_START, &[S("")], Want::NoValue)?;
    bench.open_controller()?;
    bench.open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    bench.must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue).map(drop)
}

fn another_port(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut other = bench.another()?;
    bench.serial = other.serial;
    bench.open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    // the same serial as the call before, from another port
    other.set_handle(A, bench.handle(A));
    other.must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Code(&[HResult::E_HANDLE])).map(drop)
}

fn large_reply(bench: &mut Bench<'_>) -> Result<(), Stop> {
    // the names of all variables do not fit a datagram on any device; whatever comes must be a valid frame
    bench.call(F::CONTROLLER_GET_VARIABLE_NAMES, &[H(C), S("")]).map(drop)
}
