//! b-CAP and RAC for C and C++: the library `libbcap` with the header `bcap.h`.
//!
//! ```text
//!  firmware   bcap_client_start ─► transmit ─► the link ─► receive_buffer, received ─► poll ─► reply
//!  hosted     bcap_connect ─► bcap_read, bcap_write, bcap_take_arm, bcap_move, bcap_stream_step ─► bcap_close
//! ```
//!
//! * The **sans-IO client** works in memory of the caller. It has no heap, no socket, no clock and no panics, and needs no std.
//! * The **hosted client** (feature `hosted`) is the blocking client of `bcap-std`. Its handles have generations, so a handle that
//!   was closed is an error. No panic leaves a function.
//!
//! No logic lives here: each function checks its arguments and calls `bcap-core` or `bcap-std`.
//!
//! This is the only crate of the project with unsafe code. [`memory`] has the blocks that access memory of the caller; the header
//! states once for all functions what a caller promises.
#![cfg_attr(not(feature = "hosted"), no_std)]

#[cfg(target_endian = "big")]
compile_error!("the arrays of C are the wire's only on little-endian machines");

mod client;
mod entry;
mod explain;
#[cfg(feature = "hosted")]
mod hosted;
mod memory;
mod rac;
mod status;
mod value;

#[cfg(test)]
mod tests;

/// For boards: this library does not panic, as the test of the linked image shows. If other Rust code of the caller panics, a
/// watchdog must reset the board.
#[cfg(not(feature = "hosted"))]
#[panic_handler]
fn panicked(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {
        core::hint::spin_loop();
    }
}
