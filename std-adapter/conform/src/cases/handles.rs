//! The handles of objects.

use std::collections::HashSet;

use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;

use crate::bench::{Bench, Stop, fail, skip};
use crate::case::Arg::{H, I, S};
use crate::case::{Run, Slot, Want};
use crate::device::Refusals;

const C: Slot = Slot::Controller;
const A: Slot = Slot::A;
const B: Slot = Slot::B;
const INVALID: Want = Want::Code(&[HResult::E_HANDLE]);
/// The cases of `handles.cases` that are functions.
pub(super) const FUNCTIONS: &[(&str, Run)] = &[
    ("of-another-client", of_another_client),
    ("of-an-ended-client", of_an_ended_client),
    ("twenty-different", twenty_different),
    ("many-opened-and-released", opened_and_released),
    ("limit", limit),
];

fn of_another_client(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    let mut stranger = bench.another()?;
    stranger.set_handle(A, bench.handle(A));
    stranger.must(F::VARIABLE_GET_VALUE, &[H(A)], INVALID)?;
    stranger.must(F::VARIABLE_RELEASE, &[H(A)], INVALID)?;
    bench.must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Ok).map(drop)
}

fn of_an_ended_client(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut ended = bench.another()?;
    ended.open_controller()?;
    ended.open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    let handle = ended.handle(A);
    ended.must(F::SERVICE_STOP, &[], Want::NoValue)?;
    drop(ended);
    bench.must(F::VARIABLE_GET_VALUE, &[I(handle)], INVALID).map(drop)
}

fn twenty_different(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut seen = HashSet::new();
    for _ in 0..20 {
        let reply = bench.call(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
        if [HResult::E_MAX_OBJECT, HResult::E_OUTOFMEMORY].contains(&reply.result()) {
            return skip(format!("the device has room for {} variables; their handles differ", seen.len()));
        }
        bench.check(F::CONTROLLER_GET_VARIABLE, &reply, Want::Ok, Refusals::Skip)?;
        bench.keep(A, &reply)?;
        if !seen.insert(bench.handle(A)) {
            return fail("a handle of its own", format!("{} was given out twice", bench.handle(A)));
        }
    }
    Ok(())
}

fn opened_and_released(bench: &mut Bench<'_>) -> Result<(), Stop> {
    for _ in 0..300 {
        bench.open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
        bench.must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue)?;
    }
    Ok(())
}

fn limit(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.open(B, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    for _ in 0..1100 {
        let reply = bench.call(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
        match reply.result() {
            code if code.is_ok() => {}
            HResult::E_MAX_OBJECT | HResult::E_OUTOFMEMORY => break,
            _ => return fail("success, E_MAX_OBJECT or E_OUTOFMEMORY", reply.text()),
        }
    }
    // room again after a release
    bench.must(F::VARIABLE_GET_VALUE, &[H(B)], Want::Ok)?;
    bench.must(F::VARIABLE_RELEASE, &[H(B)], Want::NoValue)?;
    bench.open(B, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])
}
