//! The fuzz target `server`; see `bcap_fuzz::server`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| bcap_fuzz::server(data));
