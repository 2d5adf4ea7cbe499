//! The fuzz target `stream`; see `bcap_fuzz::stream`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| bcap_fuzz::stream(data));
