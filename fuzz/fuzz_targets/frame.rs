//! The fuzz target `frame`; see `bcap_fuzz::frame`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| bcap_fuzz::frame(data));
