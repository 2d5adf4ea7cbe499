//! Every async function is dropped at every await point: the next call must find the connection in order.
//!
//! A future is polled n times and dropped, for n = 1, 2, ... until it ends. Then an ordinary call is made. Its reply must
//! be its own, its timing the usual one, and on the server nothing may have run twice. The functions are listed in
//! `coverage.rs`, and the list is compared with the sources. `embassy-adapter/tests/cancellation.rs` does the same for
//! bcap-embassy.

mod calls;
mod link;
mod sweep;

#[test]
fn calls() {
    let points = calls::all();
    println!("{points:?}");
}
