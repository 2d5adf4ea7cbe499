//! The fuzz target `gateway`; see `bcap_fuzz::gateway`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| bcap_fuzz::gateway(data));
