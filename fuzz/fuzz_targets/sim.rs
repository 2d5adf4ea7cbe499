//! The fuzz target `sim`; see `bcap_fuzz::sim`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| bcap_fuzz::sim(data));
