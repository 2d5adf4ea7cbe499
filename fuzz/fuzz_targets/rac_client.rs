//! The fuzz target `rac_client`; see `bcap_fuzz::rac_client`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| bcap_fuzz::rac_client(data));
