//! The bytes of a frame.

use bcap_core::bcap::FunctionId as F;

use crate::bench::{Bench, Stop, fail};
use crate::case::{Arg, Run, Slot, Want};
use crate::reply::Came;
/// The cases of `frames.cases` that are functions.
pub(super) const FUNCTIONS: &[(&str, Run)] = &[
    ("serial-wraps", serial_wraps),
    ("serial-jumps", serial_jumps),
    ("two-frames-in-one-segment", |bench| at_once(bench, 2, 0)),
    ("fifty-frames-at-once", |bench| at_once(bench, 50, 0)),
    ("frame-and-a-half", |bench| at_once(bench, 2, 12)),
    ("half-a-frame-and-the-end", |bench| ends_after(bench, &[1, 16, 0, 0, 0, 1, 0])),
    ("one-byte-and-the-end", |bench| ends_after(bench, &[1])),
    ("twenty-half-frames", twenty_half_frames),
];

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

fn ends_after(bench: &mut Bench<'_>, bytes: &[u8]) -> Result<(), Stop> {
    bench.send(bytes, "the start of a frame, then the end of the connection")?;
    bench.connect()?;
    bench.must(F::SERVICE_START, &[], Want::NoValue).map(drop)
}

fn twenty_half_frames(bench: &mut Bench<'_>) -> Result<(), Stop> {
    // first, because a device may have slots for fewer connections
    bench.connect()?;
    bench.must(F::SERVICE_START, &[], Want::NoValue)?;
    let mut others = Vec::new();
    for _ in 0..20 {
        let mut other = Bench::new(bench.options, bench.link);
        other.connect()?;
        other.send(&[1, 16, 0, 0], "the start of a frame")?;
        others.push(other);
    }
    bench.must(F::SERVICE_START, &[], Want::NoValue).map(drop)
}
