//! The fuzz target `rac_line`; see `bcap_fuzz::rac_line`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| bcap_fuzz::rac_line(data));
