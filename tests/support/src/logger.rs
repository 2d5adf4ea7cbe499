//! A logger of defmt that drops its messages, for tests on a host: without a logger a program with defmt does not link.

#![expect(unsafe_code, reason = "defmt::Logger is an unsafe trait")]

#[defmt::global_logger]
struct Discard;

// SAFETY: no state is shared, because no state is stored
unsafe impl defmt::Logger for Discard {
    fn acquire() {}

    unsafe fn flush() {}

    unsafe fn release() {}

    unsafe fn write(_: &[u8]) {}
}

defmt::timestamp!("");

/// Fails the test, without the message, which only a decoder of defmt can print.
#[defmt::panic_handler]
fn panic() -> ! {
    std::panic!("a panic of defmt")
}
