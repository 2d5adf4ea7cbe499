//! The fuzz target `roundtrip_text`; see `bcap_fuzz::roundtrip_text`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| bcap_fuzz::roundtrip_text(data));
