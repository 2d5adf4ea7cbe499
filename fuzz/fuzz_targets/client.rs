//! The fuzz target `client`; see `bcap_fuzz::client`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| bcap_fuzz::client(data));
