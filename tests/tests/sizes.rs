//! Tests the memory of the core's state machines without the buffers of the caller.

use bcap_core::bcap::{Client, server};
use bcap_core::rac;
use bcap_core::slave;

#[test]
fn a_client_is_its_two_buffers_and_at_most_256_bytes() {
    assert!(size_of::<Client<[u8; 512]>>() <= 2 * 512 + 256, "{}", size_of::<Client<[u8; 512]>>());
}

#[test]
fn a_session_is_its_buffers_its_handles_and_at_most_320_bytes() {
    const OBJECTS: usize = 32;
    let handles = OBJECTS * 8;
    let session = size_of::<server::Session<[u8; 512], [u8; 512], OBJECTS>>();
    assert!(session <= 2 * 512 + handles + 320, "{session}");
}

#[test]
fn the_machines_of_rac_hold_a_line_each_way_and_little_more() {
    let (client, session) = (size_of::<rac::client::Client<[u8; 64]>>(), size_of::<rac::server::Session<[u8; 64]>>());
    assert!(client <= 2 * rac::MAX_LINE + 64 + 256, "{client}");
    assert!(session <= 2 * rac::MAX_LINE + 64 + 256, "{session}");
}

#[test]
fn an_engine_is_its_frame_its_figures_and_little_more() {
    let figures = size_of::<slave::Stats>();
    assert!(figures <= 1320, "{figures}");
    let engine = size_of::<slave::Engine<256>>();
    assert!(engine <= 256 + figures + 2120, "{engine}");
}
