//! The fuzz target `text`; see `bcap_fuzz::text`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| bcap_fuzz::text(data));
