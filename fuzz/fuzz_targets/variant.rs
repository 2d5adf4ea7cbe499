//! The fuzz target `variant`; see `bcap_fuzz::variant`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| bcap_fuzz::variant(data));
