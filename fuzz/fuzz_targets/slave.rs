//! The fuzz target `slave`; see `bcap_fuzz::slave`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| bcap_fuzz::slave(data));
