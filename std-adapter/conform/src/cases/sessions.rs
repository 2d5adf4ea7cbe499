//! Sessions: Service_Start to Service_Stop.

use bcap_core::bcap::FunctionId as F;

use crate::bench::{Bench, Stop, skip};
use crate::case::Arg::{H, S};
use crate::case::{Run, Slot, Want};

const C: Slot = Slot::Controller;
/// The cases of `sessions.cases` that are functions.
pub(super) const FUNCTIONS: &[(&str, Run)] = &[
    ("two-controllers", two_controllers),
    ("connect-before-start", connect_before_start),
    ("unknown-provider", unknown_provider),
    ("two-clients", two_clients),
    ("ten-clients", ten_clients),
    ("one-after-another", one_after_another),
];

/// Controllers refuse the call; the specification only shows the order, and servers of small devices do not need it.
fn connect_before_start(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let arguments = [S(""), S("CaoProv.DENSO.VRC"), S("localhost"), S("")];
    let reply = bench.call(F::CONTROLLER_CONNECT, &arguments)?;
    if reply.result().is_ok() { skip("the device needs no Service_Start") } else { Ok(()) }
}

/// A device that is not a controller may have any provider.
fn unknown_provider(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let arguments = [S(""), S("CaoProv.NoSuch.Provider"), S("localhost"), S("")];
    let reply = bench.call(F::CONTROLLER_CONNECT, &arguments)?;
    if reply.result().is_ok() { skip("the device accepts any provider") } else { Ok(()) }
}

fn two_controllers(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let first = bench.handle(C);
    bench.open_controller()?;
    let second = bench.handle(C);
    bench.want(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")], Want::Type(3))?;
    if first != second {
        bench.must(F::CONTROLLER_DISCONNECT, &[H(C)], Want::NoValue)?;
        bench.set_handle(C, first);
    }
    bench.want(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")], Want::Type(3)).map(drop)
}

fn two_clients(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut other = bench.another()?;
    other.open_controller()?;
    for _ in 0..3 {
        bench.want(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")], Want::Type(3))?;
        other.want(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")], Want::Type(3))?;
    }
    other.must(F::SERVICE_STOP, &[], Want::NoValue)?;
    // the end of one session does not affect the other
    bench.want(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")], Want::Type(3)).map(drop)
}

fn ten_clients(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut others = (0..9).map(|_| bench.another()).collect::<Result<Vec<_>, _>>()?;
    others.iter_mut().try_for_each(|other| other.must(F::SERVICE_STOP, &[], Want::NoValue).map(drop))
}

fn one_after_another(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.close();
    (0..50).try_for_each(|_| {
        // not `another`, which skips the case if the device has lost its slots
        let mut client = Bench::new(bench.options, bench.link);
        client.connect()?;
        client.must(F::SERVICE_START, &[S("")], Want::NoValue).map(drop)
    })
}
