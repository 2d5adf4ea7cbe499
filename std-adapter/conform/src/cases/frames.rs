//! The bytes of a frame.

use bcap_core::bcap::FunctionId as F;
use bcap_testkit::wire::Link;

use crate::bench::{Bench, Stop, fail};
use crate::case::Edit::{
    After, Before, Body as Args, Byte, Count, Cut, Function, Last, Length, Longer, Reserved, Serial,
};
use crate::case::Reaction::{Ends, Refused, Resync, Served};
use crate::case::Setup::{Connected, Controller, Started};
use crate::case::{Arg, Body, Case, Group, Reaction, Setup, Slot, Step, Want, case, steps};
use crate::reply::Came;

const fn frame(name: &'static str, source: &'static str, rule: &'static str, edits: &'static [Step]) -> Case {
    case(Group::Frames, name, source, rule, Connected, steps(edits))
}

const fn run(
    name: &'static str,
    source: &'static str,
    rule: &'static str,
    setup: Setup,
    run: fn(&mut Bench<'_>) -> Result<(), Stop>,
) -> Case {
    case(Group::Frames, name, source, rule, setup, Body::Run(run))
}

const LAYOUT: &str = "b-CAP specification, sections 4.1.1 to 4.1.5";
const CUT: &str = "RAC specification, Table 2-3";
const SIZE: &str = "RAC specification, Table 2-3";

pub(super) const CASES: &[Case] = &[
    frame(
        "minimal-request",
        "b-CAP specification, section 4.1.1",
        "a request without arguments has 16 bytes and is answered",
        &[Step::Must(F::SERVICE_START, &[], Want::NoValue)],
    ),
    frame(
        "request-with-argument",
        "b-CAP specification, section 4.1.1",
        "a request with an argument is answered",
        &[Step::Must(F::SERVICE_START, &[Arg::S("WDT=400")], Want::NoValue)],
    ),
    frame("serial-1", LAYOUT, "a reply has the serial of its request", &[Step::Edited(&[Serial(1)], Served)]),
    frame("serial-2", LAYOUT, "a reply has the serial of its request", &[Step::Edited(&[Serial(2)], Served)]),
    frame("serial-255", LAYOUT, "a serial is 16 bits wide", &[Step::Edited(&[Serial(255)], Served)]),
    frame("serial-256", LAYOUT, "a serial is little-endian", &[Step::Edited(&[Serial(256)], Served)]),
    frame("serial-4660", LAYOUT, "a serial is little-endian", &[Step::Edited(&[Serial(0x1234)], Served)]),
    frame("serial-32767", LAYOUT, "a serial is 16 bits wide", &[Step::Edited(&[Serial(0x7fff)], Served)]),
    frame("serial-32768", LAYOUT, "a serial is unsigned", &[Step::Edited(&[Serial(0x8000)], Served)]),
    frame("serial-65535", LAYOUT, "a serial is 16 bits wide", &[Step::Edited(&[Serial(0xffff)], Served)]),
    frame(
        "reserved-ignored",
        LAYOUT,
        "over TCP the reserved field of a request has no meaning, and that of a reply is 0",
        &[Step::Edited(&[Reserved(0x5aa5)], Served)],
    )
    .over(Link::Tcp),
    run("serial-wraps", LAYOUT, "after serial 65535 a client continues with 1", Started, serial_wraps),
    run("serial-jumps", LAYOUT, "a client may choose any serial", Started, serial_jumps),
    run(
        "two-frames-in-one-segment",
        LAYOUT,
        "frames of one segment are answered one after the other",
        Controller,
        two_in_one,
    )
    .over_tcp(),
    run("fifty-frames-at-once", LAYOUT, "each request is answered once, in order", Controller, fifty_at_once)
        .over_tcp(),
    run(
        "frame-and-a-half",
        LAYOUT,
        "the second frame of a segment is kept until its rest arrives",
        Controller,
        one_and_a_half,
    )
    .over_tcp(),
    frame("pieces-in-the-length", LAYOUT, "a frame may arrive in pieces", &[Step::Pieces(&[1, 2])]).over(Link::Tcp),
    frame("pieces-at-the-serial", LAYOUT, "a frame may arrive in pieces", &[Step::Pieces(&[5])]).over(Link::Tcp),
    frame("pieces-in-the-code", LAYOUT, "a frame may arrive in pieces", &[Step::Pieces(&[11])]).over(Link::Tcp),
    frame("pieces-after-the-header", LAYOUT, "a frame may arrive in pieces", &[Step::Pieces(&[15])]).over(Link::Tcp),
    frame("pieces-in-an-argument", LAYOUT, "a frame may arrive in pieces", &[Step::Pieces(&[20, 5])]).over(Link::Tcp),
    frame("pieces-before-the-end", LAYOUT, "a frame may arrive in pieces", &[Step::Pieces(&[42])]).over(Link::Tcp),
    frame("pieces-of-one-byte", LAYOUT, "a frame may arrive byte by byte", &[Step::Pieces(&[1; 42])]).over(Link::Tcp),
    frame("wrong-end", CUT, "a frame that does not end with 04 is invalid", &[Step::Edited(&[Last(0x05)], Refused)]),
    frame("end-is-zero", CUT, "a frame that does not end with 04 is invalid", &[Step::Edited(&[Last(0)], Refused)]),
    frame("wrong-start", CUT, "a frame begins with 01", &[Step::Edited(&[Byte(0, 0x02)], Refused)]),
    frame(
        "text-instead-of-a-frame",
        CUT,
        "other protocols are refused",
        &[Step::Edited(&[Before(b"GET / HTTP/1.0\r\n\r\n")], Resync)],
    ),
    frame(
        "noise-before-a-frame",
        CUT,
        "bytes before a frame are refused or skipped",
        &[Step::Edited(&[Before(&[0, 0xff])], Resync)],
    ),
    frame("length-0", CUT, "a length is at least 16", &[Step::Edited(&[Length(0)], Refused)]),
    frame("length-15", CUT, "a length is at least 16", &[Step::Edited(&[Length(15)], Refused)]),
    frame("length-one-less", CUT, "the length counts all bytes", &[Step::Edited(&[Longer(-1)], Refused)]),
    frame("length-one-more", CUT, "the length counts all bytes", &[Step::Edited(&[Longer(1), After(&[1])], Refused)]),
    frame(
        "length-16-mib",
        SIZE,
        "a packet over 16 MiB is refused before it has arrived",
        &[Step::Edited(&[Length(0x0100_0001)], Refused)],
    ),
    frame(
        "length-2-gib",
        SIZE,
        "a packet over 16 MiB is refused before it has arrived",
        &[Step::Edited(&[Length(0x8000_0000)], Refused)],
    ),
    frame(
        "length-4-gib",
        SIZE,
        "a packet over 16 MiB is refused before it has arrived",
        &[Step::Edited(&[Length(0xffff_ffff)], Refused)],
    ),
    frame(
        "count-too-large",
        CUT,
        "the number of arguments is that of the frame",
        &[Step::Edited(&[Count(3)], Refused)],
    ),
    frame(
        "count-65535",
        CUT,
        "the number of arguments is that of the frame",
        &[Step::Edited(&[Count(0xffff)], Refused)],
    ),
    frame(
        "count-too-small",
        CUT,
        "bytes after the last argument are refused or ignored",
        &[Step::Edited(&[Count(0)], Ends)],
    ),
    frame(
        "argument-length-too-large",
        CUT,
        "an argument ends within the frame",
        &[Step::Edited(&[Byte(15, 0xff)], Ends)],
    ),
    frame(
        "argument-length-4-gib",
        CUT,
        "an argument ends within the frame",
        &[Step::Edited(&[Args(1, &[0xff, 0xff, 0xff, 0xff, 3, 0, 1, 0, 0, 0, 1, 0, 0, 0])], Ends)],
    ),
    frame("argument-length-0", CUT, "an argument's length is that of its value", &[Step::Edited(&[Byte(15, 0)], Ends)]),
    frame(
        "argument-cut-off",
        CUT,
        "an argument ends within the frame",
        &[Step::Edited(&[Args(1, &[10, 0, 0, 0, 3, 0, 1, 0])], Refused)],
    ),
    frame(
        "function-0",
        "b-CAP specification, Appendix A",
        "the functions are 1 to 137",
        &[Step::Must(F::SERVICE_START, &[], Want::NoValue), Step::Call(F(0), &[], Want::Refused)],
    ),
    frame(
        "function-65536",
        "b-CAP specification, Appendix A",
        "the functions are 1 to 137",
        &[Step::Must(F::SERVICE_START, &[], Want::NoValue), Step::Must(F(65_536), &[], Want::Refused)],
    ),
    frame(
        "function-negative",
        "b-CAP specification, Appendix A",
        "the functions are 1 to 137",
        &[Step::Must(F::SERVICE_START, &[], Want::NoValue), Step::Must(F(-1), &[], Want::Refused)],
    ),
    frame(
        "function-largest",
        "b-CAP specification, Appendix A",
        "the functions are 1 to 137",
        &[Step::Must(F::SERVICE_START, &[], Want::NoValue), Step::Must(F(0x7fff_ffff), &[], Want::Refused)],
    ),
    frame(
        "function-upper-bytes",
        LAYOUT,
        "a function number is 32 bits wide",
        &[Step::Edited(&[Byte(11, 1)], Refused)],
    ),
    frame(
        "empty-datagram",
        "b-CAP specification, Table 6-1",
        "an empty datagram is dropped",
        &[Step::Edited(&[Cut(0)], Refused)],
    )
    .over(Link::Udp),
    frame(
        "datagram-of-one-byte",
        "b-CAP specification, Table 6-1",
        "a datagram without a frame is dropped",
        &[Step::Edited(&[Cut(1)], Refused)],
    )
    .over(Link::Udp),
    frame(
        "datagram-cut-off",
        "b-CAP specification, Table 6-1",
        "a frame is one datagram",
        &[Step::Edited(&[Cut(20)], Refused)],
    )
    .over(Link::Udp),
    frame(
        "datagram-of-two-frames",
        "b-CAP specification, Table 6-1",
        "a frame is one datagram; what follows it is refused or ignored",
        &[Step::Edited(&[After(&[1, 16, 0, 0, 0, 9, 0, 9, 0, 1, 0, 0, 0, 0, 0, 4])], Ends)],
    )
    .over(Link::Udp),
    frame(
        "datagram-of-600-bytes",
        "b-CAP specification, Table 6-1",
        "a packet over UDP has at most 488 bytes",
        &[Step::Edited(&[Args(1, LARGE)], Refused)],
    )
    .over(Link::Udp),
    frame(
        "wrong-function-then-right",
        CUT,
        "a refused call does not end the session",
        &[
            Step::Must(F::SERVICE_START, &[], Want::NoValue),
            Step::Must(F(65_999), &[], Want::Refused),
            Step::Must(F::SERVICE_STOP, &[], Want::NoValue),
        ],
    ),
    frame(
        "stop-as-an-edited-start",
        "b-CAP specification, section 4.1.5",
        "Service_Stop has no arguments",
        &[Step::Must(F::SERVICE_START, &[], Want::NoValue), Step::Edited(&[Function(F::SERVICE_STOP)], Reaction::Ends)],
    ),
    run(
        "half-a-frame-and-the-end",
        CUT,
        "a connection that ends within a frame does not disturb others",
        Connected,
        half_a_frame,
    )
    .over_tcp(),
    run(
        "one-byte-and-the-end",
        CUT,
        "a connection that ends after a byte does not disturb others",
        Connected,
        one_byte,
    )
    .over_tcp(),
    run(
        "twenty-half-frames",
        CUT,
        "unfinished frames of other connections do not disturb a session",
        Connected,
        twenty_half_frames,
    )
    .over_tcp(),
];

/// One argument of 600 bytes: a BSTR of 295 letters.
const LARGE: &[u8] = &{
    let mut bytes = [0x41; 604];
    let head = [0x58, 0x02, 0, 0, 8, 0, 1, 0, 0, 0, 0x4e, 0x02, 0, 0];
    let mut at = 0;
    while at < head.len() {
        bytes[at] = head[at];
        at += 1;
    }
    bytes
};

impl Case {
    const fn over_tcp(self) -> Self {
        self.over(Link::Tcp)
    }
}

fn serial_wraps(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.serial = 0xfffe;
    for _ in 0..4 {
        bench.must(F(65_999), &[], Want::Refused)?;
    }
    Ok(())
}

fn serial_jumps(bench: &mut Bench<'_>) -> Result<(), Stop> {
    // ascending: over UDP a lower serial is a late copy
    for serial in [30_100, 30_101, 31_000] {
        bench.serial = serial;
        bench.must(F(65_999), &[], Want::Refused)?;
    }
    Ok(())
}

/// Sends this number of Controller_GetName in one write, and then expects as many replies in order.
fn at_once(bench: &mut Bench<'_>, count: usize, keep: usize) -> Result<(), Stop> {
    let handle = bench.argument(&Arg::H(Slot::Controller))?;
    let serials: Vec<u16> = (0..count).map(|_| bench.next_serial()).collect();
    let frame = |serial: &u16| bench.encode(*serial, 0, F::CONTROLLER_GET_NAME, std::slice::from_ref(&handle));
    let bytes: Vec<u8> = serials.iter().flat_map(frame).collect();
    let (now, later) = bytes.split_at(bytes.len() - keep);
    bench.send(now, &format!("{count} x Controller_GetName, without the last {keep} bytes"))?;
    for (index, serial) in serials.iter().enumerate() {
        if keep > 0 && index + 1 == count {
            bench.send(later, "the rest")?;
        }
        bench.reply(F::CONTROLLER_GET_NAME, *serial)?;
    }
    match bench.receive_within(bench.options.quiet) {
        Came::Nothing => Ok(()),
        came => fail("one reply to each request, and then silence", came.text()),
    }
}

fn two_in_one(bench: &mut Bench<'_>) -> Result<(), Stop> {
    at_once(bench, 2, 0)
}

fn fifty_at_once(bench: &mut Bench<'_>) -> Result<(), Stop> {
    at_once(bench, 50, 0)
}

fn one_and_a_half(bench: &mut Bench<'_>) -> Result<(), Stop> {
    at_once(bench, 2, 12)
}

fn ends_after(bench: &mut Bench<'_>, bytes: &[u8]) -> Result<(), Stop> {
    bench.send(bytes, "the start of a frame, then the end of the connection")?;
    bench.connect()?;
    bench.must(F::SERVICE_START, &[], Want::NoValue).map(drop)
}

fn half_a_frame(bench: &mut Bench<'_>) -> Result<(), Stop> {
    ends_after(bench, &[1, 16, 0, 0, 0, 1, 0])
}

fn one_byte(bench: &mut Bench<'_>) -> Result<(), Stop> {
    ends_after(bench, &[1])
}

fn twenty_half_frames(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut others = Vec::new();
    for _ in 0..20 {
        let mut other = Bench::new(bench.options, bench.link);
        other.connect()?;
        other.send(&[1, 16, 0, 0], "the start of a frame")?;
        others.push(other);
    }
    bench.connect()?;
    bench.must(F::SERVICE_START, &[], Want::NoValue).map(drop)
}
