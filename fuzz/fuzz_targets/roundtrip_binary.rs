//! The fuzz target `roundtrip_binary`; see `bcap_fuzz::roundtrip_binary`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| bcap_fuzz::roundtrip_binary(data));
