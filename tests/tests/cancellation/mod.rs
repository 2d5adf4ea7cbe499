//! Drops every async function at every await point; the connection must then work for the next call.
//!
//! A future is polled n times and dropped, for n = 1, 2, ... until it ends. Then an ordinary call is made. Its reply must
//! be its own, its timing the usual one, and the server must have run no call twice. The functions are listed in `coverage.rs`,
//! and the list is compared with the sources. `embassy-adapter/tests/cancellation.rs` does the same for bcap-embassy.

mod calls;
mod controller;
mod coverage;
mod gateway;
mod link;
mod rac;
mod sockets;
mod sweep;
mod timed;

use std::collections::BTreeMap;
use std::path::Path;

use bcap_tests::async_functions;

/// Checks the table of a crate, and prints how many functions were dropped at how many await points.
fn report(
    name: &str,
    folder: &str,
    table: &[(&'static str, async_functions::Coverage)],
    points: &BTreeMap<&'static str, usize>,
) {
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    if let Err(wrong) = async_functions::check(&sources, table, points) {
        panic!("{name}:\n{wrong}");
    }
    let total: usize = points.values().sum();
    println!(
        "{name}: {} async functions, {} of them dropped at {total} await points: {points:?}",
        table.len(),
        points.len()
    );
}

#[test]
fn the_core_survives_a_drop_at_every_await_point() {
    let mut points = calls::all();
    points.extend(rac::all());
    points.extend(timed::all());
    report("bcap-core", "../core/src", coverage::CORE, &points);
    assert!(points.values().sum::<usize>() >= 6000, "{points:?}");
}

#[test]
fn bcap_std_survives_a_drop_at_every_await_point() {
    let mut points = sockets::all();
    points.extend(gateway::all());
    points.extend(controller::all());
    report("bcap-std", "../std-adapter/src", coverage::STD, &points);
}
